"""Boards with load cells, emulated with the real firmware, for the tests of the serial driver."""

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
    cells = {
        name: {
            'zero': cell.zero,
            'newtons_per_count': cell.newtons_per_count,
            'zero_error': 20.0,
            'slope_error': 1e-9,
            'scatter': 40.0,
        }
        for name, cell in zip(emulated.robot().inputs, line.rig.cells, strict=True)
    }
    plain = {
        'port': line.port,
        'spool_radius': line.rig.motor.spool.radius,
        'ticks_per_turn': line.rig.motor.spool.ticks_per_turn,
        'pull_limits': [-0.01, 0.03],
        'tension_rate': 20.0,
        'pull_rate': 0.08,
        'command_timeout': 2.0,  # [s]; the machine that tests is busy
        'calibration': cells,
        'tendons': {name: {'channel': i} for i, name in enumerate(emulated.robot().inputs)},
    }
    return {**plain, **changes}


def driver_for(line, mode='tension', **changes):
    return make_driver(
        'serial', emulated.robot(), config(line, **changes), mode=mode, source='board.yaml'
    )


def running(line, mode='tension', **changes):
    """Give a driver that follows a command, and the command."""
    driver = driver_for(line, mode, **changes)
    driver.open()
    driver.enable()
    command = emulated.TENSION if mode == 'tension' else emulated.PULL
    emulated.cycle(driver, command, 0.6)
    return driver, command
