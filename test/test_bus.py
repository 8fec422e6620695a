"""The thread that talks to the motors: it releases before it ends, whatever ends it."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processes import until

pytest.importorskip('rclpy')

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers.mock import MockConfig, MockDriver
from tendon_robot_ros.drivers.safety import FOLLOWING, LIMP, RELEASED, SafetyRules, Supervisor
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.driver import motor_loop
from tendon_robot_ros.ros.driver.motor_loop import MotorLoop

ROBOT = load_robot(Path(__file__).parents[1] / 'config' / 'robots' / 'kato_10_1_single.yaml')
LOW, HIGH = 0.1, 5.0
COMMAND = np.array([2.0, 1.0])


class State:
    def __init__(self, tensions):
        self.inputs, self.pulls = tensions, 1e-3 * tensions


class Arm:
    def respond(self, tensions):
        return State(tensions.copy())


class Log(MockDriver):
    """A mock that remembers what it was told."""

    def __init__(self):
        super().__init__(ROBOT, Arm(), MockConfig(lag=0.0))
        self.written, self.switched_off, self.broken = [], [], False

    def write(self, command):
        if self.broken:
            raise OSError('the cable is cut')
        self.written.append(command.copy())
        super().write(command)

    def disable(self, inputs=()):
        self.switched_off.append(tuple(inputs))
        super().disable(inputs)


@pytest.fixture
def bus():
    limits = np.array([[LOW, HIGH]] * 2)
    rules = SafetyRules(
        ROBOT.inputs, 'tension', limits, np.full(2, 50.0), limits[:, 0], 20.0,
        command_timeout=30.0,  # a test on a busy machine is silent for longer than the usual 0.1 s
    )  # fmt: skip
    driver, cycles = Log(), []
    driver.open()
    made = MotorLoop(driver, Supervisor(rules), 0.002, cycles.append)
    made.cycles = cycles
    made.start()
    made.activate()
    yield made
    made.close()


def follow(bus, command=COMMAND):
    bus.driver.written.clear()

    def there():
        bus.put(command)
        written = bus.driver.written
        return written and np.allclose(written[-1], command)

    until(there)


def test_it_follows_and_ramps_down_for_a_release(bus):
    follow(bus)
    count = len(bus.driver.written)
    assert bus.release('inactive', 'the node is not active')
    assert bus.driver.written[-1] == pytest.approx([LOW, LOW])
    steps = np.diff(np.array(bus.driver.written[count - 1 :]), axis=0)
    assert -0.05 * 20.0 - 1e-9 <= steps.min() < 0.0
    assert bus.driver.switched_off == []


def fail(cycle):
    raise ValueError('nobody foresaw this')


@pytest.mark.parametrize(('release_to', 'off'), [('pretension', set()), ('limp', {*ROBOT.inputs})])
def test_after_a_ramp_for_an_error_torque_goes_off_where_a_release_ends_so(bus, release_to, off):
    bus.supervisor.rules = replace(bus.supervisor.rules, release_to=release_to)
    follow(bus)
    bus._report = fail
    until(lambda: not bus._thread.is_alive())
    assert isinstance(bus.crashed, ValueError)
    assert bus.driver.written[-1].max() < COMMAND.min()
    assert {name for names in bus.driver.switched_off for name in names} == off


def test_the_port_is_not_closed_before_the_ramp_for_an_error_has_ended(bus, monkeypatch):
    """However long that takes."""
    monkeypatch.setattr(motor_loop, 'CALL_TIMEOUT_S', 0.05)
    bus.supervisor.rules = replace(bus.supervisor.rules, stop_time=0.5, release_rate=0.1)
    follow(bus)
    bus._report = fail
    until(lambda: bus.crashed)
    bus.close()
    assert bus.driver.written[-1] == pytest.approx([LOW, LOW])
    assert bus.driver.switched_off == []


def test_when_even_writing_fails_torque_goes_off(bus):
    follow(bus)
    bus.driver.broken = True
    until(lambda: not bus._thread.is_alive())
    assert isinstance(bus.crashed, OSError)
    assert bus.driver.switched_off == [()]


def test_a_motor_error_takes_its_torque_and_a_reset_brings_it_back(bus):
    follow(bus)
    bus.driver.inject('overload', ['right'])
    until(lambda: bus.driver.switched_off)
    assert bus.driver.switched_off == [('right',)]
    with pytest.raises(DriverError, match='right: overload'):
        bus.call(bus.supervisor.reset)
    bus.call(bus.reboot)
    seen = len(bus.cycles)
    until(lambda: len(bus.cycles) > seen + 1)  # the next reading shows it
    bus.call(bus.supervisor.reset)
    follow(bus)
    assert bus.supervisor.state == FOLLOWING
    assert bus.call(bus.driver.read).tensions == pytest.approx(COMMAND)


def test_a_cycle_names_a_fault_exactly_when_it_gives_it_as_a_reason(bus):
    """A status whose fault comes before its reason is logged without the reason, and not again."""
    follow(bus)
    for _ in range(20):
        bus.cycles.clear()
        bus.driver.inject('silent', ['right'])
        until(lambda: bus.cycles and bus.cycles[-1].faults)
        bus.driver.clear()
        until(lambda: not bus.cycles[-1].faults)
        for cycle in tuple(bus.cycles):
            said = any('right' in reason for reason in cycle.decision.reasons)
            assert said == bool(cycle.faults)


def test_a_reboot_takes_the_torque_of_healthy_motors_until_a_reset(bus):
    follow(bus)
    bus.call(bus.reboot)
    assert bus.off == ROBOT.inputs
    assert bus.supervisor.latch.reasons == ['rebooted, torque is off']
    bus.put(COMMAND)
    assert bus.call(bus.driver.read).tensions == pytest.approx([0.0, 0.0])
    bus.call(bus.reset)
    follow(bus)
    assert bus.off == ()
    assert bus.call(bus.driver.read).tensions == pytest.approx(COMMAND)


def test_a_command_that_came_with_the_wish_to_let_go_counts_no_more(bus):
    follow(bus)
    bus.call(lambda: (bus.put(COMMAND), bus.let_go('the controller stopped')))
    until(lambda: bus.supervisor.state == RELEASED)
    assert bus.cycles[-1].decision.reasons == ('the controller stopped',)
    assert bus.driver.written[-1] == pytest.approx([LOW, LOW])
    bus.call(bus.supervisor.resume)
    follow(bus)


def test_a_command_that_came_before_a_reset_moves_nothing(bus):
    """Who follows the measured tensions of a falling arm is a cycle behind."""
    follow(bus)
    bus._receive = lambda: bus._calls.empty() or bus.put(COMMAND)
    for _ in range(10):  # most resets come between two cycles, with a command
        bus.supervisor.latch.stop('stop', 'somebody stopped it')
        until(lambda: bus.supervisor.state == RELEASED)
        bus.call(bus.reset)
        until(lambda: bus.supervisor.state == FOLLOWING)
        assert bus.driver.written[-1] == pytest.approx([LOW, LOW])
    follow(bus)


def test_a_call_that_was_reported_as_failed_is_not_made_later(bus):
    """A reset during a long search for slack would else undo the stop that came after it."""
    follow(bus)
    begun, busy = threading.Event(), threading.Event()
    bus._calls.put(lambda: (begun.set(), busy.wait()))
    assert begun.wait(30.0)
    with pytest.raises(DriverError, match='did not answer'):
        bus.call(bus.reset, 0.01)
    bus.supervisor.latch.stop('stop', 'somebody stopped it')
    busy.set()
    bus.call(lambda: None)
    assert bus.supervisor.latch.reasons == ['somebody stopped it']


def test_limp_comes_back_from_the_measured_state(bus):
    follow(bus)
    patient = replace(bus.supervisor.rules, release_to='limp')
    bus.supervisor.rules = replace(patient, command_timeout=0.1)
    until(lambda: bus.supervisor.state == LIMP)
    bus.supervisor.rules = patient  # else it lets go again where this test waits for a processor
    assert set(bus.driver.switched_off[0]) == set(ROBOT.inputs)
    bus.call(bus.supervisor.resume)
    follow(bus)
    assert bus.driver.written[0].max() <= 50.0 * 0.05


def test_errors_of_a_call_come_back_to_the_caller(bus):
    with pytest.raises(DriverError, match='expected one of silent'):
        bus.call(lambda: bus.driver.inject('gremlin'))
