"""A settled fit of freed parameters on whitened marker positions, and what it tells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .predict import Free
from .probability import chi2_sf, f_sf

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """A declared quantity that may move: a parameter with a prior (a - a0) / s."""

    quantity: str  # as under `tolerances`
    free: Free
    centre: float
    spread: float


@dataclass(frozen=True)
class Fit:
    """A settled fit; N whitened values, q parameters of which the last are nuisances."""

    frees: tuple[Free, ...]
    nuisances: tuple[Nuisance, ...]
    values: Floats  # (q,) SI
    residual: Floats  # (N + nuisances,) whitened measured minus model, prior rows last
    jacobian: Floats  # (N + nuisances, q) whitened derivative of the residual
    markers: Floats  # (P, J, 3) [m]

    @property
    def point(self) -> dict[Free, float]:
        """Values of all moved parameters."""
        return dict(zip(self.all_frees, self.values.tolist(), strict=True))

    @property
    def all_frees(self) -> tuple[Free, ...]:
        """Free parameters, then those of the nuisances."""
        return self.frees + tuple(n.free for n in self.nuisances)

    @property
    def chi2(self) -> float:
        """Sum of squares, prior rows included."""
        return float(self.residual @ self.residual)

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
        return len(self.residual) - len(self.nuisances) - self.rank

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (q, q) of the values; infinite diagonal where nothing determines them."""
        return covariance_of(self.jacobian)

    @property
    def pulls(self) -> dict[str, float]:
        """How many of its declared sd each quantity moved (of several, the most)."""
        moved: dict[str, float] = {}
        for nuisance, value in zip(self.nuisances, self.values[len(self.frees) :], strict=True):
            z = (value - nuisance.centre) / nuisance.spread
            if abs(z) > abs(moved.get(nuisance.quantity, 0.0)):
                moved[nuisance.quantity] = float(z)
        return moved

    def probability(self, noise_freedom: float) -> float:
        """Chance of so large a chi² if this model is true, the noise known that well."""
        if not np.isfinite(noise_freedom):
            return chi2_sf(self.chi2, self.freedom)
        return f_sf(self.chi2 / max(self.freedom, 1), self.freedom, noise_freedom)

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
        normal = self.jacobian.T @ self.jacobian
        root = np.linalg.pinv(_cholesky(normal))
        for p in np.unique(owners):
            rows = np.flatnonzero(owners == p)
            j, r = self.jacobian[rows], self.residual[rows]
            step = np.linalg.pinv(normal - j.T @ j, rcond=1e-12, hermitian=True) @ (j.T @ r)
            left = r + j @ step
            total += float(left @ left)
            share = np.clip(np.linalg.eigvalsh(root @ (j.T @ j) @ root.T), 0.0, 0.999)
            weights.append(1.0 / (1.0 - share) - (1.0 - share))
        w = np.concatenate(weights) if weights else np.zeros(0)
        if not w.sum() > 1e-9:
            return total, 1.0
        spread = float((w * w).sum() / w.sum())  # Satterthwaite: a scaled chi²
        excess = total - float(self.residual[: len(owners)] @ self.residual[: len(owners)])
        return total, chi2_sf(excess / spread, float(w.sum()) / spread)


def _cholesky(normal: Floats) -> Floats:
    """Lower factor of a normal matrix that may be singular."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    small = normal / np.outer(scale, scale) + 1e-12 * np.eye(len(normal))
    return np.asarray(scale[:, None] * np.linalg.cholesky(small))


def covariance_of(jacobian: Floats) -> Floats:
    """Inverse of the normal matrix, infinite for columns that carry no information."""
    scale = np.linalg.norm(jacobian, axis=0)
    blind = scale < 1e-9
    scaled = jacobian / np.where(blind, 1.0, scale)
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    made = inverse / np.outer(np.where(blind, 1.0, scale), np.where(blind, 1.0, scale))
    made[blind, blind] = np.inf
    return np.asarray(made)
