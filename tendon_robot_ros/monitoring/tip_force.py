"""
What acts on the arm now: the force at its tip, and whether something touches it elsewhere.

The measured shape is compared with what the model says under the measured tensions and a force at
the tip. What the arm as built does by itself is as known as `BuiltArm` knows it: its imperfections
shift what is expected, and what is not known of them is noise that all markers share. Without a
tracker, wire pulls take the place of the markers.

    r = y - f(T, b; F),   V = B P B' + remainder + loaded remainder + noise,
    F += (J' V^-1 J)^-1 J' V^-1 r   (Gauss-Newton)

What the model does wrong of a loaded arm, unloaded references do not tell: the loaded remainder
grows with how far what acts moves the arm.

Along the line from tip to base a force hardly bends the arm, and f is not linear there: mean and
covariance are those of the posterior, summed up along that axis.

A force at another cell joins where it lowers r' V^-1 r by more than chance does.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.estimation import gauss_newton
from ..comparison.predict import FreeParameter, SettledShapes, free_parameters
from ..comparison.statistics import chi2_isf
from ..diagnosis.slopes import pushes
from .built_arm import BuiltArm

EFFECT = 'tip_load'
# [1] of a typical force, of a difference: less would be lost in the equilibrium's tolerance
DIFFERENCE = 0.02
# [1] of a typical force: 1 sd a priori, because so much bends the arm by a quarter
PRIOR = 5.0
# [1] standard deviations of the worst axis that its mean may lie off the middle of the sum, else
# the sum would miss a part of it
SHIFTED_SD = 0.5
# [1] of the length: an arm that moved by less has the same noise, because imperfections move it
# alike
SAME_LENGTH = 0.02
# [1] of the prior: an axis that is known better is linear, because the force hardly varies
LINEAR = 0.01
# [1] standard deviations at which the posterior is summed up; beyond is 0.3 % by chance
SPREAD = np.linspace(-3.0, 3.0, 9)
# [1] probability that any cell is said to be touched though none is
FALSE_CONTACT_PROBABILITY = 1e-4
# [1] probability of what is left, below which a force elsewhere is looked for; it takes time,
# which one estimate in twenty has by chance
LOOK_ELSEWHERE_PROBABILITY = 0.05
# [1] of a wire pull, that a model of it may be off, because wires stretch (assumed)
PULL_ERROR = 0.02
# [m] of a wire pull, that it may be off at least, because wires settle on their drums (assumed)
PULL_ERROR_M = 1e-4
# [1] of how far what acts moves the arm: 1 sd of what a model of it may be off; without it one of
# two 95 % intervals would miss
LOADED_ERROR = 0.01


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
        self._near: SettledShapes | None = None  # where the last shape was found
        self.kept: _KeptWhitening | None = None  # of the last estimate
        self.slopes: Floats | None = None  # (3 J, 3) [m/N] of what was seen last

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
            As measured.
        positions : (J, 3) [m], optional
            As measured, nan where a marker was not seen; without any the pulls are taken.
        pulls : (m,) [m], optional
            As measured, from the straight arm on.
        frames : int
            Frames of the tracker of which the positions are the mean.

        Returns
        -------
        TipForce, or None where the model has no equilibrium, or nothing was measured.

        """
        inputs = np.maximum(tensions, 0.0)[None]
        markers = positions is not None and bool(np.isfinite(positions).any())
        measured = positions if markers else pulls
        if measured is None or not np.isfinite(measured).any():
            return None
        seen = _Measured(inputs, measured.ravel(), markers, frames)
        for start in (self._last, np.zeros(3)):
            estimate = _Fit(self, seen).solve(start)
            if estimate is not None:
                self._last = estimate.force
                return estimate
        return None

    def point(self, force: Floats) -> dict[FreeParameter, float]:
        """Return the parameters of the model under a force."""
        values = (self._described + force).tolist()
        return dict(zip(self._frees, values, strict=True))

    def shown(self, force: Floats, inputs: Floats, markers: bool) -> Floats | None:
        """Markers (3 J,) [m], or wire pulls (m,) [m], that are expected under a force."""
        shapes = self.arm.shapes(inputs, self.point(force), self._near)
        if shapes is None:
            return None
        self._near = SettledShapes(shapes.inputs, shapes.state)
        return self.arm.split.see(shapes).ravel() if markers else np.array(shapes.pulls[0])

    @property
    def step(self) -> float:
        """Step [N] of a difference."""
        return DIFFERENCE * self._typical

    @property
    def prior(self) -> float:
        """1 sd [N] of a direction that nothing tells."""
        return PRIOR * self._typical


