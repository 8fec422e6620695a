"""The candidates of a diagnosis: effects that may be missing, and those whose value may be off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from .cells import cell_nuisances
from .fit import Fit, Nuisance
from .noise import Whitener
from .predict import CELLS, Free, Point, Predictor, free_parameters
from .probability import chi2_sf

# Quantity under `tolerances` -> the effect whose parameter says the same.
TWINS = {
    'bending_stiffness': ('backbone_stiffness', ('relative_change',)),
    'tension_gain': ('transmission_loss', ('fraction',)),
    'friction_coefficient': ('tendon_friction', ('friction_coefficient',)),
    'position': ('base_misalignment', ('shift_x', 'shift_y', 'shift_z')),
    'rotation': ('base_misalignment', ('rotation_x', 'rotation_y', 'rotation_z')),
}
# Effects that contain another as a special case.
CONTAINS = {'section_stiffness': ('backbone_stiffness',)}
SEEN = 1.0  # whitened squared change by a typical size below which an effect is not tested


@dataclass(frozen=True)
class Candidate:
    """One or several effects whose parameters are freed together."""

    names: tuple[str, ...]
    frees: tuple[Free, ...]
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


@dataclass(frozen=True)
class Ranked:
    """A candidate with its fit and what it is worth."""

    candidate: Candidate
    fit: Fit
    probability: float  # of so large a chi² if it is the truth
    held_out: float  # chi² of postures predicted from the others
    trust: float  # probability of so much more than the fitted chi²

    @property
    def score(self) -> float:
        """Chi² plus twice the number of parameters: smaller is better."""
        return self.fit.chi2 + 2.0 * self.fit.rank


def nuisances_of(robot: Robot, catalogue: Catalogue, predictor: Predictor) -> list[Nuisance]:
    """Return declared tolerances as parameters with priors; friction only where there is some."""
    found = []
    for quantity, spread in robot.tolerances.items():
        if quantity == CELLS and spread > 0.0:
            found += cell_nuisances(robot, spread)
        if quantity not in TWINS:
            continue
        effect, parameters = TWINS[quantity]
        if effect not in catalogue or spread <= 0.0:
            continue
        for free in free_parameters(catalogue[effect], robot):
            if free.parameter.name not in parameters:
                continue
            centre = predictor.value(free)
            size = spread * centre if quantity == 'friction_coefficient' else spread
            if size > 0.0:
                found.append(Nuisance(quantity, free, centre, size))
    return found


def candidates_of(robot: Robot, catalogue: Catalogue) -> list[Candidate]:
    """Every effect of the catalogue, in its order."""
    return [
        Candidate((effect.name,), free_parameters(effect, robot), effect.name in robot.effects)
        for effect in catalogue
    ]


def is_tested(
    candidate: Candidate, predictor: Predictor, whitener: Whitener, point: Point, here: np.ndarray
) -> bool:
    """Tell whether the postures would show a typical size of the effect at a point."""
    effect = predictor.model.catalogue[candidate.names[0]]
    if effect.stage == 'memory' and not candidate.present and not unloads(predictor.dataset):
        return False
    if effect.always_on and not candidate.present:
        # its absence is the base; what shows is what it changes there
        moves = [
            {free: factor * free.parameter.typical for free in candidate.frees}
            for factor in (1.0,)
        ]
    else:
        moves = [
            {free: _moved(point.get(free, predictor.value(free)), free)}
            for free in candidate.frees
        ]
    for move in moves:
        there = predictor.markers({**point, **move})
        if there is None:
            return True
        white = whitener.white(there - here)
        if float(white @ white) > SEEN:
            return True
    return False


def _moved(value: float, free: Free) -> float:
    """Move a value by its typical size, to the side that has room."""
    parameter = free.parameter
    up = value + parameter.typical
    return up if up <= parameter.high else max(value - parameter.typical, parameter.low)


def unloads(dataset: DataSet) -> bool:
    """Tell whether a sequence ever lets an input go."""
    steps = np.diff(np.nan_to_num(dataset.inputs), axis=0)
    return dataset.path == 'sequence' and bool((steps < 0.0).any())


def gain_probability(base: Fit, fit: Fit, described: Sequence[float]) -> float:
    """Chance of so much gain in chi² by luck (likelihood ratio; one-sided at a bound: half)."""
    gain, rank = base.chi2 - fit.chi2, max(fit.rank, 1)
    if gain <= 0.0:
        return 1.0
    probability = chi2_sf(gain, rank)
    one_sided = len(fit.frees) == 1 and described[0] in (
        fit.frees[0].parameter.low,
        fit.frees[0].parameter.high,
    )
    return 0.5 * probability if one_sided else probability
