"""Types of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
DIGITS = 9  # [1] decimals of metres and newtons, because nothing that measures an arm has more
RESOLUTION = 10.0**-DIGITS  # [m] or [N], because values are rounded to it
ROWS_AT_ONCE = 2_000  # [1] rows of a table, or postures, at once, so that they stay in the cache
