"""A force as people say it: how large, how far from the arm's axis, how far from gravity."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..comparison.predict import FreeParameter, Predictor
from ..comparison.statistics import chi2_isf, normal_ppf
from .fit import Fit
from .result import LoadVector, Value

Floats = npt.NDArray[np.float64]
AXIS = np.array([0.0, 0.0, 1.0])  # of the straight arm, from base to tip
TOLD_WITHIN_RAD = 0.25 * math.pi  # [rad] half an interval from which a direction is not told
QUANTILE = normal_ppf(0.975)


def load_of(
    force: npt.ArrayLike,
    covariance: Floats | None = None,
    gravity: Sequence[float] | None = None,
    scale: float = 1.0,
) -> LoadVector:
    """
    Return size and direction of a force, with 95 % intervals.

    Parameters
    ----------
    force : (3,) [N]
        In the base frame.
    covariance : (3, 3) [N²], optional
        Default: it is known exactly.
    gravity : (3,) [m/s²], optional
        In the base frame.
    scale : float
        Of the covariance.

    """
    vector = np.asarray(force, dtype=float)
    spread = np.zeros((3, 3)) if covariance is None else scale * np.asarray(covariance)
    size = float(np.linalg.norm(vector))
    half = QUANTILE * _sd(spread, vector)
    down = None if gravity is None or not np.any(gravity) else np.array(gravity, dtype=float)
    return LoadVector(
        Value(size, max(size - half, 0.0), size + half, 'N'),
        _angle(vector, spread, AXIS),
        float(np.arctan2(vector[1], vector[0])),
        None if down is None else _angle(vector, spread, down / np.linalg.norm(down)),
    )


def _sd(spread: Floats, way: Floats) -> float:
    """Return 1 sd [N] of a force along a way (3,); of no way: along its worst."""
    length = float(np.linalg.norm(way))
    variance = way @ spread @ way / length**2 if length > 0.0 else np.linalg.eigvalsh(spread)[-1]
    return math.sqrt(max(float(variance), 0.0))


def _angle(vector: Floats, spread: Floats, axis: Floats) -> Value | None:
    """Return the angle [rad] to an axis; its interval holds 0 or pi where chance alone may."""
    size = float(np.linalg.norm(vector))
    if size == 0.0:
        return None
    along = float(vector @ axis)
    across = vector - along * axis
    away = across * size**2 - vector * float(across @ vector)  # the way in which the angle grows
    half = QUANTILE * _sd(spread, away) / size
    if not half < TOLD_WITHIN_RAD:
        return None
    angle = float(np.arctan2(np.linalg.norm(across), along))
    low, high = max(angle - half, 0.0), min(angle + half, math.pi)
    if _may_be_chance(across, spread, axis):
        low, high = (0.0, high) if along > 0.0 else (low, math.pi)
    return Value(angle, low, high, 'rad')


def _may_be_chance(across: Floats, spread: Floats, axis: Floats) -> bool:
    """Tell whether what lies across an axis is inside of the 95 % ellipse around nothing."""
    plane = np.linalg.svd(axis[None])[2][1:]  # (2, 3) across the axis
    seen, known = plane @ across, plane @ spread @ plane.T
    if not known.any():
        return not seen.any()
    return float(seen @ np.linalg.pinv(known) @ seen) < chi2_isf(0.05, 2)


def loads_of(
    fit: Fit, predictor: Predictor, scale: float = 1.0, covariance: Floats | None = None
) -> dict[str, LoadVector]:
    """
    Return the load of every effect of a fit that is a force.

    `scale` is of the covariance; default: the fit's.
    """
    made, known = {}, fit.told if covariance is None else covariance
    for effect in dict.fromkeys(free.effect for free in fit.frees):
        rows = vector_rows(fit.frees, effect)
        spread = known[np.ix_(rows, rows)]
        if rows and np.isfinite(spread).all():
            made[effect] = load_of(fit.values[rows], spread, gravity_of(predictor), scale)
    return made


def vector_rows(frees: Sequence[FreeParameter], effect: str) -> list[int]:
    """Return which free parameters are x, y and z of the force of an effect; none: it has none."""
    rows = {f.key: i for i, f in enumerate(frees) if (f.effect, f.parameter.unit) == (effect, 'N')}
    stems = [key.removesuffix('_x') for key in rows if key.endswith('_x')]
    return next(
        ([rows[f'{stem}_{axis}'] for axis in 'xyz'] for stem in stems
         if {f'{stem}_y', f'{stem}_z'} <= set(rows)),
        [],
    )  # fmt: skip


def gravity_of(predictor: Predictor) -> tuple[float, ...] | None:
    """Return gravity (3,) [m/s²] where it was the same in all postures, else None."""
    found = {tuple(part.gravity.tolist()) for part in predictor.parts}
    return next(iter(found)) if len(found) == 1 else None
