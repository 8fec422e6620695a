"""
Move the tip with the keyboard; it stops when the key is released.

Topics: ~/delta_twist remapped to that of the controller (published). Services called: stop and
reset of the controller. Parameters and units: ros/parameters.yaml.

example: python -m tendon_robot_ros teleop --ros-args -r __ns:=/left_arm
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from dataclasses import dataclass
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from std_srvs.srv import Trigger

from ...common.errors import InputError
from ..shared import interface
from ..shared.messages import Request, header_now, status_values, vector
from ..shared.parameters import ParameterNode
from ..shared.runtime import repeat, run
from ..shared.timing import NEWS_PERIOD_S

HELP = 'move the tip with the keyboard'
KEPT_FROM_MOVING = 'stopped', 'driver_stopped', 'released', 'no_driver', 'not_ready'


class TeleopNode(ParameterNode):
    """Converts keys to twists."""

    def __init__(self) -> None:
        """Read the terminal key by key; InputError: there is none."""
        super().__init__('teleop')
        if not sys.stdin.isatty():
            raise InputError('teleop: expected a terminal to read keys from, got a pipe or file')
        name = self.parameters['controller']
        self._twists = self.create_publisher(*interface.topic('controller/delta_twist', name))
        self._calls = {
            key: Request(self, Trigger, f'{name}/{service}')
            for key, service in ((' ', 'stop'), ('c', 'reset'))
        }
        self._problem = ''  # of the controller, as printed last
        interface.subscribe(self, 'node/status', self._receive, name)
        self._deadman = Deadman(self.parameters['hold'])
        self._factor, self._in_tip, self._quit, self._moved = 1.0, False, False, False
        self._terminal = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        repeat(self, NEWS_PERIOD_S, self._cycle)
        print(LEGEND, end='', flush=True)

    def running(self) -> bool:
        """Go on until q."""
        return not self._quit

    def end(self) -> None:
        """Stop the tip and restore the terminal."""
        self._send([0.0] * 6)
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)

    def _cycle(self) -> None:
        now = time.monotonic()
        for key in pressed():
            self._press(key, now)
        scale, self._deadman.hold = self._factor, self.parameters['hold']
        velocity = self._deadman.velocity(
            now, scale * self.parameters['linear_speed'], scale * self.parameters['angular_speed']
        )
        if velocity is not None or self._moved:  # one zero twist stops the tip at once
            self._send(velocity or [0.0] * 6)
        self._moved = velocity is not None

    def _press(self, key: str, now: float) -> None:
        if key in MOVES:
            self._deadman.press(key, now)
        elif key in ('+', '-'):
            self._factor = min(max(self._factor * (1.25 if key == '+' else 0.8), 0.05), 10.0)
            print(f'speed x {self._factor:.2f}')
        elif key == 't':
            self._in_tip = not self._in_tip
            print('axes of the ' + ('tip' if self._in_tip else 'base'))
        elif key == 'q':
            self._quit = True
        elif key in self._calls:
            request = self._calls[key]
            if not request.ask(Trigger.Request(), lambda r: print(f'{request.name}: {r.message}')):
                print(f'{request.name}: no such service; is the controller running?')

    def _receive(self, status: DiagnosticStatus) -> None:
        """Print why the tip does not move, as when twists are in frames of another robot."""
        code = status_values(status).get('code', '')
        problem = ''
        if code.startswith('refused_') or code in KEPT_FROM_MOVING:
            problem = f'{code}: {status.message}'
        if problem and problem != self._problem:
            print(problem)
        self._problem = problem

    def _send(self, velocity: list[float]) -> None:
        axes = 'tip' if self._in_tip else 'base'
        frame = f'{self.parameters["frame_prefix"]}{self.parameters["robot"]}_{axes}'
        twist = Twist(linear=vector(velocity[:3]), angular=vector(velocity[3:]))
        self._twists.publish(TwistStamped(header=header_now(self, frame), twist=twist))


main = partial(run, TeleopNode)  # until q or a signal comes


AXES = 'da', 'ws', 'rf', 'ik', 'lj'  # keys along + and - of linear x, y, z, about x, y
MOVES = {
    key: (axis, forwards)
    for axis, pair in enumerate(AXES)
    for key, forwards in zip(pair, (True, False), strict=True)
}
ARROWS = {'\x1b[C': 'd', '\x1b[D': 'a', '\x1b[A': 'r', '\x1b[B': 'f'}
LEGEND = """\
hold a key to move the tip, let go to stop
  a d   -x +x  (arrows left, right)      j l   turn about -y +y
  s w   -y +y                            k i   turn about -x +x
  f r   -z +z  (arrows down, up)         + -   faster, slower
  t     base or tip axes                 space stop (latched)   c reset   q quit
"""


@dataclass
class Deadman:
    """
    A velocity that is valid only while its key repeats.

    Terminals do not report the release of a key; they repeat it while it is held. The tip stops
    `hold` seconds after the last repeat.
    """

    hold: float = 0.15  # [s]
    key: str = ''
    until: float = -1.0

    def press(self, key: str, now: float) -> None:
        """Set the key that is held."""
        self.key, self.until = key, now + self.hold

    def velocity(self, now: float, linear: float, angular: float) -> list[float] | None:
        """Return the six components [m/s, rad/s], or None when nothing is held."""
        if now >= self.until or self.key not in MOVES:
            return None
        (axis, forwards), velocity = MOVES[self.key], [0.0] * 6
        speed = linear if axis < 3 else angular
        velocity[axis] = speed if forwards else -speed
        return velocity


def pressed() -> list[str]:
    """Return the keys that were pressed since the last call."""
    if not select.select([sys.stdin], [], [], 0.0)[0]:
        return []
    text = os.read(sys.stdin.fileno(), 1024).decode(errors='ignore')
    for arrow, key in ARROWS.items():
        text = text.replace(arrow, key)
    return list(text)
