"""A settled fit of freed parameters on whitened marker positions, and what it tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..comparison.predict import FreeParameter
from ..comparison.statistics import chi2_sf, f_sf
from .as_built import Kind, Members
from .marginal import RandomEffects, Sizes

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """A declared quantity that may move: a parameter with a prior (a - a0) / s."""

    quantity: str  # as under `tolerances`
    free: FreeParameter
    centre: float
    spread: float


@dataclass(frozen=True)
class Scatter:
    """The imperfections of an arm as it is built, at a fit."""

    random: RandomEffects
    around: Members  # where they are taken as linear
    sizes: Floats  # (K,) estimated sd of each kind
    penalty: float  # log |V| and priors of the sizes: what chi² lacks to be a deviance
    estimate: Callable[..., Sizes]  # of the sizes again; takes `remainder` and `told`

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds, the remainder last."""
        return self.random.kinds


@dataclass(frozen=True)
class Fit:
    """
    A settled fit; N whitened values, q parameters: freed ones, nuisances, imperfections.

    Imperfections count as mixtures, in units of their estimated standard deviation.
    """

    frees: tuple[FreeParameter, ...]
    nuisances: tuple[Nuisance, ...]
    values: Floats  # (q,) SI
    residual: Floats  # (N + priors,) whitened measured minus model, prior rows last
    jacobian: Floats  # (N + priors, q) whitened derivative of the residual
    markers: Floats  # (P, J, 3) [m] of the model alone, without the imperfections
    built: Scatter | None = None  # None: the description is exact

    @property
    def point(self) -> dict[FreeParameter, float]:
        """Values of all moved parameters."""
        return dict(zip(self.all_frees, self.values.tolist(), strict=False))

    @property
    def all_frees(self) -> tuple[FreeParameter, ...]:
        """Freed parameters, then those of the nuisances."""
        return self.frees + tuple(n.free for n in self.nuisances)

    @property
    def chi2(self) -> float:
        """Sum of squares, prior rows included."""
        return float(self.residual @ self.residual)

    @property
    def members(self) -> dict[str, Floats] | None:
        """Most likely imperfections by kind [unit], without the remainder."""
        if self.built is None:
            return None
        return self.built.random.named(self.values[len(self.all_frees) :], self.built.sizes)

    @property
    def deviance(self) -> float:
        """Return -2 log marginal likelihood up to a constant: chi² where nothing is random."""
        return self.chi2 + (0.0 if self.built is None else self.built.penalty)

    @cached_property
    def remainder_gain(self) -> float:
        """Gain in deviance by a remainder that neither the model nor imperfections explain."""
        if self.built is None:
            return 0.0
        return max(self.built.estimate(remainder=False).deviance - self.deviance, 0.0)

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
        random = 0 if self.built is None else len(self.built.random.owners)
        priors = len(self.nuisances) + random
        return len(self.residual) - priors - self.rank

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (q, q) of the values; infinite diagonal where nothing determines them."""
        return covariance_of(self.jacobian)

    @property
    def prior_z(self) -> dict[str, float]:
        """How many of its declared sd each quantity moved (of several, the most)."""
        moved: dict[str, float] = {}
        for nuisance, value in zip(self.nuisances, self.values[len(self.frees) :], strict=False):
            z = (value - nuisance.centre) / nuisance.spread
            if abs(z) > abs(moved.get(nuisance.quantity, 0.0)):
                moved[nuisance.quantity] = float(z)
        return moved

    def probability(self, noise_freedom: float) -> float:
        """
        Chance of so large a chi² if this model is true, the noise known that well.

        Of an arm as built: of so large a remainder, if that is the more unlikely.
        """
        if not np.isfinite(noise_freedom):
            chance = chi2_sf(self.chi2, self.freedom)
        else:
            chance = f_sf(self.chi2 / max(self.freedom, 1), self.freedom, noise_freedom)
        if self.built is None:
            return chance
        return min(chance, 0.5 * chi2_sf(self.remainder_gain, 1))

    def held_out(self, owners: npt.NDArray[np.int64]) -> tuple[float, float]:
        """
        Predict each posture from the others (exact for a linear model).

        Returns
        -------
        chi2 : float
            Chi² of the left-out postures.
        probability : float
            Chance of so much more than the fitted chi² if this model is true: small where single
            postures bend the parameters to themselves.

        """
        total, weights = 0.0, []
        root, _ = covariance_root(self.jacobian)
        for p in np.unique(owners):
            rows = np.flatnonzero(owners == p)
            r = self.residual[rows]
            share, vectors = shares(self.jacobian[rows] @ root)
            only = share > 0.999  # nothing but the posture tells these
            share = np.clip(share, 0.0, 0.999)  # what the posture says of itself
            along = vectors.T @ r
            left = along / np.where(only, 1.0, 1.0 - share)
            total += float(r @ r - along @ along + left @ left)
            weights.append(1.0 / (1.0 - share) - (1.0 - share))
        w = np.concatenate(weights) if weights else np.zeros(0)
        if not w.sum() > 1e-9:
            return total, 1.0
        spread = float((w * w).sum() / w.sum())  # Satterthwaite: a scaled chi²
        excess = total - float(self.residual[: len(owners)] @ self.residual[: len(owners)])
        return total, chi2_sf(excess / spread, float(w.sum()) / spread)


def covariance_of(jacobian: Floats, blind: float = np.inf) -> Floats:
    """Inverse of the normal matrix, `blind` for columns that carry no information."""
    root, unseen = covariance_root(jacobian)
    made = root @ root.T
    made[unseen, unseen] = blind
    return np.asarray(made)


def covariance_root(jacobian: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Root R (q, d) of the inverse R R' of the normal matrix, and which columns tell nothing."""
    scale = np.linalg.norm(jacobian, axis=0)
    unseen = scale < 1e-9
    scale = np.where(unseen, 1.0, scale)
    values, vectors = np.linalg.eigh((jacobian / scale).T @ (jacobian / scale))
    told = values > 1e-13 * values.max(initial=0.0)
    root = vectors[:, told] / np.sqrt(values[told]) / scale[:, None]
    root[unseen] = 0.0
    return root, unseen


