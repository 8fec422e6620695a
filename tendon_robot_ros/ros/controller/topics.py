"""
Topics of the controller: received messages, checked and in the base frame; its prediction.

Also the status of the driver, and the service of the driver that the controller calls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PointStamped, PoseStamped, TwistStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ...common.arrays import Floats
from ...control import Refusal, Target, Twist
from ...control.inputs import Trajectory, by_name, direction, finite, position
from ...data.tracker_faults import is_missing
from ...model.model import Model
from ...model.shape import Shape
from ...robot.estimates import natural_sizes
from ..shared import interface, messages
from ..shared.inbox import Answer
from ..shared.parameters import ParameterNode, base_frame
from ..shared.timing import SILENCE_S, VALUES_PERIOD_S

# [1] points of a trajectory: more would delay the commands while they are parsed
POINTS_MAX = 500


class Incoming:
    """Converts messages to targets, twists and states; Refusal: a message is invalid."""

    def __init__(self, node: ParameterNode, model: Model) -> None:
        """Create the transforms and use a model."""
        self._node, self._parameters = node, node.parameters
        self.pull = self._parameters['command_mode'] == 'pull'  # whether wire pulls are commanded
        self._frames = messages.Frames(node, '')
        self.use(model)

    def use(self, model: Model) -> None:
        """Use the names and limits of a model, and the frames named after its robot."""
        parameters, robot = self._parameters, model.robot
        self.base = base_frame(parameters, robot.name)
        self.tip = parameters['frame_prefix'] + (parameters['tip_frame'] or f'{robot.name}_tip')
        self._frames.base, self.model = self.base, model
        self._farthest = 1.5 * robot.length  # [m]

    def pose(self, message: PoseStamped, what: str = 'target_pose') -> Target:
        """Return a target with position and approach direction (+z of the orientation)."""
        along = direction(messages.xyzw(message.pose.orientation), what)
        place, rotation = self._place(message.header, message.pose.position, what)
        return Target(place, rotation @ along, messages.stamp_text(message.header.stamp))

    def point(self, message: PointStamped, what: str = 'target_point') -> Target:
        """Return a target with a position alone."""
        place, _ = self._place(message.header, message.point, what)
        return Target(place, stamp=messages.stamp_text(message.header.stamp))

    def measured_tip(self, message: PoseStamped) -> Floats:
        """Return a measured tip (3,) [m] in the base frame."""
        what = 'measured_tip'
        place, _ = self._place(message.header, message.pose.position, what)
        point = np.array(messages.xyz(message.pose.position))
        if is_missing(point):  # sent by trackers for a marker that is not visible
            raise Refusal('not_finite', f'{what}: {point.tolist()} says that it is not seen')
        return place

    def twist(self, message: TwistStamped) -> Twist:
        """Return a velocity [m/s, rad/s] in the axes of base or tip."""
        frame, axes, what = message.header.frame_id, np.eye(3), 'delta_twist'
        if frame == self.tip:
            messages.check_age(self._node, message.header, what)
        else:
            axes, _ = self._frames.of(message.header, what, self.tip)
        linear, angular = map(messages.xyz, (message.twist.linear, message.twist.angular))
        values = finite([*linear, *angular], what)
        if np.abs(values[:3]).max() > 1.0 or np.abs(values[3:]).max() > 10.0:
            expected = 'expected at most 1 m/s and 10 rad/s'
            raise Refusal('too_fast', f'{what}: {expected}, got {values.tolist()}')
        return Twist(axes @ values[:3], axes @ values[3:], frame == self.tip)

    def states(self, message: JointState) -> tuple[Floats, Floats]:
        """Return tensions (m,) [N] and wire pulls (m,) [m]; nan where not observable."""
        messages.check_age(self._node, message.header, 'tendon_states')
        tensions, pulls = messages.tensions_and_pulls(message, self.model.inputs)
        for quantity, values in (('effort', message.effort), ('position', message.position)):
            if any(map(math.isinf, values)):
                raise Refusal('not_finite', f'tendon_states: {quantity} is infinite')
        if not any(map(math.isfinite, (*message.effort, *message.position))):
            raise Refusal('not_finite', 'tendon_states: neither effort nor position is a number')
        return tensions, pulls

    def trajectory(self, message: JointTrajectory) -> Trajectory | None:
        """Return a trajectory of tensions, or of wire pulls in pull mode; None ends one."""
        what, pull = 'tendon_trajectory', self.pull
        messages.check_age(self._node, message.header, what)
        if not message.points:
            return None
        quantity = 'positions' if pull else 'effort'
        rows = [list(getattr(point, quantity)) for point in message.points]
        if not any(rows):
            mode = self._parameters['command_mode']
            raise Refusal(
                'mode', f'{what}: the controller is in {mode} mode: expected {quantity}, got none'
            )
        inputs = self.model.inputs
        if len(rows) > POINTS_MAX or len(set(map(len, rows))) > 1:
            raise Refusal(
                'length',
                f'{what}: expected at most {POINTS_MAX} points with {len(inputs)} values of '
                f'{quantity} each, got {len(rows)} points with {min(map(len, rows))} to '
                f'{max(map(len, rows))}',
            )
        by_name(message.joint_names, rows[0], inputs, what, quantity)
        order = [message.joint_names.index(name) for name in inputs]
        values = np.array(rows)[:, order]
        times = np.array([messages.seconds(point.time_from_start) for point in message.points])
        limits = None if pull else self.model.limits
        stamp = messages.stamp_text(message.header.stamp)
        return replace(Trajectory.checked(times, values, limits, inputs), stamp=stamp)

    def _place(self, header: Header, point: Point, what: str) -> tuple[Floats, Floats]:
        """
        Return a position (3,) [m] in the base frame, and the rotation (3, 3) to it.

        Refusal: it is farther than any tip of this robot.
        """
        rotation, shift = self._frames.of(header, what)
        place = rotation @ finite(messages.xyz(point), what) + shift
        return position(place.tolist(), self._farthest, what), rotation


class Prediction:
    """Publishes shape, tip and markers of the predicted arm."""

    def __init__(self, node: Node, arm: Incoming) -> None:
        """Create the publishers; `arm` has the model and the base frame."""
        self._node, self._arm = node, arm
        names = 'controller/predicted_shape', 'controller/predicted_tip', 'controller/markers'
        self._publishers = [
            messages.passing_publisher(node, *interface.topic(name)) for name in names
        ]

    def publish(self, shape: Shape) -> None:
        """Publish a shape; poses are the distal ends of the cells."""
        header, points = messages.header_now(self._node, self._arm.base), shape.positions
        thickness = 2.0 * natural_sizes(self._arm.model.robot)['radius']
        makers = (
            lambda: messages.pose_array(header, points, shape.frames),
            lambda: messages.pose_stamped(header, shape.tip_position, shape.frames[-1]),
            lambda: messages.arm_markers(header, points, thickness),
        )
        for publisher, make in zip(self._publishers, makers, strict=True):
            if publisher.get_subscription_count():
                publisher.publish(make())

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)


class DriverLink:
    """
    Receives the status of the driver; requests that it follows again after a release.

    Parameters
    ----------
    node : Node
    topic : str
        Of the status; empty: no link. The service has the same namespace.
    own : str
        Gid of this controller's commands; the status has that of the followed publisher.
    callback : callable
        Called with the arguments of `ControllerCore.driver_reports`.

    """

    def __init__(
        self, node: Node, topic: str, own: str, callback: Callable[[str, str, int, str], None]
    ) -> None:
        """Create subscription and client."""
        self.last = '', '', 0, ''
        self._own, self._callback = own, callback
        self._request: messages.Request | None = None
        self._answers: list[Answer] = []
        if topic:
            node.create_subscription(DiagnosticStatus, topic, self.receive, interface.LATCHED)
        if topic.endswith('/status'):
            service = topic.removesuffix('/status') + '/resume'
            self._request = messages.Request(node, Trigger, service)

    @property
    def another(self) -> str:
        """The publisher that the driver follows instead of this controller, '' for none."""
        return self.last[-1]

    @property
    def may_ask(self) -> bool:
        """Whether a request may be repeated: none is pending, and the last one is old enough."""
        request = self._request
        return request is not None and not request.waiting and request.age > VALUES_PERIOD_S

    def resume(self, answer: Answer) -> bool:
        """Request that the driver follows commands again; return False without a service."""
        if self._request is None or not self._request.ready:
            return False
        self._answers.append(answer)
        if not self._request.waiting:
            self._request.ask(
                Trigger.Request(),
                lambda response: self._answer(response.success, response.message),
            )
        return True

    def poll(self) -> None:
        """Drop a request without an answer."""
        request = self._request
        if request is not None and request.waiting and request.age > SILENCE_S:
            request.drop()
            self._answer(False, f'the driver does not answer within {SILENCE_S:g} s')

    def _answer(self, follows: bool, why: str) -> None:
        answers, self._answers = self._answers, []
        for answer in answers:
            answer(follows, why)

    def receive(self, message: DiagnosticStatus) -> None:
        """Parse the status of the driver and pass it on."""
        values = messages.status_values(message)
        stopped = values.get('reasons', message.message) if values.get('stopped') == 'true' else ''
        follows = values.get('follows_gid', '')
        another = '' not in (follows, self._own) and follows != self._own
        other = f'it follows {values.get("follows", follows)}' if another else ''
        releases = values.get('releases', '0')
        count = int(releases) if releases.isdecimal() else 0
        self.last = stopped, values.get('released', ''), count, other
        self._callback(*self.last)
