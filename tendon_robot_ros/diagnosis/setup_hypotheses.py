"""Mistakes that would explain a gross error, each tried on the data, the plainest first."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.rotations import rigid_fit, turn_angle, upright_fit
from ..comparison.noise import rms
from ..comparison.predict import Predictor
from ..data import DataSet
from ..robot import Robot
from .decide import (
    FRAME_HARDLY_KNOWN_RAD,
    FRAME_LEVEL_RAD,
    FRAME_OFF_SHARE_MIN,
    FRAME_TURNED_MIN_DEG,
)
from .marker_places import along

Floats = npt.NDArray[np.float64]
INPUTS_PERMUTED_MAX = 4  # all orders of so many are tried; of more, one exchange after another
UNIT_FACTORS = {
    1000.0: 'milli', 0.001: 'kilo', 9.81: 'kilograms of force', 1.0 / 9.81: 'newtons twice',
    4.448: 'pounds', 1.0 / 4.448: 'newtons as pounds', 10.0: 'a decimal point',
    0.1: 'a decimal point', 2.0: 'a double count', 0.5: 'half a count',
    25.4: 'inches', 1.0 / 25.4: 'millimetres as inches',
}  # fmt: skip
STIFFNESS_FACTORS = {
    10.0: 'a decimal point', 0.1: 'a decimal point', 100.0: 'N/cm² for N/mm²',
    0.01: 'N/mm² for N/cm²', 1000.0: 'MPa for GPa', 0.001: 'GPa for MPa',
    16.0: 'the radius of the rod for its diameter', 0.0625: 'its diameter for the radius',
}  # fmt: skip
CELLS_MISCOUNTED_MAX = 3


@dataclass(frozen=True)
class Mistake:
    """A mistake that would explain the error."""

    name: str
    sentence: str  # 'with ... the error falls'
    mend: str
    after: float  # [m] rms
    mended: DataSet | None = field(default=None, repr=False)  # without it, where that can be made
    doubtful: bool = False  # whether an effect may do much the same
    rest: str = ''  # what becomes of the error that it leaves
    certain: bool = False  # whether measurements alone show it, whatever the model lacks

    def text(self, before: float) -> str:
        """Say it with the error before and after."""
        if not math.isfinite(before):
            return (
                f'the model finds no equilibrium; {self.sentence} it does, and is off by '
                f'{1e3 * self.after:.2g} mm{self.rest}: {self.mend}'
            )
        return (
            f'{self.sentence} the error falls from {1e3 * before:.3g} to '
            f'{1e3 * self.after:.2g} mm{self.rest}: {self.mend}'
        )


def off(predictor: Predictor, measured: Floats, markers: Floats) -> float:
    """
    Return the rms [m] between measured and predicted postures (P, J, 3).

    Up to the tracker's frame where that was found with the model itself: a mistake turned it, too.
    """
    return rms(_moved(measured, _frame(predictor, measured, markers)) - markers)


Frame = tuple[Floats, Floats] | None  # rotation (3, 3) and shift (3,) [m]


def _frame(predictor: Predictor, measured: Floats, markers: Floats) -> Frame:
    """Return how the tracker's frame would lie; None where it is known as it is."""
    known, seen = predictor.robot.tolerances.get('rotation', 0.0), np.isfinite(measured)
    if known < FRAME_HARDLY_KNOWN_RAD or not np.isfinite(markers).all():
        return None
    points, onto = measured[seen.all(axis=2)], markers[seen.all(axis=2)]
    gravity = predictor.parts[0].gravity
    size = float(np.linalg.norm(gravity))
    if known < FRAME_LEVEL_RAD and size > 0.0:
        return upright_fit(points, onto, gravity / size)
    return rigid_fit(points, onto)


def _moved(positions: Floats, frame: Frame) -> Floats:
    return positions if frame is None else positions @ frame[0].T + frame[1]


def _mended(predictor: Predictor, predicted: Floats, **changes: Any) -> DataSet:
    """Return the data set with changes, in the frame that suits what is predicted best."""
    made = replace(predictor.dataset, robot=predictor.robot)
    frame = _frame(predictor, made.mean, predicted)
    return replace(made, positions=_moved(made.positions, frame), **changes)


