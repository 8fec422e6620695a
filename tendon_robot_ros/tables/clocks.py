"""By how much the tracker's file begins later than that of the inputs, from what both recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .raw_table import FloatArray

STEP_S = 0.02  # [s] of the grid on which motions are compared
POINTS_MAX = 1 << 17  # of the grid; a longer recording is compared on a coarser one
PATTERNS_MAX = 6  # motions of the markers that are compared, the largest first
CLEAR_SHARE = 0.85  # of the best match; another delay that comes nearer leaves it open
MATCH_MIN = 0.3  # of the motion that the inputs explain


@dataclass(frozen=True)
class ClockDelay:
    """A delay at which the motion of the markers goes with the inputs best."""

    seconds: float  # that the markers' first row was taken after that of the inputs
    match: float  # of the markers' motion that the inputs explain there, 0 to 1
    next_best: float  # the same at the next best delay

    @property
    def is_clear(self) -> bool:
        """Whether no other delay comes near."""
        return self.match >= MATCH_MIN and self.next_best < CLEAR_SHARE * self.match


def find_delay(
    state_times: FloatArray, inputs: FloatArray, times: FloatArray, positions: FloatArray
) -> ClockDelay:
    """
    Find by how much to delay the markers so that they move when the inputs do.

    The share of the markers' variance that a linear function of the inputs explains, for all
    delays at once: correlations of whitened inputs with the markers' principal motions, by FFT.
    Overlap counts: postures that repeat match less, moved by one round.

    Parameters
    ----------
    state_times, times : (T,) and (F,) [s]
        Each by its own clock.
    inputs : (T, m) [N] or [m]
    positions : (F, J, 3) [m]
        NaN where a marker was not seen.

    """
    span = max(state_times[-1] - state_times[0], times[-1] - times[0])
    step = max(STEP_S, float(span) / POINTS_MAX)
    given = _whitened(_on_grid(state_times, inputs, step))
    moved = _patterns(_on_grid(times, positions.reshape(len(times), -1), step))
    count = 1 << int(len(given) + len(moved) - 1).bit_length()
    one, other = np.fft.rfft(given, count, axis=0), np.fft.rfft(moved, count, axis=0)
    match = np.zeros(count)
    for column in one.T:
        match += (np.fft.irfft(column[:, None] * other.conj(), count, axis=0) ** 2).sum(axis=1)
    match = np.roll(match, len(moved) - 1)[: len(given) + len(moved) - 1]
    best = int(match.argmax())
    place = best + _vertex(match[max(best - 1, 0) : best + 2])
    delay = (place - (len(moved) - 1)) * step + float(state_times[0] - times[0])
    return ClockDelay(delay, float(match[best]), _next_best(match, best))


def _on_grid(times: FloatArray, values: FloatArray, step: float) -> FloatArray:
    """Return columns at equal steps, gaps bridged, their means taken off."""
    grid = np.arange(times[0], times[-1] + 0.5 * step, step)
    columns = []
    for column in values.T:
        seen = np.isfinite(column)
        if seen.sum() > 1:
            placed = np.interp(grid, times[seen], column[seen])
            columns.append(placed - placed.mean())
    return np.array(columns).T.reshape(len(grid), -1)


def _whitened(columns: FloatArray) -> FloatArray:
    """Return orthonormal columns that span the same."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    kept: FloatArray = u[:, s > 1e-6 * max(float(s.max(initial=0.0)), 1e-30)]
    return kept


def _patterns(columns: FloatArray) -> FloatArray:
    """Return the largest principal motions, of variance one together."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    s = s[:PATTERNS_MAX] / max(float(np.linalg.norm(s)), 1e-30)
    return np.asarray(u[:, : len(s)] * s)


def _vertex(three: FloatArray) -> float:
    """Return where the parabola through a peak and its neighbours is highest, in steps."""
    if len(three) < 3:
        return 0.0
    left, middle, right = three.tolist()
    curved = left - 2.0 * middle + right
    return 0.0 if curved >= 0.0 else float(np.clip(0.5 * (left - right) / curved, -0.5, 0.5))


def _next_best(match: FloatArray, best: int) -> float:
    """Return the highest match that is not on the slopes of the best one."""
    low = CLEAR_SHARE * match[best]
    below = np.flatnonzero(match < low)
    before, after = below[below < best], below[below > best]
    begin = int(before[-1]) if len(before) else 0
    end = int(after[0]) if len(after) else len(match)
    return float(max(match[:begin].max(initial=0.0), match[end:].max(initial=0.0)))
