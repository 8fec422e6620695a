"""
The controller node: takes targets of the tip and publishes the tendon commands that reach them.

Topics: ~/target_pose, ~/target_point, ~/delta_twist, ~/tendon_trajectory, tendon_states, stop
(subscribed);
tendon_command, ~/predicted_shape, ~/predicted_tip, ~/markers, ~/status, /diagnostics (published).
Services: ~/stop, ~/reset. Actions, where their types are installed: ~/follow_joint_trajectory,
~/navigate_to_pose, ~/navigate_through_poses. Parameters and units: docs/ros_interface.md.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ...common.errors import TendonRobotError
from ...common.local_stop import StopListener, Stoppable
from ...common.processes import REALTIME_PRIORITY_SECOND, go_realtime, in_realtime
from ...control import ControllerCore, Refusal
from ...control.checks import another_robot
from ...control.solver import SOLVER, Worker
from ...control.status import controller_status
from ...model.model import Model
from ...robot.keep_out import KeepOut
from ..shared.inbox import STOP_REASON, Inbox, LateService, Service, StopTopic, hear_anybody
from ..shared.joints import JointReader, Joints
from ..shared.lifecycle import LEVELS, ManagedNode, Status
from ..shared.messages import (
    COMMAND,
    JOINTS,
    LISTEN,
    passing_subscription,
    refilled,
    stamp_now,
)
from ..shared.parameters import Parameters
from ..shared.runtime import goes_first, repeat, run
from ..shared.senders import (
    OtherPublishers,
    PublisherNames,
    PublisherSocket,
    Received,
    Senders,
    gid_of,
    gid_text,
)
from . import parameters
from .actions import Actions
from .driver_link import DriverLink
from .incoming import Incoming
from .model import ModelLoading, Prediction

HELP = 'move the tip to targets: poses, points or twists in, tendon commands out'

STATUS_LOOK_PERIOD_S = 0.02  # [s]
STOP_CALLED = 'stop was called'
NOT_READY = 'the controller is not configured', 'the stop is over; there is no model'
SAID_IN_S = 0.02  # [s] a word is lost when its publisher leaves before it is heard
STARTING_WORDS = {
    'loading': 'reading the model',
    'compiling': 'compiling the model, once; a minute',
    'building': 'building the library of shapes',
}


class ControllerNode(ManagedNode):
    """ROS around the controller core: one thread, and one that hears stops."""

    def __init__(self) -> None:
        """Declare parameters and begin to load the model; nothing is commanded yet."""
        super().__init__('controller')
        self.parameters = Parameters(self, parameters.SPECS)
        self.status = Status(self, 'control')
        self.core: ControllerCore | None = None
        self._loading = ModelLoading(self.parameters)
        checks: dict[str, Callable[[str], object]] = {
            'model': self._loading.change,
            'keep_out': self._fence,
            'prefer_stiffness_along': parameters.direction_of,
        }
        self._keep_out, self._stopped = KeepOut(), False  # before there was anything to stop
        self.parameters.watch(checks, self._retune)
        self._incoming: Incoming | None = None
        self._prediction: Prediction | None = None
        self._latency = self._told = self._asked = 0.0
        self._solver: Worker | None = None
        self._targets: list[Subscription] = []
        self._actions: Actions | None = None
        self._drivers, self._names = Senders(), PublisherNames(self, 'tendon_states')
        self._speaking = threading.Lock()
        self._command = JointState()
        self._commands = self.create_publisher(JointState, 'tendon_command', COMMAND)
        self._socket = PublisherSocket(self._commands)
        self._controllers = OtherPublishers(self, self._commands)
        self._measured = Inbox(self, JointState, 'tendon_states', JOINTS, JointReader())
        self._tracker: Subscription | None = None
        self._hear_tip()
        self._driver = DriverLink(
            self,
            self.parameters['driver_status'],
            gid_text(gid_of(self._commands)),
            self._driver_said,
        )
        stop = Service(self, Trigger, '~/stop', self._stop)
        reset = LateService(self, Trigger, '~/reset', self._asked_to_reset)
        self._stop_topic = StopTopic(self, self._stop_said, self._stop_gone, [stop, reset])
        self._local_stop = StopListener(
            self.context.get_domain_id(),
            Stoppable(self.get_fully_qualified_name(), drives=False),
            self._stop_now,
        )
        repeat(self, 1.0 / self.parameters['rate'], self._cycle)
        repeat(self, 1.0 / self.parameters['shape_rate'], self._predict)

    def ready(self) -> bool:
        """Whether the model is compiled, so that `configure` returns soon."""
        done = self._loading.done
        if not done:
            doing = self._loading.doing
            self.status.say(LEVELS['warn'], doing, STARTING_WORDS[doing])
        return done

    def configure(self) -> None:
        """Load the model."""
        self.ready()  # says what takes so long, also where a person configures
        model = self._loading.result()
        self._loading.accept(model)
        self.status.arm = model.robot.name
        self._solver = Worker(self._wake)
        self._fence(self.parameters['keep_out'])
        settings = parameters.settings(self.parameters, self._keep_out)
        self.core = ControllerCore(model, settings, self._solver)
        self.core.driver_says(*self._driver.said)
        if self._stop_topic.says:
            self._stop_said(STOP_REASON)
        if self._stopped:
            self.core.latch.stop('stop', STOP_CALLED)
        self._incoming = Incoming(self, self.parameters, model)
        self._prediction = Prediction(self, self._incoming.base, model)
        if goes_first():
            go_realtime(REALTIME_PRIORITY_SECOND, but=[SOLVER])
            if in_realtime():  # the thread that limits it
                self._solver.lend_realtime()

    def activate(self) -> None:
        """Begin to hear targets: who waits for a subscriber sends none in vain."""
        if self._actions is None:
            self._actions = Actions(self)
        self._targets = [
            *hear_anybody(self, PoseStamped, '~/target_pose', self._pose, self._too_long),
            *hear_anybody(self, PointStamped, '~/target_point', self._point, self._too_long),
            passing_subscription(self, TwistStamped, '~/delta_twist', self._twist, LISTEN),
            *hear_anybody(
                self, JointTrajectory, '~/tendon_trajectory', self._trajectory, self._too_long
            ),
        ]

    def deactivate(self) -> None:
        """Have the arm let go, and go silent."""
        while self._targets:
            self.destroy_subscription(self._targets.pop())
        self._let_go()

    def cleanup(self) -> None:
        """Forget the model; the next `configure` loads it anew."""
        if self._prediction is not None:
            self._prediction.close()
        if self._solver is not None:
            self._solver.close()
        self.core = self._incoming = self._prediction = self._solver = None
        self._loading.forget()

    def end(self, spin: Callable[[float], None]) -> None:
        """End; the driver is told to release the arm, and hears no commands."""
        self._loading.cancel()
        super().end(spin)
        time.sleep(SAID_IN_S)

    def destroy_node(self) -> None:
        """Hear no more."""
        self._stop_topic.close()
        self._local_stop.close()
        self._measured.close()
        self._socket.close()
        super().destroy_node()

    def problem(self, message: str) -> None:
        """Say why a transition was refused."""
        self.status.say(LEVELS['error'], 'not_ready', message, once=True)

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

    def _too_long(self, problem: str) -> None:
        if self.core is not None:
            self.core.refusals['target'] = Refusal('length', problem)

    def _states(self, heard: Received[Joints]) -> None:
        def take(core: ControllerCore, incoming: Incoming) -> None:
            now, measured = time.monotonic(), incoming.states(heard.message)
            if self._drivers.counts(now, heard):
                core.measured(now, *measured)

        self._take('states', take)

    def _tip(self, message: PoseStamped) -> None:
        def take(core: ControllerCore, incoming: Incoming) -> None:
            core.tip_measured(time.monotonic(), incoming.measured_tip(message))

        self._take('tip', take)

    def _hear_tip(self) -> None:
        """Subscribe to the tracker while the loop is closed: nobody is woken in vain."""
        if (self.parameters['tip_gain'] > 0.0) == (self._tracker is not None):
            return
        if self._tracker is not None:
            self.destroy_subscription(self._tracker)
            self._tracker = None
        else:
            self._tracker = passing_subscription(
                self, PoseStamped, 'measured_tip', self._tip, LISTEN
            )

    def _take(self, kind: str, action: Callable[[ControllerCore, Incoming], None]) -> None:
        """Use a message, or say why not."""
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
            self._asked = began

    def _wake(self) -> None:
        """Have a target that is solved answered before the next cycle; called by the solver."""
        if self.executor is not None:
            self.executor.create_task(self._answer)

    def _answer(self) -> None:
        """Command what was found at once."""
        core = self.core
        if core is None:
            return
        before = core.solution
        core.solver.serve()
        if core.solution is not before:
            self._cycle()
            self._latency = time.monotonic() - self._asked

    def _cycle(self) -> None:
        """Hear stops and states, publish a command."""
        self._stop_topic.poll()
        if self._solver is not None:
            self._solver.limit_realtime()
        for heard in self._measured.take():
            self._states(heard)
        core, now = self.core, time.monotonic()
        if (problem := self._measured.refused()) and core is not None:
            core.refusals['states'] = Refusal('length', problem)
        if core is None or self.phase != 'active':
            self._idle(now)
            return
        self._reload(core)
        if self._actions is not None and self._incoming is not None:
            self._actions.serve(now, core, self._incoming)
        self._driver.poll()
        if core.wants_driver and self._driver.may_ask:
            self._driver.resume(self._resumed)
        output = core.step(now)
        if output is not None:
            pulls = output.pulls
            tensions = output.tensions if pulls is None else None
            with self._speaking:
                if not core.latch:  # a stop that came meanwhile has the last word
                    self._command.name = core.model.inputs
                    self._commands.publish(
                        refilled(self._command, stamp_now(self), pulls, tensions)
                    )
        if now - self._told >= STATUS_LOOK_PERIOD_S:
            self._told = now
            self._tell(core, now)

    def _let_go(self) -> None:
        """Have the driver release at once: a command without tendons. Silence does it later."""
        with self._speaking:
            self._commands.publish(JointState(header=Header(stamp=stamp_now(self))))

    def _idle(self, now: float) -> None:
        """Publish that it waits for a transition: the last status would go on being heard."""
        if self._actions is not None:
            self._actions.drop('the controller is not active')
        if now - self._told < STATUS_LOOK_PERIOD_S:
            return
        self._told = now
        if self.phase == 'inactive':
            self.status.say(LEVELS['warn'], 'off', 'not active: it commands nothing')
        elif not self.parameters['autostart']:
            self.status.say(LEVELS['warn'], 'unconfigured', 'waits to be configured')

    def _tell(self, core: ControllerCore, now: float) -> None:
        """Publish the status."""
        status = controller_status(core, now)
        if self._loading.note:
            status.values['model'] = self._loading.note
        status.values['target_to_command (s)'] = f'{self._latency:.5f}'
        level, message = LEVELS[status.level], status.message
        drivers = self._names.of(self._drivers.others(now))
        controllers = self._controllers.names(now)
        if drivers or controllers:
            level = max(level, LEVELS['warn'])
            message += f'; ignores tendon_states of {drivers}' if drivers else ''
            message += f'; another publishes tendon_command: {controllers}' if controllers else ''
        status.values.update({'ignored': drivers, 'other_controllers': controllers})
        self.status.say(level, status.code, message, status.values)

    def _reload(self, core: ControllerCore) -> None:
        """Take a model that was asked for and is loaded by now."""
        if not (self._loading.asked and self._loading.done):
            return
        try:
            model = self._loading.result()
        except TendonRobotError as error:
            self._refuse(core, error)
            return
        core.set_model(model, lambda error: self._swapped(core, model, error))

    def _swapped(self, core: ControllerCore, model: Model, error: TendonRobotError | None) -> None:
        """Hear that the model works where the arm is, or why not."""
        if error is not None:
            self._refuse(core, error)
        elif self._incoming is not None and self._prediction is not None:
            if another_robot(model.robot, self._incoming.robot):
                self.get_logger().warning('another robot: the target is void, the arm holds')
            self._incoming.use(model)
            self._prediction.use(self._incoming.base, model)
            self._loading.accept(model)
            self.status.arm = model.robot.name
            core.refusals.pop('model', None)
            self.get_logger().info(f'model loaded: {self._loading.note}')

    def _refuse(self, core: ControllerCore, error: TendonRobotError) -> None:
        self._loading.refuse()
        core.refusals['model'] = Refusal('model', f'the old model stays: {error}')

    def _predict(self) -> None:
        if self.core is not None and self._prediction is not None:
            self.core.predict(time.monotonic(), self._prediction.publish)

    def _driver_said(self, stopped: str, released: str, releases: int, other: str) -> None:
        if self.core is not None:
            self.core.driver_says(stopped, released, releases, other)

    def _resumed(self, follows: bool, why: str) -> None:
        """Hear whether the driver follows again."""
        if self.core is not None and follows:
            self.core.resumed()
        elif self.core is not None:
            self.core.not_resumed(why)

    def _stop_said(self, reason: str) -> None:
        if self.core is not None:
            self.core.stop('stop topic', reason, lasting=True)
            self._let_go()

    def _stop_gone(self) -> None:
        if self.core is not None:
            self.core.latch.cause_gone('stop topic')

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stop_now()
        another = self._driver.said[-1]  # is followed by the driver
        if self.core is None:
            told = 'it has no model and commands nothing, so the driver is told nothing'
        elif another:
            told = f'the driver does not hear it, {another}'
        elif not self._commands.get_subscription_count():
            told = 'no driver hears it'
        else:
            told = 'the driver releases the arm'
        response.success, response.message = True, f'stopped; {told}; call reset to go on'
        return response

    def _stop_now(self) -> None:
        """Stop at once, in the thread that hears of it; the core drops its target next."""
        self._stopped = True
        if (core := self.core) is not None:
            core.latch.stop('stop', STOP_CALLED)
            self._let_go()

    def _asked_to_reset(self, request: Trigger.Request, send: Callable[[object], None]) -> None:
        """Have the executor reset; the thread that hears stops does not wait for the driver."""
        if self.core is None or self.executor is None:
            stopped, self._stopped = self._stopped, False
            send(Trigger.Response(success=stopped, message=NOT_READY[stopped]))
        else:
            self.executor.create_task(lambda: self._reset(send))

    def _reset(self, send: Callable[[object], None]) -> None:
        """Clear the stops when the driver says that it follows: its status comes later."""

        def reset() -> None:
            response = Trigger.Response(success=True, message='waiting for a target')
            try:
                if self.core is not None:
                    self.core.reset()
                    self._stopped = False
            except TendonRobotError as error:
                response.success, response.message = False, str(error)
            send(response)

        def answered(follows: bool, why: str) -> None:
            if follows:
                self._resumed(follows, why)
                reset()
            else:
                why = f'reset refused: the driver is stopped: {why}'
                send(Trigger.Response(success=False, message=why))

        another = self._driver.said[-1]  # is followed by the driver
        if another or not self._driver.resume(answered):
            reset()

    def _retune(self) -> None:
        """Apply changed parameters."""
        self._hear_tip()
        if self.core is not None:
            self.core.settings = parameters.settings(self.parameters, self._keep_out)

    def _fence(self, text: str) -> None:
        """Take keep-out regions; they are read once, when they are set."""
        self._keep_out = parameters.keep_out_of(text)


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(ControllerNode, arguments, first=True)
