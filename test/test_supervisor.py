"""Whatever comes in, what reaches the motors stays within limits and rates, and ends safe."""

import contextlib
import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import Fault, Reading
from tendon_robot_ros.drivers.safety import (
    CYCLE_MAX_S,
    SafetyRules,
    StopLatch,
    Supervisor,
    approach,
)

INPUTS = ('left', 'right')
LOW, HIGH, RATE, RELEASE = 0.1, 5.0, 8.0, 4.0
STOP = 0.2  # [s]
CYCLE = 0.005


def rules(mode='tension', **changes):
    limits = [[LOW, HIGH]] * 2 if mode == 'tension' else [[-0.01, 0.02]] * 2
    known = {
        'inputs': INPUTS,
        'mode': mode,
        'limits': np.array(limits),
        'rates': np.full(2, RATE if mode == 'tension' else 0.02),
        'rest': np.full(2, LOW if mode == 'tension' else 0.0),
        'release_rate': RELEASE if mode == 'tension' else 0.01,
        'stop_time': STOP if mode == 'tension' else 0.0,
        'tension_limits': (LOW, HIGH),
    }
    return SafetyRules(**{**known, **changes})


def reading(tensions=(LOW, LOW), pulls=(0.0, 0.0), faults=()):
    return Reading(0.0, np.array(pulls), np.array(tensions), 'load_cell', None, tuple(faults))


def started(mode='tension', first=None, **changes):
    supervisor = Supervisor(rules(mode, **changes))
    supervisor.start(0.0, first or reading())
    return supervisor


def run(supervisor, start, seconds, command=None, state=None):
    """Step with the same command every cycle; return the last decision and the time."""
    decision, now = None, start
    for _ in range(round(seconds / CYCLE)):
        now += CYCLE
        decision = supervisor.step(now, command, state or reading())
    return decision, now


numbers = st.floats(allow_nan=True, allow_infinity=True)
commands = st.none() | st.tuples(numbers, numbers)
readings = st.builds(
    reading,
    st.tuples(numbers, numbers),
    st.tuples(numbers, numbers),
    st.lists(st.builds(Fault, st.just('x'), st.just('x'), st.booleans()), max_size=1),
)
events = st.lists(
    st.tuples(
        st.floats(-1.0, 2.0) | st.just(np.nan),
        commands,
        readings,
        st.sampled_from(['', '', '', 'stop', 'lasting', 'gone', 'reset']),
    ),
    max_size=40,
)


def disturb(supervisor, event):
    if event == 'stop':
        supervisor.latch.stop('button', 'button pressed')
    elif event == 'lasting':
        supervisor.latch.stop('topic', 'stop topic says so', lasting=True)
    elif event == 'gone':
        supervisor.latch.cause_removed('topic')
    elif event == 'reset':
        with contextlib.suppress(DriverError):
            supervisor.reset()


@settings(deadline=None)
@given(
    mode=st.sampled_from(['tension', 'pull']),
    weak=st.booleans(),
    first=readings,
    sequence=events,
)
@example(
    'pull', True, reading((0.0, 0.0), (0.0, -1.0 - 2.0**35)), [(1.0, None, reading(), 'stop')]
)
def test_no_sequence_of_inputs_breaks_limits_or_rates(mode, weak, first, sequence):
    giving = {'stop_tension': LOW, 'stop_time': STOP} if weak and mode == 'pull' else {}
    supervisor = Supervisor(rules(mode, **giving))
    try:
        supervisor.start(0.0, first)
    except DriverError:
        return
    limits, rate = supervisor.rules.limits, supervisor.rules.rates[0]
    fall = max(rate, (HIGH - LOW) / STOP) if mode == 'tension' else rate
    before, faulty = supervisor.step(0.0, None, reading()).command, False
    now, reduction = 0.0, 0.0
    for passed, command, state, event in sequence:
        disturb(supervisor, event)
        now += passed
        asked = None if command is None else np.array(command)
        decision = supervisor.step(now, asked, state)
        out = decision.command
        assert np.all(np.isfinite(out))
        begins_again = (faulty and not state.faults) or decision.current_reduction < reduction
        assert decision.current_reduction >= reduction or decision.state == 'following'
        reduction = decision.current_reduction
        assert reduction == 0.0 or (0.0 < reduction <= 1.0 and giving)
        if not begins_again:
            last_digit = np.finfo(float).eps * np.maximum(np.abs(before), np.abs(out))
            assert np.all(out - before <= rate * CYCLE_MAX_S * (1 + 1e-9) + last_digit)
            assert np.all(before - out <= fall * CYCLE_MAX_S * (1 + 1e-9) + last_digit)
            assert np.all(out >= np.minimum(before, limits[:, 0]) - 1e-12)
            assert np.all(out <= np.maximum(before, limits[:, 1]) + 1e-12)
        if mode == 'tension':
            assert np.all((out >= 0.0) & (out <= HIGH))
        before, faulty = out, bool(state.faults)
        now = now if np.isfinite(now) else 0.0


