"""The action servers over real ROS: goal, feedback, result, cancel; and what their types say."""

import os
import sys
import time
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('test_msgs')
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from control_rig import Rig, model
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Header
from test_msgs.action import Fibonacci
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tendon_robot_ros.control import Refusal
from tendon_robot_ros.control.inputs import Trajectory
from tendon_robot_ros.control.status import GoalOutcome, MotionGoal, Progress
from tendon_robot_ros.ros.controller import actions
from tendon_robot_ros.ros.controller.topics import Incoming
from tendon_robot_ros.ros.shared.runtime import make_executor, repeat

pytestmark = pytest.mark.ros
BASE = 'kato_10_1_base'
END = (1.1, 0.1, 0.1, 0.6)
TIMEOUT = 30.0  # [s] for anything to happen, on a busy machine


@dataclass
class Tenths:
    """Plays a trajectory of so many tenths of a second; feedback and result are sequences."""

    type: type

    def goal(self, request, incoming, stamp):
        if request.order <= 0:
            raise Refusal('times', f'order: expected more than 0, got {request.order}')
        return MotionGoal([Trajectory(np.array([0.1 * request.order]), np.array([END]), stamp)])

    def feedback(self, progress, header):
        return self.type.Feedback(sequence=[int(1e3 * progress.remaining)])

    def result(self, outcome):
        return self.type.Result(sequence=[len(outcome.code)])


class Bench:
    """A node with the actions, a core that a cycle drives, and a client in a node of its own."""

    def __init__(self):
        self.node, self.rig = Node('controller', namespace='/actions'), Rig(rate_limit=50.0)
        self.rig.run(0.1)  # a driver is heard
        self.actions = actions.Actions(self.node)
        incoming = SimpleNamespace(base=BASE)
        self.active = True

        def cycle():
            if self.active:
                self.actions.serve(self.rig.now, self.rig.core, incoming)
            else:
                self.actions.drop('the controller is not active')
            self.rig.run(0.005)

        self.executor = make_executor()
        self.executor.add_node(self.node)
        repeat(self.node, 0.005, cycle)
        self.user = Node('user', namespace='/actions')
        self.user_executor = SingleThreadedExecutor()
        self.user_executor.add_node(self.user)
        self.client = ActionClient(self.user, Fibonacci, 'controller/tenths')
        self.feedback = []
        self.until(self.client.server_is_ready)

    def until(self, condition):
        end = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < end
            self.executor.spin_once(timeout_sec=0.01)
            self.user_executor.spin_once(timeout_sec=0.001)

    def answer(self, future):
        self.until(future.done)
        return future.result()

    def send(self, order):
        self.feedback.clear()
        hear = self.feedback.append
        handle = self.answer(
            self.client.send_goal_async(Fibonacci.Goal(order=order), feedback_callback=hear)
        )
        assert handle.accepted
        return handle

    def close(self):
        for executor, node in ((self.executor, self.node), (self.user_executor, self.user)):
            executor.shutdown()
            node.destroy_node()


@pytest.fixture(scope='module')
def bench():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(actions, 'OFFERED', (('tenths', 'test_msgs', 'Fibonacci', Tenths),))
        if not rclpy.ok():
            rclpy.init()
        made = Bench()
        yield made
        made.close()
        rclpy.try_shutdown()


def test_a_goal_is_played_with_feedback_and_succeeds(bench):
    handle = bench.send(5)
    answer = bench.answer(handle.get_result_async())
    assert (answer.status, list(answer.result.sequence)) == (GoalStatus.STATUS_SUCCEEDED, [0])
    left = [message.feedback.sequence[0] for message in bench.feedback]
    assert len(left) >= 3
    assert left == sorted(left, reverse=True)
    assert bench.rig.tensions == pytest.approx(END)


def test_a_cancelled_goal_holds(bench):
    bench.rig.core.play(bench.rig.now, Trajectory(np.array([0.1]), np.full((1, 4), 0.1)))
    bench.until(lambda: bench.rig.code() == 'played')
    handle = bench.send(100)
    bench.until(lambda: len(bench.feedback) > 2)
    assert len(bench.answer(handle.cancel_goal_async()).goals_canceling) == 1
    assert bench.answer(handle.get_result_async()).status == GoalStatus.STATUS_CANCELED
    assert bench.rig.code() == 'holding'
    assert np.all(bench.rig.tensions[0] < END[0])


