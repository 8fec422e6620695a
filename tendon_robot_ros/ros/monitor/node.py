"""
Watch the model meet the measurement: compare, record, diagnose, add the effect.

Topics: tendon_states and measured_shape, measured_tip or a topic per marker (subscribed); ~/error,
~/rolling_error, ~/marker_errors, ~/measured, ~/predicted, ~/progress, ~/verdict, ~/status
(published). ~/tip_force, ~/tip_force_covariance, ~/drift, ~/adaptation where asked. Services:
~/record, ~/diagnose, ~/add, ~/learn, ~/change, ~/undo. Parameters: docs/ros_interface.md.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseArray, Vector3, Vector3Stamped
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, Header, String
from std_srvs.srv import Trigger

from ...common.errors import InputError, TendonRobotError
from ...control import Refusal
from ...control.checks import by_name
from ...control.loading import Loader
from ...data import save_dataset
from ...model.model import Model
from ...monitoring import Monitor
from ...monitoring.job import Work
from ...monitoring.monitor import Compared, read_markers
from ...monitoring.watch import ArmWatch
from ...robot import load_robot
from ..shared.lifecycle import ERROR, OK, WARN, Status
from ..shared.messages import LATCHED, LISTEN, STATE, pose_array, seconds
from ..shared.parameters import Parameters, RemoteText
from ..shared.runtime import repeat, run
from .adapting import Adapting
from .measured import MarkerInput
from .parameters import SPECS, parsed, settings
from .watching import Watching

HELP = 'compare the running robot with its model; record, diagnose, add what is missing'
Array = NDArray[np.float64]
BLIND_AFTER_S = 1.0  # [s] without the tracker, after which wire pulls tell the force


class MonitorNode(Node):
    """ROS around the monitor; diagnosis runs in a child process."""

    def __init__(self) -> None:
        """Begin to listen; the model comes when the controller answers."""
        super().__init__('monitor')
        self.parameters = Parameters(self, SPECS)
        self.status = Status(self, 'model error')
        self.monitor: Monitor | None = None
        self.work = Work()
        self._loader: Loader | None = None
        self._in_use = self._loading = self._base = self._said = ''
        self._measured: MarkerInput | None = None
        self._last_error = self._frame_at = float('nan')
        self._remote = RemoteText(self, self.parameters['controller'], 'model')
        publish = self.create_publisher
        self._output = MonitorOutput(self)
        self.watching: Watching | None = None
        self.adapting: Adapting | None = None
        self._progress = publish(String, '~/progress', LATCHED)
        self._verdict = publish(String, '~/verdict', LATCHED)
        self.create_subscription(JointState, 'tendon_states', self._states, LISTEN)
        for name in ('record', 'diagnose', 'add', 'learn', 'undo', 'change'):
            self.create_service(Trigger, f'~/{name}', getattr(self, f'_{name}'))
        repeat(self, 0.1, self._cycle)
        repeat(self, 1.0, self._look_at_controller)

    @property
    def node(self) -> Node:
        """Return itself, for `run`."""
        return self

    def start(self) -> None:
        """Take the model that is given; else that of the controller, when it answers."""
        if self.parameters['model']:
            self._load(self.parameters['model'])

    def running(self) -> bool:
        """Go on."""
        return True

    def end(self, spin: object) -> None:
        """End what runs."""
        self.work.cancel()

    def _look_at_controller(self) -> None:
        if not self.parameters['model']:
            self._remote.ask(self._load)

    def _load(self, text: str) -> None:
        """Begin to load a description, unless it is the one in use."""
        if not text or text in (self._in_use, self._loading):
            return
        try:
            robot = load_robot(text)
        except TendonRobotError as error:
            self._said = f'model: {error}'
            return
        loader = Loader(lambda: robot, self.parameters['effects'])
        if self._loader is not None:
            self._loader.cancel()
        self._loader, self._loading = loader, text

    def _take_model(self) -> None:
        if self._loader is None or not self._loader.done:
            return
        loader, self._loader = self._loader, None
        try:
            model = loader.result()
            if self.monitor is None:
                robot = model.robot
                markers = read_markers(parsed(self.parameters, 'markers', list), robot)
                self.monitor = Monitor(model, markers, settings(self.parameters))
                name = self.parameters['base_frame'] or f'{robot.name}_base'
                self._base = self.parameters['frame_prefix'] + name
                self._measured = MarkerInput(
                    self, self.parameters, self._base, self.monitor, self._frame
                )
                self.watching = Watching.wanted(self, self.parameters, self.monitor)
                self.adapting = Adapting(
                    self, self.parameters, self.monitor, self._loading, self._remote.put
                )
            else:
                self._change_model(self.monitor, model)
        except TendonRobotError as error:
            self._said = f'model: {error}'
        else:
            self._in_use, self._said = self._loading, ''
            self.get_logger().info(f'comparing with {", ".join(model.robot.effects) or "PCCA"}')

    def _change_model(self, monitor: Monitor, model: Model) -> None:
        """Compare with another description; the arm is still watched where it only followed."""
        monitor.set_model(model)
        anew = self.adapting is None or self.adapting.set_model(model, self._loading)
        if anew and self.watching is not None:
            self.watching.set_model(model)

    def _states(self, message: JointState) -> None:
        if self.monitor is None:
            return
        inputs, names = self.monitor.model.inputs, message.name
        blank = [float('nan')] * len(names)
        try:
            tensions = by_name(names, message.effort or blank, inputs, 'tendon_states', 'effort')
            pulls = by_name(names, message.position or blank, inputs, 'tendon_states', 'position')
        except Refusal as refusal:
            self._said = str(refusal)
            return
        now = 1e-9 * self.get_clock().now().nanoseconds
        self.monitor.put_states(seconds(message.header.stamp) or now, tensions, pulls)
        if self._measured is not None:
            self._measured.hand_over()

    def _frame(self, at: float, positions: Array) -> None:
        """Compare a frame of the tracker and publish how far it is off."""
        assert self.monitor is not None
        before = len(self.monitor.recorded)
        compared = self.monitor.put_frame(at, positions)  # of as many markers: see Measured
        if len(self.monitor.recorded) > before:
            self._tell_progress(f'recording: {len(self.monitor.recorded)} postures')
        if compared is not None:
            self._frame_at = time.monotonic()
            if np.isfinite(compared.rolling):
                self._last_error = compared.rolling
            self._output.publish(self._base, compared)
            stood = self.monitor.stands()
            if stood is not None and self.adapting is not None:
                self.adapting.stands(stood)
            if self.watching is not None:
                self.watching.frame(at, compared.measured, self._base, stood)

    def _cycle(self) -> None:
        """Take what the child says; tell how things are."""
        self._take_model()
        if self.watching is not None and time.monotonic() - self._frame_at > BLIND_AFTER_S:
            self.watching.blind(self._base)
        for news in self.work.news():
            if news['kind'] == 'verdict':
                self._verdict.publish(String(data=json.dumps(news['content'])))
            if news['kind'] == 'add':
                self._remote.put(news['file'], self._added)
            if news['text']:
                self._tell_progress(news['text'])
        level, code, message = self._condition()
        self.status.arm = '' if self.monitor is None else self.monitor.model.robot.name
        self.status.say(level, code, message, self._values())

    def _condition(self) -> tuple[bytes, str, str]:
        if self._said:
            return ERROR, 'problem', self._said
        if self.monitor is None:
            return WARN, 'waiting', 'waiting for the model of the controller'
        if self._measured is not None and self._measured.problem:
            return WARN, 'refused', self._measured.problem
        if self.monitor.problem:
            return WARN, 'not_compared', self.monitor.problem
        if not time.monotonic() - self._frame_at < 1.0:
            return WARN, 'no_tracker', 'no measured_shape and no measured_tip for a second'
        if self.watching is not None and self.watching.drifted:
            return WARN, 'drifted', f'the arm is {self.watching.watch.text}'
        if not np.isfinite(self._last_error):
            return OK, 'comparing', 'the tip was not seen at rest yet'
        return OK, 'comparing', f'off by {1e3 * self._last_error:.2f} mm at the tip'

    def _values(self) -> dict[str, str]:
        monitor = self.monitor
        count = 0 if monitor is None else len(monitor.recorded)
        return {
            'recording': str(monitor is not None and monitor.recording).lower(),
            'postures': str(count),
            'kept': str(monitor is None or monitor.kept).lower(),
            'diagnosing': str(self.work.running).lower(),
            'addition': self.work.addition_ready,
            'added': str(self.work.added),
            'model': '' if monitor is None else ', '.join(monitor.model.robot.effects),
            'error (m)': f'{self._last_error:.4g}',
            **({} if self.watching is None else self.watching.values()),
            **({} if self.adapting is None else self.adapting.values()),
        }

    def _tell_progress(self, text: str) -> None:
        self._progress.publish(String(data=text))

    def _added(self, taken: bool, reason: str) -> None:
        self._tell_progress(self.work.answered(taken, reason))

    def _record(self, request: object, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._begin_or_stop_recording)

    def _diagnose(self, request: object, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._begin_diagnosis)

    def _add(self, request: object, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, lambda: self.work.add(self.parameters['partial']))

    def _learn(self, request: object, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._learn_anew)

    def _undo(self, request: object, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, self._take_back)

    def _change(self, request: object, response: Trigger.Response) -> Trigger.Response:
        """Hand over what is known of a change, to `investigate`."""
        try:
            response.message, response.success = self._watched().change(), True
        except TendonRobotError as error:
            response.success, response.message = False, str(error)
        return response

    def _take_back(self) -> str:
        self._require_monitor()
        assert self.adapting is not None
        return self.adapting.undo()

    def _learn_anew(self) -> str:
        self._watched().learn_anew()
        return self._watched().text

    def _watched(self) -> ArmWatch:
        if self.watching is None:
            raise InputError('nothing is watched: see the parameter reference_postures')
        return self.watching.watch

    def _begin_or_stop_recording(self) -> str:
        monitor = self._require_monitor()
        count = len(monitor.recorded)
        if monitor.recording:
            monitor.recording = False
            return f'stopped after {count} postures: diagnose takes them, record goes on with them'
        more = not monitor.kept and count > 0
        monitor.start_recording()
        if more:
            return f'recording on, {count} postures are kept; call record to stop, then diagnose'
        return 'recording every posture in which the arm stands still; then call diagnose'

    def _begin_diagnosis(self) -> str:
        monitor = self._require_monitor()
        if self.work.running:
            raise InputError('a diagnosis runs already')
        folder = Path(self.parameters['folder']) / datetime.now().strftime('%Y-%m-%d_%H-%M-%S_%f')
        dataset = monitor.dataset('this recording')
        save_dataset(dataset, folder.resolve())
        monitor.recording, monitor.kept = False, True
        self.work.diagnose(folder.resolve(), self.parameters['effects'])
        return f'diagnosing {len(monitor.recorded)} postures: {folder}'

    def _require_monitor(self) -> Monitor:
        if self.monitor is None:
            raise InputError('no model yet: is the controller running?')
        return self.monitor

    def _answer(self, response: Trigger.Response, act: object) -> Trigger.Response:
        try:
            response.message = act()  # type: ignore[operator]
            response.success = True
        except TendonRobotError as error:
            response.success, response.message = False, ' '.join(str(error).split())
        self._tell_progress(response.message)
        return response


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(MonitorNode, arguments)


# -----------------------------------------------------------------------------
# What the monitor publishes for every frame of the tracker.


class MonitorOutput:
    """Errors, and both shapes at the markers."""

    def __init__(self, node: Node) -> None:
        """Make the publishers."""
        self._node, publish = node, node.create_publisher
        self._error = publish(Vector3Stamped, '~/error', STATE)
        self._rolling = publish(Float64, '~/rolling_error', STATE)
        self._per_marker = publish(Float64MultiArray, '~/marker_errors', STATE)
        self._measured = publish(PoseArray, '~/measured', STATE)
        self._predicted = publish(PoseArray, '~/predicted', STATE)

    def publish(self, frame: str, compared: Compared) -> None:
        """Publish a frame; what was not seen is nan."""
        header = Header(frame_id=frame, stamp=self._node.get_clock().now().to_msg())
        errors = compared.errors
        x, y, z = errors[-1].tolist()
        self._error.publish(Vector3Stamped(header=header, vector=Vector3(x=x, y=y, z=z)))
        self._rolling.publish(Float64(data=compared.rolling))
        self._per_marker.publish(Float64MultiArray(data=np.linalg.norm(errors, axis=1).tolist()))
        turns = np.tile(np.eye(3), (len(errors), 1, 1))
        self._measured.publish(pose_array(header, compared.measured, turns))
        self._predicted.publish(pose_array(header, compared.predicted, turns))
