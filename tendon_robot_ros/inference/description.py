"""
What a fit changes in a description: effects, and the arm itself.

Values of effects, declared quantities that moved, imperfections, and what `improve` may change:
the stiffness along the arm, and the routes of its tendons.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre

from ..common.arrays import Floats
from ..data import DataSet
from ..effects import Catalogue, Parameter
from ..robot import Robot
from ..robot.description import EffectValues, Tendon, helix_angles, tendon_offsets
from .candidates import Candidate
from .fit import Fit
from .imperfections import GAIN, HOLE, POSITION, ROTATION, ZERO
from .predict import CELLS, Conditions, FreeParameter, Point, Predictor

WRITABLE_KINDS = (CELLS, GAIN, HOLE, ZERO, POSITION, ROTATION)  # kinds that a description can hold
PROFILE = 'bending_stiffness'  # of the description: how it changes along the arm
PROFILE_DEGREE = 4  # [1] of a polynomial, because a dozen of markers tell no more of it
ROUTES = 'tendon_routes'  # of the description: every tendon turned about the axis, and winding
ANGLE_MAX = 1.0  # [rad] at the base, and to the tip, else a tendon would be its neighbour
ANGLE_TYPICAL = 0.03  # [rad] 2°, because holes are drilled to a few tenths of a millimetre
OF_THE_ARM = (PROFILE, ROUTES)
# [1] of what is written, because errors are told of the arm as it was fitted
DIGITS_OF_THE_ARM = 9


def with_values(
    robot: Robot, catalogue: Catalogue, values: Iterable[tuple[FreeParameter, float]]
) -> Robot:
    """Return a description with values of parameters; others of their effects stay as they are."""
    effects: dict[str, EffectValues] = {}
    counts = {'section': len(robot.sections), 'tendon': len(robot.tendons)}
    for free, value in values:
        name, key, count = free.effect, free.parameter.name, counts.get(free.parameter.per, 1)
        if name not in effects:
            own = (p for p in catalogue[name].parameters if not p.only_described)
            effects[name] = {**{p.name: p.neutral for p in own}, **robot.effects.get(name, {})}
        if free.column is None or count == 1:
            effects[name][key] = _short(value)
            continue
        before = effects[name][key]
        each = list(before) if isinstance(before, tuple) else [before] * count
        each[free.column] = _short(value)  # of so many sections or tendons
        effects[name][key] = tuple(each)
    for name, known in effects.items():
        robot = robot.with_effect(name, known, robot.fitted.get(name))
    return robot


def changed_robot(robot: Robot, catalogue: Catalogue, fit: Fit, dataset: DataSet) -> Robot:
    """Return the description with fitted effects, and with what was fitted of the arm itself."""
    known = zip(fit.frees, fit.values.tolist(), strict=False)
    values = [(free, value) for free, value in known if free.effect in catalogue]
    robot = with_values(robot, catalogue, values)
    if robot.gravity is None and any('gravity' in catalogue[f.effect].needs for f, _ in values):
        robot = replace(robot, gravity=dataset.gravity)
    return arm_with(robot, fit.point)


def with_cells(robot: Robot, factors: Floats, digits: int = 6) -> Robot:
    """Return a description whose cells are stiffer by factors (n,)."""
    stiffness = np.concatenate([section.bending_stiffness for section in robot.sections])
    values = [_short(value, digits) for value in (stiffness * factors).tolist()]
    ends = np.cumsum([section.cells for section in robot.sections]).tolist()
    sections = tuple(
        replace(section, bending_stiffness=tuple(values[end - section.cells : end]))
        for section, end in zip(robot.sections, ends, strict=True)
    )
    return replace(robot, sections=sections)


def with_members(robot: Robot, fit: Fit, input: str) -> Robot:
    """
    Return a description with the cells, tendons and the registration as a fit found them.

    The gain of a tension is written as an offset of its tendons: their product is what bends.
    Those of wire pulls are `spool_gain` and `pull_zero` of each tendon. Kinks have no place in a
    description.
    """
    values = fit.members
    if not fit.as_built:
        return robot
    robot = with_cells(robot, 1.0 + values.get(CELLS, np.zeros(robot.cells)))
    scale = np.ones(len(robot.tendons))
    if input == 'tension':
        for change, members in zip(values.get(GAIN, ()), robot.input_tendons, strict=False):
            scale[list(members)] *= 1.0 + change
    scale *= 1.0 + values.get(HOLE, np.zeros(len(scale)))
    tendons = map(scaled, robot.tendons, scale.tolist())
    robot = replace(robot, tendons=tuple(tendons))
    robot = robot if input == 'tension' else wound(robot, values)
    name = 'base_misalignment'
    moved = [(POSITION, 'shift'), (ROTATION, 'rotation')]
    if not any(values.get(kind, np.zeros(3)).any() for kind, _ in moved):
        return robot
    before, frame = robot.effects.get(name, {}), EffectValues()
    for kind, key in moved:  # added to the registration that the description has
        for axis, change in zip('xyz', values.get(kind, np.zeros(3)).tolist(), strict=True):
            old = before.get(f'{key}_{axis}', 0.0)
            frame[f'{key}_{axis}'] = _short((old if isinstance(old, float) else old[0]) + change)
    return robot.with_effect(name, frame, robot.fitted.get(name))


def wound(robot: Robot, members: dict[str, Floats]) -> Robot:
    """Write gains and zeros of wire pulls: wound = commanded (1 + change) + offset."""
    gain, zero = np.zeros(len(robot.tendons)), np.zeros(len(robot.tendons))
    for kind, values in ((GAIN, gain), (ZERO, zero)):
        for value, tendons in zip(members.get(kind, ()), robot.input_tendons, strict=False):
            values[list(tendons)] = value
    change = np.array(robot.effects.get('spool_gain', {}).get('relative_change', 0.0))
    offset = np.array(robot.effects.get('pull_zero', {}).get('offset', 0.0))
    for name, key, values in (
        ('pull_zero', 'offset', offset + zero * (1.0 + change)),
        ('spool_gain', 'relative_change', (1.0 + gain) * (1.0 + change) - 1.0),
    ):
        if (zero if name == 'pull_zero' else gain).any():
            written = tuple(_short(value) for value in values.tolist())
            robot = robot.with_effect(name, {key: written}, robot.fitted.get(name))
    return robot


def scaled(tendon: Tendon, factor: float, digits: int = 6) -> Tendon:
    """Return a tendon that runs so many times as far from the centre."""
    base, end, *offsets = (
        (_short(x * factor, digits), _short(y * factor, digits))
        for x, y in (tendon.base, tendon.end, *tendon.offsets)
    )
    return replace(tendon, base=base, end=end, offsets=tuple(offsets))


def _short(value: float, digits: int = 6) -> float:
    return float(f'{value:.{digits}g}')


class DescribedArm(Predictor):
    """A predictor that also moves what the description says of the arm."""

    def __init__(self, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> None:
        """Build the model of an arm whose tendons are ready to wind."""
        self.described = robot
        super().__init__(dataset, _winding(robot) if may_wind(robot) else robot, catalogue)
        self._routes = (self.model.arrays.offset.copy(), self.model.arrays.helix.copy())
        self._moved: Point = {}  # of the routes, offsets [m] and helix angles [rad], that are kept

    def value(self, free: FreeParameter) -> float:
        """Value that the description gives a parameter; of the arm itself: its change, none."""
        return 0.0 if free.effect in OF_THE_ARM else super().value(free)

    def set_parameters(self, point: Point, part: Conditions) -> None:
        """Set the parameters of the model, and the arm itself; see `Predictor.set_parameters`."""
        effects = {free: v for free, v in point.items() if free.effect not in OF_THE_ARM}
        super().set_parameters(effects, part)
        if profile := profile_of(point):
            self.model.arrays.cells[:, 1] *= profile_factors(profile, self.robot)
        moved = {free: v for free, v in point.items() if free.effect == ROUTES and v != 0.0}
        if moved != self._moved:
            robot = _winding(rerouted(self.described, moved))
            self._moved, self._routes = moved, (tendon_offsets(robot), helix_angles(robot))
        self.model.arrays.offset[:], self.model.arrays.helix[:] = self._routes


def blocks_of_the_arm(robot: Robot) -> Iterator[Candidate]:
    """Yield what may change of the arm, as candidates."""
    degrees = [f'along_{k}' for k in range(1, PROFILE_DEGREE + 1)]
    profile = [FreeParameter(PROFILE, Parameter(d, '1', -3.0, 3.0, 0.0, 0.1)) for d in degrees]
    yield Candidate((PROFILE,), tuple(profile), True)
    if may_wind(robot):
        size, helix_max = ANGLE_TYPICAL / robot.length, ANGLE_MAX / robot.length
        angle = Parameter('turn', 'rad', -ANGLE_MAX, ANGLE_MAX, 0.0, ANGLE_TYPICAL)
        helix = Parameter('helix', 'rad/m', -helix_max, helix_max, 0.0, size)
        routes = [
            FreeParameter(ROUTES, parameter, i, tendon.name)
            for i, tendon in enumerate(robot.tendons)
            for parameter in (angle, helix)
        ]
        yield Candidate((ROUTES,), tuple(routes), True)


def may_wind(robot: Robot) -> bool:
    """Tell whether the tendons have routes that can turn: none is given cell by cell."""
    return not any(tendon.offsets for tendon in robot.tendons)


def profile_of(point: Point) -> list[float]:
    """Return the coefficients of the stiffness along the arm that a point has."""
    return [value for free, value in point.items() if free.effect == PROFILE]


def profile_factors(coefficients: Sequence[float], robot: Robot) -> Floats:
    """Return a factor (n,) on the stiffness of every cell: exp of a Legendre polynomial."""
    lengths = robot.cell_lengths
    places = (2.0 * np.cumsum(lengths) - lengths) / robot.length - 1.0
    return np.asarray(np.exp(legendre.legval(places, [0.0, *coefficients])))


def rerouted(robot: Robot, point: Point) -> Robot:
    """Return the description with tendons that are turned at the base [rad] and wind [rad/m]."""
    tendons, changes = list[Tendon](), route_changes(point)
    for tendon in robot.tendons:
        turn, helix = changes.get(tendon.name, (0.0, 0.0))
        c, s = math.cos(turn), math.sin(turn)
        base, end = ((c * x - s * y, s * x + c * y) for x, y in (tendon.base, tendon.end))
        tendons.append(replace(tendon, base=base, end=end, helix=tendon.helix + helix))
    return replace(robot, tendons=tuple(tendons))


def arm_with(robot: Robot, point: Point) -> Robot:
    """Return the description with what a point says of the arm itself."""
    if any(free.effect == ROUTES for free in point):
        digits = DIGITS_OF_THE_ARM
        tendons = (
            replace(scaled(t, 1.0, digits), helix=_short(t.helix, digits))
            for t in rerouted(robot, point).tendons
        )
        robot = replace(robot, tendons=tuple(tendons))
    profile = profile_of(point)
    if not profile:
        return robot
    return with_cells(robot, profile_factors(profile, robot), DIGITS_OF_THE_ARM)


def stiffness_change(robot: Robot, point: Point) -> tuple[float, ...]:
    """Return the relative change of the stiffness at base, middle and tip [1]; else nothing."""
    profile = profile_of(point)
    change = profile_factors(profile, robot) - 1.0
    return tuple(change[[0, len(change) // 2, -1]].tolist()) if profile else ()


def route_changes(point: Point) -> dict[str, tuple[float, float]]:
    """Return by how much each tendon is turned at the base [rad], and winds [rad/m]."""
    changes: dict[str, dict[str, float]] = {}
    for free, value in point.items():
        if free.effect == ROUTES:
            changes.setdefault(free.label, {})[free.parameter.name] = value
    return {name: (own.get('turn', 0.0), own.get('helix', 0.0)) for name, own in changes.items()}


def _winding(robot: Robot) -> Robot:
    tendons = (t if t.helix else replace(t, helix=1e-6) for t in robot.tendons)
    return replace(robot, tendons=tuple(tendons))
