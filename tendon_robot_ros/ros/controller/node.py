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
from functools import partial
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ...common.errors import TendonRobotError
from ...common.processes import Realtime, go_realtime, in_realtime
from ...control import ControllerCore, Refusal
from ...control.checks import another_robot
from ...control.solver import SOLVER, Worker
from ...control.status import controller_status, controller_values
from ...drivers.safety import StopLatch
from ...model.model import Model
from ...robot.keep_out import KeepOut
from ..shared.inbox import Inbox, Received, Service, hear_anybody
from ..shared.lifecycle import LEVELS, Status, StoppableNode
from ..shared.messages import COMMAND, JOINTS, LISTEN, passing_subscription, refilled, stamp_now
from ..shared.parameters import Parameters
from ..shared.runtime import goes_first, repeat, run
from ..shared.senders import OwnPublisher, PublisherNames, Senders, gid_text
from ..shared.timing import NEWS_PERIOD_S
from . import parameters
from .actions import Actions
from .parameters import ModelLoading
from .topics import DriverLink, Incoming, Prediction

HELP = 'move the tip to targets: poses, points or twists in, tendon commands out'

NOT_READY = 'the controller is not configured', 'the stop is over; there is no model'
STARTING_WORDS = {
    'loading': 'reading the model',
    'compiling': 'compiling the model, once; a minute',
    'building': 'building the library of shapes',
}


