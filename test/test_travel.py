"""Searches for slack that find nothing: all attempts together wind no more than one may."""

import threading
import time
from functools import partial

import emulated
import emulated_board
import numpy as np
import pytest

from tendon_robot_ros.common.errors import DriverError, MovedError

pytest.importorskip('dynamixel_sdk')

from tendon_robot_ros.drivers.dynamixel.control_table import Counts

TRAVEL = 0.01  # [m]
MORE = 0.002  # [m] the back-off, and what a motor turns until it is told to stop
PULL = {'mode': 'pull', 'home_travel': TRAVEL}
SERVOS = partial(emulated.driver_for, **PULL)
BOARD = partial(emulated_board.driver_for, **PULL, home_tension=1.0, home_time=4.0)
KINDS = {  # motors, and the driver of them
    'dynamixel': (emulated.line, SERVOS),
    'stepped': (emulated.stepped, SERVOS),
    'serial': (emulated_board.board, BOARD),
}


class Free:
    """Emulated motors whose wires meet no resistance; `span` is what they have wound since."""

    def __init__(self, kind):
        if kind == 'serial' and emulated_board.compiler() is None:
            pytest.skip('no C compiler')
        make, self.driver = KINDS[kind]
        self.kind, self.line = kind, make(stiffness=0.0)
        self.begin = self.wound()

    def enabled(self):
        """Return whether each motor is on."""
        if self.kind == 'serial':
            return self.line.rig.enabled
        return [servo.torque for servo in self.line.rig.servos.values()]

    def wound(self):
        """Return the wire on every spool [m], shape (4,)."""
        rig = self.line.rig
        return rig.places.copy() if self.kind == 'serial' else rig.wound

    def unplug_on_the_way(self):
        """Pull the plug as soon as a wire has moved; or in the end, whatever happened."""
        self.wait_until_on_the_way()
        self.line.unplug()

    def wait_until_on_the_way(self, way=0.001):
        end = time.monotonic() + emulated.SOON
        while np.abs(self.wound() - self.begin).max() < way and time.monotonic() < end:
            time.sleep(0.001)

    def attempt(self, driver):
        """Enable, refused; return the largest way [m] from the very beginning."""
        with pytest.raises(MovedError, match='no resistance within home_travel') as told:
            driver.enable()
        assert str(told.value).count('call reset, then') == 1
        assert not any(self.enabled())
        return np.abs(self.wound() - self.begin).max()


@pytest.mark.parametrize('kind', ['dynamixel', 'serial'])
def test_a_driver_that_is_opened_again_has_its_zero_where_the_wires_are_then(kind):
    if kind == 'serial' and emulated_board.compiler() is None:
        pytest.skip('no C compiler')
    with KINDS[kind][0](stiffness=0.0) as line:
        maker = emulated if kind == 'dynamixel' else emulated_board
        driver = maker.driver_for(line, 'pull', zero='here')
        for _ in range(2):
            driver.open()
            np.testing.assert_allclose(driver.read().pulls, 0.0, atol=1e-4)
            driver.close()
            if kind == 'serial':
                with line._lock:
                    line.rig.places = line.rig.places + 0.005  # [m] by hand
            else:
                line.servo(1).motion.angle += 0.25  # [rad]


@pytest.fixture(params=['stepped', 'serial'])
def free(request):
    made = Free(request.param)
    with made.line:
        yield made


def test_attempts_wind_no_more_together_than_one(free):
    with free.driver(free.line) as driver:
        first = free.attempt(driver)
        assert 0.5 * TRAVEL < first < TRAVEL + MORE
        for _ in range(3):
            assert free.attempt(driver) < TRAVEL + MORE


@pytest.mark.parametrize('free', ['stepped'], indirect=True)
def test_a_motor_that_its_watchdog_stopped_has_found_no_wire(free):
    def trip():
        free.wait_until_on_the_way(way=0.004)  # behind the back-off
        for number in (1, 2, 3, 4):
            free.line.servo(number).put('bus_watchdog', Counts.WATCHDOG_TRIPPED)

    with free.driver(free.line) as driver:
        trips = threading.Thread(target=trip)
        trips.start()
        with pytest.raises(MovedError, match='no resistance within home_travel'):
            driver.enable()
        trips.join()


def test_another_driver_of_the_process_goes_on_from_the_same_beginning(free):
    with free.driver(free.line) as driver:
        free.attempt(driver)
        driver.close()
        driver.open()
        assert free.attempt(driver) < TRAVEL + MORE
    for _ in range(2):
        with free.driver(free.line) as driver:
            assert free.attempt(driver) < TRAVEL + MORE


def test_a_person_who_resets_gets_the_whole_way_again(free):
    with free.driver(free.line) as driver:
        first = free.attempt(driver)
        driver.reset()
        assert free.attempt(driver) > 1.5 * first


@pytest.mark.parametrize('free', ['dynamixel', 'serial'], indirect=True)
def test_a_plug_pulled_in_the_middle_gives_no_second_way(free):
    with free.driver(free.line) as driver:
        pull = threading.Thread(target=free.unplug_on_the_way)
        pull.start()
        with pytest.raises(MovedError):
            driver.enable()
        pull.join()
        free.line.plug()
        emulated.cycle(driver, np.zeros(4), 2.0, until=lambda r: not r.faults)
        assert free.attempt(driver) < TRAVEL + MORE
        assert free.attempt(driver) < TRAVEL + MORE


def test_a_search_that_succeeds_counts_for_nothing():
    with emulated.stepped(slack=0.006) as line:
        begin = {servo: servo.motion.angle for servo in line.rig.servos.values()}
        for _ in range(3):  # 6 mm each: together more than one may
            with emulated.driver_for(line, 'pull', home_travel=TRAVEL) as driver:
                driver.enable()
            for servo, angle in begin.items():
                servo.motion.angle = angle
                servo.refresh()


def test_a_refusal_that_moved_nothing_may_be_tried_again():
    with emulated.line() as line, emulated.driver_for(line, 'pull') as driver:
        line.servo(2).fail(0x20)
        with pytest.raises(DriverError, match='then reboot it') as told:
            driver.enable()
        assert not isinstance(told.value, MovedError)


def test_torque_that_fails_after_a_search_is_not_tried_again_either(monkeypatch):
    with emulated.stepped() as line, emulated.driver_for(line, 'pull') as driver:
        find_slack = driver._find_slack

        def then_broken():
            find_slack()
            line.servo(2).fail(0x20)

        monkeypatch.setattr(driver, '_find_slack', then_broken)
        with pytest.raises(MovedError, match='then reboot it'):
            driver.enable()
