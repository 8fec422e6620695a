"""Starting: who is on the bus, settings that are refused, the search for slack."""

import itertools
import os
import threading
import time
import tty
from dataclasses import replace

import emulated
import numpy as np
import pytest
from emulated import driver_for, stepped

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import make_driver, serial_port
from tendon_robot_ros.drivers.dynamixel.control_table import FRICTION_CURRENT
from tendon_robot_ros.emulator.rig import SpringArm

pytest.importorskip('dynamixel_sdk')

from tendon_robot_ros.drivers.dynamixel import motions
from tendon_robot_ros.drivers.dynamixel import servos as module
from tendon_robot_ros.drivers.dynamixel.bus import Bus


def refused_open(driver):
    with pytest.raises(DriverError) as caught:
        driver.open()
    with pytest.raises(DriverError, match='not open'):
        driver.read()
    return str(caught.value)


EXPECTED = ', '.join(
    f'{i}: XL330-M077 ({name})' for i, name in enumerate(emulated.robot().inputs, start=1)
)
THREE = ', '.join(f'{i}: XL330-M077 firmware 48' for i in (1, 2, 3))


@pytest.mark.parametrize(
    ('there', 'baud', 'words'),
    [
        ({'ids': (1, 2, 3)}, 3, f'servos at 1000000 baud: expected {EXPECTED}; found {THREE}; '),
        ({}, 1, 'found none; at 57600 baud: 1: XL330-M077, 2: XL330-M077, '),
        ({'model': 'XC330-T288'}, 3, 'found 1: XC330-T288 firmware 48, '),
    ],
    ids=['one too few', 'another baud rate', 'another model'],
)
def test_servos_that_are_not_as_expected_are_listed_with_those_that_are_there(there, baud, words):
    with emulated.line(**there) as line:
        for servo in line.rig.servos.values():
            servo.put('baud_rate', baud)
        message = refused_open(driver_for(line))
        assert words in message
        assert message.endswith('; correct the models or ids') == ('model' in there)


def test_servos_that_are_as_expected_are_not_blamed_for_answers_that_come_late(monkeypatch):
    with emulated.line() as line:
        monkeypatch.setattr(Bus, 'ping', lambda bus, identity: None)
        message = refused_open(driver_for(line))
        assert 'all servos are there, but answers come late or broken; check' in message


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [
        ('drive_mode', 1, 'use direction: -1 for that'),
        ('drive_mode', 4, 'expected 0, got 4: bit 0 turns the motor round'),
        ('drive_mode', 8, 'torque on by goal update'),
        ('homing_offset', -7, 'homing offset (address 20): expected 0, got -7'),
        ('status_return_level', 1, 'level (address 68): expected 2, got 1: whether it took a'),
        ('status_return_level', 0, 'level (address 68): expected 2, got 0 as it seems: pings'),
    ],
)
def test_settings_under_which_it_would_not_be_safe_are_refused(name, value, words):
    with emulated.line() as line:
        line.servo(2).put(name, value)
        message = refused_open(driver_for(line))
        assert words in message
        assert 'north (id 2)' in message
        assert ' write ' in message


def test_a_port_that_is_not_there_is_said_with_those_that_are():
    driver = make_driver('dynamixel', emulated.robot(), emulated.config('/dev/ttyUSB99'))
    assert refused_open(driver).startswith(
        '/dev/ttyUSB99: no such port; is the adapter plugged in? found: '
    )


@pytest.mark.parametrize(('firmware', 'read'), [(44, 'sync read'), (48, 'fast sync read')])
def test_old_firmware_is_read_with_the_plain_sync_read(firmware, read):
    with emulated.line(firmware=firmware) as line, driver_for(line) as driver:
        assert driver.describe()['group read'] == read
        driver.enable()
        emulated.until(driver, np.full(4, 0.5), emulated.healthy)


