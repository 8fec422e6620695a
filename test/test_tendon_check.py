"""The daily check of the tendons: what has crept is named, with its amount."""

import os
import re
import signal
from dataclasses import replace

import emulated
import emulated_board
import numpy as np
import pytest
import yaml
from emulated_board import needs_compiler
from springs import Springs

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DriverError, InputError, TendonRobotError
from tendon_robot_ros.drivers import tendon_check
from tendon_robot_ros.drivers.mock import MockConfig, MockDriver
from tendon_robot_ros.drivers.tendon_check import (
    TendonReference,
    changes,
    due,
    measure_reference,
    read_reference,
    save_reference,
)


@pytest.fixture
def driver(monkeypatch):
    monkeypatch.setattr(tendon_check, 'RAMP_S', 0.1)
    monkeypatch.setattr(tendon_check, 'STILL_S', 0.1)
    noise = MockConfig(lag=0.005, tension_noise=0.01, pull_noise=2e-5)
    made = MockDriver(emulated.robot(), Springs(1e-3), noise)
    made.open()
    yield made
    made.close()


def test_a_tendon_that_crept_is_named_with_its_amount(driver):
    first = measure_reference(driver, 1.0)
    assert first.pulls == pytest.approx(1e-3, abs=3e-5)
    driver.plant.crept = np.array([0.0, 1.2e-3, 0.0, 0.0])
    found = changes(first, measure_reference(driver, 1.0))
    said = [change.text(1.0) for change in found]
    assert [bool(text) for text in said] == [False, True, False, False]
    assert found[1].pull == pytest.approx(1.2e-3, abs=1e-4)
    assert said[1].startswith(f'{driver.inputs[1]}: has crept: 1.') and 'longer' in said[1]


def test_readings_that_come_one_by_one_from_a_busy_computer_are_waited_for(driver, monkeypatch):
    now, read = [0.0], driver.read

    def late():
        now[0] += 0.15 if now[0] < 1.0 else 0.01  # longer than it is to stand still
        return read()

    driver.enable()
    monkeypatch.setattr(driver, 'read', late)
    arm = tendon_check._HeldTendons(driver, lambda: None, np.ones(4))
    arm.clock = lambda: now[0]
    pulls, _ = arm.still()
    assert pulls == pytest.approx(1e-3, abs=3e-5)
    assert now[0] > 1.0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_whoever_ends_it_the_tendons_are_let_go_and_not_dropped(driver, monkeypatch, number):
    monkeypatch.setattr(tendon_check, 'STOP_S', 0.1)
    commands, write = [], driver.write

    def interrupt(command):
        commands.append(max(command))
        if commands[-1] == 1.0 and len(commands) > 5:
            os.kill(os.getpid(), number)
        write(command)

    monkeypatch.setattr(driver, 'write', interrupt)
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt):
        measure_reference(driver, 1.0)
    assert commands[-1] == driver.limits[0, 0]
    assert sum(commands[-1] < command < 1.0 for command in commands[-5:]) > 2  # a ramp
    assert not driver._on.any()
    assert signal.getsignal(number) == before


def test_tendons_that_do_not_come_to_rest_are_let_go_and_not_dropped(driver, monkeypatch):
    monkeypatch.setattr(tendon_check, 'STILL_TIMEOUT_S', 0.3)
    monkeypatch.setattr(tendon_check, 'STILL_TOLERANCE_M', 0.0)
    commands, write = [], driver.write
    monkeypatch.setattr(driver, 'write', lambda c: (commands.append(max(c)), write(c)))
    with pytest.raises(DriverError, match='do not come to rest at 1 N'):
        measure_reference(driver, 1.0)
    assert commands[-1] == driver.limits[0, 0]
    assert sum(commands[-1] < command < 1.0 for command in commands[-10:]) > 2  # a ramp
    assert not driver._on.any()


def test_what_all_tendons_do_is_no_creep_of_one():
    pulls = np.full(4, 1e-3)
    first = TendonReference(('a', 'b', 'c', 'd'), 1.0, pulls, np.full(4, 1.0), '')
    now = TendonReference(first.inputs, 1.0, pulls + 2e-3, np.array([1, 1, 1, 1.3]), '')
    assert [change.text(1.0) for change in changes(first, now)] == [
        '',
        '',
        '',
        'd: measures 0.30 N more',
    ]


def test_a_tension_out_of_the_limits_moves_nothing(driver):
    with pytest.raises(InputError, match='--tension: expected more than'):
        measure_reference(driver, 1e3)
    assert driver.read().tensions == pytest.approx(0.0, abs=0.1)


def test_a_reference_reads_back_and_is_due_after_the_power_was_off(tmp_path, monkeypatch):
    path = tmp_path / 'tendons.yaml'
    assert 'no reference yet' in due(path)
    values = np.array([1e-3, np.nan])
    save_reference(path, TendonReference(('a', 'b'), 1.0, values * 0 + 1e-3, values, 'today', 'x'))
    monkeypatch.setattr(tendon_check, 'boot_id', lambda: 'x')
    assert due(path) == ''
    monkeypatch.setattr(tendon_check, 'boot_id', lambda: 'y')
    assert 'the power was off' in due(path)


def test_a_reference_of_another_arm_and_a_broken_file_are_one_line(tmp_path):
    one = TendonReference(('a',), 1.0, np.zeros(1), np.zeros(1), '')
    with pytest.raises(InputError, match='the reference holds a, expected b'):
        changes(one, TendonReference(('b',), 1.0, np.zeros(1), np.zeros(1), ''))
    path = tmp_path / 'tendons.yaml'
    path.write_text('{inputs: [a], tension: 1, pulls: [0, 0], tensions: [0]}')
    with pytest.raises(TendonRobotError, match='pulls: expected a list of 1 numbers'):
        read_reference(path)


@pytest.mark.parametrize('kind', ['dynamixel', pytest.param('serial', marks=needs_compiler)])
def test_check_alone_finds_robot_and_driver_in_the_folder_and_names_what_crept(
    kind, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tendon_check, 'RAMP_S', 0.5)
    (tmp_path / 'arm.yaml').write_text(emulated.ROBOT)
    with emulated.line() if kind == 'dynamixel' else emulated_board.board() as line:
        made = emulated.config(line.port) if kind == 'dynamixel' else emulated_board.config(line)
        (tmp_path / f'{kind}.yaml').write_text(yaml.safe_dump(made))
        assert main(['motors', 'calibrate', '--check', '--yes']) == 0
        assert 'written: tendons.yaml' in capsys.readouterr().out
        reference = read_reference(tmp_path / 'tendons.yaml')
        pulls = reference.pulls - [0.0, 1e-3, 0.0, 0.0]  # what it was before it became longer
        save_reference(tmp_path / 'tendons.yaml', replace(reference, pulls=pulls))
        assert main(['motors', 'calibrate', '--check', '--yes']) == 1
    assert re.match(
        rf'{reference.inputs[1]}: has crept: 1\.\d+ mm longer', capsys.readouterr().out
    )


def test_a_folder_with_two_robots_is_asked_about(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ('one.yaml', 'two.yaml'):
        (tmp_path / name).write_text(emulated.ROBOT)
    assert main(['motors', 'calibrate', '--check']) != 0
    said = capsys.readouterr().err
    assert 'got 2 of them (one.yaml, two.yaml); say --robot FILE' in said


def test_without_check_tendon_and_weights_are_asked_for(tmp_path, capsys):
    assert main(['motors', 'calibrate', 'serial', 'none.yaml', '--robot', 'none.yaml']) != 0
    assert '--tendon and --weights, or --check' in capsys.readouterr().err
