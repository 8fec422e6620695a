"""The paper's postures with emulated servos, and a plug pulled on the way, as the README shows."""

import os
import re
import sys

import processes
import pytest
from source_tree import ROOT

pytest.importorskip('rclpy')
pytest.importorskip('dynamixel_sdk')

pytestmark = [pytest.mark.ros, pytest.mark.slow]
FARTHEST = 7.0  # [mm] in pull mode; in tension mode the gears' friction, 0.9 N, holds the arm


@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_the_demo_with_servos_survives_a_pulled_plug(mode):
    run = processes.run(
        [sys.executable, 'examples/pull_the_plug.py', mode],
        cwd=ROOT,
        env={**os.environ, 'PYTHONPATH': str(ROOT), 'AMENT_PREFIX_PATH': sys.prefix},
    )
    assert run.returncode == 0, run.stdout + run.stderr
    misses = [float(found) for found in re.findall(r'\) +([\d.]+) mm', run.stdout)]
    assert len(misses) == 5
    assert mode == 'tension' or max(misses) < FARTHEST
    assert 'the port is gone; plug the adapter in again' in run.stdout
    assert len(re.findall(r'(reached|nearest)$', run.stdout, re.MULTILINE)) == 5
    assert 'the arm stays where it is until a target comes; it is sent anew' in run.stdout
    again = re.search(r'heard ([\d.]+) s later', run.stdout)
    assert float(again[1]) < 5.0
