"""
Mistakes of the set-up that look like physics: swapped columns, turned axes, wrong units.

They are tried before any effect is, and only where the error is gross. Each is one sentence with
the error before and after, and what mends it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..common.arrays import Floats
from ..common.words import listed, mm
from ..comparison.noise import Noise, Whitener, rms
from ..comparison.predict import Point, Predictor
from ..data import DataSet
from ..effects import Catalogue
from .candidates import Candidate, joining_effects, nuisances_of
from .fit import Fit
from .fitter import FAILURES, Fitter
from .marker_hypotheses import (
    by_distances,
    exchanged,
    in_one_place,
    miscounted,
    numbered,
    otherwise_divided,
    spots,
    uncut,
)
from .result import Diagnosis
from .search import DIFFERENCE_STEP
from .session import Session
from .setup_hypotheses import (
    Mistake,
    dead_inputs,
    gravities,
    loose_inputs,
    moved_rows,
    off,
    registered,
    swapped_inputs,
    tried,
    turned_axes,
    wrong_offsets,
    wrong_stiffness,
    wrong_units,
)
from .verdict import (
    BEST_FEW,
    EFFECTS_MAX,
    ERROR_LEFT_MAX,
    ERROR_LEFT_USUAL,
    MISTAKE_HANDICAP,
    MISTAKEN_RATIO_MIN,
    ODD_FROM_FLOORS,
    QUIET_FLOORS,
    SAME_ERROR_RATIO,
)

# The plainest first: what a free registration can do, some of the others can do as well. It can
# also do what a tilted base does, which is an effect: only a gross error is laid to it.
DISCRETE = (
    swapped_inputs,
    loose_inputs,
    numbered,
    moved_rows,
    wrong_units,
    wrong_offsets,
    wrong_stiffness,
    gravities,
    spots,
    by_distances,
    miscounted,
    otherwise_divided,
    turned_axes,
)
HYPOTHESES = (*DISCRETE, registered)
BESIDE_EFFECTS = (*DISCRETE, dead_inputs)  # the last needs values of its own
NEARLY_EFFECTS = (gravities,)  # a load can take up nearly all that the weight of a light arm does
STEPS_FEW = 8  # [1] of a fit, because hundreds are made and none is told
CUT_AS_GOOD_RATIO = 1.05  # [1] to the least error, so that the fewest cells are said
WEIGHT = ('gravity', 'linear_density')  # which a scale tells: no tolerance is a factor


OF_INPUTS = (
    swapped_inputs,
    wrong_units,
    wrong_offsets,
    wrong_stiffness,
)  # that can be why there is no equilibrium


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
    if markers is None:  # the mistake without which the model has an equilibrium at all
        nothing = np.full_like(predictor.dataset.mean, np.nan)
        mistakes = [one for kind in OF_INPUTS for one in kind(predictor, nothing)]
        return _plainest([one for one in mistakes if one.after < one.most], floor)
    few = alone(predictor, markers, floor)
    if few and few[0].certain:
        return few[0]
    before = off(predictor, predictor.dataset.mean, markers)
    if before < ODD_FROM_FLOORS * floor:
        return None
    tries = HYPOTHESES if before > 2.0 * ODD_FROM_FLOORS * floor else DISCRETE
    enough = max(ERROR_LEFT_USUAL * before, QUIET_FLOORS * floor, 2.0 * usual)
    mistakes = few + [one for kind in tries for one in kind(predictor, markers)]
    certain = next((one for one in mistakes if one.certain), None)
    if certain is not None:
        return certain
    enough = min(enough, ERROR_LEFT_MAX * before)
    likely = [one for one in mistakes if one.after < min(enough, one.most)]
    return _plainest(likely, max(floor, 0.3 * usual))


def alone(predictor: Predictor, markers: Floats, floor: float) -> list[Mistake]:
    """Return the mistakes that the measurements show by themselves, whatever the model lacks."""
    found = [_cut(predictor, markers, floor), *exchanged(predictor, markers)]
    found.append(_frozen(predictor, markers, floor))
    return [one for one in found if one is not None]


def _plainest(likely: Sequence[Mistake], floor: float) -> Mistake | None:
    """Return the first kind of those that do about as well as the best; of a kind the best."""
    if not likely:
        return None
    least = min(one.after for one in likely) + floor
    plain = next(one for one in likely if one.after <= SAME_ERROR_RATIO * least)
    return min((one for one in likely if one.name == plain.name), key=lambda one: one.after)


def _cut(predictor: Predictor, markers: Floats, floor: float) -> Mistake | None:
    """Find markers that are described in one place and are not: cut at the end of the arm."""
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
    least = min((one.after for one in better), default=np.inf)
    for one in better:  # the fewest cells: beyond the last marker more of them do as well
        if one.after <= CUT_AS_GOOD_RATIO * least:
            return replace(one, sentence=f'{one_place}; {one.sentence}', certain=True)
    keep = np.delete(np.arange(len(dataset.markers)), group[1:])
    mend = 'count the cells of the arm, or give these markers the places or offsets that they have'
    after = off(predictor, dataset.mean[:, keep], markers[:, keep])
    return Mistake('cells', f'{one_place}; without all but one', mend, after, certain=True)


def _frozen(predictor: Predictor, markers: Floats, floor: float) -> Mistake | None:
    """Find a marker that stands still while the others move."""
    dataset = predictor.dataset
    spread = np.sqrt(np.nanvar(dataset.mean, axis=0).sum(axis=1))
    if len(spread) < 3:
        return None
    should = np.sqrt(np.var(markers, axis=0).sum(axis=1))
    still = np.flatnonzero(
        (spread < ERROR_LEFT_USUAL * should) & (should > ODD_FROM_FLOORS * floor)
    )
    if len(still) != 1:
        return None
    name = dataset.markers[int(still[0])].name
    keep = np.arange(len(spread)) != still[0]
    (one,) = tried(
        predictor,
        markers[:, keep],
        'frozen_marker',
        f'marker {name} stands still while the arm moves; without it',
        f'take the rows of marker {name} out',
        dataset=replace(
            dataset,
            markers=tuple(m for m, kept in zip(dataset.markers, keep, strict=True) if kept),
            positions=dataset.positions[:, :, keep],
            orientations=None,
        ),
    )
    return one


@dataclass(frozen=True)
class Explained:
    """A data set with the effects that explain it best, without imperfections."""

    left: float  # [m] rms
    score: float  # chi² + 2 k, errors as large as those of an arm built as usual
    names: tuple[str, ...]
    point: Point
    quiet: bool = False  # whether noise, and an arm built as usual, would leave as much


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
    return not 1.0 / MISTAKEN_RATIO_MIN < factor < MISTAKEN_RATIO_MIN


class Explaining:
    """Fits of effects on data sets of one arm, without imperfections."""

    def __init__(self, catalogue: Catalogue, usual: float) -> None:
        """Take the rms [m] that an arm built as usual is off."""
        self.catalogue, self.usual = catalogue, usual

    def with_effect(self, mistake: Mistake) -> Mistake:
        """Return a mistake whose fitted values suit an effect that acts as well."""
        for _ in range(2):
            if mistake.beside is None or mistake.mended is None:
                break
            beside = self.explain(mistake.mended, 1, 0.0, mistake.free_input)
            again = None if beside is None else mistake.beside(beside.point)
            if again is None:
                break
            mistake = again
        return mistake

    def explain(
        self, dataset: DataSet, most: int, enough: float, free: int | None = None
    ) -> Explained | None:
        """
        Return a data set with up to so many effects, as few as leave no more than `enough` [m].

        Of an input that is `free` each posture may have any value near the one that it has. None
        where the data set has no equilibrium.
        """
        predictor = Predictor(dataset, dataset.robot, self.catalogue)
        noise = Noise(self.usual / np.sqrt(3.0), 0.0, 1.0, np.inf, 'declared')
        slopes = np.zeros((*predictor.inputs.shape, len(dataset.markers), 3))
        if free is not None:  # how markers answer to it, per its largest value
            inputs = predictor.inputs
            step, sides = DIFFERENCE_STEP * float(np.nanmax(inputs)), []
            for sign in (1.0, -1.0):
                moved = inputs.copy()
                moved[:, free] = np.maximum(moved[:, free] + sign * step, 0.0)
                sides.append(predictor.markers({}, moved))
            if sides[0] is not None and sides[1] is not None:
                width = 2.0 * step - np.maximum(step - inputs[:, free], 0.0)
                per_largest = (step / DIFFERENCE_STEP / width)[:, None, None]
                slopes[:, free] = (sides[0] - sides[1]) * per_largest
        nuisances = nuisances_of(dataset.robot, self.catalogue, predictor)
        fitter = Fitter(predictor, Whitener(dataset, noise, slopes), nuisances)
        effects = joining_effects(dataset.robot, self.catalogue, dataset)
        try:
            fit = fitter.fit((), steps=STEPS_FEW)
        except FAILURES:
            return None
        names: tuple[str, ...] = ()
        while len(names) < most and rms(dataset.mean - fit.markers) > enough:
            better = self._with_one_more(fitter, fit, names, effects)
            if better is None:
                break
            fit, names = better
        return Explained(rms(dataset.mean - fit.markers), _score(fit), names, fit.point)

    def _with_one_more(
        self, fitter: Fitter, fit: Fit, names: tuple[str, ...], effects: Sequence[Candidate]
    ) -> tuple[Fit, tuple[str, ...]] | None:
        """Return the best fit with one more effect; None where none does better."""
        promised = list[tuple[float, int, Candidate]]()  # by first steps
        for candidate in effects:
            with suppress(*FAILURES):
                if not set(candidate.names) & set(names):
                    left = fitter.promised((*fit.frees, *candidate.frees), fit.point)
                    promised.append((left, len(promised), candidate))
        fits = list[tuple[float, int, Fit, tuple[str, ...]]]()
        for *_, candidate in sorted(promised)[:BEST_FEW]:
            frees = (*fit.frees, *candidate.frees)
            try:
                made = fitter.fit(frees, fit.point if names else None, STEPS_FEW)
            except FAILURES:
                continue
            known = fitter.predictor
            odd = [is_odd(f.effect, f.key, made.point[f], known.value(f)) for f in made.frees]
            if not any(odd):  # what nothing is off by explains nothing
                fits.append((_score(made), len(fits), made, candidate.names))
        if not fits:
            return None
        score, _, made, more = min(fits)
        return (made, names + more) if score < _score(fit) else None


def _score(fit: Fit) -> float:
    return fit.chi2 + 2.0 * fit.rank


@dataclass(frozen=True)
class Mended:
    """A mistake, and what explains the data set without it."""

    mistake: Mistake
    explained: Explained

    def with_rest(self, left: float, names: Sequence[str]) -> Mistake:
        """Return the mistake with what becomes of the error [m] that it leaves."""
        helps = names and left < self.mistake.after / SAME_ERROR_RATIO
        rest = f', and with {listed(names)} to {mm(left)}' if helps else ''
        return replace(self.mistake, rest=rest)

    def agrees(self, diagnosis: Diagnosis) -> bool:
        """Tell whether the values of effects are those of a diagnosis, or it names none."""
        known = {effect.name: effect.parameters for effect in diagnosis.effects}
        return all(
            (there := known[free.effect].get(free.key)) is None or there.low <= value <= there.high
            for free, value in self.explained.point.items()
            if free.effect in known
        )

    def possible(self, quiet: bool) -> str:
        """Say it beside effects that may be as well; `quiet` where they leave as little."""
        effects, left = listed(self.explained.names) or 'no effect', mm(self.explained.left)
        said = f'{self.mistake.sentence} and {effects} the error would fall to {left}'
        if quiet:
            return f'{said} as well: check which is right, values of {effects} depend on it'
        return f'{said}: {self.mistake.mend}'


def _rivals(
    predictor: Predictor,
    explaining: Explaining,
    described: Explained,
    floor: float,
    progress: Callable[[str, int, int], None],
) -> list[Mended]:
    """
    Return the mistakes that explain more than the best effects do, the best first.

    Of those that do about as well the plainest is the first. Where effects leave a quiet rest only
    those mistakes are tried that an effect can nearly make up for.

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
    if not described.quiet:
        kinds['alone'] = alone(predictor, markers, floor)
    for kind in NEARLY_EFFECTS if described.quiet else BESIDE_EFFECTS:
        for one in kind(predictor, markers):
            kinds.setdefault(f'{kind.__name__} {one.name}', []).append(one)
    tried = [
        one for own in kinds.values() for one in sorted(own, key=lambda one: one.after)[:BEST_FEW]
    ]
    rivals = []
    for k, one in enumerate(tried):
        progress('mistakes of the set-up', k + 1, len(tried))
        if one.mended is None:
            continue
        one = explaining.with_effect(one)
        assert one.mended is not None
        explained = explaining.explain(one.mended, 1, floor)
        if explained is None:
            continue
        if described.quiet:  # errors as large as usual tell nothing there
            better = explained.left < SAME_ERROR_RATIO * described.left
        else:
            handicap = 2.0 * one.fitted + MISTAKE_HANDICAP
            better = explained.score + handicap < described.score
        if better and explained.left < one.most:
            rivals.append(Mended(one, explained))
    if not rivals:
        return []
    least = SAME_ERROR_RATIO * (min(one.explained.left for one in rivals) + floor)
    near = [one for one in rivals if one.explained.left <= least]  # the plainest is the first
    first = min(
        (one for one in near if one.mistake.name == near[0].mistake.name),
        key=lambda one: one.explained.left,
    )
    others = [one for one in rivals if one is not first]
    others.sort(key=lambda one: one.explained.left)
    alike = [one.mistake for one in others if one in near]  # those of its kind say most
    alike.sort(key=lambda one: one.name != first.mistake.name)
    if alike:
        said = dict.fromkeys(one.sentence for one in (first.mistake, *alike))
        sentence = ', or '.join([*said][:BEST_FEW])
        first = Mended(replace(first.mistake, sentence=sentence), first.explained)
    return [first, *others]


def mended_rivals(session: Session, enough: float) -> tuple[Explained | None, list[Mended]]:
    """
    Return what effects explain of the data set as it is, and the mistakes that explain more.

    Where one effect with a value that may be leaves little more than noise, and than an arm built
    as usual is off, only those are looked for that an effect can nearly make up for.
    """
    predictor, floor = session.predictor, session.whitener.floor()
    markers = predictor.markers({})
    if markers is None:
        return None, []
    if off(predictor, session.dataset.mean, markers) < ODD_FROM_FLOORS * floor:
        return None, []
    enough = min(enough, QUIET_FLOORS * floor)
    explaining = Explaining(session.catalogue, session.usual_floor)
    dataset = replace(session.dataset, robot=session.robot)
    described = explaining.explain(dataset, 1, enough)
    if described is None:
        return None, []
    if described.left <= enough:
        described = replace(described, quiet=True)
    else:
        described = explaining.explain(dataset, EFFECTS_MAX, floor)
        assert described is not None
    return described, _rivals(predictor, explaining, described, floor, session.progress)


def implausible(diagnosis: Diagnosis) -> list[str]:
    """Say which estimated values are no tolerance; nothing where all may be one."""
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
