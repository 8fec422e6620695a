"""
Actions: goals with feedback, result and cancel, for scripts and behaviour trees.

~/follow_joint_trajectory (control_msgs), ~/navigate_to_pose and ~/navigate_through_poses
(nav2_msgs): offered where the package of the type is installed. control/status.py pursues a goal;
this module only converts messages.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import PointStamped
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.node import Node
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from ...control import ControllerCore, Refusal
from ...control.status import GoalOutcome, MotionGoal, Progress, Tolerance
from ..shared.interface import declared
from ..shared.messages import duration, header_now, pose_stamped, seconds, xyzw
from ..shared.timing import VALUES_PERIOD_S
from .topics import Incoming


class Converter:
    """
    Converts the messages of an action; a subclass has `goal` and `feedback`, too.

    Attributes
    ----------
    codes : dict
        error_code of a goal, by the code of its outcome ('': reached; None: any other), as in
        docs/ros_nodes.md.

    """

    codes: ClassVar[dict[str | None, int]]

    def __init__(self, kind: Any) -> None:
        """Keep the type."""
        self.type = kind

    def result(self, outcome: GoalOutcome) -> Any:
        """Return the result message of a goal."""
        message, why = self.type.Result(), outcome.message
        code = self.codes.get(outcome.code, self.codes[None])
        _fill(message, error_code=code, error_string=why, error_msg=why)
        return message


class TendonTrajectory(Converter):
    """control_msgs/FollowJointTrajectory: tensions [N] in `effort`, or wire pulls [m]."""

    codes: ClassVar = {
        None: -1,  # INVALID_GOAL
        '': 0,
        'canceled': 0,  # the status of the goal has it, as with joint_trajectory_controller
        'names': -2,  # INVALID_JOINTS
        'stale': -3,  # OLD_HEADER_TIMESTAMP
        'path_tolerance': -4,  # PATH_TOLERANCE_VIOLATED
        'goal_tolerance': -5,  # GOAL_TOLERANCE_VIOLATED
    }

    def goal(self, request: Any, incoming: Incoming, stamp: str) -> MotionGoal:
        """Return the goal of a request; Refusal: it is invalid."""
        if request.multi_dof_trajectory.points:
            raise Refusal('length', 'multi_dof_trajectory: expected none, tendons have one axis')
        playing = incoming.trajectory(request.trajectory)
        if playing is None:
            raise Refusal('length', 'trajectory: expected points, got none')
        inputs, pull = incoming.model.inputs, incoming.pull
        self._inputs, self._pull, tolerance = inputs, pull, None
        tolerances = [*request.path_tolerance, *request.goal_tolerance]
        if not pull and any(one.position > 0.0 for one in tolerances):
            raise Refusal(
                'mode',
                'path_tolerance, goal_tolerance: they are of positions; expected none, or a '
                'controller in pull mode',
            )
        if pull:
            allowed = {}
            for what in ('path_tolerance', 'goal_tolerance'):
                allowed[what] = np.full(len(inputs), np.inf)
                for one in getattr(request, what):
                    if one.name not in inputs:
                        known = ', '.join(inputs)
                        raise Refusal(
                            'names', f'{what}: unknown {one.name!r}; expected one of {known}'
                        )
                    if one.position > 0.0:  # 0: not given, -1: erased; there is no default
                        allowed[what][inputs.index(one.name)] = one.position
            late = seconds(request.goal_time_tolerance) or np.inf
            tolerance = Tolerance(allowed['path_tolerance'], allowed['goal_tolerance'], late)
        return MotionGoal([replace(playing, stamp=stamp)], tolerance)

    def feedback(self, progress: Progress, header: Header) -> Any:
        """Return the feedback message of a goal."""
        quantity, passed = 'positions' if self._pull else 'effort', duration(progress.passed)
        desired, actual = progress.desired, progress.actual
        rows = {'desired': desired, 'actual': actual, 'error': desired - actual}
        points = {
            name: JointTrajectoryPoint(time_from_start=passed, **{quantity: values.tolist()})
            for name, values in rows.items()
        }
        header = Header(stamp=header.stamp)  # joints have no frame
        return self.type.Feedback(header=header, joint_names=list(self._inputs), **points)


class TipPoses(Converter):
    """
    nav2_msgs/NavigateToPose and NavigateThroughPoses: poses of the tip, each to be reached.

    An orientation of zeros requests a position alone.
    """

    # those of nav2 itself begin at 100
    codes: ClassVar = {None: 3, '': 0, 'nearest': 1, 'at_limit': 1, 'ended': 2, 'canceled': 2}

    def goal(self, request: Any, incoming: Incoming, stamp: str) -> MotionGoal:
        """Return the goal of a request; Refusal: it is invalid."""
        many = hasattr(request, 'poses')
        poses = getattr(request.poses, 'goals', request.poses) if many else [request.pose]
        if not poses:
            raise Refusal('length', 'poses: expected some, got none')
        targets = []
        for i, one in enumerate(poses):
            what = f'pose {i + 1} of {len(poses)}' if many else 'pose'
            if any(xyzw(one.pose.orientation)):
                target = incoming.pose(one, what)
            else:
                point = PointStamped(header=one.header, point=one.pose.position)
                target = incoming.point(point, what)
            targets.append(replace(target, stamp=f'{stamp}/{i + 1}'))
        return MotionGoal(targets)

    def feedback(self, progress: Progress, header: Header) -> Any:
        """Return the feedback message of a goal."""
        message = self.type.Feedback(
            navigation_time=duration(progress.passed),
            estimated_time_remaining=duration(progress.remaining),
            distance_remaining=float(np.nan_to_num(progress.distance)),
        )
        if progress.tip is not None and progress.frame is not None:
            message.current_pose = pose_stamped(header, progress.tip, progress.frame)
        _fill(message, number_of_poses_remaining=progress.steps_remaining)
        return message


def _fill(message: Any, **values: object) -> None:
    """Set the fields that this version of the type has."""
    for name, value in values.items():
        if hasattr(message, name):
            setattr(message, name, value)


ActionKind = TendonTrajectory | TipPoses
# what converts the messages of an action, by the package of its type
CONVERTERS: dict[str, type[ActionKind]] = {'control_msgs': TendonTrajectory, 'nav2_msgs': TipPoses}
# name, package and type of an action, and what converts its messages
OFFERED = tuple(
    (name.removeprefix('controller/'), package, kind, CONVERTERS[package])
    for name, action in declared()['actions'].items()
    for package, kind in [action['type'].split('/')]
)


class CycledServer(ActionServer):
    """
    An action server whose goals are served by the cycle of its node.

    In rclpy a coroutine waits for the end of every goal, and its executors poll it without pause:
    a third of a processor.
    """

    def __init__(self, node: Node, kind: Any, name: str, accepted: Callable[[Any], None]) -> None:
        """Create the server."""
        super().__init__(
            node,
            kind,
            name,
            execute_callback=lambda handle: None,  # never called: `notify_execute`
            handle_accepted_callback=accepted,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )

    def notify_execute(self, goal_handle: Any, execute_callback: Any) -> None:
        """Execute a callback only for the end of a goal."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)

    def end(self, handle: Any, result: Any) -> None:
        """Send the result of a goal that has ended."""
        self.notify_execute(handle, lambda _: result)


