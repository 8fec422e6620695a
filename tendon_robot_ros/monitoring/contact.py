"""
What pushes the arm: a force, and the place along the arm at which it acts.

The measured shape is compared with the prediction under the measured tensions and a force F at an
arc length s. The imperfections of the arm are those of `BuiltArm`: their mean shifts the
prediction, their covariance is noise that all markers share. Without a tracker, wire pulls replace
the markers.

    r = y - f(T, b; F, s),   V = B P B' + remainder + loaded remainder + noise,
    F += (J' V^-1 J)^-1 J' V^-1 r   (Gauss-Newton)

Unloaded references contain no information on the errors of the model of a loaded arm: the loaded
remainder is proportional to the motion of the arm by the load, as the known error of the model is
to what the tip moves.

The place is that of the lowest cost r' V^-1 r + F' F / prior², profiled over the force at every
place. At a given shape the moments of a force are linear in it, so that slopes by forces at all
cells profile the cost near a solution. The place has the interval within which the cost is as low
by chance. Where nothing tells it (a single marker, wire pulls), and where nothing acts
significantly, it is that of the whole arm and the force the one as if at the tip.

Along the line from a place to the base a force hardly bends the arm, and f is not linear: mean and
covariance are those of the posterior, integrated numerically along that axis. The force that is
told belongs to the likeliest place; its covariance is the mean square error over all places, each
as likely as the profile says, because a force elsewhere has another lever.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.special import softmax

from ..common.arrays import Bools, Floats
from ..common.errors import NoEquilibriumError
from ..common.estimation import ITERATIONS_MAX, gauss_newton
from ..inference.imperfections import PLAUSIBLE_SIZES, ZERO, forces_along
from ..inference.predict import FreeParameter, SettledShapes, free_parameters
from ..inference.search import DIFFERENCE_STEP
from ..inference.statistics import RARE, SIGNIFICANCE, TIE_SCORE, chi2_isf
from ..model.shape import ShapeBatch
from ..robot.estimates import natural_sizes
from .built_arm import LOAD, ODD_PROBABILITY, BuiltArm, solved

# the effect whose place is sought; where the description has one itself, the tip is the only place
PLACED = 'point_load'
# [1] places along the arm at which the cost is profiled, because a hundredth of the length is a
# tenth of what a place is told to
PLACES = 100
# [1] of the length: an arm that moved by less keeps its covariance, because the Jacobian of the
# imperfections hardly changes; a solution that is farther off is a local minimum
SAME_LENGTH = 0.02
# [1] of the prior: below this 1 sd an axis is linear, because the force hardly varies
LINEAR = 0.01
# [1] standard deviations at which the posterior is evaluated; beyond lies 0.3 % by chance
SPREAD = np.linspace(-3.0, 3.0, 9)
# [1] of a wire pull: error of its model, 1 sd, because wires stretch (assumed)
PULL_ERROR = 0.02
# [N] of a force whose arrow has half of its largest length, so that forces of 0.01 N and of 1 N
# are visible in one scene
FORCE_HALF_N = 0.01
# [1] of the motion by the load: error of its model, 1 sd; without it one of two 95 % intervals
# would miss the force
LOADED_ERROR = 0.01


@dataclass(frozen=True)
class Contact:
    """The force on the arm in the base frame, and its place."""

    force: Floats  # (3,) [N]
    covariance: Floats  # (3, 3) [N²] mean square error, wherever it acts
    place: float  # [m] arc length
    interval: tuple[float, float]  # [m] of the place, 95 %
    point: Floats  # (3,) [m] of the arm at the place, as the tracker sees it
    off: float  # [m] largest residual of a coordinate
    acts: bool  # whether the force is significant: by chance once in a million estimates

    def exceeds(self, threshold: float) -> bool:
        """Whether the force acts and its size is above a threshold [N] in 97.5 of 100 cases."""
        size = float(np.linalg.norm(self.force))
        along = self.force / max(size, 1e-12)
        sd = float(np.sqrt(along @ self.covariance @ along))
        return self.acts and size - np.sqrt(chi2_isf(SIGNIFICANCE, 1)) * sd > threshold

    def arrow(self, size: float) -> Floats:
        """Return the force as an arrow (2, 3) [m] from its place, in a scene of a size [m]."""
        length = 0.5 * size / (float(np.linalg.norm(self.force)) + FORCE_HALF_N)
        return np.array([self.point, self.point + length * self.force])


class ContactObserver:
    """Estimates force and place repeatedly, each time from the last estimate."""

    def __init__(self, arm: BuiltArm) -> None:
        """Begin without a force; what a description lacks unknowingly appears as a force."""
        self.arm, self.tip = arm, arm.robot.length
        self.effect = LOAD if PLACED in arm.robot.effects else PLACED
        frees = free_parameters(arm.catalogue[self.effect], arm.robot)
        named = {free.parameter.name: free for free in frees}
        self.frees = [named[f'force_{xyz}'] for xyz in 'xyz']
        self._place = named.get('arc_length')
        self._described = np.array([arm.described.value(free) for free in self.frees])
        self.step = DIFFERENCE_STEP * self.frees[0].parameter.typical  # [N] of a difference
        # (PLACES,) [m] at which the cost is profiled; the last is the tip
        self.places = np.arange(1, PLACES + 1) / PLACES * self.tip
        self._last = np.zeros(3), self.tip
        self.shapes: ShapeBatch | None = None  # the last one, start of the next equilibrium
        self.kept: _Motions | None = None  # of the last covariance
        self.slopes: Floats | None = None  # (3 J, 3) [m/N] last Jacobian of the markers

    def update(
        self,
        tensions: Floats,
        positions: Floats | None,
        pulls: Floats | None = None,
        frames: int = 1,
    ) -> Contact | None:
        """
        Estimate force and place.

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
        Contact or None
            None where the model has no equilibrium or nothing was measured.

        """
        inputs = np.maximum(tensions, 0.0)[None]
        markers = positions is not None and bool(np.isfinite(positions).any())
        measured = positions if markers else pulls
        if measured is None or not np.isfinite(measured).any():
            return None
        best, none = None, np.zeros(3)
        # a local minimum leaves a marker elsewhere, as an arm does that was pushed far at once
        for start in (self._last, (none, self.tip), (none, 0.5 * self.tip)):
            for tangents in False, True:  # what one leaves, the other may explain
                fit = _Fit(self, inputs, measured.ravel(), markers, frames, tangents)
                with suppress(NoEquilibriumError):
                    contact = fit.solve(*start)
                    best = contact if best is None or contact.off < best.off else best
                if fit.explains:
                    break
            if best is not None and (best.off < SAME_LENGTH * self.tip or not markers):
                break
        if best is not None:
            self._last = best.force, best.place
        return best

    def point(self, force: Floats, place: float) -> dict[FreeParameter, float]:
        """Return the parameters of the model under a force at a place."""
        values = (self._described + force).tolist()
        where = {} if self._place is None else {self._place: place}
        return where | dict(zip(self.frees, values, strict=True))

    def predicted(self, force: Floats, inputs: Floats, markers: bool, place: float) -> Floats:
        """Return markers (3 J,) or wire pulls (m,) [m] under a force (3,) [N] at a place [m]."""
        point, last = self.point(force, place), self.shapes
        near = None if last is None else SettledShapes(last.inputs, last.state)
        self.shapes = shapes = self.arm.shapes(inputs, point, near)
        return self.arm.predictor.see(shapes).ravel() if markers else np.array(shapes.pulls[0])

    def along(self, force: Floats, place: float, inputs: Floats) -> Floats | None:
        """
        Return the slopes of the markers (PLACES, 3 J, 3) [m/N] by forces along a loaded arm.

        None where the place is not sought, or the arm has no slopes.
        """
        predictor, point = self.arm.predictor, self.point(force, place)
        predictor.inputs = inputs
        if self._place is None or predictor.model.remembers or predictor.markers(point) is None:
            return None
        ends = np.append(0.0, np.cumsum(self.arm.robot.cell_lengths))
        slopes = forces_along(predictor, point, self.effect, self.step, ends[1:])
        at_ends = slopes.reshape(len(ends) - 1, 3, -1).swapaxes(1, 2)
        at_ends = np.concatenate([np.zeros_like(at_ends[:1]), at_ends])
        # within a cell both ends carry as much as they are near
        return np.asarray(make_interp_spline(ends, at_ends, k=1)(self.places))

    def point_at(self, place: float) -> Floats:
        """Return the point (3,) [m] of the last predicted arm at an arc length."""
        assert self.shapes is not None
        there = self.shapes.markers(np.array([place]), np.zeros((1, 3)))
        return np.asarray(self.arm.predictor.model.measured(there)[0, 0])

    def prior(self, place: Floats | float) -> Floats:
        """
        Return the prior 1 sd [N] of each component at places (...) [m].

        At the tip it is the natural force of the arm, which bends it by about a quarter; elsewhere
        the force of the same moment at the base.
        """
        return np.asarray(natural_sizes(self.arm.robot)['force'] * self.tip / place)


@dataclass(frozen=True)
class _Solution:
    """The likeliest force at a place."""

    place: float  # [m]
    force: Floats  # (3,) [N]
    expected: Floats  # (3 J,) or (m,) [m] prediction
    white: Floats  # (r,) whitened residual
    chi2: float  # of the residual
    columns: Floats  # (r, 3) [1/N] whitened Jacobian
    normal: Floats  # (3, 3) [1/N²] information of measurement and prior


class _Profile(NamedTuple):
    """The likeliest force at every place."""

    costs: Floats  # (PLACES,)
    forces: Floats  # (PLACES, 3) [N]
    normal: Floats  # (PLACES, 3, 3) [1/N²] information of measurement and prior


@dataclass
class _Fit:
    """Fit of force and place to one measurement."""

    observer: ContactObserver
    inputs: Floats  # (1, m) [N]
    measured: Floats  # (3 J,) of markers or (m,) of wire pulls [m]
    markers: bool
    frames: int
    tangents: bool  # whether slopes are those at a point
    explains: bool = False  # whether the contact leaves no more than chance

    def __post_init__(self) -> None:
        self.rows = np.isfinite(self.measured)
        self.factor: Floats = np.zeros((0, 0))
        self.lacked: Floats = np.zeros(len(self.rows))  # [m] motion by what is not described

    def solve(self, force: Floats, place: float) -> Contact:
        """Return the contact; raise NoEquilibriumError where the model has no equilibrium."""
        whole, tip = (0.0, self.observer.tip), self.observer.tip
        best = self._at(force, place)
        if not self._is_usual(best.white) or self._acts(best, RARE):
            best, interval, profile = self._searched(best)
            if interval != whole and self._is_needed(best):
                return self._told(best, interval, True, profile)
        if best.place != tip:
            best = self._at(np.zeros(3), tip)
        return self._told(best, whole, self._is_needed(best))

    def _is_usual(self, white: Floats) -> bool:
        """Whether a whitened residual is no larger than by chance."""
        usual = chi2_isf(SIGNIFICANCE, max(len(white) - 3, 1)) * self.observer.arm.widening
        return bool(white @ white <= usual)

    def _wider(self, solution: _Solution) -> float:
        """Return the factor on the variances by the residual, and by the references."""
        if not self.markers:
            return 1.0
        freedom = max(len(solution.white) - 3, 1)
        return max(solution.chi2 / freedom, self.observer.arm.widening)

    def _acts(self, solution: _Solution, level: float) -> bool:
        """Whether a force is significant at a level, to first order."""
        gained = solution.force @ solution.normal @ solution.force / self._wider(solution)
        return bool(gained > chi2_isf(level, 3))

    def _is_needed(self, solution: _Solution) -> bool:
        """
        Whether no force explains the measurement that much worse.

        A straight arm bends far by a force along it and little by a half of that: to first order
        the force would be certain.
        """
        if not self._acts(solution, ODD_PROBABILITY):
            return False
        pushed = self.observer.shapes
        try:
            free = self._white(np.zeros(3), solution.place)
        except NoEquilibriumError:
            return True
        self.observer.shapes = pushed
        least = self._wider(solution) * chi2_isf(ODD_PROBABILITY, 3)
        return bool(free @ free - self._cost(solution) > least)

    def _searched(self, best: _Solution) -> tuple[_Solution, tuple[float, float], _Profile | None]:
        """Return the likeliest solution, the interval of its place [m], and the profile."""
        places, interval = self.observer.places, (0.0, self.observer.tip)
        # within a cell a force is only statically the same as in the arm, which bows along it
        half = 0.5 * float(self.observer.arm.robot.cell_lengths.max())
        for _ in range(ITERATIONS_MAX):  # each is linear about the last one
            # three coordinates, such as those of the tip, tell a force and no place
            profile = self._profile(best) if self.markers and len(best.white) > 3 else None
            if profile is None:
                break
            costs, forces, _ = profile
            lowest = int(np.argmin(costs))
            alike = costs < costs[lowest] + self._wider(best) * chi2_isf(SIGNIFICANCE, 1)
            first, last = places[np.flatnonzero(alike)[[0, -1]]] + half * np.array([-1.0, 1.0])
            interval = max(float(first), 0.0), min(float(last), self.observer.tip)
            present = int(np.argmin(np.abs(places - best.place)))
            if costs[present] < costs[lowest] + TIE_SCORE:
                break
            whitening = self.factor, self.lacked
            with suppress(NoEquilibriumError):
                other = self._at(forces[lowest], float(places[lowest]))
                if self._cost(other) < self._cost(best):
                    best = other
                    continue
            self.factor, self.lacked = whitening  # those of the best
            break
        return best, interval, profile

    def _profile(self, solution: _Solution) -> _Profile | None:
        """Return the force at every place, linear about a solution."""
        slopes = self.observer.along(solution.force, solution.place, self.inputs)
        if slopes is None:
            return None
        columns = self.factor @ slopes[:, self.rows]
        here = int(np.argmin(np.abs(self.observer.places - solution.place)))
        target = solution.white + columns[here] @ solution.force
        prior = self.observer.prior(self.observer.places)[:, None, None] ** -2 * np.eye(3)
        normal = columns.swapaxes(1, 2) @ columns + prior
        gradient = columns.swapaxes(1, 2) @ target
        forces = np.linalg.solve(normal, gradient[..., None])[..., 0]
        return _Profile(target @ target - (gradient * forces).sum(axis=1), forces, normal)

    def _cost(self, solution: _Solution) -> float:
        """Return the cost of a solution with the present covariance."""
        white = self._whitened(solution.expected)
        inside = solution.force / self.observer.prior(solution.place)
        return float(white @ white + inside @ inside)

    def _at(self, start: Floats, place: float) -> _Solution:
        """Return the likeliest force at a place."""
        self.factor = self._whitening(start, place, self._predicted(start, place))
        prior = self.observer.prior(place) ** -2 * np.eye(3)
        slopes = self._tangents if self.tangents else self._differences
        force, white, columns = gauss_newton(
            start, prior, lambda force: self._white(force, place), partial(slopes, place)
        )
        expected, normal = self._predicted(force, place), columns.T @ columns + prior
        return _Solution(place, force, expected, white, float(white @ white), columns, normal)

    def _differences(self, place: float, force: Floats, white: Floats) -> Floats:
        """Return the whitened Jacobian (r, 3) [1/N] across a step, as far as a fold lets it."""
        step = self.observer.step

        def column(axis: Floats) -> Floats:
            try:
                return (white - self._white(force + step * axis, place)) / step
            except NoEquilibriumError:
                return (self._white(force - step * axis, place) - white) / step

        return np.array([column(axis) for axis in np.eye(3)]).T

    def _tangents(self, place: float, force: Floats, _: Floats) -> Floats:
        """Return it at a point: a step may cross a kink of friction, or have no equilibrium."""
        observer, shapes, slopes = self.observer, self.observer.shapes, None
        if self.markers and shapes is not None:
            predictor, near = observer.arm.predictor, SettledShapes(shapes.inputs, shapes.state)
            predictor.inputs = self.inputs
            slopes = predictor.tangent(observer.point(force, place), observer.frees, near)
        return np.asarray(self.factor @ solved(slopes).markers.reshape(3, -1).T[self.rows])

    def _told(
        self,
        best: _Solution,
        interval: tuple[float, float],
        acts: bool,
        profile: _Profile | None = None,
    ) -> Contact:
        """Return a solution with its doubt, also of the place if there is a profile of it."""
        if self.markers:
            self.observer.slopes = np.zeros((len(self.rows), 3))
            self.observer.slopes[self.rows] = np.linalg.solve(self.factor, best.columns)
        self.explains = self._is_usual(best.white)
        self._predicted(best.force, best.place)  # the last one may be another's
        point = self.observer.point_at(best.place)
        mean, covariance = self._spread(best, self._wider(best))
        if profile is not None:
            covariance = self._anywhere(best, covariance, profile)
        off = float(np.nanmax(np.abs(self.measured - best.expected - self.lacked)))
        return Contact(mean, covariance, best.place, interval, point, off, acts)

    def _spread(self, solution: _Solution, wider: float) -> tuple[Floats, Floats]:
        """
        Return mean [N] and covariance [N²] of the force.

        Along the least certain axis the model is not linear: the posterior is integrated along it,
        with the other two axes at their linear optimum.
        """
        force, columns = solution.force, solution.columns
        values, axes = np.linalg.eigh(wider * np.linalg.inv(solution.normal))
        known, worst, sd = axes[:, :2], axes[:, 2], float(np.sqrt(values[2]))
        prior = self.observer.prior(solution.place)
        if sd < LINEAR * prior:
            return force, np.asarray(axes * values @ axes.T)
        best, places, logs = np.linalg.pinv(columns @ known), [], []
        for offset in SPREAD:
            place = force + offset * sd * worst
            with suppress(NoEquilibriumError):
                white = self._white(place, solution.place)
                aside = best @ white
                residual = white - columns @ (known @ aside)
                place = place + known @ aside
                places.append(place)
                logs.append(-0.5 * (residual @ residual / wider + place @ place / prior**2))
        weights = softmax(logs)
        mean = weights @ np.array(places)
        off = np.array(places) - mean
        around = off.T @ (weights[:, None] * off)
        step = sd * (SPREAD[1] - SPREAD[0]) * worst  # each place stands for all within a step
        return mean, around + np.outer(step, step) / 12.0 + (known * values[:2]) @ known.T

    def _anywhere(self, told: _Solution, covariance: Floats, profile: _Profile) -> Floats:
        """
        Return the mean square error [N²] of a force, of covariance [N²], that acts anywhere.

        The force at another place is spread as that at the likeliest one, in standard deviations
        of the linear model: the axis along which it hardly shows turns with the place.
        """
        here, roots = np.linalg.inv(_spread_root(told.normal)), _spread_root(profile.normal)
        weights = softmax(-0.5 * profile.costs / self._wider(told))
        off = profile.forces - told.force
        spreads = roots @ (here @ covariance @ here) @ roots
        return np.asarray(np.tensordot(weights, spreads, 1) + (weights * off.T) @ off)

    def _predicted(self, force: Floats, place: float) -> Floats:
        """Return the prediction under a force at a place."""
        return self.observer.predicted(force, self.inputs, self.markers, place)

    def _white(self, force: Floats, place: float) -> Floats:
        """Return the whitened residual under a force at a place."""
        return self._whitened(self._predicted(force, place))

    def _whitened(self, expected: Floats) -> Floats:
        """Return the whitened residual of a prediction."""
        return np.asarray(self.factor @ (self.measured - expected - self.lacked)[self.rows])

    def _whitening(self, force: Floats, place: float, expected: Floats) -> Floats:
        """Return the inverse root of the covariance, by the last motions while it hardly moves."""
        observer, rows = self.observer, self.rows
        if not self.markers:
            sd = np.hypot(PLAUSIBLE_SIZES[ZERO][1], PULL_ERROR * expected)
            return np.asarray(np.diag(1.0 / sd[rows]))
        arm, kept = observer.arm, observer.kept
        if (
            kept is None
            or kept.known is not arm.covariance
            or not np.array_equal(rows, kept.rows)
            or np.abs(expected - kept.expected).max() >= SAME_LENGTH * arm.robot.length
        ):
            columns, moved = arm.columns(self.inputs, observer.point(force, place)), 0.0
            with suppress(NoEquilibriumError):  # motion by the load at the marker that moves most
                free = self._predicted(np.zeros(3), observer.tip)
                off = self.measured - free - arm.lacked(columns)
                off = np.linalg.norm(off.reshape(-1, 3), axis=1)
                moved = float(np.nanmax(off))
            kept = observer.kept = _Motions(columns, arm.covariance, rows, expected, moved)
        self.lacked = arm.lacked(kept.columns)
        loaded = max(arm.response, LOADED_ERROR if arm.level > 0.0 else 0.0) * kept.moved
        covariance = arm.spread(rows, kept.columns, self.frames) + loaded**2 * arm.rest(rows)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


@dataclass(frozen=True)
class _Motions:
    """Motions of the markers that are no contact, with the state for which they are valid."""

    columns: Floats  # (3 J, q) [m] motion by imperfections
    known: Floats  # covariance of the imperfections
    rows: Bools  # (3 J,) of visible coordinates
    expected: Floats  # (3 J,) [m]
    moved: float  # [m] motion of the arm by the load


def _spread_root(information: Floats) -> Floats:
    """Return the symmetric roots (..., 3, 3) of the inverse of information."""
    values, axes = np.linalg.eigh(information)
    values = np.maximum(values, np.finfo(float).eps * values[..., -1:])  # below is rounding
    return np.asarray((axes / np.sqrt(values)[..., None, :]) @ axes.swapaxes(-1, -2))
