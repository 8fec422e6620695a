"""
The emulated bus: bytes of Protocol 2.0, the servos that answer them, their port and commands.

Framing, stuffing, CRC and answers are written from the e-manual and share no code with the SDK
that the driver uses, so that no error can hide by being made on both sides.

References
----------
ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, https://emanual.robotis.com/docs/en/dxl/protocol2/

"""

from __future__ import annotations

import functools
import json
import termios
import time
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from ..drivers.dynamixel.control_table import BAUD_RATES, REGISTERS, Counts, HardwareError
from .port import COMMON_HELP, Command, Plug
from .rig import HangingWeights, Rig
from .servo import Servo, StatusError


class InstructionCode(IntEnum):
    """What a packet says: manual, "Instruction"."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A


HEADER = b'\xff\xff\xfd\x00'
BROADCAST = 0xFE  # [1] the id of all servos: manual, "Packet ID"
PACKET_BYTES_MAX = 1024  # [bytes] else a broken length would swallow all that follows
PACKET_GAP_S = 0.02  # [s] of silence that ends a broken packet, else it would wait for its end
BOOT_TIME_S = 0.3  # [s] of silence after a reboot, so that a driver has to wait for it
LOG_MAX = 200_000  # [entries] so that minutes of goals at 100 Hz are kept
READS = InstructionCode.READ, InstructionCode.SYNC_READ, InstructionCode.FAST_SYNC_READ
LOGGED = {
    REGISTERS[name].address: name
    for name in ('torque_enable', 'goal_current', 'goal_position', 'bus_watchdog')
}


@functools.cache
def crc_of_byte(byte: int) -> int:
    """Return the CRC of one byte: CRC-16 (IBM/ANSI), polynomial 0x8005, not reflected."""
    value = byte << 8
    for _ in range(8):
        value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
    return value & 0xFFFF


def crc(data: bytes) -> int:
    """Compute the CRC-16 of the bytes."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ crc_of_byte(value >> 8 ^ byte)
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
    return packet(identity, bytes([InstructionCode.STATUS, error]) + data)


def fast_status(parts: list[tuple[int, int, bytes]]) -> bytes:
    """
    Join the answers of several servos into the one status packet of a fast read.

    Parameters
    ----------
    parts : list of (id, error, data)
        In the order of the request. No byte stuffing, and a CRC behind every part that covers
        everything before it.

    """
    length = sum(len(data) + 4 for _, _, data in parts) + 1
    out = HEADER + bytes([BROADCAST]) + length.to_bytes(2, 'little')
    out += bytes([InstructionCode.STATUS])
    for identity, error, data in parts:
        out = with_crc(out + bytes([error, identity]) + data)
    return out


class Instruction(NamedTuple):
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
        while (start := self._buffer.find(HEADER)) >= 0:
            self._buffer = self._buffer[start:]
            if len(self._buffer) < 7:
                return instructions
            size = int.from_bytes(self._buffer[5:7], 'little') + 7
            possible = 10 <= size <= PACKET_BYTES_MAX
            if possible and len(self._buffer) < size:
                return instructions
            whole = self._buffer[:size]
            if possible and crc(whole[:-2]) == int.from_bytes(whole[-2:], 'little'):
                body = unstuff(whole[7:-2])
                instructions.append(Instruction(whole[4], body[0], body[1:]))
                self._buffer = self._buffer[size:]
            else:
                self.broken += 1
                self._buffer = self._buffer[4:]
        self._buffer = self._buffer[-3:]
        return instructions


def _answers(servo: Servo, code: int) -> bool:
    """Return by its status return level (68) whether a servo answers: 0 pings, 1 reads, 2 all."""
    level = servo.get('status_return_level')
    return code == InstructionCode.PING or level >= (1 if code in READS else 2)


def _address_and_length(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], 'little'), int.from_bytes(parameters[2:4], 'little')


def sync_read(servos: dict[int, Servo], parameters: bytes, fast: bool) -> bytes:
    """Answer in the order of the ids; in a fast read nobody answers behind a silent servo."""
    address, length = _address_and_length(parameters)
    identities = list(parameters[4:])
    parts = []
    for identity in identities:
        if identity in servos:
            parts.append((identity, *servos[identity].read(address, length)))
        elif fast:
            break
    if not fast:
        return b''.join(status(*part) for part in parts)
    old = [i for i, _, _ in parts if servos[i].firmware < servos[i].model.fast_read_firmware]
    if old or not parts:
        return b''
    whole = fast_status(parts + [(i, 0, bytes(length)) for i in identities[len(parts) :]])
    return whole[: 8 + sum(len(data) + 4 for _, _, data in parts)]


