"""
Bytes of Protocol 2.0 as the e-manual describes them: framing, byte stuffing, CRC.

References
----------
ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, https://emanual.robotis.com/docs/en/dxl/protocol2/

"""

from __future__ import annotations

from dataclasses import dataclass

HEADER = b'\xff\xff\xfd\x00'
BROADCAST = 0xFE
STATUS = 0x55
PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
FACTORY_RESET, REBOOT, CLEAR = 0x06, 0x08, 0x10
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
LONGEST = 1024  # bytes of one packet


def _table() -> tuple[int, ...]:
    """Compute the CRC of every byte: polynomial 0x8005, no reflection."""
    values = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        values.append(value & 0xFFFF)
    return tuple(values)


_CRC = _table()


def crc(data: bytes, start: int = 0) -> int:
    """Compute the CRC-16 of the bytes, continuing from `start`."""
    value = start
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _CRC[value >> 8 ^ byte]
    return value


def with_crc(data: bytes) -> bytes:
    """Append the CRC, low byte first."""
    return data + crc(data).to_bytes(2, 'little')


def stuff(body: bytes) -> bytes:
    """Put 0xFD behind every FF FF FD, so that no body looks like a header."""
    return body.replace(b'\xff\xff\xfd', b'\xff\xff\xfd\xfd')


def unstuff(body: bytes) -> bytes:
    """Take the stuffing out again."""
    return body.replace(b'\xff\xff\xfd\xfd', b'\xff\xff\xfd')


def packet(identity: int, body: bytes) -> bytes:
    """Frame a body (instruction and parameters): header, id, length, stuffed body, CRC."""
    inner = stuff(body)
    length = (len(inner) + 2).to_bytes(2, 'little')
    return with_crc(HEADER + bytes([identity]) + length + inner)


def status(identity: int, error: int, data: bytes = b'') -> bytes:
    """Frame a status packet."""
    return packet(identity, bytes([STATUS, error]) + data)


def fast_status(parts: list[tuple[int, int, bytes]]) -> bytes:
    """
    Join the answers of several servos into the one status packet of a fast read.

    Parameters
    ----------
    parts : list of (id, error, data)
        In the order asked for. No byte stuffing, and a CRC behind every part that covers
        everything before it.

    """
    length = sum(len(data) + 4 for _, _, data in parts) + 1
    out = HEADER + bytes([BROADCAST]) + length.to_bytes(2, 'little') + bytes([STATUS])
    for identity, error, data in parts:
        out = with_crc(out + bytes([error, identity]) + data)
    return out


@dataclass(frozen=True)
class Instruction:
    """An instruction packet whose CRC is right."""

    identity: int
    code: int
    parameters: bytes


class Receiver:
    """Cuts a stream of bytes into instructions; what is broken is dropped, as a servo does."""

    def __init__(self) -> None:
        """Start with nothing received."""
        self._buffer = b''
        self.broken = 0  # packets with a wrong CRC or length

    def feed(self, data: bytes) -> list[Instruction]:
        """Take bytes; return the instructions that are complete now."""
        self._buffer += data
        found: list[Instruction] = []
        while True:
            start = self._buffer.find(HEADER)
            if start < 0:
                self._buffer = self._buffer[-3:]
                return found
            self._buffer = self._buffer[start:]
            if len(self._buffer) < 7:
                return found
            size = int.from_bytes(self._buffer[5:7], 'little') + 7
            if not 10 <= size <= LONGEST:
                self.broken += 1
                self._buffer = self._buffer[4:]
                continue
            if len(self._buffer) < size:
                return found
            whole, rest = self._buffer[:size], self._buffer[size:]
            if crc(whole[:-2]) != int.from_bytes(whole[-2:], 'little'):
                self.broken += 1
                self._buffer = self._buffer[4:]
                continue
            self._buffer = rest
            body = unstuff(whole[7:-2])
            found.append(Instruction(whole[4], body[0], body[1:]))
