"""An emulated board behind the real driver node: it moves, and every fault of it is survived."""

import numpy as np
import pytest
from emulated_board import needs_compiler

pytest.importorskip('rclpy')
pytest.importorskip('serial')

import dynamixel_rig
from dynamixel_rig import ROBOT
from marks import slow
from ros_station import LOW, last, point, start, values

pytestmark = [pytest.mark.ros, needs_compiler]


class Rig(dynamixel_rig.Rig):
    """The same, with a board."""

    kind = 'serial'
    near = 0.15, 1e-3

    def tensions(self):
        return np.array(self.servos.ask('state')['tensions'])


running, rig = dynamixel_rig.running(Rig), dynamixel_rig.following


def test_the_node_says_that_tensions_come_from_load_cells(rig):
    said = values(last(rig.station.driver))
    assert said['tension_source'] == 'load_cell'
    assert said['silence_until_release (s)'] == '0.2'


# name -> break, mend, what the status says, to be reset by a person
FAULTS = {
    'unplugged': ('unplug', 'plug', 'the port is gone; plug the board in again', False),
    'overheating': ('overheating 1', 'cool 1', 'motor bridge too hot; torque is off', True),
    'silent board': ('silent', 'hear', 'no telemetry from the board', False),
    'broken frames': ('spoil 100000', 'spoil 0', 'no telemetry from the board', False),
    'truncated frames': ('cut 100000', 'cut 0', 'no telemetry from the board', False),
    'slow link': ('slow 0.15', 'slow 0', 'no telemetry from the board', False),
    'overload': ('overload 1 12', 'overload 1 0', 'tension far above its limit', True),
    'load cell': ('cell 1', 'mend 1', 'load cell saturated or not answering', True),
    'low voltage': ('voltage 1', 'cool 1', 'motor supply too low', True),
    'power lost': ('restart', 'hear', 'the board restarted', True),
}
QUICK = ('unplugged', 'overheating')


@pytest.mark.parametrize('name', [name if name in QUICK else slow(name) for name in FAULTS])
def test_a_fault_is_said_releases_the_arm_and_is_recovered_from(rig, name):
    broken, mended, words, latched = FAULTS[name]
    station = rig.station
    station.driver.clear()
    rig.servos.say(broken)
    station.until(
        lambda: any(s.level != b'\x00' and words in s.message for _, s in station.driver), words
    )
    station.until_code(station.driver, 'releasing', 'released', 'stopped')
    station.spin(0.3)
    rig.servos.say(mended)
    if latched:
        rig.operate()
    rig.until_following()


def test_a_killed_driver_leaves_a_board_that_lets_go_by_itself_and_a_new_one_goes_on(rig):
    rig.node.process.kill()
    rig.node.process.wait(10.0)
    rig.station.driver.clear()
    rig.station.until(lambda: rig.tensions().max() < 4 * LOW + 0.2, 'tensions near pretension')
    assert all(rig.servos.ask('state')['enabled'])
    rig.run()
    rig.until_following()


@pytest.mark.slow
def test_a_target_for_the_controller_moves_the_emulated_arm_there(running):
    if running.mode == 'pull':
        pytest.skip('shown in tension mode')
    running.sending = False
    station = running.station
    controller = start('controller', running.space, running.folder, model=ROBOT)
    try:
        station.until_code(station.controller, 'holding', 'released', timeout=120.0)
        message = point(-0.08, 0.17)
        station.send('controller/target_point', message)

        def there():
            station.spin(0.2)
            tip = running.servos.ask('state')['tip']
            return np.hypot(tip[0] + 0.08, tip[2] - 0.17) < 0.03

        station.until(there, 'the tip near its target', timeout=30.0)
    finally:
        controller.end()
