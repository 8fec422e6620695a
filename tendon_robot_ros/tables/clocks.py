"""How the clock of the tracker's file runs against that of the inputs, from what both recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from .columns import FloatArray

STEP_S = 0.02  # [s] of the grid on which motions are compared: two frames of a usual tracker
SEARCH_STEP_S = 0.1  # [s] of that on which the speed of the clock is searched
POINTS_MAX = 1 << 17  # of the grid, for the memory; a longer recording is on a coarser one
PATTERNS_MAX = 6  # motions of the markers that are compared, the largest: all of two sections
CLEAR_SHARE = 0.85  # [1] of the best match; another delay that comes nearer leaves it open
MATCH_MIN = 0.3  # [1] of the motion that the inputs explain: less is chance
DRIFT_MAX = 0.01  # [s/s] no clock is worse; a wrong number of frames a second may be
DRIFTED_BETWEEN_S = 1.0  # [s] from one trial of the search to the next, at the end of the record
EVEN_WITHIN_S = 0.05  # [s] at the end of the record: then the clocks run alike


@dataclass(frozen=True)
class ClockFit:
    """The clock with which the motion of the markers goes with the inputs best."""

    delay: float  # [s] that the markers' first row was taken after that of the inputs
    drift: float  # [s/s] that the markers' clock loses: inputs' time = delay + (1 + drift) time
    match: float  # of the markers' motion that the inputs explain there, 0 to 1
    next_best: float  # the same at the next best delay or drift

    @property
    def is_clear(self) -> bool:
        """Whether no other clock comes near."""
        return self.match >= MATCH_MIN and self.next_best < CLEAR_SHARE * self.match


def find_clock(
    state_times: FloatArray, inputs: FloatArray, times: FloatArray, positions: FloatArray
) -> ClockFit:
    """
    Find how to delay and stretch the markers' times so that they move when the inputs do.

    The share of the markers' variance that a linear function of the inputs explains, for all
    delays at once: correlations of whitened inputs with the markers' principal motions, by FFT.
    Overlap counts: postures that repeat match less, moved by one round. That for a row of speeds
    of the clock, coarsely, and around the best one finely.

    Parameters
    ----------
    state_times, times : (T,) and (F,) [s]
        Each by its own clock, from 0.
    inputs : (T, m) [N] or [m]
    positions : (F, J, 3) [m]
        NaN where a marker was not seen.

    """
    span = float(times[-1])
    longest = max(float(state_times[-1]), span)
    motions = (state_times, inputs, times, positions.reshape(len(times), -1))
    count = int(DRIFT_MAX * span / DRIFTED_BETWEEN_S)
    drifts = np.linspace(-DRIFT_MAX, DRIFT_MAX, 2 * count + 1) if count else np.zeros(1)
    search = _Comparison(*motions, max(SEARCH_STEP_S, longest / POINTS_MAX))
    matches = np.array([search.matches(drift).max() for drift in drifts.tolist()])
    rough = int(matches.argmax())
    fine = _Comparison(*motions, max(STEP_S, longest / POINTS_MAX))
    drift, wide = float(drifts[rough]), DRIFTED_BETWEEN_S / max(span, 1.0)
    drift = float(
        minimize_scalar(
            lambda rate: -fine.matches(float(rate)).max(),
            bounds=(max(drift - wide, -DRIFT_MAX), min(drift + wide, DRIFT_MAX)),
            method='bounded',
            options={'xatol': 0.1 * EVEN_WITHIN_S / max(span, 1.0)},
        ).x
    )
    if abs(drift) * span < EVEN_WITHIN_S:
        drift = 0.0
    match = fine.matches(drift)
    best = int(match.argmax())
    place = float(best)
    if 0 < best < len(match) - 1:  # the vertex of the parabola through the peak and beside it
        left, middle, right = match[best - 1 : best + 2].tolist()
        curved = left - 2.0 * middle + right
        place += float(np.clip(0.5 * (left - right) / curved, -0.5, 0.5)) if curved < 0.0 else 0.0
    other = max(_next_best(match, best), _next_best(matches, rough))
    return ClockFit((place - fine.before(drift)) * fine.step, drift, float(match[best]), other)


class _Comparison:
    """Inputs and motions of the markers on one grid; the markers' clock may be stretched."""

    def __init__(
        self,
        state_times: FloatArray,
        inputs: FloatArray,
        times: FloatArray,
        coordinates: FloatArray,
        step: float,
    ) -> None:
        self.step = step
        # the largest principal motions, of variance one together
        u, s, _ = np.linalg.svd(_on_grid(times, coordinates, step), full_matrices=False)
        s = s[:PATTERNS_MAX] / max(float(np.linalg.norm(s)), 1e-30)
        self._moved = u[:, : len(s)] * s
        # orthonormal columns that span the inputs
        u, s, _ = np.linalg.svd(_on_grid(state_times, inputs, step), full_matrices=False)
        given = u[:, s > 1e-6 * max(float(s.max(initial=0.0)), 1e-30)]
        longest = len(given) + int(len(self._moved) * (1.0 + DRIFT_MAX)) + 1
        self._given, self._count = len(given), 1 << longest.bit_length()
        self._spectrum = np.fft.rfft(given, self._count, axis=0)

    def before(self, drift: float) -> int:
        """Return how many steps before that of the inputs the markers' grid may begin."""
        return int((len(self._moved) - 1) * (1.0 + drift))

    def matches(self, drift: float) -> FloatArray:
        """Return the share of the motion explained, for all delays from `before` steps early."""
        before = self.before(drift)
        old = np.arange(len(self._moved), dtype=float)
        new = np.minimum(np.arange(before + 1) / (1.0 + drift), old[-1])
        moved = np.column_stack([np.interp(new, old, column) for column in self._moved.T])
        other = np.fft.rfft(moved / np.sqrt(1.0 + drift), self._count, axis=0).conj()
        match = np.zeros(self._count)
        for column in self._spectrum.T:
            match += (np.fft.irfft(column[:, None] * other, self._count, axis=0) ** 2).sum(axis=1)
        found: FloatArray = np.roll(match, before)[: self._given + before]
        return found


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


def _next_best(match: FloatArray, best: int) -> float:
    """Return the highest match that is not on the slopes of the best one."""
    low = CLEAR_SHARE * match[best]
    below = np.flatnonzero(match < low)
    before, after = below[below < best], below[below > best]
    begin = int(before[-1]) if len(before) else 0
    end = int(after[0]) if len(after) else len(match)
    return float(max(match[:begin].max(initial=0.0), match[end:].max(initial=0.0)))
