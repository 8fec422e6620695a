"""
The marginal likelihood of whitened residuals whose imperfections are random.

residual = J (theta - theta0) + B b + noise, b ~ N(0, S), noise ~ N(0, 1): V = 1 + B S B'. One
standard deviation per kind of imperfection, estimated from the data under a half-normal prior.
Everything happens in the space of the columns (Woodbury), so that N does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .as_built import KINDS_WITH_FEW_MEMBERS, REMAINDER, Kind

Floats = npt.NDArray[np.float64]
SEARCH_STEPS_MAX = 25  # of the search for the standard deviations
DEVIANCE_GAIN_MIN = 0.02  # gain in -2 log likelihood at which it ends
START_SHARE = 0.5  # of the plausible sizes, where it begins


@dataclass(frozen=True)
class Sizes:
    """Standard deviations of the kinds, and what they are worth at a residual."""

    values: Floats  # (K,) [unit of the kind]
    deviance: float  # -2 log likelihood up to a constant, priors included, at the best parameters
    chi2: float  # r' V^-1 r at the best parameters


class RandomEffects:
    """Columns of imperfections, whitened by the noise, and the likelihood that they give."""

    def __init__(
        self, columns: Floats, owners: npt.NDArray[np.int64], kinds: Sequence[Kind]
    ) -> None:
        """
        Take the columns.

        Parameters
        ----------
        columns : (N, q)
            What a unit of each member does to the whitened residual.
        owners : (q,)
            Index of the kind of each column.
        kinds : (K,)
            Their half-normal priors; the last one is the remainder, whose prior is flat.

        """
        self.columns, self.owners, self.kinds = columns, owners, tuple(kinds)
        self.plausible = np.array([kind.plausible for kind in kinds])
        self.floors = np.zeros(len(kinds))

    @property
    def start(self) -> Floats:
        """Sizes (K,) to begin with: no remainder."""
        usual = np.where(np.isfinite(self.plausible), START_SHARE * self.plausible, 0.0)
        return np.asarray(np.maximum(usual, self.floors))

    def keep(self, base: Floats) -> None:
        """
        Let no effect lower the sizes of kinds with few members below those without any effect.

        Few numbers do not tell their own spread: an effect that stood for all of them would be
        paid for making it zero. What is implausibly large may fall to what is plausible.
        """
        few = np.array([kind.name in KINDS_WITH_FEW_MEMBERS for kind in self.kinds])
        self.floors = np.where(few, np.minimum(base, self.plausible), 0.0)

    @cached_property
    def gram(self) -> Floats:
        """Normal matrix (q, q) of the columns."""
        return np.asarray(self.columns.T @ self.columns)

    def spread(self, sizes: Floats) -> Floats:
        """Return the standard deviation (q,) of every member."""
        return np.asarray(sizes[self.owners])

    def log_determinant(self, sizes: Floats) -> float:
        """Return log |V|."""
        s = self.spread(sizes)
        inner = np.eye(len(s)) + s[:, None] * self.gram * s
        return float(2.0 * np.log(np.diag(np.linalg.cholesky(inner))).sum())

    def prior(self, sizes: Floats) -> float:
        """Return -2 log of the half-normal priors."""
        return float(np.sum((sizes / self.plausible) ** 2))

    def root(self, sizes: Floats) -> Floats:
        """Return the matrix A (q, q) with V^-1/2 = 1 - B A B'."""
        s = self.spread(sizes)
        values, vectors = np.linalg.eigh(s[:, None] * self.gram * s)
        x = np.maximum(values, 0.0)
        share = np.where(x > 1e-9, (1.0 - 1.0 / np.sqrt(1.0 + x)) / np.maximum(x, 1e-30), 0.5)
        return np.asarray(s[:, None] * ((vectors * share) @ vectors.T) * s)

    def members(self, sizes: Floats, residual: Floats) -> Floats:
        """Return the best imperfections b (q,) at a residual (N,)."""
        s = self.spread(sizes)
        inner = np.eye(len(s)) + s[:, None] * self.gram * s
        return np.asarray(s * np.linalg.solve(inner, s * (self.columns.T @ residual)))

    def intervals(self, sizes: Floats) -> tuple[Floats, Floats]:
        """Return 95 % intervals (K,) of the sizes, from the curvature of the likelihood."""
        work = _Work(self, np.zeros(len(self.columns)), np.zeros((len(self.columns), 0)), None)
        least = 1e-3 * np.where(np.isfinite(self.plausible), self.plausible, 1e-3)
        v = np.maximum(sizes, least) ** 2
        information = work.at(v)[2] * np.outer(v, v) + np.diag(v * work.precision)
        sd = np.sqrt(2.0 * np.diag(np.linalg.pinv(information, hermitian=True)))  # of log v
        reach = np.exp(np.minimum(0.5 * 1.96 * sd, 5.0))
        return np.where(sd < 2.5, np.sqrt(v) / reach, 0.0), np.minimum(
            np.sqrt(v) * reach, np.maximum(3.0 * self.plausible, 2.0 * sizes)
        )

    def estimate(
        self,
        residual: Floats,
        slopes: Floats,
        start: Floats | None = None,
        weights: Floats | None = None,
        remainder: bool = True,
    ) -> Sizes:
        """
        Maximise the likelihood over the standard deviations and linear parameters.

        Fisher scoring of the variances, bounded at zero, each step at least a descent.

        Parameters
        ----------
        residual : (N,)
        slopes : (N, k)
            Derivative of the residual by parameters that go along.
        start : (K,), optional
        weights : (k,), optional
            Precision of priors of the parameters at their present values.
        remainder : bool
            Whether there may be one.

        """
        work = _Work(self, residual, slopes, weights)
        sizes = self.start if start is None else np.asarray(start, dtype=float)
        low = self.floors**2
        v = np.maximum(sizes**2, low)
        free = np.array([remainder or kind.name != REMAINDER for kind in self.kinds])
        v[~free] = 0.0
        cost, gradient, information = work.at(v)
        for _ in range(SEARCH_STEPS_MAX):
            step = _step(v - low, np.where(free, gradient, np.inf), information)
            trial = None
            for _ in range(8):
                moved = np.maximum(v + step, low)
                trial = work.at(moved)
                if trial[0] < cost:
                    break
                step = 0.3 * step
                trial = None
            if trial is None:
                break
            gain = cost - trial[0]
            v, (cost, gradient, information) = moved, trial
            if gain < DEVIANCE_GAIN_MIN:
                break
        return Sizes(np.sqrt(v), cost, work.chi2(v))