@dataclass
class ActiveGoal:
    """A goal of a client that is being pursued."""

    server: CycledServer
    kind: ActionKind
    handle: Any
    goal: MotionGoal | None = None  # until the next cycle reads it
    feedback_at: float = -np.inf  # [s] when feedback was sent


class Actions:
    """The action servers of the controller, and the goals that they pursue."""

    def __init__(self, node: Node) -> None:
        """Create the servers of the action types that can be imported."""
        self._node = node
        self._active: list[ActiveGoal] = []
        missing = {}
        for name, package, kind, make in OFFERED:
            try:
                kind_of = getattr(importlib.import_module(f'{package}.action'), kind)
            except ImportError:
                missing[package] = f'ros-jazzy-{package.replace("_", "-")}'
            else:
                self._offer(name, make(kind_of))
        if missing:
            node.get_logger().info(
                f'actions of {" and ".join(missing)} are not offered: they are not installed: '
                f'apt install {" ".join(missing.values())}'
            )

    def _offer(self, name: str, kind: ActionKind) -> None:
        def accepted(handle: Any) -> None:
            handle.execute()
            self._active.append(ActiveGoal(server, kind, handle))

        server = CycledServer(self._node, kind.type, f'~/{name}', accepted)

    def serve(self, now: float, core: ControllerCore, incoming: Incoming) -> None:
        """Start new goals, update the others, end finished ones; called once per cycle."""
        for active in list(self._active):
            if active.handle.is_cancel_requested:
                if active.goal is not None:
                    active.goal.cancel(core, now)
                self._end(active, GoalOutcome('canceled', 'canceled; the arm holds'))
            elif active.goal is None:
                try:  # a refused goal changes nothing
                    stamp = bytes(active.handle.goal_id.uuid).hex()
                    active.goal = active.kind.goal(active.handle.request, incoming, stamp)
                    active.goal.begin(core, now)
                except Refusal as refusal:
                    self._end(active, GoalOutcome(refusal.code, str(refusal)))
            elif (outcome := active.goal.update(core, now)) is not None:
                self._end(active, outcome)
            elif now - active.feedback_at >= VALUES_PERIOD_S:
                active.feedback_at = now
                header = header_now(self._node, incoming.base)
                progress = active.goal.progress(core, now)
                active.handle.publish_feedback(active.kind.feedback(progress, header))

    def drop(self, reason: str) -> None:
        """Abort all goals: the controller commands nothing."""
        for active in list(self._active):
            self._end(active, GoalOutcome('ended', reason))

    def _end(self, active: ActiveGoal, outcome: GoalOutcome) -> None:
        self._active.remove(active)
        handle = active.handle
        if handle.is_cancel_requested:
            handle.canceled()
        elif outcome.code:
            handle.abort()
        else:
            handle.succeed()
        active.server.end(handle, active.kind.result(outcome))
