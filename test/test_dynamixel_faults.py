"""Every fault of bus and servos, at the driver: what it says, what the motors get, recovery."""

import time

import emulated
import numpy as np
import pytest
from emulated import (
    arm_in,
    arrive,
    goals,
    healthy,
    settled,
    steps_are_small,
    until,
    watchdogs_trip,
)
from hypothesis import given
from hypothesis import strategies as st

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers.dynamixel.config import read_config
from tendon_robot_ros.drivers.dynamixel.motor import (
    CARRIED_MARGIN,
    CARRIED_MARGIN_COUNTS,
    make_motors,
)
from tendon_robot_ros.drivers.hardware import READINGS_MIN
from tendon_robot_ros.drivers.safety import STOP_TIME_MIN_S
from tendon_robot_ros.drivers.serial_port import HICCUPS_MAX

pytest.importorskip('dynamixel_sdk')


@pytest.fixture(params=['tension', 'pull'])
def arm(request):
    """Give a driver that follows a command, its emulated line and the command."""
    yield from arm_in(request.param)


@pytest.fixture(params=['tension', 'pull'])
def watched_arm(request):
    """Give the same with watchdogs that trip soon."""
    yield from arm_in(request.param, watchdog=0.2)


@pytest.fixture
def tense_arm():
    """Give the same in tension mode only: for faults that do not care about the mode."""
    yield from arm_in('tension')


def test_a_silent_servo_is_named_the_others_go_on_and_it_comes_back(arm):
    driver, line, command = arm
    line.silent.add(2)
    reading = until(driver, command, lambda r: r.faults)
    (fault,) = reading.faults
    assert (fault.code, fault.hardware, fault.inputs) == ('silent', False, ('north',))
    advice = 'check its cable and the motor supply'
    assert fault.message == f'{line.port}: north (id 2): no answer; {advice}'
    assert np.isnan(reading.pulls[1])
    assert np.isfinite(reading.pulls[[0, 2, 3]]).all()
    line.silent.clear()
    until(driver, command, healthy)
    assert steps_are_small(line, driver, 0.0)


def test_a_stop_does_not_wait_for_a_slow_bus(tense_arm):
    """A cycle that is spent on reading is time that has passed all the same."""
    driver, _, command = tense_arm
    for _ in range(20):
        driver.write(command)
        time.sleep(0.02)  # as if the answers took so long
        driver.read()
        low = np.maximum(driver._goal - 5.0 * 0.01 / STOP_TIME_MIN_S, 0.2)  # of a limit of 5 N
        driver.write(np.full(4, 0.2))
        assert (driver._goal <= low + 1e-9).all()
        until(driver, command, healthy)


@pytest.mark.parametrize(
    ('begin', 'end', 'least'),
    [
        ('silent 1 2 3 4', 'hear 1 2 3 4', 4),
        ('spoil 200', 'spoil 0', 1),
        ('slow 0.08', 'slow 0', 1),
    ],
)
def test_a_bus_without_good_answers_is_no_lost_port_and_comes_back(tense_arm, begin, end, least):
    driver, line, command = tense_arm
    line.obey(begin)
    said = [
        fault.code for fault in until(driver, command, lambda r: len(r.faults) >= least).faults
    ]
    assert said.count('silent') >= least
    assert 'port' not in said
    line.obey(end)
    until(driver, command, healthy)


@pytest.mark.parametrize('what', ['spoilt', 'cut', 'doubled'])
def test_a_few_broken_answers_are_asked_again_and_change_nothing(tense_arm, what):
    driver, line, command = tense_arm
    before = settled(driver, command)
    for _ in range(5):
        setattr(line, what, 1)
        reading = emulated.cycle(driver, command, 0.03)[-1]
        assert not reading.faults
        np.testing.assert_allclose(reading.pulls, before.pulls, atol=1e-3)
    assert (driver.link.failures['no or broken answer'] > 0) == (what != 'doubled')


def test_a_pulled_plug_is_said_and_a_new_one_goes_on_from_where_the_arm_is(watched_arm):
    driver, line, command = watched_arm
    pulled = time.monotonic()
    line.unplug()
    reading = until(driver, command, lambda r: r.faults)
    assert emulated.codes(reading) == {'port'}
    assert reading.faults[0].message == f'{line.port}: the port is gone; plug the adapter in again'
    assert np.isnan(reading.pulls).all()
    emulated.cycle(driver, command, 0.1)
    watchdogs_trip(line)
    line.plug()
    arrive(driver, command, 0.05)
    assert steps_are_small(line, driver, pulled)


