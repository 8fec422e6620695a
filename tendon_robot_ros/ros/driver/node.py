"""
The driver node: applies tendon commands to motors, and releases the arm when they stop.

Topics: tendon_command, stop (subscribed); tendon_states, ~/status, /diagnostics (published);
with the mock also measured_tip and measured_shape. Services: ~/stop, ~/reset, ~/reboot.
Parameters and units: ros/parameters.yaml.

example: python -m tendon_robot_ros driver --ros-args -p robot:=kato_10_1 -p config:=mock_twin
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path

from sensor_msgs.msg import JointState

from ...common.errors import DriverError
from ...common.processes import Realtime, go_realtime
from ...common.words import COMPILING
from ...control.inputs import Refusal, by_name, finite
from ...drivers.mock import MockDriver
from ...drivers.safety import FOLLOWING, HOLDING, LIMP, OFF, RELEASED, Supervisor
from ...drivers.tendon_check import due
from ...robot import load_robot
from ..shared.inbox import Received
from ..shared.lifecycle import ERROR, OK, STOP, STOP_TOPIC, WARN, Status, StoppableNode
from ..shared.messages import check_age, offer_trigger
from ..shared.runtime import Ending, repeat, run
from ..shared.senders import gid_text
from ..shared.timing import VALUES_PERIOD_S
from . import backend
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
NO_MORE = 'the sender of the commands lets go'
INACTIVE, INACTIVE_REASON = 'inactive', 'the node is not active'


class DriverNode(StoppableNode):
    """ROS interface of a driver: its motor thread commands, this thread serves topics."""

    def __init__(self) -> None:
        """Declare the parameters; no device is opened yet."""
        super().__init__('driver', drives=True, hears='tendon_command', says='tendon_states')
        self.parameters.watch({'mock_fault': self._inject}, self._retune)
        self.status = Status(self, 'motors')
        self.loop: MotorLoop | None = None
        self._tracker: backend.MockTracker | None = None
        self._refusal: Refusal | None = None
        self._check_due = ''  # why the tendons need a check
        self._cycle: Cycle | None = None
        self.listen()
        resume = partial(self._try, lambda loop: loop.supervisor.resume(), 'waiting for commands')
        reboot = partial(self._try, MotorLoop.reboot, 'rebooted; call reset next')
        for name, act in (('reset', self._reset), ('resume', resume), ('reboot', reboot)):
            offer_trigger(self, f'~/{name}', act)
        repeat(self, VALUES_PERIOD_S, self._publish_status)  # a release is published at once
        # starts the release; the main thread calls `deactivate` later
        Ending.current.then(partial(self.latch.stop, INACTIVE, INACTIVE_REASON))

    def configure(self) -> None:
        """Read the robot, open the port, start to read the motors."""
        robot = load_robot(self.parameters['robot'])
        self.status.arm = robot.name
        reference = self.parameters['tendon_reference']
        self._check_due = due(Path(reference)) if reference else ''
        if self._check_due:
            self.get_logger().warning(self._check_due)
        if self.parameters['backend'] == 'mock':
            text = f'makes the mock arm; {COMPILING}, if not done'
            self.status.publish(WARN, 'starting', text)
        driver, tracker = backend.make(robot, self.parameters, self)
        supervisor = Supervisor(backend.rules(driver, self.parameters))
        supervisor.latch = self.latch
        if hasattr(driver, 'cancelled'):  # its search for the slack of wires may take long
            driver.cancelled = self._cancelled
        driver.open()
        period = 1.0 / self.parameters['rate']
        self.loop = MotorLoop(driver, supervisor, period, self._report, self._receive)
        if isinstance(driver, MockDriver):
            self._tracker = backend.MockTracker(self, driver, tracker)
        self.loop.start()
        if Ending.current.first:  # a mock arm computes: motors of another robot have priority
            mock = isinstance(driver, MockDriver)
            go_realtime(Realtime.MOCK_DRIVER if mock else Realtime.DRIVER)

    def activate(self) -> None:
        """Switch torque on, starting from the measured state."""
        assert self.loop is not None
        loop = self.loop
        self.status.publish(WARN, 'starting', 'switches torque on; looks for slack first if told')
        self.latch.forget(INACTIVE)
        loop.activate()
        if strength := loop.driver.strength():
            self.get_logger().info(strength)
        if silence := loop.driver.silence():
            self.get_logger().info(f'time-out after which motors without commands stop: {silence}')

    def deactivate(self) -> None:
        """Ramp to pretension, then switch torque off if `release_to` is limp."""
        assert self.loop is not None
        if self.loop.crashed is not None:  # the thread has already released the arm
            return
        if not self.loop.release(INACTIVE, INACTIVE_REASON):
            self.get_logger().error('the release did not end in time; torque off')
            self.loop.call(self.loop.driver.disable)

    def cleanup(self) -> None:
        """Close the port; torque stays as after the release."""
        if self._tracker is not None:
            self._tracker.close()
        if self.loop is not None:
            self.loop.close()
        self.loop = self._tracker = self._cycle = None
        for key in self.latch.keys - {STOP, STOP_TOPIC}:  # of motors that are no longer open
            self.latch.forget(key)

    def running(self) -> bool:
        """Raise the error of a motor thread that failed; else as the base class."""
        if self.loop is not None and self.loop.crashed is not None:
            raise self.loop.crashed
        return super().running()

    def _receive(self) -> None:
        """Receive stops and commands; runs in the motor thread before every cycle."""
        self.stop_topic.poll()
        for received in self._inbox.take():
            try:
                self._take(received)
            except Refusal as refusal:
                self._refusal = refusal
        self._refusal = self._inbox.refused() or self._refusal
        if self._senders.died() and self.loop is not None:
            self.loop.let_go('the sender of the commands has died')

    def _take(self, received: Received[JointState]) -> None:
        """Follow a command of the followed publisher; Refusal: the command is invalid."""
        loop, message, what = self.loop, received.message, 'tendon_command'
        if loop is None:
            return
        check_age(self, message.header, what)
        if not message.name:
            if self._senders.counts(time.monotonic(), received):
                loop.let_go(NO_MORE)
            return
        tension = loop.driver.mode == 'tension'
        quantity = 'effort' if tension else 'position'
        values = message.effort if tension else message.position
        ordered = by_name(message.name, values, loop.driver.inputs, what, quantity)
        command = finite(ordered.tolist(), what)
        if self._senders.counts(time.monotonic(), received):
            if self._senders.new:
                loop.newcomer()
            loop.put(command)
            self._refusal = None

    def _report(self, cycle: Cycle) -> None:
        """Publish a state; runs in the motor thread."""
        before, self._cycle = self._cycle, cycle
        assert self.loop is not None
        if before is not None and before.releases < cycle.releases and self.executor is not None:
            self.executor.create_task(self._publish_status)  # so that the controller knows at once
        self.say(self.loop.driver.inputs, cycle.reading.pulls, cycle.reading.tensions)

    def _publish_status(self) -> None:
        """Publish the status."""
        cycle, loop = self._cycle, self.loop
        if loop is None:
            self.stop_topic.poll()
        if cycle is None or loop is None:
            if self.phase == 'unconfigured' and not self.parameters['autostart']:
                self.status.publish(WARN, 'unconfigured', 'waits to be configured')
            return
        decision = cycle.decision
        state, stopped = decision.state, decision.stopped
        level = ERROR if stopped else OK if state == FOLLOWING else WARN
        message = '; '.join([STATE_WORDS[state], *decision.reasons])
        if cycle.held and not decision.reasons:
            message += f' ({cycle.held}); {GO_ON}'
        code = 'stopped' if stopped else state
        if (refusal := self._refusal) is not None:  # read once: the motor thread ends it
            level, code = max(level, WARN), f'refused_{refusal.code}'
            message = f'{refusal}; {message}'
        now = time.monotonic()
        senders, drivers = self._senders, self._own.others(now)
        first, ignored = senders.first(now), senders.names(senders.others(now))
        follows = '' if first is None else senders.names([first])
        notes = [f'follows {follows}, ignores tendon_command of {ignored}'] if ignored else []
        notes += [f'another publishes tendon_states: {drivers}'] if drivers else []
        if notes:
            level, message = max(level, WARN), '; '.join([message, *notes])
        faults = [fault.code for fault in cycle.faults]

        def values() -> dict[str, str]:
            return {
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
                'faults': ', '.join(faults),
                'follows': follows,
                # empty where the gids of messages and of discovery differ
                'follows_gid': gid_text(first) if first and senders.known(first) else '',
                'ignored': ignored,
                'other_drivers': drivers,
                **loop.driver.describe(),
            }

        self.status.publish(level, code, message, values, faults)

    def _cancelled(self) -> bool:
        """Return whether to cancel a search for slack; called in the motor thread."""
        self.stop_topic.poll()
        return bool(Ending.current.signal or self.latch)

    def stop_called(self) -> str:
        """Stop; return what follows, as the service `~/stop` answers."""
        self.stop_now()
        does = 'releasing' if self.loop is not None else 'stopped; no motors are open'
        return f'{does}; call reset to go on'

    def _reset(self) -> str:
        if self.loop is None and self.latch:
            self.latch.reset()
            return 'the stop is over; no motors are open'
        outcome = 'waiting for commands' if self.phase == 'active' else 'activate it next'
        return self._try(MotorLoop.reset, outcome)

    def _try(self, action: Callable[[MotorLoop], None], outcome: str) -> str:
        """Run an action in the motor thread; return `outcome`, or raise its error."""
        loop = self.loop
        if loop is None:
            raise DriverError('the driver is not configured')
        loop.call(lambda: action(loop))
        return outcome

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

    def _retune(self, names: Collection[str]) -> None:
        """Apply changed rates and times."""
        if (loop := self.loop) is not None:
            loop.supervisor.rules = backend.rules(loop.driver, self.parameters)


main = partial(run, DriverNode, first=True)  # until a signal comes
