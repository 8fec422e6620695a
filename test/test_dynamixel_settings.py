"""What other programs left in the motors, on the port and on the bus: set, refused, or named."""

import contextlib
import os
import sys
import threading
import time
from dataclasses import replace

import emulated
import emulated_board
import numpy as np
import processes
import pytest

from tendon_robot_ros.common.errors import DriverError, MovedError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel.control_table import GAINS, MODELS, REGISTERS

pytest.importorskip('dynamixel_sdk')

from tendon_robot_ros.drivers.dynamixel import motions
from tendon_robot_ros.drivers.dynamixel.bus import Bus
from tendon_robot_ros.drivers.dynamixel.servos import SETTINGS
from tendon_robot_ros.emulator.bus import status

# what another program may leave; nothing of it may steer the arm
LEFT = {
    'return_delay_time': 250,
    'secondary_id': 1,
    'operating_mode': 3,
    'pwm_limit': 60,
    'current_limit': 5,
    'startup_configuration': 3,
    'pwm_slope': 1,
    'bus_watchdog': 255,
    'goal_pwm': 50,
    'profile_acceleration': 1,
    'profile_velocity': 2,
}

# e-Manual, "Control Table of EEPROM Area" and "RAM Area": address, bytes, initial value
MANUAL = {
    'return_delay_time': (9, 1, 250),
    'drive_mode': (10, 1, 0),
    'operating_mode': (11, 1, 3),
    'secondary_id': (12, 1, 255),
    'homing_offset': (20, 4, 0),
    'pwm_limit': (36, 2, 885),
    'startup_configuration': (60, 1, 0),
    'pwm_slope': (62, 1, 140),
    'torque_enable': (64, 1, 0),
    'status_return_level': (68, 1, 2),
    'bus_watchdog': (98, 1, 0),
    'profile_acceleration': (108, 4, 0),
    'profile_velocity': (112, 4, 0),
}


def wanted(motor, mode):
    """Return what the registers must hold once the torque is on."""
    of_the_motor = {
        'operating_mode': mode,
        'current_limit': motor.strongest,
        'pwm_slope': motor.model.pwm_slope,
        'bus_watchdog': 100,
    }
    values = {s.name: of_the_motor.get(s.name, s.value) for s in SETTINGS}
    return {name: value for name, value in values.items() if value is not None}


@pytest.mark.parametrize('name', MANUAL)
def test_registers_are_where_the_manual_has_them(name):
    with emulated.line() as line:
        register = REGISTERS[name]
        found = register.address, register.size, line.servo(1).get(name)
    assert found == MANUAL[name]


def test_every_register_of_the_table_is_left_wrong_somewhere():
    refused = {setting.name for setting in SETTINGS if setting.refused}
    assert {setting.name for setting in SETTINGS} == set(LEFT) | refused


@pytest.mark.parametrize(
    ('model', 'mode'), [('XL330-M077', 'tension'), *((model, 'pull') for model in MODELS)]
)
def test_whatever_others_left_is_set_before_the_torque_comes_on(model, mode):
    plain = {'allow_coarse': True, 'zero': 'here', 'model': model}
    with emulated.line(model=model, slack=0.0) as line:
        own = [line.servo(1).get(name) for name in GAINS]
        for servo in line.rig.servos.values():
            for name, value in {**LEFT, **dict.fromkeys(GAINS, 7)}.items():
                servo.put(name, value)
        with emulated.driver_for(line, mode, **plain) as driver:
            driver.enable()
            said = driver.describe()
            for identity, motor in driver.motors.items():
                servo = line.servo(identity)
                expected = wanted(motor, driver._operating)
                assert {name: servo.get(name) for name in expected} == expected
                assert [servo.get(name) for name in GAINS] == own
                assert servo.torque
                told = said[f'registers of {motor} that were set']
                assert 'startup configuration 3 to 0' in told
                assert 'profile velocity 2 to 0' in told