def test_it_describes_resolution_calibration_and_servos():
    with emulated.line() as line, driver_for(line) as driver:
        said = driver.describe()
        assert said['east: tension_per_count (N)'] == '0.00731'
        winds, holds = (float(said[f'east: {key} (N)']) for key in ('winds_to', 'holds_to'))
        assert holds - winds == pytest.approx(2.0 * float(said['east: friction_band (N)']), 0.01)
        assert said['east: calibration'] == 'data sheet'
        assert said['east (id 1): model'] == 'XL330-M077'
        assert (said['east (id 1): firmware'], said['east (id 1): torque']) == ('48', 'off')


def test_what_is_written_arrives_and_a_port_that_takes_nothing_is_lost(monkeypatch):
    here, there = os.openpty()
    tty.setraw(there)
    os.set_blocking(there, False)
    data, came = os.urandom(50_000), bytearray()

    def drain():
        while len(came) < len(data):
            came.extend(os.read(here, 1000))

    reader = threading.Thread(target=drain)
    reader.start()
    with monkeypatch.context() as patient:  # the reader may wait for a processor
        patient.setattr(serial_port, 'ANSWER_TIMEOUT_S', 60.0)
        serial_port.write_all(there, data)
    reader.join()
    assert came == data
    with pytest.raises(TimeoutError, match='took nothing'):
        serial_port.write_all(there, data)
    os.close(here)
    os.close(there)


@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_torque_comes_on_without_a_jump(mode):
    with emulated.line(slack=0.0) as line, driver_for(line, mode, zero='here') as driver:
        before = driver.read().pulls
        driver.enable()
        time.sleep(0.05)
        np.testing.assert_allclose(driver.read().pulls, before, atol=2e-4)
        assert [servo.torque for servo in line.rig.servos.values()] == [True] * 4
        assert {servo.get('bus_watchdog') for servo in line.rig.servos.values()} == {100}


@pytest.mark.parametrize(
    ('realtime', 'given', 'counts', 'words'),
    [
        (True, {}, 4, '0.08 s (default in real time)'),
        (False, {}, 10, '0.2 s (default without real time; docs/safety.md tells how to get it)'),
        (True, {'watchdog': 0.3}, 15, '0.3 s (as configured)'),
        (False, {'watchdog': 0.05}, 3, '0.05 s (as configured)'),
        (True, {'watchdog': 0.0}, 0, 'off (as configured)'),
    ],
)
def test_the_watchdog_is_short_in_real_time_and_what_is_configured_always_counts(
    realtime, given, counts, words, monkeypatch
):
    monkeypatch.setattr(module, 'in_realtime', lambda: realtime)
    with emulated.line(slack=0.0) as line:
        config = emulated.config(line.port)
        del config['watchdog']
        made = make_driver('dynamixel', emulated.robot(), {**config, **given})
        with made as driver:
            assert driver.silence() == 'set when torque comes on'
            driver.enable()
            servos = line.rig.servos.values()
            assert {servo.get('bus_watchdog') for servo in servos} == {counts}
            assert driver.silence() == words
            seconds = driver.describe()['bus_watchdog (s)']
            assert words.startswith(f'{seconds} s (' if counts else 'off')
            assert (float(seconds) > 0.0) == bool(counts)


def test_slack_is_wound_up_and_the_pull_is_zero_where_the_wires_begin_to_pull():
    slack = np.array([0.001, 0.004, 0.0, 0.008])
    arm = SpringArm(np.full(4, emulated.STIFFNESS), slack)
    with stepped(arm=arm) as line, driver_for(line, 'pull') as driver:
        assert np.isnan(driver.read().pulls).all()
        driver.enable()
        wires = [motor.wires[0] for motor in driver.motors.values()]
        wound = np.array(
            [
                wire.spool.pull(motor.zero - start)
                for motor, wire, start in zip(
                    driver.motors.values(), wires, line.start_ticks, strict=True
                )
            ]
        )
        taut = slack + driver.config.home_tension / emulated.STIFFNESS
        np.testing.assert_allclose(wound, taut, atol=2e-4)
        np.testing.assert_allclose(driver.read().pulls, 0.0, atol=5e-4)
        assert (
            max(high for (_, name), (_, high) in line.extremes.items() if name == 'goal_current')
            <= driver.motors[1].strongest
        )


