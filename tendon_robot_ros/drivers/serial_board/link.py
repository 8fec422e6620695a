"""
The serial port to the board: it sends and receives whole frames, and reopens lost ports.

Requests that the board must answer: its identity, its configuration, and the counts of its load
cells.
"""

from __future__ import annotations

import io
import os
import select
import time

import numpy as np

from ...common.arrays import Floats
from ...common.errors import DriverError
from ..hardware import READINGS_MIN, STANDING_S
from ..interface import CYCLE_S
from ..serial_port import (
    ANSWER_TIMEOUT_S,
    HICCUPS_MAX,
    RESTART_TIMEOUT_S,
    PortLink,
    lost_while,
    write_all,
)
from . import messages
from .config import BoardConfig, CountsPoint
from .messages import Frame, FrameReceiver, Identity, Message, Protocol, Telemetry, encode

RELEASE_TIME_S = 10.0  # [s] of a board left under tension, so that a slow release comes to an end


class BoardLink(PortLink):
    """
    One port with one board.

    Attributes
    ----------
    identity : Identity or None
        Of the board, None before it was identified.
    receiver : FrameReceiver
        Cuts the bytes of the board into frames; counts those that are invalid.
    missed : int
        Frames of the board that were lost, by their sequence numbers.
    sent_at : float
        `time.monotonic()` when something was last sent [s].
    clock : callable
        Clock of the time-outs [s].

    """

    clock = staticmethod(time.monotonic)

    def __init__(self, path: str, baud: int) -> None:
        """Take the path of the port and its baud rate."""
        super().__init__(path, baud)
        self.missed, self.sent_at = 0, -1e9
        self.receiver = FrameReceiver()
        self._sequence = 0
        self._expected: int | None = None
        self.identity: Identity | None = None

    @property
    def channels(self) -> int:
        """Number of channels of the board, 0 before it was identified."""
        return 0 if self.identity is None else self.identity.channels

    def _open(self) -> None:
        super()._open()
        self.receiver, self._expected = FrameReceiver(self.receiver.bad), None

    def send(self, kind: int, payload: bytes = b'') -> int:
        """Send a message; return its sequence number."""
        with self.conversation() as port:
            self._sequence = (self._sequence + 1) & 0xFF
            self.sent_at = time.monotonic()
            write_all(port.fileno(), encode(kind, self._sequence, payload))
        return self._sequence

    def receive(self, wait: float) -> list[Frame]:
        """Return the good frames that came; sleep up to `wait` [s] until something comes."""
        with self.conversation() as port:
            if not select.select([port.fileno()], [], [], max(wait, 0.0))[0]:
                return []
            if not (data := os.read(port.fileno(), io.DEFAULT_BUFFER_SIZE)):
                raise OSError('end of file')
        frames = self.receiver.feed(data)
        for frame in frames:
            if frame.type >= Message.IDENTITY:
                if self._expected is not None:
                    self.missed += (frame.sequence - self._expected) & 0xFF
                self._expected = (frame.sequence + 1) & 0xFF
        return frames

    def flush(self) -> None:
        """Discard the bytes that have arrived: they are old."""
        with self.conversation() as port:
            port.reset_input_buffer()
        self._expected = None

    def wait_for(self, kind: int, wait: float, head: bytes = b'') -> list[Frame]:
        """Return frames of a kind with a head as soon as there is one; none after `wait` [s]."""
        deadline = self.clock() + wait
        while (remaining := deadline - self.clock()) > 0.0:
            frames = [frame for frame in self.receive(remaining) if frame.type == kind]
            if frames := [frame for frame in frames if frame.payload.startswith(head)]:
                return frames
        return []

    def ask(self, kind: int, payload: bytes, attempts: int = HICCUPS_MAX + 1) -> None:
        """
        Send a message until the board acknowledges it.

        Raises
        ------
        DriverError
            The board refuses, or does not answer.

        """
        for _ in range(attempts):
            request = bytes((kind, self.send(kind, payload)))
            for frame in self.wait_for(Message.RESULT, ANSWER_TIMEOUT_S, request):
                if frame.payload == request + b'\0':
                    return
                known = dict(enumerate(messages.REFUSALS, 1))
                result = int.from_bytes(frame.payload[len(request) :])
                raise DriverError(
                    f'{self.path}: the board refused {Message(kind).name}: '
                    f'{known.get(result, "an unknown reason")}'
                )
        raise DriverError(
            f'{self.path}: no answer to {Message(kind).name}; check cable and supply'
        )

    def identify(self, config: BoardConfig) -> None:
        """
        Request the board's identity until it answers.

        Raises
        ------
        DriverError
            No answer, another version of the protocol, or too few channels.

        """
        deadline, self.identity = self.clock() + RESTART_TIMEOUT_S, None
        while self.identity is None:
            if self.clock() > deadline:
                raise DriverError(
                    f'{self.path}: no answer at {self.baud} baud for {RESTART_TIMEOUT_S:g} s; is '
                    'the firmware on the board, and is the baud rate that of pins.h?'
                )
            self.send(Message.HELLO)
            for frame in self.wait_for(Message.IDENTITY, ANSWER_TIMEOUT_S):
                self.identity = messages.read_identity(frame) or self.identity
        if self.identity.version != Protocol.VERSION:
            raise DriverError(
                f'{self.path}: protocol: expected version {Protocol.VERSION}, got '
                f'{self.identity.version}; put the firmware of this package on the board'
            )
        for wire in config.tendons:
            if wire.channel >= self.channels:
                last = self.channels - 1
                raise DriverError(f'{config.source}: {wire}: the board has channels 0 to {last}')

    def configure(self, config: BoardConfig) -> None:
        """Send the board its configuration; its motors are off, the zeros of the wires unknown."""
        for wire in config.tendons:
            values = (wire.cell.zero, wire.cell.newtons_per_count, wire.spool.metres_per_tick)
            self.ask(Message.CALIBRATION, messages.calibration(wire.channel, *values))
        self.give_limits(config, np.zeros(len(config.tendons)))
        content = messages.settings(
            config.command_timeout,
            config.release_to,
            config.period,
            config.release_rate,
            config.pretension,
            config.tension_gain,
        )
        self.ask(Message.SETTINGS, content)

    def give_limits(
        self, config: BoardConfig, zeros: Floats, pulls: tuple[float, float] | None = None
    ) -> None:
        """
        Give the board the limits; it counts wire from its own zero.

        Parameters
        ----------
        config : BoardConfig
        zeros : ndarray, shape (m,)
            [m]
        pulls : tuple of float, optional
            Lowest and highest [m] from there; those of the tendons if not given.

        """
        for wire, zero in zip(config.tendons, zeros, strict=True):
            low, high = (wire.counted * (limit + zero) for limit in pulls or wire.pull_limits)
            values = (0.0, wire.tension_limit, low, high, config.tension_rate, config.pull_rate)
            self.ask(Message.LIMITS, messages.limits(wire.channel, np.array(values)))

    def telemetry(self, wait: float) -> Telemetry | None:
        """Return the newest telemetry; waits for one up to `wait` [s]."""
        for frame in reversed(self.wait_for(Message.TELEMETRY, wait)):
            if state := messages.read_telemetry(frame, self.channels):
                return state
        return None

    def let_go(self) -> None:
        """Release tension that another process has left, then torque off."""
        state = self.telemetry(3.0 * ANSWER_TIMEOUT_S)
        if state is not None and state.enabled:
            self.ask(Message.RELEASE, bytes((messages.RELEASES.index('limp'),)))
            deadline = self.clock() + RELEASE_TIME_S
            while state is not None and state.enabled and self.clock() < deadline:
                self.send(Message.HEARTBEAT)
                state = self.telemetry(ANSWER_TIMEOUT_S)
        self.ask(Message.DISABLE, b'\xff')

    def measure_counts(self, channel: int, tension: float, seconds: float) -> CountsPoint:
        """
        Read a load cell for some seconds; the motors stay as they are.

        Parameters
        ----------
        channel : int
            The one whose cell is read.
        tension : float
            Weight of what hangs on it [N].
        seconds : float

        Raises
        ------
        DriverError
            The board does not answer, or the cell is saturated.

        """
        counts: list[float] = []
        began = time.monotonic()
        with lost_while('calibrating'):
            while (passed := time.monotonic() - began) < STANDING_S + seconds:
                self.send(Message.RAW)
                for frame in self.wait_for(Message.RAW_CELLS, ANSWER_TIMEOUT_S):
                    cells = messages.read_cells(frame, self.channels)
                    if cells is not None and passed > STANDING_S:
                        counts.append(float(cells[channel]))
                time.sleep(CYCLE_S)
        where, values = f'{self.path}: channel {channel}', np.array(counts)
        values = values[np.diff(values, prepend=np.nan) != 0.0]  # the same value, read twice
        if len(values) < READINGS_MIN:
            raise DriverError(f'{where}: no values of its load cell')
        if np.max(np.abs(values)) >= Protocol.CELL_COUNTS_MAX:
            raise DriverError(f'{where}: load cell saturated; less weight')
        spread = float(values.std(ddof=1))
        noise = 1.05 * float(np.median(np.abs(np.diff(values))))  # 1 sd, of any that hangs still
        if spread > 4.0 * noise + 5.0:
            raise DriverError(
                f'{where}: the weight does not hang still: {spread:.0f} counts '
                f'(1 sd), the noise is {noise:.0f}; begin again'
            )
        return CountsPoint(tension, float(values.mean()), spread)
