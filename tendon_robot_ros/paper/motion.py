"""Range of motion (section IV.B): tendon-group arrangements, and what tendon stiffness costs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..model.model import Model
from ..robot import Robot
from ..workspace.grid import Family, Pair, Workspace, find_workspace
from .robots import Floats

VIEW_ANGLES_RAD = (float(np.pi), float(np.pi / 4.0))  # [rad]
TENSION_STEP_N, PRETENSION_N = 0.1, 0.1  # [N]
# [°] of the outer wires of a group from the middle one
GROUP_SPREADS_DEG = (15.0, 30.0, 45.0, 60.0)
VIEW_TOLERANCES_DEG = (1.0, 2.5, 5.0)  # [°] by which 180° may be missed
# six tendons together have this share of a cell's stiffness: "smaller by at least one order"
SHARED_TENDONS, TENDONS_SHARE = 6, 0.1


@dataclass(frozen=True)
class Arrangement:
    """A way to lay the three wires of a group, and the range of the tips that it gives."""

    name: str
    across: float  # [m] of the tips at the 180° view; 0: not reached
    low: float  # [m] over the tolerances of the view angle
    high: float
    largest: float  # [rad] tip angle


@dataclass(frozen=True)
class Stiffening:
    """What tendons that are not limp cost: relative changes [1], tip shifts [m]."""

    per_tendon: float  # [N·m/rad]
    tendons: tuple[int, ...]  # in every section
    bending: tuple[float, ...]  # change of the bends of every section, rms over rms
    shift: float  # mean tip shift over the postures
    relative: float  # the same over the mean way of the tip from straight
    softer: float  # change of the proximal backbone that evens the sections out
    evened: float  # tip shift with it at equally higher tensions


@dataclass(frozen=True, eq=False)
class MotionExperiment:
    """Section IV.B on one robot."""

    workspace: Workspace
    arrangements: tuple[Arrangement, ...]
    stiffening: Stiffening  # by the tendons that are pulled
    every_tendon: Stiffening  # by all that run there

    @property
    def main(self) -> Family:
        """The postures at 180° with most members: figure 8."""
        return self.workspace.of(VIEW_ANGLES_RAD[0])[0]


def motion(robot: Robot) -> MotionExperiment:
    """Sweep a robot of two sections with grouped tendons as section IV.B does."""
    workspace = find_workspace(Model(robot), VIEW_ANGLES_RAD, TENSION_STEP_N, PRETENSION_N)
    family = workspace.of(VIEW_ANGLES_RAD[0])[0]
    made = tuple(_arrangement(name, one, family.pair) for name, one in _variants(robot))
    return MotionExperiment(
        workspace, made, stiffening(robot, family), stiffening(robot, family, every=True)
    )


def spread(robot: Robot, degrees: float) -> Robot:
    """Return the robot with the wires of every group of three spread by an angle about z."""
    tendons = list(robot.tendons)
    for members in robot.input_tendons:
        for k, turn in zip(members, np.radians([-degrees, 0.0, degrees]), strict=True):
            (x, y), c, s = tendons[k].base, float(np.cos(turn)), float(np.sin(turn))
            place = (c * x - s * y, s * x + c * y)
            tendons[k] = replace(tendons[k], base=place, end=place)
    return replace(robot, tendons=tuple(tendons))


def stiffening(robot: Robot, family: Family, every: bool = False) -> Stiffening:
    """
    Let the tendons stiffen the robot, then soften the proximal backbone.

    Six tendons make a tenth of a cell's stiffness. Counted are those that are pulled (six
    proximal, three distal), or every one that runs there.
    """
    bare = robot if every else _only(robot, family.pair)
    count = np.array(bare.tendon_cells)
    cells = np.cumsum([section.cells for section in bare.sections])
    present = tuple(int((count >= end).sum()) for end in cells)
    stiffness = bare.sections[0].bending_stiffness[0]
    per_tendon = TENDONS_SHARE * stiffness / SHARED_TENDONS
    stiff = bare.with_effect('tendon_stiffness', {'per_tendon': per_tendon})
    softer = -(present[0] - present[-1]) * per_tendon / stiffness
    even = stiff.with_effect('section_stiffness', {'relative_change': (softer, 0.0)})
    tensions = family.tensions if every else family.tensions[:, list(family.pair.indices)]
    rise = 1.0 + present[-1] * per_tendon / stiffness
    limp, with_them = Model(bare).shapes(tensions), Model(stiff).shapes(tensions)
    evened = Model(even).shapes(rise * tensions)

    def shift(tips: Floats) -> float:
        return float(np.linalg.norm(tips - limp.tip_position, axis=1).mean())

    sections = np.split(np.arange(bare.cells), cells[:-1])
    change = with_them.bend - limp.bend
    bending = tuple(
        float(np.linalg.norm(change[:, part]) / np.linalg.norm(limp.bend[:, part]))
        for part in sections
    )
    moved = limp.tip_position - [0.0, 0.0, bare.length]
    relative = shift(with_them.tip_position) / float(np.linalg.norm(moved, axis=1).mean())
    return Stiffening(
        per_tendon, present, bending, shift(with_them.tip_position), relative, softer,
        shift(evened.tip_position),
    )  # fmt: skip


def _only(robot: Robot, pair: Pair) -> Robot:
    """Return the robot with the tendons of one pair of inputs."""
    kept = [k for j in pair.indices for k in robot.input_tendons[j]]
    return replace(robot, tendons=tuple(robot.tendons[k] for k in kept))


def _variants(robot: Robot) -> Iterator[tuple[str, Robot]]:
    low, high = robot.tension_limits
    yield f'three wires at one place, {high:g} N each', robot
    for angle in GROUP_SPREADS_DEG:
        yield f'three wires spread by ±{angle:g}°, {high:g} N each', spread(robot, angle)
    yield (
        f'three wires at one place, {high:g} N in all',
        replace(robot, tension_limits=(min(low, high / 3.0), high / 3.0)),
    )


def _arrangement(name: str, robot: Robot, pair: Pair) -> Arrangement:
    wide = np.radians(max(VIEW_TOLERANCES_DEG))
    workspace = find_workspace(
        Model(robot), VIEW_ANGLES_RAD[:1], TENSION_STEP_N, PRETENSION_N, wide, [pair]
    )
    families = workspace.of(VIEW_ANGLES_RAD[0])
    spans = [
        _across(families[0], tolerance) if families else 0.0 for tolerance in VIEW_TOLERANCES_DEG
    ]
    middle = spans[VIEW_TOLERANCES_DEG.index(2.5)]
    return Arrangement(name, middle, min(spans), max(spans), workspace.largest)


def _across(family: Family, tolerance: float) -> float:
    """Range of the tips along x [m] of the postures nearer to the view than a tolerance [°]."""
    near = np.abs(np.abs(family.angle) - family.view) <= np.radians(tolerance)
    return float(np.ptp(family.tips[near, 0])) if near.any() else 0.0
