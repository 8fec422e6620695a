"""
The controller node: takes targets of the tip and publishes the tendon commands that reach them.

Topics: ~/target_pose, ~/target_point, ~/delta_twist, ~/tendon_trajectory, tendon_states, stop
(subscribed);
tendon_command, ~/predicted_shape, ~/predicted_tip, ~/markers, ~/status, /diagnostics (published).
Services: ~/stop, ~/reset. Parameters and units: docs/ros_interface.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ..control import ControllerCore, Refusal
from ..control.report import report
from ..exceptions import TendonRobotError
from . import controller_setup
from .incoming import Incoming
from .lifecycle import ManagedNode
from .messages import joint_state
from .model_loading import ModelLoading
from .parameters import Parameters
from .prediction import Prediction
from .qos import COMMAND, LATCHED, LISTEN
from .runtime import run
from .status import LEVELS, Status

HELP = 'move the tip to targets: poses, points or twists in, tendon commands out'

TELL_PERIOD = 0.02  # [s]


class ControllerNode(ManagedNode):
    """ROS around the controller core; one thread."""

    def __init__(self) -> None:
        """Declare parameters and begin to load the model; nothing is commanded yet."""
        super().__init__('controller')
        self.parameters = Parameters(self, controller_setup.SPECS)
        self.status = Status(self)
        self.core: ControllerCore | None = None
        self._loading = ModelLoading(self.parameters)
        self.parameters.watch({'model': self._loading.change}, self._retune)
        self._incoming: Incoming | None = None
        self._prediction: Prediction | None = None
        self._latency = self._told = 0.0
        self._targets: list[Subscription] = []
        self._commands = self.create_publisher(JointState, 'tendon_command', COMMAND)
        self.create_subscription(JointState, 'tendon_states', self._states, LISTEN)
        self.create_subscription(PoseStamped, 'measured_tip', self._tip, LISTEN)
        self.create_subscription(Bool, 'stop', self._stop_topic, LATCHED)
        if self.parameters['driver_status']:
            self.create_subscription(
                DiagnosticStatus, self.parameters['driver_status'], self._driver, LATCHED
            )
        self.create_service(Trigger, '~/stop', self._stop)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_timer(1.0 / self.parameters['rate'], self._cycle)
        self.create_timer(1.0 / self.parameters['shape_rate'], self._predict)
        self._stop_asked = False
        self._driver_stopped = ''

    def ready(self) -> bool:
        """Whether the model is compiled, so that `configure` returns soon."""
        if self._loading.compiling:
            self.status.say(LEVELS['warn'], 'compiling', 'compiling the model, once; a minute')
        return self._loading.done

    def configure(self) -> None:
        """Load the model."""
        model = self._loading.result()
        self.core = ControllerCore(model, controller_setup.settings(self.parameters))
        self.core.driver_says(self._driver_stopped)
        if self._stop_asked:
            self.core.stop('stop topic', 'topic stop says true', lasting=True)
        self._incoming = Incoming(self, self.parameters, model)
        self._prediction = Prediction(self, self._incoming.base, model)

    def activate(self) -> None:
        """Begin to hear targets: who waits for a subscriber sends none in vain."""
        subscribe = self.create_subscription
        self._targets = [
            subscribe(PoseStamped, '~/target_pose', self._pose, COMMAND),
            subscribe(PointStamped, '~/target_point', self._point, COMMAND),
            subscribe(TwistStamped, '~/delta_twist', self._twist, LISTEN),
            subscribe(JointTrajectory, '~/tendon_trajectory', self._trajectory, COMMAND),
        ]

    def deactivate(self) -> None:
        """Go silent; the driver then releases the arm."""
        while self._targets:
            self.destroy_subscription(self._targets.pop())

    def cleanup(self) -> None:
        """Forget the model; the next `configure` loads it anew."""
        if self._prediction is not None:
            self._prediction.close()
        self.core = self._incoming = self._prediction = None
        self._loading.restart()

    def end(self, spin: Callable[[float], None]) -> None:
        """End; the driver then hears no commands and releases the arm."""
        self._loading.cancel()
        super().end(spin)

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.status.say(LEVELS['error'], 'not_ready', message)

    def _pose(self, message: PoseStamped) -> None:
        self._take('target', lambda core, incoming: core.aim(incoming.pose(message)))

    def _point(self, message: PointStamped) -> None:
        self._take('target', lambda core, incoming: core.aim(incoming.point(message)))

    def _twist(self, message: TwistStamped) -> None:
        self._take('target', lambda core, new: core.twist(time.monotonic(), new.twist(message)))

    def _trajectory(self, message: JointTrajectory) -> None:
        self._take(
            'target', lambda core, new: core.play(time.monotonic(), new.trajectory(message))
        )

    def _states(self, message: JointState) -> None:
        def take(core: ControllerCore, incoming: Incoming) -> None:
            core.measured(time.monotonic(), *incoming.states(message))

        self._take('states', take)

    def _tip(self, message: PoseStamped) -> None:
        def take(core: ControllerCore, incoming: Incoming) -> None:
            core.loop.take(time.monotonic(), core, incoming.measured_tip(message))

        if self.parameters['tip_gain'] > 0.0:
            self._take('tip', take)

    def _take(self, kind: str, action: Callable[[ControllerCore, Incoming], None]) -> None:
        """Use a message, and answer a target with a command at once; or say why not."""
        core, target = self.core, kind == 'target'
        if core is None or self._incoming is None:
            return
        began = time.monotonic()
        try:
            action(core, self._incoming)
        except Refusal as refusal:
            core.refusals[kind] = refusal
            return
        core.refusals.pop(kind, None)
        if target:
            core.refusals.pop('model', None)  # has been said
            self._cycle()
            self._latency = time.monotonic() - began

    def _cycle(self) -> None:
        """Publish a command."""
        core = self.core
        if core is None or self.phase != 'active':
            return
        now = time.monotonic()
        self._reload(core)
        output = core.step(now)
        if output is not None:
            pulls = output.pulls
            tensions = output.tensions if pulls is None else None
            stamp = self.get_clock().now().to_msg()
            self._commands.publish(joint_state(stamp, core.model.inputs, pulls, tensions))
        if now - self._told >= TELL_PERIOD:
            self._told = now
            self._tell(core, now)

    def _tell(self, core: ControllerCore, now: float) -> None:
        """Publish the status."""
        said = report(core, now)
        if self._loading.note:
            said.values['model'] = self._loading.note
        said.values['target_to_command'] = f'{1e3 * self._latency:.2f} ms'
        self.status.say(LEVELS[said.level], said.code, said.message, said.values)

    def _reload(self, core: ControllerCore) -> None:
        """Take a model that was asked for and is loaded by now."""
        if not (self._loading.asked and self._loading.done):
            return
        try:
            model = self._loading.result()
            core.set_model(model)
        except TendonRobotError as error:
            self._loading.refuse(str(error))
            core.refusals['model'] = Refusal('model', f'the old model stays: {error}')
        else:
            self._loading.accept()
            core.refusals.pop('model', None)
            self.get_logger().info(f'model loaded: {self._loading.note}')

    def _predict(self) -> None:
        if self.core is not None and self._prediction is not None:
            self._prediction.publish(self.core.predict(time.monotonic()))

    def _driver(self, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        stopped = values.get('stopped') == 'true'
        self._driver_stopped = values.get('reasons', message.message) if stopped else ''
        if self.core is not None:
            self.core.driver_says(self._driver_stopped)

    def _stop_topic(self, message: Bool) -> None:
        self._stop_asked = message.data
        if self.core is None:
            return
        if message.data:
            self.core.stop('stop topic', 'topic stop says true', lasting=True)
        else:
            self.core.latch.cause_gone('stop topic')

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.core is not None
        response.message = 'stopped; the driver releases the arm; call reset to go on'
        if self.core is not None:
            self.core.stop('stop', 'stop was called')
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self.core is not None, 'waiting for a target'
        try:
            if self.core is not None:
                self.core.reset()
        except TendonRobotError as error:
            response.success, response.message = False, str(error)
        return response

    def _retune(self) -> None:
        """Apply changed parameters."""
        if self.core is not None:
            self.core.settings = controller_setup.settings(self.parameters)


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(ControllerNode, arguments)