def test_a_command_is_followed_at_the_rate():
    decision, _ = run(started(), 0.0, 0.1, np.array([2.0, LOW]))
    assert decision.state == 'following'
    assert decision.command == pytest.approx([LOW + 0.1 * RATE, LOW])
    assert decision.reasons == ()


def test_a_command_outside_the_limits_is_clipped_and_named():
    decision, _ = run(started(), 0.0, 2.0, np.array([99.0, -1.0]))
    assert decision.command == pytest.approx([HIGH, LOW])
    assert decision.clipped == INPUTS


def test_silence_releases_to_pretension_and_commands_are_followed_again_when_it_is_resumed():
    supervisor = started()
    _, now = run(supervisor, 0.0, 1.0, np.array([3.0, 1.0]))
    decision, now = run(supervisor, now, 0.2)
    assert decision.state == 'releasing'
    assert decision.reasons == ('no command for 0.1 s',)
    decision, now = run(supervisor, now, 1.0)
    assert decision.state == 'released'
    assert decision.command == pytest.approx([LOW, LOW])
    assert decision.off == ()
    supervisor.resume()
    decision, _ = run(supervisor, now, 1.0, np.array([3.0, 1.0]))
    assert decision.command == pytest.approx([3.0, 1.0])


@pytest.mark.parametrize('faults', [(), (Fault('overload', 'overload', True, ('right',)),)])
def test_silence_or_an_error_of_a_motor_releases_the_others_at_the_release_rate(faults):
    supervisor = started(first=reading((4.0, 2.0)))
    before, now = run(supervisor, 0.0, 0.105, state=reading((4.0, 2.0), faults=faults))
    decision, _ = run(supervisor, now, 0.1, state=reading((4.0, 2.0), faults=faults))
    assert before.command[0] - decision.command[0] == pytest.approx(RELEASE * 0.1)


@pytest.mark.parametrize('high', [0.5, 2.0, HIGH])
def test_a_stop_lets_go_of_any_tension_in_its_time_and_begins_with_the_next_cycle(high):
    supervisor = started(first=reading((high, 0.5)))
    supervisor.latch.stop('button', 'button pressed')
    path, now = [np.array([high, 0.5])], 0.0
    while (decision := supervisor.step(now := now + CYCLE, None, reading())).state == 'releasing':
        path.append(decision.command)
    assert now == pytest.approx(min(STOP, (high - LOW) / RELEASE), abs=1.01 * CYCLE)
    assert path[1][0] < high
    steps = np.diff(path, axis=0)
    assert steps.min() == pytest.approx(steps[0].min())  # a ramp, and no steeper than it must be
    assert decision.command == pytest.approx([LOW, LOW])
    assert decision.state == 'released'


