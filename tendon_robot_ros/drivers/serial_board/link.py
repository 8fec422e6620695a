"""The serial port to the board: whole frames go out, good frames come in; lost ports come back."""

from __future__ import annotations

import os
import select
import time

import serial

from ...exceptions import DriverError
from ..ports import LOST, take_alone, why_not
from . import messages
from .frames import Frame, Receiver, encode

CHUNK = 65536


class LinkLostError(Exception):
    """The port is gone; `reopen` may bring it back."""


class Link:
    """
    One port with one board.

    Attributes
    ----------
    path : str
    missed : int
        Frames of the board that never came, by their sequence numbers.
    sent_at : float
        `time.monotonic()` when something was last sent [s].

    """

    def __init__(self, path: str, baud: int) -> None:
        """Take the path of the port and its baud rate."""
        self.path, self.baud = path, baud
        self.missed, self.sent_at = 0, -1e9
        self._receiver = Receiver()
        self._port: serial.Serial | None = None
        self._sequence = 0
        self._expected: int | None = None

    @property
    def connected(self) -> bool:
        """Whether the port is open, as far as is known."""
        return self._port is not None

    @property
    def bad(self) -> int:
        """Frames thrown away here because something about them was wrong."""
        return self._receiver.bad

    def open(self) -> None:
        """Open the port for this process alone; raise DriverError when it cannot be."""
        self.close()
        try:
            self._open()
        except LOST as error:
            raise DriverError(why_not(self.path, error)) from None

    def reopen(self) -> bool:
        """Try to get a lost port back; tell whether it worked. Quick either way."""
        self.close()
        try:
            if os.path.exists(self.path):
                self._open()
        except LOST:
            pass
        return self.connected

    def _open(self) -> None:
        port = serial.Serial(self.path, self.baud, timeout=0, write_timeout=0.1, exclusive=True)
        try:
            take_alone(port.fileno())
            port.reset_input_buffer()
        except LOST:
            port.close()
            raise
        receiver = Receiver()
        receiver.bad = self._receiver.bad
        self._port, self._receiver, self._expected = port, receiver, None

    def close(self) -> None:
        """Give the port back; never raises."""
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except LOST:
                pass

    def send(self, kind: int, payload: bytes = b'') -> int:
        """Send a message; return its sequence number."""
        port = self._open_port()
        self._sequence = (self._sequence + 1) & 0xFF
        self.sent_at = time.monotonic()
        try:
            port.write(encode(kind, self._sequence, payload))
        except LOST as error:
            self._lost(error)
        return self._sequence

    def receive(self, wait: float) -> list[Frame]:
        """Return the good frames that came; sleep up to `wait` [s] until something comes."""
        port = self._open_port()
        try:
            file = port.fileno()
            if not select.select([file], [], [], max(wait, 0.0))[0]:
                return []
            data = os.read(file, CHUNK)
        except LOST as error:
            self._lost(error)
        if not data:
            self._lost(OSError('end of file'))
        frames = self._receiver.feed(data)
        for frame in frames:
            if frame.type >= messages.IDENTITY:
                if self._expected is not None:
                    self.missed += (frame.sequence - self._expected) & 0xFF
                self._expected = (frame.sequence + 1) & 0xFF
        return frames

    def flush(self) -> None:
        """Throw away what has come: it is old."""
        port = self._open_port()
        try:
            port.reset_input_buffer()
        except LOST as error:
            self._lost(error)
        self._expected = None

    def _open_port(self) -> serial.Serial:
        if self._port is None:
            raise LinkLostError(self.path)
        return self._port

    def _lost(self, error: BaseException) -> None:
        self.close()
        raise LinkLostError(f'{self.path}: {error}') from None
