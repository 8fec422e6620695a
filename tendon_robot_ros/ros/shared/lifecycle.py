"""Lifecycle nodes that start by themselves and can be stopped; the status of a node."""

from __future__ import annotations

import gc
import time
import traceback
from collections.abc import Callable, Collection, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy._rclpy_pybind11 import RCLError
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from std_srvs.srv import Trigger

from ...common.errors import MovedError, TendonRobotError
from ...common.local_stop import StopListener, Stoppable
from ...drivers.safety import StopLatch
from .inbox import STOP_REASON, Service, StopTopic
from .messages import LATCHED, STATE, stamp_now
from .parameters import Parameters, fixed
from .runtime import Runnable
from .timing import NEWS_PERIOD_S, RETRY_PERIOD_S, STATUS_PERIOD_S, VALUES_PERIOD_S

AUTOSTART = fixed(
    'autostart', True, 'configure and activate by itself, and try again when that fails'
)
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
LEVELS = {'ok': OK, 'warn': WARN, 'error': ERROR}
STOP_CALLED = 'stop was called'


class ManagedNode(Runnable, LifecycleNode):
    """
    A lifecycle node whose transitions are plain methods.

    A subclass has `configure`, `activate`, `deactivate` and `cleanup`; each may raise a
    TendonRobotError, which refuses the transition with its text.
    """

    parameters: Parameters
    status: Status

    def __init__(self, name: str) -> None:
        """Begin unconfigured."""
        super().__init__(name)
        service = self._service_change_state
        asked_to_change = service.callback

        def change(request: Any, response: Any) -> Any:
            """Refuse a transition that this state does not have: rclpy ends the process."""
            try:
                return asked_to_change(request, response)
            except RCLError as error:
                wanted = request.transition.label or f'transition {request.transition.id}'
                self.get_logger().warning(f'refused: {wanted}: the node is {self.phase}: {error}')
                response.success = False
                return response

        service.callback = change
        self.phase = 'unconfigured'
        self._tried = -RETRY_PERIOD_S

    def running(self) -> bool:
        """Configure and activate when that is due."""
        due = self.phase != 'active' and time.monotonic() - self._tried >= RETRY_PERIOD_S
        if self.parameters['autostart'] and due and self.ready():
            self._tried = time.monotonic()
            if self.phase == 'unconfigured':
                self.trigger_configure()
            if self.phase == 'inactive':
                self.trigger_activate()
        return True

    def end(self) -> None:
        """Leave the active state the proper way, then close."""
        if self.phase == 'active':
            self.trigger_deactivate()
        if self.phase == 'inactive':
            self.trigger_cleanup()

    def ready(self) -> bool:
        """Whether it makes sense to configure now."""
        return True

    def configure(self) -> None:
        """Read what is needed, open what is needed."""

    def activate(self) -> None:
        """Begin to act."""

    def deactivate(self) -> None:
        """Stop to act, safely."""

    def cleanup(self) -> None:
        """Give everything back."""

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.get_logger().error(message)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `configure`."""
        passed = self._pass(self.configure, 'inactive')
        gc.unfreeze()
        gc.collect()
        gc.freeze()  # what is left stays: to look at it again costs 15 ms, every few seconds
        return passed

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `activate`."""
        return self._pass(self.activate, 'active')

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `deactivate`; a person who deactivates does not want autostart."""
        self._tried = float('inf')
        return self._pass(self.deactivate, 'inactive')

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run `cleanup`."""
        self._tried = float('inf')
        return self._pass(self.cleanup, 'unconfigured')

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave whatever state it is in."""
        self._tried = float('inf')
        if self.phase == 'active':
            self._pass(self.deactivate, 'inactive')
        if self.phase == 'inactive':
            self._pass(self.cleanup, 'unconfigured')
        return TransitionCallbackReturn.SUCCESS

    def _pass(self, action: Callable[[], None], phase: str) -> TransitionCallbackReturn:
        try:
            action()
        except TendonRobotError as error:
            if isinstance(error, MovedError):  # only a person tries that again
                self._tried = float('inf')
            self.problem(' '.join(str(error).split()))
            return TransitionCallbackReturn.FAILURE
        except Exception:  # rclpy would say nothing
            self.problem(f'unexpected: {traceback.format_exc()}')
            raise
        self.phase = phase
        return TransitionCallbackReturn.SUCCESS


class Status:
    """
    Publishes a level, a sentence, a code and values.

    A new level, code or fault goes out at once and into the log (what comes and goes is logged
    again after some seconds, or as soon as it stays); changed values go out at most ten times a
    second, and everything at least once a second.

    Parameters
    ----------
    node : Node
    what : str
        What the status is about: its name is `node: what`, as diagnostic_updater has it.

    """

    def __init__(self, node: Node, what: str) -> None:
        """Make the publishers."""
        self._node, self.arm = node, ''  # hardware_id: the robot, once it is known
        self._name = f'{node.get_fully_qualified_name().removeprefix("/")}: {what}'
        self._latched = node.create_publisher(DiagnosticStatus, '~/status', LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', STATE)
        # what was published last: the message for a person, the robot, the values
        self._sent: tuple[str, str, dict[str, str]] | None = None
        self._sent_at = self._read_at = 0.0  # [s] when it was published, when values were read
        self._key: tuple[bytes, str, str] | None = None
        self._logged: dict[tuple[bytes, str, str], float] = {}  # key -> when [s]
        self._to_log = False

    def say(
        self,
        level: bytes,
        code: str,
        message: str,
        values: Callable[[], Mapping[str, str]] = dict,
        faults: Collection[str] = (),
        once: bool = False,
    ) -> None:
        """
        Publish how the node is, if that is new or due.

        Parameters
        ----------
        level : bytes
            OK, WARN or ERROR.
        code : str
            Short and stable, for programs; also under the key `code`.
        message : str
            One sentence for a person.
        values : callable, optional
            Returns more: numbers plain, with their unit in the key, as `position_error (m)`. It
            is called only when values may go out, because to format them costs more than to ask.
        faults : collection of str
            Codes of what is broken.
        once : bool
            The caller will not repeat it: it is published however soon it comes after another.

        """
        now = time.monotonic()
        key = level, code, message if once else ', '.join(sorted(set(faults)))
        news = key != self._key
        if not once and (
            now - self._sent_at < NEWS_PERIOD_S if news else now - self._read_at < VALUES_PERIOD_S
        ):
            return
        self._read_at = now
        content = message, self.arm, {'code': code, **values()}
        if not news and content == self._sent and now - self._sent_at < STATUS_PERIOD_S:
            return
        self._to_log |= news
        if self._to_log and now - self._logged.get(key, -RETRY_PERIOD_S) >= RETRY_PERIOD_S:
            self._logged[key], self._to_log = now, False
            text, logger = f'{code}: {message}', self._node.get_logger()
            if level == OK:  # rclpy: a line of code logs with one level
                logger.info(text)
            elif level == WARN:
                logger.warning(text)
            else:
                logger.error(text)
        self._key, self._sent, self._sent_at = key, content, now
        status = DiagnosticStatus(
            level=level,
            name=self._name,
            message=message,
            hardware_id=self.arm,
            values=[KeyValue(key=name, value=value) for name, value in content[2].items()],
        )
        self._latched.publish(status)
        array = DiagnosticArray(status=[status])
        array.header.stamp = stamp_now(self._node)
        self._diagnostics.publish(array)


class StoppableNode(ManagedNode):
    """
    A node that the service ~/stop, the topic `stop` and the command `stop` stop at once.

    A stop that comes before there is anything to stop counts when there is: a subclass calls
    `stop_as_told` at the end of its `configure`.

    Parameters
    ----------
    name : str
    drives : bool
        Whether it drives motors.

    """

    def __init__(self, name: str, drives: bool) -> None:
        """Begin unconfigured; `listen` begins to hear stops."""
        super().__init__(name)
        self._drives, self._stopped = drives, False

    def listen(self, *services: Service) -> None:
        """Hear stops, and answer services, in a thread that does nothing else."""
        stop = Service(self, Trigger, '~/stop', lambda _, send: send(self.stop_called()))

        def gone() -> None:
            if (latch := self.latch) is not None:
                latch.cause_gone('stop topic')

        self.stop_topic = StopTopic(self, self.stop_said, gone, [stop, *services])
        self._local_stop = StopListener(
            self.context.get_domain_id(),
            Stoppable(self.get_fully_qualified_name(), self._drives),
            self.stop_now,
        )

    @property
    def latch(self) -> StopLatch | None:
        """What holds the stops; None while there is nothing to stop."""
        raise NotImplementedError

    def stop_called(self) -> Trigger.Response:
        """Stop, and answer who has called the service."""
        raise NotImplementedError

    def stop_said(self, reason: str) -> None:
        """Stop: the topic says so."""
        if (latch := self.latch) is not None:
            latch.stop('stop topic', reason, lasting=True)

    def stop_now(self) -> None:
        """Latch a stop, in the thread that hears of it."""
        self._stopped = True
        if (latch := self.latch) is not None:
            latch.stop('stop', STOP_CALLED)

    def stop_as_told(self) -> None:
        """Latch the stops that came before there was anything to stop."""
        if self.stop_topic.says:
            self.stop_said(STOP_REASON)
        if self._stopped:
            self.stop_now()

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.status.say(ERROR, 'not_ready', message, once=True)

    def destroy_node(self) -> None:
        """Hear no more."""
        self.stop_topic.close()
        self._local_stop.close()
        super().destroy_node()
