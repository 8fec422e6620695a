"""The paper's robots, their variants, and their range of motion (section IV.B)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..model.model import Model
from ..robot import Robot
from ..workspace.grid import Family, Pair, Workspace, find_workspace

Floats = npt.NDArray[np.float64]
HINGE_LEVER_M = 0.40e-3  # [m] of the 10:1 prototype, so that section IV.D's errors come out
VIEW_LEVELS = 101  # tensions up to the limit among which a view angle is bracketed
VIEW_HALVINGS = 40  # of the bracket: to 1e-12 of it
VIEW_ANGLES_RAD = (float(np.pi), float(np.pi / 4.0))  # [rad] figures 8 and 7
TENSION_STEP_N, PRETENSION_N = 0.1, 0.1  # [N] as published
# [°] of the outer wires of a group from the middle one: Table I, which would say it, is lost
GROUP_SPREADS_DEG = (15.0, 30.0, 45.0, 60.0)
# [°] by which 180° may be missed, because on a grid of 0.1 N an exact 180° is hardly ever there
VIEW_TOLERANCES_DEG = (1.0, 2.5, 5.0)
# six tendons together have this share of a cell's stiffness: "smaller by at least one order"
SHARED_TENDONS, TENDONS_SHARE = 6, 0.1


@dataclass(frozen=True)
class Robots:
    """The four descriptions that the experiments need."""

    target: Robot  # 1:1, section IV.B
    prototype: Robot  # 10:1, two sections, IV.C
    single: Robot  # 10:1, one section, IV.D
    small: Robot  # 2:1, one section, IV.E


def pcca(robot: Robot) -> Robot:
    """Return the robot without any effect: piecewise constant curvature."""
    return replace(robot, name='PCCA', effects={}, fitted={})


def with_arm(robot: Robot, arm: float) -> Robot:
    """Return the robot with all tendons at a distance [m] from the centroid, sides kept."""
    tendons = []
    for tendon in robot.tendons:
        scale = arm / float(np.hypot(*tendon.base))
        place = (scale * tendon.base[0], scale * tendon.base[1])
        tendons.append(replace(tendon, base=place, end=place))
    return replace(robot, tendons=tuple(tendons))


def with_cells(robot: Robot, cells: int) -> Robot:
    """Return a robot of one section with as many cells, of the same length and stiffness."""
    (section,) = robot.sections
    made = replace(
        section,
        cells=cells,
        cell_length=section.cells * section.cell_length / cells,
        bending_stiffness=(section.bending_stiffness[0] * cells / section.cells,) * cells,
        mass_profile=(1.0,) * cells,
    )
    return replace(robot, sections=(made,))


def at_view(model: Model, inputs: tuple[int, int], near: Floats, view: float, side: int) -> Floats:
    """
    Find tensions at which the tip looks at a view angle exactly.

    Parameters
    ----------
    model : Model
        Of a planar robot.
    inputs : (int, int)
        Index of the input whose tension is given, and of the one that is found; others are slack.
    near : (b,) [N]
        Tensions of the first.
    view : float
        Tip angle [rad].
    side : int
        Sign of the tip angle.

    Returns
    -------
    (c, m) [N]
        In the order of `near`, those without a solution left out.

    """
    levels = np.linspace(0.0, model.robot.tension_limits[1], VIEW_LEVELS)
    rows = np.zeros((len(near), len(levels), len(model.inputs)))
    rows[:, :, inputs[0]], rows[:, :, inputs[1]] = near[:, None], levels

    def gap_at(tensions: Floats) -> Floats:
        """How much farther than the view angle the tip is turned, (...) [rad]."""
        bend = model.solve(tensions.reshape(-1, len(model.inputs)))[0].bend
        turned = bend[:, :, 0].sum(axis=1).reshape(tensions.shape[:-1])
        return np.asarray(side * turned - view)

    gap = gap_at(rows)
    crossing = (gap[:, :-1] < 0.0) & (gap[:, 1:] >= 0.0)
    postures = np.flatnonzero(crossing.any(axis=1))
    at = crossing[postures].argmax(axis=1)
    low, high = rows[postures, at], rows[postures, at + 1]
    for _ in range(VIEW_HALVINGS):
        middle = 0.5 * (low + high)
        below = (gap_at(middle) < 0.0)[:, None]
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(high)


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
    low, high = robot.tension_limits
    variants = {f'three wires at one place, {high:g} N each': robot}
    for angle in GROUP_SPREADS_DEG:
        name = f'three wires spread by ±{angle:g}°, {high:g} N each'
        variants[name] = spread(robot, angle)
    shared = (min(low, high / 3.0), high / 3.0)
    variants[f'three wires at one place, {high:g} N in all'] = replace(
        robot, tension_limits=shared
    )
    made = tuple(_arrangement(name, one, family.pair) for name, one in variants.items())
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
    bare = robot
    if not every:
        kept = [k for j in family.pair.indices for k in robot.input_tendons[j]]
        bare = replace(robot, tendons=tuple(robot.tendons[k] for k in kept))
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
        per_tendon=per_tendon,
        tendons=present,
        bending=bending,
        shift=shift(with_them.tip_position),
        relative=relative,
        softer=softer,
        evened=shift(evened.tip_position),
    )


def _arrangement(name: str, robot: Robot, pair: Pair) -> Arrangement:
    wide = np.radians(max(VIEW_TOLERANCES_DEG))
    workspace = find_workspace(
        Model(robot), VIEW_ANGLES_RAD[:1], TENSION_STEP_N, PRETENSION_N, wide, [pair]
    )
    spans = []
    for tolerance in VIEW_TOLERANCES_DEG:
        span = 0.0  # [m] along x, of the postures near enough to the view
        for family in workspace.of(VIEW_ANGLES_RAD[0])[:1]:
            away = np.abs(np.abs(family.angle) - family.view)
            near = family.tips[away <= np.radians(tolerance), 0]
            span = float(np.ptp(near)) if len(near) else 0.0
        spans.append(span)
    middle = spans[VIEW_TOLERANCES_DEG.index(2.5)]
    return Arrangement(name, middle, min(spans), max(spans), workspace.largest)
