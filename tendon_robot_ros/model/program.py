"""Bounded least squares and quadratic programs of a few tensions; the step of the tip by one."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Floats

# [1] of the largest slope: along directions of the tip with less, a step would ask for much
# tension
STEP_DAMPING = 0.1
# [1] of a tension's range: tolerance of a reached goal or limit, because noise of load cells is
# half of it
RANGE_TOLERANCE = 2e-3
# [1] of a range, changed by one step of the tip: beyond it, slopes with friction would be others
STEP_MAX = 0.03
# [1] of what the tip is off, taken off in one step, so that a loop with some delay does not
# overshoot (docs/control.md)
STEP_GAIN = 0.5


def solved(
    matrix: Floats, slope: Floats, rows: Floats | None, lower: Floats, upper: Floats
) -> Floats:
    """
    Return the step u (m,) of one program; zero, which is always allowed, where it fails.

    min u·(matrix u)/2 + slope·u with bounds on u, and on rows (r, m) of it from below.

    Parameters
    ----------
    lower, upper : (m + r,) and (m,)

    """
    import daqp  # on first use: processes that solve no program do not load it

    m = len(slope)
    if rows is None:
        rows = np.empty((0, m))
    high = np.concatenate([upper, np.full(len(rows), 1e30)])
    solution, _, flag, _ = daqp.solve(matrix, slope, np.ascontiguousarray(rows), high, lower)
    return within(solution, lower[:m], upper) if flag >= 1 else np.zeros(m)


def within(values: Floats, lower: Floats | float, upper: Floats | float) -> Floats:
    """Return values within bounds; np.clip takes three times as long for a few."""
    return np.minimum(np.maximum(values, lower), upper)


def bounded_least_squares(
    matrix: Floats,
    target: Floats,
    lower: Floats,
    upper: Floats,
    damping: float = 1e-6,
    preferred: Floats | float = 0.0,
) -> Floats:
    """
    Return u (m,) with matrix u = target, as near as bounds allow.

    min |A u - t|² + (damping |A|)² |u - preferred|² over lower <= u <= upper, where 0 is allowed.

    Parameters
    ----------
    matrix : (r, m)
    target : (r,)
    lower, upper : (m,)
    damping : float
        Part of the largest singular value below which a direction is hardly followed [1].
    preferred : (m,) or float
        Value of u along directions that the matrix does not determine.

    """
    damped = (damping * float(np.linalg.norm(matrix, 2))) ** 2 + 1e-12
    first = np.broadcast_to(preferred, lower.shape)
    normal = matrix.T @ matrix + damped * np.eye(len(lower))
    return solved(normal, -matrix.T @ target - damped * first, None, lower, upper)


def bounded_step(
    slopes: Floats,
    target: Floats,
    tensions: Floats,
    limits: Floats,
    damping: float = STEP_DAMPING,
    preferred: Floats | float = 0.0,
    signs: Floats | None = None,
) -> Floats:
    """
    Return tensions (m,) [N] within limits that move the tip by `target` with minimum change.

    Parameters
    ----------
    slopes : (3, m)
        Motion of the tip [m] over the ranges of the tensions.
    target : (3,) [m]
        Requested motion of the tip.
    tensions : (m,) [N]
        Before the step.
    limits : (m, 2) [N]
    damping : float
        See `bounded_least_squares`.
    preferred : (m,), optional
        Change that is made where the tip allows it [1] of the ranges; default: none.
    signs : (m,), optional
        1: a tension that may only rise, -1: only fall; default: both.

    """
    low, width = limits[:, 0], limits[:, 1] - limits[:, 0]
    u = (tensions - low) / width
    down, up = np.maximum(-u, -STEP_MAX), np.minimum(1.0 - u, STEP_MAX)
    if signs is not None:
        down, up = np.where(signs > 0.0, 0.0, down), np.where(signs > 0.0, up, 0.0)
    step = bounded_least_squares(slopes, target, down, up, damping, preferred)
    return low + within(u + step, 0.0, 1.0) * width
