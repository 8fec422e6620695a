"""
The marginal likelihood of whitened residuals whose imperfections are random.

residual = J (theta - theta0) + B b + noise, b ~ N(0, S), noise ~ N(0, 1): V = 1 + B S B'. One
standard deviation per kind of imperfection, estimated under a prior around a plausible size.
Everything happens in the space of the columns (Woodbury), so that N does not matter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from ..common.arrays import Floats, Ints
from ..common.estimation import STEP_LENGTHS
from .imperfections import EARLIER, KINDS_WITH_FEW_MEMBERS, REMAINDER, Imperfections, Kind, Members
from .noise import Whitener
from .statistics import normal_cdf

NEGLIGIBLE = 0.01  # [1] of a plausible size, or of the noise, because nobody measures so little
SIZE_MAX = 5.0  # [1] of a plausible size, because what scatters more is no imperfection
STEPS_MAX = 25  # [1] of a damped search, else one that creeps would not end
DEVIANCE_GAIN_MIN = 0.02  # [1] of a step, because a likelihood ratio of 1 % decides nothing
STEP_MAX = 2.0  # [1] of the logarithm of a variance, else a flat likelihood would send it away
CURVATURE_MIN = 0.05  # [1] of the deviance by logarithms, else a flat one would make steps endless
ROOTS_KEPT = 4  # [1] because a fit goes back and forth between few sets of sizes
PLAUSIBLE_FACTOR = 2.0  # [1] 1 sd to which a plausible size is right, because arms differ by that
NODES = 64  # [1] sets of sizes over which an interval is the mean, so that it is known to 4 %
UNIT_LOGISTIC = math.sqrt(3.0) / math.pi  # [1] scale of a logistic, because its sd is then 1
RIDGE = 1e-10  # [1] of scaled normal matrices, else rounding would be divided by rounding
# [1] curvature of -2 log prior by log s², because log s is normal
LOG_PRECISION = 0.5 / math.log(PLAUSIBLE_FACTOR) ** 2


class Prior(IntEnum):
    """
    Prior of a size s around the plausible size p.

    None; s exp(-s²/p²) ds; or log s normal around log p with the sd log `PLAUSIBLE_FACTOR`.
    """

    NONE = 0
    SIZES = 1
    LOGARITHMS = 2


def root_inverse(matrix: Floats) -> Floats:
    """
    Return L^-1 (n, n), lower triangular, of L L' = matrix.

    Raises
    ------
    LinAlgError
        The matrix is not positive definite.

    """
    if not len(matrix):
        return matrix
    root, failed = dpotrf(matrix, lower=1)
    if failed:
        raise np.linalg.LinAlgError('the matrix is not positive definite')
    return np.asarray(dtrtri(root, lower=1)[0])


def prior_of(ratios: Floats, of: Prior = Prior.SIZES) -> float:
    """Return -2 log prior of the sizes of all kinds from shares (s/p)², up to a constant."""
    logs = np.log(ratios[ratios > 0.0])
    if of is Prior.LOGARITHMS:
        return float(0.5 * LOG_PRECISION * (logs @ logs))
    return float(of * (2.0 * ratios.sum() - logs.sum()))


@dataclass(frozen=True)
class _Reduced:
    """
    Small matrices at given variances; the remainder is part of the noise, V = D + X S X'.

    o: columns of the other kinds, d: those of the remainder, k: parameters, and the residual.
    """

    own: Floats  # (o, o) X'D^-1 X
    more: Floats  # (o, k + 1) X'D^-1 [parameters, residual]
    factor: Floats  # (o, o) inverse of the triangular root of 1 + S X'D^-1 X S, times S
    through: Floats  # (o, k + 1) factor times more
    normal: Floats  # (k + 1, k + 1) [parameters, residual]'V^-1 [parameters, residual]
    shrunk: Floats  # (d,) 1 / (1 + gain)
    log: float  # log |V|


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the deviance by the variances."""

    gradient: Floats  # (K,)
    information: Floats  # (K, K) expected of the gradient, priors of the variances included
    curvature: Floats  # (K, K) second derivative where it is, with these residuals


