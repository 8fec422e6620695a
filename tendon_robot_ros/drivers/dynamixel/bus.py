"""
The bus: every conversation with the servos, through the SDK, with its traps closed.

Of the SDK's port handler four functions are replaced: writing (until all is taken), waiting for
bytes (asleep instead of spinning), the clock (monotonic) and the time-out of an answer (the SDK
waits 34 ms whatever the adapter's latency is).

The SDK drops a whole group read when one servo is silent and then gives zeros, hides the alert
bit in group reads, hands signed values back unsigned, and forgets to lengthen a packet whose
bytes look like a header. Whatever the failure, a method of `Bus` returns only bytes that were
read from the servo; only a lost port raises.

A late answer would be mistaken for that of the next request: a position for an error, a watchdog
for a temperature. Answers keep their order. So after a silence a responding servo is read with a
length that no other read has, a different one every time: everything that arrives before an
answer of that length is old.

Between requests a bus is silent. Bytes that arrive then, and are no late answer, belong to
another conversation: that of another program on the port, or another adapter on the bus.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from itertools import cycle
from pathlib import Path
from typing import TypeVar

import dynamixel_sdk as sdk
import serial

from ...common.errors import DriverError
from ..serial_port import (
    ANSWER_TIMEOUT_S,
    HICCUPS_MAX,
    PortLink,
    PortLostError,
    held_by,
    write_all,
)
from .control_table import REGISTERS, TABLE_BYTES, decode, encode

T = TypeVar('T')
GOALS = ('goal_current', 'goal_position')
UDEV_FILE = '/etc/udev/rules.d/99-usb-serial-latency.rules'
UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
LATENCY_MAX_MS = 2  # [ms] of an adapter; every answer comes so late, else a 100 Hz cycle is missed
# [bytes] from address 0, longer than any other read and in turn different, so that the answer is
# known by its length
FRESH_LENGTHS = range(11, 31)
# [s] in which more conversations than hiccups have bytes before them, else these are hiccups
STRAY_WINDOW_S = 2.0


class StatusByte(IntEnum):
    """Places in a status packet: manual, Protocol 2.0, "Status Packet"."""

    ID = 4
    LENGTH = 5
    ERROR = 8
    DATA = 9


class Port(sdk.PortHandler):  # type: ignore[misc]
    """The SDK's port handler on an open port; `clock` tells how long it waits for answers [s]."""

    clock = staticmethod(time.monotonic)

    def __init__(self, device: serial.Serial, answer_time: float) -> None:
        """Take the open port and the time to wait for an answer besides its bytes [s]."""
        super().__init__(device.port)
        self.ser, self.baudrate = device, device.baudrate
        self.answer_time = 1000.0 * answer_time  # [ms]
        self.tx_time_per_byte = 10_000.0 / device.baudrate  # [ms]

    def getCurrentTime(self) -> float:  # noqa: N802
        """Return a time that no clock adjustment moves [ms]."""
        return 1000.0 * self.clock()

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Wait for the bytes of an answer and the adapter's latency."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self.answer_time)

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        """Write a packet; return its length."""
        write_all(self.ser.fileno(), bytes(packet))
        return len(packet)

    def waiting(self, seconds: float = 0.0) -> int:
        """Return the number of unread bytes; wait up to some seconds for the first."""
        if seconds > 0.0:
            select.select([self.ser.fileno()], [], [], seconds)
        return int(self.ser.in_waiting)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Read up to `length` bytes; sleep until the first comes or the time is over."""
        remaining = 0.001 * (self.packet_timeout - self.getTimeSinceStart())
        if remaining > 0.0:
            select.select([self.ser.fileno()], [], [], remaining)
        return bytes(self.ser.read(length))


def check_latency(path: str, allow: bool, sysfs: str = '/sys') -> int | None:
    """
    Return the latency timer of the adapter [ms], None where there is none.

    Raises
    ------
    DriverError
        The adapter holds answers back for longer than 2 ms and that is not allowed.

    """
    device = Path(sysfs, 'class', 'tty', os.path.basename(os.path.realpath(path)), 'device')
    try:
        milliseconds = int((device / 'latency_timer').read_text())
    except (OSError, ValueError):
        return None
    if milliseconds > LATENCY_MAX_MS and not allow:
        raise DriverError(
            f'{path}: latency_timer: expected at most {LATENCY_MAX_MS} ms, '
            f'got {milliseconds} ms: every '
            f"answer comes that late; type: echo '{UDEV_RULE}' | sudo tee {UDEV_FILE} && "
            'sudo udevadm control --reload && sudo udevadm trigger --action=add '
            '--subsystem-match=usb-serial (or set allow_latency: true)'
        )
    return milliseconds


class Bus(PortLink):
    """
    One serial bus with servos.

    Attributes
    ----------
    answer_time : float
        Time to wait for an answer [s].
    fast : bool
        Whether group reads use the fast sync read.

    """

    _port: Port  # of the open port

    def __init__(self, path: str, baud: int, answer_time: float) -> None:
        """Take the path of the port, the baud rate and the time to wait for an answer [s]."""
        super().__init__(path, baud)
        self.failures = {'no or broken answer': 0, 'port lost': 0}
        self.answer_time, self.fast = answer_time, False
        self._packets = sdk.Protocol2PacketHandler()
        self._responding: list[int] = []  # ids of servos that answered, the last one first
        self._behind = False  # a late answer may still arrive
        self._fresh_lengths = cycle(FRESH_LENGTHS)
        self._stray: deque[float] = deque(maxlen=HICCUPS_MAX)  # [s] times of unrequested bytes
        self._talker = ''

    def _open(self) -> None:
        super()._open()
        self._port = Port(self._device, self.answer_time)

    def _talk(self, what: Callable[[Port], T]) -> T:
        """Run one conversation; a failing port is closed at once and reported as lost."""
        with self.conversation():
            if not self._behind and self._port.waiting():
                self._stray.append(time.monotonic())
            if self._behind and self._responding:  # read past late answers
                length = next(self._fresh_lengths)
                self._behind = self._answer(self._port, self._responding[0], 0, length) is None
                if self._behind:
                    self._responding.append(self._responding.pop(0))  # another servo next time
            return what(self._port)

    def second_talker(self) -> str:
        """Listen for a moment; return the name of another program on this bus, '' for none."""
        if who := held_by(self.path, others=True):
            return who
        with contextlib.suppress(PortLostError), self.conversation():
            time.sleep(ANSWER_TIMEOUT_S)  # what comes later is no late answer
            self._port.clearPort()
            if self._port.waiting(2.0 * ANSWER_TIMEOUT_S):
                return self._other_talker()
        return ''

    def disturbed(self) -> str:
        """Return the name of another program on this bus, by bytes between conversations."""
        stray = self._stray
        if len(stray) < HICCUPS_MAX or time.monotonic() - stray[0] > STRAY_WINDOW_S:
            self._talker = ''
        elif not self._talker:  # once, because the search takes a while
            self._talker = self._other_talker()
        return self._talker

    def _other_talker(self) -> str:
        who = held_by(self.path, others=True) or 'another program or adapter talks'
        return f'bytes come that nobody here has asked for: {who}'

    def _learn(self, what: Callable[[Port], T | None]) -> T | None:
        """Run a conversation that reads; None while a late answer may still arrive."""
        return self._talk(lambda port: None if self._behind and self._responding else what(port))

    def _failed(self) -> None:
        self._behind = True
        self.failures['no or broken answer'] += 1

    def _answered(self, identity: int) -> None:
        self._responding = [identity, *(other for other in self._responding if other != identity)]

    def _answer(self, port: Port, identity: int, address: int, length: int) -> bytes | None:
        """Request bytes; return those of the first packet that can be the answer."""
        try:
            result = self._packets.readTx(port, identity, address, length)
            while result == sdk.COMM_SUCCESS:
                packet, result = self._packets.rxPacket(port, False)
                if result != sdk.COMM_SUCCESS or packet[StatusByte.ID] != identity:
                    continue
                complete = packet[StatusByte.LENGTH] == length + 4
                if complete and not packet[StatusByte.ERROR] & 0x7F:
                    return bytes(packet[StatusByte.DATA : StatusByte.DATA + length])
        except IndexError:  # shorter than the SDK expects
            pass
        return None

    def ping(self, identity: int) -> int | None:
        """Return the model number of a servo, None when it does not answer."""
        number, result, _ = self._talk(lambda port: self._packets.ping(port, identity))
        if result != sdk.COMM_SUCCESS:
            self._behind = True
            return None
        self._answered(identity)
        return int(number)

    def everyone(self) -> dict[int, int]:
        """Ping all servos; return id to model number. Takes a second or more."""
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
        where, data = (identity, register.address, register.size), list(encode(register, value))
        result, error = self._talk(lambda port: self._packets.writeTxRx(port, *where, data))
        if result != sdk.COMM_SUCCESS:
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
        writer = sdk.GroupSyncWrite(self._port, self._packets, register.address, register.size)
        for identity, goal in goals.items():
            low, high = bounds[identity]
            value = without_header(min(max(goal, low), high), low)
            writer.addParam(identity, list(encode(register, value)))
        if goals:
            self._talk(lambda port: writer.txPacket())

    def block(self, address: int, length: int, identities: Iterable[int]) -> dict[int, bytes]:
        """
        Read the same bytes from several servos; those that give no good answer are missing.

        One fast (or plain) sync read; when that fails, every servo is read by itself, because
        one silent servo spoils the whole group.
        """
        requested = tuple(identities)
        if not requested:
            return {}
        blocks = self._learn(lambda port: self.group_read(port, address, length, requested))
        if blocks is not None:
            return blocks
        self._failed()
        singles = {i: self._read_bytes(i, address, length) for i in requested}
        return {i: data for i, data in singles.items() if data is not None}

    def group_read(
        self, port: Port, address: int, length: int, identities: tuple[int, ...]
    ) -> dict[int, bytes] | None:
        """Read the same bytes from several servos at once, None where any of them is missing."""
        reader = sdk.GroupSyncRead(port, self._packets, address, length)
        for identity in identities:
            reader.addParam(identity)
        try:
            result = reader.fastSyncRead() if self.fast else reader.txRxPacket()
        except (IndexError, struct.error):  # an answer shorter than the SDK expects
            result = None
        if result != sdk.COMM_SUCCESS:
            return None
        blocks = {i: bytes(reader.data_dict[i]) for i in identities}
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
