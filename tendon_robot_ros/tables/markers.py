"""
The columns that are markers of the arm, and the arc length of each marker.

Markers are named triples of columns, centres of rims, or bodies.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError
from ..common.rotations import angle_between
from ..common.words import grouped, listed, listing, mm
from ..data import DataSet, default_markers
from ..inference.statistics import mean_over
from ..robot import Robot
from ..robot.estimates import TRACKER_NOISE_M
from .columns import BODY, BODY_MARKER, DERIVED, MARKER, RawTable, Triple, marker_label, triples_of

CHOICES = ('markers', 'rims', 'bodies')
# [1] of a length, by which measured distances on the arm and on a rim may be off, because a ruler,
# noise and a bent arm are no more exact
DISTANCE_TOLERANCE = 0.05
NAMELESS = {'unlabeled', 'unlabelled', 'unidentified', 'ghost'}


@dataclass(frozen=True)
class Points:
    """
    The selected points.

    Attributes
    ----------
    columns : tuple of tuple of str
        Of each point x, y, z; of three or more markers on a rim all of theirs.
    note : str
        What they are, and the alternatives; '' if there is none.
    aside : tuple of str
        Triples that are not used, by quantity.
    nameless : tuple of tuple of str
        Those without a name: a named marker that was lost may continue in one of them.

    """

    columns: tuple[tuple[str, ...], ...] = ()
    note: str = ''
    aside: tuple[str, ...] = ()
    nameless: tuple[tuple[str, str, str], ...] = ()


def choose_points(tables: Sequence[RawTable], choice: str | None) -> Points:
    """
    Choose the points of the arm among all triples of columns.

    Labelled markers go before bodies, but where bodies are more. Markers that are fixed to each
    other around a circle are the rim of a disk, and give its centre.

    Raises
    ------
    DataSetError
        No triple is a position, or none is of the requested kind.

    """
    triples = {t.columns: t for table in tables for t in triples_of(table)}
    places = [t for t in triples.values() if not t.quantity and t.kind != DERIVED]
    others = [t for t in triples.values() if t.quantity or t.kind == DERIVED]
    if not places:
        unfit = f': {listed(_by_quantity(others))} are no measured places' if others else ''
        problem = f'no columns of a marker are recognised{unfit}'
        remedy = 'name them alike but for the axis, such as tip_x, tip_y, tip_z'
        raise DataSetError(tables[0].name, problem, remedy)
    nameless = [t for t in places if t.columns[0].startswith('*') or NAMELESS & set(t.name)]
    named = [t for t in places if t not in nameless]
    # where none has a name, those that were seen for most of the time
    named = named or [t for t in places if np.isfinite(t.places()).all(axis=1).mean() >= 0.5]
    named = named or places
    unnamed = [t for t in places if t not in named]
    groups = {kind: [t for t in named if t.kind == kind] for kind in (MARKER, BODY_MARKER, BODY)}
    markers = groups[MARKER] or groups[BODY_MARKER]
    rims = _rims(markers)
    around = {t.columns for rim in rims for t in rim}
    rings = [tuple(c for t in rim for c in t.columns) for rim in rims]
    options: dict[str, list[tuple[str, ...]]] = {
        'markers': [t.columns for t in markers],
        'rims': [*rings, *(t.columns for t in markers if t.columns not in around)] if rims else [],
        'bodies': [t.columns for t in groups[BODY]],
    }
    mode = choice or ('rims' if rims else 'markers')
    if choice is None and len(options['bodies']) > len(options[mode]):
        mode = 'bodies'
    columns = options.pop(mode)
    others_known = [name for name in CHOICES if options.get(name)]
    if not columns:
        remedy = f'use one of {listing(others_known)}'
        raise DataSetError(tables[0].name, f'holds no {mode} (--points {mode})', remedy)
    used = {column for point in columns for column in point}
    unused = [t for t in named if t.columns[0] not in used]
    note = {
        'markers': 'the markers are taken, each by itself',
        'bodies': 'the origins of bodies are taken',
        'rims': 'markers that are fixed to each other around a circle are the rim of a disk and '
        f'give its centre: {listing(marker_label(c) for c in columns if len(c) > 3)}',
    }[mode] + f' (otherwise say --points {" or ".join(others_known)})'
    return Points(
        columns=tuple(columns),
        note=note if others_known else '',
        aside=(*_by_quantity(unused), *_by_quantity(others)),
        nameless=tuple(t.columns for t in unnamed),
    )


def _by_quantity(triples: Iterable[Triple]) -> list[str]:
    """Name triples that are not used by their quantity: 'rotations (tag 1 rvec and 3 more)'."""
    return [
        f'{what} ({marker_label(own[0].columns)}{f" and {len(own) - 1} more" if own[1:] else ""})'
        for what, own in grouped(triples, lambda one: one.quantity or one.kind).items()
    ]


def _rims(markers: Sequence[Triple]) -> list[list[Triple]]:
    """Return the markers that form a rim: of one body or prefix, at fixed places on a circle."""
    bodies = grouped(
        markers, lambda one: one.columns[0].rpartition(':')[0] or ' '.join(one.name[:-1])
    )
    return [
        group
        for group in bodies.values()
        if len(group) >= 3 and _is_rim(np.stack([t.places() for t in group], axis=1))
    ]


def _is_rim(places: Floats) -> bool:
    """Return whether markers (T, K, 3) keep their distances and lie on a circle."""
    visible = places[np.isfinite(places).all(axis=(1, 2))]
    if not len(visible):
        return False
    i, j = np.triu_indices(visible.shape[1], 1)
    apart = np.linalg.norm(visible[:, i] - visible[:, j], axis=2)
    usual = np.median(apart, axis=0)
    spread = np.percentile(apart, 90, axis=0) - np.percentile(apart, 10, axis=0)
    if not (spread <= DISTANCE_TOLERANCE * usual.max()).all():
        return False
    one = visible[np.argmin(np.abs(apart - usual).max(axis=1))][None]
    radii = np.linalg.norm(one[0] - circle_centres(one), axis=1)
    return bool(
        np.ptp(radii) <= 2.0 * DISTANCE_TOLERANCE * radii.mean()
        and 0.5 * usual.max() <= radii.mean() <= usual.max()  # of a third of the circle or more
    )


def circle_centres(points: Floats) -> Floats:
    """
    Return the centres (T, 3) of the circles through points (T, K, 3); of one point itself.

    The circle lies in the plane that fits best and has the least sum of squares of
    |p - c|² - r² (Kåsa 1976), exact for three points. NaN where a point is missing.
    """
    if points.shape[1] == 1:
        return points[:, 0]
    centres = np.full((len(points), 3), np.nan)
    complete = np.isfinite(points).all(axis=(1, 2))
    middle = points[complete].mean(axis=1, keepdims=True)
    _, _, axes = np.linalg.svd(points[complete] - middle, full_matrices=False)
    plane = axes[:, :2]  # (T, 2, 3)
    flat = (points[complete] - middle) @ plane.transpose(0, 2, 1)  # (T, K, 2)
    system = np.concatenate([2.0 * flat, np.ones((*flat.shape[:2], 1))], axis=2)
    solution = np.linalg.pinv(system) @ (flat**2).sum(axis=2)[..., None]
    centres[complete] = middle[:, 0] + (solution[:, :2].transpose(0, 2, 1) @ plane)[:, 0]
    return centres


AS_GIVEN = 'places as given'
# [1] of a cell's length, by which markers at the ends of cells may miss them, because it is less
# than half of the distance to the next one
END_TOLERANCE = 0.3


@dataclass(frozen=True)
class MarkerOrder:
    """Markers from base to tip: their indices in the table, and where on the arm they are."""

    members: tuple[int, ...]
    arc_lengths: tuple[float, ...]  # [m]
    reason: str
    off_arm: tuple[int, ...] = ()  # for example fixed beside the base
    twice: tuple[int, ...] = ()
    unseen: tuple[int, ...] = ()  # in no still segment


def order_markers(
    positions: Floats, robot: Robot, given: Sequence[float] = (), name: str = 'markers'
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
        The markers do not fit on the arm, or their number differs from that of `given`.

    """
    unseen = tuple(np.flatnonzero(~np.isfinite(positions).any(axis=(0, 2))).tolist())
    visible = [j for j in range(positions.shape[1]) if j not in unseen]
    apart = np.full((positions.shape[1],) * 2, -1.0)
    apart[np.ix_(visible, visible)] = _distances(positions[:, visible])
    same = 2.0 * TRACKER_NOISE_M  # [m] never farther apart: one marker that was exported twice
    twice = tuple(j for j in visible if any(0.0 <= apart[i, j] < same for i in visible if i < j))
    members = [j for j in visible if j not in twice]
    if len(members) == 1:
        if len(visible) > 2:  # two may be one, exported twice
            raise _no_arm(name, float(apart.max()), robot)
        if len(given) > 1:
            problem = f'has one marker, but {len(given)} places are given'
            raise DataSetError(name, problem, 'give one of them')
        place = given[0] if given else robot.length
        return MarkerOrder((members[0],), (place,), 'the only marker', (), twice, unseen)
    inner = apart[np.ix_(members, members)]
    if (inner < 0.0).any():
        alone = 'some markers are never seen together while the arm stands still'
        remedy = 'say each place in an import.yaml (arc_length of markers)'
        raise DataSetError(name, f'{alone}: nothing tells their order', remedy)
    # the ends are farthest apart, and of these the tip moves
    ends = [members[i] for i in np.unravel_index(int(inner.argmax()), inner.shape)]
    base = min(ends, key=lambda j: float(np.nanstd(positions[:, j], axis=0).sum()))
    members.sort(key=lambda j: float(apart[base, j]))
    below_tip = robot.length - _lengths_to_tip(positions[:, members], apart, members)
    cell = min(section.cell_length for section in robot.sections)
    if given:
        off = members[: max(len(members) - len(given), 0)]
        if len(given) > len(members) or any(below_tip[: len(off)] > cell):
            problem = f'has {len(members)} markers, but {len(given)} places on the arm are given'
            raise DataSetError(name, problem, 'give one arc length for each, from base to tip')
        kept = tuple(members[len(off) :])
        far, span = apart[kept[0], kept[-1]], given[-1] - given[0]
        if abs(far - span) > max(cell, 2.0 * DISTANCE_TOLERANCE * span):
            seen = f'{1e3 * far:.4g} mm apart where the arm is straightest'
            told = f'{1e3 * span:.4g} mm by the places that are given'
            problem = f'the first and the last marker are {seen}, but {told}'
            remedy = 'give the distance of every marker from the base along the arm, in mm'
            raise DataSetError(name, problem, remedy)
        return MarkerOrder(kept, tuple(given), AS_GIVEN, tuple(off), twice, unseen)
    on_arm = below_tip > -0.5 * cell
    kept = tuple(j for j, one in zip(members, on_arm, strict=True) if one)
    if len(kept) < 2:
        raise _no_arm(name, float(apart[base, members[-1]]), robot)
    places, reason = _snapped(below_tip[on_arm], robot)
    off = [j for j in members if j not in kept]
    return MarkerOrder(kept, places, reason, tuple(off), twice, unseen)


