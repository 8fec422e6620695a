"""A robot and a catalogue as the flat arrays that the kernel reads, kept alive together."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from ..effects import Catalogue
from ..exceptions import EffectError, RobotDescriptionError
from ..robot import Robot
from .compose import compose, layout

Floats = npt.NDArray[np.float64]


class Arrays:
    """Flat arrays of a robot with its effects, and the composed kernel's modules."""

    def __init__(self, robot: Robot, catalogue: Catalogue) -> None:
        """Check the effects against the catalogue and fill the arrays."""
        self.robot, self.catalogue = robot, catalogue
        self.kernel = compose(catalogue)
        self.layout = layout(catalogue)
        self.cells = _cells(robot)
        self.offset = tendon_offsets(robot)
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
        self.values = np.empty((len(self.layout.rows), len(robot.sections)))
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

    def part(self, name: str) -> ModuleType:
        """Return a module of the composed kernel."""
        return self.kernel(name)

    def set(self, effect: str, parameter: str, section: int | None, value: float) -> None:
        """Set one parameter (of one section, or of all) and switch its effect on."""
        row = self.layout.rows[effect, parameter]
        self.values[row, slice(None) if section is None else section] = value
        self.on[self.layout.index[effect]] = 1

    def get(self, effect: str, parameter: str, section: int | None = None) -> float:
        """Return one parameter (of one section)."""
        return float(self.values[self.layout.rows[effect, parameter], section or 0])

    def switch(self, effect: str, on: bool) -> None:
        """Switch an effect on or off; its parameters stay."""
        self.on[self.layout.index[effect]] = on

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
            many = isinstance(value, tuple)
            if many and (not parameter.per_section or len(value) != len(robot.sections)):
                wanted = (
                    f'{len(robot.sections)} numbers (one per section)'
                    if parameter.per_section
                    else 'one number'
                )
                raise RobotDescriptionError(robot.source, where, wanted, list(value))
            for number in value if many else (value,):
                if not parameter.low <= number <= parameter.high:
                    raise RobotDescriptionError(
                        robot.source,
                        where,
                        f'a number from {parameter.low:g} to '
                        f'{parameter.high:g} [{parameter.unit}]',
                        number,
                    )
            self.values[self.layout.rows[name, key]] = value
        missing = [key for key in known if key not in values]
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
            sections=len(robot.sections),
            radius=float(np.linalg.norm(self.offset, axis=2).max()),
            step=lay.address_of(self.part('sweep').step),
            settle=lay.address_of(self.part('solve').settle),
            **at,
        )

    def scratch(self) -> Floats:
        """Return scratch memory for one thread."""
        lay, chain = self.part('layout'), self.chain
        return np.zeros(
            lay.work_size(chain.n, chain.k)
            + 2 * chain.n
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
                ]
            )
    return np.array(rows)


def tendon_offsets(robot: Robot) -> Floats:
    """
    Return the offset of every tendon in every cell, (n, k, 2) [m].

    Linear in arc length from the base to the end of the tendon's last cell, taken at mid-cell.
    """
    lengths = np.concatenate([[s.cell_length] * s.cells for s in robot.sections])
    ends = np.cumsum(lengths)
    offset = np.zeros((robot.cells, len(robot.tendons), 2))
    for k, tendon in enumerate(robot.tendons):
        cells = robot.tendon_cells[k]
        share = (ends - 0.5 * lengths)[:cells, None] / ends[cells - 1]
        base, end = np.array(tendon.base), np.array(tendon.end)
        offset[:cells, k] = base + share * (end - base)
    return offset
