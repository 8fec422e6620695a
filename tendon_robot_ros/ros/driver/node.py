"""
The driver node: puts tendon commands on motors, and lets the arm go safely when they stay away.

Topics: tendon_command, stop (subscribed); tendon_states, ~/status, /diagnostics (published);
with the mock also measured_tip and measured_shape. Services: ~/stop, ~/reset, ~/reboot.
Parameters and units: docs/ros_interface.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from ...common.errors import TendonRobotError
from ...common.local_stop import StopListener, Stoppable
from ...common.processes import REALTIME_PRIORITY, REALTIME_PRIORITY_MOCK, go_realtime
from ...control.checks import Refusal, by_name, check_stamp, finite
from ...drivers.mock import MockDriver
from ...drivers.supervisor import FOLLOWING, HOLDING, LIMP, OFF, RELEASED, Supervisor
from ...drivers.tendon_check import due
from ...robot import load_robot
from ..shared.inbox import STOP_REASON, Inbox, Service, StopTopic
from ..shared.joints import JointReader, Joints
from ..shared.lifecycle import ERROR, OK, WARN, ManagedNode, Status
from ..shared.messages import JOINTS, STATE, nanoseconds_now, refilled, stamp_now
from ..shared.parameters import Parameters
from ..shared.runtime import asked_to_end, goes_first, repeat, run, when_asked_to_end
from ..shared.senders import (
    OtherPublishers,
    PublisherNames,
    PublisherSocket,
    Received,
    Senders,
    gid_text,
)
from . import backend, parameters
from .backend import MockTracker
from .motor_loop import Cycle, MotorLoop

HELP = 'drive motors, or a mock arm, from tendon commands'
STATE_WORDS = {
    FOLLOWING: 'following commands',
    RELEASED: 'released, holding',
    HOLDING: 'released in part, holding',
    LIMP: 'released, torque off',
    OFF: 'torque off',
    'releasing': 'releasing',
}
GO_ON = 'a new target of the controller, or reset, goes on'
STOP_CALLED = 'stop was called'
NO_MORE = 'the sender of the commands lets go'
INACTIVE, INACTIVE_REASON = 'inactive', 'the node is not active'


class DriverNode(ManagedNode):
    """ROS around a driver: the motor thread moves the motors, this thread hears and tells."""

    def __init__(self) -> None:
        """Declare parameters; nothing is opened yet."""
        super().__init__('driver')
        self.parameters = Parameters(self, parameters.SPECS)
        self.parameters.watch({'mock_fault': self._inject}, self._retune)
        self.status = Status(self, 'motors')
        self.loop: MotorLoop | None = None
        self._tracker: MockTracker | None = None
        self._refusal: Refusal | None = None
        self._check_due = ''  # why the tendons are to be checked
        self._stopped = False  # by `~/stop`, before there was anything to stop
        self._cycle: Cycle | None = None
        self._senders, self._names = Senders(), PublisherNames(self, 'tendon_command')
        self._state = JointState()
        self._states = self.create_publisher(JointState, 'tendon_states', STATE)
        self._socket = PublisherSocket(self._states)
        self._drivers = OtherPublishers(self, self._states)
        self._commands = Inbox(self, JointState, 'tendon_command', JOINTS, JointReader())
        stop = Service(self, Trigger, '~/stop', self._stop)  # answers while torque comes on, too
        self._stop_topic = StopTopic(self, self._stop_said, self._stop_gone, [stop])
        self._local_stop = StopListener(
            self.context.get_domain_id(),
            Stoppable(self.get_fully_qualified_name(), drives=True),
            self._stop_now,
        )
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/resume', self._resume)
        self.create_service(Trigger, '~/reboot', self._reboot)
        repeat(self, 0.05, self._tell)
        when_asked_to_end(self._let_go)

    def configure(self) -> None:
        """Read the robot, open the port, begin to read."""
        robot = load_robot(self.parameters['robot'])
        self.status.arm = robot.name
        reference = self.parameters['tendon_reference']
        self._check_due = due(Path(reference)) if reference else ''
        if self._check_due:
            self.get_logger().warning(self._check_due)
        if self.parameters['backend'] == 'mock':
            self.status.say(WARN, 'starting', 'makes the mock arm; compiles it, once: a minute')
        driver, tracker = backend.make(robot, self.parameters, self)
        supervisor = Supervisor(backend.rules(robot, driver, self.parameters))
        if hasattr(driver, 'cancelled'):  # it may look long for the slack of its wires
            driver.cancelled = self._cancelled
        driver.open()
        self.loop = MotorLoop(
            driver, supervisor, 1.0 / self.parameters['rate'], self._report, self._hear
        )
        if isinstance(driver, MockDriver):
            self._tracker = MockTracker(self, driver, tracker, self.parameters)
        if self._stop_topic.says:
            self._stop_said(STOP_REASON)
        if self._stopped:
            supervisor.latch.stop('stop', STOP_CALLED)
        self.loop.start()
        if goes_first():  # a mock arm computes: motors of another robot go before it
            mock = isinstance(driver, MockDriver)
            go_realtime(REALTIME_PRIORITY_MOCK if mock else REALTIME_PRIORITY)

    def activate(self) -> None:
        """Torque on, from the measured state."""
        assert self.loop is not None
        loop = self.loop
        self.status.say(WARN, 'starting', 'switches torque on; looks for slack first if told')
        loop.call(lambda: loop.supervisor.latch.forget(INACTIVE))
        loop.activate()
        if strength := loop.driver.strength():
            self.get_logger().info(strength)
        if silence := loop.driver.silence():
            self.get_logger().info(f'motors left in silence stop after {silence}')

    def _let_go(self) -> None:
        """Begin to release: the node is asked to end, `deactivate` comes when it can."""
        if self.loop is not None:
            self.loop.supervisor.latch.stop(INACTIVE, INACTIVE_REASON)

    def deactivate(self) -> None:
        """Ramp to pretension, then torque off if so told."""
        assert self.loop is not None
        if self.loop.crashed is not None:  # the thread has already done what it could
            return
        if not self.loop.release(INACTIVE, INACTIVE_REASON, self._release_time()):
            self.get_logger().error('the release did not end in time; torque off')
            self.loop.call(self.loop.driver.disable)

    def cleanup(self) -> None:
        """Close the port; torque stays as the release left it."""
        if self._tracker is not None:
            self._tracker.close()
        if self.loop is not None:
            self.loop.close()
        self.loop = self._tracker = self._cycle = None

    def running(self) -> bool:
        """Go on unless the motor thread died."""
        if self.loop is not None and self.loop.crashed is not None:
            raise self.loop.crashed
        return super().running()

    def destroy_node(self) -> None:
        """Hear no more."""
        self._stop_topic.close()
        self._local_stop.close()
        self._commands.close()
        self._socket.close()
        super().destroy_node()

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.status.say(ERROR, 'not_ready', message, once=True)

    def _release_time(self) -> float:
        assert self.loop is not None
        rules = self.loop.supervisor.rules
        return float(np.max(np.ptp(rules.limits, axis=1)) / rules.release_rate) + 1.0

    def _command(self, heard: Received[Joints]) -> None:
        if self.loop is None:
            return
        message = heard.message
        try:
            now = 1e-9 * nanoseconds_now(self)
            tolerance = self.parameters['stamp_tolerance']
            check_stamp(message.stamp, now, tolerance, 'tendon_command')
            if not message.names:
                if self._senders.counts(time.monotonic(), heard):
                    self.loop.let_go(NO_MORE)
                return
            tension = self.loop.driver.mode == 'tension'
            quantity, values = (
                ('effort', message.effort) if tension else ('position', message.position)
            )
            ordered = by_name(
                message.names, values, self.loop.driver.inputs, 'tendon_command', quantity
            )
            command = finite(ordered.tolist(), 'tendon_command')
            if self._senders.counts(time.monotonic(), heard):
                if self._senders.new:
                    self.loop.newcomer()
                self.loop.put(command)
                self._refusal = None
        except Refusal as refusal:
            self._refusal = refusal

    def _report(self, cycle: Cycle) -> None:
        """Publish a state; runs in the motor thread."""
        before, self._cycle = self._cycle, cycle
        assert self.loop is not None
        if before is not None and before.releases < cycle.releases and self.executor is not None:
            self.executor.create_task(self._tell)  # who commands hears of it at once
        message, reading = self._state, cycle.reading
        message.name = self.loop.driver.inputs
        refilled(message, stamp_now(self), reading.pulls, reading.tensions)
        self._states.publish(message)

    def _tell(self) -> None:
        """Publish the status."""
        cycle, loop = self._cycle, self.loop
        if loop is None:
            self._stop_topic.poll()
        if cycle is None or loop is None:
            if self.phase == 'unconfigured' and not self.parameters['autostart']:
                self.status.say(WARN, 'unconfigured', 'waits to be configured')
            return
        decision, latched = cycle.decision, loop.supervisor.latch.reasons  # the latch is newer
        stopped = bool(latched)
        state = 'releasing' if stopped and decision.state == FOLLOWING else decision.state
        level = ERROR if stopped else OK if state == FOLLOWING else WARN
        message = '; '.join(dict.fromkeys([STATE_WORDS[state], *decision.reasons, *latched]))
        if cycle.held and not (decision.reasons or latched):
            message += f' ({cycle.held}); {GO_ON}'
        code = 'stopped' if stopped else state
        if self._refusal is not None:
            level, code = max(level, WARN), f'refused_{self._refusal.code}'
            message = f'{self._refusal}; {message}'
        beside, senders = self._others()
        if beside:
            level, message = max(level, WARN), f'{message}; {beside}'
        values = {
            'state': state,
            'tendon_check': self._check_due,
            'stopped': str(stopped).lower(),
            'reasons': '; '.join(decision.reasons),
            'released': cycle.held,
            'releases': str(cycle.releases),
            'mode': loop.driver.mode,
            'tension_source': cycle.reading.source,
            'clipped': ', '.join(decision.clipped),
            'torque_off': ', '.join(loop.off),
            'faults': ', '.join(fault.code for fault in cycle.faults),
            **senders,
            **loop.driver.describe(),
        }
        self.status.say(level, code, message, values)

    def _others(self) -> tuple[str, dict[str, str]]:
        """Say who else sends commands or states, as a sentence and as values."""
        now = time.monotonic()
        first, others = self._senders.first(now), self._senders.others(now)
        follows = '' if first is None else self._names.of([first])
        ignored, drivers = self._names.of(others), self._drivers.names(now)
        notes = [f'follows {follows}, ignores tendon_command of {ignored}'] if ignored else []
        notes += [f'another publishes tendon_states: {drivers}'] if drivers else []
        return '; '.join(notes), {
            'follows': follows,
            # not of a middleware whose messages carry another gid than its graph
            'follows_gid': gid_text(first) if first and self._names.known(first) else '',
            'ignored': ignored,
            'other_drivers': drivers,
        }

    def _hear(self) -> None:
        """Hear what cannot wait; runs in the motor thread before every cycle."""
        self._stop_topic.poll()
        for heard in self._commands.take():
            self._command(heard)
        if problem := self._commands.refused():
            self._refusal = Refusal('length', problem)
        if self._senders.died() and self.loop is not None:
            self.loop.let_go('the sender of the commands has died')

    def _cancelled(self) -> bool:
        """Whether to end a search for slack; asked in the motor thread."""
        self._stop_topic.poll()
        return asked_to_end() or (self.loop is not None and bool(self.loop.supervisor.latch))

    def _stop_said(self, reason: str) -> None:
        if self.loop is not None:
            self.loop.supervisor.latch.stop('stop topic', reason, lasting=True)

    def _stop_gone(self) -> None:
        if self.loop is not None:
            self.loop.supervisor.latch.cause_gone('stop topic')

    def _stop_now(self) -> None:
        """Latch a stop; called by any thread."""
        self._stopped = True
        if self.loop is not None:
            self.loop.supervisor.latch.stop('stop', STOP_CALLED)

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stop_now()
        does = 'releasing' if self.loop is not None else 'stopped; no motors are open'
        response.success, response.message = True, f'{does}; call reset to go on'
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done = 'waiting for commands' if self.phase == 'active' else 'activate it next'

        def reset(loop: MotorLoop) -> None:
            loop.reset()
            self._stopped = False

        if self.loop is None and self._stopped:
            self._stopped = False
            response.success, response.message = True, 'the stop is over; no motors are open'
            return response
        return self._try(response, reset, done)

    def _resume(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._try(response, lambda loop: loop.supervisor.resume(), 'waiting for commands')

    def _reboot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._try(response, lambda loop: loop.reboot(), 'rebooted; call reset next')

    def _try(
        self, response: Trigger.Response, action: Callable[[MotorLoop], None], done: str
    ) -> Trigger.Response:
        response.success, response.message = self.loop is not None, done
        try:
            if self.loop is not None:
                loop = self.loop
                loop.call(lambda: action(loop))
            else:
                response.message = 'the driver is not configured'
        except TendonRobotError as error:
            response.success, response.message = False, ' '.join(str(error).split())
        return response

    def _inject(self, text: str) -> None:
        """Inject a fault into the mock: CODE or CODE:INPUT,INPUT; empty clears."""
        driver = None if self.loop is None else self.loop.driver
        if not isinstance(driver, MockDriver):
            raise Refusal('mock_fault', 'mock_fault: needs backend mock, configured')
        if not text:
            driver.clear()
            return
        code, _, names = text.partition(':')
        driver.inject(code, [name for name in names.split(',') if name])

    def _retune(self) -> None:
        """Apply changed rates and times."""
        if self.loop is not None:
            loop = self.loop
            made = backend.rules(loop.driver.robot, loop.driver, self.parameters)
            loop.supervisor.rules = made


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(DriverNode, arguments, first=True)
