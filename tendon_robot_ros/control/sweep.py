"""Sweeps that hold the view angle while the tip moves: looking around, as in Kato et al. 2015."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError
from ..model.model import Model
from ..model.shape import Shape
from .path_plan import ALIKE, NEAR
from .postures import Posture, view

Array = NDArray[np.float64]
FINE = 0.02  # [N] between the postures from which those of a sweep are chosen


def sweep(model: Model, angle: float, steps: int) -> list[Posture]:
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
    found = view(model, angle, FINE)
    changes = np.abs(np.diff(found.inputs, axis=0)).max(axis=1)
    distinct = np.concatenate([[True], changes > 1e-6])
    inputs, places = found.inputs[distinct], found.tip_position[distinct]
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    if len(inputs) < 2:
        raise InputError(
            f'{model.robot.name}: only one posture at the {np.degrees(angle):.0f}° view'
        )
    chosen = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], steps) - 1e-12))
    shapes = [model.shape(inputs[i]) for i in chosen]
    return [_posture(i, shape) for i, shape in enumerate(shapes)]


def _around(model: Model, angle: float, steps: int) -> list[Posture]:
    first = model.reach(direction=[np.sin(angle), 0.0, np.cos(angle)])
    postures, shape = [], first.shape
    for i, turn in enumerate(np.linspace(0.0, 2.0 * np.pi, steps)):
        c, s = np.cos(turn), np.sin(turn)
        about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        place = about @ first.shape.tip_position
        along = about @ np.array([np.sin(angle), 0.0, np.cos(angle)])
        solution = model.reach(place, along, guess=shape, relax=True)
        if solution.position_error > NEAR or solution.direction_error > ALIKE:
            raise InputError(
                f'{model.robot.name}: the {np.degrees(angle):.0f}° view is out of reach when '
                f'turned by {np.degrees(turn):.0f}°: nearest {1e3 * solution.position_error:.1f} '
                f'mm, {np.degrees(solution.direction_error):.1f}°; ask for a smaller angle'
            )
        shape = solution.shape
        postures.append(_posture(i, shape))
    return postures


def _posture(index: int, shape: Shape) -> Posture:
    return Posture(str(index), shape.inputs, shape.tip_position, shape.tip_direction)
