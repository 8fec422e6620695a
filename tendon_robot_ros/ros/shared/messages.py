"""Messages to arrays and back, their frames; requests to services."""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, Vector3
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time import Time as ClockTime
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from ...common.arrays import Floats
from ...common.colours import BAD, PREDICTED, rgb
from ...common.errors import TendonRobotError
from ...common.rotations import from_quaternion, quaternions
from ...control.inputs import Refusal, by_name, check_stamp, cut
from .interface import Callback
from .timing import ANSWER_TIMEOUT_S


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def stamp_text(stamp: Time) -> str:
    """Return a stamp as text, as in a status: seconds with nine decimals."""
    return f'{stamp.sec}.{stamp.nanosec:09d}'


def stamp_now(node: Node) -> Time:
    """Return the time of a node's clock as a stamp; the Time object of rclpy costs more."""
    clock = node.get_clock().handle
    with clock:
        sec, nanosec = divmod(int(clock.get_now().nanoseconds), 10**9)
    return Time(sec=sec, nanosec=nanosec)


def time_now(node: Node) -> float:
    """Return the time of a node's clock [s]."""
    return seconds(stamp_now(node))


def duration(time: float) -> Duration:
    """Return a time [s] as a message."""
    sec, nanosec = divmod(round(1e9 * time), 10**9)
    return Duration(sec=sec, nanosec=nanosec)


def quaternion(rotation: Floats) -> Quaternion:
    """Return the quaternion of a rotation matrix, shape (3, 3)."""
    return quaternion_messages(rotation[None])[0]


def quaternion_messages(rotations: Floats) -> list[Quaternion]:
    """Return the quaternions of rotation matrices (n, 3, 3)."""
    return [Quaternion(x=x, y=y, z=z, w=w) for x, y, z, w in quaternions(rotations).tolist()]


def matrix(message: Quaternion) -> Floats:
    """Return the rotation matrix (3, 3) of a quaternion message."""
    return from_quaternion(xyzw(message))


def xyz(message: Point | Vector3) -> list[float]:
    """Return the components of a point or a vector."""
    return [message.x, message.y, message.z]


def vector(values: Iterable[float], kind: Any = Vector3) -> Any:
    """Return a vector with these components, or another message that has x, y and z."""
    x, y, z = map(float, values)
    return kind(x=x, y=y, z=z)


point = partial(vector, kind=Point)


def xyzw(message: Quaternion) -> list[float]:
    """Return the components of a quaternion."""
    return [message.x, message.y, message.z, message.w]


def pose_array(header: Header, positions: Floats, rotations: Floats | None = None) -> PoseArray:
    """Return poses of positions (n, 3) [m] and rotation matrices (n, 3, 3); None: unrotated."""
    array = PoseArray(header=header, poses=[Pose(position=point(p)) for p in positions])
    if rotations is not None:
        for one, orientation in zip(array.poses, quaternion_messages(rotations), strict=True):
            one.orientation = orientation
    return array


def points_of(message: PoseArray) -> Floats:
    """Return the positions (n, 3) [m] of poses."""
    return np.array([xyz(one.position) for one in message.poses], dtype=float).reshape(-1, 3)


def pose_stamped(header: Header, position: Floats, rotation: Floats) -> PoseStamped:
    """Return a stamped pose."""
    pose = Pose(position=point(position), orientation=quaternion(rotation))
    return PoseStamped(header=header, pose=pose)


def header_now(node: Node, frame: str = '') -> Header:
    """Return a header of a frame at the present time of a node's clock."""
    return Header(frame_id=frame, stamp=stamp_now(node))


def refilled(
    message: JointState, stamp: Time, position: Floats | None, effort: Floats | None
) -> JointState:
    """
    Fill a joint message with new values and return it: cheaper than a new message.

    Of tendons, position is the wire pull [m] and effort the tension [N].
    """
    message.header.stamp = stamp
    message.position = () if position is None else position.tolist()
    message.effort = () if effort is None else effort.tolist()
    return message


def tensions_and_pulls(message: JointState, inputs: Sequence[str]) -> tuple[Floats, Floats]:
    """
    Return tensions (m,) [N] and wire pulls (m,) [m] in the order of the inputs.

    Missing values are nan. Refusal: other names, or another number of values.
    """
    names, blank, what = message.name, [math.nan] * len(message.name), 'tendon_states'
    tensions = by_name(names, message.effort or blank, inputs, what, 'effort')
    pulls = by_name(names, message.position or blank, inputs, what, 'position')
    return tensions, pulls


