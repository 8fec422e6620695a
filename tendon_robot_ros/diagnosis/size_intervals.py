"""Between which sizes the scatter of a kind lies: those of which what is found is not rare."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..comparison.statistics import chi2_sf
from .likelihood import Likelihood
from .marginal import LEAST_SHARE, SIZE_MAX, RandomEffects

Floats = npt.NDArray[np.float64]
NODES = 14  # sizes of a kind, evenly spaced by their logarithms, at which its estimate is known
TAIL = 0.025  # chance beyond each end
ENDS_WITHIN = 1e-3  # of an end
HARDLY_SHOWN, ALL_SHOWN = 1e-12, 1.0 - 1e-9  # share v / (v + n) that counts, at least, at most


class SizeIntervals:
    """
    How the estimate of the size of each kind is distributed, whatever its true size.

    The estimate of a variance v is spread with the variance 2 / J(v), J the expected information
    that is left of it beside the other kinds and the parameters. It acts as the mean of g squared
    deviations of a variance v + n, of which n is noise, taken off: J = g / (v + n)² (Satterthwaite
    1946, at every v). An interval holds the sizes of which the found one is no rare estimate
    (Neyman 1937): how well a size is told counts where it is tried. At a found size near zero
    noise tells nothing of how far up the true one may be, at the sizes that are tried it does.
    """

    def __init__(
        self,
        random: RandomEffects,
        sizes: Floats,
        slopes: Floats | None = None,
        weights: Floats | None = None,
    ) -> None:
        """
        Take imperfections, and the sizes (K,) at which the other kinds are, each in turn.

        Slopes (N, k) of parameters that go along, and the precision (k,) of their priors, are as
        in `RandomEffects.estimate`.
        """
        rows, parts = len(random.columns), random.parts
        slopes = np.zeros((rows, 0)) if slopes is None else slopes
        if parts.kind is not None and sizes[parts.kind] == 0.0:
            parts = replace(parts, kind=None)
        work = Likelihood(parts, np.zeros(rows), slopes, weights, prior=0)
        usual = np.where(np.isfinite(random.plausible), random.plausible, 0.0)
        others = np.maximum(sizes, 0.1 * LEAST_SHARE * usual) ** 2
        self._kinds = []
        for k, plausible in enumerate(random.plausible.tolist()):
            shows = np.isfinite(plausible) and bool((random.owners == k).any())
            shares = np.geomspace(LEAST_SHARE, 2.0 * SIZE_MAX, NODES)
            grid = (shares * plausible) ** 2 if shows else np.zeros(0)
            self._kinds.append(_Estimate.of(work, others, k, grid))

    def ends(self, found: Floats) -> tuple[Floats, Floats]:
        """
        Return the 95 % intervals (K,) of the sizes of which `found` (K,) are the estimates.

        The lower end is zero where a size of `LEAST_SHARE` of what is plausible is no rare cause;
        the upper one infinite where no size up to twice `SIZE_MAX` is a rare one.
        """
        pairs = [own.ends(value) for own, value in zip(self._kinds, found.tolist(), strict=True)]
        low, high = np.array(pairs).T
        return low, high


class _Estimate:
    """The estimate of one variance: its deviations and its noise, as they go with the true one."""

    def __init__(self, grid: Floats, freedom: Floats, noise: Floats) -> None:
        """Take logarithms of true variances (n,), and those of g (n,) and of the noise (n,)."""
        self.grid, self.freedom, self.noise = grid, freedom, noise

    @classmethod
    def of(cls, work: Likelihood, others: Floats, k: int, grid: Floats) -> _Estimate:
        """Tell how well each variance (n,) of a kind would be told beside the others (K,)."""
        told = np.zeros(len(grid))  # information of its logarithm
        for i, own in enumerate(grid.tolist()):
            v = others.copy()
            v[k] = own
            information = work.slopes(v).information * np.outer(v, v)
            length = np.sqrt(np.maximum(np.diag(information), 0.0))
            if length[k] > 0.0:
                each = np.where(length > 0.0, length, 1.0)
                alike = np.linalg.pinv(information / np.outer(each, each), hermitian=True)
                told[i] = length[k] ** 2 / alike[k, k]
        if not len(grid) or told.min() <= 0.0:
            return cls(np.zeros(0), told, told)
        logs = np.log(grid)
        share = (1.0 - 0.5 * np.gradient(np.log(told), logs)).clip(HARDLY_SHOWN, ALL_SHOWN)
        return cls(logs, np.log(told / share**2), logs + np.log(1.0 / share - 1.0))

    def chance(self, estimate: float, log: float) -> float:
        """Return the chance of at least an estimated variance where the true one is so."""
        true, freedom, noise = np.exp(
            [log, np.interp(log, self.grid, self.freedom), np.interp(log, self.grid, self.noise)]
        ).tolist()
        return chi2_sf(freedom * (estimate + noise) / (true + noise), freedom)

    def ends(self, size: float) -> tuple[float, float]:
        """Return the interval of the size whose estimate is `size`."""
        if not len(self.grid):
            return 0.0, np.inf
        low, high = (self._size(size**2, tail) for tail in (TAIL, 1.0 - TAIL))
        return low, high

    def _size(self, estimate: float, tail: float) -> float:
        """Return the size of which at least such an estimate has a chance; see `ends`."""
        low, high = float(self.grid[0]), float(self.grid[-1])
        if tail < 0.5 and self.chance(estimate, low) > tail:
            return 0.0
        if self.chance(estimate, high) < tail:
            return np.inf if tail > 0.5 else float(np.exp(0.5 * high))
        while high - low > ENDS_WITHIN:
            middle = 0.5 * (low + high)
            if self.chance(estimate, middle) < tail:
                low = middle
            else:
                high = middle
        return float(np.exp(0.25 * (low + high)))
