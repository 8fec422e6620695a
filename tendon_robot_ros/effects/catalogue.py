"""The catalogue of effects: the built-in ones, entry points, and files that the user names."""

from __future__ import annotations

import hashlib
import importlib
import importlib.machinery
import importlib.util
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from ..common.errors import EffectError, refusal, suggestion
from .effect import Effect

# Order matters twice: laws of one stage apply in it, and exact twins are reported in it.
BUILT_IN = (
    'tendon_friction',
    'eyelet_wrap',
    'tendon_travel',
    'friction_memory',
    'straight_tendon',
    'eyelet_clearance',
    'hinge_friction',
    'bending_hysteresis',
    'backbone_stiffness',
    'section_stiffness',
    'tendon_stiffness',
    'nonlinear_stiffness',
    'pre_curvature',
    'torsion',
    'gravity',
    'tip_load',
    'point_load',
    'tether',
    'contact',
    'axial_compression',
    'transmission_loss',
    'tension_offset',
    'moment_arm',
    'tendon_elongation',
    'wire_spring',
    'backlash',
    'pull_zero',
    'spool_gain',
    'base_misalignment',
)
ENTRY_POINT_GROUP = 'tendon_robot_ros.effects'
_LAWS: dict[tuple[str, str], Effect] = {}  # (name, digest) -> effect, for the composed kernels


class Catalogue:
    """An ordered set of effects."""

    def __init__(
        self, effects: Iterable[Effect], files: tuple[str, ...] = (), is_sized: bool = False
    ) -> None:
        """Refuse names that stand twice; `is_sized`: bounds are those for one robot already."""
        self.files, self.is_sized = files, is_sized
        self._effects: dict[str, Effect] = {}
        for effect in effects:
            if effect.name in self._effects:
                raise EffectError(f'effect {effect.name}: the name is taken; choose another')
            self._effects[effect.name] = effect
            _LAWS[effect.name, effect.digest] = effect

    def __iter__(self) -> Iterator[Effect]:
        """Iterate in catalogue order."""
        return iter(self._effects.values())

    def __contains__(self, name: object) -> bool:
        """Tell whether an effect is known."""
        return name in self._effects

    def __getitem__(self, name: str) -> Effect:
        """Return an effect by name; EffectError lists the known ones."""
        if name not in self._effects:
            raise EffectError(
                f'unknown effect {name!r}; known: {", ".join(self.names)} '
                f'({suggestion(name, self.names)}name the file of your own: --effect-file, '
                'parameter effects of a node, catalogue in Python and of the plant of a mock arm)'
            )
        return self._effects[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in catalogue order."""
        return tuple(self._effects)

    @property
    def digest(self) -> str:
        """Key over names, order and sources of all effects."""
        text = ' '.join(f'{effect.name}:{effect.digest}' for effect in self)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def twin(self, tolerance: str) -> tuple[str, tuple[str, ...]] | None:
        """Return the effect and its parameters that say the same as a declared tolerance."""
        for effect in self:
            parameters = tuple(p.name for p in effect.parameters if p.tolerance == tolerance)
            if parameters:
                return effect.name, parameters
        return None

    def needing(self, need: str) -> frozenset[str]:
        """Return the names of the effects that need something of the measurements."""
        return frozenset(effect.name for effect in self if need in effect.needs)

    def without(self, *names: str) -> Catalogue:
        """Return a catalogue that lacks some effects."""
        return Catalogue((e for e in self if e.name not in names), self.files, self.is_sized)

    def sized(self, sizes: Mapping[str, float]) -> Catalogue:
        """Return the catalogue with bounds and typical values for a robot of these sizes."""
        if self.is_sized:
            return self
        return Catalogue((effect.sized(sizes) for effect in self), self.files, is_sized=True)


CatalogueLike = Catalogue | str | Path | Iterable[str | Path]


def load_catalogue(files: CatalogueLike | None = None) -> Catalogue:
    """
    Load the built-in effects, those of installed packages, and the files that a user named.

    Parameters
    ----------
    files : path, iterable of paths, or Catalogue, optional
        Python files, each with an `EFFECT`. They are executed: name only your own. A catalogue
        is given back.

    Raises
    ------
    EffectError
        A file cannot be read, has no `EFFECT`, or uses a name that is taken.
    InputError
        It is none of these.

    """
    if isinstance(files, Catalogue):
        return files
    paths = [files] if isinstance(files, str | Path) else () if files is None else files
    if not isinstance(paths, Iterable) or not all(isinstance(one, str | Path) for one in paths):
        raise refusal('catalogue', 'a Catalogue, or the paths of files with an EFFECT', files)
    effects = [importlib.import_module(f'{__package__}.{name}').EFFECT for name in BUILT_IN]
    effects += _installed()
    named = tuple(str(Path(file).resolve()) for file in paths)
    return Catalogue(effects + [_from_file(Path(file)) for file in named], named)


@cache
def _installed() -> tuple[Effect, ...]:
    """Return the effects of installed packages; read once, as modules are."""
    points = sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name)
    found = []
    for point in points:
        with _in_one_line(f'entry point {ENTRY_POINT_GROUP}: {point.value}'):
            found.append(_checked(point.load(), point.value))
    return tuple(found)


def registered(name: str, digest: str) -> Effect:
    """Return the effect that a composed kernel was made from."""
    return _LAWS[name, digest]


def _checked(effect: object, where: str) -> Effect:
    if not isinstance(effect, Effect):
        raise EffectError(f'{where}: expected EFFECT = Effect(...), got {effect!r}')
    return effect


@contextmanager
def _in_one_line(where: str) -> Iterator[None]:
    """Make one line of whatever the user's code raises while it is read."""
    try:
        yield
    except EffectError:
        raise
    except Exception as error:
        raise EffectError(f'{where}: {type(error).__name__}: {error}') from None


def _from_file(path: Path) -> Effect:
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise EffectError(
            f'{path}: expected a Python file with an EFFECT, got {error.strerror}'
        ) from None
    name = f'tendon_robot_effect_{digest}'  # compiled code is found again by this name
    if name not in sys.modules:
        loader = importlib.machinery.SourceFileLoader(name, str(path))
        spec = importlib.util.spec_from_loader(name, loader)
        assert spec is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            with _in_one_line(str(path)):
                loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return _checked(getattr(sys.modules[name], 'EFFECT', None), str(path))
