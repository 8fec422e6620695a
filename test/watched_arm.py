"""An arm as it is watched: postures of it, and what a tracker sees of a plant in them."""

import numpy as np
from arms import coarse

from tendon_robot_ros.data import default_markers
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.monitoring.built_arm import BuiltArm
from tendon_robot_ros.monitoring.watch import DriftAlarm
from tendon_robot_ros.workspace.postures import default_postures

ROBOT = coarse('spatial_3')
NOISE = 2e-4


def postures(count, seed, robot=ROBOT):
    return np.clip(default_postures(robot, count, seed), *robot.tension_limits)


def untaught(robot, *more, noise=NOISE):
    """Return an arm as it is built that has learned nothing yet."""
    return BuiltArm(robot, load_catalogue(), default_markers(robot), noise, *more)


def tip_load(force):
    """Return a force (3,) [N] at the tip as an effect."""
    return {'tip_load': dict(zip(('force_x', 'force_y', 'force_z'), force.tolist(), strict=True))}


def exactly(plant, rows):
    """Return where the markers (n, J, 3) [m] of a plant are."""
    markers = default_markers(plant.robot)
    arcs, offsets = (np.array([getattr(m, k) for m in markers]) for k in ('arc_length', 'offset'))
    return plant.markers(rows, arcs, offsets)


def looked(plant, rows, seed):
    seen = exactly(plant, rows)
    return seen + np.random.default_rng(seed).normal(0.0, NOISE, seen.shape)


def alarm_of(arm, count=21600.0):
    """Return an alarm, false once in `count` postures, for an arm that learns nothing of it."""
    return DriftAlarm(arm.as_known(arm.mean, arm.covariance), count)


def alarms(alarm, read, seen):
    """Stand at postures; return whether there is an alarm after each."""
    postures = zip(read, seen, strict=True)
    return [alarm.update(tensions, positions, 30).alarm for tensions, positions in postures]


def averaged(plant, rows, random):
    read = rows * (1.0 + 0.001 * random.normal(size=rows.shape))
    seen = exactly(plant, rows)
    return read, seen + random.normal(0.0, NOISE / np.sqrt(30.0), seen.shape)
