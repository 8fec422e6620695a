"""Traces to measurements: cleaned still segments, named by posture and trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress, pairwise, zip_longest

import numpy as np

from ..common.arrays import Floats, Ints, interpolated
from ..common.errors import DataSetError
from ..common.words import digits
from ..data.arrays import VALUES_MAX
from ..data.bag_reader import Recording, Track
from ..data.loading import plausible_inputs
from ..data.still_segments import (
    STEPS_PER_WINDOW,
    ArmMotion,
    Rule,
    Segment,
    find_segments,
    name_segments,
    never_still,
    still_stretches,
)
from ..data.tracker_faults import unseen_lines
from ..robot.estimates import INPUT_TOLERANCE, NOISE_FACTOR
from .columns import UNUSUAL_FACTOR, marker_label
from .recipe import Recipe, Selection
from .traces import Traces

FROM_STRAIGHT, SEQUENCE, VISITS = 'from_straight', 'sequence', 'visits'
# [1] of the time that an arm is still at least, so that this quantile is noise alone
QUIET_FRACTION = 0.15
# [1] of the segments, that are at rest where an arm rests between trials, because half of them
# are, and some are missed
REST_FRACTION = 0.3
# [1] of the range from the lowest input to the smallest load, below which inputs are let go,
# because a load cell does not go back to exactly zero
LET_GO_FRACTION = 0.2

RESTED = (
    'every posture was loaded from the straight arm (path: from_straight); if the arm went from '
    'one posture to the next, say --path sequence (rounds in the same order) or --path visits '
    '(any order)'
)
NO_REST = (
    'from where the arm came to a posture is taken not to matter, though it did not rest between '
    'them: with friction it does; let it rest next time, or say --path sequence (rounds in the '
    'same order) or --path visits (any order)'
)
ROWS = 'every row was loaded from the straight arm; if not, say --path sequence or --path visits'
IN_ORDER = {
    SEQUENCE: 'every posture was reached from the one before, the first from the straight arm',
    VISITS: 'the arm went from posture to posture without letting go, first from the straight arm',
}


def _size(segment: Segment) -> float:
    """Return the largest input [N] or [m]."""
    return float(np.nan_to_num(segment.inputs).max())


def let_go_between(pieces: Sequence[Piece], same: float) -> tuple[int, int, float]:
    """
    Count the loaded segments before which all inputs were released since the last loaded one.

    Parameters
    ----------
    pieces : sequence of Piece
        Recordings over time.
    same : float
        [N] or [m] inputs that differ by less are the same.

    Returns
    -------
    count, of : int
    level : float
        [N] or [m] below which an input counts as released.

    """
    count, of, level = 0, 0, 0.0
    for piece in pieces:
        sizes = np.nan_to_num(piece.recording.inputs).max(axis=1)
        lowest = float(np.quantile(sizes, 0.01))
        loaded = [one for one in piece.segments if _size(one) > lowest + 3.0 * same]
        if not loaded:
            continue
        released = lowest + max(same, LET_GO_FRACTION * (min(map(_size, loaded)) - lowest))
        for before, after in pairwise(loaded):
            begin, end = np.searchsorted(piece.recording.state_times, [before.end, after.begin])
            count += bool(sizes[begin:end].min(initial=np.inf) < released)
        of += len(loaded) - 1
        level = max(level, released)
    return count, of, level


@dataclass(frozen=True)
class Piece:
    """One recording: its content, the motion of the arm, and its still segments."""

    recording: Recording
    motion: ArmMotion | None  # None: every row is a measurement
    segments: tuple[Segment, ...]
    resting: tuple[Segment, ...]
    cut: Floats  # (K, 5) of the markers, as of `Traces`


class StillMeasurements:
    """
    The measurements of all recordings in the tracker's frame, and the excluded readings.

    Still segments are found, and named by posture and trial.

    Attributes
    ----------
    pieces : list of Piece
        The recordings.
    segments : list of Segment
    rule : Rule
        When the arm counts as still.
    same, rest : float [N] or [m]
        Inputs that differ by less are those of one posture; below, the arm rests (0: never).
    delays, drifts : tuple of float [s], [s/s]
        That the tracker's file begins later, and its clock loses, by recording; () of one clock.
    dropped, assumed, warnings : list of str
        Excluded readings; assumptions; exchanged markers, contradictions of the assumed history.

    Raises
    ------
    DataSetError
        The arm never stands still, or an input is in another unit.

    """

    def __init__(self, traces: Sequence[Traces], chosen: Selection) -> None:
        recipe, kind, name = chosen.recipe, chosen.kind, traces[0].recording.name
        unit = 'N' if kind == 'tension' else 'm'
        still = recipe.still
        rule = Rule(still.speed or Rule.speed, still.duration or Rule.duration, still.change)
        rule = rule.fill(chosen.robot, kind)
        self.delays = tuple(one.delay for one in traces if one.delay is not None)
        self.drifts = tuple(one.drift for one in traces if one.delay is not None)
        labels = [marker_label(marker.columns) for marker in recipe.markers or ()]
        unseen: dict[str, Ints] = {}  # readings (J,) that are none, by why
        for one in traces:
            for why, count in one.unseen.items():
                unseen[why] = unseen.get(why, np.zeros_like(count)) + count
        self.dropped = unseen_lines(unseen, labels)
        self.assumed = [one.clocks for one in traces if one.clocks]
        self.warnings = [f'{t.recording.name}: {line}' for t in traces for line in t.exchanged]
        rows = sum(len(one.recording.tracks[0].times) for one in traces)
        motions: list[ArmMotion] = []  # none: every row is a measurement
        sparse = _too_far_apart(traces, rule) if recipe.time else ''
        if recipe.time:
            traces = [replace(one, recording=_denser(one.recording, rule)) for one in traces]
            motions = [_without_peaks(ArmMotion.of(t.recording, rule)) for t in traces]
            rule = _still_rule(motions, traces, rule, recipe)
        self.rule = rule
        pieces = [_piece(one, moved, rule, chosen) for one, moved in zip_longest(traces, motions)]
        segments = [one for piece in pieces for one in piece.segments]
        if not segments and sparse:
            raise DataSetError(name, sparse, SETTLED_ROWS)
        if not segments:
            times = [one.recording.tracks[0].times for one in traces]
            raise never_still(name, motions, times, rule)
        compared = np.nan_to_num([one.inputs for one in segments[: int(np.sqrt(VALUES_MAX))]])
        self.same = _guess_same(compared) if recipe.same is None else recipe.same
        rest = recipe.rest
        if rest is None:
            rest = _guess_rest(compared, self.same) if recipe.path == FROM_STRAIGHT else 0.0
            if rest:
                below = f'{digits(rest, 3)} {unit}'
                self.assumed.append(f'where all inputs are below {below} the arm rests')
        self.rest = rest
        self.pieces = [_without_rest(piece, rest, i == 0) for i, piece in enumerate(pieces)]
        self.dropped += _dropped_lines(self.pieces, labels)
        kept = [one for piece in self.pieces for one in piece.segments]
        self.segments = _named(kept, recipe.path, replace(rule, change=self.same))
        self._judge_history(recipe, unit)
        if sparse and len(segments) < rows / 4:
            self.warnings.append(f'{sparse}: {SETTLED_ROWS}')

    @property
    def begins(self) -> list[int]:
        """Which segments are the first of a recording."""
        counts = [len(piece.segments) for piece in self.pieces]
        return np.cumsum([0, *counts[:-1]]).tolist()

    def _judge_history(self, recipe: Recipe, unit: str) -> None:
        """Say which history of the postures is assumed, and whether the inputs contradict it."""
        timed = [piece for piece in self.pieces if piece.motion is not None]
        count, of, level = let_go_between(timed, self.same)
        let_go = count > 0.5 * of  # however briefly
        if recipe.path == FROM_STRAIGHT:
            rested = RESTED if self.rest or let_go else NO_REST
            self.assumed.append(rested if recipe.time else ROWS)
            return
        self.assumed.append(IN_ORDER[recipe.path])
        if let_go:
            self.warnings.append(
                f'before {count} of {of} loaded postures all inputs were let go (below '
                f'{digits(level)} {unit}): the arm was loaded from straight every time; leave out '
                f'--path {recipe.path}'
            )


def _named(kept: list[Segment], path: str, rule: Rule) -> list[Segment]:
    """Name segments by posture and trial: rounds through a sequence are trials."""
    if path != SEQUENCE or not kept:
        return name_segments(kept, rule, sequence=False)
    same, values = rule.change or 0.0, np.nan_to_num([one.inputs for one in kept])
    back = (np.abs(values[2 : len(kept) // 2 + 1] - values[0]) < same).all(axis=1)
    periods = (np.flatnonzero(back) + 2).tolist()  # the last round may end early
    alike = (p for p in periods if (np.abs(values[p:] - values[:-p]) < same).all())
    period = next(alike, len(kept))
    return [
        replace(one, posture=str(i % period), trial=str(i // period)) for i, one in enumerate(kept)
    ]


def _too_far_apart(traces: Sequence[Traces], rule: Rule) -> str:
    """Return how far apart rows are that cannot show the arm at rest; '' where they can."""
    intervals = np.concatenate([np.diff(one.recording.state_times) for one in traces])
    apart = float(np.median(intervals)) if len(intervals) else 0.0
    if apart <= rule.duration / 4:
        return ''
    still = f'the arm stood still for {rule.duration:g} s'
    return f'the rows are {apart:.2g} s apart, too far to show that {still}'


SETTLED_ROWS = 'if each row was taken after the arm had settled, say --column time=none'


def _denser(recording: Recording, rule: Rule) -> Recording:
    """
    Return a recording of few rows a second with places between them, on a straight line.

    Two rows that are the same then show that the arm stood still in between; where a row lacks a
    marker, or rows are farther apart than the arm has to stand still, nothing is filled in.
    """
    (track,) = recording.tracks
    window = rule.duration / 2
    if len(track.times) < 2 or np.median(np.diff(track.times)) <= window / 2:
        return recording
    times = np.arange(track.times[0], track.times[-1] + 1e-9, window / STEPS_PER_WINDOW)
    flat = track.positions.reshape(len(track.times), -1)
    filled = interpolated(times, track.times, flat)
    after = np.clip(np.searchsorted(track.times, times), 1, len(track.times) - 1)
    filled[track.times[after] - track.times[after - 1] > rule.duration] = np.nan
    turned = np.broadcast_to(np.nan, (len(times), track.positions.shape[1], 4))
    dense = Track(times, filled.reshape(len(times), -1, 3), turned)
    return replace(recording, tracks=(dense,))


def _without_peaks(moved: ArmMotion) -> ArmMotion:
    """
    Take peaks out of the change of inputs that last less than half a window.

    A step of an input shows in all windows that hold it: for at least half a window where it is
    twice as large as what counts as a change. Shorter peaks are noise of the load cells, and would
    make two trials of one.
    """
    from scipy.ndimage import grey_opening  # takes 0.2 s to import

    change = np.where(np.isfinite(moved.change), moved.change, np.inf)
    return replace(moved, change=grey_opening(change, STEPS_PER_WINDOW // 2))


def _still_rule(
    motions: Sequence[ArmMotion], traces: Sequence[Traces], rule: Rule, recipe: Recipe
) -> Rule:
    """Return the thresholds of stillness for the noise of this tracker and these load cells."""
    speeds = np.concatenate([m.speed[np.isfinite(m.speed)] for m in motions])
    changes = np.concatenate([m.change[np.isfinite(m.change)] for m in motions])
    if recipe.still.speed is None and len(speeds):
        quiet = NOISE_FACTOR * float(np.quantile(speeds, QUIET_FRACTION))
        speed = np.clip(round(quiet, 5), Rule.speed, UNUSUAL_FACTOR * Rule.speed)
        rule = replace(rule, speed=float(speed))
    if recipe.still.change is None and len(changes):
        size = max(float(np.nanquantile(np.abs(one.recording.inputs), 0.995)) for one in traces)
        quiet = NOISE_FACTOR * float(np.quantile(changes, QUIET_FRACTION))
        usual = INPUT_TOLERANCE * max(size, 1e-9)
        rule = replace(rule, change=float(f'{np.clip(quiet, usual, UNUSUAL_FACTOR * usual):.3g}'))
    return rule


def _piece(traces: Traces, moved: ArmMotion | None, rule: Rule, chosen: Selection) -> Piece:
    """Return a recording with its still segments, or a segment for every row."""
    recording = traces.recording
    if moved is None:
        positions = recording.tracks[0].positions
        turned = np.full((positions.shape[1], 4), np.nan)
        inputs, places = recording.inputs.round(9), positions.round(9)
        rows = zip(recording.state_times.tolist(), inputs, places, strict=True)
        segments = [Segment(t, t, pulled, place, turned, np.nan) for t, pulled, place in rows]
    else:
        cleaned = _without_gaps(recording, still_stretches(moved, rule))
        segments, _ = find_segments(cleaned, moved, rule, sequence=True)
    segments = [one for one in segments if np.isfinite(one.positions).any()]
    if segments and chosen.recipe.zero:  # inputs count from those of the first segment
        zero = segments[0].inputs
        recording = replace(recording, inputs=recording.inputs - zero)
        segments = [replace(one, inputs=(one.inputs - zero).round(9)) for one in segments]
    if segments:
        segments = plausible_inputs(recording.name, segments, chosen.robot, chosen.kind, rule)
    return Piece(recording, moved, tuple(segments), (), traces.cut)


def _without_gaps(recording: Recording, stretches: Sequence[tuple[float, float]]) -> Recording:
    """Exclude a marker that is missing most of a still stretch: the arm may settle in the gap."""
    track = recording.tracks[0]
    positions = track.positions.copy()
    for begin, end in stretches:
        frames = positions[slice(*np.searchsorted(track.times, [begin - 1e-9, end + 1e-9]))]
        frames[:, np.isfinite(frames[..., 0]).mean(axis=0) < 0.5] = np.nan  # a view
    return replace(recording, tracks=(replace(track, positions=positions),))


def _guess_same(inputs: Floats) -> float:
    """
    Return the difference up to which inputs (N, m) are those of trials of one posture.

    Trials differ by what motors and load cells scatter, postures by what somebody chose: between
    the two there is a gap.
    """
    size = float(np.abs(inputs).max()) or 1.0
    usual = float(f'{INPUT_TOLERANCE * size:.3g}')
    if len(inputs) < 3:
        return usual
    from scipy.cluster.hierarchy import linkage

    # smaller steps are none, higher ones lead to other postures
    highest = UNUSUAL_FACTOR * INPUT_TOLERANCE * size
    heights = linkage(inputs, 'single', metric='chebyshev')[:, 2]
    count = int(np.searchsorted(heights, highest))
    steps = np.array([0.0, *heights, highest])[: count + 2]
    steps = np.maximum(steps, INPUT_TOLERANCE * size / UNUSUAL_FACTOR)
    ratios = steps[1:] / steps[:-1]
    best = int(ratios.argmax())
    if ratios[best] < NOISE_FACTOR:
        return usual
    return float(f'{np.sqrt(steps[best] * steps[best + 1]):.3g}')


def _guess_rest(inputs: Floats, same: float) -> float:
    """Return the input below which an arm under inputs (N, m) rests between; 0: it does not."""
    if len(inputs) < 2:
        return 0.0
    from scipy.cluster.hierarchy import fclusterdata  # takes half a second to import

    sizes = inputs.max(axis=1)
    postures = fclusterdata(inputs, same, 'distance', 'chebyshev')  # (N,) number of the posture
    at_rest = postures == postures[int(sizes.argmin())]
    if at_rest.mean() < REST_FRACTION or at_rest.sum() < 3 or at_rest.all():
        return 0.0
    lowest, loaded = float(sizes[at_rest].max()), float(sizes[~at_rest].min())
    return float(f'{0.5 * (lowest + min(loaded, 2.0 * lowest + 10.0 * same)):.3g}')


def _without_rest(piece: Piece, rest: float, first: bool) -> Piece:
    """Exclude the segments at rest but the first one, which shows the straight arm."""
    if not rest:
        return piece
    at_rest = [_size(one) < rest and (i > 0 or not first) for i, one in enumerate(piece.segments)]
    loaded = [not one for one in at_rest]
    kept, between = (tuple(compress(piece.segments, which)) for which in (loaded, at_rest))
    return replace(piece, segments=kept, resting=between)


def _dropped_lines(pieces: Sequence[Piece], labels: Sequence[str]) -> list[str]:
    """Describe the excluded readings and segments."""
    lines = []
    resting = sum(len(piece.resting) for piece in pieces)
    if resting:
        lines.append(f'{resting} still segments at rest between the others')
    cut = np.concatenate([piece.cut[:, 1] for piece in pieces]).astype(int)
    jumps = np.bincount(cut, minlength=len(labels))
    if jumps.any():
        places = ', '.join(f'{labels[j]} {jumps[j]}' for j in np.flatnonzero(jumps).tolist())
        lines.append(f'{len(cut)} frames in which a marker jumps ({places})')
    seen = np.concatenate([piece.recording.tracks[0].positions[..., 0] for piece in pieces])
    lost = 100.0 * np.isnan(seen).mean(axis=0)  # (J,) [%] of the readings
    if lost.any():
        most = f'{labels[int(lost.argmax())]}: {lost.max():.2g} %'
        lines.append(f'{lost.mean():.2g} % of the marker readings are missing (most of {most})')
    return lines
