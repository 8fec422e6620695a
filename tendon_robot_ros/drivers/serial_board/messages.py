"""The messages of the serial protocol: types, layouts, scales (docs/serial_protocol.md)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .frames import VERSION, Frame

HELLO, COMMAND, ENABLE, DISABLE, RELEASE, LIMITS = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
CALIBRATION, SETTINGS, CLEAR, RAW, HEARTBEAT = 0x07, 0x08, 0x09, 0x0A, 0x0B
IDENTITY, TELEMETRY, RAW_CELLS, RESULT = 0x81, 0x82, 0x83, 0x84
NAMES = {
    ENABLE: 'ENABLE',
    DISABLE: 'DISABLE',
    RELEASE: 'RELEASE',
    LIMITS: 'LIMITS',
    CALIBRATION: 'CALIBRATION',
    SETTINGS: 'SETTINGS',
    CLEAR: 'CLEAR',
}
REFUSALS = {
    1: 'wrong length',
    2: 'a value it does not allow',
    3: 'limits, calibration or settings are missing',
    4: 'a fault is latched',
    5: 'it does not know this message',
}
MODES = {'tension': 0, 'pull': 1}
RELEASES = {'pretension': 0, 'limp': 1}
CONFIGURED, SILENCE, RELEASED = 0x01, 0x02, 0x04  # flags

# bit -> code, what a person reads; all are latched by the board, that motor is then off
CHANNEL_FAULTS = {
    0x01: ('overload', 'tension far above its limit'),
    0x02: ('overheating', 'motor bridge too hot'),
    0x04: ('load_cell', 'load cell saturated or not answering; check its cable'),
    0x08: ('encoder', 'driven hard and the encoder does not move; motor blocked, or its cable'),
    0x10: ('voltage', 'motor supply too low'),
}
CELL, ENCODER = 0x04, 0x08

MICRO = 1e-6
_HEADER = struct.Struct('<IBBBBH')
_CHANNEL = np.dtype([('tension', '<i4'), ('pull', '<i4'), ('current', '<i2'), ('faults', '<u2')])
_IDENTITY = struct.Struct('<BBHI')


@dataclass(frozen=True)
class Identity:
    """Who answers: protocol version, number of channels, firmware version."""

    version: int
    channels: int
    firmware: int


@dataclass(frozen=True)
class Telemetry:
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
        Bits of `CHANNEL_FAULTS`.

    """

    time: int
    flags: int
    enabled: int
    mode: int
    sequence: int
    bad: int
    tensions: NDArray[np.float64]
    pulls: NDArray[np.float64]
    currents: NDArray[np.float64]
    faults: NDArray[np.uint16]


def is_telemetry(frame: Frame, channels: int) -> bool:
    """Whether a frame is telemetry of a board with so many channels."""
    size = _HEADER.size + channels * _CHANNEL.itemsize
    return frame.type == TELEMETRY and frame.version == VERSION and len(frame.payload) == size


def read_telemetry(frame: Frame) -> Telemetry:
    """Read telemetry; the frame is one that `is_telemetry`."""
    values = np.frombuffer(frame.payload, _CHANNEL, offset=_HEADER.size)
    header: tuple[int, int, int, int, int, int] = _HEADER.unpack_from(frame.payload)
    return Telemetry(
        *header,
        MICRO * values['tension'],
        MICRO * values['pull'],
        1e-3 * values['current'],
        values['faults'],
    )


def read_identity(frame: Frame) -> Identity | None:
    """Read who answers, of any version; None when it is something else."""
    if frame.type != IDENTITY or len(frame.payload) != _IDENTITY.size:
        return None
    return Identity(*_IDENTITY.unpack(frame.payload)[:3])


def read_cells(frame: Frame, channels: int) -> NDArray[np.int32] | None:
    """Read the counts of the load cells, shape (n,); None when it is something else."""
    if frame.type != RAW_CELLS or len(frame.payload) != 4 + 4 * channels:
        return None
    return np.frombuffer(frame.payload, '<i4', offset=4)


def command(mode: str, values: NDArray[np.float64]) -> bytes:
    """Return the payload of a command: shape (n,) [N] or [m]."""
    return bytes((MODES[mode],)) + micro(values)


def micro(values: NDArray[np.float64]) -> bytes:
    """Return values in millionths as 32-bit integers; beyond their range the nearest."""
    whole = np.clip(np.rint(np.asarray(values) / MICRO), -(2**31) + 1, 2**31 - 1)
    return whole.astype('<i4').tobytes()


def limits(channel: int, values: NDArray[np.float64]) -> bytes:
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
        RELEASES[release_to],
        round(1e6 * period),
        round(release_rate / MICRO),
        round(rest / MICRO),
        round(gain * 1e9),
    )
