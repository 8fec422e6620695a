"""The numbers of Kato et al. 2015, its robots, their variants; range of motion (section IV.B)."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from ..common.arrays import Floats
from ..common.rotations import turned_in_plane
from ..model.model import Model
from ..robot import Robot
from ..simulation.measurements import SimulatedNoise
from ..workspace.view_angle import POSTURES_PER_SIDE, Family, Pair, Workspace, bisect

Range = tuple[float, float, float]  # a number, and the ends of what it may be


class Published:
    """What Kato et al. 2015 print in section IV, in SI units."""

    # section IV.A, scale: friction coefficient [1], number of measurements
    FRICTION: ClassVar[dict[str, tuple[float, int]]] = {'2:1': (0.31, 18), '10:1': (0.33, 30)}
    # section IV.B
    VIEW_ANGLES_RAD = (float(np.pi), float(np.pi / 4.0))  # figures 8 and 7
    TENSION_STEP_N = 0.1  # between tensions, here and where heights of IV.C are sought
    PRETENSION_N = 0.1
    # section IV.C
    TRIALS_PER_HEIGHT = (15, 15, 20)
    CELL_SCATTER_RAD = float(np.radians(2.0))  # of a cell's mean angle
    # section IV.D: left, right [N]; largest errors [m]
    POSTURES_N: ClassVar[dict[str, tuple[float, float]]] = {
        'single tendon': (0.0, 0.51),
        'antagonistic pair': (0.48, 0.99),
    }
    ERRORS_M: ClassVar[dict[tuple[str, str], float]] = {
        ('single tendon', 'FKM'): 5.1e-3,
        ('single tendon', 'PCCA'): 13.5e-3,
        ('antagonistic pair', 'FKM'): 10.1e-3,
        ('antagonistic pair', 'PCCA'): 35.7e-3,
    }
    TRIALS = 10  # of a posture
    # section IV.E
    BEND_ANGLE_RAD = float(np.pi / 2.0)
    MOMENT_ARM_M = 5.5e-3  # of the 10:1 prototype, to which the hinge lever belongs


class Assumed:
    """What the paper leaves open, in SI units: its tables I to IV are lost."""

    # section IV.A
    TANGENT_SD = 0.03  # of the tangent of one slip angle
    ANGLE_READING_DEG = 0.1  # of the rotational stage
    # section IV.B
    GROUP_SPREADS_DEG = (15.0, 30.0, 45.0, 60.0)  # of a group's outer wires from the middle one
    # by which 180° may be missed: on a grid of 0.1 N an exact 180° is hardly ever there
    VIEW_TOLERANCES_DEG = (1.0, 2.5, 5.0)
    # tendons that together have a fraction of a cell's stiffness: "smaller by at least one order"
    TENDONS, STIFFNESS_FRACTION = 6, 0.1
    # section IV.C
    MOMENT_ARMS_M = (5.0e-3, 5.5e-3, 6.0e-3)
    TRIAL_SCATTERS_RAD = (0.0, float(np.radians(1.0)), float(np.radians(2.0)))  # the middle one
    CALIPER_SD_M = 0.1e-3  # 1 sd of a wire pull that is set by hand
    CLEAR_PULL_M = 0.5e-3  # 5 sd: a proximal pull nearer to straight may end in an S-shape
    PIXEL_M = 0.09e-3
    PROTOTYPES = 200  # simulated, to know how far one of them may be off
    # section IV.D
    HINGE_LEVER_M = 0.40e-3  # of the 10:1 prototype, so that the errors of IV.D come out
    LEVER_FACTORS = (0.875, 0.9375, 1.0, 1.0625, 1.125)  # 0.35 to 0.45 mm: what is left open
    # 1 mm from trial to trial, as scattered cells make; weights behind pulleys, known to 5 % as
    # declared; what was set is exact here, so that the errors are those of the models
    NOISE = SimulatedNoise(position=1e-3, setting=0.0, trial=0.02)
    SETTING_NOISE = 0.05
    # 1 sd, declared
    TOLERANCES: ClassVar[dict[str, float]] = {
        'friction_coefficient': 0.1,
        'bending_stiffness': 0.05,
    }
    NOISE_DRAWS = 4  # repetitions with other noise: how much of the end is chance
    # section IV.E, of the 2:1 prototype, whose outer radius is 1.7 mm
    SMALL_ARMS_M = (1.0e-3, 1.15e-3, 1.3e-3, 1.45e-3, 1.6e-3)
    CELL_COUNTS = (15, 30, 60)  # around the 30 that are published of another prototype
    FRICTION_COEFFICIENTS = (0.28, 0.31, 0.34)  # 0.31 is published


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
    changed = replace(
        section,
        cells=cells,
        cell_length=section.cells * section.cell_length / cells,
        bending_stiffness=(section.bending_stiffness[0] * cells / section.cells,) * cells,
        mass_profile=(1.0,) * cells,
    )
    return replace(robot, sections=(changed,))


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
    # dense, so that the smallest of several solutions is not missed
    levels = np.linspace(0.0, model.robot.tension_limits[1], POSTURES_PER_SIDE)
    rows = np.zeros((len(near), len(levels), len(model.inputs)))
    rows[:, :, inputs[0]], rows[:, :, inputs[1]] = near[:, None], levels

    def gap_at(tensions: Floats) -> Floats:
        """Return the tip angle minus the view angle, (...) [rad]."""
        bend = model.solve(tensions.reshape(-1, len(model.inputs)))[0].bend
        turned = bend[:, :, 0].sum(axis=1).reshape(tensions.shape[:-1])
        return np.asarray(side * turned - view)

    gap = gap_at(rows)
    crossing = (gap[:, :-1] < 0.0) & (gap[:, 1:] >= 0.0)
    postures = np.flatnonzero(crossing.any(axis=1))
    at = crossing[postures].argmax(axis=1)
    return bisect(gap_at, rows[postures, at], rows[postures, at + 1])


class MotionExperiment:
    """Section IV.B: a robot of two sections with grouped tendons, swept."""

    def __init__(self, robot: Robot) -> None:
        view, step = Published.VIEW_ANGLES_RAD, Published.TENSION_STEP_N
        self.workspace = Workspace(Model(robot), view, step, Published.PRETENSION_N)
        family = self.workspace.of(view[0])[0]
        low, high = robot.tension_limits
        variants = {f'three wires at one place, {high:g} N each': robot}
        for angle in Assumed.GROUP_SPREADS_DEG:
            variants[f'three wires spread by ±{angle:g}°, {high:g} N each'] = spread(robot, angle)
        shared = replace(robot, tension_limits=(min(low, high / 3.0), high / 3.0))
        variants[f'three wires at one place, {high:g} N in all'] = shared
        # arrangement of the three wires of a group -> `across`
        self.arrangements = {name: across(one, family.pair) for name, one in variants.items()}
        self.stiffening = Stiffening(robot, family)  # by the tendons that are pulled
        self.every_tendon = Stiffening(robot, family, every=True)  # by all that run there


def spread(robot: Robot, degrees: float) -> Robot:
    """Return the robot with the wires of every group of three spread by an angle about z."""
    tendons = list(robot.tendons)
    for members in robot.input_tendons:
        for k, angle in zip(members, np.radians([-degrees, 0.0, degrees]), strict=True):
            x, y = turned_in_plane(np.array(tendons[k].base), angle).tolist()
            tendons[k] = replace(tendons[k], base=(x, y), end=(x, y))
    return replace(robot, tendons=tuple(tendons))


class Stiffening:
    """
    The tendons stiffen the robot; then the proximal backbone is softened.

    Six tendons make a tenth of a cell's stiffness. Counted are those that are pulled (six
    proximal, three distal), or every one that runs there.
    """

    def __init__(self, robot: Robot, family: Family, every: bool = False) -> None:
        pulled = list(family.pair.indices)
        bare, tensions = robot, family.tensions
        if not every:
            kept = [robot.tendons[k] for j in pulled for k in robot.input_tendons[j]]
            bare, tensions = replace(robot, tendons=tuple(kept)), tensions[:, pulled]
        cells = np.cumsum([section.cells for section in bare.sections])
        counts = (np.array(bare.tendon_cells)[:, None] >= cells).sum(axis=0)
        self.tendons: tuple[int, ...] = tuple(counts.tolist())  # in every section
        stiffness = bare.sections[0].bending_stiffness[0]
        self.per_tendon = Assumed.STIFFNESS_FRACTION * stiffness / Assumed.TENDONS  # [N·m/rad]
        proximal, distal = (counts[[0, -1]] * self.per_tendon / stiffness).tolist()
        self.softer = distal - proximal  # [1] of the proximal backbone: evens the sections out
        stiff = bare.with_effect('tendon_stiffness', {'per_tendon': self.per_tendon})
        even = stiff.with_effect('section_stiffness', {'relative_change': (self.softer, 0.0)})
        limp, with_them = Model(bare).shapes(tensions), Model(stiff).shapes(tensions)
        evened = Model(even).shapes((1.0 + distal) * tensions)

        def mean_distance(tips: Floats, others: Floats) -> float:
            return float(np.linalg.norm(tips - others, axis=1).mean())

        # [1] change of the bends of every section, rms over rms
        change, own = (
            [np.linalg.norm(part) for part in np.split(bend, cells[:-1], axis=1)]
            for bend in (with_them.bend - limp.bend, limp.bend)
        )
        self.bending = [float(new / old) for new, old in zip(change, own, strict=True)]
        straight = np.array([0.0, 0.0, bare.length])
        self.shift = mean_distance(with_them.tip_position, limp.tip_position)  # [m] of the tip
        self.relative = self.shift / mean_distance(limp.tip_position, straight)  # [1]
        # [m] of the tip with the softer backbone, at equally higher tensions
        self.evened = mean_distance(evened.tip_position, limp.tip_position)


def across(robot: Robot, pair: Pair) -> Range:
    """
    Return how far the tips at the 180° view are apart [m], 0 where it is not reached.

    The ends of the range are those over the tolerances of the view angle.
    """
    step, low = Published.TENSION_STEP_N, Published.PRETENSION_N
    wide = np.radians(max(Assumed.VIEW_TOLERANCES_DEG))
    workspace = Workspace(Model(robot), Published.VIEW_ANGLES_RAD[:1], step, low, wide, [pair])
    spans = []  # [m] along x, of the postures near enough to the view
    for tolerance in Assumed.VIEW_TOLERANCES_DEG:
        near = np.zeros(0)
        for family in workspace.of(Published.VIEW_ANGLES_RAD[0])[:1]:
            deviations = np.abs(np.abs(family.angle) - family.view)
            near = family.tips[deviations <= np.radians(tolerance), 0]
        spans.append(float(np.ptp(near)) if len(near) else 0.0)
    middle = spans[Assumed.VIEW_TOLERANCES_DEG.index(2.5)]
    return middle, min(spans), max(spans)
