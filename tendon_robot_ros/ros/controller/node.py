"""
The controller node: receives targets of the tip, publishes tendon commands that reach them.

Topics: ~/target_pose, ~/target_point, ~/delta_twist, ~/tendon_trajectory, tendon_states, stop
(subscribed);
tendon_command, ~/predicted_shape, ~/predicted_tip, ~/markers, ~/status, /diagnostics (published).
Services: ~/stop, ~/reset. Actions, where their types are installed: ~/follow_joint_trajectory,
~/navigate_to_pose, ~/navigate_through_poses. Parameters and units: ros/parameters.yaml.

example: python -m tendon_robot_ros controller --ros-args -p model:=kato_10_1
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from ...common.errors import InputError, TendonRobotError
from ...common.processes import Realtime, go_realtime, in_realtime
from ...common.words import COMPILING
from ...control import ControllerCore, Refusal
from ...control.inputs import another_robot
from ...control.solver import SOLVER, Worker
from ...control.status import controller_status, controller_values
from ...model.model import Model
from ...robot.keep_out import KeepOut, load_keep_out
from ..shared import interface
from ..shared.inbox import Answer, Received, Service, subscribe_any_qos
from ..shared.lifecycle import LEVELS, Status, StoppableNode
from ..shared.messages import attempted, header_now, passing_subscription
from ..shared.runtime import Ending, repeat, run
from ..shared.senders import gid_text
from ..shared.timing import NEWS_PERIOD_S
from . import parameters
from .actions import Actions
from .topics import DriverLink, Incoming, Prediction

HELP = 'move the tip to targets: poses, points or twists in, tendon commands out'

Action = Callable[[ControllerCore, Incoming, Any], None]  # what a message of a topic does
STARTING_WORDS = {
    'loading': 'reading the model',
    'compiling': COMPILING,
    'building': 'building the library of shapes',
}


class ControllerNode(StoppableNode):
    """ROS interface of the controller core: one thread, and one that receives stops."""

    # of the core, while there is one
    _incoming: Incoming
    _prediction: Prediction
    _solver: Worker

    def __init__(self) -> None:
        """Declare parameters and start to load the model; nothing is commanded yet."""
        super().__init__('controller', drives=False, hears='tendon_states', says='tendon_command')
        self.status = Status(self, 'control')
        self.core: ControllerCore | None = None
        self._loading = parameters.ModelLoading(self.parameters)
        self._keep_out = KeepOut()
        checks: dict[str, Callable[[str], object]] = {
            'model': self._loading.check,
            'keep_out': load_keep_out,
            'prefer_stiffness_along': parameters.direction_of,
        }
        self.parameters.watch(checks, self._retune)
        self._latency = self._status_at = self._target_at = 0.0  # [s]
        self._targets: list[Subscription] = []
        self._actions: Actions | None = None
        self._speaking = threading.Lock()
        self._tracker: Subscription | None = None
        self._subscribe_tip()
        topic, gid = self.parameters['driver_status'], gid_text(self._own.gid)

        def driver_status(*values: Any) -> None:
            if self.core is not None:
                self.core.driver_reports(*values)

        def predict() -> None:
            if self.core is not None:
                self.core.predict(time.monotonic(), self._prediction.publish)

        self._driver = DriverLink(self, topic, gid, driver_status)
        self.listen(Service(self, '~/reset', self._request_reset))
        repeat(self, 1.0 / self.parameters['rate'], self._cycle)
        repeat(self, 1.0 / self.parameters['shape_rate'], predict)

    def ready(self) -> bool:
        """Return whether the model is compiled, so that `configure` returns soon."""
        loader = self._loading.loader
        loaded = loader.done
        if not loaded:
            stage = loader.doing
            self.status.publish(LEVELS['warn'], stage, STARTING_WORDS[stage])
        return loaded

    def configure(self) -> None:
        """Load the model."""
        self.ready()  # reports what takes long, also if a user configures
        model = self._loading.result()
        self._loading.accept(model)
        self.status.arm = model.robot.name
        self._keep_out = load_keep_out(self.parameters['keep_out'])
        settings = parameters.settings(self.parameters, self._keep_out)
        self._solver = Worker(self._wake)  # last: of a refused attempt no thread stays
        core = ControllerCore(model, settings, self._solver, latch=self.latch)
        core.driver_reports(*self._driver.last)
        self._incoming = Incoming(self, model)
        self._prediction = Prediction(self, self._incoming)
        self.core = core
        if Ending.current.first:
            go_realtime(Realtime.CONTROLLER, but=[SOLVER])
            if in_realtime():  # this thread limits the time of the solver
                self._solver.lend_realtime()

    def activate(self) -> None:
        """Subscribe to targets, not before, so that no target is lost."""
        if self._actions is None:
            self._actions = Actions(self)
        now = time.monotonic
        actions: dict[str, Action] = {
            'controller/delta_twist': lambda core, new, one: core.twist(now(), new.twist(one)),
            'controller/target_pose': lambda core, new, one: core.aim(new.pose(one)),
            'controller/target_point': lambda core, new, one: core.aim(new.point(one)),
            'controller/tendon_trajectory': (
                lambda core, new, one: core.play(now(), new.trajectory(one))
            ),
        }

        for name, action in actions.items():
            kind, topic, _ = interface.topic(name)
            take = partial(self._take, 'target', action)
            if name == 'controller/delta_twist':  # only the newest counts
                heard = passing_subscription(self, kind, topic, take, interface.LISTEN)
                self._targets.append(heard)
            else:
                self._targets += subscribe_any_qos(self, kind, topic, take)

    def deactivate(self) -> None:
        """Have the arm released, and send no more commands."""
        while self._targets:
            self.destroy_subscription(self._targets.pop())
        self.let_go()

    def cleanup(self) -> None:
        """Drop the model; the next `configure` loads it again."""
        if self.core is not None:
            self._prediction.close()
            self._solver.close()
        self.core = None
        self._loading.forget()

    def end(self) -> None:
        """End the node: the driver releases the arm."""
        self._loading.cancel()
        super().end()
        # a message is lost if its publisher is destroyed before it is received
        time.sleep(NEWS_PERIOD_S)

    def _subscribe_tip(self) -> None:
        """Subscribe to the tracker only while the loop is closed, to save processor time."""
        closed = self.parameters['tip_gain'] > 0.0
        if self._tracker is not None and not closed:
            self.destroy_subscription(self._tracker)
            self._tracker = None
        elif self._tracker is None and closed:

            def tip(core: ControllerCore, incoming: Incoming, message: PoseStamped) -> None:
                core.tip_measured(time.monotonic(), incoming.measured_tip(message))

            kind, topic, _ = interface.topic('measured_tip')
            take = partial(self._take, 'tip', tip)
            self._tracker = passing_subscription(self, kind, topic, take, interface.LISTEN)

    def _take(self, kind: str, action: Action, message: Any) -> None:
        """Apply an action to a message, or keep its refusal for the status."""
        core = self.core
        if core is None:
            return
        began = time.monotonic()
        try:
            if isinstance(message, Refusal):  # it could not be read
                raise message
            action(core, self._incoming, message)
        except Refusal as refusal:
            core.refusals[kind] = refusal
            return
        core.refusals.pop(kind, None)
        if kind == 'target':
            core.refusals.pop('model', None)  # it was published
            self._target_at = began

    def _states(
        self, core: ControllerCore, incoming: Incoming, received: Received[JointState]
    ) -> None:
        """Use a measurement of the followed driver."""
        now, measured = time.monotonic(), incoming.states(received.message)
        if self._senders.counts(now, received):
            core.measured(now, *measured)

    def _wake(self) -> None:
        """Command a solved target before the next cycle; called by the solver."""

        def answer() -> None:
            if (core := self.core) is None:
                return
            before = core.solution
            core.solver.serve()
            if core.solution is not before:
                self._cycle()
                self._latency = time.monotonic() - self._target_at

        if self.executor is not None:
            self.executor.create_task(answer)

    def _cycle(self) -> None:
        """Receive stops and states, publish a command."""
        self.stop_topic.poll()
        core = self.core
        if core is not None:
            self._solver.limit_realtime()
        for received in self._inbox.take():
            self._take('states', self._states, received)
        now = time.monotonic()
        if refusal := self._inbox.refused():
            self._take('states', self._states, refusal)
        if core is None or self.phase != 'active':
            self._idle()
            return
        self._reload(core)
        if self._actions is not None:
            self._actions.serve(now, core, self._incoming)
        self._driver.poll()
        if core.needs_driver and self._driver.may_ask:
            self._driver.resume(self._resumed)
        output = core.step(now)
        if output is not None:
            pulls = output.pulls
            tensions = output.tensions if pulls is None else None
            with self._speaking:
                if not self.latch:  # unless a stop came meanwhile
                    self.say(core.model.inputs, pulls, tensions)
        if now - self._status_at >= NEWS_PERIOD_S:
            self._status_at = now
            self._publish_status(core, now)

    def let_go(self) -> None:
        """Have the driver release the arm at once: send a command without tendons."""
        if self.core is not None:
            with self._speaking:
                self._publisher.publish(JointState(header=header_now(self)))

    def _idle(self) -> None:
        """Publish that the node waits for a transition, in place of its last status."""
        if self._actions is not None:
            self._actions.drop('the controller is not active')
        if self.phase == 'inactive':
            self.status.publish(LEVELS['warn'], 'off', 'not active: it commands nothing')
        elif not self.parameters['autostart']:
            self.status.publish(LEVELS['warn'], 'unconfigured', 'waits to be configured')

    def _publish_status(self, core: ControllerCore, now: float) -> None:
        """Publish the status."""
        status = controller_status(core, now)
        level, message = LEVELS[status.level], status.message
        drivers = self._senders.names(self._senders.others(now))
        controllers = self._own.others(now)
        if drivers or controllers:
            level = max(level, LEVELS['warn'])
            message += f'; ignores tendon_states of {drivers}' if drivers else ''
            message += f'; another publishes tendon_command: {controllers}' if controllers else ''

        def values() -> dict[str, str]:
            return {
                **controller_values(core, now),
                'model': self._loading.note,
                'target_to_command (s)': f'{self._latency:.5f}',
                'ignored': drivers,
                'other_controllers': controllers,
            }

        self.status.publish(level, status.code, message, values)

    def _reload(self, core: ControllerCore) -> None:
        """Use a requested model as soon as it is loaded."""
        if not (self._loading.change_requested and self._loading.loader.done):
            return

        def refuse(error: TendonRobotError) -> None:
            self._loading.refuse()
            core.refusals['model'] = Refusal('model', f'the old model stays: {error}')

        def use(model: Model) -> None:
            if another_robot(model.robot, self._incoming.model.robot):
                self.get_logger().warning('another robot: the target is void, the arm holds')
            self._incoming.use(model)
            self._loading.accept(model)
            self.status.arm = model.robot.name
            core.refusals.pop('model', None)
            self.get_logger().info(f'model loaded: {self._loading.note}')

        try:
            model = self._loading.result()
        except TendonRobotError as error:
            refuse(error)
        else:
            # it is used if it has an equilibrium at the present tensions
            core.set_model(model, lambda error: refuse(error) if error else use(model))

    def _resumed(self, follows: bool, why: str) -> None:
        """Pass on whether the driver follows again."""
        if (core := self.core) is not None:
            core.resumed() if follows else core.not_resumed(why)

    def stop_called(self) -> str:
        """Stop; return what follows, as the service `~/stop` answers."""
        self.stop_now()
        if self.core is None:
            consequence = 'it has no model and commands nothing, so the driver is told nothing'
        elif another := self._driver.another:
            consequence = f'the driver does not hear it, {another}'
        elif not self._publisher.get_subscription_count():
            consequence = 'no driver hears it'
        else:
            consequence = 'the driver releases the arm'
        return f'stopped; {consequence}; call reset to go on'

    def _request_reset(self, send: Answer) -> None:
        """Reset in the executor: the thread that receives stops must not wait for the driver."""
        if self.core is None or self.executor is None:
            send(*attempted(self._clear_stops))
        else:
            self.executor.create_task(lambda: self._reset(send))

    def _reset(self, send: Answer) -> None:
        """Clear the stops once the driver has answered that it follows."""

        def answered(follows: bool, why: str) -> None:
            if follows:
                self._resumed(follows, why)
                send(*attempted(self._clear_stops))
            else:
                send(False, f'reset refused: the driver is stopped: {why}')

        if self._driver.another or not self._driver.resume(answered):
            send(*attempted(self._clear_stops))

    def _clear_stops(self) -> str:
        """Clear the stops, if their causes are gone; return a text."""
        if self.core is not None:
            self.core.reset()
            return 'waiting for a target'
        if not self.latch:
            raise InputError('the controller is not configured')
        self.latch.reset()
        return 'the stop is over; there is no model'

    def _retune(self, names: Collection[str]) -> None:
        """Apply changed parameters."""
        self._subscribe_tip()
        if 'keep_out' in names:  # parsed only when it changes
            self._keep_out = load_keep_out(self.parameters['keep_out'])
        if 'model' in names:
            self._loading.change(self.parameters['model'])
        if self.core is not None:
            self.core.settings = parameters.settings(self.parameters, self._keep_out)


main = partial(run, ControllerNode, first=True)  # until a signal comes
