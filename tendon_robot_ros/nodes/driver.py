"""
The driver node: puts tendon commands on motors, and lets the arm go safely when they stay away.

Topics: tendon_command, stop (subscribed); tendon_states, ~/status, /diagnostics (published);
with the mock also measured_tip and measured_shape. Services: ~/stop, ~/reset, ~/reboot.
Parameters and units: docs/ros_interface.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from ..control.checks import Refusal, by_name, check_stamp, finite
from ..drivers.mock import MockDriver
from ..drivers.supervisor import FOLLOWING, LIMP, OFF, RELEASED, Supervisor
from ..exceptions import TendonRobotError
from . import driver_setup
from .bus import Bus, Cycle
from .lifecycle import ManagedNode
from .messages import joint_state, seconds
from .parameters import Parameters
from .qos import COMMAND, LATCHED, STATE
from .runtime import asked_to_end, run
from .shared import read_robot
from .status import ERROR, OK, WARN, Status
from .tracker import MockTracker

HELP = 'drive motors, or a mock arm, from tendon commands'
MESSAGES = {
    FOLLOWING: 'following commands',
    RELEASED: 'released, holding',
    LIMP: 'released, torque off',
    OFF: 'torque off',
    'releasing': 'releasing',
}


class DriverNode(ManagedNode):
    """ROS around a driver: the bus thread moves the motors, this thread hears and tells."""

    def __init__(self) -> None:
        """Declare parameters; nothing is opened yet."""
        super().__init__('driver')
        self.parameters = Parameters(self, driver_setup.SPECS)
        self.parameters.watch({'mock_fault': self._inject}, self._retune)
        self.status = Status(self)
        self.bus: Bus | None = None
        self._tracker: MockTracker | None = None
        self._refusal: Refusal | None = None
        self._cycle: Cycle | None = None
        self._states = self.create_publisher(JointState, 'tendon_states', STATE)
        self.create_subscription(JointState, 'tendon_command', self._command, COMMAND)
        self.create_subscription(Bool, 'stop', self._stop_topic, LATCHED)
        self.create_service(Trigger, '~/stop', self._stop)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/reboot', self._reboot)
        self.create_timer(0.05, self._tell)
        self._stop_asked = False

    def configure(self) -> None:
        """Read the robot, open the port, begin to read."""
        robot = read_robot(self.parameters['robot'])
        driver, tracker = driver_setup.make(robot, self.parameters, self)
        supervisor = Supervisor(driver_setup.rules(robot, driver, self.parameters))
        if hasattr(driver, 'cancelled'):  # it may look long for the slack of its wires
            driver.cancelled = asked_to_end
        driver.open()
        self.bus = Bus(driver, supervisor, 1.0 / self.parameters['rate'], self._report)
        if isinstance(driver, MockDriver):
            self._tracker = MockTracker(self, driver, tracker, self.parameters)
        self.bus.start()
        if self._stop_asked:
            self._latch('stop topic', 'topic stop says true', lasting=True)

    def activate(self) -> None:
        """Torque on, from the measured state."""
        assert self.bus is not None
        bus = self.bus
        bus.call(lambda: bus.supervisor.latch.forget('inactive'))
        bus.activate()

    def deactivate(self) -> None:
        """Ramp to pretension, then torque off if so told."""
        assert self.bus is not None
        if self.bus.crashed is not None:  # the thread has already done what it could
            return
        if not self.bus.release('inactive', 'the node is not active', self._release_time()):
            self.get_logger().error('the release did not end in time; torque off')
            self.bus.call(self.bus.driver.disable)

    def cleanup(self) -> None:
        """Close the port; torque stays as the release left it."""
        if self._tracker is not None:
            self._tracker.close()
        if self.bus is not None:
            self.bus.close()
        self.bus = self._tracker = self._cycle = None

    def running(self) -> bool:
        """Go on unless the bus thread died."""
        if self.bus is not None and self.bus.crashed is not None:
            raise self.bus.crashed
        return super().running()

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.status.say(ERROR, 'not_ready', message)

    def _release_time(self) -> float:
        assert self.bus is not None
        rules = self.bus.supervisor.rules
        return float(np.max(np.ptp(rules.limits, axis=1)) / rules.release_rate) + 1.0

    def _command(self, message: JointState) -> None:
        if self.bus is None:
            return
        try:
            now = 1e-9 * self.get_clock().now().nanoseconds
            check_stamp(
                seconds(message.header.stamp),
                now,
                self.parameters['stamp_tolerance'],
                'tendon_command',
            )
            tension = self.bus.driver.mode == 'tension'
            quantity, values = (
                ('effort', message.effort) if tension else ('position', message.position)
            )
            ordered = by_name(
                message.name, values, self.bus.driver.inputs, 'tendon_command', quantity
            )
            self.bus.put(finite(ordered.tolist(), 'tendon_command'))
            self._refusal = None
        except Refusal as refusal:
            self._refusal = refusal

    def _report(self, cycle: Cycle) -> None:
        """Publish a state; runs in the bus thread."""
        self._cycle = cycle
        assert self.bus is not None
        self._states.publish(
            joint_state(
                self.get_clock().now().to_msg(),
                self.bus.driver.inputs,
                cycle.reading.pulls,
                cycle.reading.tensions,
            )
        )

    def _tell(self) -> None:
        """Publish the status."""
        cycle, bus = self._cycle, self.bus
        if cycle is None or bus is None:
            if self.phase == 'unconfigured' and not self.parameters['autostart']:
                self.status.say(WARN, 'unconfigured', 'waits to be configured')
            return
        decision, stopped = cycle.decision, bool(bus.supervisor.latch)
        level = OK if decision.state == FOLLOWING else ERROR if stopped else WARN
        message = '; '.join([MESSAGES[decision.state], *decision.reasons])
        code = 'stopped' if stopped else decision.state
        if self._refusal is not None:
            level, code = max(level, WARN), f'refused_{self._refusal.code}'
            message = f'{self._refusal}; {message}'
        values = {
            'state': decision.state,
            'stopped': str(stopped).lower(),
            'reasons': '; '.join(decision.reasons),
            'mode': bus.driver.mode,
            'tension_source': cycle.reading.source,
            'clipped': ', '.join(decision.clipped),
            'torque_off': ', '.join(decision.off),
            'faults': ', '.join(fault.code for fault in cycle.reading.faults),
            **bus.driver.describe(),
        }
        self.status.say(level, code, message, values)

    def _latch(self, key: str, reason: str, lasting: bool = False) -> None:
        if self.bus is not None:
            bus = self.bus
            bus.call(lambda: bus.supervisor.latch.stop(key, reason, lasting))

    def _stop_topic(self, message: Bool) -> None:
        self._stop_asked = message.data
        if message.data:
            self._latch('stop topic', 'topic stop says true', lasting=True)
        elif self.bus is not None:
            bus = self.bus
            bus.call(lambda: bus.supervisor.latch.cause_gone('stop topic'))

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._latch('stop', 'stop was called')
        response.success, response.message = True, 'releasing; call reset to go on'
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._try(response, lambda bus: bus.supervisor.reset(), 'waiting for commands')

    def _reboot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._try(response, lambda bus: bus.driver.reboot(), 'rebooted; call reset next')

    def _try(
        self, response: Trigger.Response, action: Callable[[Bus], None], done: str
    ) -> Trigger.Response:
        response.success, response.message = self.bus is not None, done
        try:
            if self.bus is not None:
                bus = self.bus
                bus.call(lambda: action(bus))
            else:
                response.message = 'the driver is not configured'
        except TendonRobotError as error:
            response.success, response.message = False, ' '.join(str(error).split())
        return response

    def _inject(self, text: str) -> None:
        """Inject a fault into the mock: CODE or CODE:INPUT,INPUT; empty clears."""
        driver = None if self.bus is None else self.bus.driver
        if not isinstance(driver, MockDriver):
            raise Refusal('mock_fault', 'mock_fault: needs backend mock, configured')
        if not text:
            driver.clear()
            return
        code, _, names = text.partition(':')
        driver.inject(code, [name for name in names.split(',') if name])

    def _retune(self) -> None:
        """Apply changed rates and times."""
        if self.bus is not None:
            bus = self.bus
            made = driver_setup.rules(bus.driver.robot, bus.driver, self.parameters)
            bus.supervisor.rules = made


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(DriverNode, arguments)
