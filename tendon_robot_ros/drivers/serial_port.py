"""
Motors on a serial port: the port of this process alone, and a driver that survives its loss.

Whoever has a port open is named, also without a lock. A port that fails is closed at once, because
an unplugged one becomes free only then, and `reopen` brings it back.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import serial

from ..common.arrays import Bools, Floats
from ..common.errors import REASON_MAX, DriverError, MovedError
from ..robot import Robot
from .hardware import HardwareDriver, PortConfig, WireConfig
from .interface import Fault, Reading, travelled

# exceptions of an unplugged port: serial's error is an OSError, termios.error is none
PORT_ERRORS = (OSError, termios.error)
# [s] the longest for a motor or board to answer or send, and for a port to take bytes, so that a
# busy computer is no lost port; whoever waits in a cycle waits less (`answer_time`)
ANSWER_TIMEOUT_S = 0.1
# [s] a servo takes some tenths to restart, the boot loader of a board that the opened port has
# restarted would wait 2 s; a longer silence is a fault
RESTART_TIMEOUT_S = 4.0
# [1] messages or answers that are lost in a row, or stray ones, so that a hiccup ends no motion
# and no configuration; what comes more often is no hiccup
HICCUPS_MAX = 5


class PortLostError(Exception):
    """The port is gone; `reopen` may bring it back."""


@contextlib.contextmanager
def lost_while(doing: str) -> Iterator[None]:
    """Raise DriverError where the port is lost in the block: what was being done has failed."""
    try:
        yield
    except PortLostError as error:
        raise DriverError(f'{error}: lost while {doing}') from None


def write_all(file: int, data: bytes) -> None:
    """
    Write to a port that does not block.

    pyserial's own write, with a time-out, fails also where the port accepted all data at once and
    this process was late to notice.

    Raises
    ------
    OSError
        The port is gone, or has taken nothing for `ANSWER_TIMEOUT_S`.

    """
    while data:
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(file, data) :]
        if data and not select.select([], [file], [], ANSWER_TIMEOUT_S)[1]:
            raise TimeoutError(f'the port took nothing for {ANSWER_TIMEOUT_S:g} s')


def why_not(path: str, error: BaseException) -> str:
    """Return a message why a port cannot be opened, and the remedy."""
    code = getattr(error, 'errno', None)
    if not os.path.exists(path):
        return (
            f'{path}: no such port; is the adapter plugged in? '
            f'found: {", ".join(present_ports()) or "no USB serial port"}'
        )
    if code == errno.EACCES:
        return (
            f'{path}: not allowed; type: sudo usermod -aG dialout $USER, then log out and in again'
        )
    if code in (errno.EAGAIN, errno.EBUSY) or 'lock' in str(error):
        return f'{path}: {held_by(path) or "another process has the port"}; stop it first'
    return f'{path}: cannot open: {error}'


def held_by(path: str, others: bool = False) -> str:
    """
    Return which process has a port open, '' if none is visible.

    Parameters
    ----------
    path : str
    others : bool
        Only other processes than this one.

    """
    device = os.path.realpath(path)
    for link in Path('/proc').glob('[0-9]*/fd/*'):
        try:
            own = int(link.parts[2]) == os.getpid()
            if os.readlink(link) != device or (own and others):
                continue
            if own:
                return 'this process has the port already'
            command = Path('/proc', link.parts[2], 'cmdline').read_bytes()
            name = ' '.join(command.decode(errors='replace').replace('\0', ' ').split())
            name = name[:REASON_MAX]
            return f'another process has the port (process {link.parts[2]}: {name})'
        except OSError:  # it has ended, or belongs to somebody else
            continue
    return ''


def present_ports() -> list[str]:
    """List the USB serial ports, by the name that stays when they are plugged in again."""
    by_id = sorted(str(path) for path in Path('/dev/serial/by-id').glob('*'))
    return by_id or sorted(str(path) for path in Path('/dev').glob('ttyUSB*'))


class PortLink:
    """
    A serial port that belongs to this process alone.

    Attributes
    ----------
    path : str
    baud : int
        [1/s]
    failures : dict of str to int
        Number of failures of each kind since the start.

    """

    def __init__(self, path: str, baud: int) -> None:
        """Take the path of the port and the baud rate."""
        self.path, self.baud = path, baud
        self.failures = {'port lost': 0}
        self._device: serial.Serial | None = None

    @property
    def connected(self) -> bool:
        """Whether the port is open; a lost port counts as open until a conversation fails."""
        return self._device is not None

    def open(self, identify: Callable[[], None] = lambda: None) -> None:
        """Open the port and identify what is behind it; DriverError: it is closed again."""
        try:
            self._open()
        except PORT_ERRORS as error:
            raise DriverError(why_not(self.path, error)) from None
        try:
            identify()
        except (DriverError, PortLostError) as error:
            self.close()
            raise DriverError(str(error)) from None

    def reopen(self) -> bool:
        """Try to reopen a lost port; return whether it worked. Quick either way."""
        with contextlib.suppress(*PORT_ERRORS):
            if os.path.exists(self.path):
                self._open()
        return self.connected

    def _open(self) -> None:
        """Open the port so that no other process can: pyserial's lock binds its users only."""
        self.close()
        if held_by(self.path):  # by a program without a lock, which would share the answers
            raise OSError(errno.EBUSY, 'open already')
        device = serial.Serial(self.path, self.baud, timeout=0, exclusive=True)
        try:
            fcntl.ioctl(device.fileno(), termios.TIOCEXCL)
            device.reset_input_buffer()
        except PORT_ERRORS:
            device.close()
            raise
        self._device = device

    def close(self) -> None:
        """Close the port; never raises. What is still waiting is old, and is not sent."""
        device, self._device = self._device, None
        if device is not None:
            for end in (device.reset_output_buffer, device.close):
                with contextlib.suppress(*PORT_ERRORS):
                    end()

    @contextlib.contextmanager
    def conversation(self) -> Iterator[serial.Serial]:
        """Give the open port; PortLostError where there is none, or where it fails."""
        if self._device is None:
            raise PortLostError(self.path)
        try:
            yield self._device
        except PORT_ERRORS as error:
            self.failures['port lost'] += 1
            self.close()
            raise PortLostError(f'{self.path}: {error}') from None


