"""Arrays as the numbers that figures carry: rounded, null where nothing was measured."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def plain(values: npt.ArrayLike, scale: float = 1.0, places: int = 4) -> list[float | None]:
    """Return numbers (n,) times a scale, rounded; None for NaN."""
    array = np.round(np.asarray(values, dtype=float) * scale, places)
    return [float(value) if np.isfinite(value) else None for value in array]


def mm_list(metres: npt.ArrayLike) -> list[float | None]:
    """Return lengths in mm."""
    return plain(metres, 1e3)


def degrees_list(radians: npt.ArrayLike) -> list[float | None]:
    """Return angles in degrees."""
    return plain(radians, 180.0 / np.pi)