def test_a_sender_that_ends_lets_go_until_it_is_resumed():
    supervisor = started()
    _, now = run(supervisor, 0.0, 1.0, np.array([4.0, 1.0]))
    supervisor.let_go('the controller stopped')
    decision, now = run(supervisor, now, STOP + CYCLE)
    assert decision.reasons == ('the controller stopped',)
    assert decision.command == pytest.approx([LOW, LOW])
    assert decision.state == 'released'
    supervisor.resume()
    decision, now = run(supervisor, now, CYCLE, np.array([4.0, 1.0]))
    assert decision.state == 'following'
    assert decision.command[0] == pytest.approx(LOW + RATE * CYCLE)
    decision, _ = run(supervisor, now, 0.2)
    assert decision.reasons == ('no command for 0.1 s',)


def test_release_to_limp_switches_torque_off_at_the_end_only():
    supervisor = started(first=reading((1.0, 1.0)), release_to='limp')
    decision, now = run(supervisor, 0.0, 0.2)
    assert decision.off == ()
    decision, now = run(supervisor, now, 0.5)
    assert decision.state == 'limp'
    assert decision.off == INPUTS
    supervisor.resume()
    decision = supervisor.step(now + CYCLE, np.array([1.0, 1.0]), reading())
    assert decision.state == 'following'
    assert decision.off == ()


@pytest.mark.parametrize('lasting', [False, True])
def test_a_stop_of_another_thread_during_a_reset_is_kept(lasting):
    latch = StopLatch()
    latch.stop('button', 'stop was called')

    class Lasting(set):
        def __bool__(self):  # asked in the middle of the reset
            latch.stop('topic', 'topic stop says true', lasting)
            return len(self) > 0

    latch._lasting = Lasting()
    with pytest.raises(DriverError) if lasting else contextlib.nullcontext():
        latch.reset()
    assert 'topic' in latch.keys


def test_the_same_stop_of_another_thread_during_a_reset_is_kept():
    latch, again = StopLatch(), threading.Thread(target=lambda: latch.stop('button', 'once more'))
    latch.stop('button', 'stop was called')

    class Lasting(set):
        def __bool__(self):  # asked in the middle of the reset
            again.start()
            again.join(0.1)
            return False

    latch._lasting = Lasting()
    latch.reset()
    again.join()
    assert latch.reasons == ['once more']


def test_a_stop_latches_and_reset_waits_for_a_new_command():
    supervisor = started()
    command = np.array([3.0, 1.0])
    _, now = run(supervisor, 0.0, 1.0, command)
    supervisor.latch.stop('button', 'stop was called')
    decision, now = run(supervisor, now, 2.0, command)
    assert decision.state == 'released'
    assert decision.reasons == ('stop was called',)
    supervisor.reset()
    decision, now = run(supervisor, now, 0.05)
    assert decision.command == pytest.approx([LOW, LOW])
    decision, _ = run(supervisor, now, 1.0, command)
    assert decision.command == pytest.approx(command)


@pytest.mark.parametrize('seen', [True, False])
def test_a_stop_is_a_release_even_if_it_is_reset_before_a_cycle_sees_it(seen):
    """Whose target it was learns of a release by its number, which comes with the stop."""
    supervisor = started()
    before, now = run(supervisor, 0.0, 0.1, np.array([3.0, 3.0]))
    releases = supervisor.releases
    supervisor.latch.stop('stop', 'somebody stopped it')
    if seen:
        before, now = run(supervisor, now, CYCLE)
        assert before.stopped
    supervisor.reset()
    assert supervisor.releases == releases + 1
    after, _ = run(supervisor, now, 0.05)
    assert not after.stopped
    assert after.command == pytest.approx(before.command)


def test_reset_is_refused_while_the_cause_lasts():
    supervisor = started()
    supervisor.latch.stop('topic', 'topic stop says true', lasting=True)
    with pytest.raises(DriverError, match='reset refused: topic stop says true'):
        supervisor.reset()
    supervisor.latch.cause_removed('topic')
    assert supervisor.latch
    supervisor.reset()
    assert not supervisor.latch


