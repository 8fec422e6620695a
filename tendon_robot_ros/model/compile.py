"""The kernel composed from a catalogue and cached, and the flat arrays that it reads."""

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
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import EffectError, RobotDescriptionError
from ..effects import STAGES, Catalogue, Parameter
from ..robot import Robot
from ..robot.routes import helix_angles, tendon_offsets

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


# -----------------------------------------------------------------------------
# A robot and a catalogue as the flat arrays that the kernel reads, kept alive together.

Floats = npt.NDArray[np.float64]


# Functions that only implicit models and derivatives by parameters call: by field of the kernel's
# chain, the module and its name. A first shape of an explicit model need not wait for them.
LINKED = {
    'residual': ('residual', 'residual'),
    'respond': ('response', 'respond'),
    'newton': ('newton', 'newton'),
    'settle': ('solve', 'solve_equilibrium'),
}
LINKING_STAGES = {'length', 'stretch', 'winding'}  # see the kernel's `place_as`
LINKING_STAGES |= {name for name, stage in STAGES.items() if stage.implicit}


class KernelArrays:
    """Flat arrays of a robot with its effects, and the composed kernel's modules."""

    def __init__(self, robot: Robot, catalogue: Catalogue) -> None:
        """Check the effects against the catalogue and fill the arrays."""
        self.robot, self.catalogue = robot, catalogue
        self.kernel = compose(catalogue)
        self.layout = layout(catalogue)
        self.cells = _cells(robot)
        self.offset = tendon_offsets(robot)
        self.helix = helix_angles(robot)
        self.tendon = np.array(
            [
                [robot.tendon_cells[k], j]
                for k in range(len(robot.tendons))
                for j, members in enumerate(robot.input_tendons)
                if k in members
            ],
            dtype=np.int64,
        )
        self.gravity = np.array(robot.gravity or (0.0, 0.0, 0.0))
        wide = max(len(robot.sections), len(robot.tendons))
        self.values = np.empty((len(self.layout.rows), wide))
        self.on = np.zeros(len(self.layout.index), dtype=np.uint8)
        for effect in catalogue:
            for parameter in effect.parameters:
                self.values[self.layout.rows[effect.name, parameter.name]] = parameter.neutral
        for name, values in robot.effects.items():
            self._read(name, values)
        self.chain = self._chain()
        radius = np.float64(self.chain.radius).view(np.int64)
        self._words = np.array(self.chain._replace(radius=radius), dtype=np.int64)
        self.address = int(self._words.ctypes.data)  # of the chain's fields, for the kernel
        acting = {e.stage for e in catalogue if self.on[self.layout.index[e.name]]}
        if acting & LINKING_STAGES or self.helix.any():
            self.link()

    def part(self, name: str) -> ModuleType:
        """Return a module of the composed kernel."""
        return self.kernel(name)

    def columns(self, parameter: Parameter) -> tuple[str, ...]:
        """Return whose values the columns of a parameter are: sections, tendons, or nobody's."""
        if parameter.per == 'section':
            return tuple(section.name for section in self.robot.sections)
        return tuple(tendon.name for tendon in self.robot.tendons if parameter.per == 'tendon')

    def set(self, effect: str, parameter: str, column: int | None, value: float) -> None:
        """Set one parameter (of one section or tendon, or of all) and switch its effect on."""
        row = self.layout.rows[effect, parameter]
        self.values[row, slice(None) if column is None else column] = value
        self.act(effect)

    def act(self, effect: str) -> None:
        """Switch an effect on; its parameters stay."""
        self.on[self.layout.index[effect]] = 1
        if self.catalogue[effect].stage in LINKING_STAGES:
            self.link()

    def get(self, effect: str, parameter: str, column: int | None = None) -> float:
        """Return one parameter (of one section or tendon)."""
        return float(self.values[self.layout.rows[effect, parameter], column or 0])

    @property
    def twists(self) -> bool:
        """Whether cells twist about their own axis."""
        return any(
            self.on[self.layout.index[e.name]] for e in self.catalogue if e.stage == 'torsion'
        )

    def _read(self, name: str, values: dict[str, Any]) -> None:
        robot = self.robot
        try:
            effect = self.catalogue[name]
        except EffectError as error:
            raise EffectError(f'{robot.source}: effects: {error}') from None
        known = {parameter.name: parameter for parameter in effect.parameters}
        for key, value in values.items():
            where = f'effects.{name}.{key}'
            if key not in known:
                raise RobotDescriptionError(robot.source, where, 'one of ' + ', '.join(known), key)
            parameter = known[key]
            numbers = value if isinstance(value, tuple) else (value,)
            if isinstance(value, tuple) and len(value) != len(self.columns(parameter)):
                wanted = 'one number'
                if parameter.per:
                    count = len(self.columns(parameter))
                    wanted = f'{count} numbers (one per {parameter.per})'
                raise RobotDescriptionError(robot.source, where, wanted, list(value))
            low, high = parameter.described_bounds
            for number in numbers:
                if not low <= number <= high:
                    wanted = f'a number from {low:g} to {high:g} [{parameter.unit}]'
                    raise RobotDescriptionError(robot.source, where, wanted, number)
            row = self.values[self.layout.rows[name, key]]
            row[: len(numbers)] = numbers
            row[len(numbers) :] = numbers[0]
        missing = [p.name for p in known.values() if not (p.has_default or p.name in values)]
        if effect.always_on and missing:
            raise RobotDescriptionError(robot.source, f'effects.{name}', ', '.join(missing), None)
        rows = [self.layout.rows[name, key] for key in known]
        neutral = np.array([[known[key].neutral] for key in known])
        acts = effect.always_on or bool(np.any(self.values[rows] != neutral))
        self.on[self.layout.index[name]] = acts

    def _chain(self) -> Any:
        lay = self.part('layout')
        at = {
            key: getattr(self, key).ctypes.data
            for key in ('cells', 'offset', 'tendon', 'values', 'on', 'gravity')
        }
        robot = self.robot
        return lay.Chain(
            n=robot.cells,
            k=len(robot.tendons),
            m=len(robot.inputs),
            wide=self.values.shape[1],
            radius=float(np.linalg.norm(self.offset, axis=2).max()),
            step=lay.address_of(self.part('sweep').step),
            **dict.fromkeys(LINKED, 0),
            helix=self.helix.ctypes.data if self.helix.any() else 0,
            beside=int(any(any(any(xy) for xy in s.mass_offset) for s in robot.sections)),
            **at,
        )

    def link(self) -> None:
        """
        Compile what explicit models do without, if that is not yet done.

        Before anything that asks the kernel for residuals or their responses: without it they call
        the address 0.
        """
        address_of = self.part('layout').address_of
        for place, (part, name) in LINKED.items():
            field = self.chain._fields.index(place)
            if not self._words[field]:
                self._words[field] = address_of(getattr(self.part(part), name))

    def scratch(self) -> Floats:
        """Return scratch memory for one thread."""
        lay, chain = self.part('layout'), self.chain
        return np.zeros(
            lay.work_size(chain.n, chain.k)
            + 3 * chain.n
            + lay.memory_size(chain.n, chain.k, chain.m)
            + chain.k
            + chain.m
        )

    def fresh_memory(self) -> Floats:
        """Return the friction memory of the straight, tension-free arm."""
        chain = self.chain
        return np.zeros(self.part('layout').memory_size(chain.n, chain.k, chain.m))


def _cells(robot: Robot) -> Floats:
    rows: list[list[float]] = []
    for index, section in enumerate(robot.sections):
        for i in range(section.cells):
            present = sum(len(rows) < cells for cells in robot.tendon_cells)
            rows.append(
                [
                    section.cell_length,
                    section.bending_stiffness[i],
                    section.mass_profile[i] * section.cell_length,
                    float(section.bends_as == 'hinge'),
                    float(index),
                    float(present),
                    *(section.mass_offset[i] if section.mass_offset else (0.0, 0.0)),
                ]
            )
    return np.array(rows)
