"""After a release of the driver the controller holds until it is asked for something new."""

from dataclasses import replace

import numpy as np
import pytest
from control_rig import CYCLE, model, reachable, standing

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.control import ControllerCore, Refusal, Settings, Target, Twist
from tendon_robot_ros.control.inputs import Trajectory
from tendon_robot_ros.control.status import MotionGoal, controller_status
from tendon_robot_ros.drivers import Fault, Reading
from tendon_robot_ros.drivers.safety import SafetyRules, Supervisor

TIMEOUT = 0.1  # [s]
ASK = {'kato_10_1': (0.5, 0.1, 0.1, 0.9), 'spatial_6': (2.0, 0.4, 0.4, 1.0, 0.4, 0.4)}


class Pair:
    """A controller and the supervisor of a driver, as their nodes join them; motors follow."""

    def __init__(self, robot, mode):
        self.model = model(robot)
        robot = self.model.robot
        self.core = ControllerCore(self.model, Settings(pull_mode=mode == 'pull'))
        m, pull = len(robot.inputs), mode == 'pull'
        limits = np.array([[-0.5, 0.5]] * m) if pull else self.model.limits
        self.supervisor = Supervisor(
            SafetyRules(
                robot.inputs,
                mode,
                limits,
                np.full(m, 0.05 if pull else 20.0),
                np.zeros(m) if pull else limits[:, 0],
                0.02 if pull else 10.0,
                command_timeout=TIMEOUT,
            )
        )
        self.pull, self.now, self.faults, self.heard = pull, 0.0, (), True
        self.place = np.zeros(m) if pull else limits[:, 0].copy()  # what the motors hold
        self.supervisor.start(0.0, self.reading())
        self.tightest, self.outputs = [], []

    def reading(self):
        nothing = np.full(len(self.place), np.nan)
        pulls, tensions = (self.place, nothing) if self.pull else (nothing, self.place)
        return Reading(self.now, pulls, tensions, 'load_cell', None, self.faults)

    def run(self, seconds, frozen=False):
        for _ in range(round(seconds / CYCLE)):
            self.now += CYCLE
            output = None if frozen else self.cycle()
            command = None
            if output is not None:
                command = output.pulls if self.pull else output.tensions
            decision = self.supervisor.step(self.now, command, self.reading())
            self.place = decision.command
            self.tightest.append(self.place.max())
        return decision

    def cycle(self):
        core, supervisor = self.core, self.supervisor
        reading = self.reading()
        core.measured(self.now, reading.tensions, reading.pulls)
        if self.heard:
            stopped = '; '.join(supervisor.latch.reasons)
            core.driver_reports(stopped, supervisor.held, supervisor.releases)
        if core.needs_driver:
            self.resume()
        return core.step(self.now)

    def resume(self):
        try:
            self.supervisor.resume()
        except DriverError as error:
            self.core.not_resumed(str(error))
        else:
            self.core.resumed()

    def code(self):
        return controller_status(self.core, self.now).code

    def target(self, share=1.0):
        tensions = share * np.array(ASK[self.model.robot.name])
        shape = self.model.shape(np.maximum(tensions, self.model.limits[:, 0]))
        return Target(shape.tip_position)

    def bent(self):
        self.run(0.1)
        self.core.aim(self.target())
        self.run(2.0)
        assert self.code() == 'reached'
        self.tightest.clear()
        return self.place.max()


def fault(code, seconds, hardware=False):
    def cause(pair):
        pair.faults = (Fault(code, code, hardware, pair.model.inputs[:1]),)
        pair.run(seconds)
        pair.faults = ()

    return cause


def frozen(pair):
    pair.run(1.5 * TIMEOUT, frozen=True)


def sender_lets_go(pair):
    pair.supervisor.let_go('the sender of the commands lets go')
    pair.run(2 * CYCLE)  # until it is told


def driver_stop(pair):
    pair.supervisor.latch.stop('stop', 'stop was called')
    pair.run(0.1)
    pair.supervisor.reset()


