"""A converged fit of freed parameters on whitened marker positions, and what it tells."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, null_space

from ..common.arrays import Bools, Floats, Ints
from .imperfections import ANEW, Kind, Members
from .marginal import Prior, RandomEffects, Sizes, root_inverse
from .predict import FreeParameter, SettledShapes, Tangent
from .statistics import QUANTILE, SIGNIFICANCE, chi2_sf, misfit_p_value

LEVERAGE_MAX = 0.999  # [1] of a value on its own prediction, else rounding would predict it
FREEDOM_MANY = 1e3  # [1] of a variance, because t and F are then their limits to three digits
CONDITION_MAX = 1e10  # [1] of normal matrices, else fewer than six digits would be left


@dataclass(frozen=True)
class Nuisance:
    """A declared quantity that a fit may change: a parameter with the prior (a - a0) / s."""

    quantity: str  # as under `tolerances`
    free: FreeParameter
    centre: float
    spread: float


@dataclass(frozen=True)
class Scatter:
    """The imperfections of an arm as it is built, at a fit; an exact arm has none of any kind."""

    random: RandomEffects
    around: Members  # where they are taken as linear
    sizes: Floats  # (K,) estimated sd of each kind
    penalty: float  # log |V| and priors of the sizes: deviance minus chi²
    raw: Floats  # (N,) whitened residual without them

    @classmethod
    def none(cls) -> Scatter:
        """Return that of an exact arm."""
        nothing = RandomEffects(np.zeros((0, 0)), np.zeros(0, dtype=np.int64), ())
        return cls(nothing, {}, nothing.start, 0.0, np.zeros(0))

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds, the remainder last."""
        return self.random.kinds


