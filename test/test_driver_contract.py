"""What every driver does, whatever is behind it."""

import contextlib
import importlib.util
import time
from functools import partial

import emulated
import emulated_board
import numpy as np
import pytest
from plain import plain_numbers
from springs import Springs

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import Driver, Reading, make_driver

MODES = ('tension', 'pull')


@contextlib.contextmanager
def mock(mode):
    springs = Springs(1.0 / emulated.STIFFNESS)
    yield make_driver('mock', emulated.robot(), {'lag': 0.005}, mode=mode, plant=springs)


@contextlib.contextmanager
def on_port(motors, driver_for, mode):
    with motors() as line, contextlib.closing(driver_for(line, mode, zero='here')) as driver:
        yield driver


BACKENDS = {
    'mock': mock,
    'dynamixel': partial(on_port, partial(emulated.line, slack=0.0), emulated.driver_for),
    'serial': partial(on_port, emulated_board.board, emulated_board.driver_for),
}
if importlib.util.find_spec('dynamixel_sdk') is None:
    del BACKENDS['dynamixel']
if importlib.util.find_spec('serial') is None or not emulated_board.compiler():
    del BACKENDS['serial']


@pytest.fixture(params=[(b, m) for b in BACKENDS for m in MODES], ids=' '.join)
def closed(request):
    backend, mode = request.param
    with BACKENDS[backend](mode) as driver:
        yield driver


@pytest.fixture
def driver(closed):
    with closed:
        closed.enable()
        yield closed


def middle(driver, part=0.3):
    """Make a command within the limits, different for every input."""
    low = np.maximum(driver.limits[:, 0], 0.0)
    return low + part * (driver.limits[:, 1] - low) * np.linspace(0.4, 1.0, len(driver.inputs))


def measured(driver, reading):
    return reading.tensions if driver.mode == 'tension' else reading.pulls


def settle(driver, command, seconds=emulated.SOON):
    """Command until what is measured is near; return the last reading."""
    close = 0.05 * np.max(np.abs(driver.limits))
    return emulated.cycle(
        driver,
        command,
        seconds,
        until=lambda r: np.allclose(measured(driver, r), command, atol=close),
    )[-1]


def test_it_says_what_it_drives(closed):
    assert isinstance(closed, Driver)
    assert closed.inputs == emulated.robot().inputs
    assert closed.mode in MODES
    m = len(closed.inputs)
    assert closed.limits.shape == (m, 2)
    assert closed.rates.shape == (m,)
    assert np.all(closed.limits[:, 0] < closed.limits[:, 1])


def test_reading_before_opening_is_refused(closed):
    with pytest.raises(DriverError, match=r'call open\(\) first'):
        closed.read()


def test_it_can_be_opened_closed_and_opened_again(closed):
    for _ in range(2):
        closed.open()
        assert isinstance(closed.read(), Reading)
        closed.close()
        closed.close()


def test_a_reading_has_a_monotonic_time_one_value_per_input_and_a_source(driver):
    before = time.monotonic()
    first, second = driver.read(), driver.read()
    assert before <= first.time <= second.time <= time.monotonic()
    assert first.pulls.shape == first.tensions.shape == (len(driver.inputs),)
    assert first.source in ('load_cell', 'current', 'command')
    assert first.faults == ()
    assert first.tension_sd is None or np.all(first.tension_sd >= 0.0)


def test_enabling_moves_nothing_and_may_be_repeated(driver):
    before = driver.read()
    driver.enable()
    after = driver.read()
    np.testing.assert_allclose(after.pulls, before.pulls, atol=5e-4)
    assert not after.faults


def test_a_command_is_reached(driver):
    command = middle(driver)
    reading = settle(driver, command)
    close = 0.05 * np.max(np.abs(driver.limits))
    np.testing.assert_allclose(measured(driver, reading), command, atol=close)


def test_a_command_beyond_the_limits_stops_at_them(driver):
    reading = settle(driver, 10.0 * driver.limits[:, 1], 0.6)
    highest = driver.limits[:, 1] * 1.02 + 1e-4
    assert np.all(measured(driver, reading) <= highest)


def test_a_command_that_is_not_finite_or_of_the_wrong_shape_is_refused(driver):
    for spoilt in (np.nan, np.inf, -np.inf):
        command = middle(driver)
        command[1] = spoilt
        with pytest.raises(DriverError, match=f'nan or inf for {driver.inputs[1]}'):
            driver.write(command)
    for shape in ((1,), (5,), (2, 2), ()):
        with pytest.raises(DriverError, match=str(len(driver.inputs))):
            driver.write(np.zeros(shape))


def test_disabling_lets_go_of_the_named_input_only(driver):
    settle(driver, middle(driver))
    driver.disable(driver.inputs[:1])

    def let_go(reading):
        tensions = reading.tensions
        return not tensions[0] > 0.1 * tensions[3] and tensions[3] > 0.1

    emulated.until(driver, middle(driver), let_go)
    emulated.cycle(driver, middle(driver), 0.1)
    emulated.until(driver, middle(driver), let_go)  # and stays so


def test_disabling_is_allowed_in_every_state(closed):
    closed.disable()
    closed.open()
    closed.disable()
    closed.enable()
    closed.disable()
    closed.disable()
    assert isinstance(closed.read(), Reading)
    closed.close()
    closed.disable()


def test_it_describes_itself_in_words_and_plain_numbers(driver):
    said = driver.describe()
    assert all(isinstance(k, str) and isinstance(v, str) for k, v in said.items())
    plain_numbers(said)
