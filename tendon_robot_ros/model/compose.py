"""Compose the compiled kernel from a catalogue of effects and cache it under a key of sources."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

from ..effects import STAGES, Catalogue

KERNEL = Path(__file__).parent / 'kernel'
_COMPOSED: dict[str, ModuleType] = {}


@dataclass(frozen=True)
class Layout:
    """Where each effect of a catalogue lives in the kernel's flat arrays."""

    rows: dict[tuple[str, str], int]  # (effect, parameter) -> row of Chain.values
    index: dict[str, int]  # effect -> entry of Chain.on


def layout(catalogue: Catalogue) -> Layout:
    """Give every parameter and effect of a catalogue its number."""
    names = [(effect.name, p.name) for effect in catalogue for p in effect.parameters]
    return Layout(
        {name: row for row, name in enumerate(names)},
        {effect.name: index for index, effect in enumerate(catalogue)},
    )


def stages_source(catalogue: Catalogue) -> str:
    """Write the module in which each stage calls its laws one after the other."""
    where = layout(catalogue)
    lines = [
        '"""Stages of a catalogue of effects; generated, do not edit."""',
        '',
        'from tendon_robot_ros.effects.catalogue import registered',
        '',
        'from .layout import compiled, flags, floats',
        '',
    ]
    for effect in catalogue:
        number = where.index[effect.name]
        lines.append(
            f'law_{number} = compiled(registered({effect.name!r}, {effect.digest!r}).law)'
        )
    for stage, (takes, _) in STAGES.items():
        arguments = takes.split(', ')
        changing = {'rest': 2, 'arm': 3, 'load': 3, 'tip_load': 3, 'measurement': 3}.get(stage, 1)
        value = ', '.join(arguments[:changing])
        members = [effect for effect in catalogue if effect.stage == stage]
        lines += ['', '', '@compiled', f'def {stage}({takes}, chain, section):']
        if members:
            lines.append('    values, on = floats(chain.values), flags(chain.on)')
        for effect in members:
            rows = [where.rows[effect.name, p.name] for p in effect.parameters]
            parameters = ', '.join(f'values[{row} * chain.sections + section]' for row in rows)
            number = where.index[effect.name]
            lines += [
                f'    if on[{number}] != 0:',
                f'        {value} = law_{number}({takes}, {parameters})',
            ]
        lines += [f'    return {value}', '', '', '@compiled', f'def {stage}_acts(chain):']
        acts = ' or '.join(
            f'flags(chain.on)[{where.index[effect.name]}] != 0' for effect in members
        )
        lines.append(f'    return {acts or "False"}')
    return '\n'.join(lines) + '\n'


@cache
def cache_folder() -> Path:
    """Folder for compiled kernels: NUMBA_CACHE_DIR, XDG_CACHE_HOME, home, else temporary."""
    candidates = [os.environ.get('NUMBA_CACHE_DIR')]
    if os.environ.get('XDG_CACHE_HOME'):
        candidates.append(os.path.join(os.environ['XDG_CACHE_HOME'], 'tendon_robot_ros'))
    elif os.path.expanduser('~') != '~':
        candidates.append(os.path.join(os.path.expanduser('~'), '.cache', 'tendon_robot_ros'))
    for candidate in candidates:
        if not candidate:
            continue
        try:
            path = Path(candidate).resolve()
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                return path
        except OSError:
            continue
    warnings.warn(
        'no writable cache folder: the model is compiled anew by every process; '
        'set NUMBA_CACHE_DIR to a writable folder',
        stacklevel=2,
    )
    return Path(tempfile.mkdtemp(prefix='tendon_robot_ros_'))


def kernel_key(catalogue: Catalogue) -> str:
    """Key over the sources of the kernel and of every effect, Python and numba."""
    digest = hashlib.sha256(catalogue.digest.encode())
    for path in sorted(KERNEL.glob('*.py')):
        digest.update(path.read_bytes())
    digest.update(Path(__file__).read_bytes())
    version = importlib.import_module('numba').__version__
    digest.update(f'{sys.version} {version}'.encode())
    return digest.hexdigest()[:20]


def compose(catalogue: Catalogue) -> Callable[[str], ModuleType]:
    """
    Return a function that imports a module of the kernel composed for a catalogue.

    The composed package lies in `cache_folder()`; numba caches its machine code beside it.
    """
    key = kernel_key(catalogue)
    name = f'tendon_robot_kernel_{key}'
    if name not in _COMPOSED:
        folder = cache_folder() / name
        if not (folder / 'stages.py').is_file():
            _write(folder, stages_source(catalogue))
        spec = importlib.util.spec_from_file_location(
            name, folder / '__init__.py', submodule_search_locations=[str(folder)]
        )
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        _COMPOSED[name] = module
    return cache(lambda part: importlib.import_module(f'{name}.{part}'))


def is_compiled(catalogue: Catalogue) -> bool:
    """Tell whether machine code for a catalogue lies in the cache."""
    # beside the sources, or with NUMBA_CACHE_DIR in a folder of that name and a hash
    return any(cache_folder().glob(f'tendon_robot_kernel_{kernel_key(catalogue)}*/**/*.nbc'))


def _write(folder: Path, stages: str) -> None:
    """Write the package beside its place and move it there, so that no process sees half."""
    scratch = Path(tempfile.mkdtemp(dir=folder.parent, prefix='composing_'))
    for path in sorted(KERNEL.glob('*.py')):
        shutil.copyfile(path, scratch / path.name)
    (scratch / 'stages.py').write_text(stages, encoding='utf-8')
    try:
        scratch.rename(folder)
    except OSError:  # another process was faster
        shutil.rmtree(scratch)
