"""
Mistakes of the set-up against missing effects: which of both explains a gross error.

Every hypothesis is a data set without a mistake. It is fitted as it stands, with the effect that
helps most and the tracker's frame, as the described one is with up to three effects. Errors count
as independent, as large as an arm built as usual is off its description: that is enough to tell
errors far above it, and a fit takes some hundredths of a second.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..common.words import listed, mm
from ..comparison.noise import Noise, Whitener, rms
from ..comparison.predict import Predictor
from ..data import DataSet
from ..effects import Catalogue
from .arm_report import usual_floor
from .candidates import Candidate, joining_effects, nuisances_of
from .decide import (
    AS_GOOD_WITHIN,
    EFFECTS_MAX,
    MISTAKE_HANDICAP,
    ODD_FROM_FLOORS,
    QUIET_WITHIN_FLOORS,
    STIFFNESS_FACTOR_MAX,
)
from .fit import Fit
from .fitter import Fitter
from .mistake import Mistake, off
from .result import Diagnosis
from .session import Session
from .setup_hypotheses import BESIDE_EFFECTS
from .setup_mistakes import alone

FITTED_MAX = 3  # effects whose first steps promise most, and which are fitted
TURNS = 8  # of such a fit
OF_A_KIND_MAX = 3  # hypotheses of a kind that leave least by themselves, and are fitted
WEIGHT = ('gravity', 'linear_density')  # which a scale tells: no tolerance is a factor
NO_FIT = (ArithmeticError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Explained:
    """A data set with the effects that explain it best, without imperfections."""

    left: float  # [m] rms
    score: float  # chi² + 2 k, errors as large as those of an arm built as usual
    names: tuple[str, ...]


def is_odd(effect: str, key: str, value: float, described: float) -> bool:
    """Tell whether a value is off by a factor that is a mistake and no tolerance."""
    if effect == 'transmission_loss':
        factor = 1.0 - value
    elif key.startswith('relative_change'):
        factor = 1.0 + value
    elif (effect, key) == WEIGHT and described > 0.0:
        factor = value / described
    else:
        return False
    return not 1.0 / STIFFNESS_FACTOR_MAX < factor < STIFFNESS_FACTOR_MAX


class Explaining:
    """Fits of effects on data sets of one arm, without imperfections."""

    def __init__(self, catalogue: Catalogue, usual: float) -> None:
        """Take the rms [m] that an arm built as usual is off."""
        self.catalogue, self.usual = catalogue, usual

    def explain(self, dataset: DataSet, most: int, enough: float) -> Explained | None:
        """
        Return a data set with up to so many effects, as few as leave no more than `enough` [m].

        None where it has no equilibrium.
        """
        predictor = Predictor(dataset, dataset.robot, self.catalogue)
        noise = Noise(self.usual / np.sqrt(3.0), 0.0, 0.0, np.inf, 'declared')
        slopes = np.zeros((*predictor.inputs.shape, len(dataset.markers), 3))
        nuisances = nuisances_of(dataset.robot, self.catalogue, predictor)
        fitter = Fitter(predictor, Whitener(dataset, noise, slopes), nuisances)
        effects = joining_effects(dataset.robot, self.catalogue, dataset)
        try:
            fit = fitter.fit((), turns=TURNS)
        except NO_FIT:
            return None
        names: tuple[str, ...] = ()
        while len(names) < most and rms(dataset.mean - fit.markers) > enough:
            better = self._with_one_more(fitter, fit, names, effects)
            if better is None:
                break
            fit, names = better
        return Explained(rms(dataset.mean - fit.markers), _score(fit), names)

    def _with_one_more(
        self, fitter: Fitter, fit: Fit, names: tuple[str, ...], effects: Sequence[Candidate]
    ) -> tuple[Fit, tuple[str, ...]] | None:
        """Return the best fit with one more effect; None where none does better."""
        found = list[tuple[float, int, Fit, tuple[str, ...]]]()
        for candidate in self._promising(fitter, fit, names, effects):
            frees = (*fit.frees, *candidate.frees)
            try:
                made = fitter.fit(frees, fit.point if names else None, TURNS)
            except NO_FIT:
                continue
            known = fitter.predictor
            odd = [is_odd(f.effect, f.key, made.point[f], known.value(f)) for f in made.frees]
            if not any(odd):  # what nothing is off by explains nothing
                found.append((_score(made), len(found), made, candidate.names))
        if not found:
            return None
        score, _, made, more = min(found)
        return (made, names + more) if score < _score(fit) else None

    def _promising(
        self, fitter: Fitter, fit: Fit, names: tuple[str, ...], effects: Sequence[Candidate]
    ) -> list[Candidate]:
        """Return the effects whose first steps promise to leave least."""
        promised = list[tuple[float, int, Candidate]]()
        for candidate in effects:
            if set(candidate.names) & set(names):
                continue
            try:
                left = fitter.promised((*fit.frees, *candidate.frees), fit.point)
            except NO_FIT:
                continue
            promised.append((left, len(promised), candidate))
        return [candidate for *_, candidate in sorted(promised)[:FITTED_MAX]]


def _score(fit: Fit) -> float:
    return fit.chi2 + 2.0 * fit.rank


@dataclass(frozen=True)
class Rival:
    """A mistake, and what explains the data set without it."""

    mistake: Mistake
    explained: Explained

    def told(self, left: float, names: Sequence[str]) -> Mistake:
        """Return the mistake with what becomes of the error [m] that it leaves."""
        helps = names and left < self.mistake.after / AS_GOOD_WITHIN
        rest = f', and with {listed(names)} to {mm(left)}' if helps else ''
        return replace(self.mistake, rest=rest)


def _rivals(
    predictor: Predictor,
    explaining: Explaining,
    described: Explained,
    floor: float,
    progress: Callable[[str, int, int], None],
) -> list[Rival]:
    """
    Return the mistakes that explain more than the best effects do, the best first.

    Of those that do about as well the plainest is the first.

    Parameters
    ----------
    predictor : Predictor
        Of the description as it stands.
    explaining : Explaining
    described : Explained
        The data set as it is with its best effects.
    floor : float
        Rms [m] that the noise alone makes.
    progress : callable
        Called with (what, done, total).

    """
    markers = predictor.markers({})
    if markers is None:
        return []
    kinds: dict[str, list[Mistake]] = {}
    for one in alone(predictor, markers, floor):
        kinds.setdefault(one.name, []).append(one)
    for one in (one for kind in BESIDE_EFFECTS for one in kind(predictor, markers)):
        kinds.setdefault(one.name, []).append(one)
    tried = [
        one
        for own in kinds.values()
        for one in sorted(own, key=lambda one: one.after)[:OF_A_KIND_MAX]
    ]
    found = []
    for k, one in enumerate(tried):
        progress('mistakes of the set-up', k + 1, len(tried))
        if one.mended is None:
            continue
        explained = explaining.explain(one.mended, 1, floor)
        if explained is None:
            continue
        handicap = 2.0 * one.fitted + MISTAKE_HANDICAP
        if explained.left < one.most and explained.score + handicap < described.score:
            found.append(Rival(one, explained))
    if not found:
        return []
    least = AS_GOOD_WITHIN * (min(one.explained.left for one in found) + floor)
    near = [one for one in found if one.explained.left <= least]  # the plainest is the first
    first = min(
        (one for one in near if one.mistake.name == near[0].mistake.name),
        key=lambda one: one.explained.left,
    )
    others = sorted((one for one in found if one is not first), key=lambda one: one.explained.left)
    alike = [one.mistake for one in others if one in near]  # those of its kind say most
    alike.sort(key=lambda one: one.name != first.mistake.name)
    if alike:
        said = dict.fromkeys(one.sentence for one in (first.mistake, *alike))
        sentence = ', or '.join([*said][:OF_A_KIND_MAX])
        first = Rival(replace(first.mistake, sentence=sentence), first.explained)
    return [first, *others]


def rivals_of(session: Session, enough: float) -> tuple[Explained | None, list[Rival]]:
    """
    Return what effects explain of the data set as it is, and the mistakes that explain more.

    None are looked for where one effect leaves little more than noise, or than an arm built as
    usual is off, with a value that may be.
    """
    predictor, floor = session.predictor, session.whitener.floor()
    markers = predictor.markers({})
    if markers is None:
        return None, []
    if off(predictor, session.dataset.mean, markers) < ODD_FROM_FLOORS * floor:
        return None, []
    enough = min(enough, QUIET_WITHIN_FLOORS * floor)
    explaining = Explaining(session.catalogue, usual_floor(session))
    dataset = replace(session.dataset, robot=session.robot)
    described = explaining.explain(dataset, 1, enough)
    if described is None or (described.left <= enough):
        return described, []
    described = explaining.explain(dataset, EFFECTS_MAX, floor)
    assert described is not None
    return described, _rivals(predictor, explaining, described, floor, session.progress)


def implausible(diagnosis: Diagnosis) -> list[str]:
    """Say which found values nothing is off by; nothing where all may be."""
    said = []
    for effect in diagnosis.effects:
        there = diagnosis.details.get('described', {}).get(effect.name, {})
        for key, value in effect.parameters.items():
            described = there.get(key.split('[')[0], 0.0)
            before = float(np.mean(described))
            if not is_odd(effect.name, key, value.value, before):
                continue
            if before > 0.0:
                said.append(
                    f'{effect.name} of {value.value / before:.2g} times what is described is no '
                    'tolerance: check gravity [m/s²], and weigh the arm'
                )
                continue
            change = -value.value if effect.name == 'transmission_loss' else value.value
            said.append(
                f'{effect.name} of {100.0 * change:+.0f} % is no tolerance: check the unit of '
                'the inputs, how the bending stiffness was worked out (modulus, diameter), '
                'the offsets of the tendons and the number of cells'
            )
    return said
