"""One quadratic program with bounds, and the step of the tip that is one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
STEP_DAMPING, STEP_MAX = 0.1, 0.03  # [1] of the largest slope, of a range: one step of the tip
STEP_SHARE = 0.5  # [1] of what the tip is off, in one step of a loop that sees it


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


def bounded_step(
    slopes: Floats,
    wanted: Floats,
    tensions: Floats,
    limits: Floats,
    damping: float = STEP_DAMPING,
    least: Floats | None = None,
    signs: Floats | None = None,
) -> Floats:
    """
    Return the tensions (m,) [N] within limits that move the tip as wanted by the least change.

    min |J u - w|² + (damping |J|)² |u - least|², with u the change in shares of the ranges.

    Parameters
    ----------
    slopes : (3, m)
        Motion of the tip [m] over the ranges of the tensions.
    wanted : (3,) [m]
    tensions : (m,) [N]
        Where the step begins.
    limits : (m, 2) [N]
    damping : float
        Share of the largest slope below which a direction of the tip is hardly followed [1].
    least : (m,), optional
        Change that is made where the tip allows it [1] of the ranges; default: none.
    signs : (m,), optional
        1: a tension that may only rise, -1: only fall; default: both.

    """
    low, width = limits[:, 0], limits[:, 1] - limits[:, 0]
    u = (tensions - low) / width
    size = float(np.linalg.norm(slopes, 2))
    damped = (damping * size) ** 2 + 1e-12
    first = np.zeros(len(u)) if least is None else least
    down, up = np.maximum(-u, -STEP_MAX), np.minimum(1.0 - u, STEP_MAX)
    if signs is not None:
        down, up = np.where(signs > 0.0, 0.0, down), np.where(signs > 0.0, up, 0.0)
    matrix = slopes.T @ slopes + damped * np.eye(len(u))
    made = solved(matrix, -slopes.T @ wanted - damped * first, None, down, up)
    return low + within(u + made, 0.0, 1.0) * width
