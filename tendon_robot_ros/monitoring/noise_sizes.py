"""
How likely postures are under sizes of what is new in each of them, all sizes at once.

Linear postures y = C b + e: b are imperfections of 1 sd each, e is new in every posture, with the
covariance r^2 R + s^2 G G' + B B' + n^2 I of remainder, tensions as read, what is not linear, and
noise. A filter that learns posture by posture would find the same (chain rule); in one batch what
a size has no part in is worked out once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
# C (n, q), y (n,), B (n, k), and of R (n, n) eigenvalues (n,) and eigenvectors (n, n)
Posture = tuple[Floats, Floats, Floats, tuple[Floats, Floats]]


def log_likelihoods(
    postures: Sequence[Posture],
    gains: npt.NDArray[np.intp],
    noise: float,
    remainders: Sequence[float],
    settings: Sequence[float],
) -> Floats:
    """
    Return the log likelihood for every remainder and setting, up to a constant.

    Parameters
    ----------
    postures : sequence of (C, y, B, R)
        As above, in [m] where they are seen; R, as its eigenvalues and vectors, of 1 m.
    gains : (m,) of int
        Columns of C that are gains: G, a tension that is read wrongly is as one.
    noise : float
        1 sd of a coordinate [m].
    remainders, settings : sequence of float
        Sizes r [m] and s, 1 sd each.

    Returns
    -------
    ndarray, shape (remainders, settings)

    """
    turned = [_turned(posture, gains) for posture in postures]
    found = np.empty((len(remainders), len(settings)))
    for i, remainder in enumerate(remainders):
        parts = list(_under(turned, remainder, noise))
        both = np.sum([part[0] for part in parts], axis=0)  # of what is known (q + 1, q + 1)
        spread = sum(part[1] for part in parts)
        for j, setting in enumerate(settings):
            found[i, j] = _likelihood(both, spread, [part[2:] for part in parts], setting, gains)
    return found


def _turned(posture: Posture, gains: npt.NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
    """Return where R is diagonal, that diagonal, [C y] and [G B] there."""
    columns, off, bent, (sizes, axes) = posture
    known = np.column_stack([columns, off])
    return sizes.clip(0.0), axes.T @ known, axes.T @ np.column_stack([columns[:, gains], bent])


def _under(
    turned: Sequence[tuple[Floats, Floats, Floats]], remainder: float, noise: float
) -> Iterator[tuple[Floats, float, Floats, Floats]]:
    """Yield products of what is known, log det, products with [G B] and of it, of each posture."""
    for sizes, known, beside in turned:
        variance = remainder**2 * sizes + noise**2
        weighted = beside / variance[:, None]
        yield (
            known.T @ (known / variance[:, None]),
            float(np.log(variance).sum()),
            weighted.T @ known,
            weighted.T @ beside,
        )


def _likelihood(
    both: Floats,
    spread: float,
    beside: Sequence[tuple[Floats, Floats]],
    setting: float,
    gains: npt.NDArray[np.intp],
) -> float:
    """Take tensions as read and what is not linear into account (Woodbury), then b's own size."""
    taken = []
    for known, itself in beside:
        scale = np.ones(len(itself))
        scale[: len(gains)] = setting
        root = np.linalg.cholesky(np.eye(len(itself)) + scale[:, None] * itself * scale)
        spread += 2.0 * float(np.log(np.diag(root)).sum())
        taken.append(np.linalg.solve(root, scale[:, None] * known))
    stacked = np.vstack(taken)
    left = both - stacked.T @ stacked
    told, seen = np.eye(len(left) - 1) + left[:-1, :-1], left[:-1, -1]
    spread += float(np.linalg.slogdet(told)[1])
    return -0.5 * float(left[-1, -1] - seen @ np.linalg.solve(told, seen) + spread)