class Likelihood:
    """
    Deviance, gradient and information of the variances, from small matrices only.

    The columns of the remainder are independent of each other: they count as noise of their own
    (V = D + B S B'), only the others are eliminated.
    """

    def __init__(
        self,
        random: RandomEffects,
        residual: Floats,
        slopes: Floats,
        weights: Floats | None,
        prior: Prior = Prior.SIZES,
        remainder: bool = True,
    ) -> None:
        """
        Take products of a residual (N,) and its slopes (N, k), whose priors weigh (k,).

        Without a `remainder` the size of that kind is zero, and has no slopes.

        Unless effects compete (`Prior.SIZES`) the likelihood is restricted: of the data without
        the part that determines the parameters (REML, Patterson and Thompson 1971).
        """
        self.restricted = prior is not Prior.SIZES
        self.prior, self.precision = prior, float(prior > 0) / random.around(prior) ** 2
        self.kind, self.owners = random.remainder if remainder else None, random.others
        self.kinds = np.equal.outer(np.arange(len(random.kinds)), self.owners).astype(float)
        self.own, self.own_last, self.size2 = random.products
        lengths = np.linalg.norm(slopes, axis=0)
        self.shown, self.lengths = lengths > 1e-9, lengths[lengths > 1e-9]
        more = np.column_stack([slopes[:, self.shown] / self.lengths, residual])
        self.more, self.more_last = np.split(random.columns.T @ more, [len(self.owners)])
        self.inner = more.T @ more
        flat = np.full(len(self.lengths), 1e-9)
        given = flat if weights is None else weights[self.shown] / self.lengths**2
        self.ridge = np.diag(given)
        self._at: tuple[Floats, _Reduced] | None = None
        self._beside: tuple[float, tuple[Floats, Floats, Floats, Floats, float]] | None = None

    def _reduced(self, v: Floats) -> _Reduced:
        """Return the matrices at variances (K,); those of the last variances are kept."""
        if self._at is not None and np.array_equal(self._at[0], v):
            return self._at[1]
        variance = 0.0 if self.kind is None else float(v[self.kind])
        if self._beside is None or self._beside[0] != variance:
            self._beside = variance, self._beside_remainder(variance)
        own, more, inner, shrunk, log = self._beside[1]
        s = np.sqrt(v)[self.owners]
        root = root_inverse(np.eye(len(s)) + s[:, None] * own * s)
        log = log - 2.0 * float(np.log(np.diag(root)).sum())
        factor = root * s
        through = factor @ more
        normal = inner - through.T @ through
        reduced = _Reduced(own, more, factor, through, normal, shrunk, log)
        self._at = (v.copy(), reduced)
        return reduced

    def _beside_remainder(self, variance: float) -> tuple[Floats, Floats, Floats, Floats, float]:
        """Return `own`, `more`, `inner`, `shrunk` and the log |V| of a remainder alone."""
        gain = variance * self.size2
        shrunk = 1.0 / (1.0 + gain)
        scaled = variance * shrunk * self.own_last
        own, more = self.own - scaled @ self.own_last.T, self.more - scaled @ self.more_last
        inner = self.inner - (self.more_last.T * (variance * shrunk)) @ self.more_last
        return own, more, inner, shrunk, float(np.log1p(gain).sum())

    def deviance(self, v: Floats) -> float:
        """-2 log likelihood with priors, at the best parameters."""
        at = self._reduced(v)
        cost = self._best(at.normal)[1] + at.log + prior_of(v * self.precision, self.prior)
        if self.restricted:
            cost -= 2.0 * float(np.linalg.slogdet(self._root(at.normal))[1])
        return cost

    def slopes(self, v: Floats) -> Slopes:
        """
        Return gradient and curvature, the parameters optimal.

        With P the projection of V^-1 beside the parameters: `rise` tr(X'V^-1 X), restricted
        tr(X'P X), `observed` |X'P r|² of each kind, and its slopes u'X'P X u (Johnson and Thompson
        1995).
        """
        at, kinds = self._reduced(v), self.kinds
        half = at.factor @ at.own
        best, _ = self._best(at.normal)
        ahead = np.append(-best, 1.0)
        w, m = at.own - half.T @ half, at.more - half.T @ at.through
        root = self._root(at.normal)
        fitted = m[:, :-1] @ root.T
        beside = w - fitted @ fitted.T  # X'P X
        expected = beside if self.restricted else w
        u = m @ ahead
        rise, observed = kinds @ np.diag(expected), kinds @ (u * u)
        information, along = kinds @ (expected * expected) @ kinds.T, kinds * u
        turned = along @ beside @ along.T
        if self.kind is not None:
            k, (cross_all, own_all, more) = self.kind, self._last(at, half)
            mine, own_fitted = more @ ahead, more[:, :-1] @ root.T
            cross, own = cross_all - fitted @ own_fitted.T, own_all - own_fitted @ own_fitted.T
            across = along @ (cross @ mine)
            turned[k] += across
            turned[:, k] += across
            turned[k, k] = mine @ own @ mine
            if not self.restricted:
                cross, own = cross_all, own_all
            both = np.square(cross).sum(axis=1)
            rise[k], observed[k] = np.trace(own), mine @ mine
            information[k] += kinds @ both
            information[:, k] += kinds @ both
            information[k, k] = np.square(own).sum()
        steady, pull, bend = self._prior_slopes(v)
        push = pull / np.maximum(v, 1e-300)
        proper = np.diag((push + bend / np.maximum(v, 1e-300)) / np.maximum(v, 1e-300))
        gradient = rise + steady - push - observed
        return Slopes(gradient, information + proper, 2.0 * turned - information + proper)

    def _prior_slopes(self, v: Floats) -> tuple[Floats, Floats, Floats]:
        """Return slopes (K,) of the prior: steady by v; minus by log v, and how that bends."""
        ratios = v * self.precision
        proper = (self.precision > 0.0).astype(float)
        if self.prior is Prior.LOGARITHMS:
            logs = np.log(np.where(ratios > 0.0, ratios, 1.0))
            return 0.0 * v, -LOG_PRECISION * logs, LOG_PRECISION * proper
        return 2.0 * self.precision, proper, 0.0 * v

    def parameters(self, v: Floats) -> tuple[Floats, Floats]:
        """Return the best parameters (k,) at variances (K,), and their covariance (k, k)."""
        at = self._reduced(v)
        root = np.zeros((len(at.normal) - 1, len(self.shown)))
        root[:, self.shown] = self._root(at.normal) / self.lengths
        best = np.zeros(len(self.shown))
        best[self.shown] = -self._best(at.normal)[0] / self.lengths
        return best, root.T @ root

    def _last(self, at: _Reduced, half: Floats) -> tuple[Floats, Floats, Floats]:
        """
        Return the remainder's columns D through V^-1, the others X being eliminated.

        X'V^-1 D (o, d), D'V^-1 D (d, d), and D'V^-1 [parameters, residual] (d, k + 1).
        """
        crossed = self.own_last * at.shrunk  # (o, d)
        mine = at.factor @ crossed
        more = at.shrunk[:, None] * self.more_last - mine.T @ at.through
        own = np.diag(self.size2 * at.shrunk) - mine.T @ mine
        return crossed - half.T @ mine, own, more

    def _root(self, m: Floats) -> Floats:
        """Return R (k, k), R'R the inverse of the normal matrix of the parameters."""
        if len(m) < 2:
            return np.zeros((0, 0))
        values, vectors = np.linalg.eigh(m[:-1, :-1] + self.ridge)
        return np.asarray((vectors / np.sqrt(np.maximum(values, RIDGE))).T)

    def _best(self, m: Floats) -> tuple[Floats, float]:
        """Return the best linear parameters and chi² there."""
        normal, right = m[:-1, :-1], m[:-1, -1]
        if not len(right):
            return right, float(m[-1, -1])
        best = np.linalg.solve(normal + self.ridge, right)
        return best, float(m[-1, -1] - right @ best)


