"""Units, limits, refusals: what the Dynamixel driver makes of its configuration."""

import math
import re

import emulated
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel.config import (
    Calibration,
    CurrentLine,
    Resolution,
    from_data_sheet,
    read_config,
)
from tendon_robot_ros.drivers.dynamixel.control_table import (
    MODELS,
    REGISTERS,
    Counts,
    decode,
    encode,
)
from tendon_robot_ros.drivers.dynamixel.motor import make_motors
from tendon_robot_ros.drivers.hardware import Spool

pytest.importorskip('dynamixel_sdk')
from tendon_robot_ros.drivers.dynamixel.bus import UDEV_RULE, check_latency, without_header


def refusal(mode='tension', **changes):
    with pytest.raises(DriverError) as caught:
        make_driver(
            'dynamixel',
            emulated.robot(),
            emulated.config('/dev/ttyUSB9', **changes),
            mode=mode,
            source='arm.yaml',
        )
    return str(caught.value)


def parsed(mode='tension', **changes):
    return read_config(emulated.robot(), emulated.config('/dev/x', **changes), mode, 'arm.yaml')


def test_a_geared_xm430_on_a_10_mm_spool_has_half_a_newton_per_count_and_a_23_n_band():
    model = MODELS['XM430-W350']
    found = Resolution(from_data_sheet(model, 0.010), model, 5.0)
    assert found.newtons_per_count == pytest.approx(0.48, abs=0.005)
    assert found.band == pytest.approx(23.2, abs=0.1)
    assert found.coarse


def test_tension_by_a_coarse_current_is_refused_with_the_numbers():
    assert refusal(model='XM430-W350', spool_radius=0.010) == (
        'arm.yaml: motors.east: tension by current is too coarse: one count of current is '
        '0.48 N (10 counts up to 5 N), the friction band is ±23.2 N (463 % of the limit); '
        'wanted: at least 20 counts and at most 20 %; use command_mode: pull, a larger spool or a '
        'lighter motor, calibrate it, or set allow_coarse: true'
    )


@pytest.mark.parametrize('change', [{'allow_coarse': True}, {'mode': 'pull'}])
def test_a_coarse_current_is_taken_when_allowed_or_when_not_commanded(change):
    assert parsed(model='XM430-W350', spool_radius=0.010, **change).motors


@pytest.mark.parametrize('common', [None, {'wind': [0.9, 1.0], 'pay_out': [-0.9, 1.0]}])
def test_a_calibration_replaces_the_assumed_friction_and_that_of_the_motor_comes_first(common):
    fine = {'wind': [0.4, 1.0], 'pay_out': [-0.4, 1.0], 'scatter': 0.0}
    motors = emulated.config('')['motors']
    motors['east'] |= {'model': 'XM430-W350', 'calibration': fine}
    wire = parsed(motors=motors, calibration=common and {'east': common}).motors[0]
    assert wire.resolution.band == pytest.approx(0.4)
    assert wire.calibration.measured


@pytest.mark.parametrize('mode', ['tension', 'pull'])
@pytest.mark.parametrize('share', [None, 0.5, 0.2])
def test_what_friction_leaves_of_the_limit_is_told_and_a_calibration_narrows_it(mode, share):
    """A motor holds the limit in pull mode and a band more in tension mode, and winds 2 less."""
    model, radius = MODELS['XL330-M077'], 0.013
    changes = {'model': model.name, 'spool_radius': radius}
    slope, friction = radius / model.torque_per_ampere, model.friction_current * (share or 1.0)
    if share is not None:
        lines = {'wind': [friction, slope], 'pay_out': [-friction, slope]}
        changes['calibration'] = dict.fromkeys(emulated.config('')['motors'], lines)
    content = emulated.config('/dev/x', **changes)
    driver = make_driver('dynamixel', emulated.robot(), content, mode=mode)
    (wire,) = driver.motors[1].wires
    band, count = friction / slope, wire.resolution.newtons_per_count
    limit = wire.tension_limit
    most = limit + (band if mode == 'tension' else 0.0)
    winds, holds = driver.motors[1].strength(wire)
    assert most - count < holds <= most + 1e-9
    assert holds - winds == pytest.approx(2.0 * band)
    told = driver.strength()
    assert f'wind up to {winds:.3g} N (east)' in told
    assert f'hold up to {holds:.3g} N (east, tension_limit {limit:g} N)' in told
    assert ('which is assumed: calibrate east' in told) == (share is None)


