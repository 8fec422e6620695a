"""examples/go_to.py moves the mock arm."""

import os
import sys

import processes
import pytest

pytest.importorskip('rclpy')

from ros_station import Station, start
from source_tree import ROOT

pytestmark = pytest.mark.ros


def test_the_example_sends_the_tip_to_a_point(tmp_path):
    with start('driver', '/', tmp_path), start('controller', '/', tmp_path):
        station = Station('/')
        station.until_code(station.controller, 'holding', timeout=120.0)  # compiles when cold
        station.close()
        run = processes.run(
            [sys.executable, ROOT / 'examples' / 'go_to.py', '60', '170'],
            timeout=60,
            env=os.environ,
        )
    assert run.stdout == 'tip at (60.0, 0.0, 170.0) mm\n', run.stderr
