"""Posture by wire pull (section IV.C): three tip heights at the 180° view, simulated trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.errors import InputError
from ..comparison.compare import compare
from ..comparison.result import Comparison
from ..data import DataSet, default_markers
from ..model.model import Model
from ..robot import Robot
from ..simulation.plant import Plant, make_plant
from ..workspace.grid import Pair, pairs_of
from .paper_motion import HINGE_LEVER_M, Floats, at_view, pcca, with_arm

VIEW_ANGLE_RAD = float(np.pi)
HEIGHT_NAMES = ('maximum tip height', 'median tip height', 'minimum tip height')
TRIALS_PER_HEIGHT = (15, 15, 20)  # as published
TENSION_STEP_N = 0.1  # [N] between the proximal tensions that are tried
MOMENT_ARMS_M = (5.0e-3, 5.5e-3, 6.0e-3)  # [m] the paper's is lost
CELL_SCATTER_RAD = float(np.radians(2.0))  # [rad] of a cell's mean angle: published
# [rad] assumed: the middle
TRIAL_SCATTERS_RAD = (0.0, float(np.radians(1.0)), float(np.radians(2.0)))
CALIPER_SD_M = 0.1e-3  # [m] 1 sd of a wire pull set by hand: assumed
CLEAR_PULL_M = 5.0 * CALIPER_SD_M  # [m] a proximal pull nearer to straight may end in an S-shape
PIXEL_M = 0.09e-3  # [m] a pixel
PROTOTYPES_SIMULATED = 200  # simulated, to know how far one of them may be off


@dataclass(frozen=True)
class Heights:
    """Wire pulls for three tip heights at 180°, and how far FKM and PCCA are apart there."""

    pair: Pair
    arm: float  # [m]
    tensions: Floats  # (3, m) [N] by the FKM
    pulls: Floats  # (3, m) [m], NaN = no wire
    tips: Floats  # (3, 3) [m] by the FKM
    apart: Floats  # (3,) [m] between the tips of FKM and PCCA
    everywhere: tuple[float, float]  # [m] smallest and largest `apart` of all such postures


@dataclass(frozen=True)
class Spread:
    """A tip error [m]: mean over prototypes, and the 5th and 95th percentile among them."""

    mean: float
    low: float
    high: float
    sd: float  # over the trials of a prototype, root mean square
    # its 5th percentile where cells do not change from trial to trial, and its 95th where they
    # change as much as they scatter
    sd_range: tuple[float, float]


@dataclass(frozen=True, eq=False)
class DisplacementExperiment:
    """Section IV.C."""

    heights: Heights  # opposite sides
    others: tuple[Heights, ...]  # other arrangements and arms
    data: DataSet  # of one simulated prototype
    comparison: Comparison
    lever: float  # [m]
    hinge_shift: float  # [m] largest tip shift that the hinge friction makes at these pulls
    errors: dict[tuple[str, str], Spread]  # height, model: over many prototypes
    scatter: float  # [rad] of the mean angles of the cells about the FKM, in the comparison


def displacement_experiment(
    robot: Robot, lever: float = HINGE_LEVER_M, seed: int = 0
) -> DisplacementExperiment:
    """
    Simulate section IV.C on a robot of two sections.

    Parameters
    ----------
    robot : Robot
        As its owner describes it (the FKM), planar.
    lever : float
        Hinge friction that the simulated prototype has [m].
    seed : int
        Of the prototype and its trials.

    """
    pairs = {pair.kind: pair for pair in reversed(pairs_of(robot))}
    heights = find_heights(robot, pairs['opposite sides'])
    if heights is None:
        raise InputError(
            f'{robot.source}: no posture at the 180° view with wires on opposite sides; '
            'raise the tension limits'
        )
    others = [
        find_heights(with_arm(robot, arm), pair)
        for pair in pairs.values()
        for arm in MOMENT_ARMS_M
    ]
    plant = make_plant(robot, {'hinge_friction': {'lever': lever}}, scatter=0.0, seed=seed)
    settled = plant.shapes(heights.pulls, displacement=True).tip_position
    data = trials(plant, heights, seed)
    models = [('FKM', robot), ('PCCA', pcca(robot))]
    comparison = compare(data, models, leave_out=False)  # as published
    bands, fkm = comparison.angle_bands(), comparison.models[0].angles
    assert bands is not None and fkm is not None
    return DisplacementExperiment(
        heights=heights,
        data=data,
        others=tuple(one for one in others if one is not None),
        comparison=comparison,
        lever=lever,
        hinge_shift=float(np.linalg.norm(settled - heights.tips, axis=1).max()),
        errors=many_prototypes(plant, heights, comparison),
        scatter=float(np.sqrt(np.mean((bands[0] - fkm) ** 2))),
    )


def find_heights(robot: Robot, pair: Pair) -> Heights | None:
    """
    Find the postures with highest, median and lowest tip at 180° and the pulls of two wires.

    Among proximal tensions in steps of 0.1 N, all other wires taken out; both wires are taut in
    both models, and every cell bends towards the view: no S-shape. None where there is none.
    """
    fkm = Model(robot)
    distal = robot.tendons[robot.input_tendons[pair.indices[1]][0]]
    side = 1 if distal.base[0] > 0.0 else -1  # sign of the tip angle towards which it bends
    near = np.arange(TENSION_STEP_N, robot.tension_limits[1], TENSION_STEP_N)
    tensions = at_view(fkm, pair.indices, near, VIEW_ANGLE_RAD, side)
    if not len(tensions):
        return None
    shapes = fkm.shapes(tensions)
    constant, needed = constant_curvature(robot, pair, shapes.pulls)
    good = (needed > 0.0).all(axis=1) & (side * shapes.bend[..., 0] > -1e-9).all(axis=1)
    good &= np.abs(shapes.pulls[:, pair.indices[0]]) > CLEAR_PULL_M
    if not good.any():
        return None
    kept = np.flatnonzero(good)
    kept = kept[np.argsort(-shapes.tip_position[kept, 2], kind='stable')]
    chosen = kept[[0, len(kept) // 2, -1]]
    apart = np.linalg.norm(shapes.tip_position - constant, axis=1)
    pulls = np.full((3, len(fkm.inputs)), np.nan)
    pulls[:, list(pair.indices)] = shapes.pulls[chosen][:, list(pair.indices)]
    return Heights(
        pair=pair,
        arm=abs(robot.tendons[0].base[0]),
        tensions=tensions[chosen],
        pulls=pulls,
        tips=shapes.tip_position[chosen],
        apart=apart[chosen],
        everywhere=(float(apart[kept].min()), float(apart[kept].max())),
    )


def constant_curvature(robot: Robot, pair: Pair, pulls: Floats) -> tuple[Floats, Floats]:
    """Return PCCA's tips (b, 3) [m] for the pulls (b, m) of two wires, and their tensions [N]."""
    model, two = Model(pcca(robot)), list(pair.indices)
    per_newton = model.solve(np.eye(len(model.inputs)))[0].pulls[np.ix_(two, two)]
    needed = np.zeros_like(pulls)
    needed[:, two] = np.linalg.solve(per_newton.T, pulls[:, two].T).T
    return model.solve(needed)[0].tip_position, needed[:, two]


