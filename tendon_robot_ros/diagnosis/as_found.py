"""
The arm as it was found: what a search of `improve` took, fitted again as `diagnose` and `add` fit.

The search weighs what it cannot explain as new in every posture. Imperfections are the same in all
of them: here they stand beside the parameters as random effects, which the data tell (`session`).
So values and their intervals are those of generalised least squares, under imperfections that are
as large as is plausible at least, and the description may take the cells, inputs and the tracker's
frame as they were found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..comparison.predict import FreeParameter
from ..robot import Robot
from .add import fit_effects, settle
from .arm_report import arm_report
from .as_built import POSITION, ROTATION, SplitPredictor
from .decide import STRAY_SD_MAX
from .described_arm import OF_THE_ARM
from .fit import Fit, covariance_of
from .interval import QUANTILE
from .load import loads_of
from .local_tests import faults_of
from .prediction_errors import Joining, Ways, fall, grown, left_out_markers, written_markers
from .report_rows import values_of
from .result import LoadVector, Value
from .session import Session
from .stepwise import PRIOR_TYPICALS, Held, State, Stepwise
from .written import described_by

Floats = npt.NDArray[np.float64]
Values = dict[str, dict[str, Value]]
FRAME = (POSITION, ROTATION)
NO_FIT = (ArithmeticError, np.linalg.LinAlgError, NoEquilibriumError)


@dataclass(frozen=True)
class AsFound:
    """A state of a search, fitted again with the arm as it is built."""

    search: Stepwise
    state: State
    session: Session
    fit: Fit
    scale: float = 1.0  # chi² over freedom where the fit is not adequate

    @property
    def robot(self) -> Robot:
        """The description with the effects, and the arm as it was found."""
        return described_by(self.session, self.fit, beside=True)

    @cached_property
    def markers(self) -> Floats:
        """What that description predicts (P, J, 3) [m]; nan without equilibrium."""
        shown = written_markers(self.session.fitters[0], self.fit, self.fit.values)
        return np.full_like(self.fit.markers, np.nan) if shown is None else shown

    @property
    def squares(self) -> Floats:
        """Squared errors (P, J) [m²] of that description."""
        return np.asarray(((self.search.measured - self.markers) ** 2).sum(axis=2))

    @cached_property
    def left_out(self) -> Floats:
        """Squared errors (P, J) [m²] of postures left out in turn, of those that it knows."""
        shown = left_out_markers(self.session.fitters[0], self.fit)
        squares = ((self.search.measured - shown) ** 2).sum(axis=2)
        squares[list(self.session.held)] = np.nan
        return np.asarray(squares)

    @property
    def is_worthwhile(self) -> bool:
        """Whether it lowers the left-out error of its search by more than that scatters."""
        before = self.state.left_out[:, None]
        told = np.isfinite(self.left_out[np.isfinite(before[:, 0])]).any(axis=1)
        if not (told.all() and np.isfinite(self.markers).all()):
            return False  # a posture has no equilibrium
        gain, scatter = fall(before, self.left_out)
        return gain > scatter

    @property
    def scatter(self) -> dict[str, Any] | None:
        """The scatter of the arm, as reports read it."""
        return arm_report(self.session, self.fit)

    @property
    def local_faults(self) -> tuple[dict[str, Any], ...]:
        """Where it is still wrong by more than what remains everywhere."""
        return tuple(faults_of(self.session, self.fit))

    @cached_property
    def values(self) -> Values:
        """Values of the effects, with 95 % intervals; the arm itself may change where it did."""
        made = values_of(self._freed, self.scale, self._freed.covariance)
        for free in self.state.effects.frees:
            if (found := self._with_its_like(free)) is not None:
                made.setdefault(free.effect, {})[free.key] = found
        return made

    def _with_its_like(self, free: FreeParameter) -> Value | None:
        """
        Return a parameter of the frame with the imperfection that it stands for, if there is one.

        Where both are in the fit only their sum is told.
        """
        fit, built = self.fit, self.fit.built
        names = [] if built is None else [kind.name for kind in built.kinds]
        if (
            built is None
            or free.parameter.tolerance not in FRAME
            or free.parameter.tolerance not in names
        ):
            return None
        k = names.index(free.parameter.tolerance)
        mix, size = built.random.mixtures[k]['xyz'.index(free.parameter.name[-1])], built.sizes[k]
        ahead = np.zeros(len(fit.values))
        ahead[len(fit.all_frees) + np.flatnonzero(built.random.owners == k)] = size * mix
        value = float(ahead @ fit.values)
        if free in fit.frees:
            ahead[fit.frees.index(free)] = 1.0
            value += float(fit.values[fit.frees.index(free)])
        else:
            value += self.session.predictor.value(free)
        variance = float(ahead @ fit.covariance @ ahead) + float(size**2 * (1.0 - mix @ mix))
        half = QUANTILE * math.sqrt(self.scale * max(variance, 0.0))
        return Value(value, value - half, value + half, free.parameter.unit)

    @cached_property
    def _freed(self) -> Fit:
        """The fit with what joined of the arm itself as further parameters."""
        fit = self.fit
        for joining in self._ways_of_the_arm():
            frees = joining.block.frees
            spread = np.array([PRIOR_TYPICALS * free.parameter.typical for free in frees])
            residual, jacobian = grown(fit, joining, np.zeros(len(frees)), spread)
            fit = replace(fit, residual=residual, jacobian=jacobian)
        return fit

    def _ways_of_the_arm(self) -> list[Joining]:
        """Return how the stiffness along the arm and the routes that joined move the markers."""
        blocks = [block for block in self.state.blocks if block.label in OF_THE_ARM]
        if not blocks:
            return []
        whitener = self.session.whitener
        off = whitener.white(self.search.measured - self.state.fit.markers)
        return list(
            Ways(self.search.predictor, whitener, replace(self.state.fit, residual=off)).of(blocks)
        )

    @property
    def loads(self) -> dict[str, LoadVector]:
        """Size and direction of the effects that are forces."""
        known = self._freed.covariance
        return loads_of(self._freed, self.session.predictor, self.scale, known)

    @property
    def values_of_the_search(self) -> Values:
        """Values that the search has found; their intervals are those of here and hold them."""
        point, found = self.state.fit.point, Values()
        for free in self.state.effects.frees:
            own, value = self.values[free.effect][free.key], point[free]
            moved = replace(own, value=value, low=min(own.low, value), high=max(own.high, value))
            found.setdefault(free.effect, {})[free.key] = moved
        return found

    @property
    def loads_of_the_search(self) -> dict[str, LoadVector]:
        """Forces that the search has found; the covariance knows how far they are from these."""
        values = np.array([self.state.fit.point[free] for free in self.fit.frees])
        q, off = len(values), values - self.fit.values[: len(values)]
        spread = self.scale * self._freed.covariance[:q, :q] + np.outer(off, off)
        moved = replace(self.fit, values=values)
        return loads_of(moved, self.session.predictor, covariance=spread)


def as_found(search: Stepwise, state: State) -> AsFound | None:
    """Fit what a search found again; None where that has no equilibrium."""
    session, names = _session(search, state)
    try:
        session.weigh({})
        found = settle(session, names, {})
    except NO_FIT:
        return None
    return AsFound(search, state, session, _as_plausible(session, found.fit), found.scale)


def as_found_without(
    search: Stepwise, state: State, held: Held, by_accuracy: bool
) -> AsFound | None:
    """Fit what a search found again that does not know some postures; weighed by a rule."""
    session, names = _session(search, state)
    session.held, session.use_accuracy = held, by_accuracy
    try:
        session.weigh({})
        fit = fit_effects(session, names, {})
    except NO_FIT:
        return None
    return AsFound(search, state, session, _as_plausible(session, fit))


def of_the_search(state: State) -> Fit:
    """Return the effects of a state, as far as the search tells their values: of an exact arm."""
    spread = covariance_of(state.fit.jacobian)
    own = np.flatnonzero([free.effect not in OF_THE_ARM for free in state.fit.frees])
    jacobian = np.linalg.inv(np.linalg.cholesky(spread[np.ix_(own, own)]))
    effects = tuple(state.fit.frees[i] for i in own)
    nothing = np.zeros(len(own))
    return replace(state.fit, frees=effects, values=state.fit.values[own], residual=nothing,
                   jacobian=jacobian)  # fmt: skip


def _session(search: Stepwise, state: State) -> tuple[Session, list[str]]:
    """
    Return a session of the description with what was found, and the effects that it fits.

    A frame that is off by no more than any tracker's is no effect but an imperfection: free, it
    would take the errors of kinks, whose size would then be estimated as too small.
    """
    robot, before = search.written(state), search.robot
    names = [name for block in state.blocks for name in block.names if name not in OF_THE_ARM]
    frame = [free for free in state.fit.frees if free.parameter.tolerance in FRAME]
    if frame and not set(FRAME) & set(before.tolerances):
        sizes = {kind.name: kind.plausible for kind in SplitPredictor(search.predictor).kinds()}
        off = [
            (state.fit.point[free] - search.predictor.value(free))
            / sizes[free.parameter.tolerance]
            for free in frame
        ]
        name = frame[0].effect
        if np.abs(off).max() <= STRAY_SD_MAX:
            names.remove(name)
            robot = robot.without_effect(name)
            if name in before.effects:
                robot = robot.with_effect(name, before.effects[name], before.fitted.get(name))
    return Session(search.dataset, robot, search.catalogue, workers=1), names


def _as_plausible(session: Session, fit: Fit) -> Fit:
    """
    Return a fit whose imperfections are as large as is plausible, where they are not larger.

    Several effects that were chosen by the same measurements take from the imperfections what
    those did: their estimated sizes are too small, and so would the intervals be.
    """
    if fit.built is None:
        return fit
    usual = np.nan_to_num(fit.built.random.plausible, posinf=0.0)
    fitter = session.fitters[0]
    fitter.resume(fit)
    return fitter.fit(fit.frees, fit.point, sizes=np.maximum(fit.built.sizes, usual))
