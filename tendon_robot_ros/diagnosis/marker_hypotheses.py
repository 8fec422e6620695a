"""Mistakes of markers and cells: other numbers, exchanges, places or counts than described."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..common.arrays import Floats
from ..common.words import mm
from ..data import DataSet
from ..inference.marginal import NEGLIGIBLE
from ..inference.predict import Predictor
from ..inference.statistics import mean_over
from ..robot import Robot
from .setup_hypotheses import Mistake, as_unit, evaluated, otherwise_described, times
from .verdict import MISTAKEN_RATIO_MIN, QUIET_FLOORS, RESIDUAL_RATIO_MAX

SAME_PLACE = 1e-6  # [1] of the arm's length, so that only rounding lies within
APART_MIN = 0.2  # [1] of a cell's length, else markers beside each other would be apart
CELLS_MISCOUNTED_MAX = 3  # [1] too many or too few, else hundreds of arms would be tried
EXCHANGED_OFF_MIN = 0.3  # [1] of neighbours' distance, rms, because models are off by less
EXCHANGED_TRIALS_MIN = 0.1  # [1] of all, because fewer are readings that others contradict


def along(dataset: DataSet, robot: Robot, longer: Robot) -> Iterator[tuple[str, list[float]]]:
    """Yield possible places of markers (J,) [m] on an arm of another length, and their name."""
    places, more = uncut(dataset, robot), longer.length - robot.length
    yield 'stay', np.clip(places, 0.0, longer.length).tolist()
    ratio = longer.length / robot.length
    yield 'go along', np.clip(places * ratio, 0.0, longer.length).tolist()
    from_tip = places + more
    if from_tip.min() > -1e-9 * robot.length:
        yield 'as far from the tip', np.clip(from_tip, 0.0, longer.length).tolist()


def uncut(dataset: DataSet, robot: Robot) -> Floats:
    """
    Return where markers (J,) [m] would be on an arm that does not end.

    In the description of an arm that is too short all markers beyond its ends are at the end. Here
    they continue at the usual distance of the others.
    """
    places, length = dataset.arc_lengths, robot.length
    apart, gap_min = np.diff(places), SAME_PLACE * length
    if not (apart > gap_min).any() or not (apart >= 0.0).all():
        return places
    usual, extended = float(np.median(apart[apart > gap_min])), places.copy()
    at_tip, at_base = np.flatnonzero(places > length - gap_min), np.flatnonzero(places < gap_min)
    extended[at_tip] += usual * np.arange(len(at_tip))
    extended[at_base] -= usual * np.arange(len(at_base))[::-1]
    return extended


def in_one_place(dataset: DataSet, robot: Robot, floor: float) -> tuple[list[int], float]:
    """
    Return the markers that are described in one place but measured apart, and the distance [m].

    This happens where places were clipped to the end of an arm that is longer than described.
    """
    near = np.abs(np.subtract.outer(dataset.arc_lengths, dataset.arc_lengths))
    beside = np.linalg.norm(dataset.offsets[:, None] - dataset.offsets, axis=2)
    same = np.triu(near + beside < SAME_PLACE * robot.length, 1)
    distance_min = max(QUIET_FLOORS * floor, APART_MIN * robot.sections[-1].cell_length)
    group: set[int] = set()
    far = 0.0
    for i, j in zip(*np.nonzero(same), strict=True):
        chords = np.linalg.norm(dataset.mean[:, i] - dataset.mean[:, j], axis=1)
        chords = chords[np.isfinite(chords)]
        if len(chords) and np.median(chords) > distance_min:
            group |= {int(i), int(j)}
            far = max(far, float(np.median(chords)))
    return sorted(group), far


def numbered(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try markers that are numbered from the tip."""
    yield from evaluated(
        predictor,
        markers,
        'markers_from_the_tip',
        'with the markers numbered from the tip to the base',
        'turn the order of the markers in shapes.csv around',
        positions=predictor.dataset.positions[:, :, ::-1],
    )


