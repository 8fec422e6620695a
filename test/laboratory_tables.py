"""Recordings of a simulated arm in a laboratory, as tables, that tests import."""

from dataclasses import replace
from functools import cache

import pytest

pytest.importorskip('pandas')

import pandas
from arms import COARSE

from tendon_robot_ros.data import Marker
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import (
    Laboratory,
    SimulatedNoise,
    raw_table,
)
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.tables import import_table
from tendon_robot_ros.workspace.postures import default_postures

ARM = replace(COARSE, gravity=(-9.81, 0.0, 0.0))  # quick to diagnose
PLACES = tuple(Marker(str(i), s) for i, s in enumerate((0.03, 0.06, 0.09, 0.12)))
EXACT = Workmanship().times(0.0)
QUIET = SimulatedNoise(position=0.0, setting=0.0, trial=0.0)
CALM = Laboratory(lost=0.0, slips=0, frame_noise=0.0, cell_noise=0.0, hold=1.6, rate=20.0)
NOISY = Laboratory(rate=25.0, hold=1.6)


def recorded(
    lab, hidden=None, noise=None, trials=1, count=4, robot=ARM, work=EXACT, places=PLACES
):
    """Return a recording as a frame of pandas."""
    plant = make_plant(robot, hidden or {}, seed=3, work=work)
    names, values = raw_table(
        plant,
        default_postures(robot, count),
        lab=replace(lab, trials=trials),
        noise=noise or QUIET,
        markers=places,
    )
    return pandas.DataFrame(values, columns=names)


@cache
def calm_recording():
    """Return one that holds the model's own values."""
    return recorded(CALM)


@cache
def noisy_recording():
    """Return one of three trials with noise and a load at the tip."""
    noise = SimulatedNoise(position=1e-4, setting=0.0, trial=0.002)
    return recorded(NOISY, {'tip_load': {'force_x': -0.05}}, noise, trials=3, count=6)


@cache
def calm_import():
    """Return the first one as imported."""
    return import_table(calm_recording(), ARM, {'up': 'y'})


@cache
def noisy_import():
    """Return the second one as imported."""
    return import_table(noisy_recording(), ARM, {'up': 'y'})