def test_a_quick_replug_is_noticed_without_a_trip(tense_arm):
    driver, line, command = tense_arm
    line.unplug()
    line.plug()
    until(driver, command, healthy)


@pytest.mark.parametrize(
    ('bit', 'code'),
    [
        (0x20, 'overload'),
        (0x04, 'overheating'),
        (0x01, 'voltage'),
        (0x08, 'encoder'),
        (0x10, 'shock'),
    ],
)
def test_a_hardware_error_takes_the_torque_of_that_motor_only_until_a_reboot(tense_arm, bit, code):
    driver, line, command = tense_arm
    line.servo(3).fail(bit)
    reading = until(driver, command, lambda r: r.faults)
    (fault,) = reading.faults
    assert (fault.code, fault.hardware, fault.inputs) == (code, True, ('west',))
    assert 'torque is off; remove the cause, then reboot it' in fault.message
    until(driver, command, lambda r: not line.servo(3).torque)
    assert [line.servo(i).torque for i in (1, 2, 4)] == [True] * 3
    with pytest.raises(DriverError, match=r'west \(id 3\): .*reboot'):
        driver.enable()
    driver.reboot(['west'])
    assert not line.servo(3).torque
    until(driver, command, lambda r: r.faults == ())  # a busy machine may have been silent
    assert not line.servo(3).torque
    driver.enable()
    until(driver, command, healthy)
    assert line.servo(3).torque


def test_a_motor_that_gets_too_hot_is_released_before_it_shuts_down(tense_arm):
    driver, line, command = tense_arm
    line.servo(1).temperature = 66.0
    reading = until(driver, command, lambda r: r.faults)
    assert reading.faults[0].code == 'temperature'
    assert not reading.faults[0].hardware
    assert line.servo(1).torque
    line.servo(1).temperature = 40.0
    until(driver, command, healthy)


def test_a_low_supply_is_an_error_of_every_motor(tense_arm):
    driver, line, command = tense_arm
    for servo in line.rig.servos.values():
        servo.voltage = 2.9
    reading = until(driver, command, lambda r: {'voltage', 'supply'} <= emulated.codes(r))
    assert {name for fault in reading.faults for name in fault.inputs} == set(driver.inputs)


def test_a_tripped_watchdog_is_said_once_and_goes_on_from_where_the_arm_is(watched_arm):
    driver, line, command = watched_arm
    watchdogs_trip(line)  # this process is busy elsewhere
    reading = until(driver, command, lambda r: r.faults)
    assert emulated.codes(reading) == {'watchdog'}
    assert not any(fault.hardware for fault in reading.faults)
    until(driver, command, healthy)
    assert not any(servo.tripped for servo in line.rig.servos.values())
    assert steps_are_small(line, driver, 0.0)


def test_a_motor_that_lost_its_power_stays_off_until_it_is_enabled_again(arm):
    driver, line, command = arm
    line.rig.rebooted(4)  # somebody used the switch in the motor supply
    reading = until(driver, command, lambda r: r.faults)
    (fault,) = reading.faults
    assert (fault.code, fault.hardware, fault.inputs) == ('restarted', True, ('south',))
    assert np.isnan(reading.pulls[3])
    emulated.cycle(driver, command, 0.2)
    assert not line.servo(4).torque
    driver.disable(['south'])
    until(driver, command, lambda r: r.faults == ())  # a busy machine may have been silent
    assert not line.servo(4).torque
    driver.enable()
    until(driver, command, healthy)


def test_nothing_was_ever_commanded_beyond_the_limits(arm):
    driver, line, command = arm
    emulated.cycle(driver, 100.0 * command, 0.6)
    for motor in driver.motors.values():
        low, high = motor.current_bounds if driver.mode == 'tension' else motor.position_bounds
        name = 'goal_current' if driver.mode == 'tension' else 'goal_position'
        sent = goals(line, name, 0.0)[motor.identity]
        assert sent
        assert low <= min(sent)
        assert max(sent) <= high
        assert line.servo(motor.identity).get('current_limit') == motor.strongest


def test_in_pull_mode_no_wire_pulls_more_than_its_limit_however_the_arm_pulls_back():
    """A motor holds its current and its friction: together they are the limit."""
    with (
        emulated.line(slack=0.0) as line,
        emulated.driver_for(line, 'pull', zero='here') as driver,
    ):
        driver.enable()
        command = np.array([0.03, 0.0, 0.0, 0.0])  # 12 N of the spring
        limit, band = 5.0, driver.config.motors[0].resolution.band
        winds = (limit - 2.0 * band) / emulated.STIFFNESS  # [m]
        emulated.until(driver, command, lambda r: r.pulls[0] > winds - 1e-4)
        line.rig.arm.slack[0] = -0.01  # the arm pulls out what it can
        held = limit / emulated.STIFFNESS - 0.01  # [m]
        emulated.until(driver, command, lambda r: r.pulls[0] < held + 2e-4)
        assert limit - 0.1 < line.rig.held[0] <= limit


