"""
Frames and messages of the serial protocol (docs/serial_protocol.md).

A frame is byte stuffed, has a CRC over the stuffed bytes, and a zero at its end.

The CRC is over the stuffed bytes, so that it protects the bytes on the wire: as they are at most
32751 bits long, any one, two or three flipped bits are detected.
"""

from __future__ import annotations

import binascii
import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Floats
from ...common.words import UNIT_PREFIXES
from ..interface import MODES, FaultBit

MICRO = UNIT_PREFIXES['µ']  # [N], [m] of one count: docs/serial_protocol.md


class Protocol(IntEnum):
    """Numbers of docs/serial_protocol.md."""

    VERSION = 1
    CRC_BYTES = 3  # six bits in each
    CHANNELS_MAX = 8  # a byte has a bit for each
    CELL_COUNTS_MAX = 2**23 - 1  # of 24 bits, where a cell is overloaded: HX711 datasheet


_HEADER = struct.Struct('BBBB')  # version, type, sequence, length of the payload
_TELEMETRY = struct.Struct('<IBBBBH')
_CHANNEL = np.dtype([('tension', '<i4'), ('pull', '<i4'), ('current', '<i2'), ('faults', '<u2')])
_IDENTITY = struct.Struct('<BBHI')
# [bytes] between two delimiters: the longest telemetry, stuffed: docs/serial_protocol.md
FRAME_BYTES_MAX = 1 + sum(
    (_HEADER.size, _TELEMETRY.size, Protocol.CHANNELS_MAX * _CHANNEL.itemsize, Protocol.CRC_BYTES)
)


class Message(IntEnum):
    """Types of messages; those of the board have the highest bit set."""

    HELLO = 0x01
    COMMAND = 0x02
    ENABLE = 0x03
    DISABLE = 0x04
    RELEASE = 0x05
    LIMITS = 0x06
    CALIBRATION = 0x07
    SETTINGS = 0x08
    CLEAR = 0x09
    RAW = 0x0A
    HEARTBEAT = 0x0B
    IDENTITY = 0x81
    TELEMETRY = 0x82
    RAW_CELLS = 0x83
    RESULT = 0x84


# by the number that the board answers with, from 1 on
REFUSALS = (
    'wrong length',
    'a value it does not allow',
    'limits, calibration or settings are missing',
    'a fault is latched',
    'it does not know this message',
)
RELEASES = ('pretension', 'limp')  # by their number


class BoardFlag(IntFlag):
    """Flags of the telemetry."""

    CONFIGURED = 0x01
    SILENCE = 0x02
    RELEASED = 0x04


class ChannelFault(FaultBit):
    """Faults of a channel; all are latched by the board, that motor is then off."""

    OVERLOAD = 0x01, 'tension far above its limit'
    OVERHEATING = 0x02, 'motor bridge too hot'
    LOAD_CELL = 0x04, 'load cell saturated or not answering; check its cable'
    ENCODER = 0x08, 'driven hard and the encoder does not move; motor blocked, or its cable'
    VOLTAGE = 0x10, 'motor supply too low'


class Frame(NamedTuple):
    """Content of a valid frame."""

    version: int
    type: int
    sequence: int
    payload: bytes


def crc16(data: bytes) -> int:
    """
    Return the CRC-16/CCITT-FALSE of some bytes; that of b'123456789' is 0x29B1.

    References
    ----------
    "CRC-16/IBM-3740" in G. Cook, Catalogue of parametrised CRC algorithms.

    """
    return binascii.crc_hqx(data, 0xFFFF)


def _crc_bytes(data: bytes) -> bytes:
    """Return the CRC, six bits per byte, the highest bit set: never a delimiter."""
    crc = crc16(data)
    return bytes((0x80 | crc >> 12, 0x80 | crc >> 6 & 0x3F, 0x80 | crc & 0x3F))


def stuff(data: bytes) -> bytes:
    """Take the zeros out of at most 253 bytes (consistent overhead byte stuffing)."""
    return b''.join(bytes((len(part) + 1,)) + part for part in data.split(b'\0'))


def unstuff(data: bytes) -> bytes | None:
    """Put the zeros back; None when the bytes cannot have come from `stuff`."""
    plain = bytearray(data)
    place, end = 0, len(data)
    while place < end:
        step = plain[place]
        if step == 0:
            return None
        plain[place] = 0
        place += step
    return bytes(plain[1:]) if place == end else None


def encode(kind: int, sequence: int, payload: bytes = b'') -> bytes:
    """Return the bytes of a frame, delimiters before and after it."""
    header = _HEADER.pack(Protocol.VERSION, kind, sequence & 0xFF, len(payload))
    body = stuff(header + payload)
    return b'\0' + body + _crc_bytes(body) + b'\0'