def status_values(message: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by their keys."""
    return {item.key: item.value for item in message.values}


def arm_markers(header: Header, positions: Floats, thickness: float) -> MarkerArray:
    """Return a line from the base through positions (n, 3) [m], and a ball at the tip."""
    points = [Point(), *map(point, positions)]
    line = _marker(header, 'predicted', PREDICTED, type=Marker.LINE_STRIP, points=points)
    line.scale.x = thickness
    tip = _marker(header, 'predicted', PREDICTED, id=1, type=Marker.SPHERE)
    tip.pose.position = points[-1]
    tip.scale.x = tip.scale.y = tip.scale.z = 2.0 * thickness
    return MarkerArray(markers=[line, tip])


def contact_marker(header: Header, ends: Floats | None, thickness: float) -> MarkerArray:
    """Return an arrow from its first end (2, 3) [m] to the second; None: what takes it away."""
    arrow = _marker(header, 'contact', BAD, type=Marker.ARROW)
    arrow.action = Marker.DELETE if ends is None else Marker.ADD
    arrow.points = [] if ends is None else [point(end) for end in ends]
    arrow.scale.x, arrow.scale.y = thickness, 2.0 * thickness
    return MarkerArray(markers=[arrow])


def _marker(header: Header, name: str, color: str, **fields: Any) -> Marker:
    red, green, blue = (level / 255.0 for level in rgb(color))
    shade = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    marker = Marker(header=header, ns=name, color=shade, **fields)
    marker.pose.orientation.w = 1.0
    return marker


def check_age(node: Any, header: Header, what: str) -> float:
    """
    Return the time of the node's clock [s].

    Refusal: the stamp is older, or further in the future, than the node's `stamp_tolerance` [s].
    """
    now = time_now(node)
    check_stamp(seconds(header.stamp), now, node.parameters['stamp_tolerance'], what)
    return now


class Frames:
    """
    Transforms from the frames of messages to the base frame, by TF.

    Messages and transforms are as old as the parameter `stamp_tolerance` of the node [s] at most;
    a static transform has no age.
    """

    def __init__(self, node: Any, base: str) -> None:
        """Listen to TF where tf2_ros is installed (the wheels of rclpy do not have it)."""
        self._node, self.base = node, base
        self._buffer: Any = None
        if importlib.util.find_spec('tf2_ros') is not None:
            from tf2_ros import Buffer, TransformListener

            self._buffer = Buffer()
            self._listener = TransformListener(self._buffer, node)

    def of(self, header: Header, what: str, *others: str) -> tuple[Floats, Floats]:
        """
        Return rotation (3, 3) and translation (3,) [m] of a message to the base frame.

        Parameters
        ----------
        header : Header
            Its stamp of 0 means now.
        what : str
            Name of the message.
        others : str
            Frames that would do besides the base, for the refusal.

        Raises
        ------
        Refusal
            The message is old, or there is no transform of its time between the two frames.

        """
        now, stamp = check_age(self._node, header, what), seconds(header.stamp)
        if (frame := header.frame_id) == self.base:
            return np.eye(3), np.zeros(3)
        try:
            newest = self._buffer.lookup_transform(self.base, frame, ClockTime())
            at = seconds(newest.header.stamp)
            if 0.0 < stamp < at:
                of_then = ClockTime(nanoseconds=round(1e9 * stamp))
                newest = self._buffer.lookup_transform(self.base, frame, of_then)
            transform = newest.transform
        except Exception:  # no buffer, or whatever tf2 raises: no transform
            known = ' or '.join(map(repr, [self.base, *others]))
            raise Refusal(
                'frame',
                f'{what}: frame {cut(frame)!r}, expected {known} '
                '(no transform between the two is known)',
            ) from None
        age, tolerance = (stamp or now) - at, self._node.parameters['stamp_tolerance']
        if at > 0.0 and age > tolerance:
            raise Refusal(
                'stale',
                f'{what}: the newest transform from {cut(frame)!r} to {self.base!r} is '
                f'{age:.3g} s old, expected at most {tolerance:g} s; does its publisher run?',
            )
        return matrix(transform.rotation), np.array(xyz(transform.translation))


def passing_publisher(node: Node, kind: Any, topic: str, qos: QoSProfile) -> Publisher:
    """
    Create a publisher that may be destroyed while its node runs.

    It has no callbacks for events of the middleware: if one is pending (an endpoint with another
    quality of service or type) when it is destroyed, rclpy's executor of events ends or crashes.
    """
    quiet = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(kind, topic, qos, event_callbacks=quiet)


def passing_subscription(
    node: Node, kind: Any, topic: str, callback: Callback, qos: QoSProfile, raw: bool = False
) -> Subscription:
    """Create a subscription that may be destroyed while its node runs, as a publisher."""
    quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
    return node.create_subscription(kind, topic, callback, qos, raw=raw, event_callbacks=quiet)


def attempted(act: Callable[[], str]) -> tuple[bool, str]:
    """Return whether an action succeeds, and its text or that of its TendonRobotError."""
    try:
        return True, act()
    except TendonRobotError as error:
        return False, ' '.join(str(error).split())


def offer_trigger(
    node: Node,
    name: str,
    act: Callable[[], str],
    then: Callable[[str], object] = lambda text: None,
) -> None:
    """
    Offer a Trigger service whose response is the text that an action returns.

    A TendonRobotError of the action refuses the request, with its text; `then` is called with the
    text of either.
    """

    def respond(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = attempted(act)
        then(response.message)
        return response

    node.create_service(Trigger, name, respond)


class Request:
    """A request to a service that may be repeated or dropped; a new one replaces it."""

    def __init__(self, node: Node, kind: Any, service: str) -> None:
        """Create the client."""
        self._client = node.create_client(kind, service)
        self.name = str(self._client.srv_name)  # in full
        self._future: Future | None = None
        self._sent_at = float('-inf')

    @property
    def waiting(self) -> bool:
        """Return whether an answer is pending."""
        return self._future is not None

    @property
    def age(self) -> float:
        """The time [s] since it was sent."""
        return time.monotonic() - self._sent_at

    @property
    def ready(self) -> bool:
        """Whether the service exists."""
        return bool(self._client.service_is_ready())

    def ask(self, request: object, answer: Callable[[Any], object]) -> bool:
        """Send a request; return whether the service exists."""
        self.drop()
        if not self.ready:
            return False
        self._asked, self._sent_at = (request, answer), time.monotonic()
        future = self._future = self._client.call_async(request)

        def done(answered: Future) -> None:
            if answered is self._future:
                self._future = None
                answer(answered.result())

        future.add_done_callback(done)
        return True

    def repeat(self) -> None:
        """Repeat the request if its answer is overdue and the service exists."""
        if self.waiting and self.age > ANSWER_TIMEOUT_S and self.ready:
            self.ask(*self._asked)

    def drop(self) -> None:
        """Ignore the answer if it is pending."""
        if self._future is not None:
            self._client.remove_pending_request(self._future)
            self._future = None
