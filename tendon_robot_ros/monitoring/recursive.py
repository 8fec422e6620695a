"""
A recursive estimate whose memory the data choose: Kalman filters side by side.

The state holds p parameters that may move slowly and q others that never do, in units of their
prior standard deviation. Before every measurement a filter forgets of the parameters

    P -> (l P^-1 + (1 - l) P0^-1)^-1,   0 < l <= 1,   P0 = 1,

as if part of what is known were exchanged for the prior (stabilised forgetting, Kulhavy and
Zarrop 1993): with l = 1 it is least squares, and however little the measurements say, P never
exceeds P0. Each filter has its own l, and its own size of what a model always gets wrong. Their
weights are their predictive likelihoods, the older ones raised to a power below 1, so that a
filter that was wrong long ago comes back (dynamic model averaging, Raftery, Karny, Ettler 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
MEMORIES = (1.0, 0.98, 0.9, 0.7)  # l: of all, of 50, of 10 and of 3 measurements
WEIGHT_MEMORY = 0.97  # power of a weight from one measurement to the next
LEAST_WEIGHT = 1e-6  # so that no filter is ever out


class _Filter:
    """A Kalman filter with one memory and one size of the remainder."""

    def __init__(self, memory: float, remainder: float, parameters: int, others: int) -> None:
        self.memory, self.remainder, self.p = memory, remainder, parameters
        self.mean, self.covariance = np.zeros(parameters + others), np.eye(parameters + others)

    def forget(self) -> None:
        """Exchange part of what is known of the parameters for the prior."""
        if self.memory == 1.0:
            return
        here = self.covariance[: self.p, : self.p]
        told = self.memory * np.linalg.inv(here) + (1.0 - self.memory) * np.eye(self.p)
        self.covariance[: self.p, : self.p] = np.linalg.inv(told)

    def learn(self, off: Floats, columns: Floats, noise: Floats) -> tuple[float, float]:
        """Take a residual (r,) around the mean; return predictive log likelihood and chi²."""
        shared = columns @ self.covariance
        root = np.linalg.cholesky(shared @ columns.T + noise)
        white = np.linalg.solve(root, off)
        gain = np.linalg.solve(root, shared)
        self.mean = self.mean + gain.T @ white
        self.covariance = self.covariance - gain.T @ gain
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        chi2 = float(white @ white)
        return -0.5 * chi2 - float(np.log(np.diag(root)).sum()), chi2

    def keep_within(self, low: Floats, high: Floats) -> None:
        """Bring parameters back to the nearest bound; what is tied to them follows."""
        for k in range(self.p):  # Simon 2006, eq. 7.94, one bound after the other
            off = self.mean[k] - np.clip(self.mean[k], low[k], high[k])
            if off != 0.0 and self.covariance[k, k] > 0.0:
                self.mean = self.mean - self.covariance[:, k] * (off / self.covariance[k, k])
        self.mean[: self.p] = np.clip(self.mean[: self.p], low, high)


class RecursiveEstimate:
    """Parameters that may move, beside others that do not; see the module."""

    def __init__(
        self,
        low: Floats,
        high: Floats,
        others: int = 0,
        remainders: Sequence[float] = (0.0,),
        memories: Sequence[float] = MEMORIES,
    ) -> None:
        """
        Know nothing but the prior: N(0, 1) each, parameters within bounds.

        Parameters
        ----------
        low, high : (p,) [prior sd]
            Bounds that no parameter leaves.
        others : int
            Number q of states that do not move.
        remainders : sequence of float
            1 sd of what the model always gets wrong [m]; each is tried.
        memories : sequence of float
            Shares l that are kept from one measurement to the next [1]; each is tried.

        """
        self.low, self.high = np.array(low, dtype=float), np.array(high, dtype=float)
        self._filters = [
            _Filter(memory, remainder, len(self.low), others)
            for memory, remainder in product(memories, remainders)
        ]
        self.weights = np.full(len(self._filters), 1.0 / len(self._filters))

    @property
    def mean(self) -> Floats:
        """Mean (p + q,) of all filters [prior sd]."""
        mean, p = self.weights @ np.array([f.mean for f in self._filters]), len(self.low)
        mean[:p] = np.clip(mean[:p], self.low, self.high)  # of values within: rounding alone
        return np.asarray(mean)

    @property
    def covariance(self) -> Floats:
        """Covariance (p + q, p + q) of all filters, what they differ by in it [prior sd²]."""
        mean, total = self.mean, 0.0
        for weight, one in zip(self.weights, self._filters, strict=True):
            off = one.mean - mean
            total = total + weight * (one.covariance + np.outer(off, off))
        return np.asarray(total)

    @property
    def memory(self) -> float:
        """Share that is kept from one measurement to the next, as the data have it [1]."""
        return float(self.weights @ [one.memory for one in self._filters])

    @property
    def remainder(self) -> float:
        """1 sd of what the model always gets wrong, as the data have it [m]."""
        return float(self.weights @ [one.remainder for one in self._filters])

    def learn(
        self, off: Floats, columns: Floats, noise: Floats, remainder: Floats | float = 0.0
    ) -> float:
        """
        Take a measurement.

        Parameters
        ----------
        off : (r,) [m]
            Measured minus predicted, at the present `mean`.
        columns : (r, p + q) [m per prior sd]
            How the state moves what is measured, there.
        noise : (r, r) [m²]
            Covariance of the measurement.
        remainder : (r, r), optional
            Covariance of what a model gets wrong that is off by 1 m.

        Returns
        -------
        float
            Least chi² of all filters: how badly the measurement fits at best.

        """
        at, told = self.mean, list[tuple[float, float]]()
        for one in self._filters:
            one.forget()
            spread = noise + one.remainder**2 * remainder
            told.append(one.learn(off - columns @ (one.mean - at), columns, spread))
            one.keep_within(self.low, self.high)
        logs = WEIGHT_MEMORY * np.log(self.weights) + np.array([log for log, _ in told])
        weights = np.exp(logs - logs.max())
        weights = weights / weights.sum() + LEAST_WEIGHT
        self.weights = weights / weights.sum()
        return min(chi2 for _, chi2 in told)

    def fits(self, off: Floats, columns: Floats, noise: Floats, remainder: Floats) -> float:
        """Return the least chi² (degrees of freedom: r) of a measurement, without taking it."""
        at, least = self.mean, np.inf
        for one in self._filters:
            known = one.covariance.copy()
            known[: one.p, : one.p] += np.eye(one.p)  # wherever the parameters are by now
            spread = columns @ known @ columns.T + noise + one.remainder**2 * remainder
            own = off - columns @ (one.mean - at)
            least = min(least, float(own @ np.linalg.solve(spread, own)))
        return least