def _step(room: Floats, gradient: Floats, information: Floats) -> Floats:
    """Fisher step (K,) of the variances; those without room that want to stay there do."""
    moving = ~((room <= 0.0) & (gradient >= 0.0))
    step = np.zeros(len(room))
    for _ in range(len(room)):
        index = np.flatnonzero(moving)
        if not len(index):
            return step
        part = information[np.ix_(index, index)]
        scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
        damped = part / np.outer(scale, scale) + 1e-6 * np.eye(len(index))
        step = np.zeros(len(room))
        step[index] = -np.linalg.solve(damped, gradient[index] / scale) / scale
        gone = moving & (room <= 0.0) & (step < 0.0)
        if not gone.any():
            break
        moving &= ~gone
    return step


class _Work:
    """Deviance, gradient and information of the variances, from small matrices only."""

    def __init__(
        self, random: RandomEffects, residual: Floats, slopes: Floats, weights: Floats | None
    ) -> None:
        self.gram, self.owners = random.gram, random.owners
        self.precision = 1.0 / random.plausible**2
        self.kinds = np.arange(len(random.kinds))[:, None] == random.owners[None]
        known = np.linalg.norm(slopes, axis=0)
        slopes = slopes[:, known > 1e-9] / known[known > 1e-9]
        more = np.column_stack([slopes, residual])
        self.cross = random.columns.T @ more  # (q, k + 1)
        self.inner = more.T @ more
        k = slopes.shape[1]
        prior = np.full(k, 1e-9) if weights is None else weights[known > 1e-9]
        self.ridge = prior / (1.0 if weights is None else known[known > 1e-9] ** 2)

    def _solved(self, v: Floats) -> tuple[Floats, Floats, Floats, float]:
        """B'V^-1 B, B'V^-1 [J, r], [J, r]'V^-1 [J, r], log |V|."""
        s = np.sqrt(v)[self.owners]
        used = np.flatnonzero(s > 0.0)
        g, c = self.gram, self.cross
        if not len(used):
            return g, c, self.inner, 0.0
        s = s[used]
        factor = np.linalg.cholesky(np.eye(len(s)) + s[:, None] * g[np.ix_(used, used)] * s)
        half = np.linalg.solve(factor, s[:, None] * np.column_stack([g[used], c[used]]))
        a, b = half[:, : len(g)], half[:, len(g) :]
        log = float(2.0 * np.log(np.diag(factor)).sum())
        return g - a.T @ a, c - a.T @ b, self.inner - b.T @ b, log

    def at(self, v: Floats) -> tuple[float, Floats, Floats]:
        """Deviance, its gradient (K,) by the variances, and the expected information (K, K)."""
        w, c, m, log = self._solved(v)
        best, chi2 = self._best(m)
        u = c[:, -1] - c[:, :-1] @ best
        per = self.kinds @ np.diag(w)
        gradient = per - self.kinds @ (u * u) + self.precision
        information = self.kinds @ (w * w) @ self.kinds.T
        return chi2 + log + float(v @ self.precision), gradient, information

    def _best(self, m: Floats) -> tuple[Floats, float]:
        """Return the best linear parameters and chi² there."""
        normal, right = m[:-1, :-1], m[:-1, -1]
        if not len(right):
            return right, float(m[-1, -1])
        best = np.linalg.solve(normal + np.diag(self.ridge), right)
        return best, float(m[-1, -1] - right @ best)

    def chi2(self, v: Floats) -> float:
        """r' V^-1 r at the best parameters."""
        return self._best(self._solved(v)[2])[1]
