"""
Every fault of motors and bus through the real driver node in a process of its own.

Commands come at 100 Hz from here; the servos are emulated in a third process. For each fault: what
the motors get, what status and diagnostics say, how it recovers.
"""

import signal
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('dynamixel_sdk')

import dynamixel_rig
from dynamixel_rig import PULL, ROBOT, TENSION, steps
from marks import slow
from ros_station import LOW, Station, last, point, stamp, start, values

from tendon_robot_ros.drivers.safety import CYCLE_MAX_S

pytestmark = pytest.mark.ros
WATCHDOG_TRIPPED = 255
RELEASE_RATE = {'tension': 10.0, 'pull': 0.02}  # [N/s], [m/s], as the driver's parameters have it


running, rig = dynamixel_rig.running(dynamixel_rig.Rig), dynamixel_rig.following


# name -> break, mend (None: reboot and reset), what the status says, torque goes off for id 2
FAULTS = {
    'silent servo': ('silent 2', 'hear 2', 'no answer; check its cable', False),
    'broken answers': ('spoil 100000', 'spoil 0', 'no answer; check its cable', False),
    'truncated answers': ('cut 100000', 'cut 0', 'no answer; check its cable', False),
    'slow bus': ('slow 0.15', 'slow 0', 'no answer; check its cable', False),
    'unplugged': ('unplug', 'plug', 'the port is gone; plug the adapter in again', False),
    'watchdog tripped': ('trip 2', '', 'its bus watchdog stopped it', False),
    'overload': ('overload 2', None, 'load above the maximum output', True),
    'overheating': ('overheating 2', None, 'motor too hot; torque is off', True),
    'hot': ('hot 2 67', 'hot 2 30', '67 °C, released from 65 °C', False),
    'low voltage': ('volts 2.9', 'volts 5', 'input voltage outside its limits', True),
    'power lost': ('restart 2', None, 'it lost its power', True),
}
LATCHED_BY_MOTOR = ('volts 2.9',)
# to the node the same as a silent servo; of the driver: test_dynamixel_faults.py
AGAIN = 'broken answers', 'truncated answers', 'slow bus'


def test_the_log_says_at_the_start_what_friction_leaves_of_the_tension_limit(rig):
    def logs():
        return ''.join(file.read_text() for file in rig.folder.glob('driver_*.log'))

    rig.station.until(lambda: 'which is assumed: calibrate' in logs(), 'what motors wind and hold')
    winds, holds = {'tension': ('4.06', '5.93'), 'pull': ('3.13', '5')}[rig.mode]
    assert (
        f'motors wind up to {winds} N (prox_left) and hold up to {holds} N (prox_left, ' in logs()
    )
    assert 'which is assumed: calibrate prox_left, prox_right' in logs()


def assert_holds(rig, words):
    """Check that no wire gets tighter: the commands of before go on, and the cause is gone."""

    def well():
        said = last(rig.station.driver)
        return values(said)['code'] in ('released', 'holding') and not values(said)['faults']

    rig.station.until(well, 'an arm that holds')
    rig.station.spin(0.2)  # the motors are where they are told to be
    start = rig.measured()
    moved = rig.station.now() + 0.5
    rig.station.until(lambda: stamp(last(rig.station.states)) > moved, 'half a second')
    assert np.all(rig.measured() <= start + rig.near[rig.mode == 'pull'])
    assert well()
    assert words in values(last(rig.station.driver))['released']


@pytest.mark.parametrize('name', [slow(name) if name in AGAIN else name for name in FAULTS])
def test_a_fault_is_said_releases_the_arm_and_is_recovered_from(rig, name):
    broken, mended, words, off = FAULTS[name]
    station = rig.station
    station.driver.clear()
    rig.diagnostics.clear()
    began = time.monotonic()
    rig.servos.say(broken)

    def told(statuses):
        return any(s.level != b'\x00' and words in s.message for s in statuses)

    station.until(lambda: told(status for _, status in station.driver), words)
    seen = time.monotonic()
    station.until(
        lambda: told(status for _, array in rig.diagnostics for status in array.status),
        'the same in /diagnostics',
    )
    station.until_code(station.driver, 'releasing', 'released', 'stopped')
    if off:
        station.until(lambda: not rig.servo(2)['torque_enable'], 'torque off for the motor')
    station.spin(0.3)
    if mended:
        rig.servos.say(mended)
    if mended is None or broken in LATCHED_BY_MOTOR:
        rig.operate()
    else:
        assert_holds(rig, words)
    back = time.monotonic()
    rig.until_following()
    print(
        f'{rig.mode}, {name}: said after {1e3 * (seen - began):.0f} ms, follows again after '
        f'{time.monotonic() - back:.2f} s'
    )


def test_a_port_that_goes_while_the_arm_is_stopped_is_told_in_the_log_too(rig):
    station = rig.station
    station.trigger('driver/stop')
    station.until_code(station.driver, 'stopped')

    def told():
        logs = [file.read_text(encoding='utf-8') for file in rig.folder.glob('driver_*.log')]
        return any(
            'stopped: ' in line and 'the port is gone' in line
            for text in logs
            for line in text.splitlines()
        )

    rig.servos.say('unplug')
    try:
        station.until(told, 'a line in the log')
    finally:  # what comes next needs the port
        rig.servos.say('plug')
    rig.operate()
    rig.until_following()


