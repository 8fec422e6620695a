"""Which marker is where on the arm: their order, and their arc lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..common.errors import DataSetError
from ..common.words import listed, mm
from ..data import DataSet, default_markers
from ..robot import Robot
from .columns import FloatArray

AS_GIVEN = 'places as given'
SAME_PLACE_M = 1e-3  # [m] markers that are never farther apart are one that was exported twice
BELOW_BASE_CELLS = 0.5  # cells that a marker may seem to be below the base and still be on the arm
END_WITHIN_SHARE = 0.3  # of a cell's length: that near to the ends of cells, markers are at them
EVEN_WITHIN_SHARE = 0.06  # of the spacing: that near to even spacing, markers are evenly spaced
LONGER_SHARE = 0.05  # of the arm, by which a chord is longer than its arc: not these markers
SPAN_WITHIN_SHARE = 0.1  # of the given span, by which chords of a bent arm may miss it
STRAIGHT_SHARE = 0.995  # of the longest chord: a posture with such a chord is as straight as any
ROUND_M = 1e-4  # [m] of arc lengths that were measured: what a ruler tells


@dataclass(frozen=True)
class MarkerOrder:
    """Markers from base to tip: indices into what was measured, and where on the arm they are."""

    members: tuple[int, ...]
    arc_lengths: tuple[float, ...]  # [m]
    reason: str
    off_arm: tuple[int, ...] = ()  # fixed beside the base, say
    twice: tuple[int, ...] = ()
    unseen: tuple[int, ...] = ()  # in no still segment


def order_markers(
    positions: FloatArray, robot: Robot, given: Sequence[float | None] = (), name: str = 'markers'
) -> MarkerOrder:
    """
    Order markers by their place along the arm where it is straightest.

    Parameters
    ----------
    positions : (N, J, 3) [m]
        Of the markers in still segments, in any frame; NaN = not seen.
    robot : Robot
        Gives the length of the arm and its cells.
    given : sequence of float, optional
        Arc lengths [m] from base to tip that somebody measured; else the last marker is taken to
        be at the tip, and the others as far below as they are when the arm is straight.
    name : str
        Of the table, for messages.

    Raises
    ------
    DataSetError
        The markers do not fit on the arm, or their count is another one.

    """
    unseen = tuple(np.flatnonzero(~np.isfinite(positions).any(axis=(0, 2))).tolist())
    seen = [j for j in range(positions.shape[1]) if j not in unseen]
    apart = np.full((positions.shape[1],) * 2, -1.0)
    apart[np.ix_(seen, seen)] = _distances(positions[:, seen])
    twice = tuple(j for j in seen if any(0.0 <= apart[i, j] < SAME_PLACE_M for i in seen if i < j))
    members = [j for j in seen if j not in twice]
    known = tuple(value for value in given if value is not None)
    if len(members) == 1:
        if len(seen) > 2:  # two may be one, exported twice
            raise _no_arm(name, float(apart.max()), robot)
        if len(known) > 1:
            raise DataSetError(
                name, f'has one marker, but {len(known)} places are given', 'give one of them'
            )
        only = known or (robot.length,)
        return MarkerOrder((members[0],), only, 'the only marker', (), twice, unseen)
    inner = apart[np.ix_(members, members)]
    if (inner < 0.0).any():
        raise DataSetError(
            name,
            'some markers are never seen together while the arm stands still: nothing tells their '
            'order',
            'say each place in an import.yaml (arc_length of markers)',
        )
    # the ends are farthest apart, and of these the tip moves
    ends = [members[i] for i in np.unravel_index(int(inner.argmax()), inner.shape)]
    base = min(ends, key=lambda j: float(np.nanstd(positions[:, j], axis=0).sum()))
    members.sort(key=lambda j: float(apart[base, j]))
    below_tip = robot.length - _lengths_to_tip(positions[:, members], apart, members)
    cell = min(section.cell_length for section in robot.sections)
    if given:
        off = members[: max(len(members) - len(known), 0)]
        if len(known) > len(members) or any(below_tip[: len(off)] > cell):
            raise DataSetError(
                name,
                f'has {len(members)} markers, but {len(known)} places on the arm are given',
                'give one arc length for each, from base to tip',
            )
        kept = tuple(members[len(off) :])
        far, span = apart[kept[0], kept[-1]], known[-1] - known[0]
        if abs(far - span) > max(cell, SPAN_WITHIN_SHARE * span):
            raise DataSetError(
                name,
                f'the first and the last marker are {1e3 * far:.4g} mm apart where the arm is '
                f'straightest, but {1e3 * span:.4g} mm by the places that are given',
                'give the distance of every marker from the base along the arm, in mm',
            )
        return MarkerOrder(kept, known, AS_GIVEN, tuple(off), twice, unseen)
    on_arm = below_tip > -BELOW_BASE_CELLS * cell
    kept = tuple(j for j, one in zip(members, on_arm, strict=True) if one)
    if len(kept) < 2:
        raise _no_arm(name, float(apart[base, members[-1]]), robot)
    places, reason = _snapped(below_tip[on_arm], robot)
    off = [j for j in members if j not in kept]
    return MarkerOrder(kept, places, reason, tuple(off), twice, unseen)


def _no_arm(name: str, far: float, robot: Robot) -> DataSetError:
    """Return the error of markers that cannot be those of the arm: up to `far` [m] apart."""
    return DataSetError(
        name,
        f'markers are up to {1e3 * far:.4g} mm apart, the arm is {1e3 * robot.length:.4g} mm long',
        'check the unit (--unit positions=...), and cells and cell_length of the robot',
    )


def places_contradicted(dataset: DataSet) -> list[str]:
    """
    Say that two markers are farther apart than the arm between them is long.

    Places that an import.yaml of another recording gives are those of other markers then.
    """
    positions, arc_lengths = dataset.mean, dataset.arc_lengths
    with np.errstate(invalid='ignore'):
        chords = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    apart = np.where(np.isfinite(chords), chords, 0.0).max(axis=0)
    beside = np.linalg.norm(dataset.offsets, axis=1)
    between = np.abs(arc_lengths[:, None] - arc_lengths) + beside[:, None] + beside
    over = apart - between
    i, j = sorted(np.unravel_index(int(over.argmax()), over.shape))
    robot = dataset.robot
    if over[i, j] < max(LONGER_SHARE * robot.length, robot.sections[-1].cell_length):
        return []
    first, second = (dataset.markers[k].name for k in (i, j))
    return [
        f'markers {first} and {second} are up to {mm(float(apart[i, j]))} apart, with '
        f'{mm(float(between[i, j]))} of the arm between them: they sit in another order, or '
        'elsewhere (take markers out of import.yaml to have them ordered, or say --markers)'
    ]


def _distances(positions: FloatArray) -> FloatArray:
    """
    Return the distance (J, J) [m] of markers where the arm is straightest.

    The chord between two markers is longest, and as long as the arm between them, where the arm
    is straight; this needs neither a frame nor a model.
    """
    with np.errstate(invalid='ignore'):
        chords = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    seen = np.isfinite(chords)
    longest: FloatArray = np.where(seen, chords, -1.0).max(axis=0)
    whole = np.where(seen.all(axis=(1, 2)), np.nan_to_num(chords).max(axis=(1, 2)), -1.0)
    best = int(whole.argmax())
    if whole[best] >= STRAIGHT_SHARE * longest.max():  # instead of the luckiest of many
        straightest: FloatArray = chords[best]
        return straightest
    return longest


def _lengths_to_tip(
    positions: FloatArray, apart: FloatArray, members: Sequence[int]
) -> FloatArray:
    """
    Return how much of the arm lies between each marker and the last one, (J,) [m].

    The chord between neighbours is lengthened to the arc that the turns of the chain beside it
    tell, and averaged over all postures: a longest chord would collect noise, and no arm with a
    load is ever straight.
    """
    steps = np.diff(positions, axis=1)  # (N, J - 1, 3)
    chords = np.linalg.norm(steps, axis=2)
    with np.errstate(invalid='ignore', divide='ignore'):
        along = steps / chords[..., None]
        turns = np.arccos(np.clip((along[:, 1:] * along[:, :-1]).sum(axis=2), -1.0, 1.0))
    turns = np.nan_to_num(turns)
    beside = np.concatenate([turns[:, :1], turns, turns[:, -1:]], axis=1)
    half = 0.25 * (beside[:, 1:] + beside[:, :-1]) if turns.shape[1] else np.zeros(chords.shape)
    arcs = chords / np.sinc(half / np.pi)
    seen = np.isfinite(arcs)
    total = np.where(seen, arcs, 0.0).sum(axis=0)
    longest = [apart[a, b] for a, b in pairwise(members)]
    lengths = np.where(seen.any(axis=0), total / np.maximum(seen.sum(axis=0), 1), longest)
    return np.append(np.cumsum(lengths[::-1])[::-1], 0.0)


def _snapped(measured: FloatArray, robot: Robot) -> tuple[tuple[float, ...], str]:
    """Return arc lengths at the ends of cells where all markers are near them."""
    ends = np.array([marker.arc_length for marker in default_markers(robot)])
    lengths = np.diff(ends, prepend=0.0)
    nearest = np.abs(measured[:, None] - ends).argmin(axis=1)
    near = np.abs(measured - ends[nearest]) < END_WITHIN_SHARE * lengths[nearest]
    if near.all() and len(set(nearest.tolist())) == len(measured):
        where = 'the ends of its cells'
        if len(measured) < len(ends):
            where = f'the ends of cells {listed(str(i + 1 - robot.plate_cells) for i in nearest)}'
        return tuple(ends[nearest].tolist()), f'the last marker is at the tip, all at {where}'
    even = robot.length * (np.arange(len(measured)) + 1.0) / len(measured)
    if np.abs(measured - even).max() < EVEN_WITHIN_SHARE * even[0]:
        return tuple(even.round(9).tolist()), 'the last marker is at the tip, all evenly spaced'
    places = np.clip(np.round(measured / ROUND_M) * ROUND_M, 0.0, robot.length).round(9)
    return (
        tuple(places.tolist()),
        'the last marker is at the tip, the others as far below as the arm between them is long',
    )
