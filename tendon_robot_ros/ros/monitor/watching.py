"""Drift, contact and adaptation in the monitor node: rates and publishers."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from datetime import datetime
from typing import Any

import numpy as np
from geometry_msgs.msg import Wrench, WrenchStamped
from std_msgs.msg import Bool, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from ...common.arrays import Floats
from ...common.errors import InputError
from ...common.words import with_unit
from ...inference.intervals import load_of
from ...model.model import Model
from ...monitoring.adaptation import Adaptation, ModelChange
from ...monitoring.contact import Contact
from ...monitoring.monitor import FrameMean, Monitor, StillMeasurement
from ...monitoring.watch import ArmWatch, WatchSettings
from ...report.sentences import load_words
from ...robot import Robot, dump_robot
from ...robot.estimates import natural_sizes, same_input
from ..shared import interface
from ..shared.messages import contact_marker, header_now, vector
from ..shared.parameters import ParameterNode, base_frame

Send = Callable[[str, Callable[[bool, str], None]], None]


class Watching:
    """Passes postures and frames to the detection of drift and forces; publishes results."""

    def __init__(self, node: ParameterNode, monitor: Monitor) -> None:
        """Start to learn the arm."""
        parameters = node.parameters
        self._node, self._parameters, self._monitor = node, parameters, monitor
        self._base = base_frame(parameters, monitor.model.robot.name)
        postures = int(parameters['reference_postures']) or WatchSettings.reference_postures
        settings = parameters.fill(WatchSettings, reference_postures=postures)
        self.watch = ArmWatch(monitor.model, monitor.markers, settings)
        self._drift = parameters['reference_postures'] > 0.0
        # [s] when the next contact is estimated
        self._due = 0.0 if parameters['force_rate'] > 0.0 else np.inf
        self.contact: Contact | None = None
        self._reaction = ''  # to the present contact
        self._exceeded = False  # by the last estimate: a single one may be wrong
        noise, same = parameters['tracker_noise'], same_input(monitor.model.robot, 'tension')
        self._frames = FrameMean(noise, same, parameters['force_time'])
        forces = 'monitor/tip_force', 'monitor/tip_force_covariance', 'monitor/contact'
        others = 'monitor/markers', 'monitor/drift', 'stop'
        self._send = interface.publishing(node, *forces, *others)
        held = interface.topic('controller/tendon_trajectory', parameters['controller'])
        self._send['hold'] = node.create_publisher(*held).publish
        self._published = ''

    def set_model(self, model: Model) -> None:
        """Restart the learning with another description."""
        self.watch = ArmWatch(model, self.watch.markers, self.watch.settings)

    @property
    def drifted(self) -> bool:
        """Whether there is an alarm of drift."""
        state = self.watch.state
        return state is not None and state.alarm

    def values(self) -> dict[str, str]:
        """Return values for the status."""
        values = {}
        if self._drift:
            values = {'drift': str(self.drifted).lower(), 'watch': self.watch.text}
        if (contact := self.contact) is not None:
            values['tip_force'] = self._said(contact)
            values['tip_force (N)'] = f'{float(np.linalg.norm(contact.force)):.4g}'
            touched, robot = contact.acts, self.watch.model.robot
            ends = np.cumsum(robot.cell_lengths) + 1e-9  # [m] a cell's end belongs to it
            cell = int(np.searchsorted(ends, contact.place)) + 1 - robot.plate_cells
            values['touched_at_cell'] = str(cell) if touched else ''
            places = contact.place, *contact.interval
            at, low, high = (f'{place:.4g}' if touched else 'nan' for place in places)
            values |= {'touched_at (m)': at, 'touched_from (m)': low, 'touched_to (m)': high}
            values['reaction'] = self._reaction
        return values

    def _said(self, contact: Contact) -> str:
        """Return force and place in words."""
        gravity = self.watch.model.robot.gravity
        words = load_words(load_of(contact.force, contact.covariance, gravity))
        place, low, high = (f'{1e3 * one:.0f}' for one in (contact.place, *contact.interval))
        where = f'at {place} mm ({low} to {high})' if contact.acts else 'nothing acts'
        return f'{words}; {where}'

    def frame(self, at: float, positions: Floats, still: StillMeasurement | None) -> None:
        """Use a frame, positions (J, 3) [m], and the posture if the arm is at rest."""
        if self._drift and still is not None:
            self.watch.update(still.inputs, still.positions, still.frames)
            self._publish_state()
        state = self._monitor.states.at(at)
        if state is None or self._due == np.inf:
            return
        tensions, _ = np.split(state, 2)
        if not np.isfinite(tensions).all():  # it would hide the force as long as it is averaged
            return
        self._frames.put(at, tensions, positions)
        if self._is_due():
            tensions, positions, frames = self._frames.take(self.watch.observer.slopes)
            self._publish(tensions, positions, None, frames)

    def blind(self) -> None:
        """Estimate the force without the tracker, from wire pulls and tensions if both exist."""
        states = self._monitor.states
        state = states.at(states.newest)
        if state is not None and self._is_due():
            tensions, pulls = np.split(state, 2)
            if np.isfinite(tensions).all():
                self._publish(tensions, None, pulls)

    def _is_due(self) -> bool:
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = now + 1.0 / self._parameters['force_rate']
        return True

    def _publish(
        self, tensions: Floats, positions: Floats | None, pulls: Floats | None, frames: int = 1
    ) -> None:
        watch, find = self.watch, self.watch.observer.update
        self.contact = contact = (
            None if watch.learning else find(tensions, positions, pulls, frames)
        )
        if contact is None:
            return
        self._react(contact)
        header, robot = header_now(self._node, self._base), self.watch.model.robot
        wrench, arrow = Wrench(force=vector(contact.force)), contact.arrow(robot.length)
        self._send['monitor/tip_force'](WrenchStamped(header=header, wrench=wrench))
        covariance = Float64MultiArray(data=contact.covariance.ravel().tolist())
        self._send['monitor/tip_force_covariance'](covariance)
        content = {
            'text': self._said(contact),
            'acts': contact.acts,
            'arc_length': contact.place,
            'interval': contact.interval,
            'point': contact.point.tolist(),
            'force': contact.force.tolist(),
            'arrow': arrow.tolist(),
            'reaction': self._reaction,
        }
        self._send['monitor/contact'](String(data=json.dumps(content)))
        thickness = natural_sizes(robot)['radius']  # half of the arm's line, so that it is seen
        ends = arrow if contact.acts else None
        self._send['monitor/markers'](contact_marker(header, ends, thickness))

    def _publish_state(self) -> None:
        """Publish the state of the alarm when it has changed."""
        state = self.watch.state
        content: dict[str, Any] = {'text': self.watch.text, 'alarm': self.drifted}
        if state is not None and state.alarm:
            suspects = [vars(suspect) for suspect in state.suspects]
            content |= {'postures': state.postures, 'suspects': suspects}
        text = json.dumps(content)
        if text != self._published:
            self._published = text
            self._send['monitor/drift'](String(data=text))

    def _react(self, contact: Contact) -> None:
        """
        Stop the arm, or let it yield, once when a contact is harder than the threshold.

        A stop is taken back when the contact ends.
        """
        action = self._parameters['contact_action']
        exceeds = contact.exceeds(self._parameters['contact_threshold'])
        acts, self._exceeded = action != 'none' and exceeds and self._exceeded, exceeds
        before, self._reaction = self._reaction, action if acts else ''
        if self._reaction == before:
            return
        if 'stop' in (self._reaction, before):
            self._send['stop'](Bool(data=self._reaction == 'stop'))
        if self._reaction == 'yield':
            self._send['hold'](JointTrajectory())  # without points: hold now
        if self._reaction:
            force = float(np.linalg.norm(contact.force))
            self._node.get_logger().warning(
                f'contact of {force:.3g} N at {1e3 * contact.place:.0f} mm: {self._reaction}'
            )


class Adapting:
    """Passes postures to the adaptation, and its changes to the controller."""

    def __init__(self, node: ParameterNode, monitor: Monitor, text: str, send: Send) -> None:
        """Start from the model in use and its text; `send` sends the controller another one."""
        self._node, self._parameters, self._monitor = node, node.parameters, monitor
        self._send, self._sent, self._waiting = send, text, False
        self._publisher = node.create_publisher(*interface.topic('monitor/adaptation'))
        self._begin(monitor.model)

    def set_model(self, model: Model, text: str) -> bool:
        """Restart with another description unless it was sent from here; return whether."""
        if text == self._sent:
            return False
        self._sent = text
        self._begin(model)
        return True

    def values(self) -> dict[str, str]:
        """Return values for the status."""
        on, count = bool(self._parameters['adapt']), len(self._adaptation.changes)
        values = {'adapt': str(on).lower(), 'adapted': str(count)}
        return values | ({'follows': self._adaptation.text} if on else {})

    def put(self, still: StillMeasurement) -> None:
        """Use a posture of the arm at rest."""
        change = self._parameters['adapt']
        if self._waiting or not (change or self._parameters['reference_postures']):
            return
        applied = self._adaptation.update(still.inputs, still.positions, change, still.frames)
        if applied is not None:
            self._log_change('changed', applied)
            self._put(self._adaptation.robot, self._adaptation.undo)
        else:
            self._publish()

    def undo(self) -> str:
        """
        Undo the last change and switch the adaptation off; return a text.

        Raises
        ------
        InputError
            There was no change, or the controller has not answered yet.

        """
        if self._waiting:
            raise InputError('the last change is still on its way to the controller')
        adaptation = self._adaptation
        robot, changes = adaptation.robot, adaptation.changes.copy()
        undone = adaptation.undo()
        if undone is None:
            raise InputError('nothing was changed since this description was taken')
        self._parameters.put_back('adapt', False)
        self._log_change('undone', undone)

        def redo() -> None:
            adaptation.robot, adaptation.changes = robot, changes

        self._put(adaptation.robot, redo)
        text = '; '.join(
            f'{one.effect}.{one.parameter} is {with_unit(f"{one.after:.4g}", one.unit)} again'
            for one in undone.parameters
        )
        return f'{text}; adapt is false now'

    def _begin(self, model: Model) -> None:
        noise = self._parameters['tracker_noise']
        self._adaptation = Adaptation(model, self._monitor.markers, noise)
        if self._parameters['model']:
            self._adaptation.problem = (
                'nothing can follow: the monitor compares with a model of its own (model)'
            )

    def _put(self, robot: Robot, take_back: Callable[[], object]) -> None:
        """Send a description to the controller; take the change back if it refuses."""
        before, self._sent, self._waiting = self._sent, dump_robot(robot), True

        def answered(accepted: bool, reason: str) -> None:
            self._waiting = False
            if not accepted:
                self._sent = before
                take_back()
                self._node.get_logger().warning(f'the controller keeps its model: {reason}')

        self._send(self._sent, answered)

    def _log_change(self, what: str, change: ModelChange) -> None:
        """Write a change to console and topic."""
        for one in change.parameters:
            self._node.get_logger().info(f'{what}: {one}')
        now = datetime.now().astimezone().isoformat(timespec='seconds')
        self._publish({'what': what, 'time': now, **change.to_json()})

    def _publish(self, last: dict[str, object] | None = None) -> None:
        """Publish the estimate, and the last change."""
        estimate = self._adaptation
        content: dict[str, object] = {
            'text': estimate.text,
            'postures': estimate.postures,
            'memory_postures': estimate.memory if estimate.memory < 1e9 else None,
            'parameters': {
                key: {'value': value, 'sd': sd} for key, (value, sd) in estimate.values().items()
            },
            'changes': len(estimate.changes),
        }
        if last is not None:
            content['last'] = last
        self._publisher.publish(String(data=json.dumps(content)))
