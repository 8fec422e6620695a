"""Identification while running: when the monitor asks, what it changes and publishes."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

from rclpy.node import Node
from std_msgs.msg import String

from ...common.errors import InputError
from ...common.words import with_unit
from ...model.model import Model
from ...monitoring import Monitor, StillMeasurement
from ...monitoring.adaptation import Adaptation, ModelChange
from ...robot import Robot, dump_robot
from ..shared.messages import LATCHED
from ..shared.parameters import Parameters

LOG = 'adaptation.jsonl'  # in the folder of the monitor: a line for every change
Send = Callable[[str, Callable[[bool, str], None]], None]


class Adapting:
    """Hands postures to the estimate, and its changes to the controller."""

    def __init__(
        self, node: Node, parameters: Parameters, monitor: Monitor, text: str, send: Send
    ) -> None:
        """Begin with the model in use and its text; `send` gives the controller another one."""
        self._node, self._parameters, self._monitor = node, parameters, monitor
        self._send, self._sent, self._waiting = send, text, False
        self._publisher = node.create_publisher(String, '~/adaptation', LATCHED)
        self._begin(monitor.model)

    def set_model(self, model: Model, text: str) -> bool:
        """Begin anew with another description, unless it came from here; return whether."""
        if text == self._sent:
            return False
        self._sent = text
        self._begin(model)
        return True

    def values(self) -> dict[str, str]:
        """Return what the status says."""
        on, made = bool(self._parameters['adapt']), len(self._adaptation.changes)
        said = {'adapt': str(on).lower(), 'adapted': str(made)}
        return said | ({'follows': self._adaptation.text} if on else {})

    def stands(self, stood: StillMeasurement) -> None:
        """Take a posture at which the arm stands."""
        change = self._parameters['adapt']
        if self._waiting or not (change or self._parameters['reference_postures']):
            return
        made = self._adaptation.stands(stood.inputs, stood.positions, change, stood.frames)
        if made is not None:
            self._tell('changed', made)
            self._put(self._adaptation.robot)
        else:
            self._publish()

    def undo(self) -> str:
        """
        Take the last change back and follow no longer.

        Raises
        ------
        InputError
            Nothing was changed, or the controller has not answered yet.

        """
        if self._waiting:
            raise InputError('the last change is still on its way to the controller')
        undone = self._adaptation.undo()
        if undone is None:
            raise InputError('nothing was changed since this description was taken')
        self._parameters.put_back('adapt', False)
        self._tell('undone', undone)
        self._put(self._adaptation.robot)
        said = '; '.join(
            f'{one.effect}.{one.parameter} is {with_unit(f"{one.after:.4g}", one.unit)} again'
            for one in undone.parameters
        )
        return f'{said}; adapt is false now'

    def _begin(self, model: Model) -> None:
        noise = self._parameters['tracker_noise']
        self._adaptation = Adaptation(model, self._monitor.markers, noise)
        if self._parameters['model']:
            self._adaptation.problem = (
                'nothing can follow: the monitor compares with a model of its own (model)'
            )

    def _put(self, robot: Robot) -> None:
        """Send a description to the controller; one that it refuses is taken back."""
        before, self._sent, self._waiting = self._sent, dump_robot(robot), True

        def answered(taken: bool, reason: str) -> None:
            self._waiting = False
            if not taken:
                self._sent = before
                self._adaptation.undo()
                self._node.get_logger().warning(f'the controller keeps its model: {reason}')

        self._send(self._sent, answered)

    def _tell(self, what: str, change: ModelChange) -> None:
        """Log a change: to the console, the topic, and the file."""
        for one in change.parameters:
            self._node.get_logger().info(f'{what}: {one}')
        now = datetime.now().astimezone().isoformat(timespec='seconds')
        self._publish({'what': what, 'time': now, **change.to_json()})
        path = Path(self._parameters['folder']) / LOG
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open('a', encoding='utf-8') as log:
                log.write(json.dumps({'what': what, 'time': now, **change.to_json()}) + '\n')
        except OSError as error:  # the arm goes on: a full disk
            self._node.get_logger().warning(f'{path}: cannot be written ({error.strerror})')

    def _publish(self, last: dict[str, object] | None = None) -> None:
        """Publish the estimate, and the last change."""
        made = self._adaptation
        content: dict[str, object] = {
            'text': made.text,
            'postures': made.postures,
            'memory_postures': made.memory if made.memory < 1e9 else None,
            'parameters': {
                key: {'value': value, 'sd': sd} for key, (value, sd) in made.values().items()
            },
            'changes': len(made.changes),
        }
        if last is not None:
            content['last'] = last
        self._publisher.publish(String(data=json.dumps(content)))