@dataclass(frozen=True)
class Fit:
    """
    A converged fit; N whitened values, q parameters: freed ones, nuisances, imperfections.

    Imperfections count as mixtures, in units of their estimated standard deviation.
    """

    frees: tuple[FreeParameter, ...]
    nuisances: tuple[Nuisance, ...]
    values: Floats  # (q,) SI
    residual: Floats  # (N + priors,) whitened measured minus model, prior rows last
    jacobian: Floats  # (N + priors, q) whitened derivative of the residual
    markers: Floats  # (P, J, 3) [m] of the model alone, without the imperfections
    built: Scatter = field(default_factory=Scatter.none)
    response: float = 0.0  # relative 1 sd of the model's response, where its error is known
    described: Floats | float = 0.0  # (k,) SI, of the freed parameters
    settled: SettledShapes | None = None  # its equilibria, from which those near it start
    tangent: Tangent | None = None  # their derivatives, or those of neighbours

    @property
    def as_built(self) -> bool:
        """Whether imperfections of the arm take part; else its description counts as exact."""
        return bool(self.built.kinds)

    @property
    def point(self) -> dict[FreeParameter, float]:
        """Values of all fitted parameters."""
        return dict(zip(self.all_frees, self.values.tolist(), strict=False))

    @property
    def all_frees(self) -> tuple[FreeParameter, ...]:
        """Freed parameters, then those of the nuisances."""
        return self.frees + tuple(n.free for n in self.nuisances)

    @property
    def one_sided(self) -> bool:
        """Whether its one parameter can only move to one side of the description."""
        ends = [(free.parameter.low, free.parameter.high) for free in self.frees]
        return len(ends) == 1 and np.atleast_1d(self.described)[0] in ends[0]

    @property
    def slopes(self) -> Floats:
        """Derivatives (N, k) of the whitened residual by the fitted parameters alone."""
        return self.jacobian[: len(self.built.raw), : len(self.all_frees)]

    @property
    def precisions(self) -> Floats:
        """Precision (k,) of the priors of the fitted parameters; of freed ones nearly zero."""
        return np.append(np.full(len(self.frees), 1e-9), [n.spread**-2 for n in self.nuisances])

    @property
    def chi2(self) -> float:
        """Sum of squares, prior rows included."""
        return float(self.residual @ self.residual)

    @property
    def members(self) -> dict[str, Floats]:
        """Most likely imperfections by kind [unit], without the remainder."""
        return self.built.random.named(self.values[len(self.all_frees) :], self.built.sizes)

    @property
    def anew(self) -> Members:
        """What was set anew in each of several recordings, or since a reference, by kind."""
        return {kind: own for kind, own in self.members.items() if kind in ANEW.values()}

    @property
    def spread(self) -> dict[str, Floats]:
        """
        Return how well the imperfections are known: kind -> (members, r) [unit].

        A root of their covariance: they are the likeliest ones plus it times r unit normals. In
        directions that do not show they are as uncertain as before.
        """
        random, sizes, first = self.built.random, self.built.sizes, len(self.all_frees)
        own = slice(first, first + len(random.others))
        values, vectors = np.linalg.eigh(self.covariance[own, own])
        seen = random.named(vectors * np.sqrt(np.maximum(values, 0.0)), sizes)
        if not seen:
            return {}
        kinds = zip(seen, random.mixtures, sizes.tolist(), strict=False)  # no remainder
        unseen = [null_space(mix.T) * size for _, mix, size in kinds]
        root = np.hstack([np.concatenate([*seen.values()]), block_diag(*unseen)])
        ends = np.cumsum([len(one) for one in seen.values()])[:-1]
        return dict(zip(seen, np.split(root, ends), strict=True))

    def started_from(self, around: Members, sizes: Floats) -> Fit:
        """Return the fit as a start of another one, from other imperfections."""
        return replace(self, built=replace(self.built, around=around, sizes=sizes))

    @property
    def deviance(self) -> float:
        """Return -2 log marginal likelihood up to a constant: chi² where nothing is random."""
        return self.chi2 + self.built.penalty

    def estimate(self, remainder: bool = True, prior: Prior = Prior.SIZES) -> Sizes:
        """Estimate the sizes of the imperfections anew; see `RandomEffects.estimate`."""
        built, known = self.built, (self.slopes, self.built.sizes, self.precisions)
        return built.random.estimate(built.raw, *known, remainder, prior)

    @cached_property
    def rank(self) -> int:
        """Number of free parameters that the data determine."""
        part = self.jacobian[:, : len(self.frees)]
        scale = np.linalg.norm(part, axis=0)
        part = part[:, scale > 1e-9] / scale[scale > 1e-9]
        return int(np.linalg.matrix_rank(part, tol=1e-6)) if part.size else 0

    @property
    def freedom(self) -> int:
        """Degrees of freedom: prior rows and nuisances cancel."""
        priors = len(self.nuisances) + len(self.built.random.owners)
        return len(self.residual) - priors - self.rank

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (q, q) of the values; infinite variance of undetermined ones."""
        return covariance_of(*self._root)

    @cached_property
    def _root(self) -> tuple[Floats, Bools]:
        return covariance_root(self.jacobian)

    @cached_property
    def interval_covariance(self) -> Floats:
        """
        Covariance (k, k) of the freed parameters whose 95 % intervals are 1.96 sd to each side.

        Of an arm as built the sizes of its imperfections are estimates themselves: the interval is
        that of the mixture over all that the data leave possible. A model that is known to be off
        by a share of what it moves is off by that share in what a change of a value does, too.
        """
        k, q = len(self.frees), len(self.all_frees)
        change = self.response * (self.values[:k] - self.described)
        known, plain = np.outer(change, change), self.covariance[:k, :k]
        if not self.as_built:
            return np.asarray(plain + known)
        random, sizes = self.built.random, self.built.sizes
        n, spread = len(random.columns), sizes[random.owners]
        raw = self.residual[:n] + (random.columns * spread) @ self.values[q:]
        mixture = random.mixture(raw, self.slopes, sizes, self.precisions)
        seen = np.isfinite(np.diag(plain))
        around = np.where(np.outer(seen, seen), mixture.covariance()[:k, :k], plain)
        sd = np.sqrt(np.diag(around))
        told = mixture.half_widths(1.0 - SIGNIFICANCE)[:k] / QUANTILE
        tails = np.divide(told, sd, where=seen & (sd > 0.0), out=np.ones(k))
        return np.asarray(around * np.outer(tails, tails) + known)

    @property
    def undetermined(self) -> list[FreeParameter]:
        """Parameters of single tendons or sections that may be anything, the loosest first."""
        sd, loose = np.sqrt(np.diag(self.covariance)), dict[FreeParameter, float]()
        for free, half in zip(self.frees, (QUANTILE * sd).tolist(), strict=False):
            share = half / (free.parameter.high - free.parameter.low)
            if free.column is not None and share >= 1.0:
                loose[free] = share
        alone = Counter(free.effect for free in self.frees)
        return sorted((f for f in loose if alone[f.effect] > 1), key=lambda f: -loose[f])

    @property
    def prior_z(self) -> dict[str, float]:
        """Change of each quantity in its declared sd [1]; the largest of several."""
        moved: dict[str, float] = {}
        for nuisance, value in zip(self.nuisances, self.values[len(self.frees) :], strict=False):
            z = (value - nuisance.centre) / nuisance.spread
            if abs(z) > abs(moved.get(nuisance.quantity, 0.0)):
                moved[nuisance.quantity] = float(z)
        return moved

    def probability(self, noise_freedom: float) -> float:
        """
        Return the p-value of the chi² of this model, the noise estimated with this freedom.

        Of an arm as built the p-value of the remainder, where that is smaller.
        """
        chance = misfit_p_value(self.chi2, self.freedom, noise_freedom)
        gain = self.estimate(remainder=False).deviance - self.deviance
        return min(chance, 0.5 * chi2_sf(gain, 1)) if gain > 0.0 else chance

    def held_out(self, owners: Ints) -> tuple[float, float]:
        """
        Predict each posture from the others (exact for a linear model).

        Returns
        -------
        chi2 : float
            Chi² of the left-out postures.
        probability : float
            P-value of its excess over the fitted chi²: small where single postures determine
            the parameters.

        """
        n = len(owners)
        residual, hat_root = self.residual[:n], self.jacobian[:n] @ self._root[0]
        deleted, (weight, weight2) = left_out(residual, hat_root, owners)
        total = float(deleted @ deleted)
        if not weight > 1e-9:
            return total, 1.0
        spread = weight2 / weight  # Satterthwaite: a scaled chi²
        excess = total - float(residual @ residual)
        return total, chi2_sf(excess / spread, weight / spread)


def left_out(
    residual: Floats, hat_root: Floats, owners: Ints, least: float = 1.0
) -> tuple[Floats, Floats]:
    """
    Leave out what has one owner, in turn, and predict it from the rest: the closed form.

    Exact where the model is linear, with the hat matrix H = A A', A (N, q) `hat_root`, the block g
    of an owner: (1 - H_gg)^-1 r_g (Cook and Weisberg 1982).

    Returns
    -------
    deleted : (N,)
        Residuals of the predictions.
    weights : (2,)
        Sum of their weights, the eigenvalues of (1 - H)^-1 - (1 - H), and of the squares of these.
        In directions that no other owner determines 1 - H counts as `least`, and without it is
        the fitted residual.

    """
    deleted, weights = np.empty_like(residual), np.zeros(2)
    order = np.argsort(owners, kind='stable')
    counts = np.unique(owners, return_counts=True)[1]
    first = np.cumsum(counts) - counts
    for count in np.unique(counts).tolist():
        rows = order[first[counts == count, None] + np.arange(count)]  # (G, n)
        leverage, vectors = gram_eigen(hat_root[rows])
        apart = 1.0 - np.minimum(leverage, LEVERAGE_MAX)
        grown = 1.0 / np.where(leverage > LEVERAGE_MAX, least, apart)
        along = residual[rows][:, None] @ vectors
        more = vectors @ ((grown - 1.0)[:, None] * along).swapaxes(1, 2)
        deleted[rows] = residual[rows] + more[..., 0]
        w = 1.0 / apart - apart
        weights += w.sum(), (w * w).sum()
    return deleted, weights


def covariance_of(root: Floats, unseen: Bools, blind: float = np.inf) -> Floats:
    """Inverse (q, q) of the normal matrix, `blind` the variance of columns that are zero."""
    inverse = root @ root.T
    inverse[unseen, unseen] = blind
    return np.asarray(inverse)


def covariance_root(jacobian: Floats) -> tuple[Floats, Bools]:
    """Root R (q, d) of the inverse R R' of the normal matrix, and which columns (q,) are zero."""
    scale = np.linalg.norm(jacobian, axis=0)
    unseen = scale < 1e-9
    scaled = jacobian[:, ~unseen] / scale[~unseen]
    normal = scaled.T @ scaled
    root = np.zeros((len(scale), len(normal)))
    try:
        upper = root_inverse(normal).T
        if (upper * upper).sum() * len(normal) < CONDITION_MAX:
            root[~unseen] = upper / scale[~unseen, None]
            return root, unseen
    except np.linalg.LinAlgError:
        pass
    values, vectors = np.linalg.eigh(normal)
    kept = values > 1e-13 * values.max(initial=0.0)
    root[~unseen] = vectors / np.sqrt(np.where(kept, values, 1.0)) / scale[~unseen, None]
    return root[:, kept], unseen


