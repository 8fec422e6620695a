"""The mock lags, has noise and fails on request; its plant is given to it."""

from pathlib import Path

import numpy as np
import pytest
from springs import Springs

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.mock import FAULTS, MockConfig, MockDriver
from tendon_robot_ros.robot import load_robot

ROBOTS = Path(__file__).parents[1] / 'config' / 'robots'
ROBOT = load_robot(ROBOTS / 'kato_10_1_single.yaml')


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def mock(mode='tension', **config):
    clock = Clock()
    driver = MockDriver(ROBOT, Springs(1e-3, highest=4.5), MockConfig(**config), mode)
    driver.clock = clock
    driver.open()
    driver.enable()
    return driver, clock


def test_it_approaches_a_command_with_its_lag():
    driver, clock = mock(lag=0.1)
    driver.write(np.array([1.0, 2.0]))
    clock.now += 0.1
    reading = driver.read()
    assert reading.tensions == pytest.approx((1 - np.exp(-1)) * np.array([1.0, 2.0]))
    clock.now += 10.0
    assert driver.read().pulls == pytest.approx([1e-3, 2e-3])


def test_a_settled_plant_is_not_asked_again():
    driver, clock = mock(lag=0.0)
    driver.write(np.array([1.0, 1.0]))
    driver.read()
    calls = driver.plant.calls
    clock.now += 1.0
    driver.read()
    assert driver.plant.calls == calls


def test_pull_mode_moves_wires_and_frees_those_without_torque():
    driver, clock = mock('pull', lag=0.01)
    driver.write(np.array([0.002, 0.001]))
    clock.now += 1.0
    assert driver.read().pulls == pytest.approx([0.002, 0.001])
    driver.disable(['left'])
    assert driver.read().tensions == pytest.approx([0.0, 1.0])


def test_enabling_holds_the_measured_state():
    driver, clock = mock(lag=0.1)
    driver.write(np.array([3.0, 3.0]))
    clock.now += 0.1
    driver.enable()
    before = driver.read().tensions
    clock.now += 1.0
    assert driver.read().tensions == pytest.approx(before)


def test_noise_is_stated_and_has_its_size():
    driver, clock = mock(lag=0.0, tension_noise=0.05)
    driver.write(np.array([2.0, 2.0]))
    clock.now += 1.0
    seen = np.array([driver.read().tensions for _ in range(400)])
    assert seen.std() == pytest.approx(0.05, rel=0.1)
    assert driver.read().tension_sd == pytest.approx([0.05, 0.05])


def test_without_load_cells_the_tension_is_the_command_and_says_so():
    driver, _ = mock(lag=1.0, tension_source='command')
    driver.write(np.array([2.0, 2.0]))
    reading = driver.read()
    assert reading.source == 'command'
    assert reading.tensions == pytest.approx([2.0, 2.0])


def test_injected_faults_are_read_until_their_cause_is_gone():
    driver, clock = mock(lag=0.0)
    driver.inject('silent', ['left'])
    reading = driver.read()
    assert np.isnan(reading.pulls[0])
    assert np.isfinite(reading.pulls[1])
    assert reading.faults[0].inputs == ('left',)
    assert 'left: no answer' in reading.faults[0].message
    driver.write(np.array([1.0, 1.0]))
    clock.now += 1.0
    driver.clear()
    assert driver.read().tensions == pytest.approx([0.0, 1.0])
    assert driver.read().faults == ()


def test_a_fault_may_end_while_another_thread_reads(monkeypatch):
    driver, _ = mock()
    driver.inject('silent', ['left'])

    class Ending(dict):
        def __getitem__(self, code):
            driver.clear()
            return super().__getitem__(code)

    monkeypatch.setattr('tendon_robot_ros.drivers.mock.FAULTS', Ending(FAULTS))
    assert np.isnan(driver.read().pulls[0])
    assert driver.read().faults == ()


def test_a_hardware_error_refuses_torque_until_reboot():
    driver, _ = mock()
    driver.inject('overload', ['right'])
    assert driver.read().faults[0].hardware
    with pytest.raises(DriverError, match='right: overload'):
        driver.enable()
    driver.reboot()
    driver.enable()


def test_an_arm_that_cannot_respond_stays_where_it_is_and_says_why():
    driver, clock = mock(lag=0.0)
    driver.write(np.array([5.0, 0.0]))
    clock.now += 1.0
    reading = driver.read()
    assert reading.faults[0].message == 'mock arm: too much'
    assert reading.tensions == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    ('config', 'message'),
    [
        ({'lags': 1}, "mock.yaml: lags: expected one of lag, .*, got 'lags'"),
        ({'lag': -1}, 'mock.yaml: lag: expected a finite number from 0 to 10 .s., got -1'),
        ({'tension_source': 'guess'}, 'tension_source: expected one of load_cell, command'),
        ({'seed': 'x'}, 'seed: expected a whole number from 0'),
    ],
)
def test_a_wrong_configuration_is_refused(config, message):
    with pytest.raises(DriverError, match=message):
        make_driver('mock', ROBOT, config, source='mock.yaml', plant=Springs(1e-3))


def test_faults_and_inputs_that_do_not_exist_are_refused():
    driver, _ = mock()
    with pytest.raises(DriverError, match='expected one of silent, port'):
        driver.inject('gremlin')
    with pytest.raises(DriverError, match='expected inputs of left, right'):
        driver.inject('silent', ['middle'])
