"""
The bus: every conversation with the servos, through the SDK, with its traps closed.

The SDK drops a whole group read when one servo is silent and then gives zeros, hides the alert
bit in group reads, hands signed values back unsigned, and forgets to lengthen a packet whose
bytes look like a header. Whatever the failure, a method here returns what was really read and
nothing else; only a lost port raises.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, Protocol2PacketHandler

from ..ports import LOST
from .port import Port, open_port
from .tables import REGISTERS, decode, encode

T = TypeVar('T')
GOALS = ('goal_current', 'goal_position')


class PortLostError(Exception):
    """The port is gone; `reopen` may bring it back."""


class Bus:
    """
    One serial bus with servos.

    Attributes
    ----------
    path : str
        The port.
    fast : bool
        Whether group reads use the fast sync read.
    failures : dict of str to int
        How often what went wrong, since the start.
    last_instruction : float
        `time.monotonic()` when something was last sent [s]: what the watchdogs measure from.

    """

    def __init__(self, path: str, baud: int, answer_time: float) -> None:
        """Take the path of the port, the baud rate and the time to wait for an answer [s]."""
        self.path, self.baud, self.answer_time = path, baud, answer_time
        self.fast = False
        self.failures = {'no or broken answer': 0, 'port lost': 0}
        self.last_instruction = time.monotonic()
        self._packets = Protocol2PacketHandler()
        self._port: Port | None = None
        self._readers: dict[tuple[int, int, tuple[int, ...]], Any] = {}

    @property
    def connected(self) -> bool:
        """Whether the port is open, as far as is known."""
        return self._port is not None

    def open(self) -> None:
        """Open the port with a new port handler; raise DriverError when it cannot be."""
        self.close()
        self._port = open_port(self.path, self.baud, self.answer_time)

    def reopen(self) -> bool:
        """Try to get a lost port back; tell whether it worked. Quick either way."""
        self.close()
        port = Port(self.path, self.baud, self.answer_time)
        try:
            opened = os.path.exists(self.path) and port.openPort()
        except LOST:
            opened = False
        if not opened:
            port.closePort()
            return False
        self._port = port
        return True

    def close(self) -> None:
        """Give the port back; never raises."""
        port, self._port = self._port, None
        self._readers.clear()
        if port is not None:
            port.closePort()

    def _talk(self, what: Callable[[Port], T]) -> T:
        """Run one conversation; a failing port is closed at once and reported as lost."""
        if self._port is None:
            raise PortLostError(self.path)
        self.last_instruction = time.monotonic()
        try:
            return what(self._port)
        except LOST as error:
            self.failures['port lost'] += 1
            self.close()
            raise PortLostError(f'{self.path}: {error}') from None

    def ping(self, identity: int) -> int | None:
        """Return the model number of a servo, None when it does not answer."""
        number, result, _ = self._talk(lambda port: self._packets.ping(port, identity))
        return int(number) if result == COMM_SUCCESS else None

    def everyone(self) -> dict[int, int]:
        """Ask who is there: id to model number. Takes a second or more."""
        found, _ = self._talk(self._packets.broadcastPing)
        return {int(identity): int(data[0]) for identity, data in found.items()}

    def read(self, identity: int, name: str) -> int | None:
        """Read one register, None when there is no good answer."""
        register = REGISTERS[name]
        data = self._read_bytes(identity, register.address, register.size)
        return None if data is None else decode(register, data)

    def write(self, identity: int, name: str, value: int) -> str | None:
        """Write one register that is no goal; return what went wrong, or None."""
        if name in GOALS:
            raise ValueError('goals are written by send_goals, which keeps them within bounds')
        register = REGISTERS[name]
        data = list(encode(register, value))
        result, error = self._talk(
            lambda port: self._packets.writeTxRx(
                port, identity, register.address, register.size, data
            )
        )
        if result != COMM_SUCCESS:
            self.failures['no or broken answer'] += 1
            return 'no answer'
        return str(self._packets.getRxPacketError(error & 0x7F))[len('[RxPacketError] ') :] or None

    def reboot(self, identity: int) -> None:
        """Restart a servo; it is silent for some tenths of a second."""
        self._talk(lambda port: self._packets.reboot(port, identity))

    def send_goals(
        self, name: str, goals: Mapping[int, int], bounds: Mapping[int, tuple[int, int]]
    ) -> None:
        """
        Send goals to several servos at once: the one place where goals become bytes.

        Parameters
        ----------
        name : str
            `goal_current` or `goal_position`.
        goals : mapping of id to int
            In counts or ticks.
        bounds : mapping of id to (lowest, highest)
            Nothing outside is ever sent.

        """
        register = REGISTERS[name]
        writer = GroupSyncWrite(self._port, self._packets, register.address, register.size)
        for identity, goal in goals.items():
            low, high = bounds[identity]
            value = without_header(min(max(goal, low), high), low)
            writer.addParam(identity, list(encode(register, value)))
        if goals:
            self._talk(lambda port: writer.txPacket())

    def block(self, address: int, length: int, identities: Iterable[int]) -> dict[int, bytes]:
        """
        Read the same bytes from several servos; those that give no good answer are missing.

        One fast (or plain) sync read; when that fails, every servo is asked by itself, because
        one silent servo spoils the whole group.
        """
        wanted = tuple(identities)
        if not wanted:
            return {}
        found = self._talk(lambda port: self._group(port, address, length, wanted))
        if found is not None:
            return found
        self.failures['no or broken answer'] += 1
        singles = {i: self._read_bytes(i, address, length) for i in wanted}
        return {i: data for i, data in singles.items() if data is not None}

    def _group(
        self, port: Port, address: int, length: int, wanted: tuple[int, ...]
    ) -> dict[int, bytes] | None:
        reader = self._readers.get((address, length, wanted))
        if reader is None:
            reader = GroupSyncRead(port, self._packets, address, length)
            for identity in wanted:
                reader.addParam(identity)
            self._readers[address, length, wanted] = reader
        try:
            result = reader.fastSyncRead() if self.fast else reader.txRxPacket()
        except (IndexError, struct.error):  # an answer shorter than the SDK expects
            result = None
        if result != COMM_SUCCESS:
            return None
        found = {i: bytes(reader.data_dict[i]) for i in wanted}
        return found if all(len(data) == length for data in found.values()) else None

    def _read_bytes(self, identity: int, address: int, length: int) -> bytes | None:
        def ask(port: Port) -> tuple[Any, int, int]:
            try:
                answer: tuple[Any, int, int] = self._packets.readTxRx(
                    port, identity, address, length
                )
            except IndexError:
                return None, 1, 0
            return answer

        data, result, error = self._talk(ask)
        if result != COMM_SUCCESS or error & 0x7F or len(data) != length:
            self.failures['no or broken answer'] += 1
            return None
        return bytes(data)


def without_header(value: int, low: int) -> int:
    """
    Keep a goal from looking like a packet header; it moves by one tick.

    The SDK stuffs such bytes into a copy and then sends the original, which no servo
    understands: FF FF FD in the three low bytes, -131073 for example.
    """
    if value & 0xFFFFFF != 0xFDFFFF:
        return value
    return value - 1 if value > low else value + 1
