"""What was measured lately, and its value at a moment in between."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

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
        found = [values for at, values in self._samples if begin <= at <= end]
        return np.array(np.mean(found, axis=0)) if found else None

    def _between(
        self, time: float, before: tuple[float, Array], after: tuple[float, Array] | None
    ) -> Array | None:
        if after is None:
            return before[1] if time - before[0] <= self.patience else None
        if after[0] - before[0] > 2.0 * self.patience:  # a gap: nobody knows
            return None
        part = (time - before[0]) / (after[0] - before[0])
        return before[1] + part * (after[1] - before[1])
