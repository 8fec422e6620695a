"""The commands emulate and calibrate, as a person runs them."""

import itertools
import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import emulated
import emulated_board
import numpy as np
import processes
import pytest
import yaml

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DriverError, InputError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel import motions
from tendon_robot_ros.drivers.dynamixel.config import CurrentPoint, fit_current, read_config
from tendon_robot_ros.emulator import board, bus
from tendon_robot_ros.emulator.rig import HangingWeights

pytest.importorskip('dynamixel_sdk')


@pytest.fixture
def robot_file(tmp_path):
    path = tmp_path / 'four.yaml'
    path.write_text(emulated.ROBOT)
    return str(path)


KINDS = ['dynamixel', pytest.param('serial', marks=emulated_board.needs_compiler)]


@pytest.mark.parametrize('kind', KINDS)
def test_emulate_prints_a_port_that_the_driver_opens_and_obeys_its_input(kind, robot_file):
    emulating = emulated.ForkedEmulator(robot_file, '--arm', 'springs', kind=kind)
    with emulating as emulator:
        content = emulator.content()
        assert content['port'] == emulator.port
        with make_driver(kind, emulated.robot(), content, source='servos.yaml') as driver:
            driver.enable()
            command = [1.5, 0.2, 0.2, 0.2]
            emulated.cycle(driver, command, 1.0)
            assert emulator.ask('state')['tensions'][0] > 0.4
            assert emulator.say('silent 2' if kind == 'dynamixel' else 'overheating 1') == 'ok'
            alone = [('north',)]  # a busy machine makes others late, too, for a moment
            emulated.until(driver, command, lambda r: [f.inputs for f in r.faults] == alone)
        emulator.say('quit')
        assert emulator.process.wait(60) == 0


def test_of_several_threads_each_gets_the_answer_to_its_own_question(robot_file):
    kinds = {'state': dict, 'trace 5': list, 'log 5': list}
    emulating = emulated.ForkedEmulator(robot_file, '--arm', 'springs')
    with ThreadPoolExecutor() as threads, emulating as emulator:

        def ask(question):
            return [(question, emulator.ask(question)) for _ in range(30)]

        found = threads.map(ask, [*kinds, *kinds], timeout=emulated.SOON)
        answers = [answer for part in found for answer in part]
    assert len(answers) == 180
    for question, answer in answers:
        assert isinstance(answer, kinds[question])
        if question == 'state':
            assert set(answer['servos']) == {'1', '2', '3', '4'}
        if question == 'trace 5':
            assert all(len(moment) == 4 and len(moment[1]) == 4 for moment in answer)


@pytest.mark.parametrize('named', [False, True])
def test_emulate_ends_on_a_signal_and_takes_its_port_away(tmp_path, robot_file, named):
    path = str(tmp_path / 'port')
    robot = 'kato_10_1' if named else robot_file
    with emulated.ForkedEmulator(robot, '--arm', 'springs', '--port', path) as emulator:
        assert emulator.port == path
        emulator.process.terminate()
        assert emulator.process.wait(60) == 0
    assert not (tmp_path / 'port').is_symlink()


# words of the help that need other values than one 0 or 1
NOTHING = dict.fromkeys(('spoil', 'cut', 'double', 'slow'), '0') | {'state': '', 'plug': ''}
SERVO_WORDS = {**NOTHING, 'unplug': '0.01', 'hot': '1 50', 'volts': '5', 'weight': '1 0.1'}
BOARD_WORDS = {**NOTHING, 'unplug': '0.01', 'overload': '1 0', 'weight': '1 0'}
EMULATED = {
    'dynamixel': (lambda: emulated.line(arm=HangingWeights(np.zeros(4))), bus, SERVO_WORDS),
    'serial': (emulated_board.board, board, BOARD_WORDS),
}


