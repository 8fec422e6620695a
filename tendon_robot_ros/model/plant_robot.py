"""The description of a plant: the owner's robot with finer cells, each a section of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..effects import BUILT_IN
from ..robot import EffectValues, Robot, Section

Floats = npt.NDArray[np.float64]
# effect -> parameter -> power of the number of finer cells per cell that it scales with
PER_CELL = {
    'tendon_stiffness': {'per_tendon': 1},
    'nonlinear_stiffness': {'cubic': 2},
    'pre_curvature': {'angle_x': -1, 'angle_y': -1},
}
WHOLE_CELLS = ('straight_tendon', 'friction_memory')


def parts_per_cell(robot: Robot, effects: dict[str, EffectValues], refine: int) -> int:
    """Return `refine` where cells may be divided, else 1."""
    scales = all(name in BUILT_IN and name not in WHOLE_CELLS for name in effects)
    return refine if scales and all(s.bends_as == 'arc' for s in robot.sections) else 1


def real_robot(
    robot: Robot,
    effects: dict[str, EffectValues],
    parts: int,
    stiffness: Floats,
    side_force: Floats,
    exponential: bool,
) -> Robot:
    """
    Describe the plant.

    Parameters
    ----------
    robot : Robot
        The owner's, n cells.
    effects : dict
        The owner's and the hidden ones, as for the owner's cells.
    parts : int
        Finer cells per cell.
    stiffness : (n,) [1]
        Factor on the bending stiffness of each of the owner's cells.
    side_force : (n, 3) [N]
    exponential : bool
        Friction follows the capstan's exponential.

    """
    n = robot.cells
    wraps = np.zeros((n, parts))
    wraps[:, -1] = parts  # the eyelet turns the tendon as the whole cell does
    friction: EffectValues = {'wraps': tuple(wraps.ravel()), 'exponential': float(exponential)}
    made = {name: _scaled(name, values, robot, parts) for name, values in effects.items()}
    made['tendon_friction'] = {**made.get('tendon_friction', {}), **friction}
    if side_force.any():
        forces = np.zeros((n, parts, 3))
        forces[:, parts // 2] = side_force
        made['side_force'] = {
            f'side_{axis}': tuple(forces[..., i].ravel()) for i, axis in enumerate('xyz')
        }
    sections = _sections(robot, parts, stiffness)
    ends = {s.name: f'{s.name} {s.cells * parts}' for s in robot.sections}
    tendons = tuple(replace(tendon, section=ends[tendon.section]) for tendon in robot.tendons)
    return replace(robot, sections=sections, tendons=tendons, effects=made, fitted={})


def _sections(robot: Robot, parts: int, stiffness: Floats) -> tuple[Section, ...]:
    made, factors = [], iter(stiffness)
    for section in robot.sections:
        for i in range(section.cells):
            one = section.bending_stiffness[i] * parts * float(next(factors))
            made += [
                Section(
                    f'{section.name} {i * parts + part + 1}',
                    1,
                    section.cell_length / parts,
                    (one,),
                    (section.mass_profile[i],),
                    section.bends_as,
                )
                for part in range(parts)
            ]
    return tuple(made)


def _scaled(name: str, values: EffectValues, robot: Robot, parts: int) -> EffectValues:
    """Scale what counts per cell; repeat what counts per section for every cell of it."""
    cells = [s.cells * parts for s in robot.sections]
    made: EffectValues = {}
    for key, value in values.items():
        factor = float(parts) ** PER_CELL.get(name, {}).get(key, 0)
        made[key] = (
            tuple(np.repeat(value, cells) * factor) if isinstance(value, tuple) else value * factor
        )
    return made
