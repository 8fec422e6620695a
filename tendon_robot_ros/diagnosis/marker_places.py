"""Where markers may sit on an arm of another length; those that cannot sit where they should."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ..data import DataSet
from ..robot import Robot

Floats = npt.NDArray[np.float64]
SAME_PLACE_SHARE = 1e-6  # of the arm's length, within which two markers are in one place
APART_FROM_FLOORS = 5.0  # noise floors that markers in one place are not apart
APART_FROM_SHARE = 0.2  # nor of a cell's length


def along(dataset: DataSet, robot: Robot, longer: Robot) -> Iterator[tuple[str, list[float]]]:
    """Yield where markers (J,) [m] may be on an arm of another length: as counted from where."""
    places, more = uncut(dataset, robot), longer.length - robot.length
    yield 'stay', np.clip(places, 0.0, longer.length).tolist()
    share = longer.length / robot.length
    yield 'go along', np.clip(places * share, 0.0, longer.length).tolist()
    from_tip = places + more
    if from_tip.min() > -1e-9 * robot.length:
        yield 'as far from the tip', np.clip(from_tip, 0.0, longer.length).tolist()


def uncut(dataset: DataSet, robot: Robot) -> Floats:
    """
    Return where markers (J,) [m] would be on an arm that does not end.

    Of an arm described too short those beyond its ends are all put at the end. They go on as far
    apart as the others mostly are.
    """
    places, length = dataset.arc_lengths, robot.length
    apart, least = np.diff(places), SAME_PLACE_SHARE * length
    if not (apart > least).any() or not (apart >= 0.0).all():
        return places
    usual, going_on = float(np.median(apart[apart > least])), places.copy()
    at_tip, at_base = np.flatnonzero(places > length - least), np.flatnonzero(places < least)
    going_on[at_tip] += usual * np.arange(len(at_tip))
    going_on[at_base] -= usual * np.arange(len(at_base))[::-1]
    return going_on


def in_one_place(dataset: DataSet, robot: Robot, floor: float) -> tuple[list[int], float]:
    """
    Return the markers that are described in one place and are not, and how far apart [m].

    As they are where their places were cut at the end of an arm that is longer than described.
    """
    near = np.abs(np.subtract.outer(dataset.arc_lengths, dataset.arc_lengths))
    beside = np.linalg.norm(dataset.offsets[:, None] - dataset.offsets, axis=2)
    same = np.triu(near + beside < SAME_PLACE_SHARE * robot.length, 1)
    least = max(APART_FROM_FLOORS * floor, APART_FROM_SHARE * robot.sections[-1].cell_length)
    group: set[int] = set()
    far = 0.0
    for i, j in zip(*np.nonzero(same), strict=True):
        chords = np.linalg.norm(dataset.mean[:, i] - dataset.mean[:, j], axis=1)
        chords = chords[np.isfinite(chords)]
        if len(chords) and np.median(chords) > least:
            group |= {int(i), int(j)}
            far = max(far, float(np.median(chords)))
    return sorted(group), far