def exchanged(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """
    Yield the exchange of two markers, in some trials or in all, if there is one.

    It shows in the distances between the markers of a trial, independent of the posture.
    """
    dataset = predictor.dataset
    J = len(dataset.markers)
    if J < 3:
        return
    expected = _distances(markers)[:, None]  # (P, 1, J, J)
    measured = _distances(dataset.positions)  # (P, Q, J, J)
    neighbour = float(np.median(np.diff(np.sort(dataset.arc_lengths))))
    off = _off(measured, expected)
    odd = off > EXCHANGED_OFF_MIN * neighbour
    if not odd.any():
        return
    pairs = list(combinations(range(J), 2))
    orders = np.tile(np.arange(J), (len(pairs), 1))
    for order, pair in zip(orders, pairs, strict=True):
        order[list(pair)] = pair[::-1]
    tried = [_off(measured[..., order, :][..., order], expected) for order in orders]
    others = np.where(odd, tried, np.inf)
    best = np.argmin(others, axis=0)
    wrong = odd & (others.min(axis=0) < RESIDUAL_RATIO_MAX * off)
    if not wrong.any():
        return
    k = int(np.bincount(best[wrong]).argmax())
    where = wrong & (best == k)
    if where.sum() < EXCHANGED_TRIALS_MIN * dataset.trials.sum():
        return
    swapped = dataset.positions[:, :, orders[k]]
    positions = np.where(where[..., None, None], swapped, dataset.positions)
    a, b = (dataset.markers[i].name for i in pairs[k])
    which = ''
    if where.sum() != dataset.trials.sum():
        p, q = np.argwhere(where)[0]
        first = f'posture {dataset.postures[p]} trial {dataset.trial_names[q]}'
        which = f' in {int(where.sum())} of {int(dataset.trials.sum())} trials, {first} the first'
    yield from evaluated(
        predictor,
        markers,
        'markers_exchanged',
        f'with markers {a} and {b} exchanged{which}',
        'exchange their names there in shapes.csv',
        certain=True,
        positions=positions,
    )


def _distances(places: Floats) -> Floats:
    """Return the distances (..., J, J) [m] between markers (..., J, 3)."""
    return np.asarray(np.linalg.norm(places[..., :, None, :] - places[..., None, :, :], axis=-1))


def _off(measured: Floats, expected: Floats) -> Floats:
    """Return the rms error (P, Q) [m] of distances; 0 where none was measured."""
    squares = ((measured - expected) ** 2).reshape(*measured.shape[:2], -1)
    return np.nan_to_num(np.sqrt(mean_over(squares, 2)))


def miscounted(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try another number of cells in a section, of the same length each."""
    for s, section in enumerate(predictor.robot.sections):
        for more in range(-CELLS_MISCOUNTED_MAX, CELLS_MISCOUNTED_MAX + 1):
            if more and section.cells + more > 0:
                yield from _counted(predictor, s, section.cells + more, section.cell_length)


def otherwise_divided(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try twice or half as many cells on the length of a section."""
    for s, section in enumerate(predictor.robot.sections):
        yield from _counted(predictor, s, 2 * section.cells, section.cell_length / 2.0)
        if section.cells % 2 == 0:
            yield from _counted(predictor, s, section.cells // 2, section.cell_length * 2.0)


def _recounted[T](values: tuple[T, ...], count: int) -> tuple[T, ...]:
    """Return values of so many cells of a section, further ones as the last; none stay none."""
    return (values + count * values[-1:])[:count]


def _counted(predictor: Predictor, s: int, count: int, length: float) -> Iterator[Mistake]:
    """Try a number of cells of a length [m] each in a section, with possible marker places."""
    robot, dataset, section = predictor.robot, predictor.dataset, predictor.robot.sections[s]
    if section.is_plate:
        return
    place = f'section {section.name}' if len(robot.own_sections) > 1 else 'the arm'
    other = replace(
        section,
        cells=count,
        cell_length=length,
        bending_stiffness=_recounted(section.bending_stiffness, count),
        mass_profile=_recounted(section.mass_profile, count),
        mass_offset=_recounted(section.mass_offset, count),
    )
    sections = (*robot.sections[:s], other, *robot.sections[s + 1 :])
    first = sum(before.cells for before in robot.sections[:s])
    beyond = first + section.cells
    tendons = tuple(
        replace(
            tendon,
            offsets=tendon.offsets[:first]
            + _recounted(tendon.offsets[first:beyond], count)
            + tendon.offsets[beyond:],
        )
        for tendon in robot.tendons
    )
    longer = replace(robot, sections=sections, tendons=tendons, fitted={})
    same = longer.length == robot.length
    each = f' of {1e3 * length:g} mm' if same else ''
    stay = [('stay', dataset.arc_lengths.tolist())]
    for where, places in stay if same else along(dataset, robot, longer):
        moved = tuple(
            replace(m, arc_length=at) for m, at in zip(dataset.markers, places, strict=True)
        )
        yield from otherwise_described(
            predictor,
            replace(dataset, robot=longer, markers=moved),
            'cells',
            f'with {count} cells{each} instead of {section.cells} in {place} (markers {where})',
            f'count the cells of {place}',
            doubtful=True,
        )


def spots(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try markers that sit elsewhere along the arm: nearer to the base, or the tip."""
    dataset, length = predictor.dataset, predictor.robot.length
    cell = predictor.robot.own_sections[0].cell_length
    moves = [
        *(
            (f'{abs(c):g} cell nearer to the {"base" if c < 0 else "tip"}', 1.0, c * cell)
            for c in (-1.0, -0.5, 0.5, 1.0)
        ),
        *((f'at {100 * s:.0f} % of their arc lengths', s, 0.0) for s in (0.8, 0.9, 1.1, 1.25)),
    ]
    for how, factor, shift in moves:
        places = factor * dataset.arc_lengths + shift
        if places.min() < -1e-9 * length or places.max() > (1.0 + 1e-9) * length:
            continue
        yield from _elsewhere(predictor, np.clip(places, 0.0, length), f'with all markers {how}')


def by_distances(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try what distances of neighbours suggest: one marker elsewhere, or another unit."""
    dataset = predictor.dataset
    order = np.argsort(dataset.arc_lengths)
    apart = np.diff(dataset.arc_lengths[order])
    if not len(apart) or apart.min() <= 0.0:
        return
    chords = [
        np.linalg.norm(np.diff(one[:, order], axis=1), axis=2) for one in (dataset.mean, markers)
    ]
    together = np.isfinite(chords[0]).any(axis=0)  # neighbours that were seen in one posture
    if not together.any():
        return
    ratio = np.full(len(apart), np.nan)
    ratio[together] = np.nanmedian((chords[0] / chords[1])[:, together], axis=0)
    straight = dataset.offsets + dataset.arc_lengths[:, None] * [0.0, 0.0, 1.0]
    described = np.linalg.norm(np.diff(straight[order], axis=0), axis=1)
    straightest = np.nanmax(chords[0][:, together], axis=0)  # never longer than the arm between
    scale = float(np.median(straightest / described[together]))
    if not 1.0 / MISTAKEN_RATIO_MIN < scale < MISTAKEN_RATIO_MIN:
        factor = as_unit(1.0 / scale)
        yield from evaluated(
            predictor,
            markers,
            'unit_of_positions',
            f'neighbouring markers are {scale:.3g} times as far apart as described: with all '
            f'positions {times(factor)}',
            'check their unit in shapes.csv [m], and arc_length of the markers in dataset.yaml',
            certain=True,
            positions=factor * dataset.positions,
        )
        return
    more = (ratio - 1.0) * apart  # [m] additional arm between neighbours
    for k, j in enumerate(order):
        estimates = [*more[k - 1 : k][:k], *(-more[k : k + 1])]
        off = float(np.mean(estimates))
        if abs(off) > 2.0 * NEGLIGIBLE * predictor.robot.length:
            places = dataset.arc_lengths.copy()
            places[j] += off
            where = f'{mm(places[j])} along the arm instead of {mm(dataset.arc_lengths[j])}'
            name = dataset.markers[j].name
            yield from _elsewhere(predictor, places, f'with marker {name} at {where}')


def _elsewhere(predictor: Predictor, places: Floats, sentence: str) -> Iterator[Mistake]:
    """Try other places (J,) [m] of the markers along the arm."""
    dataset = predictor.dataset
    inside = np.clip(places, 0.0, predictor.robot.length)
    moved = tuple(
        replace(m, arc_length=s, offset=(m.offset[0], m.offset[1], m.offset[2] + beyond))
        for m, s, beyond in zip(
            dataset.markers, inside.tolist(), (places - inside).tolist(), strict=True
        )
    )
    yield from otherwise_described(
        predictor,
        replace(dataset, robot=predictor.robot, markers=moved),
        'markers_elsewhere',
        sentence,
        'check arc_length of the markers in dataset.yaml, from the base along the arm, '
        'and the number of cells',
        doubtful=True,
    )


PLACES = (spots, by_distances, miscounted, otherwise_divided)  # of markers along the arm
