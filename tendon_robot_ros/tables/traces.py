"""Columns to inputs and markers over time, in SI units and on one clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..common.arrays import Floats, Ints, interpolated
from ..common.errors import DataSetError, InputError, short
from ..common.results import pandas
from ..common.words import UNITS, find_unit, listing
from ..data.arrays import FRAME_S, VALUES_MAX
from ..data.bag_reader import Recording, Track
from ..data.tracker_faults import exchange_lines, joined, put_back, renumbered, without_unseen
from ..inference.statistics import minimum
from ..robot.estimates import TRACKER_NOISE_M
from .columns import ROWS_MAX, UNUSUAL_FACTOR, RawTable, marker_label, not_visible
from .markers import circle_centres
from .recipe import MarkerColumns, Recipe, Selection, WireSpool, time_column

# [1] of the best match, above which another delay leaves it open, because noise changes both
CLEAR_RATIO = 0.85
MATCH_MIN = 0.3  # [1] of the motion that the inputs explain, because less may be by chance
# [s/s] that a clock may lose, because a wrong number of frames a second is no larger error
DRIFT_MAX = 0.01
# [s] at the end of the record, from one drift of the search to the next, so that their peaks
# overlap
DRIFT_STEP_S = 1.0


def _modes(times: Floats, values: Floats, step: float) -> tuple[Floats, Floats]:
    """Return left singular vectors and singular values of columns, gaps bridged, without means."""
    grid = np.arange(times[0], times[-1] + 0.5 * step, step)
    columns = []
    for column in values.T:
        known = np.isfinite(column)
        if known.sum() > 1:
            placed = np.interp(grid, times[known], column[known])
            columns.append(placed - placed.mean())
    u, s, _ = np.linalg.svd(np.array(columns).T.reshape(len(grid), -1), full_matrices=False)
    return u, s


def _matches(inputs: Floats, moved: Floats, drift: float) -> Floats:
    """Return the fraction of the motion that is explained, for all delays."""
    before = int((len(moved) - 1) * (1.0 + drift))
    old = np.arange(len(moved), dtype=float)
    new = np.minimum(np.arange(before + 1) / (1.0 + drift), old[-1])
    stretched = interpolated(new, old, moved)
    count = 1 << (len(inputs) + before + 1).bit_length()
    other = np.fft.rfft(stretched / np.sqrt(1.0 + drift), count, axis=0).conj()
    match = np.zeros(count)
    for column in np.fft.rfft(inputs, count, axis=0).T:
        match += (np.fft.irfft(column[:, None] * other, count, axis=0) ** 2).sum(axis=1)
    return np.asarray(np.roll(match, before)[: len(inputs) + before])


def _next_best(match: Floats, best: int) -> float:
    """Return the highest match that is not on the slopes of the best one."""
    below = np.flatnonzero(match < CLEAR_RATIO * match[best])
    begin = below[below < best].max(initial=0)
    end = below[below > best].min(initial=len(match))
    return float(max(match[:begin].max(initial=0.0), match[end:].max(initial=0.0)))


# [s] for which a marker is taken for another one at most, so that motions are not cut out
JUMP_MAX_S = 0.3
# [1] of the distance that the arm moves: smaller steps from row to row are those of a recording,
# because postures that somebody chose are farther apart
FRAME_STEP_FRACTION = 0.02


def input_factor(unit_text: str, spool: WireSpool) -> float:
    """
    Return what one unit of an input's column is in newtons or metres.

    Raises
    ------
    InputError
        A motor's angle or current is given without the spool that it turns.

    """
    unit = find_unit(unit_text)
    assert unit is not None  # checked when it was read
    if unit.kind in ('force', 'length'):
        return unit.factor
    if spool.radius is None:
        asked = 'how far is the wire from the axis of its spool? say --spool MM'
        raise InputError(f'inputs are in {unit.text}: {asked}')
    if unit.kind == 'angle':
        return unit.factor * spool.radius
    if unit.kind == 'current':
        if spool.torque_constant is None:
            option = '--torque-constant, N·m per ampere at the spool'
            raise InputError(f'inputs are in {unit.text}: say {option}')
        return unit.factor * spool.torque_constant / spool.radius
    if spool.counts_per_turn is None:
        raise InputError(f'inputs are in {unit.text}: say --counts-per-turn, 4096 for example')
    return 2.0 * np.pi * spool.radius / spool.counts_per_turn


@dataclass(frozen=True)
class Traces:
    """One recording; its inputs have times of their own where they have their own file."""

    recording: Recording
    unseen: dict[str, Ints]  # readings (J,) of each marker that are none, by why
    # (K, 5) readings that were cut out, because a marker was elsewhere for a moment: time [s],
    # index of the marker, place [m]
    cut: Floats
    delay: float | None = None  # [s] that the tracker's file begins later; None: there is one file
    drift: float = 0.0  # [s/s] that the tracker's clock loses
    clocks: str = ''  # how these are known, where there are two clocks
    exchanged: tuple[str, ...] = ()  # which markers were put back, and when


def make_traces(tables: Sequence[RawTable], chosen: Selection) -> list[Traces]:
    """
    Return one recording per table, or per pair of tables where markers have their own.

    Raises
    ------
    DataSetError
        Time goes back, a cell is no number, or tables do not fit to each other.

    """
    recipe = chosen.recipe
    inputs = [u.column for u in (recipe.inputs or {}).values()]
    markers = recipe.markers or ()
    places = [c for m in markers for part in m.parts for point in part for c in point]
    with_inputs = [t for t in tables if t.holds(*inputs)]
    with_markers = [t for t in tables if t.holds(*places)]
    for table in tables:
        if table not in with_inputs and table not in with_markers:
            missing = [c for c in (*inputs, *places) if not table.holds(c)]
            problem = f'lacks the columns {listing(missing)}'
            raise DataSetError(table.name, problem, 'give all tables the same')
    if len(with_inputs) != len(with_markers):
        problem = f'{len(with_inputs)} tables hold inputs and {len(with_markers)} markers'
        raise DataSetError(tables[0].name, problem, 'name one of each per recording')
    clocks = []
    for what, given in (('delay', recipe.delay), ('drift', recipe.drift)):
        known = given or (None,)
        if len(known) not in (1, len(with_inputs)):
            problem = f'{len(known)} {what}s are given for {len(with_inputs)} recordings'
            raise DataSetError(tables[0].name, problem, f'give one {what}, or one for each')
        clocks.append(known if len(known) > 1 else known * len(with_inputs))
    pairs = zip(with_inputs, with_markers, *clocks, strict=True)
    return [_trace(a, b, chosen, delay, drift) for a, b, delay, drift in pairs]


def _trace(
    input_table: RawTable,
    marker_table: RawTable,
    chosen: Selection,
    delay: float | None,
    drift: float | None,
) -> Traces:
    recipe = chosen.recipe
    uses = (recipe.inputs or {}).values()
    inputs = np.column_stack(
        [input_table.numbers(use.column) * input_factor(use.unit, recipe.spool) for use in uses]
    )
    positions, unseen = marker_places(marker_table, recipe, chosen.robot.length)
    pulled = [use.unit in UNITS['force'] or use.unit in UNITS['current'] for use in uses]
    empty = ~np.isfinite(inputs).any(axis=0) & pulled  # a wire may be slack all the time
    if empty.any():
        names = [use.column for use, none in zip(uses, empty.tolist(), strict=True) if none]
        problem = f'there is no number in {listing(names)}'
        raise DataSetError(input_table.name, problem, 'name another column: --column INPUT=COLUMN')
    if not np.isfinite(positions).any():
        problem, remedy = 'no marker was ever seen', 'export the markers again'
        raise DataSetError(marker_table.name, problem, remedy)
    clocks, drift = '', drift or 0.0
    cut, exchanges = np.zeros((0, 5)), list[tuple[int, int, int]]()
    if not recipe.time:
        if len(input_table) != len(marker_table):
            others = f'{input_table.name} with the inputs {len(input_table):,}'
            problem = f'has {len(marker_table):,} rows, and {others}: which belong together?'
            remedy = 'give both a row for each measurement, or name their columns of times'
            raise DataSetError(marker_table.name, problem, remedy)
        steps = np.linalg.norm(np.diff(positions, axis=0), axis=2)
        moved = np.linalg.norm(np.nanmax(positions, axis=0) - np.nanmin(positions, axis=0), axis=1)
        is_recording = recipe.time is None and len(positions) > ROWS_MAX
        if is_recording and np.nanmedian(steps) < FRAME_STEP_FRACTION * moved.max():
            like = 'follow each other like the frames of a recording'
            problem = f'has no column of times, and its {len(positions):,} rows {like}'
            remedy = 'say --column time=COLUMN, or leave one row per measurement'
            raise DataSetError(marker_table.name, problem, remedy)
        times = state_times = np.arange(len(input_table), dtype=float)
    else:
        state_times, times = _times(input_table, recipe), _times(marker_table, recipe)
        if input_table is not marker_table and not (
            input_table.part and input_table.name == marker_table.name
        ):  # own clocks
            if delay is None:
                delay, drift, clocks = _clock(state_times, inputs, times, positions)
            times = delay + (1.0 + drift) * times
        elif delay:
            remedy = 'leave out the delay, or name its inputs in a table of their own'
            raise DataSetError(marker_table.name, 'has one clock for inputs and markers', remedy)
        late = times > state_times[-1]
        if late.all():
            problem = f'begins after {input_table.name} with the inputs has ended'
            raise DataSetError(marker_table.name, problem, 'correct --delay')
        if late.any():  # what the inputs were then, nothing tells
            unseen['the inputs end before'] = np.isfinite(positions[late, :, 0]).sum(axis=0)
            positions[late] = np.nan
        cut = _cut_jumps(positions, times)
        positions, exchanges = put_back(positions)
    track = Track(times, positions, np.broadcast_to(np.nan, (*positions.shape[:2], 4)))
    recording = Recording(marker_table.name, state_times, (track,), inputs=inputs)
    labels = [marker_label(marker.columns) for marker in recipe.markers or ()]
    exchange_notes = tuple(exchange_lines(exchanges, times, labels))
    return Traces(recording, unseen, cut, delay, drift, clocks, exchange_notes)


def marker_places(
    table: RawTable, recipe: Recipe, length: float
) -> tuple[Floats, dict[str, Ints]]:
    """Return places (T, J, 3) [m], NaN where not seen, and the readings (J,) left out, by why."""
    factor = UNITS['length'][find_unit(recipe.positions or 'm').text]  # type: ignore[union-attr]
    markers = [marker.parts for marker in recipe.markers or ()]
    rims = [points for parts in markers for points in parts]
    points = [point for rim in rims for point in rim]
    positions, unseen = without_unseen(factor * table.places(points), length)
    visible = np.isfinite(positions).all(axis=2)
    for why, hidden in not_visible(table, points).items():
        if (hidden & visible).any():
            unseen[why] = (hidden & visible).sum(axis=0)
            visible &= ~hidden
    positions[~visible] = np.nan
    of_rims = np.split(positions, np.cumsum([len(rim) for rim in rims])[:-1], axis=1)
    centres = np.stack([circle_centres(one) for one in of_rims], axis=1)
    counts = np.cumsum([0, *map(len, markers)])
    own = [range(a, b) for a, b in pairwise(counts.tolist())]
    first = np.cumsum([0, *(sum(map(len, parts)) for parts in markers)])[:-1]
    summed = {why: np.add.reduceat(count, first) for why, count in unseen.items()}
    return joined(centres, own), summed


def follow_renumbered(tables: Sequence[RawTable], chosen: Selection) -> None:
    """
    Join the columns of markers that the tracker renumbered, with a line for each.

    A marker may go on in columns without a name; the others of these are reflections. Where a
    recipe says where each marker is on the arm, it has said that already.
    """
    markers = chosen.recipe.markers or ()
    if len(markers) < 2 or any(marker.arc_length is not None for marker in markers):
        return
    columns = [c for marker in markers for c in marker.columns]
    with_markers = [table for table in tables if table.holds(*columns)]
    if not with_markers:
        return
    nameless = [c for c in chosen.nameless if all(table.holds(*c) for table in with_markers)]
    every = (*markers, *map(MarkerColumns, nameless))
    recipe = replace(chosen.recipe, markers=every)
    length = chosen.robot.length
    places = np.concatenate([marker_places(t, recipe, length)[0] for t in with_markers])
    chains = [chain for chain in renumbered(places) if chain[0] < len(markers)]
    followed = []
    for first, *later in chains:
        known = marker_label(markers[first].columns)
        more = tuple(every[j].columns for j in later)
        chosen.assumed += [
            f'{marker_label(own)} is {known}, numbered anew: it begins where that one ends'
            for own in more
        ]
        chosen.nameless = [own for own in chosen.nameless if own not in more]
        followed.append(replace(markers[first], later=more or None))
    chosen.recipe = replace(chosen.recipe, markers=tuple(followed))


def _clock(
    state_times: Floats, inputs: Floats, times: Floats, positions: Floats
) -> tuple[float, float, str]:
    """
    Return delay [s] and drift [s/s] of the tracker's clock, and how they are known.

    The inputs' time is delay + (1 + drift) times that of the markers. A clock is as good as the
    share of the markers' variance that a linear function of the inputs explains, for all delays at
    once: correlations of whitened inputs with the markers' principal motions, by FFT. Overlap
    counts: postures that repeat match less, moved by one round. That for a row of speeds of the
    clock, coarsely, and around the best one finely.

    Parameters
    ----------
    state_times, times : (T,) and (F,) [s]
        Each by its own clock, from 0.
    inputs : (T, m) [N] or [m]
    positions : (F, J, 3) [m]
        NaN where a marker was not seen.

    """
    last, span = times[-1], max(float(times[-1]), 1.0)
    coordinates = positions.reshape(len(times), -1)
    longest = max(float(state_times[-1]), float(last))
    # of the grid on which motions are compared: coarser where it would not fit into memory
    step = max(FRAME_S, longest * coordinates.shape[1] / VALUES_MAX)
    # coarse and fine: orthonormal columns that span the inputs; the largest motions
    grids = []
    for one in (5.0 * step, step):
        spanned, sizes = _modes(state_times, inputs, one)
        moved, moves = _modes(times, coordinates, one)
        total = max(float(np.linalg.norm(moves)), 1e-30)  # all together have variance one
        known = sizes > 1e-6 * max(float(sizes.max(initial=0.0)), 1e-30)
        # as many motions as inputs, the largest, because they move the arm in no more ways
        grids.append((spanned[:, known], (moved * moves / total)[:, : known.sum()]))
    coarse, fine = grids
    count = int(DRIFT_MAX * last / DRIFT_STEP_S)
    drifts = np.linspace(-DRIFT_MAX, DRIFT_MAX, 2 * count + 1) if count else np.zeros(1)
    matches = np.array([_matches(*coarse, one).max() for one in drifts.tolist()])
    rough = int(matches.argmax())
    beside = drifts[rough] + np.array([-1.0, 1.0]) * DRIFT_STEP_S / span
    low, high = np.clip(beside, -DRIFT_MAX, DRIFT_MAX).tolist()
    drift, _ = minimum(lambda rate: -_matches(*fine, rate).max(), low, high, 0.25 * FRAME_S / span)
    if abs(drift) * last < 2.5 * FRAME_S:  # at the end of the record: they run alike
        drift = 0.0
    match = _matches(*fine, drift)
    best = int(match.argmax())
    place, (left, middle, right) = float(best), np.pad(match, 1)[best : best + 3].tolist()
    if (curved := left - 2.0 * middle + right) < 0.0:  # the vertex of the parabola through them
        place += float(np.clip(0.5 * (left - right) / curved, -0.5, 0.5))
    before = len(match) - len(fine[0])  # steps by which the markers' grid may begin earlier
    delay, drift = round((place - before) * step, 3), round(drift, 7)
    explained, next_best = match[best], max(_next_best(match, best), _next_best(matches, rough))
    if explained < MATCH_MIN or next_best >= CLEAR_RATIO * explained:
        why = (
            'both files begin together: what moves in them does not tell by how much one begins '
            f'later ({100 * explained:.0f} % go with the inputs at {delay:.2f} s, '
            f'{100 * next_best:.0f} % at another delay); if you know it, say --delay'
        )
        return 0.0, 0.0, why
    order = 'after' if delay >= 0.0 else 'before'
    speed = 'fast' if drift < 0.0 else 'slow'
    off = f'{abs(drift) * last:.2f} s at its end, {1e6 * abs(drift):.0f} in a million'
    how = (
        f"the tracker's file begins {abs(delay):.2f} s {order} that of the inputs"
        + (f', and its clock is {speed} ({off})' if drift else '')
        + f': then {100 * explained:.0f} % of what the markers move goes with the inputs, '
        f'at no other delay more than {100 * next_best:.0f} %'
    )
    return delay, drift, how


def _cut_jumps(positions: Floats, times: Floats) -> Floats:
    """Take out frames in which a marker leaps away and, a moment later, is back."""
    step_s = float(np.median(np.diff(times))) if len(times) > 2 else 1.0
    frames_max = int(np.clip(JUMP_MAX_S / max(step_s, 1e-9), 1, 50))
    cut, leap_min = [np.zeros((0, 5))], 4.0 * TRACKER_NOISE_M  # [m] of a leap
    for j in range(positions.shape[1]):
        visible = np.flatnonzero(np.isfinite(positions[:, j, 0]))
        path = positions[visible, j]
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        if len(steps) < 3:
            continue
        leaps = np.flatnonzero(steps > max(UNUSUAL_FACTOR * float(np.median(steps)), leap_min)) + 1
        out = set[int]()
        for frame in leaps.tolist():
            before = frame - 1
            while before in out:
                before -= 1
            leap = float(np.linalg.norm(path[frame] - path[before]))
            if frame in out or leap < leap_min:
                continue
            back = np.linalg.norm(path[frame : frame + frames_max] - path[before], axis=1)
            near = np.flatnonzero(back < 0.25 * leap)
            out |= set(range(frame, frame + int(near[0]))) if len(near) else set()
        frames = visible[sorted(out)]
        cut.append(np.column_stack([times[frames], np.full(len(frames), j), positions[frames, j]]))
        positions[frames, j] = np.nan
    return np.concatenate(cut)


def _times(table: RawTable, recipe: Recipe) -> Floats:
    column = time_column(table, recipe.time)
    assert column is not None
    written = table.columns[column]
    if table.is_text(column):
        # whole seconds may have no decimals, as Python writes them
        stamps = pandas().to_datetime(written, format='ISO8601', errors='coerce', utc=True)
        if stamps.isna().mean() > 0.5:
            stamps = pandas().to_datetime(written, errors='coerce', utc=True)
    if table.is_text(column) and stamps.isna().mean() <= 0.5:  # dates
        times = np.asarray((stamps - stamps[0]).total_seconds())
    else:
        unit = find_unit((recipe.time or {})[column])
        times = table.numbers(column, 'a time') * (1.0 if unit is None else unit.factor)
    back = np.diff(times, prepend=-np.inf) < 0.0
    for row in np.flatnonzero(~np.isfinite(times) | back)[:1].tolist():
        if back[row]:
            problem = f'time goes back from {times[row - 1]:g} to {times[row]:g} s'
            raise DataSetError(table.where(row), problem, 'one file per recording: split it there')
        cell = 'empty' if np.isnan(times[row]) else f'{times[row]:g}'
        cell = short(written[row]) if table.is_text(column) and written[row] else cell
        raise DataSetError(table.where(row), f'{column} is {cell}', 'every row needs its time')
    return np.asarray(times - times[0])
