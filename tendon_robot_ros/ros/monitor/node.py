"""
Compare the model with the measurements of the running arm; record, diagnose, add the effect.

Topics: tendon_states and measured_shape, measured_tip or a topic per marker (subscribed); ~/error,
~/rolling_error, ~/marker_errors, ~/measured, ~/predicted, ~/progress, ~/verdict, ~/status
(published); ~/tip_force, ~/tip_force_covariance, ~/drift, ~/adaptation by parameter. Services:
~/record, ~/diagnose, ~/add, ~/learn, ~/change, ~/undo. Parameters: docs/ros_interface.md.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ...common.arrays import Floats
from ...common.errors import InputError, TendonRobotError
from ...control import Refusal
from ...control.loading import Loader
from ...data import save_dataset
from ...monitoring import Monitor, MonitorSettings
from ...monitoring.job import Work
from ...monitoring.monitor import read_markers
from ...monitoring.watch import ArmWatch
from ...robot import load_robot
from ..shared.lifecycle import ERROR, OK, WARN, Status
from ..shared.messages import LATCHED, LISTEN, seconds, tensions_and_pulls, time_now
from ..shared.parameters import (
    Parameters,
    RemoteParameter,
    base_frame,
    parsed,
)
from ..shared.runtime import Runnable, repeat, run
from ..shared.timing import SILENCE_S, STATUS_PERIOD_S, VALUES_PERIOD_S
from .measured import MarkerInput, MonitorOutput
from .watching import Adapting, Watching

HELP = 'compare the running robot with its model; record, diagnose, add what is missing'
SETTINGS = 'still_time', 'still_speed', 'rolling', 'position_noise', 'setting_noise', 'path'


class MonitorNode(Runnable, Node):
    """ROS interface of the monitor; a diagnosis runs in a child process."""

    def __init__(self) -> None:
        """Create topics and services; the model comes when the controller answers."""
        super().__init__('monitor')
        self.parameters = Parameters(self, 'monitor')
        self.status = Status(self, 'model error')
        self.monitor: Monitor | None = None
        self.work = Work()
        self._loader: Loader | None = None
        self._in_use = self._loading = self._base = self._problem = ''
        self._measured: MarkerInput | None = None
        self._last_error = self._frame_at = float('nan')
        self._remote = RemoteParameter(self, self.parameters['controller'], 'model')
        publish = self.create_publisher
        self._output = MonitorOutput(self)
        self.watching: Watching | None = None
        self.adapting: Adapting | None = None
        self._progress = publish(String, '~/progress', LATCHED)
        self._verdict = publish(String, '~/verdict', LATCHED)
        self.create_subscription(JointState, 'tendon_states', self._states, LISTEN)
        services: dict[str, Callable[[], str]] = {
            'record': self.record,
            'diagnose': self.diagnose,
            'add': lambda: self.work.add(self.parameters['partial']),
            'learn': self.learn,
            'undo': self.undo,
            'change': lambda: self._watched().change(),  # the estimated change, for `investigate`
        }
        for name, act in services.items():
            self.create_service(Trigger, f'~/{name}', partial(self._answer, name, act))
        repeat(self, VALUES_PERIOD_S, self._cycle)
        if not self.parameters['model']:
            repeat(self, STATUS_PERIOD_S, lambda: self._remote.ask(self._load))

    def start(self) -> None:
        """Load the model of the parameter, if there is one."""
        if self.parameters['model']:
            self._load(self.parameters['model'])

    def end(self) -> None:
        """Cancel a running diagnosis."""
        self.work.cancel()

    def _load(self, text: str) -> None:
        """Start to load a description, unless it is the one in use."""
        if not text or text in (self._in_use, self._loading):
            return
        try:
            robot = load_robot(text)
        except TendonRobotError as error:
            self._problem = f'model: {error}'
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
                markers = parsed(self.parameters['markers'], 'markers', list)
                settings = MonitorSettings(**{name: self.parameters[name] for name in SETTINGS})
                self.monitor = Monitor(model, read_markers(markers, robot), settings)
                self._base = base_frame(self.parameters, robot.name)
                self._measured = MarkerInput(
                    self, self.parameters, self._base, self.monitor, self._frame
                )
                self.watching = Watching.if_enabled(self, self.parameters, self.monitor)
                self.adapting = Adapting(
                    self, self.parameters, self.monitor, self._loading, self._remote.put
                )
            else:
                self.monitor.set_model(model)
                # an adapted description does not restart the detection of drift
                anew = self.adapting is None or self.adapting.set_model(model, self._loading)
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
            measured = tensions_and_pulls(message, self.monitor.model.inputs)
        except Refusal as refusal:
            self._problem = str(refusal)
            return
        self.monitor.put_states(seconds(message.header.stamp) or time_now(self), *measured)
        if self._measured is not None:
            self._measured.hand_over()

    def _frame(self, at: float, positions: Floats) -> None:
        """Compare a frame of the tracker with the model and publish the errors."""
        assert self.monitor is not None
        before = len(self.monitor.recorded)
        compared = self.monitor.put_frame(
            at, positions
        )  # `MarkerInput` has checked the number of markers
        if len(self.monitor.recorded) > before:
            self._publish_progress(f'recording: {len(self.monitor.recorded)} postures')
        if compared is not None:
            self._frame_at = time.monotonic()
            if np.isfinite(compared.rolling):
                self._last_error = compared.rolling
            self._output.publish(self._base, compared)
            still = self.monitor.new_posture()
            if still is not None and self.adapting is not None:
                self.adapting.put(still)
            if self.watching is not None:
                self.watching.frame(at, compared.measured, self._base, still)

    def _cycle(self) -> None:
        """Handle the messages of the child process; publish the status."""
        self._take_model()
        if self.watching is not None and time.monotonic() - self._frame_at > SILENCE_S:
            # without the tracker, wire pulls determine the force
            self.watching.blind(self._base)
        for news in self.work.news():
            if news['kind'] == 'verdict':
                self._verdict.publish(String(data=json.dumps(news['content'])))
            if news['kind'] == 'add':
                self._remote.put(
                    news['file'],
                    lambda *answer: self._publish_progress(self.work.answered(*answer)),
                )
            if news['text']:
                self._publish_progress(news['text'])
        level, code, message = self._condition()
        self.status.arm = '' if self.monitor is None else self.monitor.model.robot.name
        self.status.publish(level, code, message, self._values)

    def _condition(self) -> tuple[bytes, str, str]:
        if self._problem:
            return ERROR, 'problem', self._problem
        if self.monitor is None:
            return WARN, 'waiting', 'waiting for the model of the controller'
        if self._measured is not None and self._measured.problem:
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
            **({} if self.adapting is None else self.adapting.values()),
        }

    def _publish_progress(self, text: str) -> None:
        self._progress.publish(String(data=text))

    def undo(self) -> str:
        """Undo the last change of the controller's model; return a text."""
        self._require_monitor()
        assert self.adapting is not None
        return self.adapting.undo()

    def learn(self) -> str:
        """Restart the learning of the arm; return a text."""
        self._watched().learn_anew()
        return self._watched().text

    def _watched(self) -> ArmWatch:
        if self.watching is None:
            raise InputError('nothing is watched: see the parameter reference_postures')
        return self.watching.watch

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
        dataset = monitor.dataset('this recording')
        save_dataset(dataset, folder.resolve())
        monitor.recording, monitor.kept = False, True
        self.work.diagnose(folder.resolve(), self.parameters['effects'])
        return f'diagnosing {len(monitor.recorded)} postures: {folder}'

    def _require_monitor(self) -> Monitor:
        if self.monitor is None:
            raise InputError('no model yet: is the controller running?')
        return self.monitor

    def _answer(
        self, name: str, act: Callable[[], str], request: object, response: Trigger.Response
    ) -> Trigger.Response:
        """Run the action of a service; respond with its text, or with the error."""
        try:
            response.message, response.success = act(), True
        except TendonRobotError as error:
            response.success, response.message = False, ' '.join(str(error).split())
        if name != 'change':  # its response is a file, not for users
            self._publish_progress(response.message)
        return response


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(MonitorNode, arguments)
