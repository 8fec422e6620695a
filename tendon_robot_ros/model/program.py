"""Bounded least squares and quadratic programs of a few tensions; the step of the tip by one."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Floats

# [1] of the largest slope: along directions of the tip with less, a step would ask for much
# tension
STEP_DAMPING = 0.1
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
    import daqp  # not before: what solves no program does without

    m, high = len(slope), upper
    if rows is None:
        rows = np.empty((0, m))
    else:
        high = np.concatenate([upper, np.full(len(rows), 1e30)])
    made, _, flag, _ = daqp.solve(matrix, slope, np.ascontiguousarray(rows), high, lower)
    return within(made, lower[:m], upper) if flag >= 1 else np.zeros(m)


def within(values: Floats, lower: Floats | float, upper: Floats | float) -> Floats:
    """Return values within bounds; np.clip takes three times as long for a few."""
    return np.minimum(np.maximum(values, lower), upper)


def bounded_least_squares(
    matrix: Floats,
    wanted: Floats,
    lower: Floats,
    upper: Floats,
    damping: float = 1e-6,
    preferred: Floats | float = 0.0,
) -> Floats:
    """
    Return u (m,) with matrix u = wanted, as near as bounds let it.

    min |A u - w|² + (damping |A|)² |u - preferred|² over lower <= u <= upper, where 0 is allowed.

    Parameters
    ----------
    matrix : (r, m)
    wanted : (r,)
    lower, upper : (m,)
    damping : float
        Part of the largest singular value below which a direction is hardly followed [1].
    preferred : (m,) or float
        What u is where the matrix says nothing of it.

    """
    damped = (damping * float(np.linalg.norm(matrix, 2))) ** 2 + 1e-12
    first = np.broadcast_to(preferred, lower.shape)
    normal = matrix.T @ matrix + damped * np.eye(len(lower))
    return solved(normal, -matrix.T @ wanted - damped * first, None, lower, upper)


def bounded_step(
    slopes: Floats,
    wanted: Floats,
    tensions: Floats,
    limits: Floats,
    damping: float = STEP_DAMPING,
    preferred: Floats | float = 0.0,
    signs: Floats | None = None,
) -> Floats:
    """
    Return the tensions (m,) [N] within limits that move the tip as wanted by the least change.

    Parameters
    ----------
    slopes : (3, m)
        Motion of the tip [m] over the ranges of the tensions.
    wanted : (3,) [m]
    tensions : (m,) [N]
        Where the step begins.
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
    made = bounded_least_squares(slopes, wanted, down, up, damping, preferred)
    return low + within(u + made, 0.0, 1.0) * width