@dataclass(frozen=True)
class _Measured:
    """What was measured."""

    inputs: Floats  # (1, m) [N]
    measured: Floats  # (3 J,) of markers or (m,) of wire pulls [m]
    markers: bool
    frames: int

    @property
    def rows(self) -> npt.NDArray[np.bool_]:
        """What of it is known."""
        return np.isfinite(self.measured)


class _Fit:
    """One estimate."""

    def __init__(self, observer: TipForceObserver, seen: _Measured) -> None:
        self.observer, self.seen, self.rows = observer, seen, seen.rows
        self.prior = observer.prior**-2 * np.eye(3)
        self.factor: Floats = np.zeros((0, 0))
        self.columns: Floats = np.zeros((0, 3))  # (r, 3) [1/N] how the force moves what is seen

    def solve(self, start: Floats) -> TipForce | None:
        """Return the force; None where a model has no equilibrium."""
        here = self.observer.shown(start, self.seen.inputs, self.seen.markers)
        factor = None if here is None else self._whitening(start, here)
        if factor is None:
            return None
        self.factor = factor

        def left(force: Floats) -> tuple[Floats, float] | None:
            white = self._white(force)
            return None if white is None else (white, float(white @ white))

        fit = gauss_newton(start, self.prior, left, self._linearised)
        if fit is None:
            return None
        force, white, chi2, information = fit
        columns, normal = self.columns, information + self.prior
        if self.seen.markers:
            self.observer.slopes = np.zeros((len(self.rows), 3))
            self.observer.slopes[self.rows] = np.linalg.solve(factor, columns)
        freedom = max(int(self.rows.sum()) - 3, 1)
        wider = max(chi2 / freedom, 1.0) if self.seen.markers else 1.0
        cell, contact = self._elsewhere(force, white, columns, factor)
        mean, covariance = self._spread(force, columns, normal, wider)
        return TipForce(mean, covariance, chi2, freedom, cell, contact)

    def _spread(
        self, force: Floats, columns: Floats, normal: Floats, wider: float
    ) -> tuple[Floats, Floats]:
        """
        Return mean [N] and covariance [N²] of the force.

        Along the axis that is known worst the model is far from linear: there the posterior is
        summed up, the other two axes at their best (their estimate is linear).
        """
        values, axes = np.linalg.eigh(wider * np.linalg.inv(normal))
        known, worst, sd = axes[:, :2], axes[:, 2], float(np.sqrt(values[2]))
        if sd < LINEAR * self.observer.prior:
            return force, np.asarray(axes * values @ axes.T)
        best = np.linalg.pinv(columns @ known)
        for _ in range(2):  # once more around where it was
            places, logs = [], []
            for away in SPREAD:
                place = force + away * sd * worst
                white = self._white(place)
                if white is None:
                    continue
                aside = best @ white
                left = white - columns @ (known @ aside)
                place = place + known @ aside
                places.append(place)
                logs.append(-0.5 * (left @ left / wider + place @ self.prior @ place))
            if not places:
                return force, np.asarray(axes * values @ axes.T)
            weights = np.exp(np.array(logs) - max(logs))
            weights /= weights.sum()
            before, force = force, weights @ np.array(places)
            if abs(worst @ (force - before)) < SHIFTED_SD * sd:
                break
        off = np.array(places) - force
        around = off.T @ (weights[:, None] * off)
        return force, around + (known * values[:2]) @ known.T

    def _elsewhere(
        self, force: Floats, white: Floats, columns: Floats, factor: Floats
    ) -> tuple[int | None, Floats | None]:
        """Return the cell where a further force explains what is left, and the force [N]."""
        freedom = max(len(white) - 3, 1)
        if not self.seen.markers or white @ white < chi2_isf(LOOK_ELSEWHERE_PROBABILITY, freedom):
            return None, None
        observer = self.observer
        split = observer.arm.split
        split.inputs = self.seen.inputs
        pushed = pushes(split, observer.point(force), observer.step)
        if pushed is None:
            return None, None
        basis, _ = np.linalg.qr(columns)
        contact: tuple[int | None, Floats | None] = (None, None)
        least = chi2_isf(FALSE_CONTACT_PROBABILITY / len(pushed), 3)
        for i, push in enumerate(pushed):
            own = factor @ push.reshape(3, -1)[:, self.rows].T
            free = own - basis @ (basis.T @ own)
            solved, *_ = np.linalg.lstsq(free, white, rcond=1e-3)
            gain = float(white @ free @ solved)
            if gain > least:
                cell = i + 1 - observer.arm.robot.plate_cells
                contact, least = (cell, solved), gain
        return contact

    def _white(self, force: Floats) -> Floats | None:
        """Return the whitened residual under a force."""
        here = self.observer.shown(force, self.seen.inputs, self.seen.markers)
        return None if here is None else self.factor @ (self.seen.measured - here)[self.rows]

    def _linearised(self, force: Floats, white: Floats) -> tuple[Floats, Floats] | None:
        """Find how the force moves what is seen, whitened; return what that tells of it."""
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

    def _whitening(self, force: Floats, here: Floats) -> Floats | None:
        """Inverse root of the covariance of what is seen; the last one where little moved."""
        observer, seen = self.observer, self.seen
        if not seen.markers:
            sd = np.sqrt(observer.pull_noise**2 + (PULL_ERROR * here) ** 2 + PULL_ERROR_M**2)
            return np.asarray(np.diag(1.0 / sd[self.rows]))
        arm, kept = observer.arm, observer.kept
        if kept is None or not kept.serves(arm, seen, here):
            columns = arm.columns(seen.inputs, observer.point(force))
            if columns is None:
                return None
            free, moved = observer.shown(np.zeros(3), seen.inputs, True), 0.0
            if free is not None:  # at the marker that what acts moves farthest
                off = np.linalg.norm((seen.measured - free).reshape(-1, 3), axis=1)
                moved = float(np.nanmax(off))
            kept = _KeptWhitening(columns, arm.covariance, seen, here, moved)
        elif seen.frames == kept.seen.frames:
            return kept.factor
        observer.kept = kept = replace(kept, seen=seen, factor=kept.inverse_root(arm, seen))
        return kept.factor


@dataclass(frozen=True)
class _KeptWhitening:
    """What imperfections do, the factor that follows, and where it was taken."""

    columns: Floats  # (3 J, q) [m]
    known: Floats  # covariance of the imperfections
    seen: _Measured
    here: Floats  # (3 J,) [m]
    moved: float  # [m] how far what acts moves the arm
    factor: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def inverse_root(self, arm: BuiltArm, seen: _Measured) -> Floats:
        """Return the inverse root of the covariance of what is seen."""
        own, rows = self.columns[seen.rows], seen.rows
        scatter = arm.scatter(rows, self.columns, seen.frames)
        if arm.level > 0.0:
            scatter += (LOADED_ERROR * self.moved) ** 2 * arm.rest(rows)
        covariance = own @ arm.covariance @ own.T + scatter
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def serves(self, arm: BuiltArm, seen: _Measured, here: Floats) -> bool:
        """Whether it is good enough elsewhere."""
        return (
            arm.covariance is self.known
            and np.array_equal(seen.rows, self.seen.rows)
            and bool(np.abs(here - self.here).max() < SAME_LENGTH * arm.robot.length)
        )