@dataclass(frozen=True)
class Sizes:
    """Standard deviations of the kinds, and their deviance at a residual."""

    values: Floats  # (K,) [unit of the kind]
    deviance: float  # -2 log likelihood up to a constant, priors included, at the best parameters


@dataclass(frozen=True)
class Mixture:
    """Parameters under n possible sets of sizes: each a normal distribution, with its weight."""

    weights: Floats  # (n,) sum to 1
    shifts: Floats  # (n, k) from the values at the likeliest sizes
    covariances: Floats  # (n, k, k)

    def covariance(self) -> Floats:
        """Return the second moments (k, k) about the values at the likeliest sizes."""
        moments = self.covariances + self.shifts[:, :, None] * self.shifts[:, None]
        return np.asarray(np.tensordot(self.weights, moments, 1))

    def half_widths(self, share: float) -> Floats:
        """Return how far (k,) to both sides of those values a share of the distribution lies."""
        sd = np.sqrt(np.maximum(np.einsum('nii->ni', self.covariances), 1e-300))
        low, high = np.zeros(sd.shape[1]), (np.abs(self.shifts) + 10.0 * sd).max(axis=0)
        while (high - low > 1e-4 * high).any():
            middle = 0.5 * (low + high)
            above, below = ((side * middle - self.shifts) / sd for side in (1.0, -1.0))
            less = self.weights @ (normal_cdf(above) - normal_cdf(below)) < share
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        return np.asarray(high)