def decode(data: bytes) -> Frame | None:
    """Read what stood between two delimiters; None when anything about it is wrong."""
    if not _HEADER.size + 1 + Protocol.CRC_BYTES <= len(data) <= FRAME_BYTES_MAX:
        return None
    stuffed, check = data[: -Protocol.CRC_BYTES], data[-Protocol.CRC_BYTES :]
    if check != _crc_bytes(stuffed):
        return None
    body = unstuff(stuffed)
    if body is None or body[3] != len(body) - _HEADER.size:
        return None
    return Frame(body[0], body[1], body[2], body[_HEADER.size :])


class FrameReceiver:
    """
    Cuts a stream into frames.

    Attributes
    ----------
    bad : int
        Frames thrown away because something about them was wrong.

    """

    def __init__(self, bad: int = 0) -> None:
        """Begin between two frames."""
        self.bad, self._rest = bad, b''

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes as they come; return the good frames that they complete."""
        *whole, self._rest = (self._rest + data).split(b'\0')
        # noise without delimiters: keep only that it is too long
        if len(self._rest) > FRAME_BYTES_MAX:
            self._rest = self._rest[: FRAME_BYTES_MAX + 1]
        frames = []
        for piece in filter(None, whole):
            if frame := decode(piece):
                frames.append(frame)
            else:
                self.bad += 1
        return frames


class Identity(NamedTuple):
    """Who answers: protocol version, number of channels, firmware version."""

    version: int
    channels: int
    firmware: int


class Telemetry(NamedTuple):
    """
    What the board measured at one moment.

    Parameters
    ----------
    time : int
        Clock of the board [µs], begins again after 71 minutes.
    flags, enabled, mode : int
        Flags of the board, bit mask of the motors that are on, 0 tension or 1 pull.
    sequence : int
        Of the last command that was applied.
    bad : int
        Frames that the board threw away.
    tensions, pulls : ndarray, shape (n,) [N], [m]
        Per channel.
    currents : ndarray, shape (n,) [A]
    faults : ndarray of int, shape (n,)
        Bits of `ChannelFault`.

    """

    time: int
    flags: int
    enabled: int
    mode: int
    sequence: int
    bad: int
    tensions: Floats
    pulls: Floats
    currents: Floats
    faults: NDArray[np.uint16]


def read_telemetry(frame: Frame, channels: int) -> Telemetry | None:
    """Read telemetry of a board with so many channels; None when it is something else."""
    known = frame.type == Message.TELEMETRY and frame.version == Protocol.VERSION
    if not known or len(frame.payload) != _TELEMETRY.size + channels * _CHANNEL.itemsize:
        return None
    values = np.frombuffer(frame.payload, _CHANNEL, offset=_TELEMETRY.size)
    header: tuple[int, int, int, int, int, int] = _TELEMETRY.unpack_from(frame.payload)
    return Telemetry(
        *header,
        MICRO * values['tension'],
        MICRO * values['pull'],
        1e-3 * values['current'],
        values['faults'],
    )


def read_identity(frame: Frame) -> Identity | None:
    """Read who answers, of any version; None when it is something else."""
    if frame.type != Message.IDENTITY or len(frame.payload) != _IDENTITY.size:
        return None
    return Identity(*_IDENTITY.unpack(frame.payload)[:3])


def read_cells(frame: Frame, channels: int) -> NDArray[np.int32] | None:
    """Read the counts of the load cells, shape (n,); None when it is something else."""
    if frame.type != Message.RAW_CELLS or len(frame.payload) != 4 + 4 * channels:
        return None
    return np.frombuffer(frame.payload, '<i4', offset=4)


def command(mode: str, values: Floats) -> bytes:
    """Return the payload of a command: shape (n,) [N] or [m]."""
    return bytes((MODES.index(mode),)) + micro(values)


def micro(values: Floats) -> bytes:
    """Return values in millionths as 32-bit integers; beyond their range the nearest."""
    whole = np.clip(np.rint(np.asarray(values) / MICRO), -(2**31) + 1, 2**31 - 1)
    return whole.astype('<i4').tobytes()


def limits(channel: int, values: Floats) -> bytes:
    """Return the payload of limits: tension [N], pull [m], low and high; rates [N/s], [m/s]."""
    return bytes((channel,)) + micro(values)


def calibration(
    channel: int, zero: float, newtons_per_count: float, metres_per_tick: float
) -> bytes:
    """Return the payload of a calibration: counts, 1e-12 N per count, 1e-9 m per tick."""
    whole = (round(zero), round(newtons_per_count * 1e12), round(metres_per_tick * 1e9))
    return struct.pack('<Biii', channel, *whole)


def settings(
    timeout: float, release_to: str, period: float, release_rate: float, rest: float, gain: float
) -> bytes:
    """Return the payload of settings: [s], word, [s], [N/s], [N], [m/(N·s)]."""
    return struct.pack(
        '<HBHiii',
        round(1e3 * timeout),
        RELEASES.index(release_to),
        round(1e6 * period),
        round(release_rate / MICRO),
        round(rest / MICRO),
        round(gain * 1e9),
    )
