"""
The bus: every conversation with the servos, through the SDK, with its traps closed.

The SDK drops a whole group read when one servo is silent and then gives zeros, hides the alert
bit in group reads, hands signed values back unsigned, and forgets to lengthen a packet whose
bytes look like a header. Whatever the failure, a method here returns what was really read and
nothing else; only a lost port raises.

An answer that comes after its time would be taken for that of the next question: a position for
an error, a watchdog for a temperature. Answers keep their order. So after a silence a servo that
is there is asked for as many bytes as nobody else asks for, another number every time: what
comes before those is old.
"""

from __future__ import annotations

import os
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, Protocol2PacketHandler

from ..ports import PORT_ERRORS, PortLostError, held_by
from .control_table import REGISTERS, TABLE_BYTES, decode, encode
from .port import Port, open_port

T = TypeVar('T')
GOALS = ('goal_current', 'goal_position')


PACKET_ID, PACKET_LENGTH, PACKET_ERROR = 4, 5, 8  # places in a status packet
FEWEST_BYTES, DIFFERENT_LENGTHS = 11, 20  # from address 0; no other read is so long

# Between its questions a bus is silent. Bytes that come all the same, and are no late answer, are
# somebody else's conversation: another program on the port, another adapter on the bus.
LATE_S = 0.1  # [s] after which no answer of ours comes: the longest `answer_time`
LISTENING_S = 0.2  # [s]; who talks less often disturbs little
STRAY_MAX, STRAY_WITHIN_S = 3, 2.0  # conversations with bytes before them: a hiccup comes once


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

    """

    def __init__(self, path: str, baud: int, answer_time: float) -> None:
        """Take the path of the port, the baud rate and the time to wait for an answer [s]."""
        self.path, self.baud, self.answer_time = path, baud, answer_time
        self.fast = False
        self.failures = {'no or broken answer': 0, 'port lost': 0}
        self._packets = Protocol2PacketHandler()
        self._port: Port | None = None
        self._readers: dict[tuple[int, int, tuple[int, ...]], Any] = {}
        self._there: list[int] = []  # who has answered, the last one first
        self._behind = False  # an answer may be on its way that nobody waits for
        self._turn = 0
        self._stray: deque[float] = deque(maxlen=STRAY_MAX)  # [s] when bytes had come unasked
        self._talker = ''

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
        except PORT_ERRORS:
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
        try:
            if not self._behind and self._port.waiting():
                self._stray.append(time.monotonic())
            self._catch_up(self._port)
            return what(self._port)
        except PORT_ERRORS as error:
            self.failures['port lost'] += 1
            self.close()
            raise PortLostError(f'{self.path}: {error}') from None

    def second_talker(self) -> str:
        """Look, and listen for a moment; say who else talks on this bus, '' for nobody."""
        who = held_by(self.path, others=True)
        if who or self._port is None:
            return who
        try:
            time.sleep(LATE_S)
            self._port.clearPort()
            if self._port.waiting(LISTENING_S):
                return self._other_talker()
        except PORT_ERRORS:
            self.close()
        return ''

    def disturbed(self) -> str:
        """Say who else talks on this bus, from what came between the last conversations."""
        stray = self._stray
        if len(stray) < STRAY_MAX or time.monotonic() - stray[0] > STRAY_WITHIN_S:
            self._talker = ''
        elif not self._talker:  # looked up once: it takes a while
            self._talker = self._other_talker()
        return self._talker

    def _other_talker(self) -> str:
        who = held_by(self.path, others=True) or 'another program or adapter talks'
        return f'bytes come that nobody here has asked for: {who}'

    def _learn(self, what: Callable[[Port], T | None]) -> T | None:
        """Run a conversation that reads; None while an old answer may be taken for a new one."""
        return self._talk(lambda port: None if self._behind and self._there else what(port))

    def _catch_up(self, port: Port) -> None:
        """Let pass what is late, so that the next answer is that of the next question."""
        if self._behind and self._there:
            self._turn += 1
            length = FEWEST_BYTES + self._turn % DIFFERENT_LENGTHS
            self._behind = self._answer(port, self._there[0], 0, length) is None
            if self._behind:
                self._there.append(self._there.pop(0))  # another one is asked next time

    def _failed(self) -> None:
        self._behind = True
        self.failures['no or broken answer'] += 1

    def _answered(self, identity: int) -> None:
        self._there = [identity, *(other for other in self._there if other != identity)]

    def _answer(self, port: Port, identity: int, address: int, length: int) -> bytes | None:
        """Ask for bytes; return those of the first packet that can be the answer."""
        try:
            result = self._packets.readTx(port, identity, address, length)
            while result == COMM_SUCCESS:
                packet, result = self._packets.rxPacket(port, False)
                if result != COMM_SUCCESS or packet[PACKET_ID] != identity:
                    continue
                if packet[PACKET_LENGTH] == length + 4 and not packet[PACKET_ERROR] & 0x7F:
                    return bytes(packet[PACKET_ERROR + 1 : PACKET_ERROR + 1 + length])
        except IndexError:  # shorter than the SDK expects
            pass
        return None

    def ping(self, identity: int) -> int | None:
        """Return the model number of a servo, None when it does not answer."""
        number, result, _ = self._talk(lambda port: self._packets.ping(port, identity))
        if result != COMM_SUCCESS:
            self._behind = True
            return None
        self._answered(identity)
        return int(number)

    def everyone(self) -> dict[int, int]:
        """Ask who is there: id to model number. Takes a second or more."""
        answers, _ = self._talk(self._packets.broadcastPing)
        return {int(identity): int(data[0]) for identity, data in answers.items()}

    def read(self, identity: int, name: str) -> int | None:
        """Read one register, None when there is no good answer."""
        register = REGISTERS[name]
        data = self._read_bytes(identity, register.address, register.size)
        return None if data is None else decode(register, data)

    def table(self, identity: int) -> dict[str, int] | None:
        """Read all registers at once, name to value; None when there is no good answer."""
        data = self._read_bytes(identity, 0, TABLE_BYTES)
        if data is None:
            return None
        return {
            name: decode(register, data[register.address : register.address + register.size])
            for name, register in REGISTERS.items()
        }

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
            self._failed()
            return 'no answer'
        self._answered(identity)
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
        blocks = self._learn(lambda port: self._group(port, address, length, wanted))
        if blocks is not None:
            return blocks
        self._failed()
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
        blocks = {i: bytes(reader.data_dict[i]) for i in wanted}
        return blocks if all(len(data) == length for data in blocks.values()) else None

    def _read_bytes(self, identity: int, address: int, length: int) -> bytes | None:
        data = self._learn(lambda port: self._answer(port, identity, address, length))
        if data is None:
            self._failed()
        else:
            self._answered(identity)
        return data


def without_header(value: int, low: int) -> int:
    """
    Keep a goal from looking like a packet header; it moves by one tick.

    The SDK stuffs such bytes into a copy and then sends the original, which no servo
    understands: FF FF FD in the three low bytes, -131073 for example.
    """
    if value & 0xFFFFFF != 0xFDFFFF:
        return value
    return value - 1 if value > low else value + 1