class RandomEffects:
    """
    Imperfections, whitened by the noise, and their marginal likelihood.

    Of each kind only observable directions are kept: mixtures of its members by singular vectors.
    Members of a kind share one variance, so mixtures have the same variance.

    Where effects compete the prior of a size s with the plausible value p is s exp(-s²/p²)
    (Rayleigh), never zero. Few members do not determine their spread, and the likelihood would
    reward an effect that makes it small: there the size of kinds with few members is fixed at the
    plausible one.
    """

    def __init__(self, columns: Floats, owners: Ints, kinds: Sequence[Kind]) -> None:
        """
        Take the columns.

        Parameters
        ----------
        columns : (N, q)
            Derivative of the whitened residual by each member.
        owners : (q,)
            Index of the kind of each column.
        kinds : (K,)
            Their priors; the last one is the remainder, whose prior is flat.

        """
        self.kinds = tuple(kinds)
        self.plausible = np.array([kind.plausible for kind in kinds], dtype=float)
        self.together = np.hypot(self.plausible, [kind.beside for kind in kinds])
        own = [columns[:, owners == k] for k in range(len(kinds))]
        self.mixtures = [_mixture(c, p) for c, p in zip(own, self.plausible, strict=True)]
        mixed = [c @ mix for c, mix in zip(own, self.mixtures, strict=True)]
        self.columns = np.hstack([columns[:, :0], *mixed])
        self.owners = np.repeat(np.arange(len(kinds)), [mix.shape[1] for mix in self.mixtures])
        self.few = np.array([kind.name in KINDS_WITH_FEW_MEMBERS for kind in kinds], dtype=bool)
        self.known = np.array([kind.name == EARLIER for kind in kinds], dtype=bool)
        is_last = bool(kinds) and kinds[-1].name == REMAINDER
        self.remainder = len(kinds) - 1 if is_last else None  # which of the kinds it is
        self.others = self.owners[self.owners < len(kinds) - is_last]  # of its columns: the first
        self._roots: dict[bytes, Floats] = {}  # of the last sizes

    @classmethod
    def of(cls, built: Imperfections, whitener: Whitener) -> RandomEffects:
        """Return those of an arm, by the slopes of the markers; an exact one has no kinds."""
        return cls(whitener.white(built.moves).T, built.owners, built.kinds)

    @property
    def start(self) -> Floats:
        """Initial sizes (K,), without a remainder."""
        usual = np.where(np.isfinite(self.plausible), 0.5 * self.plausible, 0.0)
        return np.where(self.few, self.plausible, usual)

    @cached_property
    def _basis(self) -> tuple[Floats, Floats]:
        """Orthonormal basis (N, d) of the columns, and the columns in it (d, r)."""
        basis, triangle = np.linalg.qr(self.columns)
        return basis, triangle

    @cached_property
    def _last(self) -> Floats:
        """Columns (d, N) of the remainder."""
        return np.ascontiguousarray(self.columns[:, len(self.others) :].T)

    @cached_property
    def products(self) -> tuple[Floats, Floats, Floats]:
        """Products (o, o) of the other columns, (o, d) with the remainder's, (d,) of its own."""
        own, last = self.columns[:, : len(self.others)], self._last
        return own.T @ own, own.T @ last.T, (last * last).sum(axis=1)

    def around(self, prior: Prior) -> Floats:
        """Return the sizes (K,) around which a prior lies; infinite where it is flat."""
        return self.together if prior is Prior.LOGARITHMS else self.plausible

    def named(self, units: Floats, sizes: Floats) -> dict[str, Floats]:
        """Return members by kind, without the remainder, from mixtures (r, ...) in units of sd."""
        owners = self.owners[: len(units)]  # those of the remainder, the last, may be missing
        values = (units.T * sizes[owners]).T
        return {
            kind.name: self.mixtures[k] @ values[owners == k]
            for k, kind in enumerate(self.kinds)
            if kind.name != REMAINDER
        }

    def best(self, residual: Floats, sizes: Floats) -> Floats:
        """Return the most likely mixtures (r,), in units of their sd, at a residual (N,)."""
        basis, triangle = self._basis
        inverse = self.root(sizes)
        n = len(inverse)
        along = basis[:, :n].T @ residual
        along += inverse @ along
        along += inverse.T @ along
        return np.asarray(sizes[self.owners] * (triangle[:n].T @ along))

    def freedom(self, shift: Floats, sizes: Floats) -> float:
        """
        Return the degrees of freedom behind the variance of a shift (N,) of the markers.

        The variance of the amplitude of a shift m, 1 / m'V^-1 m, depends on the estimated sizes;
        the degrees of freedom correspond to its uncertainty (Satterthwaite 1946). They are few
        where the shift resembles imperfections of a kind whose size the data hardly determine, and
        infinite where only noise matters.
        """
        spread = sizes[self.owners]
        along = np.divide(self.best(shift, sizes), spread, where=spread > 0.0, out=0.0 * spread)
        turned = np.bincount(self.owners, along**2, len(self.kinds))
        known = np.flatnonzero((sizes > 0.0) & ~self.few)  # the other sizes are fixed
        work = Likelihood(self, np.zeros_like(shift), np.zeros((len(shift), 0)), None)
        information = work.slopes(sizes**2).information[np.ix_(known, known)]
        spread_of_sizes = 2.0 * np.linalg.pinv(information, hermitian=True)  # of the variances
        variance = float(turned[known] @ spread_of_sizes @ turned[known])
        lifted = self.lift(self.root(sizes), shift)
        size = float(lifted @ lifted)
        return 2.0 * size**2 / variance if variance > 0.0 else np.inf

    def _bounds(self, prior: Prior) -> tuple[Floats, Floats]:
        """Return the least and largest variances (K,) under a prior."""
        around = self.around(prior)
        usual = np.where(np.isfinite(around), around, 0.0)
        fixed = self.few if prior is Prior.SIZES else self.known
        low = np.where(fixed, usual, NEGLIGIBLE * usual)
        return low**2, np.where(fixed, usual, SIZE_MAX * around) ** 2

    def mixture(
        self, residual: Floats, slopes: Floats, sizes: Floats, weights: Floats | None = None
    ) -> Mixture:
        """
        Return the distribution of parameters over the sizes that the data leave possible.

        Sets of sizes are drawn around the likeliest ones (K,), by the curvature there, and weighed
        by their likelihood and prior within the bounds of `estimate` (importance sampling); always
        the same ones. A remainder keeps its size. The other arguments are those of `estimate`.
        """
        work, v = Likelihood(self, residual, slopes, weights, Prior.LOGARITHMS), sizes**2
        low, high = self._bounds(Prior.LOGARITHMS)
        free = np.flatnonzero(np.isfinite(self.plausible) & (sizes > 0.0) & ~self.known)
        here, own = work.slopes(v), v[free]
        bend = here.curvature[np.ix_(free, free)] * np.outer(own, own)
        values, vectors = np.linalg.eigh(bend + np.diag(own * here.gradient[free]))
        # symmetric, so that no sign of an eigenvector decides what is drawn
        root = vectors * np.sqrt(2.0 / np.maximum(values, LOG_PRECISION)) @ vectors.T
        ranks = (np.arange(NODES) + 0.5) / NODES
        strata = np.tile(ranks, (len(free), 1))  # of a Latin hypercube
        chances = np.random.default_rng(0).permuted(strata, axis=1).T
        draws = UNIT_LOGISTIC * np.log(chances / (1.0 - chances))  # its tails are long
        logs = -np.log(chances * (1.0 - chances)).sum(axis=1)
        best, at_best = work.parameters(v)
        shifts, covariances = [], []
        for i, draw in enumerate(draws):
            tried = v.copy()
            tried[free] *= np.exp(root @ draw)
            inside = (low <= tried).all() and (tried <= high).all()
            logs[i] -= 0.5 * work.deviance(tried) if inside else np.inf
            there, covariance = work.parameters(tried)
            shifts.append(there - best)
            covariances.append(covariance)
        if not np.isfinite(logs).any():  # all beyond the bounds: the likeliest sizes alone
            return Mixture(np.ones(1), np.zeros((1, len(best))), at_best[None])
        weights = np.exp(logs - logs.max())
        return Mixture(weights / weights.sum(), np.array(shifts), np.array(covariances))

    def misfit(self, errors: Floats, sizes: Floats) -> float:
        """Return the chi² of errors (N,) under noise and remainder alone."""
        length2 = self.products[2]
        gain = sizes[-1:] ** 2 * length2
        along = (self._last @ errors) ** 2 / np.maximum(length2, 1e-300)
        return float(errors @ errors - (along * gain / (1.0 + gain)).sum())

    def cost(self, members: Members, sizes: Floats) -> float:
        """Return the sum of squares of members in their sd: -2 log prior up to a constant."""
        total = 0.0
        for kind, size in zip(self.kinds, sizes.tolist(), strict=True):
            if kind.name in members:
                sd = max(size, NEGLIGIBLE * kind.plausible)
                total += float(np.sum((members[kind.name] / sd) ** 2))
        return total

    def log_determinant(self, sizes: Floats) -> float:
        """Return log |V|."""
        return float(-2.0 * np.log1p(np.diag(self.root(sizes))).sum())

    def prior(self, sizes: Floats) -> float:
        """Return -2 log of the priors of the sizes, up to a constant."""
        return prior_of((sizes / self.plausible) ** 2)

    def root(self, sizes: Floats) -> Floats:
        """Return A (n, n) of `lift`, for the columns up to the last one with a size above zero."""
        key = sizes.tobytes()
        root = self._roots.get(key)
        if root is None:
            spread = sizes[self.owners]
            used = int(np.flatnonzero(spread)[-1]) + 1 if spread.any() else 0
            scaled = self._basis[1][:used, :used] * spread[:used]
            inverse = root_inverse(np.eye(len(scaled)) + scaled @ scaled.T)
            root = inverse - np.eye(len(inverse))
            self._roots = dict([*self._roots.items()][1 - ROOTS_KEPT :]) | {key: root}
        return root

    def lift(self, root: Floats, rows: Floats) -> Floats:
        """Remove from rows (N, ...) what imperfections explain: W rows with W'W = V^-1."""
        basis = self._basis[0][:, : len(root)]
        return np.asarray(rows + basis @ (root @ (basis.T @ rows)))

    def estimate(
        self,
        residual: Floats,
        slopes: Floats,
        start: Floats | None = None,
        weights: Floats | None = None,
        remainder: bool = True,
        prior: Prior = Prior.SIZES,
    ) -> Sizes:
        """
        Maximise the likelihood over the standard deviations and linear parameters.

        Newton's method on the logarithms of the variances, bounded, each step a descent.

        Parameters
        ----------
        residual : (N,)
        slopes : (N, k)
            Derivative of the residual by parameters that are fitted along.
        start : (K,), optional
        weights : (k,), optional
            Precision of the priors of the parameters, centred at their present values.
        remainder : bool
            Whether a remainder may be larger than what is allowed of its kind.
        prior : Prior
            With `NONE` the data alone determine the sizes. Effects compete with the likeliest
            sizes (`SIZES`), those of kinds with few members fixed: they are too often too small
            where few members determine them. Values are told with `LOGARITHMS`.

        """
        work = Likelihood(self, residual, slopes, weights, prior)
        sizes = self.start if start is None else np.asarray(start, dtype=float)
        low, high = self._bounds(prior)
        if not remainder and self.remainder is not None:
            low[self.remainder] = 0.0
            high[self.remainder] = self.kinds[self.remainder].allowed ** 2
        v = np.clip(sizes**2, low, high)
        cost, offset = work.deviance(v), np.zeros(len(v))
        shows = np.linalg.norm(self.products[2])
        if self.remainder is not None and shows > 0.0:  # it may be zero: a variance that shows
            offset[self.remainder] = 1.0 / shows  # is added before the logarithm
        for _ in range(STEPS_MAX):
            step, promised = _step(v - low, high - v, v + offset, work.slopes(v))
            if promised < DEVIANCE_GAIN_MIN:
                break
            for fraction in STEP_LENGTHS:
                new = np.clip((v + offset) * np.exp(fraction * step) - offset, low, high)
                deviance = work.deviance(new)
                if deviance < cost:
                    break
            gain = cost - deviance
            if gain > 0.0:
                v, cost = new, deviance
            if gain < DEVIANCE_GAIN_MIN:
                break
        return Sizes(np.sqrt(v), cost)