def trials(plant: Plant, heights: Heights, seed: int) -> DataSet:
    """Pull the wires by hand, photograph: 15, 15 and 20 trials, (3, 20, n, 3) [m]."""
    random, robot = np.random.default_rng(seed), plant.robot
    # of this prototype, in all its trials
    play = CELL_SCATTER_RAD * random.normal(size=robot.cells)
    positions = np.full((3, max(TRIALS_PER_HEIGHT), robot.cells, 3), np.nan)
    for p, count in enumerate(TRIALS_PER_HEIGHT):
        pulls = heights.pulls[p] + CALIPER_SD_M * random.normal(size=(count, len(robot.inputs)))
        shapes = plant.shapes(pulls, displacement=True).positions
        own = play + TRIAL_SCATTERS_RAD[1] * random.normal(size=(count, robot.cells))
        seen = turned(shapes, held(own, robot))
        seen[..., [0, 2]] += PIXEL_M * random.normal(size=(*seen.shape[:2], 2))
        positions[p, :count] = seen
    return DataSet(
        name='section IV.C, simulated',
        robot=robot,
        markers=default_markers(robot),
        postures=HEIGHT_NAMES,
        inputs=heights.pulls,
        positions=positions,
        input='displacement',
    )


def many_prototypes(
    plant: Plant, heights: Heights, comparison: Comparison
) -> dict[tuple[str, str], Spread]:
    """Tip errors of the models over many prototypes that differ in the play of their cells."""
    random, robot = np.random.default_rng(0), plant.robot
    spreads: dict[tuple[str, str], Spread] = {}
    play = CELL_SCATTER_RAD * random.normal(size=(PROTOTYPES_SIMULATED, 1, robot.cells))
    for p, count in enumerate(TRIALS_PER_HEIGHT):
        pulls = heights.pulls[p] + CALIPER_SD_M * random.normal(size=(count, len(robot.inputs)))
        shapes = plant.shapes(pulls, displacement=True).positions
        change = random.normal(size=(PROTOTYPES_SIMULATED, count, robot.cells))
        tips = [
            turned(
                np.broadcast_to(shapes, (PROTOTYPES_SIMULATED, *shapes.shape)), held(own, robot)
            )[:, :, -1]
            for own in (play + size * change for size in TRIAL_SCATTERS_RAD)
        ]
        for model in comparison.models:
            tip = model.markers[p, -1]
            errors = [np.linalg.norm(one - tip, axis=2) for one in tips]
            means, sds = errors[1].mean(axis=1), [one.std(axis=1, ddof=1) for one in errors]
            low, high = np.percentile(means, [5.0, 95.0]).tolist()
            spreads[HEIGHT_NAMES[p], model.name] = Spread(
                mean=float(means.mean()),
                low=low,
                high=high,
                sd=float(np.sqrt((sds[1] ** 2).mean())),
                sd_range=(float(np.percentile(sds[0], 5)), float(np.percentile(sds[-1], 95))),
            )
    return spreads


def held(play: Floats, robot: Robot) -> Floats:
    """Take the mean of every section off the play (..., n) [rad]: taut wires hold the sum."""
    parts = np.split(play, np.cumsum([s.cells for s in robot.sections])[:-1], axis=-1)
    return np.concatenate([part - part.mean(axis=-1, keepdims=True) for part in parts], axis=-1)


def turned(positions: Floats, play: Floats) -> Floats:
    """
    Turn every cell about its proximal end, with all that lies beyond it.

    Parameters
    ----------
    positions : (..., n, 3) [m]
        Ends of the cells.
    play : (..., n) [rad]
        Turns in the x-z plane, towards +x.

    """
    moved = np.array(positions, dtype=float)
    joints = np.concatenate([np.zeros_like(moved[..., :1, :]), moved[..., :-1, :]], axis=-2)
    for i in reversed(range(moved.shape[-2])):  # what lies nearer to the base is still in place
        away = moved[..., i:, :] - joints[..., i : i + 1, :]
        c, s = np.cos(play[..., i, None]), np.sin(play[..., i, None])
        moved[..., i:, 0] = joints[..., i, None, 0] + c * away[..., 0] + s * away[..., 2]
        moved[..., i:, 2] = joints[..., i, None, 2] - s * away[..., 0] + c * away[..., 2]
    return moved
