"""How large is what no model of the family explains: sizes by marginal likelihood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..comparison.noise import Noise, common_error, rms
from ..comparison.statistics import minimum
from ..data import DataSet

Floats = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
LOG_MIN, LOG_MAX = -6.0, 3.0  # logarithms of both sizes over that of all that is left
PRECISION = 0.1  # of these logarithms
ROUNDS = 2  # through the sizes, one after the other


def likely(
    dataset: DataSet,
    noise: Noise,
    slopes: Floats,
    off: Floats,
    held: Sequence[int] | npt.NDArray[np.int64] = (),
) -> tuple[float, float]:
    """
    Return the sizes [m] under which measured minus model `off` (P, J, 3) [m] is most likely.

    Of an error of every posture that grows along the arm, and of one of every marker (1 sd per
    coordinate), beside the noise: `accuracy` and `rough` of a `Whitener`.

    Parameters
    ----------
    slopes : (P, m, J, 3)
        Of `input_slopes`.
    held : sequence
        Postures that do not count.

    """
    seen = np.repeat(dataset.counts > 0, 3, axis=1)  # (P, 3 J)
    seen[list(held)] = False
    size = rms(np.where(seen.reshape(off.shape), off, np.nan)) / np.sqrt(3.0)
    left = _Left(dataset, noise, slopes, np.where(seen, off.reshape(seen.shape), 0.0), seen)
    best = [0.0, 0.0]
    for _ in range(ROUNDS):
        for i in range(len(best)):

            def along(x: float, i: int = i) -> float:
                return left.cost(*(size * np.exp([*best[:i], x, *best[i + 1 :]])))

            best[i], _ = minimum(along, LOG_MIN, LOG_MAX, PRECISION)
    smooth, rough = np.exp(best).tolist()
    return size * smooth, size * rough


class _Left:
    """What is left (P, 3 J) [m] of postures, where it was seen, and its covariance by noise."""

    def __init__(
        self, dataset: DataSet, noise: Noise, slopes: Floats, flat: Floats, seen: BoolArray
    ) -> None:
        P = len(flat)
        self.flat, self.seen, self.here = flat, seen, np.arange(flat.shape[1])
        self.own = noise.position**2 / np.repeat(np.maximum(dataset.counts, 1), 3, axis=1)
        share = noise.setting**2 + noise.trial**2 / np.maximum(dataset.trials, 1)
        driven = slopes.reshape(P, slopes.shape[1], -1)
        self.driven = driven.swapaxes(1, 2) @ (share[:, None, None] * driven)  # (P, 3 J, 3 J)
        self.common = common_error(dataset, self.here, 1.0)

    def cost(self, smooth: float, rough: float) -> float:
        """Return -2 log likelihood with errors of these sizes [m]."""
        seen, here = self.seen, self.here
        blocks = self.driven + smooth**2 * self.common
        blocks[:, here, here] += self.own + rough**2
        blocks = np.where(seen[:, :, None] & seen[:, None], blocks, 0.0)
        blocks[:, here, here] += ~seen
        root = np.linalg.cholesky(blocks)
        white = np.linalg.solve(root, self.flat[..., None])
        logs = np.log(np.diagonal(root, axis1=1, axis2=2))
        return float((white**2).sum() + 2.0 * logs.sum())