def _no_arm(name: str, far: float, robot: Robot) -> DataSetError:
    """Return the error of markers that cannot be those of the arm: up to `far` [m] apart."""
    long = f'the arm is {1e3 * robot.length:.4g} mm long'
    remedy = 'check the unit (--unit positions=...), and cells and cell_length of the robot'
    return DataSetError(name, f'markers are up to {1e3 * far:.4g} mm apart, {long}', remedy)


def place_warnings(dataset: DataSet) -> list[str]:
    """
    Return contradictions between how markers move and where on the arm they are taken to be.

    Places that an import.yaml of another recording gives are those of other markers then.
    """
    robot, lines = dataset.robot, []
    positions, arc_lengths = dataset.mean, dataset.arc_lengths
    chords = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    apart = np.where(np.isfinite(chords), chords, 0.0).max(axis=0)
    beside = np.linalg.norm(dataset.offsets, axis=1)
    between = np.abs(arc_lengths[:, None] - arc_lengths) + beside[:, None] + beside
    over = apart - between
    i, j = sorted(np.unravel_index(int(over.argmax()), over.shape))
    if over[i, j] >= max(DISTANCE_TOLERANCE * robot.length, robot.sections[-1].cell_length):
        first, second = (dataset.markers[k].name for k in (i, j))
        lines.append(
            f'markers {first} and {second} are up to {mm(float(apart[i, j]))} apart, with '
            f'{mm(float(between[i, j]))} of the arm between them: they sit in another order, or '
            'elsewhere (take markers out of import.yaml to have them ordered, or say --markers)'
        )
    if arc_lengths[0] > 0.5 * robot.sections[0].cell_length:
        return lines
    off = np.linalg.norm(positions[:, 0] - np.nanmedian(positions[:, 0], axis=0), axis=1)
    if (moved := float(np.nanmax(off))) > 4.0 * TRACKER_NOISE_M:
        lines.append(
            f'marker {dataset.markers[0].name} moves by {mm(moved)}, and would sit at the base: '
            f'is the arm longer than its {mm(robot.length)}? Check cells and cell_length of the '
            'robot, or say where markers sit (--markers)'
        )
    return lines


