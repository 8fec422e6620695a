"""A robot and its effects as the arrays of the kernel, which is composed, compiled and cached."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import EffectError, RobotDescriptionError
from ..common.files import cache_folder
from ..common.processes import child_environment
from ..common.words import COMPILING
from ..effects import STAGES, Catalogue, Effect, load_catalogue
from ..robot import Robot
from ..robot.description import helix_angles, tendon_offsets
from ..robot.estimates import stiffnesses

# [rad] largest change of a bend at which an equilibrium has converged, so that the tip of an arm
# of 100 cells and 1 m is within 10 nm
BEND_TOLERANCE = 1e-10
# [N] below it a wire is slack, because its tension is rounding; also the step of differences, one
# way too: a longer one would err by as much as low tensions weigh in a search. Measured: with 6e-6
# N those of a robot a fifth as large are others by up to 10 %
LEAST_TENSION_N = 1e-6
# [1] parts of a path at most. Measured at 288 postures of kato_10_1, spatial_3 and spatial_6: nine
# of ten tips are within 7.4 µm of those of 1024 parts; with 64, in three quarters of the time, 180
PARTS = 256
# [m] gap of a wire that ends a search, because friction near rest changes sign within 2e-6
GAP_ACCEPTED_M = 5e-6
KERNEL = Path(__file__).parent / 'kernel'


class Layout:
    """
    Where each effect of a catalogue lives in the kernel's flat arrays.

    Attributes
    ----------
    rows : dict
        (effect, parameter) -> row of Chain.values.
    index : dict
        effect -> entry of Chain.on.
    members : dict
        stage -> entries of Chain.on of its effects.
    per_section : set
        (effect, parameter) that sections have their own value of.

    """

    def __init__(self, catalogue: Catalogue) -> None:
        """Give every parameter and effect of a catalogue its number."""
        names = [(effect.name, p.name) for effect in catalogue for p in effect.parameters]
        self.rows = {name: row for row, name in enumerate(names)}
        self.index = {effect.name: index for index, effect in enumerate(catalogue)}
        self.per_section = {
            (e.name, p.name) for e in catalogue for p in e.parameters if p.per_section
        }
        self.members: dict[str, list[int]] = {stage: [] for stage in STAGES}
        for effect in catalogue:
            self.members[effect.stage].append(self.index[effect.name])


def stages_source(catalogue: Catalogue) -> str:
    """Write the module in which each stage calls its laws one after the other."""
    where = Layout(catalogue)
    lines = [
        '"""Stages of a catalogue of effects; generated, do not edit."""',
        '',
        'from tendon_robot_ros.effects.catalogue import registered',
        '',
        'from .layout import compiled, contracted, flags, floats',
        '',
    ]
    for effect in catalogue:
        number = where.index[effect.name]
        lines.append(
            f'law_{number} = contracted(registered({effect.name!r}, {effect.digest!r}).law)'
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
        own = (where.index[effect.name] for effect in members)
        acts = ' or '.join(f'flags(chain.on)[{number}] != 0' for number in own)
        lines.append(f'    return {acts or "False"}')
    return '\n'.join(lines) + '\n'


def kernel_key(catalogue: Catalogue) -> str:
    """Key over the sources of the kernel, its stages and every effect, Python and numba."""
    stages = f'{catalogue.digest} {stages_source(catalogue)}'
    # machine code in the cache names the modules of the laws; the same file may be in two places
    modules = ' '.join(effect.law.__module__ for effect in catalogue)
    return hashlib.sha256(f'{stages} {modules} {kernel_digest()}'.encode()).hexdigest()[:20]


@cache
def kernel_digest() -> str:
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
    check = getattr(linalg, 'ensure_blas', None)
    if check is None or 'numba.np.arraymath' in sys.modules:
        return
    linalg.ensure_blas = lambda: None  # type: ignore[attr-defined]
    try:
        importlib.import_module('numba.np.arraymath').ensure_blas = check  # type: ignore[attr-defined]
    finally:
        linalg.ensure_blas = check  # type: ignore[attr-defined]


def compose(catalogue: Catalogue) -> Callable[[str], ModuleType]:
    """
    Return a function that imports a module of the kernel composed for a catalogue.

    The composed package lies in `cache_folder()`; numba caches its machine code beside it.
    """
    key = kernel_key(catalogue)
    name = f'tendon_robot_kernel_{key}'
    if name not in sys.modules:
        load_numba()
        folder = cache_folder() / name
        if not (folder / 'stages.py').is_file():
            # written beside its place and moved there, so that no process sees half of it
            scratch = Path(tempfile.mkdtemp(dir=folder.parent, prefix='composing_'))
            for path in sorted(KERNEL.glob('*.py')):
                shutil.copyfile(path, scratch / path.name)
            (scratch / 'stages.py').write_text(stages_source(catalogue), encoding='utf-8')
            try:
                scratch.rename(folder)
            except OSError:  # another process was faster
                shutil.rmtree(scratch)
        spec = importlib.util.spec_from_file_location(
            name, folder / '__init__.py', submodule_search_locations=[str(folder)]
        )
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return cache(lambda part: importlib.import_module(f'{name}.{part}'))


def is_compiled(catalogue: Catalogue, part: str = '') -> bool:
    """Tell whether machine code for a catalogue, or of one module of it, lies in the cache."""
    # beside the sources, or with NUMBA_CACHE_DIR in a folder of that name and a hash
    files = f'tendon_robot_kernel_{kernel_key(catalogue)}*/**/{part}*.nbc'
    return any(cache_folder().glob(files))


def say_where_it_compiles(catalogue: Catalogue) -> None:
    """Say on the terminal that the model compiles first, where it is not in the cache."""
    if not is_compiled(catalogue):
        print(COMPILING, file=sys.stderr)


COMPILE_ENTRIES = """
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
    processor is all there is, and with effects that another process does not know.
    """
    alone = os.cpu_count() == 1 or is_compiled(catalogue, entries[0][0])
    # who asks for the usual effects reads what is installed: not for every model
    if alone or load_catalogue().digest != catalogue.digest:
        yield
        return
    command = [sys.executable, '-c', COMPILE_ENTRIES.format(entries=entries)]
    with subprocess.Popen(command, env=child_environment(), stderr=subprocess.DEVNULL):
        yield


# What only implicit models and derivatives by parameters call: fields of the kernel's chain, by
# their module. A first shape of an explicit model need not wait for them.
LINKED = {
    'sweep': ('prepare', 'place_travel', 'balance', 'residual'),
    'elimination': ('respond',),
    'equilibrium': ('newton', 'solve_equilibrium', 'descend', 'march'),
    'loads': ('load_moments', 'bow_cells', 'pushes'),
    'linearisation': ('load_slopes', 'push_slopes', 'leaning_slopes'),
    'geometry': ('leaning_travel',),
    'shape': ('remembered', 'ramped'),
}
MODULES = {name: module for module, names in LINKED.items() for name in names}
# About half of the work: these are compiled by a process of its own.
BESIDE = ('respond', 'balance', 'residual', 'newton')
# What only models call in which an effect acts at one of these stages; tendons that wind lean as
# those of cells that twist.
ONLY_WITH = {
    ('load', 'tip_load', 'push'): {
        *('load_moments', 'bow_cells', 'load_slopes', 'descend'),
    },
    ('push',): {'pushes', 'push_slopes'},
    ('torsion',): {'leaning_travel', 'leaning_slopes'},
    ('memory',): {'remembered', 'ramped'},
}
LINKING_STAGES = {'length', 'stretch', 'winding'}  # see `place_as` of the kernel
LINKING_STAGES |= {name for name, stage in STAGES.items() if stage.implicit}


def described_effect(
    robot: Robot, catalogue: Catalogue, name: str, values: Mapping[str, Any]
) -> Effect:
    """
    Return an effect of a description, whose values are checked.

    Raises
    ------
    EffectError
        The catalogue does not have it.
    RobotDescriptionError
        A parameter is unknown or missing, out of bounds, or has another number of values.

    """
    try:
        effect = catalogue[name]
    except EffectError as error:
        raise EffectError(f'{robot.source}: effects: {error}') from None
    known = {parameter.name: parameter for parameter in effect.parameters}
    for key, value in values.items():
        where = f'effects.{name}.{key}'
        if key not in known:
            raise RobotDescriptionError(robot.source, where, 'one of ' + ', '.join(known), key)
        parameter = known[key]
        numbers = value if isinstance(value, tuple) else (value,)
        per = parameter.per
        count = {'section': len(robot.sections), 'tendon': len(robot.tendons)}.get(per)
        if isinstance(value, tuple) and len(value) != count:
            many = count is not None and count > 1
            expected = f'{count} numbers (one per {per})' if many else 'one number'
            raise RobotDescriptionError(robot.source, where, expected, list(value))
        for number in numbers:
            if expected := parameter.expected(number):
                raise RobotDescriptionError(robot.source, where, expected, number)
    missing = [p.name for p in known.values() if not (p.has_default or p.name in values)]
    if effect.always_on and missing:
        raise RobotDescriptionError(robot.source, f'effects.{name}', ', '.join(missing), None)
    return effect


class KernelArrays:
    """Flat arrays of a robot with its effects, and the composed kernel's modules."""

    def __init__(self, robot: Robot, catalogue: Catalogue) -> None:
        """Check the effects against the catalogue and fill the arrays."""
        self.robot, self.catalogue = robot, catalogue
        self.part = compose(catalogue)  # returns a module of the composed kernel
        self.layout = Layout(catalogue)
        self.cells = cell_rows(robot)
        self.offset = tendon_offsets(robot)
        self.helix = helix_angles(robot)
        puller = {k: j for j, members in enumerate(robot.input_tendons) for k in members}
        rows = [[cells, puller[k]] for k, cells in enumerate(robot.tendon_cells)]
        self.tendon = np.array(rows, dtype=np.int64)
        self.gravity = np.array(robot.gravity or (0.0, 0.0, 0.0))
        ends = np.cumsum([section.cells for section in robot.sections]).tolist()
        # the cells of each section
        self.spans = [
            slice(end - s.cells, end) for end, s in zip(ends, robot.sections, strict=True)
        ]
        wide = max(robot.cells, len(robot.tendons))
        neutral = [[p.neutral] * wide for effect in catalogue for p in effect.parameters]
        self.values = np.array(neutral, dtype=float).reshape(-1, wide)
        self.on = np.zeros(len(self.layout.index), dtype=np.uint8)
        self._linked = set[bytes]()  # the effects that acted when `link` was called
        self.twisting = np.zeros_like(self.on)  # which effects let cells twist
        self.twisting[self.layout.members['torsion']] = 1
        for name, values in robot.effects.items():
            self.read(name, values)
        linked = bool(self._acting() & LINKING_STAGES) or bool(self.helix.any())
        entries = [(MODULES[field], field) for field in BESIDE]
        beside = compiled_beside(catalogue, *entries) if linked else nullcontext()
        with beside:
            lay = self.part('layout')
            arrays = ('cells', 'offset', 'tendon', 'values', 'on', 'gravity')
            self.chain = lay.Chain(
                n=robot.cells,
                k=len(robot.tendons),
                m=len(robot.inputs),
                wide=self.values.shape[1],
                radius=float(np.linalg.norm(self.offset, axis=2).max()),
                step=lay.address_of(self.part('sweep').step),
                helix=self.helix.ctypes.data if self.helix.any() else 0,
                beside=int(any(any(any(xy) for xy in s.mass_offset) for s in robot.sections)),
                **dict.fromkeys(MODULES, 0),
                **{name: getattr(self, name).ctypes.data for name in arrays},
            )
            radius = np.float64(self.chain.radius).view(np.int64)
            self._words = np.array(self.chain._replace(radius=radius), dtype=np.int64)
            self.address = int(self._words.ctypes.data)  # of the chain's fields, for the kernel
            if linked:
                self._link(self._called() - {*BESIDE})
                lay.address_of(self.part('shape').postures)
        if linked:
            self.link()

    def columns(self, effect: str, parameter: str, owner: int | None) -> slice:
        """Return where the values of one section or tendon, or of all, are: a column per cell."""
        if owner is None:
            return slice(None)
        own = (effect, parameter) in self.layout.per_section
        return self.spans[owner] if own else slice(owner, owner + 1)

    def set(self, effect: str, parameter: str, owner: int | None, value: float) -> None:
        """Set one parameter (of one section or tendon, or of all) and switch its effect on."""
        row = self.layout.rows[effect, parameter]
        self.values[row, self.columns(effect, parameter, owner)] = value
        self.act(effect)

    def act(self, effect: str) -> None:
        """Switch an effect on; its parameters stay."""
        self.on[self.layout.index[effect]] = 1
        if self.catalogue[effect].stage in LINKING_STAGES:
            self.link()

    def get(self, effect: str, parameter: str, owner: int | None = None) -> float:
        """Return one parameter (of one section or tendon)."""
        columns = self.columns(effect, parameter, owner)
        return float(self.values[self.layout.rows[effect, parameter], columns.start or 0])

    @property
    def unknowns(self) -> int:
        """How many entries of a state are unknowns of the present model."""
        return (3 if self.twists else 2) * int(self.chain.n)

    @property
    def twists(self) -> bool:
        """Whether cells twist about their own axis."""
        return bool((self.on & self.twisting).any())

    def read(self, name: str, values: dict[str, Any]) -> None:
        """Set an effect as a description lists it, within the bounds of its parameters."""
        effect = described_effect(self.robot, self.catalogue, name, values)
        for key, value in values.items():
            numbers = value if isinstance(value, tuple) else (value,)
            row = self.values[self.layout.rows[name, key]]
            row[:] = numbers[0]
            for owner, number in enumerate(numbers):
                row[self.columns(name, key, owner)] = number
        rows = [self.layout.rows[name, parameter.name] for parameter in effect.parameters]
        neutral = np.array([[parameter.neutral] for parameter in effect.parameters])
        acts = effect.always_on or bool(np.any(self.values[rows] != neutral))
        self.on[self.layout.index[name]] = acts

    def link(self) -> None:
        """
        Compile what explicit models do without and what acts here calls, if that is not yet done.

        Before anything that asks the kernel for residuals or their responses, and once another
        effect acts: without it they call the address 0.
        """
        acts = self.on.tobytes()
        if acts not in self._linked:
            self._link(self._called())
            self._linked.add(acts)

    def acts_at(self, stage: str) -> bool:
        """Tell whether an effect of a stage acts."""
        return any(self.on[place] for place in self.layout.members[stage])

    def _acting(self) -> frozenset[str]:
        """Return the stages at which effects act."""
        return frozenset(filter(self.acts_at, STAGES))

    def _called(self) -> frozenset[str]:
        """Return the functions of `LINKED` that the active effects call."""
        acting = self._acting() | ({'torsion'} if self.helix.any() else set())
        idle = [names for stages, names in ONLY_WITH.items() if not acting & {*stages}]
        called = frozenset(MODULES).difference(*idle)
        # only arms without loads whose friction follows the cell alone are solved cell by cell
        follows_cell = not {'friction_travel', 'eyelet'} <= acting
        return called if follows_cell and 'descend' not in called else called - {'march'}

    def _link(self, fields: Iterable[str]) -> None:
        address_of = self.part('layout').address_of
        for name in fields:
            place = self.chain._fields.index(name)
            if not self._words[place]:
                self._words[place] = address_of(getattr(self.part(MODULES[name]), name))

    def scratch(self) -> Floats:
        """Return scratch memory for one thread."""
        lay, (n, k, m) = self.part('layout'), self.chain[:3]
        scratch = np.zeros(lay.work_size(n, k) + lay.memory_size(n, k, m) + 3 * n + k + m)
        lay.lay_out_work(n, k, scratch)
        return scratch

    def fresh_memory(self) -> Floats:
        """Return the friction memory of the straight, tension-free arm."""
        return np.zeros(self.part('layout').memory_size(*self.chain[:3]))


def cell_rows(robot: Robot) -> Floats:
    """Return a row (n, 7) per cell, in the columns of the kernel (`CELL_COLUMNS`)."""
    sections = [section for section in robot.sections for _ in range(section.cells)]
    profile = np.concatenate([s.mass_profile for s in robot.sections])
    rows = np.empty((robot.cells, 7))
    rows[:, 0], rows[:, 1] = robot.cell_lengths, stiffnesses(robot)
    rows[:, 2] = profile * robot.cell_lengths
    rows[:, 3] = [section.bends_as == 'hinge' for section in sections]
    rows[:, 4] = [sum(i < end for end in robot.tendon_cells) for i in range(robot.cells)]
    rows[:, 5:] = [xy for s in robot.sections for xy in s.mass_offset or [(0.0, 0.0)] * s.cells]
    return rows
