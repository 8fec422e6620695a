"""Every fault of board and port at the serial driver: what it says, how it recovers."""

import time

import emulated
import emulated_board
import numpy as np
import processes
import pytest
from emulated import arrive, codes, healthy, until
from emulated_board import needs_compiler
from marks import slow

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers.hardware import Spool
from tendon_robot_ros.emulator.board import Gearmotor

pytest.importorskip('serial')
pytestmark = needs_compiler


def arm_in(mode, **changes):
    with emulated_board.board() as line:
        driver, command = emulated_board.running(line, mode, **changes)
        yield driver, line, command
        driver.close()


@pytest.fixture
def arm():
    """Give a driver that follows a command, its emulated board and the command."""
    yield from arm_in('tension')


@pytest.fixture
def watched_arm(request):
    """Give the same with a board that soon misses the commands."""
    yield from arm_in(getattr(request, 'param', 'tension'), command_timeout=0.2)


both_modes = pytest.mark.parametrize('watched_arm', ['tension', slow('pull')], indirect=True)


def enabled(line):
    return [bool(line.rig.firmware.enabled >> i & 1) for i in range(4)]


def test_tension_is_measured_by_load_cells_and_carries_its_uncertainty(arm):
    driver, _, _ = arm
    reading = driver.read()
    assert reading.source == 'load_cell'
    assert np.all((reading.tension_sd > 0.0) & (reading.tension_sd < 0.01))


@both_modes
def test_a_silent_board_is_said_it_releases_by_itself_and_goes_on(watched_arm):
    driver, line, command = watched_arm
    line.deaf = True
    reading = until(driver, command, lambda r: 'silent' in codes(r))
    assert codes(reading) == {'silent'}
    assert np.isnan(reading.tensions).all()
    rest = emulated.robot().tension_limits[0]
    low = rest + 0.6 * (np.max(emulated.TENSION) - rest)
    until(driver, command, lambda _: np.all(line.rig.tensions < low))
    assert enabled(line) == [True] * 4
    line.deaf = False
    until(driver, command, healthy)


@pytest.mark.parametrize('what', ['spoilt', slow('cut'), slow('doubled')])
def test_a_few_broken_frames_change_nothing(arm, what):
    driver, line, command = arm
    before = driver.read()
    setattr(line, what, 3)
    for reading in emulated.cycle(driver, command, 0.2):
        assert not reading.faults
        np.testing.assert_allclose(reading.tensions, before.tensions, atol=0.2)
    assert what == 'doubled' or driver.link.receiver.bad + driver.link.missed > 0


@pytest.mark.slow
@pytest.mark.parametrize(('begin', 'end'), [('spoil 999999', 'spoil 0'), ('slow 0.15', 'slow 0')])
def test_a_board_without_good_frames_is_silent_and_comes_back(arm, begin, end):
    driver, line, command = arm
    line.obey(begin)
    until(driver, command, lambda r: 'silent' in codes(r))
    line.obey(end)
    until(driver, command, healthy)


@both_modes
def test_a_pulled_plug_is_said_and_a_new_one_goes_on_from_where_the_arm_is(watched_arm):
    driver, line, command = watched_arm
    line.unplug()
    reading = until(driver, command, lambda r: r.faults)
    message = f'{line.port}: the port is gone; plug the board in again'
    assert [fault.message for fault in reading.faults] == [message]
    assert np.isnan(reading.pulls).all()
    emulated.cycle(driver, command, 0.5)
    line.rig.highest[:] = 0.0
    line.plug()
    arrive(driver, command, 0.06)
    assert np.all(line.rig.highest < 1.15 * np.max(line.rig.tensions) + 0.2)  # no jump


FAULTS = {
    'overload': ('overload 2 9', 'overload 2 0'),
    'overheating': ('overheating 2', 'cool 2'),
    'voltage': ('voltage 2', 'cool 2'),
    'load_cell': ('cell 2', 'mend 2'),
    'encoder': ('block 2', 'free 2'),
}
QUICK = ('overheating', 'load_cell')


@pytest.mark.parametrize(
    'code', [pytest.param(c, marks=[pytest.mark.slow] * (c not in QUICK)) for c in FAULTS]
)
def test_a_fault_of_a_channel_takes_its_torque_only_until_cause_and_fault_are_gone(arm, code):
    driver, line, command = arm
    broken, mended = FAULTS[code]
    line.obey(broken)
    hard = np.array(command) + [0.0, 0.0, 4.0 if code == 'encoder' else 0.0, 0.0]
    # On a busy machine the board may have missed commands as well: that is no fault of hardware
    reading = until(driver, hard, lambda r: any(fault.hardware for fault in r.faults))
    (fault,) = (fault for fault in reading.faults if fault.hardware)
    assert (fault.code, fault.inputs) == (code, ('west',))
    assert fault.message.startswith(f'{line.port}: west (channel 2): ')
    until(driver, command, lambda r: enabled(line) == [True, True, False, True])
    if code == 'load_cell':
        assert np.isnan(driver.read().tensions).tolist() == [False, False, True, False]
    if code != 'encoder':
        with pytest.raises(DriverError, match=r'west \(channel 2\): .*reboot'):
            driver.enable()
    if code in ('voltage', 'overheating', 'load_cell'):
        with pytest.raises(DriverError, match='west'):  # the cause is still there
            driver.reboot(['west'])
    line.obey(mended)
    time.sleep(0.1)
    driver.reboot()
    until(driver, command, lambda r: r.faults == ())  # a busy machine may have been silent
    driver.enable()
    until(driver, command, healthy)
    assert enabled(line) == [True] * 4


