"""Mistakes of inputs, axes, units, gravity and stiffness, each evaluated on the data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.rotations import rigid_fit, rotation_angle, rotation_between
from ..common.words import STANDARD_GRAVITY, digits, mm
from ..data import DataSet
from ..inference.description import DIGITS_OF_THE_ARM, scaled
from ..inference.marginal import NEGLIGIBLE
from ..inference.predict import Point, Predictor
from ..inference.statistics import mean_over, rms
from .verdict import RESIDUAL_RATIO_MAX

EARTH = round(STANDARD_GRAVITY, 2)  # [m/s²] as descriptions have it, because `robot new` rounds so
UNIT_FACTORS = {
    1000.0: 'milli', 0.001: 'kilo', EARTH: 'kilograms of force', 1.0 / EARTH: 'newtons twice',
    4.448: 'pounds', 1.0 / 4.448: 'newtons as pounds', 10.0: 'a decimal point',
    0.1: 'a decimal point', 2.0: 'a double count', 0.5: 'half a count',
    25.4: 'inches', 1.0 / 25.4: 'millimetres as inches',
}  # fmt: skip
FRAME_TURNED_MIN_DEG = 10.0  # [deg] because a load bends an arm like a smaller rotation
FRAME_SHIFTED_MIN = 0.1  # [1] of the arm's length, because a load shifts its markers by less
FRAME_HARDLY_KNOWN_RAD = 0.017  # [rad] 1°, which an import declares: docs/inference.md
FRAME_LEVEL_RAD = 0.05  # [rad] above it the vertical was not known either, else it would turn
UNIT_RATIO_MAX = 1.1  # [1] to the factor of a unit, because distances tell it to a tenth
INPUTS_PERMUTED_MAX = 4  # [1] whose 24 orders are all tried; five would have 120
STIFFNESS_FACTORS = {
    10.0: 'a decimal point', 0.1: 'a decimal point', 100.0: 'N/cm² for N/mm²',
    0.01: 'N/mm² for N/cm²', 1000.0: 'MPa for GPa', 0.001: 'GPa for MPa',
    16.0: 'the radius of the rod for its diameter', 0.0625: 'its diameter for the radius',
}  # fmt: skip
# [1] of the largest input, in steps of 5 %: a parabola tells the least between, so that few do
DEAD_SIZES = np.linspace(0.0, 1.25, 26)


@dataclass(frozen=True)
class Mistake:
    """A mistake that may explain the error."""

    name: str
    sentence: str  # 'with ... the error falls'
    mend: str
    after: float  # [m] rms
    mended: DataSet | None = field(default=None, repr=False)  # corrected data set, where it exists
    doubtful: bool = False  # whether an effect may explain about as much
    free_input: int | None = None  # the input of which a value was fitted in every posture
    rest: str = ''  # note on its residual with effects
    certain: bool = False  # whether measurements alone show it

    @property
    def residual_max(self) -> float:
        """Return the largest residual [m]: a fraction of the error of a motionless arm."""
        if self.mended is None:
            return math.inf
        places = self.mended.mean
        return RESIDUAL_RATIO_MAX * rms(places - mean_over(places, 0))

    def text(self, before: float) -> str:
        """Return the report with the rms error [m] before and after."""
        end = f'{mm(self.after)}{self.rest}: {self.mend}'
        if not math.isfinite(before):
            return f'the model finds no equilibrium; {self.sentence} it does, and is off by {end}'
        verb = 'falls' if self.after < before else 'goes'  # up, with an effect that acts as well
        return f'{self.sentence} the error {verb} from {digits(1e3 * before, 3)} to {end}'


def off(predictor: Predictor, measured: Floats, markers: Floats) -> float:
    """
    Return the rms [m] between measured and predicted postures (P, J, 3).

    Without the motion of the tracker's frame where that was registered with the model itself.
    """
    frame = _frame(predictor, measured, markers, predictor.parts[0].gravity)
    return rms(_moved(measured, frame) - markers)


Frame = tuple[Floats, Floats] | None  # rotation (3, 3) and shift (3,) [m]


def _frame(predictor: Predictor, measured: Floats, markers: Floats, down: Floats) -> Frame:
    """Return the best frame of the tracker, gravity `down` [m/s²]; None where it is known."""
    known, visible = predictor.robot.tolerances.get('rotation', 0.0), np.isfinite(measured)
    if known < FRAME_HARDLY_KNOWN_RAD or not np.isfinite(markers).all():
        return None
    points, onto = measured[visible.all(axis=2)], markers[visible.all(axis=2)]
    size = float(np.linalg.norm(down))
    if known < FRAME_LEVEL_RAD and size > 0.0:
        return rigid_fit(points, onto, axis=down / size)
    return rigid_fit(points, onto)


def _moved(positions: Floats, frame: Frame) -> Floats:
    return positions if frame is None else positions @ frame[0].T + frame[1]


def in_frame(predictor: Predictor, dataset: DataSet, predicted: Floats) -> DataSet:
    """Return a data set in the frame of the tracker that fits the predicted markers best."""
    down = np.array(dataset.gravity_for(dataset.robot) or (0.0, 0.0, 0.0))
    frame = _frame(predictor, dataset.mean, predicted, down)
    if frame is None:
        return dataset
    return replace(dataset, positions=_moved(dataset.positions, frame))


def evaluated(
    predictor: Predictor,
    predicted: Floats | None,
    name: str,
    sentence: str,
    mend: str,
    doubtful: bool = False,
    certain: bool = False,
    dataset: DataSet | None = None,
    **changes: Any,
) -> Iterator[Mistake]:
    """
    Yield a mistake with its corrected data set and rms; nothing without equilibrium.

    The corrected one is the `dataset`, else that of the predictor with its robot and `changes`.
    """
    if predicted is None or not np.isfinite(predicted).all():
        return
    described = {'robot': predictor.robot, **changes}
    mended = in_frame(predictor, dataset or replace(predictor.dataset, **described), predicted)
    after = rms(mended.mean - predicted)
    yield Mistake(name, sentence, mend, after, mended, doubtful, certain=certain)


def otherwise_described(
    predictor: Predictor, mended: DataSet, name: str, sentence: str, mend: str, doubtful: bool
) -> Iterator[Mistake]:
    """Try a data set with another description of the arm, or of its markers."""
    expected = Predictor(mended, mended.robot, predictor.model.catalogue).markers({})
    yield from evaluated(predictor, expected, name, sentence, mend, doubtful, dataset=mended)


def times(factor: float) -> str:
    """Return 'multiplied by ...' or 'divided by ...'."""
    return f'multiplied by {factor:.4g}' if factor >= 1.0 else f'divided by {1.0 / factor:.4g}'


def as_unit(factor: float) -> float:
    """Return the factor of a unit near the given one, else the given one."""
    near = min(UNIT_FACTORS, key=lambda one: abs(math.log(factor / one)))
    return near if abs(math.log(factor / near)) < math.log(UNIT_RATIO_MAX) else factor


def swapped_inputs(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try other orders of the inputs."""
    m = len(predictor.robot.inputs)
    if m <= INPUTS_PERMUTED_MAX:
        orders = [order for order in permutations(range(m)) if list(order) != sorted(order)]
    else:
        orders = list(_exchanges(predictor))
    names, dataset = predictor.robot.inputs, predictor.dataset
    for order in orders:
        moved = [i for i in range(m) if order[i] != i]
        are = ' and '.join(names[i] for i in moved)
        header = ','.join(names[list(order).index(i)] for i in range(m))
        yield from evaluated(
            predictor,
            predictor.markers({}, predictor.inputs[:, list(order)]),
            'inputs_swapped',
            f'with inputs {are} {"swapped" if len(moved) == 2 else "in another order"}',
            f'name the columns of inputs.csv {header}',
            **_with_inputs(dataset, partial(np.take, indices=order, axis=-1)),
        )