def _swapped(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try other orders of the inputs."""
    m = len(predictor.robot.inputs)
    if m <= INPUTS_PERMUTED_MAX:
        orders = [order for order in permutations(range(m)) if list(order) != sorted(order)]
    else:
        orders = list(_exchanges(predictor))
    for order in orders:
        after = _in_order(predictor, order)
        if np.isfinite(after):
            yield _swap(predictor.robot.inputs, order, after)


def _exchanges(predictor: Predictor) -> Iterator[tuple[int, ...]]:
    """Exchange two inputs after the other while that helps."""
    order = tuple(range(len(predictor.robot.inputs)))
    least = _in_order(predictor, order)
    for _ in range(len(order)):
        tried = []
        for i, j in combinations(range(len(order)), 2):
            other = list(order)
            other[i], other[j] = other[j], other[i]
            tried.append((_in_order(predictor, other), tuple(other)))
        best, order = min(tried)
        if not best < least:
            return
        least = best
        yield order


def _in_order(predictor: Predictor, order: Sequence[int]) -> float:
    """Return the error [m] with inputs in another order."""
    moved = predictor.markers({}, predictor.inputs[:, list(order)])
    return np.inf if moved is None else off(predictor, predictor.dataset.mean, moved)


def _swap(names: Sequence[str], order: Sequence[int], after: float) -> Mistake:
    off = [i for i in range(len(order)) if order[i] != i]
    are = ' and '.join(names[i] for i in off)
    header = ','.join(names[list(order).index(i)] for i in range(len(order)))
    return Mistake(
        'inputs_swapped',
        f'with inputs {are} {"swapped" if len(off) == 2 else "in another order"}',
        f'name the columns of inputs.csv {header}',
        after,
    )


def _loose(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try inputs that do not reach the arm."""
    for j, name in enumerate(predictor.robot.inputs):
        inputs = predictor.inputs.copy()
        inputs[:, j] = 0.0 if predictor.dataset.input == 'tension' else np.nan
        moved = predictor.markers({}, inputs)
        if moved is not None:
            yield Mistake(
                'input_loose',
                f'if input {name} never reached the arm',
                f'look whether {name} is connected, and its wire taut',
                off(predictor, predictor.dataset.mean, moved),
            )


def _rows(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try inputs and shapes that belong to different postures: rows moved by one, or reversed."""
    measured = predictor.dataset.mean
    one = 'row of inputs.csv does not belong to its posture in shapes.csv'
    for shift in (1, -1):
        kept = slice(max(shift, 0), len(measured) + min(shift, 0))
        yield Mistake(
            'rows_moved',
            f'with the postures moved by one row {"down" if shift > 0 else "up"}',
            f'a {one}: one was left out, or is double',
            off(predictor, np.roll(measured, shift, axis=0)[kept], markers[kept]),
        )
    yield Mistake(
        'rows_moved',
        'with the postures in reverse order',
        f'a {one}',
        off(predictor, measured[::-1], markers),
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
                off(predictor, turned, markers),
            )


def _registered(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try a free rigid registration (Kabsch); a small one is an effect's: a load does the same."""
    measured = predictor.dataset.mean
    seen = np.isfinite(measured).all(axis=2)
    turn, shift = rigid_fit(measured[seen], markers[seen])
    angle = math.degrees(turn_angle(turn))
    far = np.linalg.norm(shift) > FRAME_OFF_SHARE_MIN * predictor.robot.length
    if angle < FRAME_TURNED_MIN_DEG and not far:
        return
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
        off(predictor, predictor.dataset.mean[:, ::-1], markers),
    )


def _units(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try units of the inputs and of the positions."""
    tension = predictor.dataset.input == 'tension'
    described = 'bending_stiffness [N·m/rad] and offsets [m]' if tension else 'offsets [m]'
    for factor in UNIT_FACTORS:
        moved = predictor.markers({}, predictor.inputs * factor)
        how = f'multiplied by {factor:.4g}' if factor >= 1.0 else f'divided by {1.0 / factor:.4g}'
        if moved is not None:
            yield Mistake(
                'unit_of_inputs',
                f'with all inputs {how}',
                f'check their unit in inputs.csv {"[N]" if tension else "[m]"}; if that is right, '
                f'{described} of the description',
                off(predictor, predictor.dataset.mean, moved),
                _mended(predictor, moved, **_scaled_inputs(predictor.dataset, factor)),
            )
        if np.isfinite(markers).all():
            yield Mistake(
                'unit_of_positions',
                f'with all positions {how}',
                'check their unit in shapes.csv [m]',
                off(predictor, predictor.dataset.mean * factor, markers),
            )


def _scaled_inputs(dataset: DataSet, factor: float) -> dict[str, Any]:
    each = dataset.trial_inputs
    return {
        'inputs': dataset.inputs * factor,
        'trial_inputs': None if each is None else each * factor,
    }


def _stiffness(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try a bending stiffness far beyond what any rod is off: a wrong unit, or diameter."""
    for factor, why in STIFFNESS_FACTORS.items():
        stiffer = np.full(predictor.model.arrays.chain.n, factor)
        moved = predictor.markers({}, stiffness=stiffer)
        if moved is None:
            continue
        how = f'multiplied by {factor:g}' if factor > 1.0 else f'divided by {1.0 / factor:g}'
        yield Mistake(
            'stiffness',
            f'with the bending stiffness {how}',
            f'check how it was worked out ({why}?): modulus, diameter, length of a cell',
            off(predictor, predictor.dataset.mean, moved),
            _mended(predictor, moved, robot=_stiffer(predictor.robot, factor)),
        )


def _stiffer(robot: Robot, factor: float) -> Robot:
    sections = tuple(
        section
        if section.is_plate
        else replace(
            section, bending_stiffness=tuple(factor * k for k in section.bending_stiffness)
        )
        for section in robot.sections
    )
    return replace(robot, sections=sections)


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
                off(predictor, predictor.dataset.mean, moved),
            )


def miscounted(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try another number of cells in a section, of the same length each."""
    robot, dataset = predictor.robot, predictor.dataset
    reach = range(-CELLS_MISCOUNTED_MAX, CELLS_MISCOUNTED_MAX + 1)
    for s, more in product(range(len(robot.sections)), reach):
        section = robot.sections[s]
        count = section.cells + more
        if count < 1 or more == 0 or section.is_plate:
            continue
        place = f'section {section.name}' if len(robot.own_sections) > 1 else 'the arm'
        again = (section.bending_stiffness[-1],) * CELLS_MISCOUNTED_MAX
        masses = (section.mass_profile[-1],) * CELLS_MISCOUNTED_MAX
        other = replace(
            section,
            cells=count,
            bending_stiffness=(section.bending_stiffness + again)[:count],
            mass_profile=(section.mass_profile + masses)[:count],
        )
        sections = (*robot.sections[:s], other, *robot.sections[s + 1 :])
        longer = replace(robot, sections=sections, fitted={})
        for where, places in along(dataset, robot, longer):
            spots = tuple(
                replace(m, arc_length=s) for m, s in zip(dataset.markers, places, strict=True)
            )
            mended = replace(dataset, robot=longer, markers=spots)
            moved = Predictor(mended, longer, predictor.model.catalogue).markers({})
            if moved is not None:
                yield Mistake(
                    'cells',
                    f'with {count} cells instead of {section.cells} in {place} (markers {where})',
                    f'count the cells of {place}',
                    off(predictor, dataset.mean, moved),
                    _mended(predictor, moved, robot=longer, markers=spots),
                    True,
                )


def _spots(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try markers that sit elsewhere along the arm: nearer to the base, or the tip."""
    dataset, length = predictor.dataset, predictor.robot.length
    cell = predictor.robot.own_sections[0].cell_length
    moves = [
        *((f'{abs(c):g} cell nearer to the {"base" if c < 0 else "tip"}', 1.0, c * cell)
          for c in (-1.0, -0.5, 0.5, 1.0)),
        *((f'at {100 * s:.0f} % of their arc lengths', s, 0.0) for s in (0.8, 0.9, 1.1, 1.25)),
    ]  # fmt: skip
    for how, share, shift in moves:
        spots = [share * m.arc_length + shift for m in dataset.markers]
        if min(spots) < -1e-9 * length or max(spots) > (1.0 + 1e-9) * length:
            continue
        moved_to = tuple(
            replace(m, arc_length=s)
            for m, s in zip(dataset.markers, np.clip(spots, 0.0, length).tolist(), strict=True)
        )
        mended = replace(dataset, robot=predictor.robot, markers=moved_to)
        moved = Predictor(mended, predictor.robot, predictor.model.catalogue).markers({})
        if moved is not None:
            yield Mistake(
                'markers_elsewhere',
                f'with all markers {how}',
                'check arc_length of the markers in dataset.yaml, from the base along the arm, '
                'and the number of cells',
                off(predictor, dataset.mean, moved),
                _mended(predictor, moved, markers=moved_to),
                True,
            )


OF_INPUTS = (_swapped, _units, _stiffness)  # that can be why there is no equilibrium
# The plainest first: what a free registration can do, some of the others can do as well. It can
# also do what a tilted base does, which is an effect: only a gross error is laid to it.
DISCRETE = (
    _swapped,
    _loose,
    _numbered,
    _rows,
    _units,
    _stiffness,
    _gravity,
    _spots,
    miscounted,
    _axes,
)
HYPOTHESES = (*DISCRETE, _registered)