def test_a_hardware_error_takes_torque_from_that_motor_only_and_releases_the_others():
    supervisor = started(first=reading((2.0, 2.0)))
    bad = reading((2.0, 2.0), faults=[Fault('overload', 'motor 1: overload', True, ('left',))])
    command = np.array([2.0, 2.0])
    decision = supervisor.step(CYCLE, command, bad)
    assert decision.off == ('left',)
    decision, now = run(supervisor, CYCLE, 1.0, command, bad)
    assert decision.off == ('left',)
    assert decision.command == pytest.approx([LOW, LOW])
    with pytest.raises(DriverError, match='motor 1: overload'):
        supervisor.reset()
    decision, now = run(supervisor, now, 0.1, command)
    assert decision.off == ('left',)
    supervisor.reset()
    decision, _ = run(supervisor, now, 0.1, command)
    assert decision.off == ()
    assert decision.state == 'following'


def test_after_a_lost_connection_it_begins_again_at_the_measured_state():
    supervisor = started()
    command = np.array([3.0, 3.0])
    _, now = run(supervisor, 0.0, 1.0, command)
    lost = reading((np.nan, np.nan), faults=[Fault('port', 'the port is gone')])
    decision, now = run(supervisor, now, 0.1, command, lost)
    assert decision.reasons == ('the port is gone',)
    decision = supervisor.step(now + CYCLE, command, reading((1.0, 1.0)))
    assert (decision.state, decision.reasons) == ('holding', ())
    assert decision.command == pytest.approx([1.0] * 2)
    supervisor.resume()
    decision = supervisor.step(now + 2 * CYCLE, command, reading((1.0, 1.0)))
    assert decision.command == pytest.approx([1.0 + RATE * CYCLE] * 2)


def silence(supervisor):
    return None, reading((3.0, 3.0))


def fault(code, hardware=False, inputs=('right',)):
    def cause(supervisor):
        return HELD, reading((3.0, 3.0), (0.01, 0.01), [Fault(code, code, hardware, inputs)])

    return cause


def lets_go(supervisor):
    supervisor.let_go('the controller stopped')
    return None, reading((3.0, 3.0))


def stopped(supervisor):
    supervisor.latch.stop('stop', 'stop was called')
    return HELD, reading((3.0, 3.0))


HELD = np.array([3.0, 3.0])
CAUSES = {
    'silence': silence,
    'motor silent': fault('silent'),
    'port lost': fault('port', inputs=()),
    'watchdog': fault('watchdog'),
    'overload': fault('overload', hardware=True),
    'sender lets go': lets_go,
    'stop': stopped,
}


@pytest.mark.parametrize('seconds', [CYCLE, 0.12, 2.0])
@pytest.mark.parametrize('mode', ['tension', 'pull'])
@pytest.mark.parametrize('cause', CAUSES)
def test_after_any_release_nothing_moves_until_a_person_or_a_new_target(cause, mode, seconds):
    """The commands of before go on all the time; only the cause comes and goes."""
    scale = 1.0 if mode == 'tension' else 0.005
    there = reading((3.0, 3.0), (0.015, 0.015))
    supervisor = started(mode)
    _, now = run(supervisor, 0.0, 1.0, scale * HELD, there)
    if cause == 'silence':
        seconds = max(seconds, 0.12)
    releases, path = supervisor.releases, []
    for _ in range(round(seconds / CYCLE)):
        command, state = CAUSES[cause](supervisor)
        command = None if command is None else scale * command
        decision, now = run(supervisor, now, CYCLE, command, state)
        path.append(decision.command)
    assert supervisor.releases == releases + 1
    assert decision.state in ('releasing', 'released')
    with contextlib.suppress(DriverError):  # refused while a stop is latched
        supervisor.latch.stop('x', 'x')
        supervisor.resume()
        pytest.fail('resumed a latched stop')
    supervisor.latch.forget('x')
    begun, now = run(supervisor, now, CYCLE, scale * HELD, there)
    for _ in range(100):
        decision, now = run(supervisor, now, CYCLE, scale * HELD, there)
        assert np.all(decision.command <= begun.command + 1e-12)
        assert decision.state in ('holding', 'releasing', 'released')
        assert supervisor.held
    if cause in ('overload', 'stop'):  # latched
        with pytest.raises(DriverError):
            supervisor.resume()
        supervisor.reset()
    else:
        supervisor.resume()
    decision, now = run(supervisor, now, 1.0, scale * HELD, there)
    assert decision.command == pytest.approx(scale * HELD)
    assert decision.state == 'following'