@pytest.mark.parametrize('kind', KINDS)
def test_every_word_of_the_emulators_help_is_known(kind):
    make, module, values = EMULATED[kind]
    rows = [row.split('  ')[0].replace('|', ',') for row in module.HELP.splitlines()[:-1]]
    listed = [part.split()[0] for row in rows for part in row.split(',')]
    assert len(listed) > 15
    with make() as line:
        for word in listed:
            assert line.obey(f'{word} {values.get(word, "1")}')


WRONG_WORDS = {
    'dynamixel': ('jump', 'silent 9', 'hot 1', 'slow fast', 'weight 1 0.1'),
    'serial': ('jump', 'cell 9', 'weight 1', 'slow fast'),
}


@pytest.mark.parametrize('kind', KINDS)
def test_a_wrong_word_for_the_emulator_is_refused(kind):
    with emulated.line() if kind == 'dynamixel' else emulated_board.board() as line:
        for text in WRONG_WORDS[kind]:
            with pytest.raises(InputError, match='type help'):
                line.obey(text)


def test_a_spool_without_a_radius_is_refused(capsys):
    assert main(['motors', 'emulate', 'dynamixel', '--robot', 'kato_10_1', '--spool', '0']) == 1
    assert 'argument --spool: expected a number above 0, got 0' in capsys.readouterr().err


MASSES = (0.5, 1.0, 2.0, 4.0)  # [kg]
FEW = (0.5, 1.0, 4.0)  # [kg] tell a line, too


@pytest.fixture
def scales(tmp_path, robot_file, monkeypatch):
    """Give calibrate, run for a tendon; Enter hangs the next weight on its motor."""
    arm = HangingWeights(np.zeros(4))
    large = {'model': 'XM430-W350', 'radius': 0.01}
    with emulated.stepped(**large, arm=arm) as line:
        config = tmp_path / 'servos.yaml'
        content = emulated.config(line.port, model='XM430-W350', spool_radius=0.01)
        config.write_text(yaml.safe_dump(content))

        def calibrate(tendon, masses=MASSES, **hung):
            pile = iter(hung.get('hung', masses))
            place = emulated.robot().inputs.index(tendon)
            monkeypatch.setattr('builtins.input', lambda _: arm.hang(place, next(pile)))
            call = f'motors calibrate dynamixel {config} --robot {robot_file} --tendon {tendon}'
            more = f'--out {tmp_path / "lines.yaml"} --travel 6 --speed 10'
            return main([*call.split(), '--weights', *map(str, masses), *more.split()])

        yield calibrate, line, config


@pytest.mark.parametrize('late', [0.0, 0.1])
def test_calibrate_finds_the_friction_and_the_torque_of_the_motor(
    late, scales, tmp_path, capsys, monkeypatch
):
    """Also on a computer that is late: a motor that waits for its next goal stands."""
    calibrate, line, _ = scales
    waits, sleep = itertools.cycle((0.0, 0.0, late)), line.sleep
    monkeypatch.setattr(line, 'sleep', lambda seconds: sleep(seconds + next(waits)))
    masses = FEW if late else MASSES
    assert calibrate('east', masses) == 0
    said = capsys.readouterr().out
    assert 'half the gap' in said
    found = yaml.safe_load((tmp_path / 'lines.yaml').read_text())['east']
    model = line.servo(1).model
    slope = 0.01 / model.torque_per_ampere
    drag = 0.01 * model.stall_torque / model.no_load_speed / model.torque_per_ampere  # at 1 rad/s
    friction = model.friction_current + drag
    np.testing.assert_allclose(found['wind'], [friction, slope], rtol=0.1)
    np.testing.assert_allclose(found['pay_out'], [-friction, slope], rtol=0.1)
    assert found['half_gap'] == pytest.approx(friction / slope, rel=0.1)
    assert len(found['tensions']) == len(masses)
    assert (tmp_path / 'lines_east.png').read_bytes().startswith(b'\x89PNG')
    assert not any(servo.torque for servo in line.rig.servos.values())