def test_the_mean_line_converts_and_half_the_gap_is_the_uncertainty():
    lines = Calibration(
        CurrentLine(0.10, 0.05), CurrentLine(-0.06, 0.03), measured=True, scatter=0.003
    )
    assert lines.mean.current(2.0) == pytest.approx(0.02 + 0.04 * 2.0)
    assert lines.mean.tension(lines.mean.current(2.0)) == pytest.approx(2.0)
    half_gap = 0.5 * ((0.10 + 0.05 * 2.0) - (-0.06 + 0.03 * 2.0))
    assert lines.uncertainty(2.0) == pytest.approx(math.hypot(half_gap, 0.003) / 0.04)


def test_a_calibration_file_is_found_beside_the_configuration(tmp_path):
    (tmp_path / 'lines.yaml').write_text('west: {wind: [0.1, 0.02], pay_out: [-0.1, 0.02]}')
    content = emulated.config('/dev/x', calibration='lines.yaml', allow_coarse=True)
    config = read_config(emulated.robot(), content, 'tension', str(tmp_path / 'arm.yaml'))
    measured = [wire.name for wire in config.motors if wire.calibration.measured]
    assert measured == ['west']


@given(st.floats(1e-3, 0.1), st.sampled_from([1, -1]), st.floats(-0.1, 0.1))
def test_ticks_and_pull_undo_each_other(radius, direction, pull):
    spool = Spool(radius, direction, Counts.TICKS_PER_TURN)
    assert spool.pull(spool.ticks(pull)) == pytest.approx(pull, abs=1e-12)
    assert spool.pull(direction * Counts.TICKS_PER_TURN) == pytest.approx(2.0 * math.pi * radius)


@given(st.sampled_from(list(REGISTERS.values())), st.data())
def test_registers_keep_their_sign(register, data):
    bits = 8 * register.size
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if register.signed else (0, 2**bits - 1)
    value = data.draw(st.integers(low, high))
    assert decode(register, encode(register, value)) == value


def test_a_goal_that_looks_like_a_packet_header_moves_by_one_tick():
    assert without_header(-131073, -(10**6)) == -131074
    assert without_header(-131073, -131073) == -131072
    assert without_header(-131072, -(10**6)) == -131072


@given(st.floats(-1e6, 1e6), st.sampled_from(['tension', 'pull']))
def test_no_command_makes_a_goal_outside_the_bounds(command, mode):
    for motor in make_motors(parsed(mode=mode), mode).values():
        motor.ticks, motor.zero = 100, 100.0
        low, high = motor.current_bounds if mode == 'tension' else motor.position_bounds
        goal = min(max(motor.goal([command]), low), high)  # as it is sent
        if mode == 'tension':
            amperes = abs(goal) * motor.model.current_unit
            assert motor.wires[0].calibration.mean.tension(amperes) <= 5.0 + 1e-9
        else:
            pull = motor.wires[0].spool.pull(goal - motor.zero)
            assert -0.01 - 1e-9 <= pull <= 0.03 + 1e-9


def test_two_tendons_on_one_motor_share_it_in_antagonism():
    shared = make_motors(parsed(mode='pull', motors=emulated.SHARED), 'pull')
    assert list(shared) == [1, 2]
    motor = shared[1]
    motor.ticks, motor.zero = 0, 0.0
    turned = motor.wires[0].spool.ticks(0.004)
    assert motor.goal([0.004, -0.004]) == round(turned)
    assert motor.goal([0.004, 0.004]) == 0
    motor.ticks = round(turned)
    assert [motor.pull(wire) for wire in motor.wires] == pytest.approx([0.004, -0.004], abs=2e-5)
    assert np.isnan([motor.tension(wire) for wire in motor.wires]).all()


