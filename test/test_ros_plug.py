"""The paper's postures with emulated servos, and a plug pulled on the way, as the README shows."""

import os
import re
import sys

import numpy as np
import processes
import pytest
from scipy.optimize import least_squares
from source_tree import ROOT

from tendon_robot_ros.drivers.dynamixel.config import (
    Resolution,
    from_data_sheet,
    smallest_spool,
)
from tendon_robot_ros.drivers.dynamixel.control_table import MODELS
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

pytest.importorskip('rclpy')
pytest.importorskip('dynamixel_sdk')

pytestmark = [pytest.mark.ros, pytest.mark.slow]
FARTHEST = 7.0  # [mm] in pull mode
TOLD = 0.2  # [mm]: tip as printed
ROW = re.compile(r'\( *(-?[\d.]+), *(-?[\d.]+)\) +([\d.]+) mm +(.*?) +(?:reached|nearest)$', re.M)


def beyond_friction(model, tensions, tip):
    """
    Return how far a tip is from all that tensions within the friction of the gears allow [mm].

    Parameters
    ----------
    model : Model
    tensions : ndarray, shape (m,) [N]
        As the motors tell them from their currents.
    tip : ndarray, shape (2,) [mm]
        Along x and z.

    """
    motor, limit = MODELS['XL330-M077'], model.robot.tension_limits[1]
    known = Resolution(from_data_sheet(motor, smallest_spool(motor, limit)), motor, limit)
    band = known.band + known.newtons_per_count
    low, high = np.maximum(0.0, tensions - band), tensions + band

    def miss(inside):
        return 1e3 * model.shape(inside).tip_position[[0, 2]] - tip

    starts = np.clip([tensions, low, high], low + 1e-6, high - 1e-6)
    return min(
        np.linalg.norm(least_squares(miss, start, bounds=(low, high), diff_step=1e-3).fun)
        for start in starts
    )


@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_the_demo_with_servos_survives_a_pulled_plug(mode):
    run = processes.run(
        [sys.executable, 'examples/pull_the_plug.py', mode],
        cwd=ROOT,
        env={**os.environ, 'PYTHONPATH': str(ROOT), 'AMENT_PREFIX_PATH': sys.prefix},
    )
    assert run.returncode == 0, run.stdout + run.stderr
    rows = ROW.findall(run.stdout)
    assert len(rows) == 5
    model = Model(load_robot('kato_10_1'))
    for x, z, miss, values in rows:
        if mode == 'pull':
            assert float(miss) < FARTHEST
        else:  # currents leave the tensions of the wires open by the friction: nothing else may
            tensions = np.array(values.split()[-4:], dtype=float)
            assert beyond_friction(model, tensions, np.array([x, z], dtype=float)) < TOLD
    assert 'the port is gone; plug the adapter in again' in run.stdout
    assert 'the arm stays where it is until a target comes; it is sent anew' in run.stdout
    again = re.search(r'heard ([\d.]+) s later', run.stdout)
    assert float(again[1]) < 5.0
