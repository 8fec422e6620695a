"""What comes in over the controller's topics, checked and brought into the base frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

from ...control import Refusal, Target, Twist
from ...control.checks import by_name, check_frame, check_stamp, direction, finite, position
from ...control.state import Trajectory
from ...data.tracker_faults import not_there
from ...model.model import Model
from ...robot import Robot
from ..shared.joints import Joints
from ..shared.messages import Frames, nanoseconds_now, seconds
from ..shared.parameters import Parameters

Array = NDArray[np.float64]
POINTS_MAX = 500  # of a trajectory: more would hold up the commands while they are read


class Incoming:
    """Turns messages into targets, twists and states; raises `Refusal`."""

    def __init__(self, node: Node, parameters: Parameters, model: Model) -> None:
        """Begin with a model."""
        self._node, self._parameters = node, parameters
        self._frames = Frames(node, '')
        self.use(model)

    def use(self, model: Model) -> None:
        """Know the names and limits of a model; frames are named after its robot."""
        parameters, robot = self._parameters, model.robot
        prefix = parameters['frame_prefix']
        self.base = prefix + (parameters['base_frame'] or f'{robot.name}_base')
        self.tip = prefix + (parameters['tip_frame'] or f'{robot.name}_tip')
        self._frames.base, self._model = self.base, model
        self._farthest = 1.5 * robot.length  # [m]

    @property
    def robot(self) -> Robot:
        """Whose frames they are."""
        return self._model.robot

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the tendons."""
        return self._model.inputs

    @property
    def pull(self) -> bool:
        """Whether wire pulls are commanded."""
        return bool(self._parameters['command_mode'] == 'pull')

    def pose(self, message: PoseStamped, what: str = 'target_pose') -> Target:
        """Return a target with position and approach direction (+z of the orientation)."""
        rotation, shift = self._header(message.header, what)
        p, q = message.pose.position, message.pose.orientation
        along = direction([q.x, q.y, q.z, q.w], what)
        place = rotation @ finite([p.x, p.y, p.z], what) + shift
        place = position(place.tolist(), self._farthest, what)
        return Target(place, rotation @ along, _text(message.header))

    def point(self, message: PointStamped, what: str = 'target_point') -> Target:
        """Return a target with a position alone."""
        rotation, shift = self._header(message.header, what)
        p = message.point
        place = rotation @ finite([p.x, p.y, p.z], what) + shift
        place = position(place.tolist(), self._farthest, what)
        return Target(place, stamp=_text(message.header))

    def measured_tip(self, message: PoseStamped) -> Array:
        """Return a measured tip [m]."""
        rotation, shift = self._header(message.header, 'measured_tip')
        p = message.pose.position
        seen = finite([p.x, p.y, p.z], 'measured_tip')
        if not_there(seen):  # what trackers send for a marker that they do not see
            raise Refusal('not_finite', f'measured_tip: {seen.tolist()} says that it is not seen')
        place = rotation @ seen + shift
        return position(place.tolist(), self._farthest, 'measured_tip')

    def twist(self, message: TwistStamped) -> Twist:
        """Return a velocity, in the axes of base or tip."""
        self._stamp(message.header, 'delta_twist')
        frame, axes = message.header.frame_id, np.eye(3)
        if frame != self.tip:
            try:
                axes, _ = self._to_base(message.header, 'delta_twist')
            except Refusal as refusal:
                if refusal.code == 'frame':
                    check_frame(frame, [self.base, self.tip], 'delta_twist')
                raise
        linear, angular = message.twist.linear, message.twist.angular
        values = finite(
            [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z], 'delta_twist'
        )
        if np.abs(values[:3]).max() > 1.0 or np.abs(values[3:]).max() > 10.0:
            raise Refusal(
                'too_fast',
                f'delta_twist: expected at most 1 m/s and 10 rad/s, got {values.tolist()}',
            )
        return Twist(axes @ values[:3], axes @ values[3:], frame == self.tip)

    def states(self, message: Joints) -> tuple[Array, Array]:
        """Return tensions [N] and wire pulls [m]; nan where not observable."""
        self._fresh(message.stamp, 'tendon_states')
        inputs, names = self._model.inputs, message.names
        found = []
        for quantity, values in (('effort', message.effort), ('position', message.position)):
            values = values or [np.nan] * len(names)
            found.append(by_name(names, values, inputs, 'tendon_states', quantity))
            if any(map(math.isinf, values)):
                raise Refusal('not_finite', f'tendon_states: {quantity} is infinite')
        tensions, pulls = found
        if not any(map(math.isfinite, (*message.effort, *message.position))):
            raise Refusal('not_finite', 'tendon_states: neither effort nor position is a number')
        return tensions, pulls

    def trajectory(self, message: JointTrajectory) -> Trajectory | None:
        """Return a trajectory of tensions, or of wire pulls in pull mode; None ends one."""
        what, pull = 'tendon_trajectory', self.pull
        self._stamp(message.header, what)
        if not message.points:
            return None
        quantity = 'positions' if pull else 'effort'
        rows = [list(getattr(point, quantity)) for point in message.points]
        if not any(rows):
            mode = self._parameters['command_mode']
            raise Refusal(
                'mode', f'{what}: the controller is in {mode} mode: expected {quantity}, got none'
            )
        inputs = self._model.inputs
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
        times = np.array([seconds(point.time_from_start) for point in message.points])
        limits = None if pull else self._model.limits
        return replace(
            Trajectory.checked(times, values, limits, inputs), stamp=_text(message.header)
        )

    def _header(self, header: Header, what: str) -> tuple[Array, Array]:
        self._stamp(header, what)
        return self._to_base(header, what)

    def _to_base(self, header: Header, what: str) -> tuple[Array, Array]:
        now = 1e-9 * nanoseconds_now(self._node)
        stamp, tolerance = seconds(header.stamp), self._parameters['stamp_tolerance']
        return self._frames.to_base(header.frame_id, what, stamp, now, tolerance)

    def _stamp(self, header: Header, what: str) -> None:
        self._fresh(seconds(header.stamp), what)

    def _fresh(self, stamp: float, what: str) -> None:
        now = 1e-9 * nanoseconds_now(self._node)
        check_stamp(stamp, now, self._parameters['stamp_tolerance'], what)


def _text(header: Header) -> str:
    return f'{header.stamp.sec}.{header.stamp.nanosec:09d}'
