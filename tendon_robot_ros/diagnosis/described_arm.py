"""What `improve` may change of the arm itself: stiffness along it, and how its tendons run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial import legendre

from ..comparison.conditions import Conditions
from ..comparison.predict import FreeParameter, Point, Predictor
from ..data import DataSet
from ..effects import Catalogue, Parameter
from ..robot import Robot, Tendon
from ..robot.routes import helix_angles, tendon_offsets
from .candidates import Candidate

Floats = npt.NDArray[np.float64]
PROFILE = 'bending_stiffness'  # of the description: how it changes along the arm
PROFILE_DEGREE = 4  # of the polynomial by which its logarithm changes
ROUTES = 'tendon_routes'  # of the description: every tendon turned about the axis, and winding
TURN_MAX = 1.0  # [rad] about the axis at the base, and on the whole way to the tip
TURN_TYPICAL = 0.03  # [rad]
ROUTES_KEPT_MAX = 64  # arrangements of the tendons that are not computed again
WINDS_AT_LEAST = 1e-6  # [rad/m] no more than rounding, but the model is ready for more
OF_THE_ARM = (PROFILE, ROUTES)


class DescribedArm(Predictor):
    """A predictor that also moves what the description says of the arm."""

    def __init__(self, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> None:
        """Build the model of an arm whose tendons are ready to wind."""
        self.described = robot
        super().__init__(dataset, _winding(robot) if may_wind(robot) else robot, catalogue)
        self._routes = (self.model.arrays.offset.copy(), self.model.arrays.helix.copy())
        self._rerouted: dict[tuple[Any, ...], tuple[Floats, Floats]] = {}

    def value(self, free: FreeParameter) -> float:
        """Value that the description gives a parameter; of the arm itself: its change, none."""
        return 0.0 if free.effect in OF_THE_ARM else super().value(free)

    def set_parameters(
        self, point: Point, part: Conditions, stiffness: Floats | None = None
    ) -> None:
        """Set the parameters of the model, and the arm itself; see `Predictor.set_parameters`."""
        effects = {free: v for free, v in point.items() if free.effect not in OF_THE_ARM}
        profile = [v for free, v in point.items() if free.effect == PROFILE]
        if profile:
            own = profile_factors(profile, self.robot)
            stiffness = own if stiffness is None else own * stiffness
        super().set_parameters(effects, part, stiffness)
        routes = self._routes_at(point)
        self.model.arrays.offset[:], self.model.arrays.helix[:] = routes

    def _routes_at(self, point: Point) -> tuple[Floats, Floats]:
        """Return offsets (n, k, 2) [m] and helix angles (n, k) [rad] of the tendons at a point."""
        moved = tuple(sorted((f.column, f.parameter.name, v) for f, v in point.items()
                             if f.effect == ROUTES and v != 0.0))  # fmt: skip
        if not moved:
            return self._routes
        if moved not in self._rerouted:
            if len(self._rerouted) >= ROUTES_KEPT_MAX:
                self._rerouted.clear()
            robot = _winding(rerouted(self.described, point))
            self._rerouted[moved] = tendon_offsets(robot), helix_angles(robot)
        return self._rerouted[moved]


def blocks_of_the_arm(robot: Robot) -> Iterator[Candidate]:
    """Yield what may change of the arm, as candidates."""
    degrees = [f'along_{k}' for k in range(1, PROFILE_DEGREE + 1)]
    profile = [FreeParameter(PROFILE, Parameter(d, '1', -3.0, 3.0, 0.0, 0.1)) for d in degrees]
    yield Candidate((PROFILE,), tuple(profile), True)
    if may_wind(robot):
        size, most = TURN_TYPICAL / robot.length, TURN_MAX / robot.length
        turn = Parameter('turn', 'rad', -TURN_MAX, TURN_MAX, 0.0, TURN_TYPICAL)
        helix = Parameter('helix', 'rad/m', -most, most, 0.0, size)
        routes = [
            FreeParameter(ROUTES, parameter, i, tendon.name)
            for i, tendon in enumerate(robot.tendons)
            for parameter in (turn, helix)
        ]
        yield Candidate((ROUTES,), tuple(routes), True)


def may_wind(robot: Robot) -> bool:
    """Tell whether the tendons have routes that can turn: none is given cell by cell."""
    return not any(tendon.offsets for tendon in robot.tendons)


def profile_factors(coefficients: Sequence[float], robot: Robot) -> Floats:
    """Return a factor (n,) on the stiffness of every cell: exp of a Legendre polynomial."""
    lengths = np.array([s.cell_length for s in robot.sections for _ in range(s.cells)])
    places = (2.0 * np.cumsum(lengths) - lengths) / robot.length - 1.0
    return np.asarray(np.exp(legendre.legval(places, [0.0, *coefficients])))


def rerouted(robot: Robot, point: Point) -> Robot:
    """Return the description with tendons that are turned at the base [rad] and wind [rad/m]."""
    change = {(free.column, free.parameter.name): value for free, value in point.items()
              if free.effect == ROUTES}  # fmt: skip
    tendons = []
    for i, tendon in enumerate(robot.tendons):
        c, s = np.cos(change.get((i, 'turn'), 0.0)), np.sin(change.get((i, 'turn'), 0.0))
        base, end = ((c * x - s * y, s * x + c * y) for x, y in (tendon.base, tendon.end))
        helix = tendon.helix + change.get((i, 'helix'), 0.0)
        tendons.append(replace(tendon, base=base, end=end, helix=helix))
    return replace(robot, tendons=tuple(tendons))


def arm_with(robot: Robot, point: Point) -> Robot:
    """Return the description with what a point says of the arm itself."""
    if any(free.effect == ROUTES for free in point):
        robot = replace(robot, tendons=tuple(_written(t) for t in rerouted(robot, point).tendons))
    profile = [value for free, value in point.items() if free.effect == PROFILE]
    if not profile:
        return robot
    factors = profile_factors(profile, robot)
    ends = np.cumsum([section.cells for section in robot.sections])
    sections = []
    for section, end in zip(robot.sections, ends, strict=True):
        own = zip(section.bending_stiffness, factors[end - section.cells : end], strict=True)
        stiffness = tuple(_short(k * factor) for k, factor in own)
        sections.append(replace(section, bending_stiffness=stiffness))
    return replace(robot, sections=tuple(sections))


def stiffness_change(robot: Robot, point: Point) -> tuple[float, ...]:
    """Return the relative change of the stiffness at base, middle and tip [1]; else nothing."""
    profile = [value for free, value in point.items() if free.effect == PROFILE]
    change = profile_factors(profile, robot) - 1.0
    return tuple(change[[0, len(change) // 2, -1]].tolist()) if profile else ()


def route_changes(point: Point) -> dict[str, tuple[float, float]]:
    """Return by how much each tendon is turned at the base [rad], and winds [rad/m]."""
    values = {
        (free.label, free.parameter.name): value
        for free, value in point.items()
        if free.effect == ROUTES
    }
    return {name: (values[name, 'turn'], values[name, 'helix']) for name, _ in values}


def _winding(robot: Robot) -> Robot:
    tendons = (replace(tendon, helix=tendon.helix or WINDS_AT_LEAST) for tendon in robot.tendons)
    return replace(robot, tendons=tuple(tendons))


def _written(tendon: Tendon) -> Tendon:
    (x, y), (end_x, end_y) = tendon.base, tendon.end
    base, end = (_short(x), _short(y)), (_short(end_x), _short(end_y))
    return replace(tendon, base=base, end=end, helix=_short(tendon.helix))


def _short(value: float) -> float:
    return float(f'{value:.9g}')
