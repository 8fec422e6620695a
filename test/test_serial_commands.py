"""The commands `emulate serial` and `calibrate serial`, and configurations that are refused."""

import threading

import emulated
import emulated_board
import numpy as np
import pytest
import yaml
from emulated_board import needs_compiler

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DriverError, InputError
from tendon_robot_ros.drivers.serial_board.config import CountsPoint, fit_counts, read_config
from tendon_robot_ros.drivers.serial_board.link import BoardLink
from tendon_robot_ros.robot import load_robot

pytest.importorskip('serial')


@pytest.fixture
def robot_file(tmp_path):
    path = tmp_path / 'four.yaml'
    path.write_text(emulated.ROBOT)
    return str(path)


@needs_compiler
def test_calibrate_finds_zero_and_scale_of_a_load_cell_with_their_errors(
    tmp_path, robot_file, monkeypatch, capsys
):
    monkeypatch.setattr('tendon_robot_ros.cli.motors.SECONDS_PER_WEIGHT', 0.5)
    masses = (0.1, 0.2, 0.4)  # [kg]
    with emulated_board.board() as line:
        config = tmp_path / 'board.yaml'
        content = emulated_board.config(line, calibration='cells.yaml')
        config.write_text(yaml.safe_dump(content))
        pile = iter((0.0, *masses))
        monkeypatch.setattr('builtins.input', lambda _: line.obey(f'weight 1 {next(pile)}'))
        out = tmp_path / 'cells.yaml'
        out.write_text('east: {zero: 8000.0, newtons_per_count: 6.0e-6}\n')
        call = f'motors calibrate serial {config} --robot {robot_file} --tendon north'
        code = main([*call.split(), '--weights', *map(str, masses), '--output', str(out)])
        truth = line.rig.cells[1]
    assert code == 0
    assert 'uncertainty: 0.000' in capsys.readouterr().out
    found = yaml.safe_load(out.read_text())
    assert found['east']['zero'] == 8000.0
    north = found['north']
    assert north['newtons_per_count'] == pytest.approx(truth.newtons_per_count, rel=2e-3)
    assert abs(north['zero'] - truth.zero) < 4.0 * north['zero_error'] + 1.0
    assert 0.0 < north['slope_error'] < 1e-3 * truth.newtons_per_count
    assert 0.0 < north['uncertainty'] < 0.01


@needs_compiler
def test_a_weight_that_swings_is_refused(robot_file):
    with emulated_board.board() as line:
        content = emulated_board.config(line)
        config = read_config(emulated.robot(), content, 'tension', 'board.yaml')
        link = BoardLink(config.port, config.baudrate)
        link.open(lambda: link.identify(config))
        timer = threading.Timer(0.4, lambda: line.obey('weight 0 0.2'))
        timer.start()
        with pytest.raises(DriverError, match='channel 0: the weight does not hang still'):
            link.measure_counts(0, 0.0, 0.6)
        timer.join()
        link.close()


@pytest.mark.parametrize('mass', ['0', '51', 'nan'])
def test_a_mass_that_no_weight_has_is_refused(mass, capsys):
    call = 'motors calibrate serial board.yaml --robot arm.yaml --tendon left --weights 0.1'
    assert main([*call.split(), mass]) == 1
    assert '--weights: expected masses from 0 to 50 kg, got [0.1, ' in capsys.readouterr().err


def test_a_board_that_gives_no_counts_is_refused(monkeypatch):
    link = BoardLink('/dev/none', 1_000_000)
    monkeypatch.setattr(link, 'send', lambda *_: 0)
    monkeypatch.setattr(link, 'wait_for', lambda *_: [])
    with pytest.raises(DriverError, match='channel 0: no values of its load cell'):
        link.measure_counts(0, 0.0, 0.0)


def test_weights_that_the_counts_do_not_follow_are_refused():
    with pytest.raises(InputError, match='do not follow the weight'):
        fit_counts([CountsPoint(t, 8000.0 + t, 30.0) for t in (0.0, 1.0, 2.0)])
    with pytest.raises(InputError, match='at least 2 different weights'):
        fit_counts([CountsPoint(t, 8000.0 + 1e5 * t, 30.0) for t in (0.0, 1.0, 1.0)])


def test_a_straight_line_is_found_exactly_and_a_cell_mounted_backwards_too():
    for slope in (6e-6, -6e-6):
        cell = fit_counts([CountsPoint(t, -500.0 + t / slope, 0.0) for t in (0.0, 1.0, 2.0, 4.0)])
        assert cell.zero == pytest.approx(-500.0, abs=1e-3)
        assert cell.newtons_per_count == pytest.approx(slope)


WRONG = [
    ({'port': ''}, 'port: expected the path of a serial port'),
    ({'baudrate': 9600}, 'baudrate: expected one of 115200'),
    ({'telemetry_rate': 5000}, 'telemetry_rate: expected a finite number from 20 to 1000'),
    ({'speed': 1}, "speed: expected one of port, baudrate, .*got 'speed'"),
    ({'calibration': {}}, 'calibration: .*none for east: type motors calibrate serial'),
    ({'tendons': {'east': {'channel': 0}}}, 'tendons: .*none for north, west, south'),
    ({'ticks_per_turn': 2e6}, 'ticks_per_turn: expected whole nanometres .*, got .*31.4 nm'),
    ({'ticks_per_turn': 1e7, 'spool_radius': 5e-4}, 'ticks_per_turn: .*got .*0.314 nm'),
    ({'pull_limits': [0.1, 0.0]}, 'pull_limits: expected .lowest, highest.'),
]


@needs_compiler
@pytest.mark.parametrize(('change', 'words'), WRONG)
def test_a_wrong_configuration_is_refused_with_file_and_key(change, words):
    refused = pytest.raises(DriverError, match=f'board.yaml: {words}')
    with emulated_board.board() as line, refused:
        emulated_board.driver_for(line, **change)


@needs_compiler
def test_two_inputs_on_one_channel_and_a_channel_the_board_has_not_are_refused():
    with emulated_board.board() as line:
        tendons = {name: {'channel': i} for i, name in enumerate(emulated.robot().inputs)}
        tendons['south'] = {'channel': 0}
        with pytest.raises(DriverError, match='a channel of its own'):
            emulated_board.driver_for(line, tendons=tendons)
        tendons['south'] = {'channel': 6}
        driver = emulated_board.driver_for(line, tendons=tendons)
        with pytest.raises(DriverError, match='the board has channels 0 to 3'):
            driver.open()


def test_the_example_configuration_is_read():
    root = emulated.HERE.parent
    content = yaml.safe_load((root / 'config/serial_board.yaml').read_text())
    robot = load_robot(root / 'config/robots/kato_10_1.yaml')
    for mode in ('tension', 'pull'):
        config = read_config(robot, content, mode, 'serial_board.yaml', calibrated=False)
        assert np.array([t.spool.metres_per_tick for t in config.tendons])[1] < 0.0