def test_a_board_that_heard_no_command_releases_and_says_so_once(watched_arm):
    driver, line, command = watched_arm
    for _ in range(10):
        arrive(driver, command, 0.1)
        processes.until(
            lambda: np.all(line.rig.tensions < 0.7 * np.max(command))
        )  # busy elsewhere
        reading = until(driver, command, lambda r: r.faults)
        if codes(reading) != {'silent'}:  # else too long: a board that nobody asks tells nothing
            break
    assert codes(reading) == {'watchdog'}
    assert not any(fault.hardware for fault in reading.faults)
    until(driver, command, healthy)


@pytest.mark.slow
def test_polling_alone_does_not_keep_a_dead_controllers_arm_tense(watched_arm):
    driver, line, command = watched_arm
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        driver.read()
        time.sleep(0.01)
    assert np.all(line.rig.tensions < 0.7 * np.max(command))


def test_a_board_that_lost_its_power_stays_off_until_it_is_enabled_again(arm):
    driver, line, command = arm
    line.restart()
    reading = until(driver, command, lambda r: r.faults)
    assert codes(reading) == {'restarted'}
    assert all(fault.hardware for fault in reading.faults)
    emulated.cycle(driver, command, 0.3)
    assert enabled(line) == [False] * 4
    driver.disable()
    until(driver, command, lambda r: r.faults == ())  # a busy machine may have been silent
    assert enabled(line) == [False] * 4
    driver.enable()
    until(driver, command, healthy)


@pytest.mark.filterwarnings('error::RuntimeWarning')
def test_a_board_that_lost_its_power_counts_pulls_from_where_the_wires_are():
    """Else the next command would wind what the board had counted before the driver began."""
    with emulated_board.board(slack=0.02) as line:
        line.rig.places += 0.008
        driver, command = emulated_board.running(line, 'pull', zero='here')
        np.testing.assert_allclose(driver.zero, 0.008, atol=1e-4)
        line.restart()
        until(driver, command, lambda r: codes(r) == {'restarted'})
        emulated.cycle(driver, command, 0.1)
        at = line.rig.places.copy()
        driver.enable()
        np.testing.assert_allclose(driver.read().pulls, 0.0, atol=1e-4)
        emulated.cycle(driver, np.zeros(4), 0.5)
        np.testing.assert_allclose(line.rig.places, at, atol=5e-4)
        driver.close()


def test_pulls_are_right_where_a_tick_is_no_whole_number_of_nanometres():
    with emulated_board.board(stiffness=0.0) as line:
        # a tick is 100.53 nm, the board counts 101
        line.rig.motor = Gearmotor(spool=Spool(0.01, 1, ticks_per_turn=625_000))
        driver, _ = emulated_board.running(line, 'pull', zero='here')
        goal = np.array([0.02, 0.01, 0.0, 0.02])
        until(driver, goal, lambda r: np.allclose(r.pulls, goal, atol=2e-5))
        np.testing.assert_allclose(line.rig.places, goal, atol=6e-5)
        driver.close()


@pytest.mark.slow
def test_torque_switched_off_while_the_port_was_gone_stays_off(arm):
    driver, line, command = arm
    line.unplug()
    until(driver, command, lambda r: r.faults)
    driver.disable()
    line.plug()
    until(driver, command, healthy)
    emulated.cycle(driver, command, 0.2)
    assert enabled(line) == [False] * 4


def test_a_new_process_finds_an_arm_under_tension_and_lets_it_go_slowly(arm):
    driver, line, _ = arm
    driver.close()  # as after kill -9: nothing was said to the board
    other = emulated_board.driver_for(line)
    other.open()
    assert enabled(line) == [False] * 4
    processes.until(lambda: np.max(line.rig.tensions) < 0.5)  # on its way down
    other.close()


def test_a_port_without_a_board_is_refused_with_a_reason(monkeypatch):
    monkeypatch.setattr('tendon_robot_ros.drivers.serial_board.link.RESTART_TIMEOUT_S', 0.2)
    with emulated_board.board() as line:
        line.deaf = True
        driver = emulated_board.driver_for(line)
        with pytest.raises(DriverError, match=f'{line.port}: no answer at 1000000 baud'):
            driver.open()
    with pytest.raises(DriverError, match='no such port'):
        driver.open()
