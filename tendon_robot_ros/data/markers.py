"""Tracked points of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..common.errors import DataSetError
from ..common.given import refusal
from ..robot import Robot
from .dataframes import FrameArrays

MARKERS_EXPECTED = 'the arc length [m] of each, or a Marker'
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Marker:
    """A tracked point of the arm."""

    name: str
    arc_length: float  # [m] from the base along the straight backbone
    offset: Vector = (0.0, 0.0, 0.0)  # [m] in the frame at that arc length


def default_markers(robot: Robot) -> tuple[Marker, ...]:
    """Return one marker per cell, named '1' to 'n', at the cell's distal end."""
    lengths = np.repeat([s.cell_length for s in robot.sections], [s.cells for s in robot.sections])
    ends = np.cumsum(lengths).round(12).tolist()  # 0.108, not 0.10800000000000003
    return tuple(Marker(str(i + 1), end) for i, end in enumerate(ends))


def even_markers(robot: Robot, count: int) -> tuple[Marker, ...]:
    """Return so many markers, named '1' to 'n', evenly spaced up to the tip."""
    places = robot.length * (np.arange(count) + 1.0) / count
    return tuple(Marker(str(i + 1), float(place)) for i, place in enumerate(places))


def place_markers(
    arrays: FrameArrays, robot: Robot, given: Sequence[Marker | float] | None, name: str
) -> tuple[Marker, ...]:
    """
    Return the markers: as given, else by their column of arc lengths, else one per cell.

    Raises
    ------
    DataSetError
        There are places for more or fewer markers.

    """
    if given is None and arrays.arc_lengths is not None:
        given = arrays.arc_lengths.tolist()
    if given is None and len(arrays.markers) == robot.cells:
        return default_markers(robot)
    if given is not None and not isinstance(given, Sequence | np.ndarray):
        raise refusal(f'{name}: markers', MARKERS_EXPECTED, given)
    if given is None or len(given) != len(arrays.markers):
        known = 'none' if given is None else f'{len(given)}'
        raise DataSetError(
            f'{name}: markers',
            f'there are {len(arrays.markers)}, {known} with a place',
            'give the arc length [m] of each, from the base along the arm',
        )
    return markers_of(given, arrays.markers, name)


def markers_of(
    given: Sequence[Marker | float], labels: Sequence[str], name: str
) -> tuple[Marker, ...]:
    """Return markers that are given as such or by their arc lengths [m]."""
    try:
        return tuple(
            one if isinstance(one, Marker) else Marker(label, float(one))
            for label, one in zip(labels, given, strict=True)
        )
    except (TypeError, ValueError):
        raise refusal(f'{name}: markers', MARKERS_EXPECTED, given) from None
