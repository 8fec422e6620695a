"""Postures that hold one view angle: the paper's, and sweeps that look around."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError
from ..model.inverse import reach
from ..model.model import Model
from ..model.shape import Shape, ShapeBatch
from ..model.tip_task import COLD, TipTask
from ..paths.path import DIRECTION_TOLERANCE_RAD, POSITION_TOLERANCE_M

Array = NDArray[np.float64]
CELL_BEND_MAX_RAD = np.radians(20.0)  # [rad] beyond it stacked guides would touch (assumed)
S_BEND_MIN_RAD = np.radians(20.0)  # [rad] of the first section away from the view: seen as an S
SEARCH_STARTS = 200  # of a search, where the way from the last posture does not lead on
HALVINGS = 40  # of a range of tensions: to 1e-12 of it
POSTURE_STEP_N = 0.02  # [N] between the postures that a sweep chooses from: a millimetre or so


@dataclass(frozen=True)
class Posture:
    """A posture to go to."""

    name: str
    tensions: Array  # (m,) [N]
    position: Array  # (3,) [m] of the tip
    direction: Array  # (3,)

    @classmethod
    def of(cls, name: str, shape: Shape) -> Posture:
        """Name a shape."""
        return cls(name, shape.inputs, shape.tip_position, shape.tip_direction)


def salient(model: Model) -> list[Posture]:
    """
    Return the highest, the middle and the lowest tip at the 180° view, and an S at 45°.

    As in Kato et al. 2015, IV.B: one tendon of either section pulls and the others hold
    pretension, the lower limit; the tip's height is its z.
    """
    back = view(model, np.pi)
    order = np.argsort(back.tip_position[:, 2])
    chosen = [
        ('highest, 180° view', order[-1]),
        ('middle, 180° view', order[len(order) // 2]),
        ('lowest, 180° view', order[0]),
    ]
    postures = [Posture.of(name, model.shape(back.inputs[row])) for name, row in chosen]
    s_shaped = view(model, np.pi / 4)
    first = model.robot.sections[0].cells
    opposite = np.flatnonzero(s_shaped.bend[:, :first, 0].sum(axis=1) < -S_BEND_MIN_RAD)
    if len(opposite) == 0:
        raise InputError(f'{model.robot.name}: no S-shape at the 45° view within its limits')
    height = s_shaped.tip_position[opposite, 2]
    middle = opposite[np.argsort(height)[len(height) // 2]]
    return [*postures, Posture.of('S-shape, 45° view', model.shape(s_shaped.inputs[middle]))]


def view(model: Model, angle: float, step: float = 0.1) -> ShapeBatch:
    """
    Return the postures whose tip has turned by an angle [rad] in the x-z plane.

    The tension of the first section goes through both directions in steps [N]; for each, that
    of the second section is bisected until the view is exact.
    """
    low, high = model.limits[:, 0], model.limits[:, 1]
    prox_left, prox_right, dist_right = _planar_inputs(model)
    steps = np.arange(-high[prox_left], high[prox_right] + 0.5 * step, step)

    def inputs(dist: Array) -> Array:
        tensions = np.tile(low, (len(steps), 1))
        tensions[:, prox_left] = np.clip(-steps, low[prox_left], high[prox_left])
        tensions[:, prox_right] = np.clip(steps, low[prox_right], high[prox_right])
        tensions[:, dist_right] = dist
        return tensions

    below, above = np.full(len(steps), low[dist_right]), np.full(len(steps), high[dist_right])
    for _ in range(HALVINGS):
        middle = 0.5 * (below + above)
        under = model.shapes(inputs(middle)).bend[:, :, 0].sum(axis=1) < angle
        below, above = np.where(under, middle, below), np.where(under, above, middle)
    tensions = inputs(above)
    shapes = model.shapes(tensions)
    turned = shapes.bend[:, :, 0].sum(axis=1)
    good = (np.abs(turned - angle) < 1e-9) & (
        np.abs(shapes.bend).max(axis=(1, 2)) < CELL_BEND_MAX_RAD
    )
    if not good.any():
        raise InputError(
            f'{model.robot.name}: no posture at the {np.degrees(angle):.0f}° view '
            'within its limits'
        )
    return model.shapes(tensions[good])


def _planar_inputs(model: Model) -> tuple[int, int, int]:
    """Return the inputs of a planar two-section robot: prox left, prox right, dist right."""
    robot = model.robot
    sides = {}
    for index, members in enumerate(robot.input_tendons):
        tendon = robot.tendons[members[0]]
        sides[tendon.section, tendon.base[0] > 0.0] = index
    if len(robot.sections) != 2 or len(sides) != 4:
        raise InputError(f'{robot.name}: expected two sections with a tendon left and right each')
    first, second = (section.name for section in robot.sections)
    return sides[first, False], sides[first, True], sides[second, True]


def look_around(model: Model, angle: float, steps: int) -> list[Posture]:
    """
    Return postures, one after the other, that all look at an angle [rad] from the base axis.

    A robot of two sections in a plane keeps its direction and moves its tip through all postures
    of section IV.B of the paper, from the highest to the lowest. A spatial robot turns once around
    the axis of the base.

    Parameters
    ----------
    model : Model
    angle : float
        Between the approach direction and the axis of the base, 0 to pi [rad].
    steps : int
        How many postures, at least 2.

    Raises
    ------
    InputError
        The robot has no such postures within its limits.

    """
    if all(tendon.base[1] == 0.0 for tendon in model.robot.tendons):
        return _in_plane(model, angle, steps)
    return _around(model, angle, steps)


def _in_plane(model: Model, angle: float, steps: int) -> list[Posture]:
    workspace = view(model, angle, POSTURE_STEP_N)
    changes = np.abs(np.diff(workspace.inputs, axis=0)).max(axis=1)
    distinct = np.concatenate([[True], changes > 1e-6])
    inputs, places = workspace.inputs[distinct], workspace.tip_position[distinct]
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    if len(inputs) < 2:
        raise InputError(
            f'{model.robot.name}: only one posture at the {np.degrees(angle):.0f}° view'
        )
    chosen = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], steps) - 1e-12))
    return [Posture.of(str(i), model.shape(inputs[row])) for i, row in enumerate(chosen)]


def _around(model: Model, angle: float, steps: int) -> list[Posture]:
    straight = model.shape(model.limits[:, 0])  # from there, a gentle bend and no curl
    towards = np.array([np.sin(angle), 0.0, np.cos(angle)])
    policy = replace(COLD, starts=SEARCH_STARTS)
    first = reach(replace(TipTask.at(model, None, towards), guess=straight), policy)
    postures, shape = [], first.shape
    for i, turn in enumerate(np.linspace(0.0, 2.0 * np.pi, steps)):
        c, s = np.cos(turn), np.sin(turn)
        about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        place = about @ first.shape.tip_position
        task = TipTask.at(model, place, about @ towards)
        solution = reach(replace(task, guess=shape), policy)
        if (
            solution.position_error > POSITION_TOLERANCE_M
            or solution.direction_error > DIRECTION_TOLERANCE_RAD
        ):
            raise InputError(
                f'{model.robot.name}: the {np.degrees(angle):.0f}° view is out of reach when '
                f'turned by {np.degrees(turn):.0f}°: nearest {1e3 * solution.position_error:.1f} '
                f'mm, {np.degrees(solution.direction_error):.1f}°; ask for a smaller angle'
            )
        shape = solution.shape
        postures.append(Posture.of(str(i), shape))
    return postures