def test_an_old_firmware_has_no_startup_configuration():
    with emulated.line(firmware=44) as line, emulated.driver_for(line) as driver:
        line.servo(2).put('startup_configuration', 1)  # bytes without a meaning
        driver.enable()
        assert line.servo(2).get('startup_configuration') == 1


def test_a_register_that_does_not_keep_what_is_written_is_refused(monkeypatch):
    with emulated.line() as line, emulated.driver_for(line) as driver:
        servo, accept = line.servo(3), line.servo(3)._accept
        servo.put('profile_velocity', 3)
        monkeypatch.setattr(
            servo,
            '_accept',
            lambda name, value: None if name == 'profile_velocity' else accept(name, value),
        )
        monkeypatch.setattr(servo, '_mode_to_defaults', lambda: None)
        emulated.refused(line, driver, r'velocity \(address 112\): 0 was written, 3')


@pytest.mark.parametrize(
    ('mode', 'torque'), [('tension', 0), ('tension', 1), ('pull', 1), ('extended', 1)]
)
@pytest.mark.long
def test_a_motor_that_was_without_power_for_a_moment_does_not_wind_on(mode, torque):
    """Also one that comes back with its torque on: its turns are gone, its goals were old."""
    operation = {'pull_operation': 'extended'} if mode == 'extended' else {}
    plain = {**operation, 'zero': 'here', 'spool_radius': 0.004, 'pull_limits': [-0.01, 0.06]}
    with emulated.line(slack=0.0, stiffness=40.0, radius=0.004) as line:
        kind = 'pull' if operation else mode
        with emulated.driver_for(line, kind, allow_coarse=True, **plain) as driver:
            driver.enable()
            command = np.array([0.5, 0.2, 0.2, 0.2]) if mode == 'tension' else 0.02 * np.eye(4)[0]
            emulated.settled(driver, command)
            line.servo(1).put('startup_configuration', torque)
            before = line.rig.wound[0]
            line.rig.most[:] = line.rig.wound
            line.booting[1] = time.monotonic() + 0.1
            line.restart(1)
            emulated.until(driver, command, lambda r: 'restarted' in emulated.codes(r))
            emulated.cycle(driver, command, 0.1)
            assert not line.servo(1).torque
            assert line.rig.most[0] < before + 5e-4
            driver.disable(['east'])
            line.servo(1).put('profile_velocity', 2)
            driver.enable()
            assert line.servo(1).get('profile_velocity') == 0
            assert line.servo(1).get('startup_configuration') == 0


@pytest.mark.parametrize(
    ('register', 'value'), [('goal_pwm', 20), ('position_p_gain', 0), ('profile_velocity', 1)]
)
def test_a_motor_held_back_by_something_else_has_not_found_its_wire(register, value, monkeypatch):
    """Whoever writes a register while the slack is looked for makes no zero of it."""
    monkeypatch.setattr(motions, 'TURNING_TIMEOUT_S', 0.4)
    with emulated.stepped() as line, emulated.driver_for(line, 'pull') as driver:
        driver.cancelled = lambda: line.servo(1).put(register, value)
        words = r'east \(id 1\): (stands still with 0.0|does not turn)'
        emulated.refused(line, driver, words, MovedError)
        assert driver.motors[1].zero is None


HOLDER = (
    'import os, sys; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print(flush=True); input()'
)


@contextlib.contextmanager
def held(port):
    """Let another program, that locks nothing, have a port open."""
    command = [sys.executable, '-c', HOLDER, port]
    pipes = {'stdin': processes.PIPE, 'stdout': processes.PIPE}
    with processes.Process(command, **pipes) as holder:
        holder.stdout.readline()
        yield f'another process has the port (process {holder.pid}: '
        holder.stdin.close()


@pytest.mark.parametrize('kind', ['dynamixel', 'serial'])
def test_a_port_that_another_program_has_open_is_refused_with_its_name(kind):
    made = emulated.line() if kind == 'dynamixel' else emulated_board.board()
    with made as line, held(line.port) as who:
        maker = emulated.driver_for if kind == 'dynamixel' else emulated_board.driver_for
        with pytest.raises(DriverError) as told:
            maker(line).open()
        assert str(told.value).startswith(f'{line.port}: {who}')
        assert str(told.value).endswith('); stop it first')