def test_a_new_goal_takes_the_place_of_the_one_before(bench):
    first = bench.send(100)
    bench.until(lambda: bench.feedback)
    second = bench.send(2)
    answer = bench.answer(first.get_result_async())
    assert (answer.status, list(answer.result.sequence)) == (GoalStatus.STATUS_ABORTED, [5])
    assert bench.answer(second.get_result_async()).status == GoalStatus.STATUS_SUCCEEDED


def test_a_refused_goal_ends_with_the_reason_and_leaves_the_one_before(bench):
    first = bench.send(4)
    refused = bench.answer(bench.send(0).get_result_async())
    assert (refused.status, list(refused.result.sequence)) == (GoalStatus.STATUS_ABORTED, [5])
    assert bench.answer(first.get_result_async()).status == GoalStatus.STATUS_SUCCEEDED


def test_goals_end_where_the_controller_commands_nothing(bench):
    handle = bench.send(100)
    bench.until(lambda: bench.feedback)
    bench.active = False
    answer = bench.answer(handle.get_result_async())
    assert answer.status == GoalStatus.STATUS_ABORTED
    bench.active = True


def test_waiting_for_a_goal_costs_next_to_nothing(bench):
    handle = bench.send(100)
    bench.rig.run = lambda seconds: None  # only the waiting counts
    began, end = time.process_time(), time.monotonic() + 0.5
    while time.monotonic() < end:
        bench.executor.spin_once(timeout_sec=0.05)
    del bench.rig.run
    assert time.process_time() - began < 0.15
    bench.answer(handle.cancel_goal_async())
    bench.answer(handle.get_result_async())


def test_types_that_are_not_installed_are_named_with_what_to_install(bench, monkeypatch):
    said = []
    logger = SimpleNamespace(info=said.append)
    kinds = tuple((name, f'no_{package}', kind, make) for name, package, kind, make in
                  (('follow', 'control_msgs', 'X', Tenths), ('go', 'nav2_msgs', 'Y', Tenths),
                   ('go_on', 'nav2_msgs', 'Z', Tenths)))  # fmt: skip
    monkeypatch.setattr(actions, 'OFFERED', kinds)
    actions.Actions(SimpleNamespace(get_logger=lambda: logger))
    assert said == [
        'actions of no_control_msgs and no_nav2_msgs are not offered: they are not installed: '
        'apt install ros-jazzy-no-control-msgs ros-jazzy-no-nav2-msgs'
    ]


# -----------------------------------------------------------------------------
# What is read of control_msgs and nav2_msgs, which come with ROS only: fields as in their files.


def incoming(bench, **parameters):
    given = {'frame_prefix': '', 'base_frame': '', 'tip_frame': '', 'stamp_tolerance': 1.0,
             'command_mode': 'tension', **parameters}  # fmt: skip
    bench.node.parameters = given
    return Incoming(bench.node, model())


@dataclass
class Feedback:
    header: Header = None
    joint_names: list = None
    desired: JointTrajectoryPoint = None
    actual: JointTrajectoryPoint = None
    error: JointTrajectoryPoint = None


@dataclass
class PoseFeedback:
    navigation_time: Duration
    estimated_time_remaining: Duration
    distance_remaining: float
    current_pose: PoseStamped = field(default_factory=PoseStamped)
    number_of_poses_remaining: int = 0


@dataclass
class Result:
    error_code: int = 0
    error_string: str = ''


@dataclass
class PoseResult:
    error_code: int = 0
    error_msg: str = ''


def follow_request(field_of_values, values, **more):
    point = JointTrajectoryPoint(time_from_start=Duration(sec=2))
    setattr(point, field_of_values, list(values))
    return SimpleNamespace(
        trajectory=JointTrajectory(joint_names=list(model().inputs), points=[point]),
        multi_dof_trajectory=SimpleNamespace(points=[]),
        path_tolerance=more.get('path', []), goal_tolerance=more.get('goal', []),
        goal_time_tolerance=Duration(sec=more.get('time', 0)),
    )  # fmt: skip


