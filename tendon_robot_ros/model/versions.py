"""The same package, effects and compiled kernel in every worker."""

from __future__ import annotations

import fcntl
import hashlib
import importlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ..common.errors import InputError
from ..common.files import cache_folder, write_text
from ..effects import Catalogue, load_catalogue
from . import forward
from .compile import kernel_key

PACKAGE = Path(__file__).parent.parent
LIBRARIES = ('numpy', 'scipy', 'numba')
# folders on whose code a row depends; what prints and what moves motors is not among them
PARTS = (
    *('common', 'robot', 'effects', 'model', 'data', 'inference', 'comparison'),
    *('diagnosis', 'simulation', 'workspace', 'studies'),
)


@dataclass(frozen=True)
class UserEffect:
    """A file with an effect of the user, as it goes to workers."""

    name: str
    text: str

    @classmethod
    def read(cls, files: Sequence[str | Path]) -> tuple[UserEffect, ...]:
        """Read the files that the user has named."""
        load_catalogue(files)  # refuses what is none
        return tuple(cls(Path(f).name, Path(f).read_text(encoding='utf-8')) for f in files)


@cache
def catalogue_of(effects: tuple[UserEffect, ...]) -> Catalogue:
    """Load the catalogue with the user's own effects, which lie beside the compiled kernels."""
    files = []
    for effect in effects:
        digest = hashlib.sha256(effect.text.encode()).hexdigest()[:16]
        folder = cache_folder() / 'effects' / digest
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / effect.name).is_file():
            write_text(folder / effect.name, effect.text)
        files.append(folder / effect.name)
    return load_catalogue(files)


@cache
def versions(effects: tuple[UserEffect, ...] = ()) -> Mapping[str, str]:
    """
    Return what results depend on, by name.

    Code counts by its digest, folder by folder: the package's version stands still between
    releases.
    """
    digests = {}
    for part in PARTS:
        digest = hashlib.sha256()
        for path in sorted((PACKAGE / part).rglob('*.py')):
            digest.update(path.relative_to(PACKAGE).as_posix().encode() + path.read_bytes())
        digests[f'{PACKAGE.name}/{part}'] = digest.hexdigest()[:8]
    digests['catalogue of effects'] = catalogue_of(effects).digest
    return digests | {name: str(importlib.import_module(name).__version__) for name in LIBRARIES}


def refuse_difference(
    where: str,
    theirs: Mapping[str, str],
    ours: Mapping[str, str],
    remedy: str = 'install the same on both sides',
) -> None:
    """
    Raise where results would depend on who computed them.

    Raises
    ------
    InputError
        One line with what differs.

    """
    apart = differences(theirs, ours)
    if apart:
        raise InputError(f'{where}: {"; ".join(apart)}; {remedy}')


def differences(theirs: Mapping[str, str], ours: Mapping[str, str]) -> list[str]:
    """Return one phrase per version that differs."""
    return [
        f'{name} is {theirs.get(name, "not")} there and {version} here'
        for name, version in ours.items()
        if theirs.get(name) != version
    ]


@dataclass(frozen=True)
class Preparation:
    """What a worker does before its first chunk: it compares versions and loads a kernel."""

    versions: tuple[tuple[str, str], ...]
    effects: tuple[UserEffect, ...] = ()

    @classmethod
    def of_this_process(cls, effects: tuple[UserEffect, ...] = ()) -> Preparation:
        """Return the preparation that demands the versions of this process."""
        return cls(tuple(versions(effects).items()), effects)

    def __call__(self) -> None:
        """Refuse another version; keep to the one core that this worker has."""
        import platform

        forward.THREADS = 1
        refuse_difference(
            f'worker on {platform.node()}', versions(self.effects), dict(self.versions)
        )


@contextmanager
def compiled_once(kind: str, effects: tuple[UserEffect, ...] = ()) -> Iterator[None]:
    """
    Let one process of this machine do a kind of work first: it compiles, the others load.

    Numba compiles what is called; the first chunk of a kind calls all that the others will.
    """
    catalogue = catalogue_of(effects)
    mark = cache_folder() / f'compiled_{kind}_{kernel_key(catalogue)}'
    with mark.with_suffix('.lock').open('w') as lock:
        if not mark.exists():
            fcntl.flock(lock, fcntl.LOCK_EX)
        if mark.exists():  # done already, or while this process waited
            fcntl.flock(lock, fcntl.LOCK_UN)
        yield
        mark.touch()
