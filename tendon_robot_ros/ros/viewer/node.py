"""
The live page in the browser: measured and predicted arm, errors, tensions, buttons.

Topics: what driver, controller and monitor of its namespace publish (subscribed);
controller/target_point, tour (published). Parameters and units: docs/live.md.
"""

from __future__ import annotations

import ipaddress
import secrets
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseArray, WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger

from ...robot import load_robot
from ..shared.lifecycle import OK, Status
from ..shared.messages import COMMAND, LATCHED, LATCHED_BY_MANY, LISTEN, STATE
from ..shared.parameters import Parameters, RemoteText, Spec
from ..shared.runtime import repeat, run
from .page import LivePage
from .state import ViewState

HELP = 'the live page in the browser (extra: viewer)'
Array = NDArray[np.float64]
SPECS = (
    Spec('host', '127.0.0.1', 'address to serve on; beyond this machine a token is needed',
         read_only=True),
    Spec('port', 8080.0, 'port of the page', '', 1.0, 65535.0, read_only=True),
    Spec('token', '', 'what a browser must give before it may command; empty: none on this '
         'machine, else drawn and logged', read_only=True),
    Spec('controller', 'controller', 'name of the controller node', read_only=True),
    Spec('driver', 'driver', 'name of the driver node', read_only=True),
    Spec('monitor', 'monitor', 'name of the monitor node', read_only=True),
    Spec('investigate', 'investigate', 'name of the node that investigates', read_only=True),
    Spec('rate', 25.0, 'frames per second', 'Hz', 1.0, 60.0, read_only=True),
)  # fmt: skip
PANEL_PERIOD_S = 0.25  # [s]
SERVICES = {
    'record': ('monitor',),
    'diagnose': ('monitor',),
    'add': ('monitor',),
    'start': ('investigate',),
    'stop': ('controller', 'driver'),
    'reset': ('driver', 'controller'),
}