def test_it_is_not_resumed_while_the_cause_is_there():
    supervisor = started()
    _, now = run(supervisor, 0.0, 0.5, HELD)
    run(supervisor, now, 0.05, HELD, fault('silent')(supervisor)[1])
    with pytest.raises(DriverError, match='silent'):
        supervisor.resume()


def test_who_never_commanded_needs_not_resume():
    decision, now = run(started(), 0.0, 1.0)
    assert decision.state == 'released'
    supervisor = started()
    _, now = run(supervisor, 0.0, 1.0)
    decision, _ = run(supervisor, now, 1.0, HELD)
    assert decision.command == pytest.approx(HELD)


def test_a_hiccup_of_the_bus_during_a_stop_makes_no_tension_rise_again():
    supervisor = started()
    _, now = run(supervisor, 0.0, 1.0, np.array([3.0, 3.0]))
    supervisor.latch.stop('stop', 'stop was called')
    before, now = run(supervisor, now, 0.4 * STOP)
    lost = reading((np.nan, 3.0), faults=[Fault('silent', 'no answer')])
    supervisor.step(now + CYCLE, None, lost)
    after = supervisor.step(now + 2 * CYCLE, None, reading((3.0, 3.0)))
    assert np.all(after.command < before.command)
    decision, _ = run(supervisor, now + 2 * CYCLE, 0.6 * STOP)
    assert decision.command == pytest.approx([LOW, LOW])


@pytest.mark.parametrize(('sd', 'winds'), [(None, -1), (np.array([1.5, 0.5]), 1)])
def test_in_pull_mode_a_tight_wire_pays_out_unless_its_tension_may_be_within_the_limit(sd, winds):
    supervisor = started('pull', reading(pulls=(0.005, 0.005)))
    tight = replace(reading((HIGH + 1, 0.0)), tension_sd=sd)
    decision, _ = run(supervisor, 0.0, 0.1, np.array([0.010, 0.0]), tight)
    assert np.sign(decision.command - 0.005).tolist() == [winds, -1]


@pytest.mark.parametrize(
    ('tension', 'sd', 'falls'),
    [
        (HIGH + 0.1, None, 0.1),  # all that is beyond, in the same cycle
        (HIGH + 0.1, 0.04, 0.06),
        (HIGH + 0.1, 0.2, 0.0),  # the sensor does not know
        (HIGH + 9.0, None, (HIGH - LOW) / STOP * CYCLE),  # no faster than a stop
        (HIGH - 0.1, None, 0.0),
        (np.nan, None, 0.0),
    ],
)
def test_in_tension_mode_a_wire_above_its_limit_gets_less_at_once(tension, sd, falls):
    supervisor = started(first=reading((HIGH, 1.0)))
    state = reading((tension, 1.0))
    if sd is not None:
        state = replace(state, tension_sd=np.full(2, sd))
    decision = supervisor.step(CYCLE, np.array([HIGH, 1.0]), state)
    assert decision.command == pytest.approx([HIGH - falls, 1.0])
    assert decision.state == 'following'