@pytest.mark.long
def test_calibrations_are_collected_in_one_file_that_the_driver_reads(scales, tmp_path):
    calibrate, _, config = scales
    assert calibrate('east', FEW) == 0
    assert calibrate('north', FEW) == 0  # which winds the other way round
    content = {**yaml.safe_load(config.read_text()), 'calibration': 'lines.yaml'}
    content['allow_coarse'] = True
    wires = read_config(emulated.robot(), content, 'tension', str(config)).motors
    assert [wire.calibration.measured for wire in wires] == [True, True, False, False]
    other = {**content, 'spool_radius': 0.02}
    with pytest.raises(DriverError, match=r'spool_radius: expected 0\.02 m: calibrate again'):
        read_config(emulated.robot(), other, 'tension', str(config))


def test_a_weight_that_is_too_heavy_is_refused_and_the_torque_is_off(scales, capsys):
    calibrate, line, _ = scales
    assert calibrate('east', hung=(40.0,) * 4) == 1
    assert 'does not follow; is the weight too heavy' in capsys.readouterr().err
    assert not line.servo(1).torque


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whoever_ends_a_calibration_the_torque_is_off(scales, monkeypatch, number):
    calibrate, line, _ = scales
    turn = motions.turn_to

    def interrupt(bus, motor, ticks):
        assert line.servo(1).torque
        os.kill(os.getpid(), number)
        turn(bus, motor, ticks)

    monkeypatch.setattr(motions, 'turn_to', interrupt)
    assert calibrate('east') == 130
    assert not line.servo(1).torque


def test_a_port_lost_while_calibrating_is_one_line(scales, capsys):
    calibrate, line, _ = scales

    def unplug_while_it_turns():
        processes.until(lambda: line.servo(1).torque)
        line.unplug()

    threading.Thread(target=unplug_while_it_turns).start()
    assert calibrate('east') == 1
    assert 'lost while calibrating' in capsys.readouterr().err


def test_two_lines_are_fitted_with_their_standard_errors():
    points = [CurrentPoint(t, 0.1 + 0.05 * t, -0.08 + 0.04 * t) for t in (1.0, 2.0, 4.0, 8.0)]
    lines = fit_current(points)
    assert (lines.wind.intercept, lines.wind.slope) == pytest.approx((0.1, 0.05))
    assert (lines.pay_out.intercept, lines.pay_out.slope) == pytest.approx((-0.08, 0.04))
    assert lines.uncertainty(8.0) == pytest.approx(0.5 * (0.18 + 0.01 * 8.0) / 0.045)
    assert lines.wind[2:4] == pytest.approx((0.0, 0.0), abs=1e-12)


def test_the_standard_errors_are_those_of_a_linear_regression():
    random = np.random.default_rng(1)
    tensions = np.linspace(1.0, 5.0, 9)
    slopes, stated = [], []
    for _ in range(400):
        noise = random.normal(scale=0.01, size=9)
        rows = np.transpose([tensions, 0.1 + 0.05 * tensions + noise, 0.04 * tensions])
        found = fit_current([CurrentPoint(*row) for row in rows])
        slopes.append(found.wind.slope)
        stated.append(found.wind.slope_error)
    assert np.std(slopes) == pytest.approx(np.mean(stated), rel=0.1)


@pytest.mark.parametrize(
    ('points', 'words'),
    [
        ([(1, 0.1, 0.0), (1, 0.1, 0.0), (2, 0.2, 0.1)], 'at least 3 different weights, got 2'),
        ([(1, 0.1, 0.01), (2, 0.1, 0.02), (3, 0.1, 0.03)], 'does not grow with the weight'),
    ],
)
def test_what_cannot_be_fitted_is_refused(points, words):
    with pytest.raises(InputError, match=words):
        fit_current([CurrentPoint(*point) for point in points])