class ViewerNode(Node):
    """Topics in, page out; what people click becomes messages and service calls."""

    def __init__(self) -> None:
        """Open the page and listen; the other nodes may come and go."""
        super().__init__('viewer')
        self.parameters = Parameters(self, SPECS)
        self.state = ViewState()
        nodes = ('controller', 'driver', 'monitor', 'investigate')
        names = {key: self.parameters[key] for key in nodes}
        host, token = self.parameters['host'], self.parameters['token']
        if not token and not _is_local(host):
            token = secrets.token_urlsafe(9)
            self.get_logger().warning(f'token for commands from the page: {token}')
        port = int(self.parameters['port'])
        self.page = LivePage(host, port, token)
        self._base = ''
        self._told = 0.0
        self._status_out = Status(self, 'page')
        self._frames: deque[float] = deque(maxlen=100)  # when the arm was drawn
        self._listen(names)
        self._targets = self.create_publisher(
            PointStamped, f'{names["controller"]}/target_point', COMMAND
        )
        self._tour = self.create_publisher(Bool, 'tour', LATCHED)
        self._remote = RemoteText(self, names['controller'], 'model')
        self._triggers = {
            (name, owner): self.create_client(Trigger, f'{names[owner]}/{name}')
            for name, owners in SERVICES.items()
            for owner in owners
        }
        repeat(self, 1.0 / self.parameters['rate'], self._cycle)
        repeat(self, 2.0, lambda: self._remote.ask(self._hear_model))

    @property
    def node(self) -> Node:
        """Return itself, for `run`."""
        return self

    def start(self) -> None:
        """Say where the page is."""
        self.get_logger().info(f'open http://{self.parameters["host"]}:{self.page.port}')

    def running(self) -> bool:
        """Go on."""
        return True

    def end(self, spin: Callable[[float], None]) -> None:
        """Close the page."""
        self.page.close()

    def _listen(self, names: dict[str, str]) -> None:
        subscribe, monitor = self.create_subscription, names['monitor']
        for key, name in names.items():
            subscribe(DiagnosticStatus, f'{name}/status', partial(self._status, key), LATCHED)
        subscribe(JointState, 'tendon_states', self._states, LISTEN)
        subscribe(PoseArray, 'measured_shape', partial(self._shape, 'measured'), LISTEN)
        subscribe(PoseArray, f'{monitor}/predicted', partial(self._shape, 'predicted'), LISTEN)
        subscribe(WrenchStamped, f'{monitor}/tip_force', self._force, LISTEN)
        subscribe(Float64, f'{monitor}/rolling_error', self._error, LISTEN)
        subscribe(Float64MultiArray, f'{monitor}/marker_errors', self._per_marker, LISTEN)
        subscribe(String, f'{monitor}/progress', self._progress, STATE)
        subscribe(String, f'{monitor}/verdict', self._verdict, LATCHED)
        subscribe(Bool, 'tour', self._touring, LATCHED)
        subscribe(String, f'{names["investigate"]}/progress', self._news, LATCHED_BY_MANY)

    def _cycle(self) -> None:
        """Take clicks, draw, and now and then update the panel."""
        while not self.page.commands.empty():
            self._command(*self.page.commands.get())
        now = time.monotonic()
        self.page.draw(self.state)
        self._frames.append(now)
        if now - self._told >= PANEL_PERIOD_S:
            self._told = now
            self.page.tell(self.state, now)
            self._say(now)

    def _say(self, now: float) -> None:
        """Publish how the page is."""
        frames = sum(now - at <= 2.0 for at in self._frames) / 2.0
        statuses = self.state.statuses(now)
        values = {
            'browsers': str(self.page.clients),
            'frames (Hz)': f'{frames:.1f}',
            'hears': ', '.join(name for name, (level, _) in statuses.items() if level != 'silent'),
        }
        self._status_out.say(OK, 'serving', f'page on port {self.page.port}', values)

    def _command(self, name: str, value: object) -> None:
        if name == 'target':
            self._send_target(np.asarray(value))
        elif name == 'tour':
            self.state.held = not value
            self._tour.publish(Bool(data=bool(value)))
        else:
            for owner in SERVICES[name]:
                self._call(name, owner)

    def _send_target(self, place: Array) -> None:
        if not self.state.held:
            self.state.held = True
            self._tour.publish(Bool(data=False))
        if not self._base:
            self.state.progress = 'no controller yet: the target was not sent'
            return
        message = PointStamped()
        message.header.frame_id = self._base
        message.header.stamp = self.get_clock().now().to_msg()
        message.point.x, message.point.y, message.point.z = place.tolist()
        self._targets.publish(message)

    def _call(self, name: str, owner: str) -> None:
        client = self._triggers[name, owner]
        if not client.service_is_ready():
            self.state.progress = f'{client.srv_name} does not answer: is the node running?'
            return

        def done(future: object) -> None:
            self.state.progress = str(future.result().message)  # type: ignore[attr-defined]

        client.call_async(Trigger.Request()).add_done_callback(done)

    def _status(self, key: str, message: DiagnosticStatus) -> None:
        values = {item.key: item.value for item in message.values}
        level = int.from_bytes(message.level, 'little')
        self.state.hear_status(time.monotonic(), key, level, message.message, values)

    def _states(self, message: JointState) -> None:
        blank = [float('nan')] * len(message.name)
        self.state.inputs = tuple(message.name)
        self.state.tensions = tuple(message.effort or blank)

    def _shape(self, which: str, message: PoseArray) -> None:
        points = [[p.position.x, p.position.y, p.position.z] for p in message.poses]
        setattr(self.state, which, np.array(points).reshape(-1, 3))
        if which == 'measured' and not self._base:
            self._base = message.header.frame_id

    def _force(self, message: WrenchStamped) -> None:
        f = message.wrench.force
        self.state.force, self.state.force_at = np.array([f.x, f.y, f.z]), time.monotonic()

    def _error(self, message: Float64) -> None:
        self.state.hear_error(time.monotonic(), message.data)

    def _per_marker(self, message: Float64MultiArray) -> None:
        self.state.hear_markers(time.monotonic(), message.data)

    def _progress(self, message: String) -> None:
        self.state.progress = message.data

    def _verdict(self, message: String) -> None:
        self.state.hear_verdict(message.data)

    def _news(self, message: String) -> None:
        self.state.hear_investigation(message.data)

    def _touring(self, message: Bool) -> None:
        self.state.touring = message.data

    def _hear_model(self, text: str) -> None:
        robot = load_robot(text)
        self.state.limits = robot.tension_limits
        self.page.resize(robot.length)


def _is_local(host: str) -> bool:
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def main(arguments: Sequence[str]) -> int:
    """Run the node until a signal comes."""
    return run(ViewerNode, arguments)
