"""
The likelihood of variances from small matrices: its value, gradient and expected information.

V = 1 + B S B' as in `marginal`; everything happens in the space of the columns (Woodbury), so that
N does not matter once their products are taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
LEAF = 32  # [1] rows of a triangle that is inverted as it is
NORMAL_LEAST = 1e-12  # of the parameters, each of them scaled to move the residual by one
SIZES, LOGARITHMS = 1, 2  # what is likeliest: s exp(-s²/p²) ds = s² exp(-s²/p²) d log s


def root_inverse(matrix: Floats) -> Floats:
    """
    Return L^-1 (n, n), lower triangular, of L L' = matrix.

    A triangle is inverted in a sixth of what `numpy.linalg.inv` takes; that of scipy is no faster,
    and importing it takes a tenth of a second or two.

    Raises
    ------
    LinAlgError
        The matrix is not positive definite.

    """
    return _inverse_of_triangle(np.linalg.cholesky(matrix))


def _inverse_of_triangle(lower: Floats) -> Floats:
    n = len(lower)
    if n <= LEAF:
        return np.linalg.inv(lower)
    half, inverse = n // 2, np.zeros_like(lower)
    inverse[:half, :half] = _inverse_of_triangle(lower[:half, :half])
    inverse[half:, half:] = _inverse_of_triangle(lower[half:, half:])
    below = inverse[half:, half:] @ (lower[half:, :half] @ inverse[:half, :half])
    inverse[half:, :half] = -below
    return inverse


def prior_of(share: Floats, of: int = SIZES) -> float:
    """Return -2 log (s exp(-s²/p²)) of all kinds from shares (s/p)², up to a constant."""
    proper = share[share > 0.0]
    return float(2.0 * share.sum() - of * np.log(proper).sum())


@dataclass(frozen=True)
class Columns:
    """Products of the columns of all kinds: those of the remainder (d) and the others (o)."""

    all: Floats  # (N, o + d)
    plausible: Floats  # (K,) sizes of the kinds; infinite: the prior is flat
    kind: int | None  # the remainder's
    others: npt.NDArray[np.intp]  # (o,) columns
    last: npt.NDArray[np.intp]  # (d,)
    owners: npt.NDArray[np.int64]  # (o,) kinds
    kinds: Floats  # (K, o) 1 where a column is of the kind
    own: Floats  # (o, o) normal matrix
    own_last: Floats  # (o, d)
    size2: Floats  # (d,) squared lengths


@dataclass(frozen=True)
class _Reduced:
    """
    What a set of variances makes of the small matrices, the remainder counted as noise: V = D + ..

    o: columns of the other kinds, d: those of the remainder, k: parameters, and the residual.
    """

    own: Floats  # (o, o) X'D^-1 X
    more: Floats  # (o, k + 1) X'D^-1 [parameters, residual]
    inner: Floats  # (k + 1, k + 1) of these themselves
    factor: Floats  # (o, o) inverse of the triangular root of 1 + S X'D^-1 X S, times S
    shrunk: Floats  # (d,) 1 / (1 + gain)
    log: float  # log |V|


@dataclass(frozen=True)
class _Last:
    """The columns of the remainder (d) through V^-1."""

    cross: Floats  # (o, d) X'V^-1 D
    own: Floats  # (d, d) D'V^-1 D
    more: Floats  # (d, k) D'V^-1 [parameters]
    u: Floats  # (d,) D'V^-1 of the residual beside the best parameters


@dataclass(frozen=True)
class Slopes:
    """How the deviance goes with the variances."""

    gradient: Floats  # (K,)
    information: Floats  # (K, K) expected of the gradient, priors of the variances included
    curvature: Floats  # (K, K) second derivative where it is, with these residuals
    slower: Floats  # (K,) variances that are no worse, and often hardly better


class Likelihood:
    """
    Deviance, gradient and information of the variances, from small matrices only.

    The columns of the remainder are independent of each other: they count as noise of their own
    (V = D + B S B'), only the others are eliminated.
    """

    def __init__(
        self,
        columns: Columns,
        residual: Floats,
        slopes: Floats,
        weights: Floats | None,
        prior: int = SIZES,
    ) -> None:
        """
        Take products of a residual (N,) and its slopes (N, k), whose priors weigh (k,).

        Sizes have a prior, of them or their logarithms, or (`prior` 0) the data alone say them:
        what they leave beside the parameters (restricted, Patterson and Thompson 1971).
        """
        self.restricted = prior == 0
        self.prior, self.precision = prior, float(prior > 0) / columns.plausible**2
        self.proper = np.where(np.isfinite(columns.plausible), prior, 0)
        self.kind, self.owners, self.kinds = columns.kind, columns.owners, columns.kinds
        self.own, self.own_last, self.size2 = columns.own, columns.own_last, columns.size2
        known = np.linalg.norm(slopes, axis=0)
        slopes = slopes[:, known > 1e-9] / known[known > 1e-9]
        more = np.column_stack([slopes, residual])
        cross = columns.all.T @ more
        self.more, self.more_last = cross[columns.others], cross[columns.last]
        self.inner = more.T @ more
        k = slopes.shape[1]
        given = np.full(k, 1e-9) if weights is None else weights[known > 1e-9]
        self.ridge = np.diag(given / (1.0 if weights is None else known[known > 1e-9] ** 2))
        self._at: tuple[Floats, _Reduced] | None = None

    def _reduced(self, v: Floats) -> _Reduced:
        """Return what variances (K,) make of the matrices; kept until others are asked for."""
        if self._at is not None and np.array_equal(self._at[0], v):
            return self._at[1]
        own, more, inner, log = self.own, self.more, self.inner, 0.0
        shrunk = np.ones(len(self.size2))
        if self.kind is not None and v[self.kind] > 0.0:
            gain = v[self.kind] * self.size2
            shrunk, log = 1.0 / (1.0 + gain), float(np.log1p(gain).sum())
            taken = self.own_last * (v[self.kind] * shrunk)
            own, more = own - taken @ self.own_last.T, more - taken @ self.more_last
            inner = inner - (self.more_last.T * (v[self.kind] * shrunk)) @ self.more_last
        s = np.sqrt(v)[self.owners]
        root = root_inverse(np.eye(len(s)) + s[:, None] * own * s)
        log -= 2.0 * float(np.log(np.diag(root)).sum())
        reduced = _Reduced(own, more, inner, root * s, shrunk, log)
        self._at = (v.copy(), reduced)
        return reduced

    def deviance(self, v: Floats) -> float:
        """-2 log likelihood with priors, at the best parameters."""
        at = self._reduced(v)
        half = at.factor @ at.more
        normal = at.inner - half.T @ half
        cost = self._best(normal)[1] + at.log + prior_of(v * self.precision, self.prior)
        if self.restricted:
            cost -= 2.0 * float(np.linalg.slogdet(self._root(normal))[1])
        return cost

    def slopes(self, v: Floats) -> Slopes:
        """
        Return gradient, curvature and a step that cannot fail, of the best parameters everywhere.

        With P what V^-1 is beside the parameters: rise tr(X'V^-1 X), restricted tr(X'P X), found
        |X'P r|² of each kind, and its slopes u'X'P X u (Johnson and Thompson 1995). The step is
        minorise-maximise of variance components: slow, but always a descent.
        """
        at, kinds = self._reduced(v), self.kinds
        half, through = at.factor @ at.own, at.factor @ at.more
        normal = at.inner - through.T @ through
        best, _ = self._best(normal)
        ahead = np.append(-best, 1.0)
        w, m = at.own - half.T @ half, at.more - half.T @ through
        root = self._root(normal)
        taken = m[:, :-1] @ root.T
        beside = w - taken @ taken.T  # X'P X
        told = beside if self.restricted else w
        u = m @ ahead
        rise, found = kinds @ np.diag(told), kinds @ (u * u)
        information, along = kinds @ (told * told) @ kinds.T, kinds * u
        turned = along @ beside @ along.T
        if self.kind is not None:
            last = self._last(at, half, through, ahead)
            k, mine, own_taken = self.kind, last.u, last.more @ root.T
            cross, own = last.cross - taken @ own_taken.T, last.own - own_taken @ own_taken.T
            across = along @ (cross @ mine)
            turned[k] += across
            turned[:, k] += across
            turned[k, k] = mine @ own @ mine
            if not self.restricted:
                cross, own = last.cross, last.own
            both = np.square(cross).sum(axis=1)
            rise[k], found[k] = np.trace(own), mine @ mine
            information[k] += kinds @ both
            information[:, k] += kinds @ both
            information[k, k] = np.square(own).sum()
        rise += 2.0 * self.precision
        push = self.proper / np.maximum(v, 1e-300)  # away from zero
        proper = np.diag(push / np.maximum(v, 1e-300))
        rise = np.maximum(rise, 1e-300)
        apart = np.sqrt(self.proper**2 + 4.0 * rise * v**2 * found)
        slower = (self.proper + apart) / (2.0 * rise)
        gradient = rise - push - found
        return Slopes(gradient, information + proper, 2.0 * turned - information + proper, slower)

    def _last(self, at: _Reduced, half: Floats, through: Floats, ahead: Floats) -> _Last:
        """Return what the columns of the remainder are, once the others are eliminated."""
        crossed = self.own_last * at.shrunk  # (o, d)
        mine = at.factor @ crossed
        more = at.shrunk[:, None] * self.more_last - mine.T @ through
        own = np.diag(self.size2 * at.shrunk) - mine.T @ mine
        return _Last(crossed - half.T @ mine, own, more[:, :-1], more @ ahead)

    def _root(self, m: Floats) -> Floats:
        """Return R (k, k), R'R the inverse of the normal matrix of the parameters."""
        if len(m) < 2:
            return np.zeros((0, 0))
        values, vectors = np.linalg.eigh(m[:-1, :-1] + self.ridge)
        return np.asarray((vectors / np.sqrt(np.maximum(values, NORMAL_LEAST))).T)

    def _best(self, m: Floats) -> tuple[Floats, float]:
        """Return the best linear parameters and chi² there."""
        normal, right = m[:-1, :-1], m[:-1, -1]
        if not len(right):
            return right, float(m[-1, -1])
        best = np.linalg.solve(normal + self.ridge, right)
        return best, float(m[-1, -1] - right @ best)
