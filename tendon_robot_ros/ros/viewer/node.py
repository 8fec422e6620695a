"""
The live page in the browser: measured and predicted arm, errors, tensions, buttons.

Topics: what driver, controller and monitor of its namespace publish (subscribed);
controller/target_point, tour (published). Parameters and units: ros/parameters.yaml.

example: python -m tendon_robot_ros viewer --ros-args -p port:=8081
"""

from __future__ import annotations

import ipaddress
import json
import math
import secrets
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ...robot import Robot
from ..shared import interface
from ..shared.lifecycle import OK, Status
from ..shared.messages import Request, header_now, point, points_of, status_values
from ..shared.parameters import ParameterNode, watch_robot
from ..shared.runtime import repeat, run
from .page import LivePage
from .state import PANEL_PERIOD_S, ViewState

HELP = 'the live page in the browser (extra: viewer)'
SERVICES = {
    'record': ('monitor',),
    'diagnose': ('monitor',),
    'add': ('monitor',),
    'start': ('investigate',),
    'stop': ('controller', 'driver'),
    'reset': ('driver', 'controller'),
}


class ViewerNode(ParameterNode):
    """Shows topics on the page; clicks become messages and service calls."""

    def __init__(self) -> None:
        """Open the page and create the subscriptions; the other nodes may start and end."""
        super().__init__('viewer')
        self.state = ViewState()
        nodes = ('controller', 'driver', 'monitor', 'investigate')
        names = {key: self.parameters[key] for key in nodes}
        host, token = self.parameters['host'], self.parameters['token']
        if not token and not is_local(host):
            token = secrets.token_urlsafe(9)
            self.get_logger().warning(f'token for commands from the page: {token}')
        self.page = LivePage(host, int(self.parameters['port']), token)
        self._base, self._panel_at = '', 0.0
        self._status = Status(self, 'page')
        self._frames: deque[float] = deque(maxlen=200)  # [s] when the arm was drawn, 2 s at least
        self._listen(names)
        target = interface.topic('controller/target_point', names['controller'])
        self._targets = self.create_publisher(*target)
        self._tour = self.create_publisher(*interface.topic('tour'))
        self._triggers = {
            name: [Request(self, Trigger, f'{names[owner]}/{name}') for owner in owners]
            for name, owners in SERVICES.items()
        }
        repeat(self, 1.0 / self.parameters['rate'], self._cycle)

        def take(robot: Robot) -> None:
            self.state.limits = robot.tension_limits
            self.page.resize(robot.length)

        watch_robot(self, names['controller'], take)
        self.get_logger().info(f'open http://{host}:{self.page.port}')

    def end(self) -> None:
        """Close the page."""
        self.page.close()

    def _listen(self, names: dict[str, str]) -> None:
        """Subscribe to the topics that update the state of the page."""
        state, now = self.state, time.monotonic

        def status(key: str, message: DiagnosticStatus) -> None:
            level, values = int.from_bytes(message.level, 'little'), status_values(message)
            state.set_status(now(), key, level, message.message, values)

        def states(message: JointState) -> None:
            known = len(message.effort) == len(message.name)
            state.inputs = tuple(message.name)
            state.tensions = tuple(message.effort if known else [math.nan] * len(message.name))

        def predicted_tip(message: PoseStamped) -> None:
            self._base = message.header.frame_id

        def contact(message: String) -> None:
            state.force, state.force_at = np.array(json.loads(message.data)['arrow']), now()

        def keep(name: str, value: Callable[[Any], object]) -> Callable[[Any], None]:
            return lambda message: setattr(state, name, value(message))

        for key, name in names.items():
            interface.subscribe(self, 'node/status', partial(status, key), name)
        progress = keep('progress', lambda m: m.data)
        interface.subscribe(self, 'monitor/progress', progress, names['monitor'], interface.STATE)
        topics: dict[str, Callable[[Any], None]] = {
            'tendon_states': states,
            'controller/predicted_tip': predicted_tip,
            'monitor/measured': keep('measured', points_of),
            'monitor/predicted': keep('predicted', points_of),
            'monitor/contact': contact,
            'monitor/rolling_error': lambda m: state.add_error(now(), m.data),
            'monitor/marker_errors': lambda m: state.add_marker_errors(now(), m.data),
            'monitor/verdict': keep('verdict', lambda m: json.loads(m.data)),
            'tour': keep('touring', lambda m: m.data),
            'investigate/progress': lambda m: state.add_investigation(m.data),
        }
        for topic, callback in topics.items():
            interface.subscribe(self, topic, callback, names.get(topic.partition('/')[0], ''))

    def _cycle(self) -> None:
        """Handle clicks, draw the arms, and update the panel every `PANEL_PERIOD_S`."""
        while not self.page.commands.empty():
            self._command(*self.page.commands.get())
        now = time.monotonic()
        self.page.draw(self.state)
        self._frames.append(now)
        if now - self._panel_at >= PANEL_PERIOD_S:
            self._panel_at = now
            self.page.update(self.state, now)
            frames = sum(now - at <= 2.0 for at in self._frames) / 2.0
            statuses = self.state.statuses(now).items()
            values = {
                'browsers': str(self.page.clients),
                'frames (Hz)': f'{frames:.1f}',
                'hears': ', '.join(name for name, (level, _) in statuses if level != 'silent'),
            }
            self._status.publish(OK, 'serving', f'page on port {self.page.port}', lambda: values)

    def _command(self, name: str, value: Any) -> None:
        """Handle a click."""
        if name in self._triggers:
            for request in self._triggers[name]:
                if not request.ask(Trigger.Request(), lambda answer: self._say(answer.message)):
                    self._say(f'{request.name} does not answer: is the node running?')
            return
        if name == 'tour' or not self.state.held:
            touring = name == 'tour' and bool(value)
            self.state.held = not touring
            self._tour.publish(Bool(data=touring))
        if name == 'target' and not self._base:
            self._say('no controller yet: the target was not sent')
        elif name == 'target':
            header = header_now(self, self._base)
            self._targets.publish(PointStamped(header=header, point=point(value)))

    def _say(self, text: str) -> None:
        self.state.progress = text


def is_local(host: str) -> bool:
    """Return whether an address is reachable from this machine alone."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


main = partial(run, ViewerNode)  # until a signal comes
