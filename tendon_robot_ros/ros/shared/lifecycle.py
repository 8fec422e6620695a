"""Lifecycle nodes that start by themselves and can be stopped; the status of a node."""

from __future__ import annotations

import gc
import time
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ...common.arrays import Floats
from ...common.errors import MovedError, TendonRobotError
from ...common.local_stop import StopListener, Stoppable
from ...drivers.safety import StopLatch
from . import interface
from .inbox import Inbox, Service, StopTopic
from .messages import refilled, stamp_now
from .parameters import ParameterNode
from .senders import OwnPublisher, Senders
from .timing import NEWS_PERIOD_S, RETRY_PERIOD_S, STATUS_PERIOD_S, VALUES_PERIOD_S

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
LEVELS = {'ok': OK, 'warn': WARN, 'error': ERROR}
STOP, STOP_TOPIC = 'stop', 'stop topic'  # keys of the stops that somebody requested
STOP_REASON = 'topic stop says true (publish false on it to end that)'


class StoppableNode(ParameterNode, LifecycleNode):
    """
    A lifecycle node whose transitions are plain methods, and that can be stopped at once.

    A subclass has `configure`, `activate`, `deactivate` and `cleanup`; each may raise a
    TendonRobotError, which refuses the transition with its text.

    The service ~/stop, the topic `stop` and the command `stop` stop it. The latch is that of the
    node, so that a stop that arrives before there is anything to stop counts, too.

    Parameters
    ----------
    name : str
    drives : bool
        Whether the node drives motors.
    hears, says : str
        Topics of joints that it receives and publishes. The messages of one publisher count; every
        publisher is known to the nodes that receive.

    """

    status: Status

    def __init__(self, name: str, drives: bool, hears: str, says: str) -> None:
        """Create the node, unconfigured; `listen` subscribes to stops."""
        super().__init__(name)
        self._drives, self.latch = drives, StopLatch()
        self._senders = Senders(self, hears)
        self._inbox = Inbox[JointState](self, *interface.topic(hears)[:2], interface.JOINTS)
        self._message = JointState()  # filled anew for every publication
        self._publisher = self.create_publisher(*interface.topic(says))
        self._own = OwnPublisher(self, self._publisher)
        self.closing: list[Any] = [self._inbox, self._own]  # what ends with the node
        service = self._service_change_state
        change_state = service.callback

        def change(request: Any, response: Any) -> Any:
            """Refuse a transition that this state does not have; rclpy would end the process."""
            try:
                return change_state(request, response)
            except RCLError as error:
                transition = request.transition.label or f'transition {request.transition.id}'
                text = f'refused: {transition}: the node is {self.phase}: {error}'
                self.get_logger().warning(text)
                response.success = False
                return response

        service.callback = change
        self.phase = 'unconfigured'
        self._tried = -RETRY_PERIOD_S

    def running(self) -> bool:
        """Configure and activate the node when an attempt is due; return True: it goes on."""
        due = self.phase != 'active' and time.monotonic() - self._tried >= RETRY_PERIOD_S
        if self.parameters['autostart'] and due and self.ready():
            self._tried = time.monotonic()
            if self.phase == 'unconfigured':
                self.trigger_configure()
            if self.phase == 'inactive':
                self.trigger_activate()
        return True

    def end(self) -> None:
        """Deactivate and clean up, as the present state requires."""
        if self.phase == 'active':
            self.trigger_deactivate()
        if self.phase == 'inactive':
            self.trigger_cleanup()

    def ready(self) -> bool:
        """Return whether `configure` may be attempted now."""
        return True

    def configure(self) -> None:
        """Read the configuration and open devices."""

    def activate(self) -> None:
        """Start to command."""

    def deactivate(self) -> None:
        """Stop to command, safely."""

    def cleanup(self) -> None:
        """Close devices and release what `configure` acquired."""

    def problem(self, message: str) -> None:
        """Report why a transition was refused."""
        self.status.publish(ERROR, 'not_ready', message, once=True)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `configure`."""
        passed = self._pass(self.configure, 'inactive')
        gc.unfreeze()
        gc.collect()
        gc.freeze()  # else every collection scans the objects that stay: measured, 15 ms each
        return passed

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `activate`."""
        return self._pass(self.activate, 'active')

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `deactivate`; a requested transition ends the autostart."""
        self._tried = float('inf')
        return self._pass(self.deactivate, 'inactive')

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `cleanup`."""
        self._tried = float('inf')
        return self._pass(self.cleanup, 'unconfigured')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and clean up from any state."""
        if self.phase == 'active':
            self.on_deactivate(state)
        if self.phase == 'inactive':
            self.on_cleanup(state)
        self._tried = float('inf')
        return TransitionCallbackReturn.SUCCESS

    def _pass(self, action: Callable[[], None], phase: str) -> TransitionCallbackReturn:
        try:
            action()
        except TendonRobotError as error:
            if isinstance(error, MovedError):  # only a person may repeat the attempt
                self._tried = float('inf')
            self.problem(' '.join(str(error).split()))
            return TransitionCallbackReturn.FAILURE
        except Exception:  # rclpy would not report it
            self.problem(f'unexpected: {traceback.format_exc()}')
            raise
        self.phase = phase
        return TransitionCallbackReturn.SUCCESS

    def say(self, names: Sequence[str], position: Floats | None, effort: Floats | None) -> None:
        """Publish joints with the present stamp."""
        self._message.name = names
        self._publisher.publish(refilled(self._message, stamp_now(self), position, effort))

    def listen(self, *services: Service) -> None:
        """Receive stops and answer services in a thread of their own."""
        stop = Service(self, '~/stop', lambda send: send(True, self.stop_called()))
        by_topic = partial(self.stop_now, STOP_TOPIC, STOP_REASON, lasting=True)
        cleared = partial(self.latch.cause_removed, STOP_TOPIC)
        self.stop_topic = StopTopic(self, by_topic, cleared, stop, *services)
        who = Stoppable(self.get_fully_qualified_name(), self._drives)
        local_stop = StopListener(self.context.get_domain_id(), who, self.stop_now)
        self.closing += self.stop_topic, local_stop

    def stop_called(self) -> str:
        """Stop; return what follows, as the service `~/stop` answers."""
        raise NotImplementedError

    def stop_now(
        self, key: str = STOP, reason: str = 'stop was called', lasting: bool = False
    ) -> None:
        """Latch a stop, in the thread that receives it."""
        self.latch.stop(key, reason, lasting)
        self.let_go()

    def let_go(self) -> None:
        """Have the arm released, where another node does that."""

    def destroy_node(self) -> None:
        """Close subscriptions and sockets, and destroy the node."""
        for one in self.closing:
            one.close()
        super().destroy_node()


class Status:
    """
    Publishes a level, a sentence, a code and values.

    A new level, code or fault is published at once and logged (one that comes and goes is logged
    again after some seconds, or as soon as it stays). Changed values are published at most ten
    times a second, and the whole status at least once a second.

    Parameters
    ----------
    node : Node
    what : str
        Subject of the status; its name is `node: what`, as in diagnostic_updater.

    """

    def __init__(self, node: Node, what: str) -> None:
        """Create the publishers."""
        self._node, self.arm = node, ''  # hardware_id: the robot, once it is known
        self._name = f'{node.get_fully_qualified_name().removeprefix("/")}: {what}'
        self._latched = node.create_publisher(*interface.topic('node/status'))
        self._diagnostics = node.create_publisher(*interface.topic('/diagnostics'))
        # what was published last: the message for a person, the robot, the values
        self._sent: tuple[str, str, dict[str, str]] | None = None
        self._sent_at = self._read_at = 0.0  # [s] when it was published, when values were read
        self._key: tuple[bytes, str, str] | None = None
        self._logged: dict[tuple[bytes, str, str], float] = {}  # key -> when [s]
        self._to_log = False

    def publish(
        self,
        level: bytes,
        code: str,
        message: str,
        values: Callable[[], Mapping[str, str]] = dict,
        faults: Collection[str] = (),
        once: bool = False,
    ) -> None:
        """
        Publish the state of the node if it is new or due.

        Parameters
        ----------
        level : bytes
            OK, WARN or ERROR.
        code : str
            Short and stable, for programs; also published as the value `code`.
        message : str
            One sentence for a person.
        values : callable, optional
            Returns key -> text: plain numbers with their unit in the key, as
            `position_error (m)`. Called only when values may be published, because it takes
            longer to format them than to check that.
        faults : collection of str
            Codes of the present faults.
        once : bool
            The caller does not repeat it: it is published however soon after another one.

        """
        now = time.monotonic()
        key = level, code, message if once else ', '.join(sorted(set(faults)))
        news = key != self._key
        last, period = (self._sent_at, NEWS_PERIOD_S) if news else (self._read_at, VALUES_PERIOD_S)
        if not once and now - last < period:
            return
        self._read_at = now
        content = message, self.arm, {'code': code, **values()}
        if not news and content == self._sent and now - self._sent_at < STATUS_PERIOD_S:
            return
        self._to_log |= news
        if self._to_log and now - self._logged.get(key, -RETRY_PERIOD_S) >= RETRY_PERIOD_S:
            self._logged[key], self._to_log = now, False
            text, logger = f'{code}: {message}', self._node.get_logger()
            if level == OK:  # rclpy allows one level per line of code
                logger.info(text)
            elif level == WARN:
                logger.warning(text)
            else:
                logger.error(text)
        self._key, self._sent, self._sent_at = key, content, now
        pairs = [KeyValue(key=name, value=value) for name, value in content[2].items()]
        status = DiagnosticStatus(level=level, name=self._name, message=message, values=pairs)
        status.hardware_id = self.arm
        self._latched.publish(status)
        array = DiagnosticArray(status=[status])
        array.header.stamp = stamp_now(self._node)
        self._diagnostics.publish(array)