def _distances(positions: Floats) -> Floats:
    """
    Return the distance (J, J) [m] of markers where the arm is straightest.

    The chord between two markers is longest, and as long as the arm between them, where the arm
    is straight; this needs neither a frame nor a model.
    """
    chords = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
    known = np.isfinite(chords)
    longest = np.where(known, chords, -1.0).max(axis=0)
    whole = np.where(known.all(axis=(1, 2)), np.nan_to_num(chords).max(axis=(1, 2)), -1.0)
    best = int(whole.argmax())  # preferred, because maxima over many postures collect noise
    is_straightest = whole[best] >= longest.max() - 2.0 * TRACKER_NOISE_M
    return np.asarray(chords[best] if is_straightest else longest)


def _lengths_to_tip(positions: Floats, apart: Floats, members: Sequence[int]) -> Floats:
    """
    Return how much of the arm lies between each marker and the last one, (J,) [m].

    The chord between neighbours is lengthened to an arc by the angles between the chords beside
    it, and averaged over all postures: the longest chord would be biased by noise, and no loaded
    arm is ever straight.
    """
    steps = np.diff(positions, axis=1)  # (N, J - 1, 3)
    chords = np.linalg.norm(steps, axis=2)
    with np.errstate(invalid='ignore', divide='ignore'):
        along = steps / chords[..., None]
        bends = angle_between(along[:, 1:], along[:, :-1])
    bends = np.nan_to_num(bends)
    beside = np.concatenate([bends[:, :1], bends, bends[:, -1:]], axis=1)
    half = 0.25 * (beside[:, 1:] + beside[:, :-1]) if bends.shape[1] else np.zeros(chords.shape)
    arcs = mean_over(chords / np.sinc(half / np.pi), 0)
    longest = [apart[a, b] for a, b in pairwise(members)]
    lengths = np.where(np.isnan(arcs), longest, arcs)
    return np.append(np.cumsum(lengths[::-1])[::-1], 0.0)