def gram_eigen(rows: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (G, d) and vectors (G, n, d) of A A' for A (G, n, q); those of zero are zero."""
    across = rows.swapaxes(1, 2)
    if rows.shape[1] <= rows.shape[2]:
        return np.linalg.eigh(rows @ across)
    values, vectors = np.linalg.eigh(across @ rows)
    scale = np.where(values > 1e-15, 1.0 / np.sqrt(np.maximum(values, 1e-15)), 0.0)
    return values, rows @ (vectors * scale[:, None])


def with_imperfections(plain: Fit, random: RandomEffects, sizes: Floats, around: Members) -> Fit:
    """Return a fit whose last parameters are the imperfections, at their most likely values."""
    n, spread, q = len(random.columns), sizes[random.owners], plain.jacobian.shape[1]
    scaled, raw = random.columns * spread, plain.residual[:n]
    members = random.best(raw, sizes)
    off = plain.residual.copy()
    off[:n] -= scaled @ members
    jacobian = np.zeros((len(off) + len(spread), q + len(spread)))
    jacobian[: len(off), :q] = plain.jacobian
    jacobian[:n, q:] = -scaled
    jacobian[len(off) :, q:] = np.eye(len(spread))
    penalty = random.log_determinant(sizes) + random.prior(sizes)
    return replace(
        plain,
        values=np.append(plain.values, members),
        residual=np.append(off, members),
        jacobian=jacobian,
        built=Scatter(random, around, sizes, penalty, raw),
    )
