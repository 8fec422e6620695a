"""
Compare the model with the measurements of the running arm; record, diagnose, add the effect.

Topics: tendon_states and measured_shape, measured_tip or a topic per marker (subscribed); ~/error,
~/rolling_error, ~/marker_errors, ~/measured, ~/predicted, ~/progress, ~/verdict, ~/status
(published); ~/tip_force, ~/tip_force_covariance, ~/contact, ~/markers, ~/drift, ~/adaptation by
parameter. Services: ~/record, ~/diagnose, ~/add, ~/learn, ~/change, ~/undo. Parameters:
ros/parameters.yaml.

example: python -m tendon_robot_ros monitor --ros-args -p model:=kato_10_1
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped, Vector3Stamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, Header, String

from ...common.arrays import Floats
from ...common.errors import InputError, TendonRobotError
from ...common.rotations import from_quaternion
from ...common.words import numbers
from ...control import Refusal
from ...control.loading import Loader
from ...data.arrays import FRAME_S
from ...data.folder import read_markers, save_dataset
from ...data.tracker_faults import is_missing
from ...monitoring import Monitor, MonitorSettings
from ...monitoring.job import Work
from ...robot import load_robot
from ..shared import interface, messages
from ..shared.lifecycle import ERROR, OK, WARN, Status
from ..shared.parameters import ParameterNode, RemoteParameter, base_frame, parsed
from ..shared.runtime import repeat, run
from ..shared.timing import SILENCE_S, STATUS_PERIOD_S, VALUES_PERIOD_S
from .watching import Adapting, Watching

HELP = 'compare the running robot with its model; record, diagnose, add what is missing'


class MonitorNode(ParameterNode):
    """ROS interface of the monitor; a diagnosis runs in a child process."""

    # of the monitor, since there is one
    _measured: MarkerInput
    adapting: Adapting

    def __init__(self) -> None:
        """Create topics and services; the model comes when the controller answers."""
        super().__init__('monitor')
        self.status = Status(self, 'model error')
        self.monitor: Monitor | None = None
        self.work = Work()
        self._loader: Loader | None = None
        self._in_use = self._loading = self._problem = self._unusable = ''
        self._last_error = self._frame_at = float('nan')
        self._remote = RemoteParameter(self, self.parameters['controller'], 'model')
        errors = 'monitor/error', 'monitor/rolling_error', 'monitor/marker_errors'
        others = 'monitor/measured', 'monitor/predicted', 'monitor/progress', 'monitor/verdict'
        self._publish = interface.publishing(self, *errors, *others)
        self.watching: Watching | None = None
        interface.subscribe(self, 'tendon_states', self._states)
        services: dict[str, Callable[[], str]] = {
            'record': self.record,
            'diagnose': self.diagnose,
            'add': lambda: self.work.add(self.parameters['partial']),
            'learn': self.learn,
            'undo': self.undo,
        }
        for name, act in services.items():
            messages.offer_trigger(self, f'~/{name}', act, self._publish_progress)
        # its response is a file for `investigate`, not for users
        messages.offer_trigger(self, '~/change', lambda: self._watched().watch.change())
        repeat(self, VALUES_PERIOD_S, self._cycle)
        if own := self.parameters['model']:
            self._load(own)
        else:
            repeat(self, STATUS_PERIOD_S, lambda: self._remote.ask(self._load))

    def end(self) -> None:
        """Cancel a running diagnosis."""
        self.work.cancel()

    def _load(self, text: str) -> None:
        """Start to load a description, unless it is the one in use."""
        if not text or text == self._loading:
            return
        if self._loader is not None:
            self._loader.cancel()
        self._loader, self._loading = None, ''
        try:
            if text != self._in_use:  # else the controller has gone back to it
                robot = load_robot(text)
                self._loader = Loader(lambda: robot, self.parameters['effects'])
        except TendonRobotError as error:
            self._problem = f'model: {error}'
        else:
            self._loading, self._problem = text, ''

    def _take_model(self) -> None:
        if self._loader is None or not self._loader.done:
            return
        loader, self._loader = self._loader, None
        try:
            model = loader.result()
            if self.monitor is None:
                markers = parsed(self.parameters['markers'], 'markers', list)
                settings = self.parameters.fill(MonitorSettings)
                monitor = Monitor(model, read_markers(markers, model.robot), settings)
                self._measured = MarkerInput(self, monitor, self._frame)
                if self.parameters['force_rate'] or self.parameters['reference_postures']:
                    self.watching = Watching(self, monitor)
                self.adapting = Adapting(self, monitor, self._loading, self._remote.put)
                self.monitor = monitor
            else:
                self.monitor.set_model(model)
                # an adapted description does not restart the detection of drift
                anew = self.adapting.set_model(model, self._loading)
                if anew and self.watching is not None:
                    self.watching.set_model(model)
        except TendonRobotError as error:
            self._problem = f'model: {error}'
        else:
            self._in_use, self._problem = self._loading, ''
            self.get_logger().info(f'comparing with {", ".join(model.robot.effects) or "PCCA"}')

    def _states(self, message: JointState) -> None:
        if self.monitor is None:
            return
        try:
            measured = messages.tensions_and_pulls(message, self.monitor.model.inputs)
        except Refusal as refusal:
            self._unusable = str(refusal)
            return
        self._unusable = ''
        at = messages.seconds(message.header.stamp) or messages.time_now(self)
        self.monitor.put_states(at, *measured)
        self._measured.hand_over()

    def _frame(self, at: float, positions: Floats) -> None:
        """Compare a frame of the tracker with the model and publish the errors."""
        assert self.monitor is not None
        before = len(self.monitor.recorded)
        compared = self.monitor.put_frame(at, positions)
        if len(self.monitor.recorded) > before:
            self._publish_progress(f'recording: {len(self.monitor.recorded)} postures')
        if compared is not None:
            self._frame_at = time.monotonic()
            if np.isfinite(compared.rolling):
                self._last_error = compared.rolling
            header, errors = messages.header_now(self, self._measured.base), compared.errors
            sizes = np.linalg.norm(errors, axis=1).tolist()  # nan where a marker is not seen
            content = {
                'monitor/error': Vector3Stamped(header=header, vector=messages.vector(errors[-1])),
                'monitor/rolling_error': Float64(data=compared.rolling),
                'monitor/marker_errors': Float64MultiArray(data=sizes),
                'monitor/measured': messages.pose_array(header, compared.measured),
                'monitor/predicted': messages.pose_array(header, compared.predicted),
            }
            for name, message in content.items():
                self._publish[name](message)
            still = self.monitor.new_posture()
            if still is not None:
                self.adapting.put(still)
            if self.watching is not None:
                self.watching.frame(at, compared.measured, still)

    def _cycle(self) -> None:
        """Handle the messages of the child process; publish the status."""
        self._take_model()
        if self.watching is not None and time.monotonic() - self._frame_at > SILENCE_S:
            # without the tracker, wire pulls determine the force
            self.watching.blind()
        for news in self.work.news():
            if news['kind'] == 'verdict':
                self._publish['monitor/verdict'](String(data=json.dumps(news['content'])))
            if news['kind'] == 'add':
                self._remote.put(
                    news['file'],
                    lambda *answer: self._publish_progress(self.work.answered(*answer)),
                )
            self._publish_progress(news['text'])
        level, code, message = self._condition()
        self.status.arm = '' if self.monitor is None else self.monitor.model.robot.name
        self.status.publish(level, code, message, self._values)

    def _condition(self) -> tuple[bytes, str, str]:
        if problem := self._problem or self._unusable:
            return ERROR, 'problem', problem
        if self.monitor is None:
            return WARN, 'waiting', 'waiting for the model of the controller'
        if self._measured.problem:
            return WARN, 'refused', self._measured.problem
        if self.monitor.problem:
            return WARN, 'not_compared', self.monitor.problem
        if not time.monotonic() - self._frame_at < SILENCE_S:
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
            **({} if monitor is None else self.adapting.values()),
        }

    def _publish_progress(self, text: str) -> None:
        self._publish['monitor/progress'](String(data=text))

    def undo(self) -> str:
        """Undo the last change of the controller's model; return a text."""
        self._require_monitor()
        return self.adapting.undo()

    def learn(self) -> str:
        """Restart the learning of the arm; return a text."""
        watching = self._watched()
        watching.set_model(watching.watch.model)
        return watching.watch.text

    def _watched(self) -> Watching:
        if self.watching is None:
            raise InputError('nothing is watched: see the parameter reference_postures')
        return self.watching

    def record(self) -> str:
        """Start to record postures, or stop; return a text."""
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

    def diagnose(self) -> str:
        """Start the diagnosis of the recording; return a text."""
        monitor = self._require_monitor()
        if self.work.running:
            raise InputError('a diagnosis runs already')
        folder = Path(self.parameters['folder']) / datetime.now().strftime('%Y-%m-%d_%H-%M-%S_%f')
        save_dataset(monitor.dataset('this recording'), folder.resolve())
        monitor.recording, monitor.kept = False, True
        self.work.diagnose(folder.resolve(), self.parameters['effects'])
        return f'diagnosing {len(monitor.recorded)} postures: {folder}'

    def _require_monitor(self) -> Monitor:
        if self.monitor is None:
            raise InputError('no model yet: is the controller running?')
        return self.monitor