def shares(rows: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (d,) and vectors (n, d) of A A' for A (n, q), without those that are zero."""
    n, q = rows.shape
    if n <= q:
        values, vectors = np.linalg.eigh(rows @ rows.T)
        return values, vectors
    values, vectors = np.linalg.eigh(rows.T @ rows)
    told = values > 1e-15
    values = values[told]
    return values, rows @ (vectors[:, told] / np.sqrt(values))


def with_imperfections(plain: Fit, random: RandomEffects, sizes: Floats, around: Members) -> Fit:
    """Return a fit whose last parameters are the imperfections, at their most likely values."""
    n, spread = len(random.columns), random.spread(sizes)
    prior = np.append(np.full(len(plain.frees), 1e-9), [n.spread**-2 for n in plain.nuisances])

    def estimate(remainder: bool = True, told: bool = True) -> Sizes:
        raw, slopes = plain.residual[:n], plain.jacobian[:n]
        return random.estimate(raw, slopes, sizes, prior, remainder, told)

    scaled = random.columns * spread
    members = random.best(plain.residual[:n], sizes)
    off = plain.residual.copy()
    off[:n] -= scaled @ members
    q = plain.jacobian.shape[1]
    jacobian = np.zeros((len(off) + len(spread), q + len(spread)))
    jacobian[: len(off), :q] = plain.jacobian
    jacobian[:n, q:] = -scaled
    jacobian[len(off) :, q:] = np.eye(len(spread))
    scatter = Scatter(
        random,
        around,
        sizes,
        random.log_determinant(sizes) + random.prior(sizes),
        estimate,
    )
    return Fit(
        plain.frees,
        plain.nuisances,
        np.append(plain.values, members),
        np.append(off, members),
        jacobian,
        plain.markers,
        scatter,
    )
