"""The emulated bus: a pseudo-terminal, the servos on it, and a thread that serves both."""

from __future__ import annotations

import termios
import time

from ..dynamixel.tables import BAUD_RATES
from . import packets
from .faults import Faults
from .plug import Plug
from .responder import Responder
from .rig import Rig
from .servo import Servo

GAP = 0.02  # [s] of silence that ends a broken packet


class Line(Plug):
    """
    An emulated port with servos; `port` is the path to open.

    Attributes
    ----------
    rig : Rig
    faults : Faults
    responder : Responder

    """

    def __init__(self, rig: Rig, port: str | None = None) -> None:
        """Plug it in, at a path of its own if none is given; `start` begins to answer."""
        self.rig, self.faults = rig, Faults()
        self.responder = Responder(rig)
        self._heard = time.monotonic()
        self._receiver = packets.Receiver()
        super().__init__('dynamixel', port)

    def restart(self, identity: int) -> None:
        """Let a servo lose its power for a moment."""
        with self._lock:
            self.rig.rebooted(identity)

    def servo(self, identity: int) -> Servo:
        """Return the servo with an id."""
        return self.rig.servos[identity]

    def _let_time_pass(self, passed: float) -> None:
        self.rig.advance(passed)

    def _hear(self, data: bytes) -> None:
        now = time.monotonic()
        if now - self._heard > GAP:
            self._plugged()
        self._heard = now
        speed = self._speed()
        for instruction in self._receiver.feed(data):
            self._send(self.faults.on_the_way(self.responder.carry_out(instruction, speed)))

    def _plugged(self) -> None:
        self._receiver = packets.Receiver()

    def _speed(self) -> int | None:
        """Baud rate that the client has set, None when it is an odd one."""
        if self._master is None:
            return None
        try:
            code = termios.tcgetattr(self._master)[5]
        except termios.error:
            return None
        for baud in BAUD_RATES.values():
            if getattr(termios, f'B{baud}') == code:
                return baud
        return None
