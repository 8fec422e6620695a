"""
External load on the arm: the force at its tip, and a contact elsewhere.

The measured shape is compared with the prediction under the measured tensions and a force at the
tip. The imperfections of the arm are those of `BuiltArm`: their mean shifts the prediction, their
covariance is noise that all markers share. Without a tracker, wire pulls replace the markers.

    r = y - f(T, b; F),   V = B P B' + remainder + loaded remainder + noise,
    F += (J' V^-1 J)^-1 J' V^-1 r   (Gauss-Newton)

Unloaded references contain no information on the errors of the model of a loaded arm: the loaded
remainder is proportional to the motion of the arm by the load, as the known error of the model is
to what the tip moves.

Along the line from tip to base a force hardly bends the arm, and f is not linear: mean and
covariance are those of the posterior, integrated numerically along that axis.

A force at another cell is added where it lowers r' V^-1 r significantly.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.estimation import gauss_newton
from ..diagnosis.verdict import MISFIT_ALARM_LEVEL
from ..inference.imperfections import pushes
from ..inference.predict import FreeParameter, SettledShapes, free_parameters
from ..inference.search import DIFFERENCE_STEP
from ..inference.statistics import SIGNIFICANCE, chi2_isf
from .built_arm import LOAD, BuiltArm

# [1] of a typical force: prior 1 sd, because such a force bends the arm by a quarter
PRIOR = 5.0
# [1] standard deviations along the worst axis between the mean and the centre of the integration,
# else part of the posterior would lie outside
SHIFTED_SD = 0.5
# [1] of the length: an arm that moved by less keeps its covariance, because the Jacobian of the
# imperfections hardly changes
SAME_LENGTH = 0.02
# [1] of the prior: below this 1 sd an axis is linear, because the force hardly varies
LINEAR = 0.01
# [1] standard deviations at which the posterior is evaluated; beyond lies 0.3 % by chance
SPREAD = np.linspace(-3.0, 3.0, 9)
FALSE_CONTACT_PROBABILITY = MISFIT_ALARM_LEVEL  # by chance, that any cell is reported
SEARCH_PROBABILITY = SIGNIFICANCE  # by chance, that the search for a contact starts
# [1] of a wire pull: error of its model, 1 sd, because wires stretch (assumed)
PULL_ERROR = 0.02
# [m] of a wire pull: smallest error, 1 sd, because wires settle on their drums (assumed)
PULL_ERROR_M = 1e-4
# [1] of the motion by the load: error of its model, 1 sd; without it one of two 95 % intervals
# would miss the force
LOADED_ERROR = 0.01


@dataclass(frozen=True)
class TipForce:
    """The force at the tip in the base frame."""

    force: Floats  # (3,) [N]
    covariance: Floats  # (3, 3) [N²]
    chi2: float  # of the residual
    freedom: int  # degrees of freedom of the residual
    cell: int | None = None  # of a further contact, counted from 1 at the base
    contact: Floats | None = None  # (3,) [N] force of the contact

    @property
    def acts(self) -> bool:
        """Whether the force is significant: zero lies outside its 99.9 % ellipsoid."""
        return float(self.force @ np.linalg.solve(self.covariance, self.force)) > chi2_isf(1e-3, 3)


class TipForceObserver:
    """Estimates the force repeatedly, each time from the last estimate."""

    def __init__(self, arm: BuiltArm, pull_noise: float = 2e-5) -> None:
        """
        Begin without a force; what a description lacks unknowingly appears as a force.

        Parameters
        ----------
        arm : BuiltArm
        pull_noise : float
            1 sd of a measured wire pull [m].

        """
        self.arm, self.pull_noise = arm, pull_noise
        self._frees = free_parameters(arm.catalogue[LOAD], arm.robot)
        self._described = np.array([arm.whole.value(free) for free in self._frees])
        self._typical = self._frees[0].parameter.typical
        self._last = np.zeros(3)
        self._near: SettledShapes | None = None  # start of the next equilibrium
        self.kept: _KeptWhitening | None = None  # of the last covariance
        self.slopes: Floats | None = None  # (3 J, 3) [m/N] last Jacobian of the markers

    def update(
        self,
        tensions: Floats,
        positions: Floats | None,
        pulls: Floats | None = None,
        frames: int = 1,
    ) -> TipForce | None:
        """
        Estimate the force.

        Parameters
        ----------
        tensions : (m,) [N]
            Measured tensions.
        positions : (J, 3) [m], optional
            Measured markers, nan where missing; without any the wire pulls are used.
        pulls : (m,) [m], optional
            Measured wire pulls, from the straight arm.
        frames : int
            Number of frames whose mean the positions are.

        Returns
        -------
        TipForce or None
            None where the model has no equilibrium or nothing was measured.

        """
        inputs = np.maximum(tensions, 0.0)[None]
        markers = positions is not None and bool(np.isfinite(positions).any())
        measured = positions if markers else pulls
        if measured is None or not np.isfinite(measured).any():
            return None
        data = _Measured(inputs, measured.ravel(), markers, frames)
        for start in (self._last, np.zeros(3)):
            estimate = _Fit(self, data).solve(start)
            if estimate is not None:
                self._last = estimate.force
                return estimate
        return None

    def point(self, force: Floats) -> dict[FreeParameter, float]:
        """Return the parameters of the model under a force."""
        values = (self._described + force).tolist()
        return dict(zip(self._frees, values, strict=True))

    def predicted(self, force: Floats, inputs: Floats, markers: bool) -> Floats | None:
        """Return the predicted markers (3 J,) or wire pulls (m,) [m] under a force (3,) [N]."""
        shapes = self.arm.shapes(inputs, self.point(force), self._near)
        if shapes is None:
            return None
        self._near = SettledShapes(shapes.inputs, shapes.state)
        return self.arm.split.see(shapes).ravel() if markers else np.array(shapes.pulls[0])

    @property
    def step(self) -> float:
        """Step [N] of a difference."""
        return DIFFERENCE_STEP * self._typical

    @property
    def prior(self) -> float:
        """Prior 1 sd [N] of each component."""
        return PRIOR * self._typical


@dataclass(frozen=True)
class _Measured:
    """One measurement."""

    inputs: Floats  # (1, m) [N]
    measured: Floats  # (3 J,) of markers or (m,) of wire pulls [m]
    markers: bool
    frames: int

    @property
    def rows(self) -> npt.NDArray[np.bool_]:
        """Valid coordinates."""
        return np.isfinite(self.measured)


class _Fit:
    """Fit of the force to one measurement."""

    def __init__(self, observer: TipForceObserver, data: _Measured) -> None:
        self.observer, self.data, self.rows = observer, data, data.rows
        self.prior = observer.prior**-2 * np.eye(3)
        self.factor: Floats = np.zeros((0, 0))
        self.columns: Floats = np.zeros((0, 3))  # (r, 3) [1/N] whitened Jacobian
        self.lacked: Floats = np.zeros(len(data.measured))  # [m] motion by what is not described

    def solve(self, start: Floats) -> TipForce | None:
        """Return the force, None where the model has no equilibrium."""
        expected = self.observer.predicted(start, self.data.inputs, self.data.markers)
        factor = None if expected is None else self._whitening(start, expected)
        if factor is None:
            return None
        self.factor = factor

        def whitened(force: Floats) -> tuple[Floats, float] | None:
            white = self._white(force)
            return None if white is None else (white, float(white @ white))

        fit = gauss_newton(start, self.prior, whitened, self._linearised)
        if fit is None:
            return None
        force, white, chi2, information = fit
        columns, normal = self.columns, information + self.prior
        if self.data.markers:
            self.observer.slopes = np.zeros((len(self.rows), 3))
            self.observer.slopes[self.rows] = np.linalg.solve(factor, columns)
        freedom = max(int(self.rows.sum()) - 3, 1)
        wider = max(chi2 / freedom, self.observer.arm.widening) if self.data.markers else 1.0
        cell, contact = self._elsewhere(force, white, columns, factor)
        mean, covariance = self._spread(force, columns, normal, wider)
        return TipForce(mean, covariance, chi2, freedom, cell, contact)

    def _spread(
        self, force: Floats, columns: Floats, normal: Floats, wider: float
    ) -> tuple[Floats, Floats]:
        """
        Return mean [N] and covariance [N²] of the force.

        Along the least certain axis the model is not linear: the posterior is integrated along it,
        with the other two axes at their linear optimum.
        """
        values, axes = np.linalg.eigh(wider * np.linalg.inv(normal))
        known, worst, sd = axes[:, :2], axes[:, 2], float(np.sqrt(values[2]))
        if sd < LINEAR * self.observer.prior:
            return force, np.asarray(axes * values @ axes.T)
        best = np.linalg.pinv(columns @ known)
        for _ in range(2):  # a second time around the first mean
            places, logs = [], []
            for offset in SPREAD:
                place = force + offset * sd * worst
                white = self._white(place)
                if white is None:
                    continue
                aside = best @ white
                residual = white - columns @ (known @ aside)
                place = place + known @ aside
                places.append(place)
                logs.append(-0.5 * (residual @ residual / wider + place @ self.prior @ place))
            if not places:
                return force, np.asarray(axes * values @ axes.T)
            weights = np.exp(np.array(logs) - max(logs))
            weights /= weights.sum()
            before, force = force, weights @ np.array(places)
            if abs(worst @ (force - before)) < SHIFTED_SD * sd:
                break
        off = np.array(places) - force
        around = off.T @ (weights[:, None] * off)
        step = sd * (SPREAD[1] - SPREAD[0]) * worst  # each place stands for all within a step
        return force, around + np.outer(step, step) / 12.0 + (known * values[:2]) @ known.T

    def _elsewhere(
        self, force: Floats, white: Floats, columns: Floats, factor: Floats
    ) -> tuple[int | None, Floats | None]:
        """Return the cell at which a contact explains the residual, and its force (3,) [N]."""
        freedom = max(len(white) - 3, 1)
        if not self.data.markers or white @ white < chi2_isf(SEARCH_PROBABILITY, freedom):
            return None, None
        observer = self.observer
        split = observer.arm.split
        split.inputs = self.data.inputs
        pushed = pushes(split, observer.point(force))
        if pushed is None:
            return None, None
        basis, _ = np.linalg.qr(columns)
        contact: tuple[int | None, Floats | None] = (None, None)
        gain_min = chi2_isf(FALSE_CONTACT_PROBABILITY / len(pushed), 3)
        for i, push in enumerate(pushed):
            own = factor @ push.reshape(3, -1)[:, self.rows].T
            free = own - basis @ (basis.T @ own)
            solved, *_ = np.linalg.lstsq(free, white, rcond=1e-3)
            gain = float(white @ free @ solved)
            if gain > gain_min:
                cell = i + 1 - observer.arm.robot.plate_cells
                contact, gain_min = (cell, solved), gain
        return contact

    def _white(self, force: Floats) -> Floats | None:
        """Return the whitened residual under a force."""
        expected = self.observer.predicted(force, self.data.inputs, self.data.markers)
        if expected is None:
            return None
        return self.factor @ (self.data.measured - expected - self.lacked)[self.rows]

    def _linearised(self, force: Floats, white: Floats) -> tuple[Floats, Floats] | None:
        """Update the whitened Jacobian; return information (3, 3) and gradient (3,)."""
        step, columns = self.observer.step, []
        for axis in np.eye(3):
            for side in (step, -step):
                moved = self._white(force + side * axis)
                if moved is not None:
                    columns.append((white - moved) / side)
                    break
            else:
                return None
        self.columns = slopes = np.array(columns).T
        return slopes.T @ slopes, slopes.T @ white

    def _whitening(self, force: Floats, expected: Floats) -> Floats | None:
        """Return the inverse root of the covariance, the last one where the arm hardly moved."""
        observer, data = self.observer, self.data
        if not data.markers:
            sd = np.sqrt(observer.pull_noise**2 + (PULL_ERROR * expected) ** 2 + PULL_ERROR_M**2)
            return np.asarray(np.diag(1.0 / sd[self.rows]))
        arm, kept = observer.arm, observer.kept
        if kept is None or not kept.serves(arm, data, expected):
            columns = arm.columns(data.inputs, observer.point(force))
            if columns is None:
                return None
            free, moved = observer.predicted(np.zeros(3), data.inputs, True), 0.0
            if free is not None:  # motion by the load at the marker that moves most
                off = data.measured - free - arm.lacked(columns)
                off = np.linalg.norm(off.reshape(-1, 3), axis=1)
                moved = float(np.nanmax(off))
            kept = _KeptWhitening(columns, arm.covariance, data, expected, moved)
        if not len(kept.factor) or data.frames != kept.data.frames:
            kept = replace(kept, data=data, factor=kept.inverse_root(arm, data))
        observer.kept, self.lacked = kept, arm.lacked(kept.columns)
        return kept.factor


@dataclass(frozen=True)
class _KeptWhitening:
    """The whitening factor, with the state for which it is valid."""

    columns: Floats  # (3 J, q) [m] motion by imperfections
    known: Floats  # covariance of the imperfections
    data: _Measured
    expected: Floats  # (3 J,) [m]
    moved: float  # [m] motion of the arm by the load
    factor: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def inverse_root(self, arm: BuiltArm, data: _Measured) -> Floats:
        """Return the inverse root of the covariance of the valid coordinates."""
        covariance = arm.spread(data.rows, self.columns, data.frames)
        loaded = max(arm.response, LOADED_ERROR if arm.level > 0.0 else 0.0) * self.moved
        covariance += loaded**2 * arm.rest(data.rows)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def serves(self, arm: BuiltArm, data: _Measured, expected: Floats) -> bool:
        """Whether the columns are still valid."""
        return (
            arm.covariance is self.known
            and np.array_equal(data.rows, self.data.rows)
            and bool(np.abs(expected - self.expected).max() < SAME_LENGTH * arm.robot.length)
        )
