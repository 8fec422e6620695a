"""A model that takes long, by an effect whose law does: the controller hears and commands on."""

import signal

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_station import holding, point, stamp, values

from tendon_robot_ros.robot import dump_robot, load_robot

pytestmark = [pytest.mark.ros, pytest.mark.slow]
SPACE = '/slow_model'
SLOW = """
import math

from tendon_robot_ros.effects.effect import Effect, Parameter

def law(stiffness, tendons, turns):
    x = 0.5
    for _ in range(int(turns)):  # nothing makes this shorter
        x = math.cos(x)
    return stiffness * (1.0 + 1e-9 * x)

EFFECT = Effect('slow', 'stiffness', 'stiffness',
                (Parameter('turns', '1', 0.0, 1e7, 0.0, 1e3),), law)
"""
ANSWERED_S = 1.0  # [s] in which a signal is answered
TURNS = 10_000.0  # some 100 µs for every cell and evaluation: each search takes a second


def lets_go(station, since):
    """List the commands without tendons since then: the driver lets go."""
    return [m for _, m in station.commands if not m.name and stamp(m) > since]


def test_commands_stops_and_the_end_do_not_wait_for_the_model(tmp_path):
    path = tmp_path / 'slow.py'
    path.write_text(SLOW)
    robot = dump_robot(load_robot('kato_10_1').with_effect('slow', {'turns': TURNS}))
    slow = {'model': robot, 'effects': [str(path)]}
    with holding(SPACE, tmp_path, 400.0, controller=slow) as station:
        station.commands.clear()
        station.controller.clear()
        for x in np.linspace(0.05, 0.28, 6):  # the last ones are out of reach: a long search
            station.send('controller/target_point', point(x, 0.1))
            station.spin(0.5)
        assert 'searching' in {values(said)['code'] for _, said in station.controller}
        assert len(station.commands) > 10  # however busy the machine is
        station.send('controller/target_point', point(0.2, 0.2))
        station.until_code(station.controller, 'searching')
        assert station.trigger('controller/stop').success
        station.until_code(station.controller, 'stopped')
        assert station.trigger('controller/reset').success
        station.until_code(station.controller, 'holding')
        station.send('controller/target_point', point(0.2, 0.2))
        station.until_code(station.controller, 'searching')
        sent = station.now()
        station.controlling.process.send_signal(signal.SIGINT)
        station.until(lambda: lets_go(station, sent), 'the word that lets go')
        assert stamp(lets_go(station, sent)[0]) - sent < ANSWERED_S
        station.until(lambda: station.controlling.process.poll() is not None, 'its end')
        assert station.controlling.process.returncode == 0
