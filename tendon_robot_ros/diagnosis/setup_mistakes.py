"""
Mistakes of the set-up that look like physics: swapped columns, turned axes, wrong units.

They are tried before any effect is, and only where the error is gross. Each is one sentence with
the error before and after, and what mends it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..common.words import listed, mm
from ..comparison.predict import Predictor
from .decide import (
    AS_GOOD_WITHIN,
    CUT_AS_GOOD_WITHIN,
    ERROR_SHARE_LEFT_LIMIT,
    ERROR_SHARE_LEFT_MAX,
    EXPLAINED_WITHIN_FLOORS,
    GROSS_FROM_FLOORS,
    ODD_FROM_FLOORS,
    STILL_FROM_FLOORS,
    STILL_SHARE_MAX,
)
from .marker_hypotheses import exchanged, miscounted
from .marker_places import in_one_place, uncut
from .mistake import Mistake, off, tried
from .setup_hypotheses import DISCRETE, HYPOTHESES, OF_INPUTS

Floats = npt.NDArray[np.float64]


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
    if markers is None:
        return _shapeless(predictor, floor)
    few = alone(predictor, markers, floor)
    if few and few[0].certain:
        return few[0]
    before = off(predictor, predictor.dataset.mean, markers)
    if before < ODD_FROM_FLOORS * floor:
        return None
    tries = HYPOTHESES if before > GROSS_FROM_FLOORS * floor else DISCRETE
    enough = max(ERROR_SHARE_LEFT_MAX * before, EXPLAINED_WITHIN_FLOORS * floor, 2.0 * usual)
    mistakes = few + [one for kind in tries for one in kind(predictor, markers)]
    certain = next((one for one in mistakes if one.certain), None)
    if certain is not None:
        return certain
    enough = min(enough, ERROR_SHARE_LEFT_LIMIT * before)
    likely = [one for one in mistakes if one.after < min(enough, one.most)]
    return _plainest(likely, max(floor, 0.3 * usual))


def alone(predictor: Predictor, markers: Floats, floor: float) -> list[Mistake]:
    """Return the mistakes that the measurements show by themselves, whatever the model lacks."""
    found = [_cut(predictor, markers, floor), *exchanged(predictor, markers)]
    found.append(_frozen(predictor, markers, floor))
    return [one for one in found if one is not None]


def _shapeless(predictor: Predictor, floor: float) -> Mistake | None:
    """Find the mistake without which the model has an equilibrium at all."""
    measured = predictor.dataset.mean
    nothing = np.full_like(measured, np.nan)
    mistakes = [one for kind in OF_INPUTS for one in kind(predictor, nothing)]
    return _plainest([one for one in mistakes if one.after < one.most], floor)


def _plainest(likely: Sequence[Mistake], floor: float) -> Mistake | None:
    """Return the first kind of those that do about as well as the best; of a kind the best."""
    if not likely:
        return None
    least = min(one.after for one in likely) + floor
    plain = next(one for one in likely if one.after <= AS_GOOD_WITHIN * least)
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
        if one.after <= CUT_AS_GOOD_WITHIN * least:
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
        (spread < STILL_SHARE_MAX * should) & (should > STILL_FROM_FLOORS * floor)
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
