"""An effect of the user's own, loaded while the arm is held: compiled elsewhere."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_station import OWN_EFFECT, holding, last, stamp, values

from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.shared.robot_client import Pilot
from tendon_robot_ros.ros.shared.runtime import Ending

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_an_effect_of_the_users_own_is_loaded_while_the_arm_is_held(tmp_path, monkeypatch):
    path = tmp_path / 'own.py'
    path.write_text(OWN_EFFECT)
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'cache'))  # everything is cold
    with holding('/reload', tmp_path, 300.0) as station:
        station.go_to_point(0.06, 0.17)
        assert station.set('controller', 'effects', [str(path)]).successful
        station.commands.clear()
        station.driver.clear()
        before, held = len(station.states), max(last(station.states).effort)
        robot = load_robot('kato_10_1').with_effect('own', {'change': 0.2})
        assert station.set('controller', 'model', dump_robot(robot)).successful
        station.until(lambda: 'own' in values(last(station.controller))['model'], 'it', 300.0)
        station.until_code(station.controller, 'reached')
        station.spin(0.5)
        pilot = Pilot('pilot', Ending(), namespace='/reload')
        assert pilot.model().acts('own')  # the controller's own effects, too
        pilot.destroy_node()
    # linking the machine code holds Python for about 0.1 s in one piece: a release may just begin
    assert {values(said)['code'] for _, said in station.driver} <= {'following', 'releasing'}
    assert np.diff([stamp(message) for _, message in station.commands]).max() < 0.2  # [s]
    assert min(max(message.effort) for _, message in station.states[before:]) > 0.5 * held