HELP = f"""\
silent ID...          these servos neither hear nor answer; hear ID...: they do again
{COMMON_HELP}
overload ID, overheating ID, encoder ID, shock ID   a hardware error, until a reboot
hot ID CELSIUS        temperature of a motor
volts VOLTS           supply of all motors
restart ID...         the motor loses its power for a moment
trip ID...            its bus watchdog trips
weight ID KG          hang a weight on it (only with --weights)
state                 print what the servos and wires do, as JSON
log SECONDS           print what they accepted lately, as JSON: [time, id, register, value]
trace SECONDS         print what they did lately, as JSON: [time, [A], [N of wires], [m wound]]
quit"""


class EmulatedBus(Plug):
    """
    An emulated port with servos; `port` is the path to open.

    Attributes
    ----------
    rig : Rig
    silent : set of int
        Ids that neither hear nor answer.
    accepted : deque of (time, id, register, value)
        What the servos accepted for torque, goals and watchdog, `time.monotonic` [s].
    extremes : dict of (id, register) to (lowest, highest)
        What was written to them, accepted or not.
    booting : dict of int to float
        Until when a servo that restarts is silent, `time.monotonic` [s].

    """

    help = HELP
    rig: Rig

    def __init__(self, rig: Rig, port: str | None = None) -> None:
        """Plug it in, at a path of its own if none is given."""
        self.rig = rig
        self.silent: set[int] = set()
        self.accepted: deque[tuple[float, int, str, int]] = deque(maxlen=LOG_MAX)
        self.extremes: dict[tuple[int, str], tuple[int, int]] = {}
        self.booting: dict[int, float] = {}
        self._received_at = time.monotonic()
        self._receiver = InstructionReceiver()
        super().__init__('dynamixel', port)

    def commands(self) -> dict[str, Command]:
        """Return its commands by their first word."""

        def of_each(act: Callable[[Servo], object]) -> Command:
            """Return a command that acts on the servos whose ids follow it."""

            def carry_out(identities: list[str]) -> None:
                for identity in identities:
                    act(self.servo(int(identity)))

            return carry_out

        return {
            **super().commands(),
            **{
                str(error.name).lower(): of_each(functools.partial(Servo.fail, bits=error))
                for error in HardwareError
            },
            'silent': of_each(lambda servo: self.silent.add(servo.identity)),
            'hear': of_each(lambda servo: self.silent.discard(servo.identity)),
            'hot': lambda values: setattr(
                self.servo(int(values[0])), 'temperature', float(values[1])
            ),
            'volts': self.supply,
            'restart': of_each(lambda servo: self.restart(servo.identity)),
            'trip': of_each(lambda servo: servo.put('bus_watchdog', Counts.WATCHDOG_TRIPPED)),
            'weight': self.hang,
            'log': self.log,
            'trace': self.trace,
        }

    def servo(self, identity: int) -> Servo:
        """Return the servo with an id."""
        return self.rig.servos[identity]

    def restart(self, identity: int) -> None:
        """Let a servo lose its power for a moment."""
        with self._lock:
            self.rig.rebooted(identity)

    def supply(self, values: list[str]) -> None:
        """Set the supply of all motors [V]."""
        for servo in self.rig.servos.values():
            servo.voltage = float(values[0])

    def hang(self, values: list[str]) -> None:
        """Hang a weight [kg] on the wire of a servo, by its id."""
        arm = self.rig.arm
        if not isinstance(arm, HangingWeights):
            raise ValueError('start the emulator with --weights')
        arm.hang(list(self.rig.servos).index(int(values[0])), float(values[1]))

    def log(self, values: list[str]) -> str:
        """Return as JSON what the servos accepted in the last seconds."""
        begin = time.monotonic() - float(values[0])
        return json.dumps([entry for entry in self.accepted.copy() if entry[0] >= begin])

    def trace(self, values: list[str]) -> str:
        """Return as JSON what motors and wires did in the last seconds."""
        begin = time.monotonic() - float(values[0])
        recent = [entry for entry in self.rig.trace.copy() if entry[0] >= begin]
        return json.dumps([[t, *(np.round(v, 6).tolist() for v in rest)] for t, *rest in recent])

    def state(self) -> dict[str, object]:
        """Return the state of servos and wires as plain values."""
        wires = ('tensions', 'wound', 'highest', 'held', 'least', 'most')
        return {
            **super().state(),
            **{name: np.round(getattr(self.rig, name), 6).tolist() for name in wires},
            'servos': {
                i: {name: servo.get(name) for name in REGISTERS}
                for i, servo in self.rig.servos.items()
            },
            'extremes': {
                f'{i} {name}': list(values) for (i, name), values in self.extremes.items()
            },
        }

    def receive(self, data: bytes) -> None:
        """Carry out the instructions that the bytes complete."""
        now = time.monotonic()
        if now - self._received_at > PACKET_GAP_S:
            self.connected()
        self._received_at = now
        for instruction in self._receiver.feed(data):
            self._send(self.carry_out(instruction, self.baud_rate()))

    def carry_out(self, instruction: Instruction, baud: int | None) -> bytes:
        """Let the servos at a baud rate do what an instruction says; return their answers."""
        now = time.monotonic()
        servos = {
            identity: servo
            for identity, servo in self.rig.servos.items()
            if identity not in self.silent
            and now >= self.booting.get(identity, 0.0)
            and baud in (None, BAUD_RATES.get(servo.get('baud_rate')))
        }
        for servo in servos.values():
            servo.silence = 0.0  # every instruction on the bus feeds the watchdogs
        code, parameters = instruction.code, instruction.parameters
        if code == InstructionCode.SYNC_WRITE:
            address, length = _address_and_length(parameters)
            for start in range(4, len(parameters) - length, length + 1):
                identity, data = parameters[start], parameters[start + 1 : start + 1 + length]
                if identity in servos:
                    self._write(servos[identity], address, data)
            return b''
        if code in (InstructionCode.SYNC_READ, InstructionCode.FAST_SYNC_READ):
            answering = {i: servo for i, servo in servos.items() if _answers(servo, code)}
            return sync_read(answering, parameters, code == InstructionCode.FAST_SYNC_READ)
        everyone = instruction.identity == BROADCAST
        addressed = sorted(servos) if everyone else [instruction.identity]
        answers = [self.answer(servos[i], code, parameters) for i in addressed if i in servos]
        return b'' if everyone and code != InstructionCode.PING else b''.join(answers)

    def answer(self, servo: Servo, code: int, parameters: bytes) -> bytes:
        """Let one servo carry out an instruction; return its status packet."""
        error, data = StatusError.INSTRUCTION | servo.alert, b''
        if code == InstructionCode.PING:
            number = servo.model.number.to_bytes(2, 'little')
            error, data = servo.alert, number + bytes([servo.firmware])
        elif code == InstructionCode.READ and len(parameters) == 4:
            error, data = servo.read(*_address_and_length(parameters))
        elif code == InstructionCode.WRITE and len(parameters) > 2:
            error = self._write(servo, int.from_bytes(parameters[:2], 'little'), parameters[2:])
        elif code == InstructionCode.REBOOT:
            self.rig.rebooted(servo.identity)
            self.booting[servo.identity] = time.monotonic() + BOOT_TIME_S
            error = 0
        return status(servo.identity, error, data) if _answers(servo, code) else b''

    def _write(self, servo: Servo, address: int, data: bytes) -> int:
        error = servo.write(address, data)
        name = LOGGED.get(address)
        if name is not None and len(data) == REGISTERS[name].size:
            value = int.from_bytes(data, 'little', signed=REGISTERS[name].signed)
            key = (servo.identity, name)
            low, high = self.extremes.get(key, (value, value))
            self.extremes[key] = (min(low, value), max(high, value))
            if not error & ~StatusError.ALERT:
                self.accepted.append((time.monotonic(), servo.identity, name, value))
        return error

    def connected(self) -> None:
        """Discard an incomplete packet."""
        self._receiver = InstructionReceiver()

    def baud_rate(self) -> int | None:
        """Return the baud rate that the client has set, None when it is an odd one."""
        if self._master is None:
            return None
        try:
            code = termios.tcgetattr(self._master)[5]
        except termios.error:
            return None
        return next((b for b in BAUD_RATES.values() if getattr(termios, f'B{b}') == code), None)