def _with_inputs(dataset: DataSet, change: Callable[[Floats], Floats]) -> dict[str, Any]:
    """Return the inputs of a data set (P, m), and those of its trials (P, Q, m), changed."""
    each = dataset.trial_inputs
    return {
        'inputs': change(dataset.inputs),
        'trial_inputs': None if each is None else change(each),
    }


def _exchanges(predictor: Predictor) -> Iterator[tuple[int, ...]]:
    """Yield orders by exchanging two inputs at a time while the error falls."""
    order = tuple(range(len(predictor.robot.inputs)))
    lowest = _in_order(predictor, order)
    for _ in range(len(order)):
        exchanges = []
        for i, j in combinations(range(len(order)), 2):
            other = list(order)
            other[i], other[j] = other[j], other[i]
            exchanges.append((_in_order(predictor, other), tuple(other)))
        best, order = min(exchanges)
        if not best < lowest:
            return
        lowest = best
        yield order


def _in_order(predictor: Predictor, order: Sequence[int]) -> float:
    """Return the error [m] with inputs in another order."""
    moved = predictor.markers({}, predictor.inputs[:, list(order)])
    return np.inf if moved is None else off(predictor, predictor.dataset.mean, moved)


def loose_inputs(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try inputs that do not reach the arm."""
    nothing = 0.0 if predictor.dataset.input == 'tension' else np.nan
    for j, name in enumerate(predictor.robot.inputs):
        yield from evaluated(
            predictor,
            predictor.markers({}, _with_one(j, nothing, predictor.inputs)),
            'input_loose',
            f'if input {name} never reached the arm',
            f'look whether {name} is connected, and its wire taut',
            **_with_inputs(predictor.dataset, partial(_with_one, j, nothing)),
        )


def _with_one(j: int, value: float | Floats, inputs: Floats) -> Floats:
    """Return inputs (..., m) with another value of one."""
    changed = np.array(inputs)
    changed[..., j] = value
    return changed


def moved_rows(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try inputs and shapes that belong to different postures: rows moved by one, or reversed."""
    dataset, one = predictor.dataset, 'row of inputs.csv does not belong to its posture'
    if dataset.path != 'from_straight':
        return
    P, shifted = len(dataset.postures), f'a {one} in shapes.csv: one was left out, or is double'
    for how, rows, kept in (
        ('moved by one row down', np.roll(np.arange(P), 1), slice(1, None)),
        ('moved by one row up', np.roll(np.arange(P), -1), slice(None, -1)),
        ('in reverse order', np.arange(P)[::-1], slice(None)),
    ):
        positions = dataset.positions[rows]
        moved = replace(dataset, robot=predictor.robot, positions=positions, trial_inputs=None)
        yield from evaluated(
            predictor,
            markers[kept],
            'rows_moved',
            f'with the postures {how}',
            f'a {one} in shapes.csv' if how.startswith('in') else shifted,
            dataset=moved.select(dataset.postures[kept]),
        )


def turned_axes(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try all orders and signs of the axes."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            if list(order) == [0, 1, 2] and min(signs) > 0.0:
                continue
            columns = ', '.join(
                f'{"" if sign > 0 else "-"}{"xyz"[i]}'
                for i, sign in zip(order, signs, strict=True)
            )
            yield from evaluated(
                predictor,
                markers,
                'axes',
                f'with the axes of the tracker taken as ({columns})',
                f'write {columns} into the columns x, y, z of shapes.csv',
                positions=predictor.dataset.positions[..., order] * np.array(signs),
            )


def registered(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try a free rigid registration (Kabsch 1976); a load can imitate a small one."""
    measured = predictor.dataset.mean
    visible = np.isfinite(measured).all(axis=2)
    rotation, shift = rigid_fit(measured[visible], markers[visible])
    angle = math.degrees(rotation_angle(rotation))
    far = np.linalg.norm(shift) > FRAME_SHIFTED_MIN * predictor.robot.length
    if angle < FRAME_TURNED_MIN_DEG and not far:
        return
    millimetres = ', '.join(f'{1e3 * x:.1f}' for x in shift)
    yield Mistake(
        'registration',
        f'with the frame of the tracker turned by {angle:.1f}° and shifted by {millimetres} mm',
        'register the tracker to the base of the arm again',
        rms(measured @ rotation.T + shift - markers),
    )


def wrong_units(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try units of the inputs and of the positions."""
    tension, dataset = predictor.dataset.input == 'tension', predictor.dataset
    described = 'bending_stiffness [N·m/rad] and offsets [m]' if tension else 'offsets [m]'
    stretch = ', and how far its wires stretch (wire_spring)'  # an arm bends less by that
    for factor in UNIT_FACTORS:
        yield from evaluated(
            predictor,
            predictor.markers({}, predictor.inputs * factor),
            'unit_of_inputs',
            f'with all inputs {times(factor)}',
            f'check their unit in inputs.csv {"[N]" if tension else "[m]"}; if that is right, '
            f'{described} of the description{"" if tension or factor > 1.0 else stretch}',
            **_with_inputs(dataset, partial(np.multiply, factor)),
        )
        yield from evaluated(
            predictor,
            markers,
            'unit_of_positions',
            f'with all positions {times(factor)}',
            'check their unit in shapes.csv [m]',
            positions=dataset.positions * factor,
        )


def wrong_offsets(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try tendons that run twice or half as far from the centre as described."""
    for factor in (0.5, 2.0):
        tendons = tuple(scaled(one, factor, DIGITS_OF_THE_ARM) for one in predictor.robot.tendons)
        if any(tendon.offsets for tendon in tendons):
            return
        yield from otherwise_described(
            predictor,
            replace(predictor.dataset, robot=replace(predictor.robot, tendons=tendons)),
            'offsets',
            f'with the offsets of the tendons {times(factor)}',
            'check the offsets [m] of the description (diameter for radius?)',
            doubtful=False,
        )


def wrong_stiffness(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try a bending stiffness that is wrong by a factor: of a unit, or of a diameter."""
    for factor, why in STIFFNESS_FACTORS.items():
        sections = tuple(
            s
            if s.is_plate
            else replace(s, bending_stiffness=tuple(factor * k for k in s.bending_stiffness))
            for s in predictor.robot.sections
        )
        yield from otherwise_described(
            predictor,
            replace(predictor.dataset, robot=replace(predictor.robot, sections=sections)),
            'stiffness',
            f'with the bending stiffness {times(factor)}',
            f'check how it was worked out ({why}?): modulus, diameter, length of a cell',
            doubtful=False,
        )


SIZES = (wrong_units, wrong_offsets, wrong_stiffness)  # numbers that are off by a factor


def gravities(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """
    Try gravity along every axis, and as large as on the Earth, where weight is described.

    A tracker's frame that was laid level by the described gravity turns with it; it stays where
    gravity was written wrongly afterwards.
    """
    described = np.asarray(predictor.parts[0].gravity)
    size = float(np.linalg.norm(described))
    if not predictor.model.acts('gravity'):
        return
    axes = [described / size] if size > 0.0 else []
    axes += [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    sizes = {size} if abs(size / EARTH - 1.0) < NEGLIGIBLE else {size, EARTH} - {0.0}
    positions = predictor.dataset.positions
    for axis, much in product(axes, sizes):
        vector = np.round(much * axis, 9) + 0.0
        if np.allclose(vector, described):
            continue
        turned = copy(predictor)  # in all parts of the data set
        turned.parts = [replace(part, gravity=vector) for part in predictor.parts]
        moved = turned.markers({})
        level = predictor.robot.tolerances.get('rotation', 0.0) >= FRAME_HARDLY_KNOWN_RAD
        rotations = [rotation_between(described, vector)] if level and size > 0.0 else []
        x, y, z = vector.tolist()
        text = f'{x:g}, {y:g}, {z:g}'
        for rotation in (*rotations, np.eye(3)):
            yield from evaluated(
                predictor,
                moved,
                'gravity',
                f'with gravity [{text}]',
                f'write gravity: [{text}] into dataset.yaml',
                positions=positions @ rotation.T,
                gravity=(x, y, z),
                robot=replace(predictor.robot, gravity=(x, y, z)),
            )


def dead_inputs(predictor: Predictor, markers: Floats) -> Iterator[Mistake]:
    """Try inputs with a constant reading as unknown in every posture."""
    given = predictor.inputs
    if predictor.dataset.input != 'tension' or len(given) < 2:
        return
    largest, spans = float(np.nanmax(given)), np.ptp(given, axis=0)
    if spans.max() < 10.0 * NEGLIGIBLE * largest:
        return
    for j in np.flatnonzero(spans < NEGLIGIBLE * largest).tolist():
        yield from dead_input(predictor, j, {})


def dead_input(predictor: Predictor, j: int, point: Point) -> Iterator[Mistake]:
    """Fit the value of an input in each posture to its markers, at a point of effects."""
    dataset, given = predictor.dataset, predictor.inputs
    name, fitted, largest = predictor.robot.inputs[j], given.copy(), float(np.nanmax(given))
    sizes = largest * DEAD_SIZES
    moved = [predictor.markers(point, _with_one(j, size, given)) for size in sizes.tolist()]
    none = np.full_like(dataset.mean, np.nan)
    seen = np.array([none if one is None else one for one in moved])  # (S, P, J, 3)
    for _ in range(3):
        now = predictor.markers(point, fitted)
        if now is None:
            break
        measured = in_frame(predictor, dataset, now).mean
        errors = mean_over(((measured - seen) ** 2).sum(axis=3), 2)
        errors = np.where(np.isnan(errors), np.inf, errors)  # (S, P); the minimum is interpolated
        k = np.clip(np.argmin(errors, axis=0), 1, len(sizes) - 2)
        below, lowest, above = (errors[k + i, np.arange(len(given))] for i in (-1, 0, 1))
        with np.errstate(invalid='ignore', divide='ignore'):
            between = 0.5 * (below - above) / (below - 2.0 * lowest + above)
        between = np.clip(np.where(np.isfinite(between), between, 0.0), -1.0, 1.0)
        fitted[:, j] = sizes[k] + between * (sizes[1] - sizes[0])
    own = fitted[:, j]
    for one in evaluated(
        predictor,
        predictor.markers({}, fitted),
        'input_dead',
        f'input {name} reads {np.median(given[:, j]):.3g} N in every posture; with '
        f'{own.min():.2g} to {own.max():.2g} N, as the markers ask for,',
        f'look at the load cell of {name}',
        inputs=fitted,
        trial_inputs=None,
    ):
        yield replace(one, free_input=j)
