"""The 2:1 prototype at a tip angle of 90° (section IV.E)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..model.model import Model
from ..robot import Robot
from .robots import HINGE_LEVER_M, at_view, pcca, with_arm, with_cells

BEND_ANGLE_RAD = float(np.pi / 2.0)
MOMENT_ARMS_M = (1.0e-3, 1.15e-3, 1.3e-3, 1.45e-3, 1.6e-3)  # [m] the outer radius is 1.7 mm
CELL_COUNTS = (15, 30, 60)
FRICTION_COEFFICIENTS = (0.28, 0.31, 0.34)
PUBLISHED_MOMENT_ARM_M = 5.5e-3  # [m] of the 10:1 prototype, to which the lever belongs


@dataclass(frozen=True)
class Gap:
    """Distances [m] between tips at 90°."""

    tension: float  # FKM to PCCA at equal tension
    pull: float  # FKM to PCCA at equal wire pull, which is equal tip angle
    hinge: float  # FKM to FKM with scaled hinge friction, at equal tension


@dataclass(frozen=True)
class SmallExperiment:
    """Section IV.E."""

    as_assumed: Gap
    low: Gap  # over arms, cells and friction that the paper leaves open
    high: Gap
    lever: float  # [m] of the hinges, scaled with the arm
    tension: float  # [N] at which the FKM predicts 90°


def small_experiment(robot: Robot) -> SmallExperiment:
    """Compare the models of a robot of one section with inputs left and right."""
    gaps = []
    for arm, cells, friction in product(MOMENT_ARMS_M, CELL_COUNTS, FRICTION_COEFFICIENTS):
        one = with_cells(with_arm(robot, arm), cells)
        gaps.append(gap(one.with_effect('tendon_friction', {'friction_coefficient': friction}))[0])
    fields = ('tension', 'pull', 'hinge')
    assumed, tension, lever = *gap(robot), _lever(robot)
    return SmallExperiment(
        assumed,
        Gap(*(min(getattr(one, name) for one in gaps) for name in fields)),
        Gap(*(max(getattr(one, name) for one in gaps) for name in fields)),
        lever,
        tension,
    )


def gap(robot: Robot) -> tuple[Gap, float]:
    """Return the distances between the models' tips, and the tension [N]."""
    fkm, constant = Model(robot), Model(pcca(robot))
    hinge = Model(robot.with_effect('hinge_friction', {'lever': _lever(robot)}))
    (tensions,) = at_view(fkm, (0, 1), np.zeros(1), BEND_ANGLE_RAD, 1)
    (equal,) = at_view(constant, (0, 1), np.zeros(1), BEND_ANGLE_RAD, 1)
    tip = fkm.shape(tensions).tip_position
    others = (
        constant.shape(tensions).tip_position,
        constant.shape(equal).tip_position,
        hinge.shape(tensions).tip_position,
    )
    distances = [float(np.linalg.norm(other - tip)) for other in others]
    return Gap(*distances), float(tensions[1])


def _lever(robot: Robot) -> float:
    """Scale the hinge friction of the 10:1 prototype with the arm [m]."""
    return HINGE_LEVER_M * abs(robot.tendons[0].base[0]) / PUBLISHED_MOMENT_ARM_M
