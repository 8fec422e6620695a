"""
Frames of the serial protocol: byte stuffing, a CRC over the stuffed bytes, a zero at the end.

The CRC stands outside the stuffing, so that it protects the very bytes on the wire: as they are
at most 32751 bits long, any one, two or three flipped bits are noticed.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass

VERSION = 1
HEADER = 4  # version, type, sequence, length of the payload
CRC_BYTES = 3
LONGEST = HEADER + 106 + 1 + CRC_BYTES  # bytes between two delimiters, eight channels


@dataclass(frozen=True)
class Frame:
    """What a good frame carries."""

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


def encode(kind: int, sequence: int, payload: bytes = b'', version: int = VERSION) -> bytes:
    """Return the bytes of a frame, delimiters before and after it."""
    body = stuff(bytes((version, kind, sequence & 0xFF, len(payload))) + payload)
    return b'\0' + body + _crc_bytes(body) + b'\0'


def decode(data: bytes) -> Frame | None:
    """Read what stood between two delimiters; None when anything about it is wrong."""
    if not HEADER + 1 + CRC_BYTES <= len(data) <= LONGEST:
        return None
    stuffed = data[:-CRC_BYTES]
    if data[-CRC_BYTES:] != _crc_bytes(stuffed):
        return None
    body = unstuff(stuffed)
    if body is None or body[3] != len(body) - HEADER:
        return None
    return Frame(body[0], body[1], body[2], body[HEADER:])


class Receiver:
    """
    Cuts a stream into frames.

    Attributes
    ----------
    bad : int
        Frames thrown away because something about them was wrong.

    """

    def __init__(self) -> None:
        """Begin between two frames."""
        self.bad = 0
        self._rest = b''

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes as they come; return the good frames that they complete."""
        *whole, self._rest = (self._rest + data).split(b'\0')
        if len(self._rest) > LONGEST:  # noise without delimiters: keep only that it is too long
            self._rest = self._rest[: LONGEST + 1]
        frames = []
        for piece in whole:
            if not piece:
                continue
            frame = decode(piece)
            if frame is None:
                self.bad += 1
            else:
                frames.append(frame)
        return frames