def controller_stop(pair):
    pair.core.latch.stop('stop', 'stop was called')
    pair.run(0.3)
    pair.core.reset()


CAUSES = {
    'motor silent for a cycle': fault('silent', CYCLE),
    'motor silent': fault('silent', 0.5),
    'port lost': fault('port', 2.0),
    'controller frozen': frozen,
    'sender lets go': sender_lets_go,
    'driver stopped and reset': driver_stop,
    'controller stopped and reset': controller_stop,
}


@pytest.mark.parametrize(
    ('cause', 'robot'),
    [*((cause, 'kato_10_1') for cause in CAUSES), ('motor silent', 'spatial_6')],
)
@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_after_a_release_nothing_moves_until_a_new_target(cause, mode, robot):
    pair = Pair(robot, mode)
    high = pair.bent()
    CAUSES[cause](pair)
    for _ in range(40):
        pair.run(CYCLE)
        assert pair.code() in ('released', 'holding')
    start = pair.place.max()
    pair.run(1.0)
    assert np.diff(pair.tightest).max() <= 1e-9
    assert pair.code() in ('released', 'holding')
    before = pair.place
    pair.core.aim(pair.target(0.9))
    pair.run(2.0)
    assert pair.code() in ('reached', 'nearest')
    assert not np.allclose(pair.place, before, atol=1e-4)
    assert max(start, pair.place.max()) <= high + 1e-3


def test_the_same_target_again_and_again_is_no_new_one_but_a_reset_is():
    pair = Pair('kato_10_1', 'tension')
    pair.bent()
    CAUSES['motor silent'](pair)
    pair.run(0.1)
    with pytest.raises(Refusal, match='the same target as before the release; send another'):
        pair.core.aim(pair.target())
    pair.run(0.5)
    assert np.diff(pair.tightest).max() <= 1e-9
    pair.resume()
    pair.core.reset()  # by a person
    pair.run(0.1)
    assert pair.code() == 'holding'
    pair.core.aim(pair.target())
    pair.run(2.0)
    assert pair.code() == 'reached'


def test_the_same_place_without_its_direction_is_a_new_target():
    pair, target = Pair('kato_10_1', 'tension'), reachable()
    pair.run(0.1)
    pair.core.aim(target)
    pair.run(0.5)
    pair.run(0.5, frozen=True)
    pair.run(0.1)
    assert pair.core.driver.released and pair.core.driver.dropped.same(target)
    pair.core.aim(replace(target, direction=None))
    pair.run(2.0)
    assert controller_status(pair.core, pair.now).code == 'reached'


def test_while_the_cause_is_there_a_target_is_refused_with_it():
    pair = Pair('kato_10_1', 'tension')
    pair.bent()
    pair.faults = (Fault('silent', 'motor 1: no answer', False, ('prox_left',)),)
    pair.run(0.5)
    pair.core.aim(pair.target(0.5))
    pair.run(0.1)
    said = controller_status(pair.core, pair.now)
    assert said.code == 'released'
    assert 'target refused: motor 1: no answer' in said.message
    pair.faults = ()
    pair.run(1.0)
    assert pair.code() == 'released'
    assert np.diff(pair.tightest).max() <= 1e-9


def test_a_twist_that_went_on_through_a_release_moves_nothing_until_it_was_let_go_of():
    pair = Pair('kato_10_1', 'tension')
    pair.bent()

    def twist(seconds, x):
        for _ in range(round(seconds / CYCLE)):
            pair.core.twist(pair.now, Twist(np.array([x, 0.0, 0.0]), np.zeros(3)))
            pair.run(CYCLE)

    twist(0.1, -0.02)
    assert pair.code() == 'jogging'
    pair.faults = (Fault('silent', 'no answer', False, ()),)
    twist(0.1, -0.02)
    pair.faults = ()
    pair.tightest.clear()
    twist(1.0, -0.02)
    assert pair.code() == 'released'
    assert np.diff(pair.tightest).max() <= 1e-9
    twist(0.05, 0.0)
    twist(0.05, -0.02)
    assert pair.code() == 'jogging'


