"""What the servos of a bus do with an instruction, and what they answer together."""

from __future__ import annotations

import time
from collections import deque

from ..dynamixel.tables import BAUD_RATES, REGISTERS
from . import packets
from .packets import Instruction
from .rig import Rig
from .servo import INSTRUCTION_ERROR, Servo

BOOT_TIME = 0.3  # [s] in which a rebooting servo is silent
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
        if code == packets.SYNC_WRITE:
            self._sync_write(servos, parameters)
            return b''
        if code in (packets.SYNC_READ, packets.FAST_SYNC_READ):
            return _sync_read(servos, parameters, code == packets.FAST_SYNC_READ)
        everyone = instruction.identity == packets.BROADCAST
        wanted = sorted(servos) if everyone else [instruction.identity]
        answers = [self._single(servos[i], code, parameters) for i in wanted if i in servos]
        return b'' if everyone and code != packets.PING else b''.join(answers)

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
        if code == packets.PING:
            number = servo.model.number.to_bytes(2, 'little')
            error, data = servo.alert, number + bytes([servo.firmware])
        elif code == packets.READ and len(parameters) == 4:
            error, data = servo.read(*_address_and_length(parameters))
        elif code == packets.WRITE and len(parameters) > 2:
            error = self._write(servo, int.from_bytes(parameters[:2], 'little'), parameters[2:])
        elif code == packets.REBOOT:
            self.rig.rebooted(servo.identity)
            self._booting[servo.identity] = time.monotonic() + BOOT_TIME
            error = 0
        return packets.status(servo.identity, error, data)

    def _sync_write(self, servos: dict[int, Servo], parameters: bytes) -> None:
        address, length = _address_and_length(parameters)
        for start in range(4, len(parameters) - length, length + 1):
            servo = servos.get(parameters[start])
            if servo is not None:
                self._write(servo, address, parameters[start + 1 : start + 1 + length])

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
        return b''.join(packets.status(*part) for part in parts)
    old = [i for i, _, _ in parts if servos[i].firmware < servos[i].model.fast_read_firmware]
    if old or not parts:
        return b''
    whole = packets.fast_status(parts + [(i, 0, bytes(length)) for i in wanted[len(parts) :]])
    return whole[: 8 + sum(len(data) + 4 for _, _, data in parts)]
