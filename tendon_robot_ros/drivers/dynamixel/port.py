"""
The serial port as the SDK's port handler, for one process alone.

Of it only what the SDK leaves to its port handler is replaced: opening (exclusively), waiting for
bytes (asleep instead of spinning), the clock (monotonic) and the time to wait for an answer (the
SDK waits 34 ms whatever the adapter's latency is).
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import time
from pathlib import Path

import serial
from dynamixel_sdk import PortHandler

from ...common.errors import DriverError
from ..ports import PORT_ERRORS, refuse_held, take_alone, why_not, write_all

UDEV_FILE = '/etc/udev/rules.d/99-usb-serial-latency.rules'
UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
LATENCY_MAX_MS = 2  # [ms]


class Port(PortHandler):  # type: ignore[misc]
    """The SDK's port handler for one process; `clock` tells how long it waits for answers [s]."""

    clock = staticmethod(time.monotonic)

    def __init__(self, path: str, baud: int, answer_time: float) -> None:
        """Take path, baud rate and the time to wait for an answer besides its bytes [s]."""
        super().__init__(path)
        self.is_open: bool = False
        self.baudrate = baud
        self.answer_time = 1000.0 * answer_time  # [ms]

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the port so that no other process can."""
        if self.is_open:
            self.closePort()
        refuse_held(self.port_name)
        self.ser = serial.Serial(
            port=self.port_name, baudrate=cflag_baud, timeout=0, exclusive=True
        )
        take_alone(self.ser.fileno())
        self.is_open = True
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10_000.0 / self.baudrate
        return True

    def closePort(self) -> None:  # noqa: N802
        """Close for good; an unplugged port only becomes free again when it is closed."""
        self.is_open = False
        self.is_using = False
        if self.ser is not None:
            with contextlib.suppress(*PORT_ERRORS):
                self.ser.reset_output_buffer()  # goals that are still waiting are old
            with contextlib.suppress(*PORT_ERRORS):
                self.ser.close()

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
        """Return how many bytes have come that nobody has read; wait for them so long at most."""
        if seconds > 0.0:
            select.select([self.ser.fileno()], [], [], seconds)
        return int(self.ser.in_waiting)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Read up to `length` bytes; sleep until the first comes or the time is over."""
        left = 0.001 * (self.packet_timeout - self.getTimeSinceStart())
        if left > 0.0:
            select.select([self.ser.fileno()], [], [], left)
        return bytes(self.ser.read(length))


def open_port(path: str, baud: int, answer_time: float) -> Port:
    """
    Open a port for this process alone.

    Raises
    ------
    DriverError
        It does not exist, is not allowed, or another process has it.

    """
    port = Port(path, baud, answer_time)
    try:
        if port.openPort():
            return port
        raise DriverError(f'{path}: baudrate: the SDK does not know {baud}')
    except PORT_ERRORS as error:
        port.closePort()
        raise DriverError(why_not(path, error)) from None


def latency(path: str, sysfs: str = '/sys') -> int | None:
    """Read the adapter's latency timer [ms]; None where the port has none."""
    name = os.path.basename(os.path.realpath(path))
    if not re.fullmatch(r'tty\w+', name):
        return None
    file = Path(sysfs, 'class', 'tty', name, 'device', 'latency_timer')
    try:
        return int(file.read_text())
    except (OSError, ValueError):
        return None


def check_latency(path: str, allow: bool, sysfs: str = '/sys') -> int | None:
    """
    Return the latency timer [ms], None where there is none.

    Raises
    ------
    DriverError
        The adapter holds answers back for longer than 2 ms and that is not allowed.

    """
    milliseconds = latency(path, sysfs)
    if milliseconds is not None and milliseconds > LATENCY_MAX_MS and not allow:
        raise DriverError(
            f'{path}: latency_timer: expected at most {LATENCY_MAX_MS} ms, '
            f'got {milliseconds} ms: every '
            f"answer comes that late; type: echo '{UDEV_RULE}' | sudo tee {UDEV_FILE} && "
            'sudo udevadm control --reload && sudo udevadm trigger --action=add '
            '--subsystem-match=usb-serial (or set allow_latency: true)'
        )
    return milliseconds