def test_a_trajectory_is_played_after_a_release_from_where_the_arm_is():
    pair = Pair('kato_10_1', 'tension')
    pair.bent()
    CAUSES['motor silent'](pair)
    pair.run(0.1)
    pair.core.play(pair.now, Trajectory(np.array([0.5]), np.array([[0.3, 0.1, 0.1, 0.4]])))
    pair.run(1.0)
    assert pair.code() == 'played'
    assert pair.place == pytest.approx([0.3, 0.1, 0.1, 0.4])


def test_with_resume_it_goes_on_to_the_old_target_once_the_cause_is_gone():
    pair = Pair('kato_10_1', 'tension')
    pair.core.settings = Settings(resume=True)
    high = pair.bent()
    CAUSES['motor silent'](pair)
    pair.run(2.0)
    assert pair.code() == 'reached'
    assert pair.place.max() == pytest.approx(high, abs=1e-6)


def test_what_the_driver_said_before_it_was_reset_stops_nothing():
    """Its answer comes at once, its status somewhat later."""
    rig = standing()
    rig.core.driver_reports('', '', 1)
    rig.core.driver_reports('stop was called', 'stop was called', 2)
    rig.core.resumed()  # the driver has said so
    rig.core.reset()
    rig.core.driver_reports('stop was called', 'stop was called', 2)
    rig.core.aim(reachable())
    rig.run(1.0)
    assert rig.code() == 'reached'
    rig.core.driver_reports('stop was called', 'stop was called', 3)
    rig.run(0.1)
    assert rig.code() == 'driver_stopped'


def test_a_stop_of_a_driver_that_was_started_anew_counts():
    rig = standing()
    for why, count in (('', 0), ('stop was called', 1)):
        rig.core.driver_reports(why, why, count)
    rig.core.resumed()
    for why, count in (('', 0), ('stop was called', 1)):
        rig.core.driver_reports(why, why, count)
    rig.run(0.1)
    assert rig.code() == 'driver_stopped'


def refuse_a_target(rig):
    with pytest.raises(Refusal) as refusal:
        rig.core.aim(reachable())
    rig.core.refusals['target'] = refusal.value  # as the node does
    assert rig.code() in ('stopped', 'driver_stopped')


def test_a_refusal_because_of_a_stop_ends_with_it():
    rig = standing()
    rig.core.latch.stop('stop', 'stop was called')
    refuse_a_target(rig)
    rig.core.reset()
    rig.run(0.1)
    assert rig.code() == 'holding'
    rig.core.driver_reports('stop was called')
    refuse_a_target(rig)
    rig.core.driver_reports('')
    rig.run(0.1)
    assert rig.code() == 'holding'


def test_a_goal_ends_with_a_release_and_says_so_and_the_next_one_goes_on():
    pair = Pair('kato_10_1', 'tension')
    pair.run(0.1)
    goal = MotionGoal([replace(pair.target(), stamp='1')])
    goal.begin(pair.core, pair.now)
    pair.run(0.02)
    assert goal.update(pair.core, pair.now) is None
    CAUSES['motor silent'](pair)
    outcome = goal.update(pair.core, pair.now)
    assert outcome.code == 'ended'
    assert 'the driver let go: silent' in outcome.message
    pair.run(CYCLE)
    goal = MotionGoal([replace(pair.target(), stamp='2')])
    goal.begin(pair.core, pair.now)
    assert goal.update(pair.core, pair.now) is None
    pair.run(2.0)
    assert goal.update(pair.core, pair.now).code == ''
    CAUSES['motor silent'](pair)
    pair.core.play(pair.now, None)  # hold now: nothing is asked for
    pair.run(0.5)
    assert pair.code() == 'released'