class ControllerNode(StoppableNode):
    """ROS around the controller core: one thread, and one that hears stops."""

    def __init__(self) -> None:
        """Declare parameters and begin to load the model; nothing is commanded yet."""
        super().__init__('controller', drives=False)
        self.parameters = Parameters(self, parameters.SPECS)
        self.status = Status(self, 'control')
        self.core: ControllerCore | None = None
        self._loading = ModelLoading(self.parameters)
        self._keep_out = KeepOut()
        checks: dict[str, Callable[[str], object]] = {
            'model': self._loading.change,
            'keep_out': self._fence,
            'prefer_stiffness_along': parameters.direction_of,
        }
        self.parameters.watch(checks, self._retune)
        self._incoming: Incoming | None = None
        self._prediction: Prediction | None = None
        self._latency = self._told = self._asked = 0.0  # [s]
        self._solver: Worker | None = None
        self._targets: list[Subscription] = []
        self._actions: Actions | None = None
        self._drivers, self._names = Senders(), PublisherNames(self, 'tendon_states')
        self._speaking = threading.Lock()
        self._command = JointState()
        self._commands = self.create_publisher(JointState, 'tendon_command', COMMAND)
        self._own = OwnPublisher(self, self._commands)
        self._measured = Inbox(self, JointState, 'tendon_states', JOINTS)
        self._tracker: Subscription | None = None
        self._hear_tip()
        topic, gid = self.parameters['driver_status'], gid_text(self._own.gid)

        def driver_said(*said: Any) -> None:
            if self.core is not None:
                self.core.driver_says(*said)

        def predict() -> None:
            if self.core is not None and self._prediction is not None:
                self.core.predict(time.monotonic(), self._prediction.publish)

        self._driver = DriverLink(self, topic, gid, driver_said)
        self.listen(Service(self, Trigger, '~/reset', self._asked_to_reset))
        repeat(self, 1.0 / self.parameters['rate'], self._cycle)
        repeat(self, 1.0 / self.parameters['shape_rate'], predict)

    @property
    def latch(self) -> StopLatch | None:
        """What holds the stops; None while there is no model."""
        core = self.core  # any thread may ask
        return None if core is None else core.latch

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
        self.stop_as_told()
        self._incoming = Incoming(self, self.parameters, model)
        self._prediction = Prediction(self, self._incoming.base, model)
        if goes_first():
            go_realtime(Realtime.CONTROLLER, but=[SOLVER])
            if in_realtime():  # the thread that limits it
                self._solver.lend_realtime()

    def activate(self) -> None:
        """Begin to hear targets: who waits for a subscriber sends none in vain."""
        if self._actions is None:
            self._actions = Actions(self)

        target = partial(partial, self._take, 'target')
        pose = target(lambda core, new, message: core.aim(new.pose(message)))
        point = target(lambda core, new, message: core.aim(new.point(message)))
        now = time.monotonic
        twist = target(lambda core, new, message: core.twist(now(), new.twist(message)))
        play = target(lambda core, new, message: core.play(now(), new.trajectory(message)))

        def too_long(problem: str) -> None:
            if self.core is not None:
                self.core.refusals['target'] = Refusal('length', problem)

        self._targets = [
            *hear_anybody(self, PoseStamped, '~/target_pose', pose, too_long),
            *hear_anybody(self, PointStamped, '~/target_point', point, too_long),
            passing_subscription(self, TwistStamped, '~/delta_twist', twist, LISTEN),
            *hear_anybody(self, JointTrajectory, '~/tendon_trajectory', play, too_long),
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

    def end(self) -> None:
        """End; the driver is told to release the arm, and hears no commands."""
        self._loading.cancel()
        super().end()
        time.sleep(NEWS_PERIOD_S)  # a message is lost when its publisher leaves before it is heard

    def destroy_node(self) -> None:
        """Hear no more."""
        self._measured.close()
        self._own.close()
        super().destroy_node()

    def _hear_tip(self) -> None:
        """Subscribe to the tracker while the loop is closed: nobody is woken in vain."""
        closed = self.parameters['tip_gain'] > 0.0
        if self._tracker is not None and not closed:
            self.destroy_subscription(self._tracker)
            self._tracker = None
        elif self._tracker is None and closed:

            def tip(core: ControllerCore, incoming: Incoming, message: PoseStamped) -> None:
                core.tip_measured(time.monotonic(), incoming.measured_tip(message))

            self._tracker = passing_subscription(
                self, PoseStamped, 'measured_tip', partial(self._take, 'tip', tip), LISTEN
            )

    def _take(
        self, kind: str, action: Callable[[ControllerCore, Incoming, Any], None], message: Any
    ) -> None:
        """Use a message, or say why not."""
        core = self.core
        if core is None or self._incoming is None:
            return
        began = time.monotonic()
        try:
            action(core, self._incoming, message)
        except Refusal as refusal:
            core.refusals[kind] = refusal
            return
        core.refusals.pop(kind, None)
        if kind == 'target':
            core.refusals.pop('model', None)  # has been said
            self._asked = began

    def _states(
        self, core: ControllerCore, incoming: Incoming, heard: Received[JointState]
    ) -> None:
        """Take what the driver measures, if it is the one to follow."""
        now, measured = time.monotonic(), incoming.states(heard.message)
        if self._drivers.counts(now, heard):
            core.measured(now, *measured)

    def _wake(self) -> None:
        """Have a target that is solved commanded before the next cycle; called by the solver."""

        def answer() -> None:
            if (core := self.core) is None:
                return
            before = core.solution
            core.solver.serve()
            if core.solution is not before:
                self._cycle()
                self._latency = time.monotonic() - self._asked

        if self.executor is not None:
            self.executor.create_task(answer)

    def _cycle(self) -> None:
        """Hear stops and states, publish a command."""
        self.stop_topic.poll()
        if self._solver is not None:
            self._solver.limit_realtime()
        core = self.core
        for heard in self._measured.take():
            self._take('states', self._states, heard)
        now = time.monotonic()
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
        if now - self._told >= NEWS_PERIOD_S:
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
        if now - self._told < NEWS_PERIOD_S:
            return
        self._told = now
        if self.phase == 'inactive':
            self.status.say(LEVELS['warn'], 'off', 'not active: it commands nothing')
        elif not self.parameters['autostart']:
            self.status.say(LEVELS['warn'], 'unconfigured', 'waits to be configured')

    def _tell(self, core: ControllerCore, now: float) -> None:
        """Publish the status."""
        status = controller_status(core, now)
        level, message = LEVELS[status.level], status.message
        drivers = self._names.of(self._drivers.others(now))
        controllers = self._own.others(now)
        if drivers or controllers:
            level = max(level, LEVELS['warn'])
            message += f'; ignores tendon_states of {drivers}' if drivers else ''
            message += f'; another publishes tendon_command: {controllers}' if controllers else ''

        def values() -> dict[str, str]:
            model = {'model': self._loading.note} if self._loading.note else {}
            return {
                **controller_values(core, now),
                **model,
                'target_to_command (s)': f'{self._latency:.5f}',
                'ignored': drivers,
                'other_controllers': controllers,
            }

        self.status.say(level, status.code, message, values)

    def _reload(self, core: ControllerCore) -> None:
        """Take a model that was asked for and is loaded by now."""
        if not (self._loading.asked and self._loading.done):
            return

        def refuse(error: TendonRobotError) -> None:
            self._loading.refuse()
            core.refusals['model'] = Refusal('model', f'the old model stays: {error}')

        def swapped(model: Model, error: TendonRobotError | None) -> None:
            """Hear that the model works where the arm is, or why not."""
            if error is not None:
                refuse(error)
            elif self._incoming is not None and self._prediction is not None:
                if another_robot(model.robot, self._incoming.robot):
                    self.get_logger().warning('another robot: the target is void, the arm holds')
                self._incoming.use(model)
                self._prediction.use(self._incoming.base, model)
                self._loading.accept(model)
                self.status.arm = model.robot.name
                core.refusals.pop('model', None)
                self.get_logger().info(f'model loaded: {self._loading.note}')

        try:
            model = self._loading.result()
        except TendonRobotError as error:
            refuse(error)
        else:
            core.set_model(model, lambda error: swapped(model, error))

    def _resumed(self, follows: bool, why: str) -> None:
        """Hear whether the driver follows again."""
        if self.core is not None and follows:
            self.core.resumed()
        elif self.core is not None:
            self.core.not_resumed(why)

    def stop_said(self, reason: str) -> None:
        """Stop and have the arm let go: the topic says so."""
        if self.core is not None:
            self.core.stop('stop topic', reason, lasting=True)
            self._let_go()

    def stop_now(self) -> None:
        """Stop at once, in the thread that hears of it; the core drops its target next."""
        super().stop_now()
        if self.core is not None:
            self._let_go()

    def stop_called(self) -> Trigger.Response:
        """Stop, and answer who has called the service."""
        self.stop_now()
        if self.core is None:
            told = 'it has no model and commands nothing, so the driver is told nothing'
        elif another := self._driver.another:
            told = f'the driver does not hear it, {another}'
        elif not self._commands.get_subscription_count():
            told = 'no driver hears it'
        else:
            told = 'the driver releases the arm'
        return Trigger.Response(success=True, message=f'stopped; {told}; call reset to go on')

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

        if self._driver.another or not self._driver.resume(answered):
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
