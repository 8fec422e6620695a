"""
Postures by wire pull and by tension, simulated.

Section IV.C: three tip heights at the 180° view. Section IV.D: one tendon and an antagonistic
pair, and what they can tell. Section IV.E: a bend of 90°.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError
from ..common.rotations import turned_in_plane
from ..comparison.compare import compare
from ..comparison.result import Comparison
from ..data import DataSet, default_markers
from ..diagnosis.diagnose import diagnose
from ..diagnosis.verdict import POSTURES_ENOUGH
from ..model.model import Model
from ..robot import Robot
from ..simulation.measurements import simulate
from ..simulation.plant import Plant, make_plant
from ..workspace.postures import default_postures
from ..workspace.view_angle import Pair, pairs_of
from .paper_motion import Assumed, Published, Range, at_view, pcca, with_arm, with_cells

HEIGHT_NAMES = ('maximum tip height', 'median tip height', 'minimum tip height')
HINGE_MODEL = 'FKM + hinge friction'


@dataclass(frozen=True)
class Heights:
    """Wire pulls for three tip heights at 180°, and how far FKM and PCCA are apart there."""

    pair: Pair
    arm: float  # [m]
    pulls: Floats  # (3, m) [m], NaN = no wire
    tips: Floats  # (3, 3) [m] by the FKM
    apart: Floats  # (3,) [m] between the tips of FKM and PCCA
    everywhere: tuple[float, float]  # [m] smallest and largest `apart` of all such postures


class DisplacementExperiment:
    """Section IV.C, simulated on a planar robot of two sections as its owner describes it."""

    def __init__(self, robot: Robot) -> None:
        pairs = {pair.kind: pair for pair in reversed(pairs_of(robot))}
        heights = find_heights(robot, pairs['opposite sides'])
        if heights is None:
            raise InputError(
                f'{robot.source}: no posture at the 180° view with wires on opposite sides; '
                'raise the tension limits'
            )
        self.heights = heights
        others = [
            find_heights(with_arm(robot, arm), pair)
            for pair, arm in product(pairs.values(), Assumed.MOMENT_ARMS_M)
        ]
        self.others = [one for one in others if one is not None]  # arrangements and arms
        plant = prototype(robot, 0)
        settled = plant.shapes(heights.pulls, displacement=True).tip_position
        # [m] largest tip shift that the hinge friction makes at these pulls
        self.hinge_shift = float(np.linalg.norm(settled - heights.tips, axis=1).max())
        self.data = trials(plant, heights)  # of one simulated prototype
        models = [('FKM', robot), ('PCCA', pcca(robot))]
        self.comparison = compare(self.data, models, leave_out=False)  # as published
        # by model, over many prototypes
        self.errors = many_prototypes(plant, heights, self.comparison)
        (mean, _), fkm = self.comparison.angle_bands(), self.comparison.models[0].angles
        assert fkm is not None
        # [rad] of the mean angles of the cells about the FKM
        self.scatter = float(np.sqrt(np.mean((mean - fkm) ** 2)))


def find_heights(robot: Robot, pair: Pair) -> Heights | None:
    """
    Find the postures with highest, median and lowest tip at 180° and the pulls of two wires.

    Among proximal tensions in steps of 0.1 N, all other wires taken out; both wires are taut in
    both models, and every cell bends towards the view: no S-shape. None where there is none.
    """
    fkm = Model(robot)
    distal = robot.tendons[robot.input_tendons[pair.indices[1]][0]]
    side = 1 if distal.base[0] > 0.0 else -1  # sign of the tip angle towards which it bends
    near = np.arange(Published.TENSION_STEP_N, robot.tension_limits[1], Published.TENSION_STEP_N)
    tensions = at_view(fkm, pair.indices, near, Published.VIEW_ANGLES_RAD[0], side)
    if not len(tensions):
        return None
    shapes = fkm.shapes(tensions)
    constant, needed = constant_curvature(robot, pair, shapes.pulls)
    good = (needed > 0.0).all(axis=1) & (side * shapes.bend[..., 0] > -1e-9).all(axis=1)
    good &= np.abs(shapes.pulls[:, pair.indices[0]]) > Assumed.CLEAR_PULL_M
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


def trials(plant: Plant, heights: Heights) -> DataSet:
    """Pull the wires by hand, photograph: 15, 15 and 20 trials, (3, 20, n, 3) [m]."""
    random, robot = np.random.default_rng(0), plant.robot
    # of this prototype, in all its trials
    play = Published.CELL_SCATTER_RAD * random.normal(size=robot.cells)
    positions = np.full((3, max(Published.TRIALS_PER_HEIGHT), robot.cells, 3), np.nan)
    for p, count in enumerate(Published.TRIALS_PER_HEIGHT):
        shapes = pulled_by_hand(plant, heights, p, random)
        own = play + Assumed.TRIAL_SCATTERS_RAD[1] * random.normal(size=(count, robot.cells))
        photos = turned(shapes, held(own, robot))
        photos[..., [0, 2]] += Assumed.PIXEL_M * random.normal(size=(*photos.shape[:2], 2))
        positions[p, :count] = photos
    return DataSet(
        name='section IV.C, simulated',
        robot=robot,
        markers=default_markers(robot),
        postures=HEIGHT_NAMES,
        inputs=heights.pulls,
        positions=positions,
        input='displacement',
    )


def pulled_by_hand(plant: Plant, heights: Heights, p: int, random: np.random.Generator) -> Floats:
    """Return the cells (t, n, 3) [m] of a posture in all its trials, pulled by the caliper."""
    shape = Published.TRIALS_PER_HEIGHT[p], len(plant.robot.inputs)
    pulls = heights.pulls[p] + Assumed.CALIPER_SD_M * random.normal(size=shape)
    return plant.shapes(pulls, displacement=True).positions


def many_prototypes(
    plant: Plant, heights: Heights, comparison: Comparison
) -> dict[str, tuple[Range, Range]]:
    """
    Return tip errors at the highest tip, by model, of prototypes that differ in their cells' play.

    Of each the mean over prototypes with the 5th and the 95th percentile among them [m]; then of
    its sd over the trials of a prototype the root mean square, the 5th percentile where cells do
    not change from trial to trial, and the 95th where they change as much as they scatter [m].
    """
    random, robot, spreads = np.random.default_rng(0), plant.robot, {}
    play = Published.CELL_SCATTER_RAD * random.normal(size=(Assumed.PROTOTYPES, 1, robot.cells))
    shapes = pulled_by_hand(plant, heights, 0, random)
    change = random.normal(size=(Assumed.PROTOTYPES, len(shapes), robot.cells))
    many = np.broadcast_to(shapes, (Assumed.PROTOTYPES, *shapes.shape))
    tips = [
        turned(many, held(play + size * change, robot))[:, :, -1]
        for size in Assumed.TRIAL_SCATTERS_RAD
    ]
    for model in comparison.models:
        errors = [np.linalg.norm(one - model.markers[0, -1], axis=2) for one in tips]
        means, sds = errors[1].mean(axis=1), [one.std(axis=1, ddof=1) for one in errors]
        low, high = np.percentile(means, [5.0, 95.0]).tolist()
        least, most = float(np.percentile(sds[0], 5)), float(np.percentile(sds[-1], 95))
        sd = float(np.sqrt((sds[1] ** 2).mean()))
        spreads[model.name] = (float(means.mean()), low, high), (sd, least, most)
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
    cells = np.diff(positions, axis=-2, prepend=0.0)  # (..., n, 3) [m] from end to end
    turns = np.cumsum(play, axis=-1)  # a cell turns with all that lie nearer to the base
    cells[..., [2, 0]] = turned_in_plane(cells[..., [2, 0]], turns)
    return np.cumsum(cells, axis=-2)


class TensionExperiment:
    """
    Section IV.D, simulated on a robot of one section with inputs left and right.

    Trials under tension against the models, and their diagnoses.
    """

    def __init__(self, robot: Robot) -> None:
        robot, lever = replace(robot, tolerances=Assumed.TOLERANCES), Assumed.HINGE_LEVER_M
        self.data = measured(robot, Published.POSTURES_N, 0)
        # FKM, PCCA, FKM + hinge friction; the two postures, as published
        self.comparison = compare(self.data, models_of(robot, lever), error='sem', leave_out=False)
        self.largest = {  # [m] error, by posture and model
            (posture, model.name): float(np.nanmax(model.distance[p]))
            for p, posture in enumerate(Published.POSTURES_N)
            for model in self.comparison.models
        }
        levers = [errors_of_lever(robot, factor * lever) for factor in Assumed.LEVER_FACTORS]
        self.low, self.high = (  # [m] the same, over levers
            {key: ends(one[key] for one in levers) for key in levers[0]} for ends in (min, max)
        )
        one, two = Model(pcca(robot)).shapes([*Published.POSTURES_N.values()]).tip_position
        self.same = float(np.linalg.norm(one - two))  # [m] between PCCA's tips
        self.alone = diagnose(self.data)  # of the two postures
        # with as many postures as it asks for, and where that ends with other noise
        further = default_postures(robot, POSTURES_ENOUGH - len(Published.POSTURES_N)).tolist()
        names = (f'further {i}' for i in range(1, 1 + len(further)))
        enough = Published.POSTURES_N | dict(zip(names, further, strict=True))
        self.enough, *self.redrawn = (
            diagnose(measured(robot, enough, seed)) for seed in range(1 + Assumed.NOISE_DRAWS)
        )


def measured(robot: Robot, postures: Mapping[str, tuple[float, ...]], seed: int) -> DataSet:
    """Simulate ten trials of postures [N] of the prototype that has friction in its hinges."""
    plant = prototype(robot, seed)
    data = simulate(
        plant,
        [*postures.values()],
        noise=Assumed.NOISE,
        trials=Published.TRIALS,
        seed=seed,
        postures=tuple(postures),
    )
    return replace(data, name='section IV.D, simulated', setting_noise=Assumed.SETTING_NOISE)


def prototype(robot: Robot, seed: int) -> Plant:
    """Return the simulated prototype, which has friction in its hinges."""
    hidden = {'hinge_friction': {'lever': Assumed.HINGE_LEVER_M}}
    return make_plant(robot, hidden, scatter=0.0, seed=seed)


def models_of(robot: Robot, lever: float) -> list[tuple[str, Robot]]:
    """Return the FKM, PCCA, and the FKM with friction in its hinges."""
    hinge = robot.with_effect('hinge_friction', {'lever': lever})
    return [('FKM', robot), ('PCCA', pcca(robot)), (HINGE_MODEL, hinge)]


def errors_of_lever(robot: Robot, lever: float) -> dict[tuple[str, str], float]:
    """Largest distance [m] of FKM and PCCA from the model with hinge friction, without noise."""
    inputs = list(Published.POSTURES_N.values())
    cells = {name: Model(one).shapes(inputs).positions for name, one in models_of(robot, lever)}
    real = cells.pop(HINGE_MODEL)
    return {
        (posture, name): float(np.linalg.norm(model[p] - real[p], axis=1).max())
        for name, model in cells.items()
        for p, posture in enumerate(Published.POSTURES_N)
    }


class Gap(NamedTuple):
    """Distances [m] between tips at 90°."""

    tension: float  # FKM to PCCA at equal tension
    pull: float  # FKM to PCCA at equal wire pull, which is equal tip angle
    hinge: float  # FKM to FKM with scaled hinge friction, at equal tension


class SmallExperiment:
    """Section IV.E: the models of a robot of one section with inputs left and right."""

    def __init__(self, robot: Robot) -> None:
        gaps = []
        for arm, cells, friction in product(
            Assumed.SMALL_ARMS_M, Assumed.CELL_COUNTS, Assumed.FRICTION_COEFFICIENTS
        ):
            one = with_cells(with_arm(robot, arm), cells)
            one = one.with_effect('tendon_friction', {'friction_coefficient': friction})
            gaps.append(gap(one)[0])
        self.robot, self.lever = robot, scaled_lever(robot)
        self.as_assumed, self.tension = gap(robot)  # [N] at which the FKM predicts 90°
        # over arms, cells and friction that the paper leaves open
        self.low, self.high = (Gap(*map(ends, zip(*gaps, strict=True))) for ends in (min, max))


def gap(robot: Robot) -> tuple[Gap, float]:
    """Return the distances between the models' tips, and the tension [N]."""
    fkm, constant = Model(robot), Model(pcca(robot))
    hinge = Model(robot.with_effect('hinge_friction', {'lever': scaled_lever(robot)}))
    (tensions,) = at_view(fkm, (0, 1), np.zeros(1), Published.BEND_ANGLE_RAD, 1)
    (equal,) = at_view(constant, (0, 1), np.zeros(1), Published.BEND_ANGLE_RAD, 1)
    tip = fkm.shape(tensions).tip_position
    others = constant.shape(tensions), constant.shape(equal), hinge.shape(tensions)
    distances = [float(np.linalg.norm(other.tip_position - tip)) for other in others]
    return Gap(*distances), float(tensions[1])


def scaled_lever(robot: Robot) -> float:
    """Scale the hinge friction of the 10:1 prototype with the arm [m]."""
    return Assumed.HINGE_LEVER_M * abs(robot.tendons[0].base[0]) / Published.MOMENT_ARM_M