def test_a_wire_that_friction_holds_above_its_limit_comes_down_to_it_and_stays():
    """The wire pulls 0.8 N more than it is told, whatever it is told."""
    supervisor, friction = started(first=reading((HIGH, LOW))), np.array([0.8, 0.0])
    command, now, seen = np.array([HIGH, LOW]), 0.0, []
    for _ in range(200):
        now += CYCLE
        command = supervisor.step(now, np.array([HIGH, LOW]), reading(command + friction)).command
        seen.append(command[0] + friction[0])
    assert max(seen[20:]) <= HIGH + RATE * CYCLE + 1e-9  # one step of the way back up
    assert min(seen) >= HIGH - 2.0 * RATE * CYCLE


def weak(pulls=(0.010, -0.008)):
    """Return a supervisor in pull mode whose motors are stopped in `STOP` seconds."""
    return started('pull', reading(pulls=pulls), stop_tension=LOW, stop_time=STOP)


def test_in_pull_mode_a_stop_reduces_the_current_and_the_wire_stays_on_its_spool():
    supervisor = weak()
    bent = np.array([0.010, -0.008])
    decision, now = run(supervisor, 0.0, 0.1, bent)
    assert decision.current_reduction == 0.0
    assert decision.command == pytest.approx(bent)
    supervisor.latch.stop('stop', 'stop was called')
    decision, now = run(supervisor, now, 0.5 * STOP)
    assert decision.current_reduction == pytest.approx(0.5)  # the ramp is a straight line
    decision, now = run(supervisor, now, 0.5 * STOP)
    assert decision.current_reduction == pytest.approx(1.0)
    assert decision.command[0] == pytest.approx(0.010 - 0.01 * STOP)  # at the release rate
    assert -0.01 * STOP < decision.command[1] + 0.008 - 0.02 * STOP <= 0.0  # nothing pulls there
    decision, now = run(supervisor, now, 2.0)
    assert (decision.state, decision.current_reduction) == ('released', 1.0)
    assert decision.command == pytest.approx([0.0, 0.0])


def test_silence_in_pull_mode_does_not_reduce_the_current():
    decision, _ = run(weak(), 0.0, 0.3)
    assert decision.state == 'releasing'
    assert decision.current_reduction == 0.0


def test_after_such_a_stop_the_motors_go_on_from_where_the_arm_has_moved_them():
    supervisor = weak()
    _, now = run(supervisor, 0.0, 0.1, np.array([0.010, -0.008]))
    supervisor.latch.stop('stop', 'stop was called')
    moved = reading(pulls=(0.002, -0.001))
    _, now = run(supervisor, now, STOP, None, moved)
    supervisor.reset()
    decision = supervisor.step(now + CYCLE, np.array([0.010, 0.0]), moved)
    assert decision.current_reduction == 0.0
    assert decision.command[0] == pytest.approx(0.002 + 0.02 * CYCLE)


def test_pull_mode_does_not_start_without_a_measured_pull():
    with pytest.raises(DriverError, match='no wire pull measured for right'):
        started('pull', reading(pulls=(0.0, np.nan)))


@pytest.mark.parametrize(
    'changes',
    [
        {'limits': np.array([[1.0, 0.5]] * 2)},
        {'rates': np.array([0.0, 1.0])},
        {'rest': np.array([0.0, 1.0])},
        {'command_timeout': np.inf},
        {'release_to': 'nowhere'},
        {'rates': np.ones(3)},
        {'stop_tension': 0.1},
    ],
)
def test_rules_that_cannot_be_held_are_refused(changes):
    with pytest.raises(DriverError, match='safety rules'):
        rules(**changes)


@given(st.lists(st.tuples(*[st.floats(-10, 10)] * 2), min_size=1), st.floats(0.0, 3.0))
def test_approach_moves_straight_and_at_most_by_the_step(goals, step):
    current = np.zeros(2)
    for goal in goals:
        after = approach(current, np.array(goal), np.full(2, step))
        assert np.all(np.abs(after - current) <= step * (1 + 1e-12) + 1e-15)
        way, done = np.array(goal) - current, after - current
        assert abs(way[0] * done[1] - way[1] * done[0]) < 1e-9
        current = after