def tolerance(name, position):
    return SimpleNamespace(name=name, position=position)


def test_a_tendon_trajectory_is_read_and_its_feedback_and_result_are_written(bench):
    kind = actions.TendonTrajectory(SimpleNamespace(Feedback=Feedback, Result=Result))
    goal = kind.goal(follow_request('effort', END), incoming(bench), 'id')
    assert (goal.step.stamp, goal.tolerance) == ('id', None)
    assert goal.step.values.tolist() == [list(END)]
    desired, actual = np.array(END), np.array([1.0, 0.1, np.nan, 0.6])
    told = kind.feedback(Progress(0.5, 1.5, 1, desired=desired, actual=actual), Header())
    assert list(told.desired.effort) == list(END)
    assert np.array(told.error.effort) == pytest.approx(desired - actual, nan_ok=True)
    assert told.desired.time_from_start == Duration(nanosec=500_000_000)
    assert told.header.frame_id == ''
    for code, number in (('', 0), ('names', -2), ('stale', -3), ('path_tolerance', -4), ('x', -1)):
        assert kind.result(GoalOutcome(code, 'why')) == Result(number, 'why')


def test_tolerances_are_of_wire_pulls(bench):
    kind = actions.TendonTrajectory(None)
    first, last = model().inputs[0], model().inputs[-1]
    pulls = follow_request(
        'positions', [0.0] * 4, path=[tolerance(first, 1e-3)],
        goal=[tolerance(last, 2e-3), tolerance(first, -1.0)], time=3,
    )  # fmt: skip
    read = kind.goal(pulls, incoming(bench, command_mode='pull'), 'id').tolerance
    assert read.path.tolist() == [1e-3, np.inf, np.inf, np.inf]
    assert read.goal.tolist() == [np.inf, np.inf, np.inf, 2e-3]
    assert read.time == 3.0
    with pytest.raises(Refusal, match="path_tolerance: unknown 'a'; expected one of prox_left"):
        kind.goal(
            follow_request('positions', [0.0] * 4, path=[tolerance('a', 1.0)]),
            incoming(bench, command_mode='pull'), 'id',
        )  # fmt: skip
    tension = follow_request('effort', END, goal=[tolerance(first, 1.0)])
    with pytest.raises(Refusal, match='they are of positions'):
        kind.goal(tension, incoming(bench), 'id')


def test_poses_are_read_with_or_without_a_direction(bench):
    kind = actions.TipPoses(SimpleNamespace(Feedback=PoseFeedback, Result=PoseResult))
    place = Point(x=0.06, z=0.17)
    header = Header(frame_id=BASE)
    free = PoseStamped(header=header, pose=Pose(position=place, orientation=Quaternion(w=0.0)))
    up = PoseStamped(header=header, pose=Pose(position=place))
    goal = kind.goal(SimpleNamespace(poses=[free, up]), incoming(bench), 'id')
    assert [step.stamp for step in goal.steps] == ['id/1', 'id/2']
    assert goal.steps[0].direction is None
    assert goal.steps[1].direction == pytest.approx([0, 0, 1])
    one = kind.goal(SimpleNamespace(pose=free), incoming(bench), 'id')
    assert one.steps[0].position == pytest.approx([0.06, 0, 0.17])
    progress = Progress(1.0, 0.5, 2, np.array([0.0, 0.0, 0.2]), np.eye(3), 0.06)
    told = kind.feedback(progress, header)
    assert (told.distance_remaining, told.number_of_poses_remaining) == (0.06, 2)
    assert told.current_pose.pose.position == Point(z=0.2)
    assert kind.result(GoalOutcome('nearest', 'why')) == PoseResult(1, 'why')


@pytest.mark.parametrize(
    ('request_', 'says'),
    [
        (SimpleNamespace(poses=[]), 'poses: expected some'),
        (SimpleNamespace(pose=PoseStamped(header=Header(frame_id='map'))), "pose: frame 'map'"),
    ],
)
def test_poses_that_cannot_be_are_refused(bench, request_, says):
    with pytest.raises(Refusal, match=says):
        actions.TipPoses(None).goal(request_, incoming(bench), 'id')
