"""The emulated bus: a pseudo-terminal, the servos on it, and a thread that serves both."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import tempfile
import termios
import threading
import time
import tty
from pathlib import Path

from ...exceptions import InputError
from ..dynamixel.tables import BAUD_RATES
from . import packets
from .faults import Faults
from .responder import Responder
from .rig import Rig
from .servo import Servo

IDLE = 0.005  # [s] between two looks at the clock when nothing arrives
GAP = 0.02  # [s] of silence that ends a broken packet


class Line:
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
        self._folder = Path(tempfile.mkdtemp(prefix='tendon_robot_ros_'))
        self.port = port or str(self._folder / 'dynamixel')
        if os.path.exists(self.port):
            raise InputError(f'{self.port}: there is a file of that name already')
        self._master: int | None = None
        self._receiver = packets.Receiver()
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, name='emulated bus', daemon=True)
        self._before = self._heard = time.monotonic()
        self.plug()

    def start(self) -> Line:
        """Answer from now on, in a thread of its own."""
        self._before = time.monotonic()
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the thread and take the port away."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Line:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    def plug(self) -> None:
        """Make the port appear; the servos kept their power."""
        with self._lock:
            if self._master is not None:
                return
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)
            os.symlink(os.ttyname(slave), self.port)
            os.close(slave)  # else a client's exclusive lock would outlive the client
            self._master, self._receiver = master, packets.Receiver()

    def unplug(self) -> None:
        """Pull the plug: the port is gone, the servos keep their power."""
        with self._lock:
            if self._master is None:
                return
            os.close(self._master)
            self._master = None
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)

    def restart(self, identity: int) -> None:
        """Let a servo lose its power for a moment."""
        with self._lock:
            self.rig.rebooted(identity)

    def servo(self, identity: int) -> Servo:
        """Return the servo with an id."""
        return self.rig.servos[identity]

    def _serve(self) -> None:
        while not self._end.is_set():
            data = self._receive()
            with self._lock:
                self._let_time_pass()
                if not data:
                    continue
                now = time.monotonic()
                if now - self._heard > GAP:
                    self._receiver = packets.Receiver()
                self._heard = now
                speed = self._speed()
                for instruction in self._receiver.feed(data):
                    self._send(
                        self.faults.on_the_way(self.responder.carry_out(instruction, speed))
                    )

    def _receive(self) -> bytes:
        """Wait a little for bytes; none when there are none or nobody has the port open."""
        master = self._master
        if master is not None:
            with contextlib.suppress(OSError, ValueError):
                if not select.select([master], [], [], IDLE)[0]:
                    return b''
                return os.read(master, 4096)
        time.sleep(IDLE)
        return b''

    def _send(self, answer: bytes) -> None:
        if self._master is not None and answer:
            with contextlib.suppress(OSError):
                os.write(self._master, answer)

    def _let_time_pass(self) -> None:
        now = time.monotonic()
        self.rig.advance(now - self._before)
        self._before = now

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
