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
import serial

from ...common.errors import DriverError
from ..hardware import (
    ANSWER_TIMEOUT_S,
    PORT_ERRORS,
    READINGS_MIN,
    PortLostError,
    refuse_held,
    take_alone,
    why_not,
    write_all,
)
from ..interface import Array
from . import messages
from .config import BoardConfig, CountsPoint
from .messages import VERSION, Frame, FrameReceiver, Identity, Message, Telemetry, encode

# [s] opening the port restarts many boards, and their boot loader would wait 2 s
BOOT_TIME_S = 4.0
ATTEMPTS = 8  # [1] of a message, so that noise on the cable does not end a configuration
RELEASE_TIME_S = 10.0  # [s] of a board left under tension, so that a slow release comes to an end
SAMPLE_S = 0.0125  # [s] between two values of a load cell: HX711 datasheet, 80 values per second
# [s] in which a load cell and what pulls at it settle, so that no reading is from before
SETTLE_S = 0.2


class BoardLink:
    """
    One port with one board.

    Attributes
    ----------
    path : str
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
        self.path, self.baud = path, baud
        self.missed, self.sent_at = 0, -1e9
        self._receiver = FrameReceiver()
        self._port: serial.Serial | None = None
        self._sequence = 0
        self._expected: int | None = None

    @property
    def connected(self) -> bool:
        """Whether the port is open; a lost port counts as open until it fails."""
        return self._port is not None

    @property
    def bad(self) -> int:
        """Number of invalid frames that were discarded."""
        return self._receiver.bad

    def open(self) -> None:
        """Open the port for this process alone; raise DriverError when it cannot be."""
        self.close()
        try:
            self._open()
        except PORT_ERRORS as error:
            raise DriverError(why_not(self.path, error)) from None

    def reopen(self) -> bool:
        """Try to reopen a lost port; return whether it worked. Quick either way."""
        self.close()
        try:
            if os.path.exists(self.path):
                self._open()
        except PORT_ERRORS:
            pass
        return self.connected

    def _open(self) -> None:
        refuse_held(self.path)
        port = serial.Serial(self.path, self.baud, timeout=0, exclusive=True)
        try:
            take_alone(port.fileno())
            port.reset_input_buffer()
        except PORT_ERRORS:
            port.close()
            raise
        receiver = FrameReceiver()
        receiver.bad = self._receiver.bad
        self._port, self._receiver, self._expected = port, receiver, None

    def close(self) -> None:
        """Close the port; never raises."""
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except PORT_ERRORS:
                pass

    def send(self, kind: int, payload: bytes = b'') -> int:
        """Send a message; return its sequence number."""
        port = self._open_port()
        self._sequence = (self._sequence + 1) & 0xFF
        self.sent_at = time.monotonic()
        try:
            write_all(port.fileno(), encode(kind, self._sequence, payload))
        except PORT_ERRORS as error:
            self._lost(error)
        return self._sequence

    def receive(self, wait: float) -> list[Frame]:
        """Return the good frames that came; sleep up to `wait` [s] until something comes."""
        port = self._open_port()
        try:
            file = port.fileno()
            if not select.select([file], [], [], max(wait, 0.0))[0]:
                return []
            data = os.read(file, io.DEFAULT_BUFFER_SIZE)
        except PORT_ERRORS as error:
            self._lost(error)
        if not data:
            self._lost(OSError('end of file'))
        frames = self._receiver.feed(data)
        for frame in frames:
            if frame.type >= Message.IDENTITY:
                if self._expected is not None:
                    self.missed += (frame.sequence - self._expected) & 0xFF
                self._expected = (frame.sequence + 1) & 0xFF
        return frames

    def flush(self) -> None:
        """Discard the bytes that have arrived: they are old."""
        port = self._open_port()
        try:
            port.reset_input_buffer()
        except PORT_ERRORS as error:
            self._lost(error)
        self._expected = None

    def _open_port(self) -> serial.Serial:
        if self._port is None:
            raise PortLostError(self.path)
        return self._port

    def _lost(self, error: BaseException) -> None:
        self.close()
        raise PortLostError(f'{self.path}: {error}') from None


def identify(link: BoardLink, config: BoardConfig) -> Identity:
    """
    Request the board's identity until it answers.

    Raises
    ------
    DriverError
        No answer, another version of the protocol, or too few channels.

    """
    deadline = link.clock() + BOOT_TIME_S
    while link.clock() < deadline:
        link.send(Message.HELLO)
        for frame in wait_for(link, Message.IDENTITY, ANSWER_TIMEOUT_S):
            identity = messages.read_identity(frame)
            if identity is None:
                continue
            if identity.version != VERSION:
                raise DriverError(
                    f'{link.path}: protocol: expected version {VERSION}, got {identity.version}; '
                    'put the firmware of this package on the board'
                )
            last = identity.channels - 1
            for tendon in config.tendons:
                if tendon.channel > last:
                    raise DriverError(
                        f'{config.source}: {tendon}: the board has channels 0 to {last}'
                    )
            return identity
    raise DriverError(
        f'{link.path}: no answer at {config.baud} baud for {BOOT_TIME_S:g} s; is the firmware on '
        'the board, and is the baud rate that of pins.h?'
    )


def wait_for(link: BoardLink, kind: int, wait: float) -> list[Frame]:
    """Return the frames of a kind as soon as there is one; none after `wait` [s]."""
    deadline = link.clock() + wait
    while (remaining := deadline - link.clock()) > 0.0:
        frames = [frame for frame in link.receive(remaining) if frame.type == kind]
        if frames:
            return frames
    return []


def ask(link: BoardLink, kind: int, payload: bytes, attempts: int = ATTEMPTS) -> None:
    """
    Send a message until the board acknowledges it.

    Raises
    ------
    DriverError
        The board refuses, or does not answer.

    """
    for _ in range(attempts):
        sequence = link.send(kind, payload)
        deadline = link.clock() + ANSWER_TIMEOUT_S
        while (remaining := deadline - link.clock()) > 0.0:
            for frame in wait_for(link, Message.RESULT, remaining):
                if frame.payload[:2] == bytes((kind, sequence)) and len(frame.payload) == 3:
                    if frame.payload[2] == 0:
                        return
                    known = dict(enumerate(messages.REFUSALS, 1))
                    reason = known.get(frame.payload[2], 'an unknown reason')
                    raise DriverError(
                        f'{link.path}: the board refused {Message(kind).name}: {reason}'
                    )
    raise DriverError(f'{link.path}: no answer to {Message(kind).name}; check cable and supply')


def configure(link: BoardLink, config: BoardConfig, zeros: Array) -> None:
    """Send the board its configuration; its motors are off. `zeros`: shape (m,) [m]."""
    for tendon in config.tendons:
        cell = tendon.cell
        if cell is not None:
            values = (cell.zero, cell.newtons_per_count, tendon.metres_per_tick)
            ask(link, Message.CALIBRATION, messages.calibration(tendon.channel, *values))
    give_limits(link, config, zeros)
    content = messages.settings(
        config.timeout,
        config.release_to,
        config.period,
        config.release_rate,
        config.rest,
        config.gain,
    )
    ask(link, Message.SETTINGS, content)


def give_limits(
    link: BoardLink, config: BoardConfig, zeros: Array, pulls: tuple[float, float] | None = None
) -> None:
    """
    Give the board the limits; it counts wire from its own zero.

    Parameters
    ----------
    link : BoardLink
    config : BoardConfig
    zeros : ndarray, shape (m,)
        [m]
    pulls : tuple of float, optional
        Lowest and highest [m] from there; those of the tendons if not given.

    """
    for tendon, zero in zip(config.tendons, zeros, strict=True):
        low, high = (limit + zero for limit in pulls or tendon.pull_limits)
        values = (0.0, tendon.tension_limit, low, high, config.tension_rate, config.pull_rate)
        ask(link, Message.LIMITS, messages.limits(tendon.channel, np.array(values)))


def telemetry(link: BoardLink, channels: int, wait: float) -> Telemetry | None:
    """Return the newest telemetry; waits for one up to `wait` [s]."""
    for frame in reversed(wait_for(link, Message.TELEMETRY, wait)):
        if messages.is_telemetry(frame, channels):
            return messages.read_telemetry(frame)
    return None


def let_go(link: BoardLink, channels: int) -> None:
    """Release tension that another process has left, then torque off."""
    state = telemetry(link, channels, 0.3)
    if state is not None and state.enabled:
        ask(link, Message.RELEASE, bytes((messages.RELEASES.index('limp'),)))
        deadline = link.clock() + RELEASE_TIME_S
        while state is not None and state.enabled and link.clock() < deadline:
            link.send(Message.HEARTBEAT)
            state = telemetry(link, channels, 0.1)
    ask(link, Message.DISABLE, b'\xff')


def connect(config: BoardConfig) -> tuple[BoardLink, int]:
    """Open the port and identify the board; return the link and the number of channels."""
    link = BoardLink(config.port, config.baud)
    link.open()
    try:
        return link, identify(link, config).channels
    except (DriverError, PortLostError) as error:
        link.close()
        raise DriverError(str(error)) from None


def measure_counts(
    link: BoardLink, channels: int, channel: int, tension: float, seconds: float
) -> CountsPoint:
    """
    Read a load cell for some seconds; the motors stay as they are.

    Parameters
    ----------
    link : BoardLink
    channels : int
        Of the board.
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
    try:
        while (passed := time.monotonic() - began) < SETTLE_S + seconds:
            link.send(Message.RAW)
            for frame in wait_for(link, Message.RAW_CELLS, ANSWER_TIMEOUT_S):
                cells = messages.read_cells(frame, channels)
                if cells is not None and passed > SETTLE_S:
                    counts.append(float(cells[channel]))
            time.sleep(SAMPLE_S)
    except PortLostError as error:
        raise DriverError(f'{error}: lost while calibrating') from None
    values = np.array(counts)
    values = values[np.append(True, np.diff(values) != 0.0)]  # the same value, read twice
    if len(values) < READINGS_MIN:
        raise DriverError(f'{link.path}: channel {channel}: no values of its load cell')
    if np.max(np.abs(values)) >= messages.CELL_COUNTS_MAX:
        raise DriverError(f'{link.path}: channel {channel}: load cell saturated; less weight')
    spread = float(values.std(ddof=1))
    noise = 1.05 * float(np.median(np.abs(np.diff(values))))  # 1 sd, of any that hangs still
    if spread > 4.0 * noise + 5.0:
        raise DriverError(
            f'{link.path}: channel {channel}: the weight does not hang still: {spread:.0f} counts '
            f'(1 sd), the noise is {noise:.0f}; begin again'
        )
    return CountsPoint(tension, float(values.mean()), spread)