def test_a_second_driver_is_refused_the_port_and_says_who_has_it(rig):
    other = Station(f'{rig.space}/other')
    config = str(rig.servos.config)
    given = {'robot': ROBOT, 'backend': 'dynamixel', 'config': config, 'command_mode': rig.mode}
    with start('driver', other.namespace, rig.folder, **given):
        other.until_code(other.driver, 'not_ready')
        assert (
            f'another process has the port (process {rig.node.process.pid}'
            in last(other.driver).message
        )
    other.close()
    rig.until_following()


def test_silence_of_the_commands_lets_the_motors_go_slowly(rig):
    rig.sending = False
    stopped = time.monotonic()

    def let_go():
        said = last(rig.station.driver)
        return values(said)['code'] == 'released' and 'no command' in said.message

    rig.station.until(let_go, 'the end of the release')
    goals = rig.goals(stopped)
    assert steps(goals) <= rig.counts(RELEASE_RATE[rig.mode] * CYCLE_MAX_S) + 1  # a ramp, no jump
    way = rig.counts(rig.command[0] - (LOW if rig.mode == 'tension' else 0.0))
    assert max(goals[1]) - goals[1][-1] > 0.9 * way  # all of it was seen
    rest, near = (LOW, 0.05) if rig.mode == 'tension' else (0.0, 5e-4)
    rig.station.until(lambda: np.allclose(rig.measured(), rest, atol=near), 'rest')
    assert all(servo['torque_enable'] for servo in rig.servos.ask('state')['servos'].values())


def test_a_killed_controller_lets_the_motors_go_slowly(rig):
    station = rig.station
    rig.sending = False
    station.controller.clear()
    known = {'model': ROBOT, 'command_mode': rig.mode}
    with start('controller', rig.space, rig.folder, **known) as controller:
        station.until_code(station.controller, 'holding', 'released', timeout=120.0)
        station.send_until(
            'controller/target_point',
            point(0.08, 0.15),
            lambda: np.abs(rig.measured()).max() > (0.5 if rig.mode == 'tension' else 2e-3),
            'a bent arm',
        )
        controller.process.send_signal(signal.SIGKILL)
        killed = time.monotonic()
    station.until_code(station.driver, 'releasing', 'released')
    said = time.monotonic() - killed

    def let_go():  # in pull mode the arm takes its wire from motors as weak as that
        tensions = np.array(last(station.states).effort)
        if rig.mode == 'pull':
            tensions = np.maximum(tensions, LOW)
        return np.allclose(tensions, LOW, atol=0.05)

    station.until(let_go, 'the pretension')
    print(
        f'{rig.mode}, killed controller: said after {1e3 * said:.0f} ms, let go after '
        f'{time.monotonic() - killed:.2f} s'
    )


def test_nothing_beyond_the_limits_was_ever_sent(rig):
    rig.command = [100.0] * 4 if rig.mode == 'tension' else [1.0] * 4
    rig.station.spin(1.0)
    rig.command = TENSION if rig.mode == 'tension' else PULL
    state = rig.servos.ask('state')
    content = rig.servos.content()
    for key, (low, high) in state['extremes'].items():
        identity, register = key.split()
        if register == 'goal_current':
            assert low >= 0
            assert high <= state['servos'][identity]['current_limit']
        if register == 'goal_position':
            travel = (content['pull_limits'][1] + 0.06) / (2 * np.pi * content['spool_radius'])
            assert max(abs(low), abs(high)) < 4096 * (travel + 1)


def test_a_killed_driver_leaves_the_motors_to_their_watchdog_and_a_new_one_goes_on(rig):
    driver = rig.node
    driver.process.send_signal(signal.SIGKILL)

    def tripped():
        servos = rig.servos.ask('state')['servos'].values()
        return all(servo['bus_watchdog'] == WATCHDOG_TRIPPED for servo in servos)

    def stopped():
        before = rig.servos.ask('state')['servos']
        time.sleep(0.2)
        after = rig.servos.ask('state')['servos']
        assert all(servo['torque_enable'] == 1 for servo in before.values())
        if rig.mode == 'tension':
            return all(servo['present_current'] == 0 for servo in before.values())
        place = 'present_position'
        return all(servo[place] == after[i][place] for i, servo in before.items())

    rig.station.until(tripped, 'the watchdogs')
    rig.station.until(stopped, 'the manual: it stops, and keeps the torque on')
    rig.station.driver.clear()
    rig.run()
    rig.until_following()


def test_a_stopped_driver_ends_with_the_motors_at_rest(rig):
    told = time.monotonic()
    rig.node.process.send_signal(signal.SIGTERM)
    rig.station.until(lambda: rig.node.process.poll() is not None, 'the end')
    assert rig.node.process.returncode == 0
    assert steps(rig.goals(told)) < 300
    rig.station.driver.clear()
    rig.run()
    rig.until_following()
