"""
What acts on the arm now: the force at its tip, and whether something touches it elsewhere.

The measured shape is compared with what the model says under the measured tensions and a force at
the tip. What the arm as built does by itself is as known as `BuiltArm` knows it: its imperfections
shift what is expected, and what is not known of them is noise that all markers share. Without a
tracker, wire pulls take the place of the markers.

    r = y - f(T; F) - B b,   V = B P B' + remainder + noise,
    F += (J' V^-1 J)^-1 J' V^-1 r   (Gauss-Newton)

A force at another cell joins where it lowers r' V^-1 r by more than chance does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..comparison.predict import FreeParameter, free_parameters
from ..comparison.statistics import chi2_isf
from ..diagnosis.slopes import pushes
from .built_arm import BuiltArm

Floats = npt.NDArray[np.float64]
EFFECT = 'tip_load'
ROUNDS_MAX = 12  # of Gauss-Newton
SETTLED_SD = 0.05  # sd of the force that the last step may move it
STEP_SHARE = 0.02  # of a typical force, of a difference
PRIOR_SHARE = 10.0  # of a typical force: 1 sd of a direction that nothing tells
FALSE_CONTACT_PROBABILITY = 1e-4
ODD_PROBABILITY = 0.05  # of what is left, below which a force elsewhere is looked for
PULL_ERROR = 0.02, 1e-4  # [1] of a wire pull, and [m]: what a model of it may be off


@dataclass(frozen=True)
class TipForce:
    """The force at the tip in the base frame."""

    force: Floats  # (3,) [N]
    covariance: Floats  # (3, 3) [N²]
    chi2: float  # of what is left, and its degrees of freedom
    freedom: int
    cell: int | None = None  # counted from 1 at the base: where something touches besides
    contact: Floats | None = None  # (3,) [N] the force there

    @property
    def acts(self) -> bool:
        """Whether it is more than noise: outside its 99.9 % ellipsoid around none."""
        return float(self.force @ np.linalg.solve(self.covariance, self.force)) > chi2_isf(1e-3, 3)


class TipForceObserver:
    """Estimates the force again and again; each time from the last one."""

    def __init__(self, arm: BuiltArm, pull_noise: float = 2e-5) -> None:
        """
        Stand on an arm; effects that its description lacks are taken for a force.

        Parameters
        ----------
        arm : BuiltArm
        pull_noise : float
            1 sd of a measured wire pull [m].

        """
        self.arm, self.pull_noise = arm, pull_noise
        self._frees = free_parameters(arm.catalogue[EFFECT], arm.robot)
        self._described = np.array([arm.whole.value(free) for free in self._frees])
        self._typical = self._frees[0].parameter.typical
        self._last = np.zeros(3)

    def update(
        self, tensions: Floats, positions: Floats | None, pulls: Floats | None = None
    ) -> TipForce | None:
        """
        Estimate the force.

        Parameters
        ----------
        tensions : (m,) [N]
            As measured.
        positions : (J, 3) [m], optional
            As measured, nan where a marker was not seen; without any the pulls are taken.
        pulls : (m,) [m], optional
            As measured, from the straight arm on.

        Returns
        -------
        TipForce, or None where the model has no equilibrium, or nothing was measured.

        """
        inputs = np.maximum(tensions, 0.0)[None]
        markers = positions is not None and bool(np.isfinite(positions).any())
        measured = positions if markers else pulls
        if measured is None or not np.isfinite(measured).any():
            return None
        for start in (self._last, np.zeros(3)):
            task = _Fit(self, inputs, measured.ravel(), markers, start)
            found = task.solve()
            if found is not None:
                self._last = found.force
                return found
        return None

    def point(self, force: Floats) -> dict[FreeParameter, float]:
        """Return the parameters of the model under a force."""
        values = (self._described + force).tolist()
        return dict(zip(self._frees, values, strict=True))

    def shown(self, force: Floats, inputs: Floats, markers: bool) -> Floats | None:
        """Markers (3 J,) [m], or wire pulls (m,) [m], that the model has under a force."""
        whole = self.arm.whole
        ((_, shapes),) = whole.settle(self.point(force), inputs)
        if shapes is None:
            return None
        return whole.see(shapes).ravel() if markers else np.array(shapes.pulls[0])

    @property
    def step(self) -> float:
        """Step [N] of a difference."""
        return STEP_SHARE * self._typical

    @property
    def prior(self) -> float:
        """1 sd [N] of a direction that nothing tells."""
        return PRIOR_SHARE * self._typical


class _Fit:
    """One estimate: what was measured, and the noise around the force where it began."""

    def __init__(
        self,
        observer: TipForceObserver,
        inputs: Floats,
        measured: Floats,
        markers: bool,
        start: Floats,
    ) -> None:
        self.observer, self.inputs, self.markers, self.start = observer, inputs, markers, start
        self.rows = np.isfinite(measured)
        self.measured = measured
        self.shift: Floats | float = 0.0

    def solve(self) -> TipForce | None:
        """Return the force; None where a model has no equilibrium."""
        force, observer = self.start.copy(), self.observer
        prior = observer.prior**-2 * np.eye(3)
        factor = self._whitening(force)
        if factor is None:
            return None
        for _ in range(ROUNDS_MAX):
            here = self._shown(force)
            slopes = None if here is None else self._slopes(force, here)
            if here is None or slopes is None:
                return None
            white = factor @ (self.measured - self.shift - here)[self.rows]
            columns = factor @ slopes[self.rows]
            normal = columns.T @ columns + prior
            step = np.linalg.solve(normal, columns.T @ white - prior @ force)
            moved = self._stepped(force, step)
            if moved is None:
                return None
            left = float((moved - force) @ normal @ (moved - force))
            force = moved
            if left < SETTLED_SD**2:
                break
        white = white - columns @ step
        freedom, chi2 = max(int(self.rows.sum()) - 3, 1), float(white @ white)
        wider = max(chi2 / freedom, 1.0) if self.markers else 1.0
        cell, contact = self._elsewhere(force, white, columns, factor)
        return TipForce(force, wider * np.linalg.inv(normal), chi2, freedom, cell, contact)

    def _elsewhere(
        self, force: Floats, white: Floats, columns: Floats, factor: Floats
    ) -> tuple[int | None, Floats | None]:
        """Return the cell where a further force explains what is left, and the force [N]."""
        freedom = max(len(white) - 3, 1)
        if not self.markers or white @ white < chi2_isf(ODD_PROBABILITY, freedom):
            return None, None
        observer = self.observer
        split = observer.arm.split
        split.inputs = self.inputs
        pushed = pushes(split, observer.point(force), observer.step)
        if pushed is None:
            return None, None
        basis, _ = np.linalg.qr(columns)
        found: tuple[int | None, Floats | None] = (None, None)
        least = chi2_isf(FALSE_CONTACT_PROBABILITY / len(pushed), 3)
        for i, push in enumerate(pushed):
            own = factor @ push.reshape(3, -1)[:, self.rows].T
            free = own - basis @ (basis.T @ own)
            solved, *_ = np.linalg.lstsq(free, white, rcond=1e-3)
            gain = float(white @ free @ solved)
            if gain > least:
                found, least = (i + 1, solved), gain
        return found

    def _shown(self, force: Floats) -> Floats | None:
        return self.observer.shown(force, self.inputs, self.markers)

    def _slopes(self, force: Floats, here: Floats) -> Floats | None:
        step, columns = self.observer.step, []
        for axis in np.eye(3):
            moved = self._shown(force + step * axis)
            if moved is None:
                return None
            columns.append((moved - here) / step)
        return np.array(columns).T

    def _stepped(self, force: Floats, step: Floats) -> Floats | None:
        """Return the force after a step, a shorter one where there is no equilibrium."""
        for share in (1.0, 0.5, 0.2, 0.05):
            moved: Floats = force + share * step
            if self._shown(moved) is not None:
                return moved
        return None

    def _whitening(self, force: Floats) -> Floats | None:
        """Inverse root of the covariance of what is seen; None without equilibrium."""
        arm = self.observer.arm
        if not self.markers:
            here = self._shown(force)
            if here is None:
                return None
            share, least = PULL_ERROR
            sd = np.sqrt(self.observer.pull_noise**2 + (share * here) ** 2 + least**2)
            return np.asarray(np.diag(1.0 / sd[self.rows]))
        expected = arm.expected(self.inputs[0], self.observer.point(force))
        if expected is None:
            return None
        self.shift = expected.columns @ arm.mean
        columns = expected.columns[self.rows]
        covariance = columns @ arm.covariance @ columns.T + arm.scatter(self.rows)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
