"""
Common parts of drivers of real motors.

Serial ports, commands within limits and rates, opening and enabling of a driver on a port,
configuration files and the straight lines of calibrations.
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
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError, MovedError, TendonRobotError
from ..common.files import read_text
from ..common.yaml_reading import ConfigFields, parse_yaml
from ..robot import Robot
from .interface import Array, Driver
from .safety import CYCLE_MAX_S, STOP_TIME_MIN_S, approach, bounded

# exceptions of an unplugged port: serial's error is an OSError, termios.error is none
PORT_ERRORS = (OSError, termios.error)
# [s] the longest for a motor or board to answer or send, and for a port to take bytes, so that a
# busy computer is no lost port; whoever waits in a cycle waits less (`answer_time`)
ANSWER_TIMEOUT_S = 0.1
COMMAND_SHOWN = 60  # [characters] of another process's command, so that a message is a line
# [s] after a longer pause the command does not catch up, so that no wire moves in one step
WRITE_STEP_MAX_S = 2.0 * CYCLE_MAX_S
# [s] between two attempts to get a port or a motor back, so that those that fail, with their
# time-outs, leave most cycles to the motors that are there
RETRY_PERIOD_S = 0.2
PULL_MAX_M = 1.0  # [m] of wire either way: more would be a mistake in a unit
WEIGHTS_MIN = 3  # [1] different ones in a calibration, else a line fits them without a residual
READINGS_MIN = 5  # [1] with one weight, else a mean and its noise would mean little


class PortLostError(Exception):
    """The port is gone; `reopen` may bring it back."""


def take_alone(file: int) -> None:
    """Let no other process open the port; a lock that pyserial takes binds its users only."""
    fcntl.ioctl(file, termios.TIOCEXCL)


def refuse_held(path: str) -> None:
    """
    Refuse a port that is open already: a program without a lock would share its answers.

    Raises
    ------
    OSError
        A process has it open; `why_not` names it.

    """
    if held_by(path):
        raise OSError(errno.EBUSY, 'open already')


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
            if os.readlink(link) != device:
                continue
            if int(link.parts[2]) == os.getpid():
                if others:
                    continue
                return 'this process has the port already'
            command = Path('/proc', link.parts[2], 'cmdline').read_bytes()
            name = ' '.join(command.decode(errors='replace').replace('\0', ' ').split())
            name = f'{link.parts[2]}: {name[:COMMAND_SHOWN]}'
            return f'another process has the port (process {name})'
        except OSError:  # it has ended, or belongs to somebody else
            continue
    return ''


def present_ports() -> list[str]:
    """List the USB serial ports, by the name that stays when they are plugged in again."""
    by_id = sorted(str(path) for path in Path('/dev/serial/by-id').glob('*'))
    return by_id or sorted(str(path) for path in Path('/dev').glob('ttyUSB*'))


class HardwareDriver(Driver):
    """
    A driver of real motors: it is open or not, and its command moves within limits and rates.

    Tensions rise at the rates; they may fall faster, because a stop releases them.

    Parameters
    ----------
    robot : Robot
    mode : str
        `tension` or `pull`.
    place : str
        Port or topic; every message begins with it.
    limits : ndarray, shape (m, 2) [N] or [m]
    rates : ndarray, shape (m,) [N/s] or [m/s]

    """

    def __init__(self, robot: Robot, mode: str, place: str, limits: Array, rates: Array) -> None:
        """Create a closed driver."""
        self.robot, self.inputs, self.mode, self.place = robot, robot.inputs, mode, place
        self.limits, self.rates = limits, rates
        self._is_open = False
        self._goal: Array = np.zeros(len(self.inputs))  # (m,) what was commanded last
        self._written = self._retried = -np.inf  # monotonic [s]

    def _require_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'{self.place}: {what}: the driver is not open')

    def _chosen(self, inputs: Sequence[str]) -> NDArray[np.bool_]:
        """Return a mask (m,) of the named inputs; none named means all."""
        unknown = [name for name in inputs if name not in self.inputs]
        if unknown:
            raise DriverError(
                f'expected inputs of {", ".join(self.inputs)}, got {", ".join(unknown)}'
            )
        return np.array([not inputs or name in inputs for name in self.inputs])

    def _since_write(self) -> float:
        """Return the time since the last command [s], and restart that clock."""
        now = time.monotonic()
        passed, self._written = now - self._written, now
        return passed

    def _towards(self, command: Array, limits: Array, passed: float) -> Array:
        """Return the next goal (m,): towards a command (m,), within limits and rates."""
        goal = bounded(command, limits)
        rates = self.rates
        if self.mode == 'tension':
            falling = np.maximum(rates, limits[:, 1] / STOP_TIME_MIN_S)
            rates = np.where(goal < self._goal, falling, rates)
        return approach(self._goal, goal, rates * min(passed, WRITE_STEP_MAX_S))

    def _may_retry(self, now: float) -> bool:
        """Return whether it is time for another attempt to reconnect."""
        if now - self._retried < RETRY_PERIOD_S:
            return False
        self._retried = now
        return True


class PortConfig(Protocol):
    """The keys that every configuration of such a driver has."""

    @property
    def port(self) -> str:
        """Path of the port."""

    @property
    def zero(self) -> str:
        """`find` slack at enabling, or `here`: pull 0 is where the wires are."""


class PortLink(Protocol):
    """The port itself."""

    def open(self) -> None:
        """Open it for this process alone."""

    def close(self) -> None:
        """Close it."""


class PortDriver(HardwareDriver):
    """
    Opens a port, identifies the motors and finds the slack of the wires before the first torque.

    Attributes
    ----------
    cancelled : callable
        Called while `enable` searches for slack; a true result ends it.

    """

    config: PortConfig
    read_config: ClassVar[Callable[..., Any]]

    def __init__(
        self, robot: Robot, mode: str, config: PortConfig, link: PortLink, *bounds: Array
    ) -> None:
        """Take limits (m, 2) and rates (m,) last, in the unit of the mode."""
        super().__init__(robot, mode, config.port, *bounds)
        self.config, self.port, self.link = config, config.port, link
        self.cancelled: Callable[[], bool] = lambda: False

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str
    ) -> Self:
        """Make the driver from the content of its configuration file."""
        return cls(robot, cls.read_config(robot, config, mode, source), mode)  # type: ignore

    def open(self) -> None:
        """Open the port for this process alone and identify the motors."""
        self.link.open()
        try:
            self._shake_hands()
        except (DriverError, PortLostError) as error:
            self.link.close()
            raise DriverError(str(error)) from None
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
                failed = MovedError
            self._torque_on()
        except MovedError:
            self.disable()
            raise
        except (DriverError, PortLostError) as error:
            self.disable()
            raise failed(str(error)) from None
        self._start_from_measured()

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
    def _start_from_measured(self) -> None:
        """Let the next command begin at what is measured."""


def fields_of_inputs(
    top: ConfigFields, key: str, what: str, robot: Robot
) -> dict[str, ConfigFields]:
    """
    Return the fields of every input of the robot.

    Parameters
    ----------
    top : ConfigFields
    key : str
        Key of their mapping: `motors`, `tendons`.
    what : str
        What every input needs, for messages: `a motor`.
    robot : Robot

    Raises
    ------
    DriverError
        An input is unknown, or has none.

    """
    mapping = top.child(key)
    mapping.only(*robot.inputs)
    missing = [name for name in robot.inputs if not mapping.has(name)]
    if missing:
        expected = f'{what} for every input of the robot'
        raise top.error(key, expected, f'none for {", ".join(missing)}')
    return {name: mapping.child(name) for name in robot.inputs}


def nearest(item: ConfigFields, top: ConfigFields, key: str) -> ConfigFields:
    """Return the fields of an input where it has a key of its own, else those of the file."""
    return item if item.has(key) else top


def read_spool_radius(item: ConfigFields, top: ConfigFields) -> float:
    """Return the radius of a spool [m]."""
    return nearest(item, top, 'spool_radius').number('spool_radius', 5e-4, 0.2, 'm')


def read_direction(item: ConfigFields, winding: str) -> int:
    """Return 1 where `winding` (what winds the wire, for messages) holds, else -1."""
    value = item.content.get('direction', 1)
    if isinstance(value, bool) or value not in (1, -1):
        raise item.error('direction', f'1 ({winding}) or -1', value)
    return int(value)


def read_pull_limits(fields: ConfigFields, largest: float = PULL_MAX_M) -> tuple[float, float]:
    """Return the lowest and the highest pull [m], within `largest` either way."""
    low, high = fields.vector('pull_limits', 2)
    if not -largest <= low < high <= largest:
        raise fields.error('pull_limits', '[lowest, highest] [m], lowest < highest', [low, high])
    return float(low), float(high)


def read_calibrations(top: ConfigFields, required: bool) -> ConfigFields:
    """
    Open the calibrations: a mapping, or the path of the file that `calibrate` writes.

    Raises
    ------
    DriverError
        The file cannot be read, or is required and not there.

    """
    value = top.content.get('calibration')
    if not isinstance(value, str):
        return ConfigFields(top.source, 'calibration', value)
    file = Path(top.source).parent / value
    if not required and not file.exists():
        return ConfigFields(str(file), '', {})

    def refuse(reason: object) -> TendonRobotError:
        return top.error('calibration', 'a readable YAML file', f'{file}: {reason}')

    text = read_text(file, refuse)
    try:
        return ConfigFields(str(file), '', parse_yaml(text))
    except ValueError as error:
        raise refuse(error) from None


class LineFit(NamedTuple):
    """A line y = intercept + slope x, standard errors of both, and the scatter about it."""

    intercept: float
    slope: float
    intercept_error: float
    slope_error: float
    scatter: float


def fit_line(x: Array, y: Array, noise: float = 0.0) -> LineFit:
    """
    Fit a straight line by least squares, with the standard errors of linear regression.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
    noise : float
        Scatter that is known from elsewhere, where the residuals show less.

    """
    (slope, intercept), factors = np.polyfit(x, y, 1, cov='unscaled')
    residual = y - intercept - slope * x
    scatter = max(float(np.sqrt(residual @ residual / max(1, len(x) - 2))), noise)
    slope_error, intercept_error = (scatter * np.sqrt(np.diag(factors))).tolist()
    return LineFit(float(intercept), float(slope), intercept_error, slope_error, scatter)