class MarkerInput:
    """
    Receives the topics of the tracker and passes on frames.

    Parameters
    ----------
    node : ParameterNode
        The monitor.
    monitor : Monitor
        poses[i] is its markers[i]; a frame waits for states that are as new as itself.
    take : callable
        Called with the time [s] of the frame and positions (J, 3) [m], nan where missing.

    """

    def __init__(
        self, node: ParameterNode, monitor: Monitor, take: Callable[[float, Floats], None]
    ) -> None:
        """Create the subscriptions; InputError: a parameter is invalid."""
        self._node, self._taker = node, take
        self._monitor, self.markers, self.problem = monitor, monitor.markers, ''
        self._waiting: tuple[float, Floats] | None = None
        self.base = base_frame(node.parameters, monitor.model.robot.name)
        self._frames = messages.Frames(node, self.base)
        self._fixed = _transform(node.parameters['tracker_transform'])
        topics = parsed(node.parameters['measured_markers'], 'measured_markers', dict)
        self._frame: tuple[float, Floats] | None = None
        if topics:
            indices = {marker.name: index for index, marker in enumerate(self.markers)}
            for name, topic in topics.items():
                if str(name) not in indices:
                    raise InputError(
                        f'measured_markers: expected names of {", ".join(indices)}, got {name!r}'
                    )
                callback = partial(self._heard, partial(self._marker, indices[str(name)]))
                node.create_subscription(PoseStamped, str(topic), callback, interface.LISTEN)
        else:
            interface.subscribe(node, 'measured_shape', partial(self._heard, self._shape))
            interface.subscribe(node, 'measured_tip', partial(self._heard, self._tip))
        self._shape_at = -np.inf

    def hand_over(self, late: bool = False) -> None:
        """Pass on the waiting frame if the states are as new, or if it is late."""
        if self._waiting is not None and (late or self._monitor.states.newest >= self._waiting[0]):
            frame, self._waiting = self._waiting, None
            self._taker(*frame)

    def _heard(self, use: Callable[[Any], None], message: Any) -> None:
        """Use a message, or keep its refusal for the status."""
        try:
            use(message)
        except Refusal as refusal:
            self.problem = str(refusal)

    def _take(self, at: float, points: Floats) -> None:
        self.hand_over(late=at - self._monitor.states.newest > VALUES_PERIOD_S)
        self._waiting = at, points
        self.hand_over()

    def _shape(self, message: PoseArray) -> None:
        points = messages.points_of(message)
        if len(points) != len(self.markers):
            raise Refusal(
                'length',
                f'measured_shape: expected {len(self.markers)} poses, one for each of the markers '
                f'(nan where it was not seen), got {len(points)}',
            )
        self._shape_at = messages.time_now(self._node)
        self._take(*self._in_base(message.header, points, 'measured_shape'))

    def _tip(self, message: PoseStamped) -> None:
        # a shape has more markers
        if messages.time_now(self._node) - self._shape_at >= SILENCE_S:
            points = self._only(len(self.markers) - 1, message)
            self._take(*self._in_base(message.header, points, 'measured_tip'))

    def _marker(self, index: int, message: PoseStamped) -> None:
        """Merge markers on topics of their own into frames."""
        new = self._in_base(message.header, self._only(index, message), 'measured_markers')
        if self._frame is not None and abs(new[0] - self._frame[0]) > FRAME_S:
            self._take(*self._frame)
            self._frame = None
        if self._frame is None:
            self._frame = new
        else:
            self._frame[1][index] = new[1][index]

    def _only(self, index: int, message: PoseStamped) -> Floats:
        """Return positions (J, 3) [m], nan for all markers but one."""
        points = np.full((len(self.markers), 3), np.nan)
        points[index] = messages.xyz(message.pose.position)
        return points

    def _in_base(self, header: Header, points: Floats, what: str) -> tuple[float, Floats]:
        """Return time [s] and positions (J, 3) [m] in the base frame."""
        now = messages.check_age(self._node, header, what)
        rotation, translation = self._fixed or self._frames.of(header, what)
        self.problem = ''
        points = np.where(is_missing(points)[:, None], np.nan, points)
        return messages.seconds(header.stamp) or now, points @ rotation.T + translation


def _transform(text: str) -> tuple[Floats, Floats] | None:
    """Parse rotation (3, 3) and translation (3,) [m] from tracker to base; None: no text."""
    if not text.strip():
        return None
    expected = 'x y z qx qy qz qw with a quaternion of norm 1'
    values = np.array(numbers('tracker_transform', text, None, expected, 7))
    norm = float(np.linalg.norm(values[3:]))
    if not 0.99 < norm < 1.01:
        raise InputError(f'tracker_transform: expected {expected}, got {text!r}')
    return from_quaternion(values[3:] / norm), values[:3]


main = partial(run, MonitorNode)  # until a signal comes