REFUSED = {
    'an unknown key': ({'spool': 1}, r'spool: expected one of port, .*, got .spool.'),
    'no port': ({'port': None}, r'port: expected the path of a serial port.*, got None'),
    'an odd baud rate': ({'baudrate': 12345}, r'baudrate: expected one of 9600, .*, got 12345'),
    'a radius in mm': (
        {'spool_radius': 10},
        r'spool_radius: .*0\.0005 to 0\.2 \[m\] \(is it in mm\?\), got 10',
    ),
    'another motor': ({'model': 'AX-12A'}, r'motors\.east\.model|model: expected one of XM430'),
    'a tendon too many': (
        {'motors': {**emulated.config('')['motors'], 'up': {'id': 9}}},
        r'motors\.up: expected one of east, north, west, south',
    ),
    'a tendon too few': (
        {'motors': {'east': {'id': 1}}},
        r'motors: expected a motor for every input.*none for north, west, south',
    ),
    'a direction of yes': (
        {'motors': {**emulated.config('')['motors'], 'east': {'id': 1, 'direction': True}}},
        r'motors\.east\.direction: expected 1 .* or -1, got True',
    ),
    'a slow watchdog': ({'watchdog': 3.0}, r'watchdog: .*0 to 2\.54 \[s\], got 3'),
    'words for flags': ({'allow_coarse': 'yes'}, r'allow_coarse: expected true or false'),
    'a missing calibration': (
        {'calibration': 'nowhere.yaml'},
        r'calibration: expected a readable YAML file',
    ),
    'a shared motor in tension mode': (
        {'motors': {name: {'id': 1 + i // 2} for i, name in enumerate(emulated.robot().inputs)}},
        'motor of its own for every input in tension mode',
    ),
    'no limits in pull mode': ({'mode': 'pull', 'pull_limits': None}, r'pull_limits: .*2 numbers'),
}


@pytest.mark.parametrize('what', REFUSED)
def test_it_refuses_with_file_key_expectation_and_value(what):
    changes, pattern = REFUSED[what]
    message = refusal(**changes)
    assert message.startswith('arm.yaml: ')
    assert re.search(pattern, message), message
    assert '\n' not in message


@pytest.mark.parametrize(
    ('mode', 'key', 'default'), [('tension', 'tension_rate', 3.0), ('pull', 'pull_rate', 0.01)]
)
def test_limits_and_rates_may_differ_from_tendon_to_tendon(mode, key, default):
    motors = emulated.config('')['motors']
    motors['north'] |= {key: 0.5 * default, 'tension_limit': 2.0, 'pull_limits': [0.0, 0.02]}
    content = emulated.config('/dev/x', motors=motors, allow_coarse=True, **{key: default})
    driver = make_driver('dynamixel', emulated.robot(), content, mode=mode)
    assert driver.rates.tolist() == [default, 0.5 * default, default, default]
    own, common = ([0.2, 2.0], [0.2, 5.0]) if mode == 'tension' else ([0.0, 0.02], [-0.01, 0.03])
    assert driver.limits.tolist() == [common, own, common, common]


def latency_file(tmp_path, value):
    folder = tmp_path / 'class' / 'tty' / 'ttyUSB7' / 'device'
    folder.mkdir(parents=True)
    (folder / 'latency_timer').write_text(f'{value}\n')
    return str(tmp_path)


def test_a_slow_latency_timer_is_refused_with_the_rule_that_fixes_it(tmp_path):
    sysfs = latency_file(tmp_path, 16)
    with pytest.raises(DriverError, match='expected at most 2 ms, got 16 ms') as caught:
        check_latency('/dev/ttyUSB7', False, sysfs)
    assert UDEV_RULE in str(caught.value)
    assert check_latency('/dev/ttyUSB7', True, sysfs) == 16


def test_a_fast_latency_timer_and_a_port_without_one_are_fine(tmp_path):
    assert check_latency('/dev/ttyUSB7', False, latency_file(tmp_path, 1)) == 1
    assert check_latency('/dev/ttyACM0', False, str(tmp_path)) is None