def test_a_motor_that_does_not_turn_is_refused_and_the_torque_is_off():
    with stepped() as line, driver_for(line, 'pull', home_tension=0.3) as driver:
        motion = line.servo(3).motion  # its gear does not move below 0.5 A
        motion.model = replace(motion.model, stall_current=0.5 / FRICTION_CURRENT)
        emulated.refused(line, driver, r'west \(id 3\): does not turn with 0\.1\d\d A')


def test_a_motor_that_winds_too_slowly_is_named(monkeypatch):
    monkeypatch.setattr(motions, 'TURNING_TIMEOUT_S', 0.25)
    arm = SpringArm(np.full(4, emulated.STIFFNESS), np.array([0.004, 0.004, 0.5, 0.004]))
    changes = {'home_speed': 0.1, 'home_travel': 0.1}
    with stepped(arm=arm) as line, driver_for(line, 'pull', **changes) as driver:
        driver.cancelled = lambda: line.servo(3).put('profile_velocity', 24)  # 11 mm/s
        emulated.refused(line, driver, r': west \(id 3\): looking for slack took too long')


def trip(line):
    """Trip the watchdogs, as a computer that is late does; return whether to cancel."""
    return any(servo.protect(1.0) for servo in line.rig.servos.values())


@pytest.mark.parametrize('cycle', [1, 12])
def test_a_computer_that_is_late_while_it_looks_for_slack_goes_on_from_where_the_motors_are(
    cycle, monkeypatch
):
    """The watchdogs stop the motors, paying out or winding: neither stuck nor stalled."""
    monkeypatch.setattr(motions, 'BACK_OFF_M', 0.008)
    with stepped(slack=0.004) as line, driver_for(line, 'pull') as driver:
        cycles = itertools.count()
        driver.cancelled = lambda: next(cycles) == cycle and trip(line)
        driver.enable()
        wound = [s.motion.ticks for s in line.rig.servos.values()]
        taut = 0.004 + driver.config.home_tension / emulated.STIFFNESS
        turns = np.abs(np.array(wound) - line.start_ticks)
        ticks = [motor.wires[0].spool.ticks(taut) for motor in driver.motors.values()]
        np.testing.assert_allclose(turns, np.abs(ticks), atol=30)


def test_a_computer_that_is_always_late_does_not_find_the_slack(monkeypatch):
    monkeypatch.setattr(motions, 'HICCUPS_MAX', 1)
    with stepped(slack=0.02) as line, driver_for(line, 'pull') as driver:
        driver.cancelled = lambda: trip(line)
        emulated.refused(line, driver, 'late again and again; torque is off')


def test_the_search_for_slack_can_be_cancelled():
    with emulated.line(slack=0.02) as line, driver_for(line, 'pull') as driver:
        end = time.monotonic() + 0.2
        driver.cancelled = lambda: time.monotonic() > end
        emulated.refused(line, driver, 'cancelled; torque is off')


def test_two_tendons_on_one_motor_have_their_zero_half_way_between_their_slack():
    with (
        emulated.antagonists(slack=0.003) as line,
        driver_for(line, 'pull', motors=emulated.SHARED) as driver,
    ):
        driver.enable()
        np.testing.assert_allclose(driver.read().pulls, 0.0, atol=1.1e-3)
        middle = [
            m.zero - s for m, s in zip(driver.motors.values(), line.start_ticks, strict=True)
        ]
        np.testing.assert_allclose(middle, 0.0, atol=20)
        wanted = [0.006, 0.0, -0.006, 0.0]
        emulated.until(driver, wanted, lambda r: np.allclose(r.pulls, wanted, atol=1e-4))
        assert line.rig.tensions[0] == pytest.approx(0.003 * emulated.STIFFNESS, rel=0.1)