class PortDriver(HardwareDriver):
    """
    Opens a port, identifies the motors and finds the slack of the wires before the first torque.

    Attributes
    ----------
    cancelled : callable
        Called while `enable` searches for slack; a true result ends it.
    released_after : float
        Silence [s] after which the motors may have released by themselves, and a command waits
        until they have been read.

    """

    config: PortConfig
    link: PortLink
    read_config: ClassVar[Callable[..., Any]]
    device: ClassVar[str]  # what is plugged in, for messages
    source: ClassVar[str]  # of the tensions
    released_after = np.inf

    def __init__(
        self, robot: Robot, mode: str, config: PortConfig, wires: Sequence[WireConfig]
    ) -> None:
        """Take the wires in the order of the robot's inputs."""
        limits = [wire.pull_limits for wire in wires]
        if mode == 'tension':
            limits = [(robot.tension_limits[0], wire.tension_limit) for wire in wires]
        rates = np.array([wire.rate for wire in wires])
        super().__init__(robot, mode, config.port, np.array(limits), rates)
        self.config, self.port = config, config.port
        self.cancelled: Callable[[], bool] = lambda: False
        self._retried = -np.inf  # monotonic [s]

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str
    ) -> Self:
        """Make the driver from the content of its configuration file."""
        return cls(robot, cls.read_config(robot, config, mode, source), mode)  # type: ignore

    def open(self) -> None:
        """Open the port for this process alone and identify the motors."""
        self.link.open(self._shake_hands)
        self._is_open = True

    def close(self) -> None:
        """Close the port; the watchdogs of the motors then stop them."""
        self._is_open = False
        self.link.close()

    def enable(self) -> None:
        """Torque on where the arm is; with `zero: find`, wind up the slack first."""
        self._require_open('enable')
        failed: type[DriverError] = DriverError
        try:
            self._check_motors()
            if self.config.zero == 'find' and self._slack_unknown():
                self._find_slack()
                travelled(self.port).clear()
                failed = MovedError
            self._torque_on()
        except (DriverError, PortLostError) as error:
            self.disable()
            if isinstance(error, MovedError):
                raise
            raise failed(str(error)) from None
        self._start_from_measured()

    def write(self, command: Floats) -> None:
        """Command tensions [N] or pulls [m], shape (m,), kept within limits and rates."""
        self._require_open('write')
        requested, passed = self.checked(command), self._since_write()
        if passed > self.released_after:
            return
        self._goal = self._towards(requested, self.limits, passed)
        with contextlib.suppress(PortLostError):  # read() reports it and reopens the port
            self._send()

    def read(self) -> Reading:
        """Read the state of all motors; try to restore what was lost."""
        self._require_open('read')
        now = time.monotonic()
        try:
            if not self.link.connected and self._may_retry(now) and self.link.reopen():
                self._retried = -np.inf  # motors that were lost with the port are asked at once
            self._converse(now)
        except (PortLostError, DriverError):
            self._forget_readings()
        gone = f'{self.port}: the port is gone; plug the {self.device} in again'
        faults = self._faults() if self.link.connected else (Fault('port', gone),)
        tensions, doubt = self._tensions()
        return Reading(time.monotonic(), self._pulls(), tensions, self.source, doubt, faults)

    def _may_retry(self, now: float) -> bool:
        """Return whether it is time for another attempt to reconnect."""
        # those that fail, with their time-outs, leave most cycles to the motors that are there
        if now - self._retried < 2.0 * ANSWER_TIMEOUT_S:
            return False
        self._retried = now
        return True

    def _start_from_measured(self, which: Bools | None = None) -> None:
        """
        Let the next command begin at what is measured.

        Parameters
        ----------
        which : ndarray of bool, shape (m,), optional
            Only these inputs: the ramps of the others continue, because a stop must not wait.

        """
        measured = self._tensions()[0] if self.mode == 'tension' else self._pulls()
        known = np.where(np.isfinite(measured), measured, 0.0)
        if which is None:
            self._goal, self._written = known, time.monotonic()
        else:
            self._goal = np.where(which, known, self._goal)

    def refuse_cancelled(self) -> None:
        """Raise DriverError where the search for slack was cancelled."""
        if self.cancelled():
            raise DriverError(f'{self.port}: looking for slack was cancelled; torque is off')

    @abstractmethod
    def _shake_hands(self) -> None:
        """Check the motors behind the open port, and read the positions of the wires."""

    def _check_motors(self) -> None:
        """Refuse motors that latched a fault."""

    @abstractmethod
    def _slack_unknown(self) -> bool:
        """Return whether the zero of a pull is unknown."""

    @abstractmethod
    def _find_slack(self) -> None:
        """Wind every wire until it is taut; MovedError where that fails after a motor moved."""

    @abstractmethod
    def _torque_on(self) -> None:
        """Switch all motors on, where they are."""

    @abstractmethod
    def _send(self) -> None:
        """Send the goal to the motors that are on."""

    @abstractmethod
    def _converse(self, now: float) -> None:
        """Read the motors; act on what they did by themselves. PortLostError without a port."""

    @abstractmethod
    def _forget_readings(self) -> None:
        """Note that nothing is known of the motors now."""

    @abstractmethod
    def _faults(self) -> tuple[Fault, ...]:
        """Return the present faults of the motors behind the open port."""

    @abstractmethod
    def _tensions(self) -> tuple[Floats, Floats]:
        """Return tensions and their standard uncertainties, (m,) [N]; nan where unknown."""

    @abstractmethod
    def _pulls(self) -> Floats:
        """Return the wire pulls, (m,) [m]; nan where unknown."""
