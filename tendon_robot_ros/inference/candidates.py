"""Effects that may be missing or whose value may be off, and why some cannot be judged."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..common.arrays import Floats, Ints
from ..data import DataSet
from ..effects import Catalogue, Effect
from ..robot import Robot
from .fit import FREEDOM_MANY, Fit, Nuisance
from .noise import Whitener
from .predict import FreeParameter, Point, Predictor, SettledShapes, free_parameters
from .statistics import beta_cdf, chi2_sf


def why_untested(effect: Effect, dataset: DataSet, robot: Robot) -> str:
    """Return in a few words why the postures do not show an effect."""
    if effect.acts_on and effect.acts_on not in robot.effects:
        return f'acts on {effect.acts_on}, which the description lacks'
    if 'pulls' in effect.needs and dataset.input == 'tension':
        return 'wire pulls not commanded'
    if 'history' in effect.needs:
        if dataset.path == 'from_straight':
            return 'every posture loaded from straight'
        return 'these postures hardly show it' if unloads(dataset) else 'no unloading'
    if 'gravity' in effect.needs:
        gravity = dataset.gravity_for(robot)
        if gravity is None:
            return 'direction of gravity unknown'
        if not np.any(gravity):
            return 'set to zero'
    return 'these postures hardly show it'


def acts(effect: Effect, robot: Robot, given: Collection[str]) -> bool:
    """Return whether an effect acts on an arm if these needs are given; those at places do not."""
    shapes = not effect.acts_on or effect.acts_on in robot.effects
    return shapes and not effect.placed and set(effect.needs.split()) <= set(given)


@dataclass(frozen=True)
class Candidate:
    """One or several effects whose parameters are freed together."""

    names: tuple[str, ...]
    frees: tuple[FreeParameter, ...]
    present: bool  # already in the description: its value may be wrong

    @property
    def label(self) -> str:
        """Name to print."""
        return ' + '.join(self.names)

    def with_(self, other: Candidate) -> Candidate:
        """Both together."""
        return Candidate(
            self.names + other.names, self.frees + other.frees, self.present and other.present
        )

    def without(self, name: str) -> Candidate:
        """All but one effect."""
        return Candidate(
            tuple(one for one in self.names if one != name),
            tuple(free for free in self.frees if free.effect != name),
            self.present,
        )


@dataclass(frozen=True, eq=False)
class Ranked:
    """A candidate with its fit and measures of its quality."""

    candidate: Candidate
    fit: Fit
    noise_freedom: float  # degrees of freedom behind the noise
    owners: Ints  # posture (N,) of each whitened value

    @property
    def names(self) -> tuple[str, ...]:
        """Effects."""
        return self.candidate.names

    @property
    def present(self) -> bool:
        """Whether the description has them already."""
        return self.candidate.present

    @property
    def misfit(self) -> float:
        """Chi² over its degrees of freedom."""
        return self.fit.chi2 / max(self.fit.freedom, 1)

    @cached_property
    def probability(self) -> float:
        """P-value of its chi²."""
        return self.fit.probability(self.noise_freedom)

    @cached_property
    def _left_out(self) -> tuple[float, float]:
        return self.fit.held_out(self.owners)

    @property
    def held_out(self) -> float:
        """Chi² of postures predicted from the others."""
        return self._left_out[0]

    @property
    def trust(self) -> float:
        """P-value of the excess of `held_out` over the fitted chi²."""
        return self._left_out[1]

    @property
    def score(self) -> float:
        """Chi² plus twice the number of parameters: smaller is better."""
        return self.fit.deviance + 2.0 * self.fit.rank


def nuisances_of(robot: Robot, catalogue: Catalogue, predictor: Predictor) -> list[Nuisance]:
    """Return declared tolerances as parameters with priors; friction only where described."""
    nuisances = []
    for quantity, spread in robot.tolerances.items():
        twin = catalogue.twin(quantity)
        if twin is None or spread <= 0.0:
            continue
        effect, parameters = twin
        for free in free_parameters(catalogue[effect], robot):
            if free.parameter.name not in parameters:
                continue
            centre = predictor.value(free)
            size = spread * centre if quantity == 'friction_coefficient' else spread
            if size > 0.0:
                nuisances.append(Nuisance(quantity, free, centre, size))
    return nuisances


def candidates_of(robot: Robot, catalogue: Catalogue) -> list[Candidate]:
    """Every effect of the catalogue, in its order."""
    return [
        Candidate((effect.name,), free_parameters(effect, robot), effect.name in robot.effects)
        for effect in catalogue
        if effect.name in robot.effects or not effect.placed
    ]


def joining_effects(robot: Robot, catalogue: Catalogue, dataset: DataSet) -> list[Candidate]:
    """
    Return the effects that may join a description that lacks several, in the catalogue's order.

    Effects that the data cannot show are excluded; one that only modifies another effect may also
    join together with it.
    """
    lacks = {'pulls': dataset.input == 'tension', 'history': not unloads(dataset)}
    own = [
        c
        for c in candidates_of(robot, catalogue)
        if not any(lacks.get(need) for need in catalogue[c.label].needs.split())
    ]
    known = {c.label: c for c in own}
    pairs = [
        known[catalogue[c.label].acts_on or ''].with_(c)
        for c in own
        if catalogue[c.label].always_on and catalogue[c.label].acts_on in known
    ]
    return own + [pair for pair in pairs if not set(pair.names) & set(robot.effects)]


def is_tested(
    candidate: Candidate,
    predictor: Predictor,
    whitener: Whitener,
    point: Point,
    markers: Floats,
    near: SettledShapes | None,
) -> bool:
    """
    Return whether a typical size of the effect changes the markers (P, J, 3) at a point.

    An effect that only acts on another one does so where that is described or in the point.
    """
    effect = predictor.model.catalogue[candidate.names[0]]
    if effect.acts_on and not candidate.present:
        present = {*predictor.robot.effects, *(free.effect for free in point)}
        if effect.acts_on not in present:
            return False
    if 'history' in effect.needs and not candidate.present and not unloads(predictor.dataset):
        return False
    if effect.always_on and not candidate.present:
        # without it the arm is the base, from which its typical values differ
        shown = [f for f in candidate.frees if not f.parameter.has_default]
        moves = [{free: free.parameter.typical for free in shown}]
    else:
        moves = []
        for free in candidate.frees:
            value = point.get(free, predictor.value(free))
            moves.append({free: value + free.parameter.step(value, 1.0)})
    for move in moves:
        moved = predictor.markers({**point, **move}, near=near)
        if moved is None:
            return True
        white = whitener.white(moved - markers)
        if float(white @ white) > 1.0:  # more than one standard deviation of the noise
            return True
    return False


def unloads(dataset: DataSet) -> bool:
    """Return whether an input falls between a posture and the next one."""
    inputs, visits = np.nan_to_num(dataset.inputs), dataset.visits
    if visits is None:
        paths = [rows for _, rows in dataset.divided]
    else:
        paths = [visits.rows[leg] for leg in visits.legs()]
    let_go = any((np.diff(inputs[path], axis=0) < 0.0).any() for path in paths)
    return dataset.path != 'from_straight' and let_go


def gain_p_value(
    base: Fit, whitener: Whitener, deviance: float, markers: Floats, rank: int
) -> float:
    """
    Return the p-value of a gain in deviance over a fit.

    Parameters
    ----------
    base : Fit
    whitener : Whitener
    deviance : float
        Of what explains more.
    markers : (P, J, 3) [m]
        Of its model, without the imperfections.
    rank : int
        Number of its parameters beyond those of the fit.

    """
    shift = whitener.white(markers - base.markers)
    freedom = base.built.random.freedom(shift, base.built.sizes)
    return likelihood_ratio_p_value(base.deviance - deviance, rank, freedom)


def likelihood_ratio_p_value(gain: float, rank: int, freedom: float = np.inf) -> float:
    """
    Return the p-value of a gain in deviance by `rank` parameters: the likelihood ratio test.

    Of an arm as built by an F distribution: `freedom` deviations determine the spread of the
    change of the fit by chance, which the fit itself may underestimate.
    """
    if gain <= 0.0:
        return 1.0
    if freedom >= FREEDOM_MANY:
        return chi2_sf(gain, rank)
    # 1 / (1 + F rank / freedom), because F itself overflows for large gains
    return beta_cdf(np.exp(-gain / (freedom + rank)), 0.5 * freedom, 0.5 * rank)
