"""A robot and a catalogue of effects as the flat arrays that the compiled kernel reads."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import EffectError, RobotDescriptionError
from ..effects import STAGES, Catalogue, Parameter
from ..robot import Robot
from ..robot.description import helix_angles, tendon_offsets
from .compile import compiled_beside, compose, layout

Floats = npt.NDArray[np.float64]


# Functions that only implicit models and derivatives by parameters call: by field of the kernel's
# chain, the module and its name. A first shape of an explicit model need not wait for them.
LINKED = {
    'prepare': ('residual', 'prepare'),
    'place_travel': ('residual', 'place_travel'),
    'balance': ('residual', 'balance'),
    'residual': ('residual', 'residual'),
    'respond': ('response', 'respond'),
    'newton': ('newton', 'newton'),
    'settle': ('equilibrium', 'solve_equilibrium'),
}
# Half of the work: these are compiled by a process of its own.
BESIDE = ('respond', 'balance', 'residual', 'newton')
# The same that only loaded arms call, those whose tendons lean, those whose friction remembers,
# and those without loads whose friction follows the cell alone.
OF_LOADS = {
    'load_moments': ('loads', 'load_moments'),
    'flat_moments': ('flat', 'flat_moments'),
    'bow_cells': ('loads', 'bow_cells'),
    'load_slopes': ('load_tangent', 'load_slopes'),
    'descend': ('newton', 'descend'),
}
OF_LEANING = {
    'leaning_travel': ('geometry', 'leaning_travel'),
    'leaning_slopes': ('tangent', 'leaning_slopes'),
}
OF_MEMORY = {'remembered': ('history', 'remembered'), 'ramped': ('history', 'ramped')}
OF_CAUSAL = {'march': ('equilibrium', 'march')}
ALL_LINKED = {**LINKED, **OF_LOADS, **OF_LEANING, **OF_MEMORY, **OF_CAUSAL}
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
        self.twisting = np.zeros_like(self.on)  # which effects let cells twist
        self.twisting[[self.layout.index[e.name] for e in catalogue if e.stage == 'torsion']] = 1
        for effect in catalogue:
            for parameter in effect.parameters:
                self.values[self.layout.rows[effect.name, parameter.name]] = parameter.neutral
        for name, values in robot.effects.items():
            self._read(name, values)
        linked = bool(self._acting() & LINKING_STAGES) or bool(self.helix.any())
        entries = [LINKED[field] for field in BESIDE]
        beside = compiled_beside(catalogue, *entries) if linked else nullcontext()
        with beside:
            self.chain = self._chain()
            radius = np.float64(self.chain.radius).view(np.int64)
            self._words = np.array(self.chain._replace(radius=radius), dtype=np.int64)
            self.address = int(self._words.ctypes.data)  # of the chain's fields, for the kernel
            if linked:
                self._link([field for field in self._called() if field not in BESIDE])
                self.part('layout').address_of(self.part('shape').postures)
        if linked:
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
        return bool((self.on & self.twisting).any())

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
            **dict.fromkeys(ALL_LINKED, 0),
            helix=self.helix.ctypes.data if self.helix.any() else 0,
            beside=int(any(any(any(xy) for xy in s.mass_offset) for s in robot.sections)),
            **at,
        )

    def link(self) -> None:
        """
        Compile what explicit models do without and what acts here calls, if that is not yet done.

        Before anything that asks the kernel for residuals or their responses, and once another
        effect acts: without it they call the address 0.
        """
        self._link(self._called())

    def _acting(self) -> frozenset[str]:
        """Return the stages at which effects act."""
        on, index = self.on, self.layout.index
        return frozenset(effect.stage for effect in self.catalogue if on[index[effect.name]])

    def _called(self) -> dict[str, tuple[str, str]]:
        """Return what the effects that act call, as `LINKED`."""
        acting, called = self._acting(), dict(LINKED)
        if acting & {'load', 'tip_load'}:
            called |= OF_LOADS
        elif not {'friction_travel', 'eyelet'} <= acting:
            called |= OF_CAUSAL
        if 'torsion' in acting or self.helix.any():
            called |= OF_LEANING
        if 'memory' in acting:
            called |= OF_MEMORY
        return called

    def _link(self, fields: Iterable[str]) -> None:
        address_of = self.part('layout').address_of
        for place in fields:
            field, (part, name) = self.chain._fields.index(place), ALL_LINKED[place]
            if not self._words[field]:
                self._words[field] = address_of(getattr(self.part(part), name))

    def scratch(self) -> Floats:
        """Return scratch memory for one thread."""
        lay, chain = self.part('layout'), self.chain
        scratch = np.zeros(
            lay.work_size(chain.n, chain.k)
            + 3 * chain.n
            + lay.memory_size(chain.n, chain.k, chain.m)
            + chain.k
            + chain.m
        )
        lay.lay_out_work(chain.n, chain.k, scratch)
        return scratch

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
