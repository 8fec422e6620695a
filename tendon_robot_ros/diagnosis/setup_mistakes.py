"""
Mistakes of the set-up that resemble effects: swapped columns, rotated axes, wrong units.

They are tested before the effects, and only where the error is gross. A mistake is reported as a
sentence with the error before and after its correction, and the correction itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..common.arrays import Floats
from ..common.words import listed, mm
from ..data import DataSet
from ..effects import Catalogue
from ..inference.candidates import Candidate, joining_effects, nuisances_of
from ..inference.fit import Fit
from ..inference.fitter import BEST_FEW, FAILURES, Fitter
from ..inference.noise import Noise, Whitener
from ..inference.predict import Point, Predictor
from ..inference.search import DIFFERENCE_STEP
from ..inference.session import Session
from ..inference.statistics import mean_over, rms
from .marker_hypotheses import PLACES, exchanged, in_one_place, miscounted, numbered, uncut
from .result import Diagnosis
from .setup_hypotheses import (
    SIZES,
    Mistake,
    dead_input,
    dead_inputs,
    evaluated,
    gravities,
    loose_inputs,
    moved_rows,
    off,
    registered,
    swapped_inputs,
    turned_axes,
)
from .verdict import (
    EFFECTS_MAX,
    MISTAKE_HANDICAP,
    MISTAKEN_RATIO_MIN,
    ODD_FROM_FLOORS,
    QUIET_FLOORS,
    RESIDUAL_RATIO_MAX,
    RESIDUAL_RATIO_USUAL,
    SAME_ERROR_RATIO,
)

# The simplest first: a free registration can imitate some of the others. It can also imitate a
# tilted base, which is an effect: only a gross error is attributed to it.
ORDERS = (swapped_inputs, loose_inputs, numbered, moved_rows)
DISCRETE = (*ORDERS, *SIZES, gravities, *PLACES, turned_axes)
HYPOTHESES = (*DISCRETE, registered)
BESIDE_EFFECTS = (*DISCRETE, dead_inputs)  # the last one has fitted values
NEARLY_EFFECTS = (gravities,)  # a load can imitate the weight of a light arm
# that can happen to an arm between two recordings of it, while others are in both, and cancel
NEW_MISTAKES = (*ORDERS, dead_inputs)
OF_INPUTS = (swapped_inputs, *SIZES)  # that can be why there is no equilibrium
STEPS_FEW = 8  # [1] of a fit, because hundreds are made and none is reported
# [1] postures of a long recording, because a mistake of the set-up shows in every one of them
SCREENED_POSTURES = 24
CUT_AS_GOOD_RATIO = 1.05  # [1] to the least error, so that the fewest cells are reported
Hypothesis = Callable[[Predictor, Floats], Iterable[Mistake]]
WEIGHT = ('gravity', 'linear_density')  # known from a scale, so that no tolerance is a factor


def find_mistake(predictor: Predictor, floor: float, usual: float = 0.0) -> Mistake | None:
    """
    Return the mistake of the set-up that explains a gross error; None where none does.

    Parameters
    ----------
    predictor : Predictor
        Of the description as it stands.
    floor : float
        Rms [m] that the noise alone makes.
    usual : float
        Rms [m] that an arm built as usual is off its description, noise included.

    """
    markers = predictor.markers({})
    if markers is None:  # find a mistake whose correction gives one
        nothing = np.full_like(predictor.dataset.mean, np.nan)
        mistakes = [one for kind in OF_INPUTS for one in kind(predictor, nothing)]
        return _plainest([one for one in mistakes if one.after < one.residual_max], floor)
    few = alone(predictor, markers, floor)
    if few and few[0].certain:
        return few[0]
    before = off(predictor, predictor.dataset.mean, markers)
    if before < ODD_FROM_FLOORS * floor:
        return None
    tries = _possible(
        HYPOTHESES if before > 2.0 * ODD_FROM_FLOORS * floor else DISCRETE, predictor.dataset
    )
    mistakes = few + [one for kind in tries for one in kind(predictor, markers)]
    certain = next((one for one in mistakes if one.certain), None)
    if certain is not None:
        return certain
    usually = max(RESIDUAL_RATIO_USUAL * before, QUIET_FLOORS * floor, 2.0 * usual)
    enough = min(usually, RESIDUAL_RATIO_MAX * before)
    likely = [one for one in mistakes if one.after < min(enough, one.residual_max)]
    return _plainest(likely, max(floor, 0.3 * usual))


def _possible(kinds: Sequence[Hypothesis], dataset: DataSet) -> list[Hypothesis]:
    """Return the kinds of mistakes that a data set may have."""
    return [kind for kind in kinds if dataset.reference is None or kind in NEW_MISTAKES]


def alone(predictor: Predictor, markers: Floats, floor: float) -> list[Mistake]:
    """Return the mistakes that the measurements show without the model being complete."""
    mistakes = [_cut(predictor, markers, floor), *exchanged(predictor, markers)]
    mistakes.append(_frozen(predictor, markers, floor))
    return [one for one in mistakes if one is not None]


def _as_good[M: (Mistake, Mended)](likely: Sequence[M], floor: float) -> list[M]:
    """Return what leaves about as little as the best, the simplest kind first."""
    lowest = min((one.after for one in likely), default=0.0) + floor
    return [one for one in likely if one.after <= SAME_ERROR_RATIO * lowest]


def _plainest[M: (Mistake, Mended)](likely: Sequence[M], floor: float) -> M | None:
    """Return the best mistake of the simplest kind that explains about as much as the best."""
    near = _as_good(likely, floor)
    own = [one for one in likely if one.name == near[0].name] if near else []
    return min(own, key=lambda one: one.after, default=None)


def _cut(predictor: Predictor, markers: Floats, floor: float) -> Mistake | None:
    """Return the mistake of markers clipped to one place at the end of the arm, if any."""
    dataset, robot = predictor.dataset, predictor.robot
    group, apart = in_one_place(dataset, robot, floor)
    if not group:
        return None
    before, places = off(predictor, dataset.mean, markers), uncut(dataset, robot)
    length = max(places.max(), robot.length) - min(places.min(), 0.0)
    names = listed([dataset.markers[j].name for j in group])
    one_place = f'markers {names} are described in one place and are {mm(apart)} apart'
    better = [
        one
        for one in miscounted(predictor, markers)
        if one.after < before
        and one.mended is not None
        and one.mended.robot.length > length - 0.5 * robot.sections[-1].cell_length
    ]
    lowest = min((one.after for one in better), default=np.inf)
    for one in better:  # the fewest cells: more beyond the last marker fit as well
        if one.after <= CUT_AS_GOOD_RATIO * lowest:
            return replace(one, sentence=f'{one_place}; {one.sentence}', certain=True)
    keep = np.delete(np.arange(len(dataset.markers)), group[1:])
    mend = 'count the cells of the arm, or give these markers the places or offsets that they have'
    after = off(predictor, dataset.mean[:, keep], markers[:, keep])
    return Mistake('cells', f'{one_place}; without all but one', mend, after, certain=True)


def _frozen(predictor: Predictor, markers: Floats, floor: float) -> Mistake | None:
    """Return the mistake of a marker that does not move while the others do, if any."""
    dataset = predictor.dataset
    moved = dataset.mean - mean_over(dataset.mean, 0)
    spread = np.sqrt(mean_over(moved**2, 0).sum(axis=1))
    if len(spread) < 3:
        return None
    seen = np.where(np.isfinite(dataset.mean), markers, np.nan)  # in the same postures
    expected = np.sqrt(mean_over((seen - mean_over(seen, 0)) ** 2, 0).sum(axis=1))
    still = np.flatnonzero(
        (spread < RESIDUAL_RATIO_USUAL * expected) & (expected > ODD_FROM_FLOORS * floor)
    )
    if len(still) != 1:
        return None
    name = dataset.markers[int(still[0])].name
    keep = np.arange(len(spread)) != still[0]
    (one,) = evaluated(
        predictor,
        markers[:, keep],
        'frozen_marker',
        f'marker {name} stands still while the arm moves; without it',
        f'take the rows of marker {name} out',
        markers=tuple(m for m, kept in zip(dataset.markers, keep, strict=True) if kept),
        positions=dataset.positions[:, :, keep],
        orientations=None,
    )
    return one


@dataclass(frozen=True)
class Explained:
    """Best explanation of a data set by effects, without imperfections."""

    residual: float  # [m] rms
    score: float  # chi² + 2 k, the noise as large as the usual error of an arm as built
    names: tuple[str, ...]
    point: Point
    quiet: bool = False  # whether the residual is within noise and usual imperfections


def is_odd(effect: str, key: str, value: float, described: float) -> bool:
    """Return whether a value deviates by a factor that is a mistake and no tolerance."""
    if effect == 'transmission_loss':
        factor = 1.0 - value
    elif key.startswith('relative_change'):
        factor = (1.0 + value) / (1.0 + described)
    elif (effect, key) == WEIGHT and described > 0.0:
        factor = value / described
    else:
        return False
    return not 1.0 / MISTAKEN_RATIO_MIN < factor < MISTAKEN_RATIO_MIN


def is_odd_fit(fit: Fit, predictor: Predictor) -> bool:
    """Return whether a fit has such a value."""
    frees, point = fit.frees, fit.point
    return any(is_odd(f.effect, f.key, point[f], predictor.value(f)) for f in frees)


class Explaining:
    """Fits of effects on data sets of one arm, without imperfections."""

    def __init__(self, catalogue: Catalogue, usual: float) -> None:
        """Take the usual rms error [m] of an arm as built."""
        self.catalogue, self.usual = catalogue, usual

    def with_effect(self, predictor: Predictor, mistake: Mistake) -> Mistake:
        """Return a mistake with values fitted together with an effect that acts as well."""
        for _ in range(2):
            free = mistake.free_input
            if free is None or mistake.mended is None:
                break
            beside = self.explain(mistake.mended, 1, 0.0, free)
            if beside is not None:
                mistake = next(dead_input(predictor, free, beside.point), mistake)
        return mistake

    def explain(
        self, dataset: DataSet, effects_max: int, enough: float, free: int | None = None
    ) -> Explained | None:
        """
        Explain a data set with as few effects as leave at most `enough` [m], up to `effects_max`.

        The input `free`, if any, may deviate in each posture. Of a long recording effects that
        remember are left to the diagnosis itself. None without equilibrium.
        """
        predictor = Predictor(dataset, dataset.robot, self.catalogue)
        noise = Noise(0.0, 0.0, 1.0, np.inf, 'declared')  # trials average no error of the arm away
        slopes = np.zeros((*predictor.inputs.shape, len(dataset.markers), 3))
        if free is not None:  # slopes of the markers, per its largest value
            moved = predictor.inputs.copy()
            moved[:, free] += DIFFERENCE_STEP * np.nanmax(moved)
            before, after = predictor.markers({}), predictor.markers({}, moved)
            if before is not None and after is not None:
                slopes[:, free] = (after - before) / DIFFERENCE_STEP
        nuisances = nuisances_of(dataset.robot, self.catalogue, predictor)
        whitener = Whitener(dataset, noise, slopes, rough=self.usual / np.sqrt(3.0))
        fitter = Fitter(predictor, whitener, nuisances)
        effects = joining_effects(dataset.robot, self.catalogue, dataset)
        if dataset.thinned_from:
            slow = self.catalogue.needing('history')
            effects = [effect for effect in effects if not slow & set(effect.names)]
        try:
            fit = fitter.fit((), steps=STEPS_FEW)
        except FAILURES:
            return None
        names: tuple[str, ...] = ()
        while len(names) < effects_max and rms(dataset.mean - fit.markers) > enough:
            better = self._with_one_more(fitter, fit, names, effects)
            if better is None:
                break
            fit, names = better
        return Explained(rms(dataset.mean - fit.markers), _score(fit), names, fit.point)

    def _with_one_more(
        self, fitter: Fitter, fit: Fit, names: tuple[str, ...], effects: Sequence[Candidate]
    ) -> tuple[Fit, tuple[str, ...]] | None:
        """Return the best fit with one more effect; None where none lowers the score."""
        promising = list[tuple[float, int, Candidate]]()  # by first steps
        for candidate in effects:
            with suppress(*FAILURES):
                if not set(candidate.names) & set(names):
                    chi2 = fitter.linear_chi2((*fit.frees, *candidate.frees), fit.point)
                    promising.append((chi2, len(promising), candidate))
        fits = list[tuple[float, int, Fit, tuple[str, ...]]]()
        for *_, candidate in sorted(promising)[:BEST_FEW]:
            frees = (*fit.frees, *candidate.frees)
            try:
                joint = fitter.fit(frees, fit.point if names else None, STEPS_FEW)
            except FAILURES:
                continue
            if not is_odd_fit(joint, fitter.predictor):  # an implausible value explains nothing
                fits.append((_score(joint), len(fits), joint, candidate.names))
        if not fits:
            return None
        score, _, joint, more = min(fits)
        return (joint, names + more) if score < _score(fit) else None


def _score(fit: Fit) -> float:
    return fit.chi2 + 2.0 * fit.rank


@dataclass(frozen=True)
class Mended:
    """A mistake, and the explanation of the corrected data set."""

    mistake: Mistake
    explained: Explained

    @property
    def name(self) -> str:
        """Name of the mistake."""
        return self.mistake.name

    @property
    def after(self) -> float:
        """Rms [m] that the effects leave of the corrected measurements."""
        return self.explained.residual

    def with_rest(self, residual: float, names: Sequence[str]) -> Mistake:
        """Return the mistake with a note on the residual [m] that effects leave as well."""
        helps = names and residual < self.mistake.after / SAME_ERROR_RATIO
        rest = f', and with {listed(names)} to {mm(residual)}' if helps else ''
        return replace(self.mistake, rest=rest)

    def agrees(self, diagnosis: Diagnosis) -> bool:
        """Return whether the values of common effects lie in the intervals of a diagnosis."""
        known = {effect.name: effect.parameters for effect in diagnosis.effects}
        return all(
            (own := known[free.effect].get(free.key)) is None or own.low <= value <= own.high
            for free, value in self.explained.point.items()
            if free.effect in known
        )

    def possible(self, quiet: bool) -> str:
        """Return the sentence of a possible mistake; `quiet` where effects explain as much."""
        effects = listed(self.explained.names) or 'no effect'
        error = mm(self.explained.residual)
        text = f'{self.mistake.sentence} and {effects} the error would fall to {error}'
        if quiet:
            return f'{text} as well: check which is right, values of {effects} depend on it'
        return f'{text}: {self.mistake.mend}'


def _rivals(
    predictor: Predictor,
    markers: Floats,
    explaining: Explaining,
    described: Explained,
    floor: float,
    progress: Callable[[str, int, int], None],
) -> list[Mended]:
    """
    Return the mistakes that explain more than the best effects, the best first.

    Of those that do about as well the plainest is the first. Where effects leave a quiet rest only
    those mistakes are tried that an effect can nearly make up for.

    Parameters
    ----------
    predictor : Predictor
        Of the description as it stands.
    markers : (P, J, 3) [m]
        Its prediction.
    explaining : Explaining
    described : Explained
        The data set as it is with its best effects.
    floor : float
        Rms [m] that the noise alone makes.
    progress : callable
        Called with (what, done, total).

    """
    kinds: dict[str, list[Mistake]] = {}
    if not described.quiet:
        kinds['alone'] = alone(predictor, markers, floor)
    tries = NEARLY_EFFECTS if described.quiet else BESIDE_EFFECTS
    for kind in _possible(tries, predictor.dataset):
        for one in kind(predictor, markers):
            kinds.setdefault(f'{kind.__name__} {one.name}', []).append(one)
    mistakes = [
        one for own in kinds.values() for one in sorted(own, key=lambda one: one.after)[:BEST_FEW]
    ]
    rivals = []
    for k, one in enumerate(mistakes):
        progress('mistakes of the set-up', k + 1, len(mistakes))
        if one.mended is None:
            continue
        one = explaining.with_effect(predictor, one)
        assert one.mended is not None
        explained = explaining.explain(one.mended, 1, floor)
        if explained is None:
            continue
        if described.quiet:  # the score, with usual errors as noise, decides nothing
            better = explained.residual < SAME_ERROR_RATIO * described.residual
        else:
            fitted = 0 if one.free_input is None else len(markers)
            handicap = 2.0 * fitted + MISTAKE_HANDICAP
            better = explained.score + handicap < described.score
        if better and explained.residual < one.residual_max:
            rivals.append(Mended(one, explained))
    first, near = _plainest(rivals, floor), _as_good(rivals, floor)
    if first is None:
        return []
    others = sorted((one for one in rivals if one is not first), key=lambda one: one.after)
    alike = [one for one in others if one in near]
    alike.sort(key=lambda one: one.name != first.name)  # those of its kind first
    sentences = dict.fromkeys(one.mistake.sentence for one in (first, *alike))
    said = replace(first.mistake, sentence=', or '.join([*sentences][:BEST_FEW]))
    return [Mended(said, first.explained), *others]


def mended_rivals(session: Session, enough: float) -> tuple[Explained | None, list[Mended]]:
    """
    Return the explanation of the unchanged data set by effects, and mistakes that explain more.

    Where one effect of a plausible value leaves little more than noise and the usual error of an
    arm as built, only mistakes that an effect can nearly imitate are tested.
    """
    predictor, floor, dataset = session.predictor, session.known_floor, session.dataset
    if dataset.thinned_from:
        dataset = dataset.thinned(SCREENED_POSTURES)
        predictor = Predictor(dataset, session.robot, session.catalogue)
    markers = predictor.markers({})
    if markers is None or off(predictor, dataset.mean, markers) < ODD_FROM_FLOORS * floor:
        return None, []
    enough = min(enough, QUIET_FLOORS * floor)
    explaining = Explaining(session.catalogue, session.usual_floor)
    dataset = replace(dataset, robot=session.robot)
    described = explaining.explain(dataset, 1, enough)
    if described is None:
        return None, []
    if described.residual <= enough:
        described = replace(described, quiet=True)
    else:
        described = explaining.explain(dataset, EFFECTS_MAX, floor)
        assert described is not None
    return described, _rivals(predictor, markers, explaining, described, floor, session.progress)


def implausible(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence for every estimated value that is too large to be a tolerance."""
    texts = []
    for effect in diagnosis.effects:
        described_values = diagnosis.details.get('described', {}).get(effect.name, {})
        for key, value in effect.parameters.items():
            described = described_values.get(key.split('[')[0], 0.0)
            before = float(np.mean(described))
            if not is_odd(effect.name, key, value.value, before):
                continue
            if (effect.name, key) == WEIGHT:
                texts.append(
                    f'{effect.name} of {value.value / before:.2g} times what is described is no '
                    'tolerance: check gravity [m/s²], and weigh the arm'
                )
                continue
            change = -value.value if effect.name == 'transmission_loss' else value.value
            texts.append(
                f'{effect.name} of {100.0 * change:+.0f} % is no tolerance: check the unit of '
                'the inputs, how the bending stiffness was worked out (modulus, diameter), '
                'the offsets of the tendons and the number of cells'
            )
    return list(dict.fromkeys(texts))  # of several inputs with the same value once


def in_shares(diagnosis: Diagnosis, input: str) -> list[str]:
    """
    Say what values in newtons depend on where the postures do not tell how stiff the arm is.

    By wire lengths alone an arm has the same shapes if its stiffness and all forces grow alike.
    """
    units = (value.unit for effect in diagnosis.effects for value in effect.parameters.values())
    told = input == 'tension' or 'backbone_stiffness' not in diagnosis.not_tested
    if told or not any('N' in unit for unit in units):
        return []
    return [
        'values in newtons depend on the bending stiffness of the description, which these '
        'postures do not tell: with twice the stiffness forces are twice as large; postures with '
        'a known load would tell'
    ]
