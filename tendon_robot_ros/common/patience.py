"""How long a search may take: compiled code reads it from step to step."""

from __future__ import annotations

import math
import time

import numpy as np
import numpy.typing as npt


class Patience:
    """Says True once time is over; another thread may end it before."""

    def __init__(self, budget: float = math.inf) -> None:
        """Begin to count; `budget` [s]."""
        self.until: npt.NDArray[np.float64] = np.array([time.monotonic() + budget])  # (1,) [s]

    def __call__(self) -> bool:
        """Whether time is over."""
        return time.monotonic() > float(self.until[0])

    def end(self) -> None:
        """Let it be over now."""
        self.until[0] = -math.inf
