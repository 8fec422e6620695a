"""Boards with load cells, emulated with the real firmware, for the tests of the serial driver."""

from functools import partial

import emulated
import numpy as np
import pytest

from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.emulator.board import BoardRig, EmulatedBoard, compiler
from tendon_robot_ros.emulator.rig import SpringArm

needs_compiler = pytest.mark.skipif(
    compiler() is None, reason='no C compiler: the emulated board is skipped'
)


class Line(emulated.OwnTime, EmulatedBoard):
    """An emulated board."""


def board(slack=0.001, stiffness=emulated.STIFFNESS):
    """Make a board with four motors that wind four springs."""
    return Line(BoardRig(SpringArm(np.full(4, stiffness), np.full(4, slack)), 4))


def config(line, /, **changes):
    plain = {
        'port': line.port,
        'pull_limits': [-0.01, 0.03],
        'tension_gain': 0.015,
        'tension_rate': 20.0,
        'pull_rate': 0.08,
        'command_timeout': 2.0,  # [s]; the machine that tests is busy
    }
    return line.rig.config(emulated.robot().inputs) | plain | changes


def driver_for(line, mode='tension', **changes):
    return make_driver(
        'serial', emulated.robot(), config(line, **changes), mode=mode, source='board.yaml'
    )


running = partial(emulated.running, maker=driver_for, seconds=0.6)
