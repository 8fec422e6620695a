"""An arm as it is watched: postures of it, and what a tracker sees of a plant in them."""

import numpy as np
from arms import coarse

from tendon_robot_ros.data import default_markers
from tendon_robot_ros.monitoring.watch import DriftAlarm
from tendon_robot_ros.workspace.postures import default_postures

ROBOT = coarse('spatial_3')
NOISE = 2e-4


def postures(count, seed):
    return np.clip(default_postures(ROBOT, count, seed), *ROBOT.tension_limits)


def looked(plant, rows, seed):
    markers = default_markers(plant.robot)
    arcs, offsets = (np.array([getattr(m, k) for m in markers]) for k in ('arc_length', 'offset'))
    seen = plant.markers(rows, arcs, offsets)
    return seen + np.random.default_rng(seed).normal(0.0, NOISE, seen.shape)


def alarm_of(arm, count=21600.0):
    """Return an alarm, false once in `count` postures, for an arm that learns nothing of it."""
    return DriftAlarm(arm.as_known(arm.mean, arm.covariance), count)


def alarms(alarm, read, seen):
    """Stand at postures; return whether there is an alarm after each."""
    postures = zip(read, seen, strict=True)
    return [alarm.update(tensions, positions, 30).alarm for tensions, positions in postures]


def averaged(plant, rows, random):
    markers = default_markers(plant.robot)
    arcs, offsets = (np.array([getattr(m, k) for m in markers]) for k in ('arc_length', 'offset'))
    read = rows * (1.0 + 0.001 * random.normal(size=rows.shape))
    seen = plant.markers(rows, arcs, offsets)
    return read, seen + random.normal(0.0, NOISE / np.sqrt(30.0), seen.shape)
