"""What a robot may do that no effect of the catalogue describes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ..exceptions import EffectError
from ..robot import Robot

Floats = npt.NDArray[np.float64]
Values = dict[str, float]


@dataclass
class Damage:
    """What hidden causes do to a robot of n cells; cells count from 1 at the base."""

    robot: Robot
    stiffness: Floats  # (n,) [1] factor on the bending stiffness
    side_force: Floats  # (n, 3) [N] at mid-cell, base frame
    gain: float = 0.0  # [1] largest deviation of the tensions' gain
    rotation: float = 0.0  # [rad] largest rotation of the tracker
    waves: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def none(cls, robot: Robot, seed: int) -> Damage:
        """Start without any; the seed draws how gain and rotation vary from posture to posture."""
        n, m = robot.cells, len(robot.inputs)
        waves = np.random.default_rng([seed, 77]).normal(size=(4, m + 1))
        return cls(robot, np.ones(n), np.zeros((n, 3)), waves=waves)

    def deviations(self, inputs: Floats) -> Floats:
        """
        Return four numbers (b, 4) in [-1, 1] that vary with the inputs (b, m) as no law does.

        Inputs in units that bend the arm by half a radian; NaN (slack) counts as 0.
        """
        phase = np.nan_to_num(inputs) @ self.waves[:, 1:].T + 7.0 * self.waves[:, 0]
        return np.sin(phase)

    def cell(self, values: Values, fallback: int) -> int:
        """Return the index of the cell that the values name."""
        n = self.robot.cells
        number = values.get('cell', fallback)
        if number != int(number) or not 1 <= number <= n:
            raise EffectError(f'cell: expected a whole number from 1 (base) to {n}, got {number}')
        return int(number) - 1


def soft_cell(damage: Damage, values: Values) -> None:
    """One cell is softer: its stiffness times `factor`."""
    cell = damage.cell(values, (2 * damage.robot.cells + 2) // 3)
    damage.stiffness[cell] *= values.get('factor', 0.6)


def tether(damage: Damage, values: Values) -> None:
    """Let a cable pull at one cell: a constant force [N] in the base frame."""
    robot = damage.robot
    cell = damage.cell(values, (2 * robot.cells + 2) // 3)
    stiffness = np.mean([k for section in robot.sections for k in section.bending_stiffness])
    usual = {'force_x': 0.5 * float(stiffness) / (robot.cells * robot.length)}
    given = {key: value for key, value in values.items() if key != 'cell'} or usual
    damage.side_force[cell] += [given.get(f'force_{axis}', 0.0) for axis in 'xyz']


def stiffness_gradient(damage: Damage, values: Values) -> None:
    """Change the stiffness linearly from the base to `relative_change` more at the tip."""
    along = np.linspace(-0.5, 0.5, damage.robot.cells)
    damage.stiffness *= 1.0 + values.get('relative_change', 0.4) * along


def posture_gain(damage: Damage, values: Values) -> None:
    """Let every posture have its own gain of the tensions, at most `size` off."""
    damage.gain = values.get('size', 0.1)


def posture_rotation(damage: Damage, values: Values) -> None:
    """Let the tracker's frame turn from posture to posture, at most `size` [rad] about an axis."""
    damage.rotation = values.get('size', 0.03)


@dataclass(frozen=True)
class Cause:
    """A cause outside the catalogue and its parameters with their units."""

    parameters: dict[str, str]
    act: Callable[[Damage, Values], None]


FORCES = {'force_x': 'N', 'force_y': 'N', 'force_z': 'N'}
CAUSES = {
    'soft_cell': Cause({'cell': '1', 'factor': '1'}, soft_cell),
    'tether': Cause({'cell': '1', **FORCES}, tether),
    'stiffness_gradient': Cause({'relative_change': '1'}, stiffness_gradient),
    'posture_gain': Cause({'size': '1'}, posture_gain),
    'posture_rotation': Cause({'size': 'rad'}, posture_rotation),
}
