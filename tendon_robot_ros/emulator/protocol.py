"""
Protocol 2.0 as the e-manual describes it: framing, stuffing, CRC, and who answers what.

References
----------
ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, https://emanual.robotis.com/docs/en/dxl/protocol2/

"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

from ..drivers.dynamixel.control_table import BAUD_RATES, REGISTERS
from .rig import Rig
from .servo import EEPROM_END, INSTRUCTION_ERROR, Servo

HEADER = b'\xff\xff\xfd\x00'
BROADCAST = 0xFE
STATUS = 0x55
PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
FACTORY_RESET, REBOOT, CLEAR = 0x06, 0x08, 0x10
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE = 0x92, 0x93
PACKET_BYTES_MAX = 1024  # bytes of one packet


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


class InstructionReceiver:
    """Cuts a stream of bytes into instructions; what is broken is dropped, as a servo does."""

    def __init__(self) -> None:
        """Start with nothing received."""
        self._buffer = b''
        self.broken = 0  # packets with a wrong CRC or length

    def feed(self, data: bytes) -> list[Instruction]:
        """Take bytes; return the instructions that are complete now."""
        self._buffer += data
        instructions: list[Instruction] = []
        while True:
            start = self._buffer.find(HEADER)
            if start < 0:
                self._buffer = self._buffer[-3:]
                return instructions
            self._buffer = self._buffer[start:]
            if len(self._buffer) < 7:
                return instructions
            size = int.from_bytes(self._buffer[5:7], 'little') + 7
            if not 10 <= size <= PACKET_BYTES_MAX:
                self.broken += 1
                self._buffer = self._buffer[4:]
                continue
            if len(self._buffer) < size:
                return instructions
            whole, rest = self._buffer[:size], self._buffer[size:]
            if crc(whole[:-2]) != int.from_bytes(whole[-2:], 'little'):
                self.broken += 1
                self._buffer = self._buffer[4:]
                continue
            self._buffer = rest
            body = unstuff(whole[7:-2])
            instructions.append(Instruction(whole[4], body[0], body[1:]))


# -----------------------------------------------------------------------------
# What the servos of a bus do with an instruction, and what they answer together.

SECONDARY_OFF = 253  # a secondary id from here on is none
BOOT_TIME_S = 0.3  # [s] in which a rebooting servo is silent
LEVELS = {PING: 0, READ: 1, SYNC_READ: 1, FAST_SYNC_READ: 1}
WATCHED = {
    REGISTERS[name].address: name
    for name in ('torque_enable', 'goal_current', 'goal_position', 'bus_watchdog')
}


class Responder:
    """
    The servos of a rig as they hear and answer.

    Attributes
    ----------
    silent : set of int
        Ids that neither hear nor answer.
    log : deque of (time, id, register, value)
        What the servos accepted for torque, goals and watchdog, `time.monotonic` [s].
    extremes : dict of (id, register) to (lowest, highest)
        What was written to them, accepted or not.

    """

    def __init__(self, rig: Rig) -> None:
        """Take the servos."""
        self.rig = rig
        self.silent: set[int] = set()
        self.log: deque[tuple[float, int, str, int]] = deque(maxlen=200_000)
        self.extremes: dict[tuple[int, str], tuple[int, int]] = {}
        self._booting: dict[int, float] = {}

    def carry_out(self, instruction: Instruction, baud: int | None) -> bytes:
        """Let the servos at a baud rate do what an instruction says; return their answers."""
        servos = self._listening(baud)
        for servo in servos.values():
            servo.heard()
        code, parameters = instruction.code, instruction.parameters
        if code == SYNC_WRITE:
            self._sync_write(servos, parameters)
            return b''
        if code in (SYNC_READ, FAST_SYNC_READ):
            speaking = {i: servo for i, servo in servos.items() if _answers(servo, code)}
            return _sync_read(speaking, parameters, code == FAST_SYNC_READ)
        if code == WRITE and len(parameters) > 2:
            address, data = int.from_bytes(parameters[:2], 'little'), parameters[2:]
            self._shadowed(servos, instruction.identity, address, data)
        everyone = instruction.identity == BROADCAST
        wanted = sorted(servos) if everyone else [instruction.identity]
        answers = [self._single(servos[i], code, parameters) for i in wanted if i in servos]
        return b'' if everyone and code != PING else b''.join(answers)

    def _listening(self, baud: int | None) -> dict[int, Servo]:
        """Servos that hear and answer: with power, at this baud rate, not silenced."""
        now = time.monotonic()
        return {
            identity: servo
            for identity, servo in self.rig.servos.items()
            if identity not in self.silent
            and now >= self._booting.get(identity, 0.0)
            and baud in (None, BAUD_RATES.get(servo.get('baud_rate')))
        }

    def _single(self, servo: Servo, code: int, parameters: bytes) -> bytes:
        error, data = INSTRUCTION_ERROR | servo.alert, b''
        if code == PING:
            number = servo.model.number.to_bytes(2, 'little')
            error, data = servo.alert, number + bytes([servo.firmware])
        elif code == READ and len(parameters) == 4:
            error, data = servo.read(*_address_and_length(parameters))
        elif code == WRITE and len(parameters) > 2:
            error = self._write(servo, int.from_bytes(parameters[:2], 'little'), parameters[2:])
        elif code == REBOOT:
            self.rig.rebooted(servo.identity)
            self._booting[servo.identity] = time.monotonic() + BOOT_TIME_S
            error = 0
        return status(servo.identity, error, data) if _answers(servo, code) else b''

    def _sync_write(self, servos: dict[int, Servo], parameters: bytes) -> None:
        address, length = _address_and_length(parameters)
        for start in range(4, len(parameters) - length, length + 1):
            data = parameters[start + 1 : start + 1 + length]
            self._shadowed(servos, parameters[start], address, data)
            servo = servos.get(parameters[start])
            if servo is not None:
                self._write(servo, address, data)

    def _shadowed(
        self, servos: dict[int, Servo], identity: int, address: int, data: bytes
    ) -> None:
        """Let servos whose secondary id is meant obey, without an answer; not in their flash."""
        for servo in servos.values():
            shadows = servo.get('secondary_id') == identity != servo.identity
            if shadows and identity < SECONDARY_OFF and address >= EEPROM_END:
                self._write(servo, address, data)

    def _write(self, servo: Servo, address: int, data: bytes) -> int:
        error = servo.write(address, data)
        name = WATCHED.get(address)
        if name is not None and len(data) == REGISTERS[name].size:
            value = int.from_bytes(data, 'little', signed=REGISTERS[name].signed)
            key = (servo.identity, name)
            low, high = self.extremes.get(key, (value, value))
            self.extremes[key] = (min(low, value), max(high, value))
            if not error & 0x7F:
                self.log.append((time.monotonic(), servo.identity, name, value))
        return error


def _answers(servo: Servo, code: int) -> bool:
    """Tell by its status return level (68) whether a servo answers: 0 pings, 1 reads, 2 all."""
    return servo.get('status_return_level') >= LEVELS.get(code, 2)


def _address_and_length(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], 'little'), int.from_bytes(parameters[2:4], 'little')


def _sync_read(servos: dict[int, Servo], parameters: bytes, fast: bool) -> bytes:
    """Answer in the order asked; in a fast read nobody speaks behind a silent servo."""
    address, length = _address_and_length(parameters)
    wanted = list(parameters[4:])
    parts = []
    for identity in wanted:
        if identity in servos:
            parts.append((identity, *servos[identity].read(address, length)))
        elif fast:
            break
    if not fast:
        return b''.join(status(*part) for part in parts)
    old = [i for i, _, _ in parts if servos[i].firmware < servos[i].model.fast_read_firmware]
    if old or not parts:
        return b''
    whole = fast_status(parts + [(i, 0, bytes(length)) for i in wanted[len(parts) :]])
    return whole[: 8 + sum(len(data) + 4 for _, _, data in parts)]