def _snapped(measured: Floats, robot: Robot) -> tuple[tuple[float, ...], str]:
    """Return arc lengths at the ends of cells where all markers are near them."""
    ends = np.array([marker.arc_length for marker in default_markers(robot)])
    lengths = np.diff(ends, prepend=0.0)
    nearest = np.abs(measured[:, None] - ends).argmin(axis=1)
    near = np.abs(measured - ends[nearest]) < END_TOLERANCE * lengths[nearest]
    if near.all() and len(set(nearest.tolist())) == len(measured):
        where = 'the ends of its cells'
        if len(measured) < len(ends):
            where = f'the ends of cells {listed(str(i + 1 - robot.plate_cells) for i in nearest)}'
        return tuple(ends[nearest].tolist()), f'the last marker is at the tip, all at {where}'
    even = robot.length * (np.arange(len(measured)) + 1.0) / len(measured)
    if np.abs(measured - even).max() < DISTANCE_TOLERANCE * even[0]:
        return tuple(even.round(9).tolist()), 'the last marker is at the tip, all evenly spaced'
    places = np.clip(measured.round(4), 0.0, robot.length)  # no ruler is finer than 0.1 mm
    return (
        tuple(places.tolist()),
        'the last marker is at the tip, the others as far below as the arm between them is long',
    )