@pytest.fixture
def pulled_arm():
    """Give the same in pull mode only."""
    yield from arm_in('pull')


@pytest.mark.long
def test_a_motor_of_reduced_current_lets_the_arm_have_its_wire_and_is_strong_again(
    pulled_arm, monkeypatch
):
    driver, line, command = pulled_arm
    command = 2.0 * command
    settled(driver, command)
    held, motor = driver.read().tensions, driver.motors[1]
    driver.limit_current(1.0, 0.5)
    settled(driver, command)
    counts = round(motor.wires[0].calibration.mean.current(0.5) / motor.model.current_unit)
    assert [line.servo(i).get('goal_current') for i in (1, 2, 3, 4)] == [counts] * 4
    assert driver.read().tensions.max() < 0.6 < held.max()
    lost, send = iter(range(HICCUPS_MAX)), driver.link.send_goals

    def send_but_for_a_hiccup(name, *goals):
        if name != 'goal_current' or next(lost, None) is None:
            send(name, *goals)

    monkeypatch.setattr(driver.link, 'send_goals', send_but_for_a_hiccup)
    driver.limit_current(0.0, 0.5)
    time.sleep(0.2)  # a computer that stands still; the motors stayed weak after that
    settled(driver, command)
    assert line.servo(1).get('goal_current') == motor.strongest
    np.testing.assert_allclose(driver.read().tensions, held, atol=0.1)


@pytest.mark.long
def test_a_motor_limits_current_from_what_it_carries_and_no_goal_rises(pulled_arm):
    driver, line, command = pulled_arm
    settled(driver, command)
    began, shares = time.monotonic(), np.linspace(0.05, 1.0, 20)
    carried = {i: abs(line.servo(i).get('present_current')) for i in (1, 2)}
    for share in shares:
        driver.limit_current(share, 0.5)
        driver.write(command)
        driver.read()
    for i, sent in goals(line, 'goal_current', began).items():
        assert len(sent) == len(shares)
        assert np.all(np.diff(sent) <= 0)
        assert sent[-1] == driver.motors[i].reduced_limit
        if i in carried:  # the other two wires are slack
            assert sent[0] < carried[i] * (1.0 + CARRIED_MARGIN) + CARRIED_MARGIN_COUNTS
            assert sent[0] < driver.motors[i].strongest
            assert sent[len(sent) // 2] < carried[i]  # it bites long before the end
        else:
            assert set(sent) == {sent[-1]}
    driver.enable()
    assert [motor.reduced_limit for motor in driver.motors.values()] == [None] * 4


@given(
    lately=st.lists(st.integers(-400, 400), max_size=8),
    shares=st.lists(st.floats(0.0, 1.0, exclude_min=True), min_size=1, max_size=20),
    least=st.floats(0.0, 1.0),
)
def test_whatever_a_motor_carried_it_never_holds_more_than_that_while_it_limits_current(
    lately, shares, least
):
    plain = read_config(emulated.robot(), emulated.config('/dev/none'), 'pull', 'arm.yaml')
    motor = make_motors(plain, 'pull')[1]
    for current in lately:
        motor.take(current.to_bytes(2, 'little', signed=True) + bytes(8))
    held = max(map(abs, lately[-READINGS_MIN:]), default=motor.strongest)
    end = round(motor.wires[0].calibration.mean.current(least) / motor.model.current_unit)
    most = (1.0 + CARRIED_MARGIN) * held + CARRIED_MARGIN_COUNTS + 1
    before = motor.strongest
    for share in [*sorted(shares), 1.0]:
        motor.limit_current(share, least)
        assert end <= motor.reduced_limit <= max(end, min(most, before))
        assert motor.current_bounds == (0, motor.reduced_limit)
        before = motor.reduced_limit
    assert before == end
    motor.limit_current(0.0, least)
    assert motor.current_bounds == (0, motor.strongest)


def test_a_position_mode_without_current_has_no_reduction():
    with emulated.line() as line:
        assert emulated.driver_for(line, 'pull').limits_current
        assert not emulated.driver_for(line, 'pull', pull_operation='extended').limits_current
        assert not emulated.driver_for(line, 'tension').limits_current
