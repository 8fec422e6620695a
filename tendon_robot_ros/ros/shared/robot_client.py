"""Client of a running robot: sends targets, reads statuses, waits; tip and commands meanwhile."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...common.arrays import Floats
from ...common.errors import InputError, TendonRobotError
from ...common.rotations import towards
from ...control.inputs import Trajectory, direction
from ...control.loading import load
from ...data.tracker_faults import is_missing
from ...effects import load_catalogue
from ...model.model import Model
from ...robot import load_robot
from ...robot.keep_out import joined, text_of
from . import interface, messages
from .parameters import RemoteParameter, declared
from .runtime import SPIN_S, ClientNode, Ending
from .timing import CALL_TIMEOUT_S, MOVE_TIMEOUT_S, REACTION_TIMEOUT_S, SILENCE_S

SETTLED_CODES = ('reached', 'nearest', 'at_limit')
WORKING_CODES = ('holding', 'searching', 'moving', 'playing', 'played', 'jogging', *SETTLED_CODES)
# [s] over which a tip at rest is averaged: ten frames at 30 Hz, so that the noise of a tracker
# falls to a third
TIP_AVERAGE_S = 0.3
# [1] messages kept of a topic: two seconds at 1 kHz, so that a busy machine loses none, and memory
# does not grow
MESSAGES_MAX = 2000
TipSample = tuple[float, Floats, Floats]  # time [s], position (3,) [m], direction (3,) of a tip


def add_controller(parser: argparse.ArgumentParser) -> None:
    """Add the option for the name of the controller node."""
    text = 'of the node (default: controller)'
    parser.add_argument('--controller', default='controller', metavar='NAME', help=text)


class Pilot(ClientNode):
    """
    A node that sends targets to a running robot, reads statuses, and waits.

    It keeps the tips and commands since `clear`.

    Parameters
    ----------
    name : str
    ending : Ending
        Request of a signal to end.
    controller : str
        Name of the controller node.
    namespace : str, optional
    watched : sequence of str
        Names of other nodes whose status is read.

    """

    def __init__(
        self,
        name: str,
        ending: Ending,
        controller: str = 'controller',
        namespace: str | None = None,
        watched: Sequence[str] = (),
    ) -> None:
        """Create publishers and subscriptions."""
        super().__init__(name, namespace=namespace)
        self.ending, self._controller = ending, controller
        self.base = ''  # frame of the controller, and of the targets
        self.inputs, self.pull = tuple[str, ...](), False
        self.statuses: dict[str, dict[str, str]] = {node: {} for node in (controller, *watched)}
        self._status_at = 0.0  # [s] when the controller's status came
        self._since = np.inf  # [s] when `clear` was called
        self._remotes: dict[tuple[str, str], RemoteParameter] = {}  # of (node, name)
        self._tips: dict[str, list[TipSample]] = {'measured': [], 'predicted': []}
        self._commands: list[tuple[float, Floats]] = []
        own = partial(interface.topic, at=controller)
        self._poses = self.create_publisher(*own('controller/target_pose'))
        self._points = self.create_publisher(*own('controller/target_point'))
        self._trajectories = self.create_publisher(*own('controller/tendon_trajectory'))

        def receive(node: str, message: DiagnosticStatus) -> None:
            self.statuses[node] = {**messages.status_values(message), 'message': message.message}
            if node == controller:
                self._status_at = time.monotonic()

        def tip(which: str, message: PoseStamped) -> None:
            if which == 'predicted':
                self.base = message.header.frame_id
            elif message.header.frame_id != self.base:
                return
            with suppress(InputError):  # an orientation that is none
                view = direction(messages.xyzw(message.pose.orientation), which)
                place = np.array(messages.xyz(message.pose.position))
                if not is_missing(place):  # as trackers say that they see none
                    self._tips[which].append((time.monotonic(), place, view))

        def command(message: JointState) -> None:
            self.inputs, self.pull = tuple(message.name), not message.effort
            values = message.position if self.pull else message.effort
            self._commands.append((time.monotonic(), np.array(values)))

        for node in self.statuses:
            interface.subscribe(self, 'node/status', partial(receive, node), node)
        predicted = partial(tip, 'predicted')
        interface.subscribe(self, 'controller/predicted_tip', predicted, controller)
        interface.subscribe(self, 'measured_tip', partial(tip, 'measured'))
        interface.subscribe(self, 'tendon_command', command, heard=interface.COMMAND)

    @property
    def status(self) -> dict[str, str]:
        """The last status of the controller: `code`, `message` and values; empty before."""
        return self.statuses[self._controller]

    @property
    def has_listener(self) -> bool:
        """Whether targets and trajectories have a subscriber."""
        sent = self._poses, self._points, self._trajectories
        return all(one.get_subscription_count() for one in sent)

    def send(self, position: Floats, direction: Floats | None) -> str:
        """Send a target, (3,) [m] and (3,) or None; return its stamp as the status reports it."""
        header = messages.header_now(self, self.base)
        if direction is None:
            self._points.publish(PointStamped(header=header, point=messages.point(position)))
        else:
            self._poses.publish(messages.pose_stamped(header, position, towards(direction)))
        return messages.stamp_text(header.stamp)

    def settled(self, stamp: str, codes: Sequence[str] = SETTLED_CODES) -> bool:
        """Return whether the status has one of `codes` for the target with this stamp."""
        return self.status.get('target_stamp') == stamp and self.status['code'] in codes

    def wait(
        self, condition: Callable[[], object], timeout: float, what: str, strict: bool = True
    ) -> bool:
        """
        Spin until a condition is true, at most `timeout` [s].

        Raises
        ------
        TendonRobotError
            The condition stayed false, and `strict`; the text has the statuses of the nodes.
        KeyboardInterrupt
            A signal came.

        """
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                if not strict:
                    return False
                statuses = '; '.join(
                    f'the {node if node != self._controller else "controller"} says: '
                    f'{values.get("message", "nothing")}'
                    for node, values in self.statuses.items()
                )
                raise TendonRobotError(f'waited {timeout:g} s in vain for {what}; {statuses}')
            self.spin_once(SPIN_S)
        return True

    def spin(self, seconds: float) -> None:
        """Serve messages for some seconds."""
        end = time.monotonic() + seconds
        while (remaining := end - time.monotonic()) > 0.0:
            self.spin_once(remaining)

    def triggered(self, name: str) -> str:
        """Call a Trigger service; return its message, raise TendonRobotError if it refuses."""
        request, answers = messages.Request(self, Trigger, name), list[Trigger.Response]()
        self.wait(lambda: request.ready, REACTION_TIMEOUT_S, f'the service {name}')
        request.ask(Trigger.Request(), answers.append)
        self.wait(lambda: answers, REACTION_TIMEOUT_S, f'an answer of {name}')
        if not answers[0].success:
            raise TendonRobotError(f'{name}: {answers[0].message}')
        return str(answers[0].message)

    def spin_once(self, timeout: float) -> None:
        """Serve one message; raise KeyboardInterrupt when a signal came."""
        if self.ending.signal:
            raise KeyboardInterrupt
        with self.ending.interrupting(False):
            self.serve(timeout)

    def parameter(self, name: str, node: str = '') -> Any:
        """Return a parameter, a text or a list of texts, of a node (default: the controller)."""
        node, values = node or self._controller, list[Any]()
        if (node, name) not in self._remotes:
            self._remotes[node, name] = RemoteParameter(self, node, name)
        remote = self._remotes[node, name]

        def answered() -> bool:
            remote.ask(values.append)
            return bool(values)

        self.wait(answered, REACTION_TIMEOUT_S, f'the parameter {name} of {node}: is it running?')
        return values[0]

    def put(self, name: str, value: str, timeout: float = REACTION_TIMEOUT_S) -> tuple[bool, str]:
        """Set a parameter of the controller that was read before; return success and reason."""
        answers: list[tuple[bool, str]] = []
        self._remotes[self._controller, name].put(value, lambda *answer: answers.append(answer))
        end = time.monotonic() + timeout
        while not answers and time.monotonic() < end:
            self.serve(SPIN_S)  # works after Ctrl-C, too
        return answers[0] if answers else (False, f'{self._controller} does not answer')

    def connect(self, timeout: float = REACTION_TIMEOUT_S) -> None:
        """
        Wait for the controller.

        Raises
        ------
        TendonRobotError
            The controller does not answer, or accepts no targets now.

        """

        def up() -> bool:
            heard = self._commands and self._tips['predicted'] and self.status
            # also of states: else a tip that the driver publishes could be missed
            return bool(heard and self.has_listener and self.count_publishers('tendon_states'))

        what = (
            f'{self.resolve_topic_name(self._controller)} to command; are driver and controller '
            'running, in this namespace and ROS_DOMAIN_ID?'
        )
        self.wait(up, timeout, what)
        self.spin(TIP_AVERAGE_S)
        for topic in ('tendon_command', 'tendon_states'):
            if (count := self.count_publishers(topic)) > 1:
                raise TendonRobotError(
                    f'{count} nodes publish {self.resolve_topic_name(topic)}: another robot runs '
                    'here; give each its own namespace or ROS_DOMAIN_ID'
                )
        self.require_good()

    def require_good(self) -> None:
        """Raise TendonRobotError if the controller does not follow; old refusals do not count."""
        code = self.status.get('code', '')
        passing = code.startswith('refused_') or code == 'released'
        old = passing and self._status_at < self._since + TIP_AVERAGE_S
        if code not in WORKING_CODES and not old:
            raise TendonRobotError(f'the controller says {code}: {self.status.get("message")}')

    def model(self) -> Model:
        """Load the model that the controller uses, with its effects."""
        text, effects = self.parameter('model'), self.parameter('effects')
        return load(load_robot(text), load_catalogue([file for file in effects if file]))

    @contextmanager
    def keeping_out(self, regions: str) -> Iterator[None]:
        """Add keep-out regions (YAML text) to those of the controller within the context."""

        def put(text: str) -> None:
            accepted, reason = self.put('keep_out', text)
            if not accepted:
                node = self._controller
                raise TendonRobotError(f'the regions of {node} were not changed: {reason}')

        own = self.parameter('keep_out')
        put(joined(text_of(own), regions))
        try:
            yield
        finally:
            put(own)

    def play(self, trajectory: Trajectory) -> str:
        """Send a trajectory of the tendons; return its stamp."""
        message = JointTrajectory(header=messages.header_now(self), joint_names=list(self.inputs))
        field = 'positions' if self.pull else 'effort'
        for at, values in zip(trajectory.times, trajectory.values, strict=True):
            row = {'time_from_start': messages.duration(at), field: values.tolist()}
            message.points.append(JointTrajectoryPoint(**row))
        self._trajectories.publish(message)
        return messages.stamp_text(message.header.stamp)

    def settle(self, stamp: str, timeout: float, what: str) -> None:
        """Wait until the status reports the result of a target or a trajectory."""

        def at_rest() -> bool:
            self.require_good()
            return self.settled(stamp, (*SETTLED_CODES, 'played'))

        self.wait(at_rest, timeout, what)

    def play_to_the_end(
        self, trajectory: Trajectory, what: str, timeout: float = MOVE_TIMEOUT_S
    ) -> None:
        """Play a trajectory and wait for its end, `timeout` [s] beyond its duration at most."""
        self.clear()
        self.settle(self.play(trajectory), trajectory.times[-1] + timeout, what)

    def stand_at(self, position: Floats, direction: Floats | None, what: str) -> None:
        """Send a target, (3,) [m] and (3,) or None, and wait until the tip is at rest there."""
        self.clear()
        self.settle(self.send(position, direction), MOVE_TIMEOUT_S, what)
        self.stand()

    def stand(self) -> None:
        """Wait until the tip is at rest, at most `CALL_TIMEOUT_S`: motors, trackers lag."""
        end = time.monotonic() + CALL_TIMEOUT_S
        # between the mean tips of both halves of the time; with a noise of 0.2 mm and five frames
        # each, seven of eight arms at rest would pass at once
        tolerance = declared()['monitor']['still_speed'].default * TIP_AVERAGE_S / 2
        self.spin(TIP_AVERAGE_S)
        while time.monotonic() < end:
            self.spin(TIP_AVERAGE_S)
            _, times, places, _ = self.tips()
            late, early = times > times[-1] - TIP_AVERAGE_S / 2, times > times[-1] - TIP_AVERAGE_S
            if not (early & ~late).any():
                continue
            moved = places[late].mean(axis=0) - places[early & ~late].mean(axis=0)
            if np.linalg.norm(moved) < tolerance:
                self.spin(TIP_AVERAGE_S)  # so that `tip` averages no frames of the move
                return

    def clear(self) -> None:
        """Drop all but the last tips and commands."""
        for samples in self._tips.values():
            del samples[:-1]
        del self._commands[:-1]
        self._since = time.monotonic()

    def tips(self) -> tuple[bool, Floats, Floats, Floats]:
        """Return whether a tracker measures, times (T,) [s], positions (T, 3) [m], directions."""
        seen = self._tips['measured']
        measured = len(seen) > 1 and time.monotonic() - seen[-1][0] <= SILENCE_S
        samples = self._tips['measured' if measured else 'predicted']
        times, places, views = zip(*samples, strict=True)
        return measured, np.array(times), np.array(places), np.array(views)

    def commands(self) -> tuple[Floats, Floats]:
        """Return times (C,) [s] and commands (C, m) [N], or [m] in pull mode."""
        times, values = zip(*self._commands, strict=True)
        return np.array(times), np.array(values)

    def tip(self) -> tuple[Floats, Floats]:
        """Return mean position (3,) [m] and direction (3,) of the tip over `TIP_AVERAGE_S`."""
        _, times, places, views = self.tips()
        recent = times > times[-1] - TIP_AVERAGE_S
        along = views[recent].mean(axis=0)
        return places[recent].mean(axis=0), along / np.linalg.norm(along)