class Chatter(threading.Thread):
    """Answers to questions of an adapter elsewhere on the bus."""

    def __init__(self, line):
        super().__init__(daemon=True)
        self.line, self.ending = line, threading.Event()

    def run(self):
        answer = status(8, 0, bytes(4))
        while not self.ending.wait(0.02):
            with self.line._lock:
                os.write(self.line._master, answer)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.ending.set()
        self.join()


WRONG = {
    'another model': lambda line: setattr(line.servo(1), 'model', MODELS['XC330-T288']),
    'nobody there': lambda line: line.silent.update({1, 2, 3, 4}),
    'no reads': lambda line: line.servo(2).put('status_return_level', 0),
    'a setting': lambda line: line.servo(2).put('homing_offset', 3),
}


@pytest.mark.parametrize('what', WRONG)
def test_a_bus_with_a_second_talker_says_so_instead_of_blaming_models_ids_or_cables(what):
    with emulated.line() as line, Chatter(line):
        WRONG[what](line)
        driver = emulated.driver_for(line, answer_time=0.004)
        with pytest.raises(DriverError) as told:
            driver.open()
        assert str(told.value) == (
            f'{line.port}: bytes come that nobody here has asked for: another program or adapter '
            'talks; one program at a time: stop it first'
        )


@pytest.mark.parametrize('chatter', [True, False])
def test_a_motor_that_falls_silent_beside_a_second_talker_is_not_blamed_on_its_cable(chatter):
    with emulated.line(slack=0.001) as line:
        driver, command = emulated.running(line)
        with Chatter(line) if chatter else contextlib.nullcontext():
            if chatter:
                emulated.until(driver, command, lambda r: driver.link.disturbed())
            line.silent.add(2)
            reading = emulated.until(driver, command, lambda r: r.faults)
        (said,) = {fault.message for fault in reading.faults if fault.code == 'silent'}
        assert ('nobody here has asked for' in said) == chatter
        assert ('cable' in said) != chatter
        driver.close()


def test_a_late_answer_is_no_second_talker():
    with emulated.line() as line:
        bus = Bus(line.port, 1_000_000, 0.01)
        bus.open()
        line.delay = 2.0 * bus.answer_time  # two answers, one after the other
        bus.ping(1)
        bus.read(1, 'led')
        assert bus.second_talker() == ''
        line.delay = 0.0
        assert bus.ping(1) is not None
        bus.close()


@pytest.mark.parametrize(
    ('label', 'ok'),
    [
        ('XM430-W350-T', True),
        ('xl330-m077', True),
        ('XM430-W210-R ', True),
        ('XL430-W250', False),
        ('2xc430-w250-t', False),
        ('XM540-W270', False),
    ],
)
def test_models_are_known_by_their_label_and_others_refused_with_what_else_there_is(label, ok):
    content = emulated.config('/dev/none', model=label, allow_coarse=True)
    if ok:
        driver = make_driver('dynamixel', emulated.robot(), content)
        assert driver.motors[1].model.name in label.upper()
        return
    with pytest.raises(DriverError) as told:
        make_driver('dynamixel', emulated.robot(), content)
    assert 'model: expected one of XM430-W210, ' in str(told.value)
    assert ('backend: ros2_control' in str(told.value)) == ('430-W2' in label.upper())


@pytest.mark.parametrize('number', [1060, 1070, 1080, 1090, 1160])
def test_motors_without_current_control_are_refused_with_what_else_there_is(number):
    with emulated.line() as line:
        line.servo(2).put('model_number', number)
        line.servo(2).model = replace(line.servo(2).model, number=number)
        with pytest.raises(DriverError, match='pull mode through backend: ros2_control') as told:
            emulated.driver_for(line).open()
        assert 'found 2: ' in str(told.value)
