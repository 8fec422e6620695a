"""
Mistakes of the set-up that look like physics: swapped columns, turned axes, wrong units.

They are tried before any effect is, and only where the error is gross. Each is one sentence with
the error before and after, and what mends it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
import numpy.typing as npt

from ..common.rotations import rigid_fit, turn_angle
from ..comparison.noise import rms
from ..comparison.predict import Predictor
from .decide import (
    AS_GOOD_WITHIN,
    ERROR_SHARE_LEFT_LIMIT,
    ERROR_SHARE_LEFT_MAX,
    EXPLAINED_WITHIN_FLOORS,
    GROSS_FROM_FLOORS,
    STILL_FROM_FLOORS,
    STILL_SHARE_MAX,
)

Floats = npt.NDArray[np.float64]
INPUTS_REORDERED_MAX = 6  # inputs whose order is searched
UNIT_FACTORS = {
    1000.0: 'milli', 0.001: 'kilo', 9.81: 'kilograms of force', 1.0 / 9.81: 'newtons twice',
    4.448: 'pounds', 1.0 / 4.448: 'newtons as pounds', 10.0: 'a decimal point',
    0.1: 'a decimal point', 2.0: 'a double count', 0.5: 'half a count',
}  # fmt: skip


@dataclass(frozen=True)
class Mistake:
    """A mistake that would explain the error."""

    name: str
    sentence: str  # 'with ... the error falls'
    mend: str
    after: float  # [m] rms

    def text(self, before: float) -> str:
        """Say it with the error before and after."""
        return (
            f'{self.sentence} the error falls from {1e3 * before:.3g} to '
            f'{1e3 * self.after:.2g} mm: {self.mend}'
        )


def find_mistake(predictor: Predictor, floor: float) -> Mistake | None:
    """
    Return the mistake of the set-up that explains a gross error; None where none does.

    Parameters
    ----------
    predictor : Predictor
        Of the description as it stands.
    floor : float
        Rms [m] that the noise alone makes.

    """
    frozen = _frozen(predictor, floor)
    if frozen is not None:
        return frozen
    markers = predictor.markers({})
    measured = predictor.dataset.mean
    if markers is None:
        return None
    before = rms(measured - markers)
    if before < GROSS_FROM_FLOORS * floor:
        return None
    enough = max(ERROR_SHARE_LEFT_MAX * before, EXPLAINED_WITHIN_FLOORS * floor)
    mistakes = [one for tried in _HYPOTHESES for one in tried(predictor, markers)]
    likely = [one for one in mistakes if one.after < min(enough, ERROR_SHARE_LEFT_LIMIT * before)]
    if not likely:
        return None
    least = min(one.after for one in likely) + floor  # alike: the first, the plainest, is it
    return next(one for one in likely if one.after <= AS_GOOD_WITHIN * least)


def _frozen(predictor: Predictor, floor: float) -> Mistake | None:
    """Find a marker that stands still while the others move."""
    dataset = predictor.dataset
    spread = np.sqrt(np.nanvar(dataset.mean, axis=0).sum(axis=1))
    predicted = predictor.markers({})
    if predicted is None or len(spread) < 3:
        return None
    should = np.sqrt(np.var(predicted, axis=0).sum(axis=1))
    still = np.flatnonzero(
        (spread < STILL_SHARE_MAX * should) & (should > STILL_FROM_FLOORS * floor)
    )
    if len(still) != 1:
        return None
    name = dataset.markers[int(still[0])].name
    keep = np.arange(len(spread)) != still[0]
    after = rms((dataset.mean - predicted)[:, keep])
    sentence = f'marker {name} stands still while the arm moves; without it'
    return Mistake('frozen_marker', sentence, f'take the rows of marker {name} out', after)


def _swapped(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try all orders of the inputs."""
    names, inputs = predictor.robot.inputs, predictor.inputs
    if len(names) > INPUTS_REORDERED_MAX:
        return
    for order in permutations(range(len(names))):
        if list(order) == sorted(order):
            continue
        moved = predictor.markers({}, inputs[:, order])
        if moved is None:
            continue
        off = [i for i in range(len(order)) if order[i] != i]
        are = ' and '.join(names[i] for i in off)
        header = ','.join(names[order.index(i)] for i in range(len(order)))
        yield Mistake(
            'inputs_swapped',
            f'with inputs {are} {"swapped" if len(off) == 2 else "in another order"}',
            f'name the columns of inputs.csv {header}',
            rms(predictor.dataset.mean - moved),
        )


