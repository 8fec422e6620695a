"""What was measured lately: at a moment, where the arm stands still, as a mean meanwhile."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..comparison.statistics import chi2_isf

Array = NDArray[np.float64]


class History:
    """
    Samples of the last seconds, by their time.

    Parameters
    ----------
    span : float
        Older samples are forgotten [s].
    patience : float
        A moment so much later than the newest sample still has its value [s].

    """

    def __init__(self, span: float = 4.0, patience: float = 0.1) -> None:
        """Begin empty."""
        self.span, self.patience = span, patience
        self._samples: deque[tuple[float, Array]] = deque()

    def put(self, time: float, values: Array) -> None:
        """Take a sample; one that comes late, after a newer one, is dropped."""
        if self._samples and time <= self._samples[-1][0]:
            if time > self._samples[-1][0] - self.span:
                return
            self._samples.clear()  # the clock was set back
        self._samples.append((time, values))
        while self._samples[0][0] < time - self.span:
            self._samples.popleft()

    @property
    def newest(self) -> float:
        """Time of the last sample; minus infinity without any."""
        return self._samples[-1][0] if self._samples else -np.inf

    def at(self, time: float) -> Array | None:
        """Return the values at a time, straight between samples; None outside of them."""
        later: tuple[float, Array] | None = None
        for sample in reversed(self._samples):
            if sample[0] <= time:
                return self._between(time, sample, later)
            later = sample
        return None

    def mean(self, begin: float, end: float) -> Array | None:
        """Return the mean over a time, both ends included; None without a sample in it."""
        samples = [values for at, values in self._samples if begin <= at <= end]
        return np.array(np.mean(samples, axis=0)) if samples else None

    def _between(
        self, time: float, before: tuple[float, Array], after: tuple[float, Array] | None
    ) -> Array | None:
        if after is None:
            return before[1] if time - before[0] <= self.patience else None
        if after[0] - before[0] > 2.0 * self.patience:  # a gap: nobody knows
            return None
        part = (time - before[0]) / (after[0] - before[0])
        return before[1] + part * (after[1] - before[1])


# -----------------------------------------------------------------------------
# When the arm stands still, and what was measured meanwhile.

FRAMES_PER_HALF_MIN = 4  # frames of the tracker in either half of the window


@dataclass(frozen=True)
class StillMeasurement:
    """A posture that stood still: means over the window."""

    inputs: Array  # (m,) [N] or [m]
    positions: Array  # (J, 3) [m], nan where a marker was not seen
    spread: float  # [m] 1 sd of one coordinate in one frame
    frames: int
    begin: float  # [s]
    end: float  # [s]


class StillWindow:
    """
    The last frames, and whether the arm stood still in them.

    Still is what `import-bag` calls still: the means of the two halves of the window are nearer to
    each other than the speed allows, so that the noise of a tracker is no motion, and no input
    changed.

    Parameters
    ----------
    duration : float
        Length of the window [s].
    speed : float
        Largest speed, rms over the markers [m/s].
    change : float
        Largest change of an input between the halves [N] or [m].

    """

    def __init__(self, duration: float, speed: float, change: float) -> None:
        """Begin empty."""
        self.duration, self.speed, self.change = duration, speed, change
        self._frames: deque[tuple[float, Array, Array]] = deque()

    def put(self, time: float, inputs: Array, positions: Array) -> None:
        """Take a frame: inputs (m,), markers (J, 3) [m]; a gap in time begins anew."""
        if self._frames and not 0.0 < time - self._frames[-1][0] < self.duration:
            self._frames.clear()
        self._frames.append((time, inputs, positions))
        while self._frames[0][0] < time - self.duration:
            self._frames.popleft()

    def clear(self) -> None:
        """Forget the frames."""
        self._frames.clear()

    def settled(self) -> StillMeasurement | None:
        """Return the means over the window if it is full and the arm stood still in it."""
        if not self._frames or self._frames[-1][0] - self._frames[0][0] < 0.8 * self.duration:
            return None
        times = np.array([frame[0] for frame in self._frames])
        inputs = np.array([frame[1] for frame in self._frames])
        positions = np.array([frame[2] for frame in self._frames])
        early = times < times[-1] - self.duration / 2
        if min(early.sum(), (~early).sum()) < FRAMES_PER_HALF_MIN:
            return None
        if np.abs(inputs[early].mean(axis=0) - inputs[~early].mean(axis=0)).max() > self.change:
            return None
        moved = np.linalg.norm(mean(positions[early]) - mean(positions[~early]), axis=1)
        moved = moved[np.isfinite(moved)]
        if not len(moved) or np.sqrt((moved**2).mean()) > self.speed * self.duration / 2:
            return None
        middle = mean(positions)
        deviations = positions - middle
        freedom = max(int(np.isfinite(deviations).sum()) - middle.size, 1)
        return StillMeasurement(
            inputs=inputs.mean(axis=0),
            positions=middle,
            spread=float(np.sqrt(np.nansum(deviations**2) / freedom)),
            frames=len(times),
            begin=float(times[0]),
            end=float(times[-1]),
        )


def mean(positions: Array) -> Array:
    """Return the mean (J, 3) [m] over frames (F, J, 3); nan where no frame saw the marker."""
    seen = np.isfinite(positions)
    count = seen.sum(axis=0)
    total = np.where(seen, positions, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


# -----------------------------------------------------------------------------
# The mean of the frames while neither tensions nor arm change more than by chance.

FALSE_CHANGE_PROBABILITY = 1e-3  # of a batch that it is taken for a change


@dataclass(frozen=True)
class _Batch:
    """Frames between two estimates."""

    at: float  # [s] of the last one
    tensions: Array  # (m,) [N]
    positions: Array  # (J, 3) [m], their mean
    frames: int


class FrameMean:
    """
    Averages frames as long as the arm stands under the same tensions, and begins anew when not.

    Frames since the last time are compared with those before: all coordinates together, and along
    the directions in which a force at the tip moves them, where little shows early.

    Parameters
    ----------
    noise : float
        1 sd of a coordinate of a marker in one frame [m].
    tension_change : float
        Tensions that differ by less are the same [N].
    longest : float
        Frames older than that are forgotten [s].

    """

    def __init__(self, noise: float, tension_change: float, longest: float) -> None:
        """Begin with nothing."""
        self.noise, self.tension_change, self.longest = noise, tension_change, longest
        self._new: list[tuple[float, Array, Array]] = []
        self._kept = deque[_Batch]()

    def put(self, at: float, tensions: Array, positions: Array) -> None:
        """Take a frame: its time [s], (m,) [N], (J, 3) [m] with nan where nothing was seen."""
        self._new.append((at, tensions, positions))

    def take(self, slopes: Array | None = None) -> tuple[Array, int]:
        """
        Return the mean (J, 3) [m], and of how many frames.

        Parameters
        ----------
        slopes : (3 J, 3), optional
            How a force moves the coordinates, as it was lately [m/N].

        """
        at, now, _ = self._new[-1]
        rows = [y for _, t, y in self._new if self._same(t, now)]
        self._new.clear()
        batch = _Batch(at, now, mean(np.array(rows)), len(rows))
        while self._kept and self._kept[0].at < at - self.longest:
            self._kept.popleft()
        if self._kept and self._changed(batch, slopes):
            self._kept.clear()
        self._kept.append(batch)
        return _joined(self._kept)

    def _same(self, tensions: Array, now: Array) -> bool:
        return not np.abs(tensions - now).max() > self.tension_change

    def _changed(self, batch: _Batch, slopes: Array | None) -> bool:
        """Tell whether a batch is not as the ones before."""
        if not self._same(self._kept[-1].tensions, batch.tensions):
            return True
        before, frames = _joined(self._kept)
        off = (batch.positions - before).ravel()
        seen = np.isfinite(off)
        off = off[seen] / (self.noise * np.sqrt(1.0 / batch.frames + 1.0 / frames))
        parts = [off]
        if slopes is not None and len(off) > slopes.shape[1]:
            parts.append(np.linalg.qr(slopes[seen])[0].T @ off)
        return any(p @ p > chi2_isf(FALSE_CHANGE_PROBABILITY, len(p)) for p in parts if len(p))


def _joined(batches: deque[_Batch]) -> tuple[Array, int]:
    """Return the mean of batches (J, 3) [m], nan where none saw the marker, and their frames."""
    frames = np.array([batch.frames for batch in batches])
    positions = np.array([batch.positions for batch in batches])
    seen = np.isfinite(positions) * frames[:, None, None]
    total, count = np.nansum(positions * frames[:, None, None], axis=0), seen.sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), int(frames.sum())
