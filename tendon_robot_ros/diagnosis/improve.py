"""
Improve a description effect by effect, while the error on postures left out keeps falling.

On a real arm nothing is adequate and several effects are at work. `stepwise` lets them join one
after the other by the error on left-out postures; but the error by which effects were selected is
too optimistic. The whole search is therefore repeated without each posture (or group of postures),
and predicts it: nested cross-validation. The error of these predictions after every step is
reported. A search chooses its number of steps by its own left-out errors: the last step that
lowers them by more than their standard error. The final step is the arm as it was found (cells,
inputs, the tracker's frame), where that lowers them as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, Progress, listener, whole
from ..common.processes import one_thread
from ..data import DataSet, DataSetLike, load_dataset
from ..effects import Catalogue, CatalogueLike, load_catalogue
from ..inference.crossval import (
    Errors,
    described_by,
    fall,
    last_worthwhile,
    left_out_squares,
    missed,
    predict,
    rms_of,
    set_alike,
)
from ..inference.description import OF_THE_ARM, WRITABLE_KINDS, route_changes, stiffness_change
from ..inference.fit import Fit, covariance_root
from ..inference.fitter import FAILURES
from ..inference.imperfections import (
    ANEW,
    POSITION,
    ROTATION,
    BuiltPredictor,
    Members,
    imperfections,
)
from ..inference.intervals import (
    UNDETERMINED,
    LoadVector,
    Value,
    Values,
    loads_of,
    values_of,
)
from ..inference.predict import FreeParameter, Predictor
from ..inference.session import Question, Session
from ..inference.statistics import QUANTILE, mean_over
from ..robot import Robot, RobotLike
from .add import Addition, more_at_work, settle, with_origin
from .local_tests import faults_of, local_faults
from .report_rows import arm_report, left_out
from .result import AS_FOUND, Improvement, ImprovementStep, total
from .stepwise import GROUPS_MIN, STEPS_MAX, State, Stepwise, grown, spread_of
from .verdict import P_SINGLE_MIN, TOLERANCE_SD_MAX

FRAME = (POSITION, ROTATION)
STEPS_IN_VAIN = 2  # [1] in a row end a search; not one, because some effects only help together


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
    def left_out(self) -> Floats:
        """Squared errors (P, J) [m²] of postures left out in turn."""
        return left_out_squares(self.session.fitter, self.fit, folds=self.search.folds)

    @property
    def is_worthwhile(self) -> bool:
        """Whether it lowers the left-out error of its search by more than the standard error."""
        before = self.state.left_out[:, None]
        predicted = np.isfinite(self.left_out[np.isfinite(before[:, 0])]).any(axis=1)
        search = self.search
        if not predicted.all() or np.isnan(rms_of(search.whole, self.robot, search.catalogue)):
            return False  # a posture has no equilibrium
        gain, scatter = fall(before, self.left_out)
        return gain > scatter

    def beside(self, state: State) -> Floats:
        """
        Predict markers (P, J, 3) [m] by a state of a search without some postures, and by the arm.

        The effects of the state and the imperfections that the other postures show, by one
        Gauss-Newton step from its fit; slopes and sizes of the imperfections are those of this
        one. Nan without an equilibrium.
        """
        search, fit, built = self.search, state.fit, self.session.imperfections
        own = np.flatnonzero([free.effect not in OF_THE_ARM for free in fit.frees])
        k, spread = len(own), self.fit.built.sizes[built.owners]
        # what was set anew in each recording is among the imperfections
        alone = fit.residual - fit.jacobian[:, len(fit.frees) :] @ fit.values[len(fit.frees) :]
        effects = replace(fit, residual=alone, jacobian=fit.jacobian[:, own])
        moves, standard = built.moves * spread[:, None, None, None], np.ones(len(spread))
        residual, jacobian = grown(effects, moves, state.whitener, standard)
        root = covariance_root(jacobian)[0]
        step = root @ (root.T @ (jacobian.T @ residual))
        moved = zip(own.tolist(), (fit.values[own] - step[:k]).tolist(), strict=True)
        point = {fit.frees[i]: fit.frees[i].clip(value) for i, value in moved}
        robot = search.written(state)
        arm = BuiltPredictor(Predictor(search.dataset, robot, search.catalogue))
        arm.around = {
            kind.name: -(spread * step[k:])[built.owners == i]
            for i, kind in enumerate(built.kinds)
            if kind.name in (*WRITABLE_KINDS, *ANEW.values())
        }
        markers = arm.markers(point)
        return np.full_like(fit.markers, np.nan) if markers is None else markers

    @cached_property
    def values(self) -> Values:
        """Values of the effects with 95 % intervals, which allow for changes of the arm itself."""
        values = values_of(self._freed, self.scale, self._freed.covariance)
        kinds = [kind.name for kind in self.fit.built.kinds]
        for free in self.state.effects.frees:
            tolerance = free.parameter.tolerance
            own = values.setdefault(free.effect, {})
            if tolerance in FRAME and tolerance in kinds:
                own[free.key] = self._with_imperfection(free, kinds.index(tolerance))
            elif free.key not in own:  # of one tendon or section, which a fit leaves as it was
                low, high, unit = free.parameter.low, free.parameter.high, free.parameter.unit
                own[free.key] = Value(self.state.fit.point[free], low, high, unit, UNDETERMINED)
        return values

    def _with_imperfection(self, free: FreeParameter, k: int) -> Value:
        """
        Return the sum of a parameter of the frame and the imperfection of the same direction.

        Where both are in the fit, only their sum is determined.
        """
        fit, built = self.fit, self.fit.built
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
        """The fit with the parameters of the arm that joined the search."""
        fit, whitener = self.fit, self.session.whitener
        blocks = [block for block in self.state.blocks if block.label in OF_THE_ARM]
        for joining in self.search.rates(self.state, blocks):
            spread = spread_of(joining.block.frees)
            residual, jacobian = grown(fit, joining.moves, whitener, spread)
            fit = replace(fit, residual=residual, jacobian=jacobian)
        return fit

    @property
    def loads(self) -> dict[str, LoadVector]:
        """Size and direction of the effects that are forces."""
        known = self._freed.covariance
        return loads_of(self._freed, self.session.predictor, self.scale, known)

    @property
    def values_of_the_search(self) -> Values:
        """Values of the search with the intervals of this fit, extended to hold them."""
        point, values = self.state.fit.point, Values()
        for free in self.state.effects.frees:
            own, value = self.values[free.effect][free.key], point[free]
            moved = replace(own, value=value, low=min(own.low, value), high=max(own.high, value))
            values.setdefault(free.effect, {})[free.key] = moved
        return values

    @property
    def loads_of_the_search(self) -> dict[str, LoadVector]:
        """Forces of the search; their covariance includes the difference from this fit."""
        values = np.array([self.state.fit.point[free] for free in self.fit.frees])
        q, off = len(values), values - self.fit.values[: len(values)]
        spread = self.scale * self._freed.covariance[:q, :q] + np.outer(off, off)
        moved = replace(self.fit, values=values)
        return loads_of(moved, self.session.predictor, covariance=spread)


def as_found(search: Stepwise, state: State) -> AsFound | None:
    """
    Fit a state of a search again, with the arm as it is built; None without an equilibrium.

    A frame error of plausible size is treated as an imperfection, not as an effect: as a free
    parameter it would absorb errors of kinks, whose size would then be underestimated. The
    imperfections have plausible sizes, where they are not larger: several effects that were
    selected by the same measurements also explain part of what imperfections cause, so that the
    estimated sizes, and with them the intervals, would be too small.
    """
    robot, before = search.written(state), search.robot
    names = [name for block in state.blocks for name in block.names if name not in OF_THE_ARM]
    frame = [free for free in state.fit.frees if free.parameter.tolerance in FRAME]
    if frame and not set(FRAME) & set(before.tolerances):
        sizes = {kind.name: kind.plausible for kind in BuiltPredictor(search.predictor).kinds()}
        moved = [state.fit.point[free] - search.predictor.value(free) for free in frame]
        usual = [sizes[free.parameter.tolerance] for free in frame]
        name = frame[0].effect
        if np.abs(np.divide(moved, usual)).max() <= TOLERANCE_SD_MAX:
            names.remove(name)
            robot = robot.without_effect(name)
            if name in before.effects:
                robot = robot.with_effect(name, before.effects[name], before.fitted.get(name))
    try:
        session = Question.of(search.dataset, robot, search.catalogue).weigh()
        settled = settle(session, names, {})
    except (*FAILURES, NoEquilibriumError):
        return None
    session, fit = settled.session, settled.fit
    usual = np.nan_to_num(fit.built.random.plausible, posinf=0.0)
    session.fitter.resume(fit)
    fit = session.fitter.fit(fit.frees, fit.point, sizes=np.maximum(fit.built.sizes, usual))
    return AsFound(search, state, session, fit, settled.scale)


@one_thread()
def improve(
    dataset: DataSetLike,
    robot: RobotLike | None = None,
    catalogue: CatalogueLike | None = None,
    check: DataSetLike | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Improvement:
    """
    Add effects one after the other while the error on left-out postures falls.

    Parameters
    ----------
    dataset : DataSet, path, or a list of these
        As `load_dataset` takes them.
    robot : Robot, name, path, text or dict, optional
        Default: the data set's.
    catalogue : Catalogue or paths, optional
    check : DataSet or path, optional
        Other postures, whose error is shown at every step; they have no part in anything.
    workers : int
        Has no effect: fits one after the other are faster than in threads.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    InputError
        Fewer than four postures, the noise is not known, or a mistake of the set-up explains the
        error and has to be corrected first.
    NoEquilibriumError

    """
    show = listener(progress)
    whole('workers', workers, 1)
    dataset = load_dataset(dataset, robot)
    before = dataset.robot
    other = None if check is None else load_dataset(check, before)
    search = Stepwise(dataset, before, load_catalogue(catalogue))
    if len(search.folds) < GROUPS_MIN:
        raise InputError(
            f'{search.dataset.name}: {len(search.folds)} different inputs, expected '
            f'{GROUPS_MIN} or more'
        )
    searched = Searched.by(search, other, show)
    search.refuse_mistake(searched.states[-1])
    arm = None if search.robot.exact else as_found(search, searched.states[searched.taken])
    if arm is not None:
        searched = replace(searched, arm=arm)
        if arm.is_worthwhile:
            searched = searched.with_the_arm()
    return searched.result()


def inner(states: Sequence[State]) -> Floats:
    """Return the left-out squared errors (K, P, 1) [m²] by which a search selects."""
    return np.array([state.left_out[:, None] for state in states])


def how_many(states: Sequence[State], errors: Floats) -> int:
    """
    Return how many steps are written.

    At most as many as the search selects by its own errors; of these the number with the smallest
    error (K, P, J) [m²] of the searches that did not know the posture.
    """
    steps_max = last_worthwhile(inner(states))
    return int(np.argmin(np.nanmean(errors[: steps_max + 1], axis=(1, 2))))


def shown(errors: Floats, taken: int) -> list[int]:
    """
    Return which steps are shown: of those taken only the ones that lower the left-out error.

    A step that lowers it only with a later one, or has no equilibrium, is merged with that;
    `errors` (K, P, J) [m²].
    """
    squares = np.nanmean(errors, axis=(1, 2))
    kept = [0]
    for k in range(1, taken + 1):
        if k == taken or squares[taken] < squares[k] < squares[kept[-1]]:
            kept.append(k)
    return [*kept, *(k for k in range(taken + 1, len(squares)) if np.isfinite(squares[k]))]


def errors_of(dataset: DataSet, robot: Robot, catalogue: Catalogue, anew: Members) -> Floats:
    """
    Return the rms errors (J,) [m] of a description; nan without an equilibrium.

    Without what was set anew in each recording.
    """
    alike = set_alike(dataset, robot, catalogue, anew)
    squares = (missed(alike, robot, catalogue) ** 2).sum(axis=2)
    return np.sqrt(mean_over(squares, 0))


@dataclass(frozen=True)
class Searched:
    """The steps of a search, and the errors of searches that did not know some postures."""

    search: Stepwise
    states: list[State]
    paths: list[list[State]]  # of the searches without each fold, the last state again and again
    errors: Floats  # (K, P, J) [m²] after 0, 1, ... steps
    taken: int  # steps
    # (P, J) [m²] after as many steps as a search that did not know the posture took
    chosen: Floats
    check: DataSet | None
    arm: AsFound | None = None  # the arm after the steps that are taken; None: it is exact
    last: Floats | None = None  # (P, J) [m²] with the arm as found; None: not tried
    arm_written: bool = False  # whether the arm as it was found is the last step

    @classmethod
    def by(cls, search: Stepwise, check: DataSet | None, show: Progress) -> Searched:
        """Search step by step, in turn with and without each fold, while this lowers errors."""
        walks = [search.without(held).path() for held in search.folds]
        paths, states, errors = [list[State]() for _ in walks], list[State](), list[Floats]()

        for k, state in enumerate(search.path()):
            show('searching', k, STEPS_MAX)
            after = errors_of(search.whole, search.written(state), search.catalogue, {})
            states.append(state)
            for i, (walk, path) in enumerate(zip(walks, paths, strict=True)):
                show('searching without some postures', i, len(walks))
                path.append(next(walk, None) or path[-1])
            # where a posture that was not used has no equilibrium it is not written
            lost = np.inf if np.isnan(after).all() else 0.0
            errors.append(search.squares([path[-1] for path in paths]) + lost)
            if k - int(np.argmin(np.nanmean(errors, axis=(1, 2)))) == STEPS_IN_VAIN:
                break
        chosen = search.squares([path[last_worthwhile(inner(path))] for path in paths])
        every = np.array(errors)
        return cls(search, states, paths, every, how_many(states, every), chosen, check)

    def with_the_arm(self) -> Searched:
        """
        Judge the arm as it was found as a last step, by searches that did not know the posture.

        It is written where their error falls by more than its standard error, as any step.
        """
        assert self.arm is not None
        last, chosen = self.errors[self.taken].copy(), self.chosen.copy()
        for held, path in zip(self.search.folds, self.paths, strict=True):
            steps = self.taken, last_worthwhile(inner(path))
            predicted = {k: self.arm.beside(path[k])[held] for k in set(steps)}
            for k, squares in zip(steps, (last, chosen), strict=True):
                off = self.search.measured[held] - predicted[k]
                if np.isfinite(off).any(axis=(1, 2)).all():
                    squares[held] = (off**2).sum(axis=2)
        gain, scatter = fall(self.errors[self.taken], last)
        if gain <= scatter:
            return replace(self, last=last)
        return replace(self, last=last, chosen=chosen, arm_written=True)

    def result(self) -> Improvement:
        """Return the improved description, its steps and errors."""
        search, states, arm, taken = self.search, self.states, self.arm, self.taken
        final, dataset = states[taken], search.dataset
        robots = [search.written(state) for state in states]
        kept, steps = shown(self.errors, taken), list[ImprovementStep]()
        for begin, k in zip([-1, *kept], kept, strict=False):
            merged = states[begin + 1 : k + 1]
            joined = [state.joined for state in merged]
            removed = [name for state in merged for name in state.removed]
            added = [name for name in joined if name and name not in removed]
            dropped = tuple(name for name in removed if name not in joined)
            before = self.errors[min(max(begin, 0), taken)]
            name, anew = ' + '.join(added), search.anew(states[k])
            steps.append(self._step(name, dropped, robots[k], anew, before, self.errors[k]))
        last_step, errors, robot = kept.index(taken), self.errors[taken], robots[taken]
        anew = search.anew(final)
        if self.last is not None and arm is not None:
            step = self._step(AS_FOUND, (), arm.robot, arm.fit.anew, errors, self.last)
            steps.insert(last_step + 1 if self.arm_written else len(steps), step)
            if self.arm_written:
                last_step, errors, robot = last_step + 1, self.last, arm.robot
                anew = arm.fit.anew
        predictor, _ = predict(dataset, robot, search.catalogue)
        addition = self._addition(steps[: last_step + 1], robot, anew, errors)
        tips = np.sqrt(errors[:, -1])
        return Improvement(
            robot=with_origin(addition, search.robot),
            steps=tuple(steps),
            taken=last_step,
            chosen=np.sqrt(mean_over(self.chosen, 0)),
            values=addition.values,
            loads=addition.loads,
            profile=stiffness_change(search.robot, final.fit.point),
            routes=route_changes(final.fit.point),
            markers=tuple(marker.name for marker in dataset.markers),
            data=dataset.name,
            check='' if self.check is None else self.check.name,
            noise_floor=search.plain.floor(),
            probability=addition.probability,
            more_at_work=addition.more_at_work,
            tips={dataset.postures[p]: float(tips[p]) for p in np.flatnonzero(np.isfinite(tips))},
            local_faults=self._faults(predictor),
            left_out=left_out(dataset, search.outliers, search.unsettled),
            as_built=arm_report(arm.session, arm.fit) if arm and self.arm_written else None,
            anew=anew,
        )

    def _step(
        self,
        joined: str,
        removed: tuple[str, ...],
        robot: Robot,
        anew: Members,
        before: Floats,
        after: Floats,
    ) -> ImprovementStep:
        """Return a step with its errors, those left out (P, J) [m²] before and after it."""
        catalogue, check = self.search.catalogue, self.check
        fitted = errors_of(self.search.whole, robot, catalogue, anew)
        left_out = np.sqrt(mean_over(after, 0))
        checked = None if check is None else errors_of(check, robot, catalogue, {})
        return ImprovementStep(joined, removed, fitted, left_out, checked, *fall(before, after))

    def _addition(
        self, steps: Sequence[ImprovementStep], robot: Robot, anew: Members, squares: Floats
    ) -> Addition:
        """Return the added effects with their errors (P, J) [m²], for the written description."""
        search, dataset, check, arm = self.search, self.search.dataset, self.check, self.arm
        kind, judged = ('left out', dataset) if check is None else ('check', check)
        floor, first, last = search.plain.floor(), steps[0], steps[-1]

        def errors(kind: str, data: DataSet, floor: float | None) -> Errors:
            before, after = total(first.errors[kind]), total(last.errors[kind])
            return Errors(kind, data.name, int((data.trials > 0).sum()), before, after, floor)

        fitted = errors('fitted', dataset, floor)
        final = self.states[self.taken]
        alike = set_alike(dataset, robot, search.catalogue, anew)
        chance = search.chance(missed(alike, robot, search.catalogue), len(final.fit.values))
        if arm is None:
            known = final.effects
            values, loads = values_of(known), loads_of(known, search.predictor)
        elif self.arm_written:
            values, loads = arm.values, arm.loads
        else:
            values, loads = arm.values_of_the_search, arm.loads_of_the_search
        more, error = '', None
        if chance <= P_SINGLE_MIN:
            more, error = more_at_work(fitted, chance, dataset, squares, floor)
        return Addition(
            robot,
            values,
            fitted,
            errors(kind, judged, floor if check is None else None),
            chance,
            more_at_work=more,
            model_error=error,
            beside=self.arm_written,
            loads=loads,
        )

    def _faults(self, predictor: Predictor) -> tuple[dict[str, Any], ...]:
        """Return the places where the improved description misfits by more than the remainder."""
        if self.arm is not None and self.arm_written:
            return tuple(faults_of(self.arm.session, self.arm.fit))
        as_built = imperfections(BuiltPredictor(predictor), {})
        if as_built is None:
            return ()
        final, freedom = self.states[self.taken], self.search.noise.freedom
        faults = local_faults(as_built.kinds, as_built.moves, final.whitener, final.fit, freedom)
        postures = self.search.dataset.postures
        return tuple(fault.to_json(predictor.robot, postures) for fault in faults)