def _mixture(columns: Floats, plausible: float) -> Floats:
    """Return the observable independent directions (q, r) of a kind."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    limit = (NEGLIGIBLE / plausible) ** 2 if np.isfinite(plausible) else 0.0
    return np.asarray(vectors[:, values > max(limit, 1e-14 * values.max(initial=0.0))][:, ::-1])


def _step(down: Floats, up: Floats, stretch: Floats, slopes: Slopes) -> tuple[Floats, float]:
    """
    Return the Newton step (K,) of the logarithms, and its predicted gain.

    Variances at a bound stay if the gradient points outwards; `stretch` is dv / d log v. Negative
    curvature counts as positive.
    """
    gradient = slopes.gradient
    pressed = ((down <= 0.0) & (gradient >= 0.0)) | ((up <= 0.0) & (gradient <= 0.0))
    index, step = np.flatnonzero(~pressed & (stretch > 0.0)), np.zeros(len(down))
    if not len(index):
        return step, 0.0
    t = stretch[index]
    along = t * gradient[index]
    bend = slopes.curvature[np.ix_(index, index)] * np.outer(t, t) + np.diag(along)
    values, vectors = np.linalg.eigh(bend)
    own = -vectors @ ((vectors.T @ along) / np.maximum(np.abs(values), CURVATURE_MIN))
    own *= STEP_MAX / max(STEP_MAX, float(np.abs(own).max()))
    step[index] = own
    return step, float(-along @ own)