def _axes(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try all ways in which axes may be flipped and swapped."""
    measured = predictor.dataset.mean
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            if list(order) == [0, 1, 2] and min(signs) > 0.0:
                continue
            turned = measured[..., order] * np.array(signs)
            columns = ', '.join(
                f'{"" if sign > 0 else "-"}{"xyz"[i]}'
                for i, sign in zip(order, signs, strict=True)
            )
            yield Mistake(
                'axes',
                f'with the axes of the tracker taken as ({columns})',
                f'write {columns} into the columns x, y, z of shapes.csv',
                rms(turned - markers),
            )


def _registered(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try a free rigid registration, any angle (Kabsch)."""
    measured = predictor.dataset.mean
    seen = np.isfinite(measured).all(axis=2)
    turn, shift = rigid_fit(measured[seen], markers[seen])
    angle = math.degrees(turn_angle(turn))
    millimetres = ', '.join(f'{1e3 * x:.1f}' for x in shift)
    yield Mistake(
        'registration',
        f'with the frame of the tracker turned by {angle:.1f}° and shifted by {millimetres} mm',
        'register the tracker to the base of the arm again',
        rms(measured @ turn.T + shift - markers),
    )


def _numbered(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try markers that are numbered from the tip."""
    yield Mistake(
        'markers_from_the_tip',
        'with the markers numbered from the tip to the base',
        'turn the order of the markers in shapes.csv around',
        rms(predictor.dataset.mean[:, ::-1] - markers),
    )


def _units(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try units of the inputs and of the positions."""
    for factor in UNIT_FACTORS:
        moved = predictor.markers({}, predictor.inputs * factor)
        how = f'multiplied by {factor:.4g}' if factor >= 1.0 else f'divided by {1.0 / factor:.4g}'
        unit = '[N]' if predictor.dataset.input == 'tension' else '[m]'
        if moved is not None:
            yield Mistake(
                'unit_of_inputs',
                f'with all inputs {how}',
                f'check their unit in inputs.csv {unit}',
                rms(predictor.dataset.mean - moved),
            )
        yield Mistake(
            'unit_of_positions',
            f'with all positions {how}',
            'check their unit in shapes.csv [m]',
            rms(predictor.dataset.mean * factor - markers),
        )


def _gravity(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try gravity along every axis, where the weight of the arm is described."""
    size = float(np.linalg.norm(predictor.parts[0].gravity))
    if size == 0.0 or not predictor.model.acts('gravity'):
        return
    for axis, sign in product(range(3), (1.0, -1.0)):
        with predictor.under_gravity(sign * size * np.eye(3)[axis]):
            moved = predictor.markers({})
        if moved is not None:
            vector = ', '.join(f'{x:g}' for x in sign * size * np.eye(3)[axis])
            yield Mistake(
                'gravity',
                f'with gravity [{vector}]',
                f'write gravity: [{vector}] into dataset.yaml',
                rms(predictor.dataset.mean - moved),
            )


def _cells(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try another number of cells in the last section, of the same length each."""
    robot, dataset = predictor.robot, predictor.dataset
    last = robot.sections[-1]
    for more in (-3, -2, -1, 1, 2, 3):
        count = last.cells + more
        if count < 1:
            continue
        section = replace(
            last,
            cells=count,
            bending_stiffness=(last.bending_stiffness + (last.bending_stiffness[-1],) * 3)[:count],
            mass_profile=(last.mass_profile + (last.mass_profile[-1],) * 3)[:count],
        )
        longer = replace(robot, sections=(*robot.sections[:-1], section), fitted={})
        share = longer.length / robot.length
        spots = tuple(
            replace(m, arc_length=m.arc_length * share) if m.arc_length > longer.length else m
            for m in dataset.markers
        )
        other = replace(dataset, robot=longer, markers=spots)
        moved = Predictor(other, longer, predictor.model.catalogue).markers({})
        if moved is not None:
            total = sum(s.cells for s in robot.sections) + more
            yield Mistake(
                'cells',
                f'with {total} cells instead of {total - more}',
                f'count the cells of section {last.name}: {count}?',
                rms(dataset.mean - moved),
            )


# The plainest first: what a free registration can do, some of the others can do as well.
_HYPOTHESES = (_swapped, _numbered, _units, _gravity, _cells, _axes, _registered)
