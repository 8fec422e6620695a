"""The kernel composed from a catalogue, compiled and cached."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType

from ..common.files import cache_folder
from ..common.processes import child_environment
from ..effects import STAGES, Catalogue, load_catalogue

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
        'from .layout import compiled, flags, floats, lawful',
        '',
    ]
    for effect in catalogue:
        number = where.index[effect.name]
        lines.append(f'law_{number} = lawful(registered({effect.name!r}, {effect.digest!r}).law)')
    for stage in STAGES.values():
        takes = ', '.join(quantity.name for quantity in stage.inputs)
        value = ', '.join(quantity.name for quantity in stage.outputs)
        members = [effect for effect in catalogue if effect.stage == stage.name]
        lines += ['', '', '@compiled', f'def {stage.name}({takes}, chain, column):']
        if members:
            lines.append('    values, on = floats(chain.values), flags(chain.on)')
        for effect in members:
            rows = [where.rows[effect.name, p.name] for p in effect.parameters]
            parameters = ', '.join(f'values[{row} * chain.wide + column]' for row in rows)
            number = where.index[effect.name]
            lines += [
                f'    if on[{number}] != 0:',
                f'        {value} = law_{number}({takes}, {parameters})',
            ]
        lines += [f'    return {value}', '', '', '@compiled', f'def {stage.name}_acts(chain):']
        acts = ' or '.join(
            f'flags(chain.on)[{where.index[effect.name]}] != 0' for effect in members
        )
        lines.append(f'    return {acts or "False"}')
    return '\n'.join(lines) + '\n'


def kernel_key(catalogue: Catalogue) -> str:
    """Key over the sources of the kernel, its stages and every effect, Python and numba."""
    stages = f'{catalogue.digest} {stages_source(catalogue)}'
    # machine code in the cache names the modules of the laws; the same file may be in two places
    modules = ' '.join(effect.law.__module__ for effect in catalogue)
    return hashlib.sha256(f'{stages} {modules} {_kernel_digest()}'.encode()).hexdigest()[:20]


@cache
def _kernel_digest() -> str:
    """Key over what does not change while a process runs: the kernel, Python and numba."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for path in sorted(KERNEL.glob('*.py')):
        digest.update(path.read_bytes())
    version = importlib.import_module('numba').__version__
    digest.update(f'{sys.version} {version}'.encode())
    return digest.hexdigest()


@cache
def load_numba() -> None:
    """
    Import numba as far as the kernel needs it: without the linear algebra of scipy.

    Numba imports that to see whether it is there, which takes a fifth of a warm start, and again
    by itself once something compiled multiplies matrices.
    """
    linalg = importlib.import_module('numba.np.linalg')
    look = getattr(linalg, 'ensure_blas', None)
    if look is None or 'numba.np.arraymath' in sys.modules:
        return
    linalg.ensure_blas = lambda: None  # type: ignore[attr-defined]
    try:
        importlib.import_module('numba.np.arraymath').ensure_blas = look  # type: ignore[attr-defined]
    finally:
        linalg.ensure_blas = look  # type: ignore[attr-defined]


def compose(catalogue: Catalogue) -> Callable[[str], ModuleType]:
    """
    Return a function that imports a module of the kernel composed for a catalogue.

    The composed package lies in `cache_folder()`; numba caches its machine code beside it.
    """
    key = kernel_key(catalogue)
    name = f'tendon_robot_kernel_{key}'
    if name not in _COMPOSED:
        load_numba()
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


BESIDE = """
from tendon_robot_ros.common.processes import end_with_parent
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.compile import compose

end_with_parent()
kernel = compose(load_catalogue())
for part, entry in {entries!r}:
    kernel('layout').address_of(getattr(kernel(part), entry))
"""


@contextmanager
def compiled_beside(catalogue: Catalogue, *entries: tuple[str, str]) -> Iterator[None]:
    """
    Have a process of its own compile entries of the kernel meanwhile; wait for it.

    Each by its module and its name. Nothing happens where the first is compiled, where one
    processor is all there is, and with effects that another process would have to be told of.
    """
    alone = os.cpu_count() == 1 or is_compiled(catalogue, entries[0][0])
    # who asks for the usual effects reads what is installed: not for every model
    if alone or load_catalogue().digest != catalogue.digest:
        yield
        return
    command = [sys.executable, '-c', BESIDE.format(entries=entries)]
    with subprocess.Popen(command, env=child_environment(), stderr=subprocess.DEVNULL):
        yield


def is_compiled(catalogue: Catalogue, part: str = '') -> bool:
    """Tell whether machine code for a catalogue, or of one module of it, lies in the cache."""
    # beside the sources, or with NUMBA_CACHE_DIR in a folder of that name and a hash
    files = f'tendon_robot_kernel_{kernel_key(catalogue)}*/**/{part}*.nbc'
    return any(cache_folder().glob(files))


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
