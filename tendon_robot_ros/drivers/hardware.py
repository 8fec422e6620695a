"""What drivers of real motors share: ports, commands within limits and rates, configuration."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError, MovedError, TendonRobotError
from ..common.files import read_text
from ..common.yaml_reading import ConfigFields, parse_yaml
from ..robot import Robot
from .interface import Array, Driver
from .ports import PortLostError
from .safety import STOP_TIME_MIN_S, approach, bounded

WRITE_STEP_MAX_S = 0.1  # [s]; after a pause the command does not catch up
RETRY_PERIOD_S = 0.2  # [s] between two attempts to get a port or a motor back


class HardwareDriver(Driver):
    """
    A driver of real motors: it is open or not, and its command moves within limits and rates.

    Tensions rise at the rates; they may fall faster, because a stop lets go of them.

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
        """Begin closed."""
        self.robot, self.inputs, self.mode, self.place = robot, robot.inputs, mode, place
        self.limits, self.rates = limits, rates
        self._is_open = False
        self._goal: Array = np.zeros(len(self.inputs))  # (m,) what was commanded last
        self._written = self._retried = -np.inf  # monotonic [s]

    def _require_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'{self.place}: {what}: the driver is not open')

    def _chosen(self, inputs: Sequence[str]) -> NDArray[np.bool_]:
        """Return which inputs are named, (m,); none named means all."""
        unknown = [name for name in inputs if name not in self.inputs]
        if unknown:
            raise DriverError(
                f'expected inputs of {", ".join(self.inputs)}, got {", ".join(unknown)}'
            )
        return np.array([not inputs or name in inputs for name in self.inputs])

    def _since_write(self) -> float:
        """Return how long ago the last command came [s], and begin anew."""
        now = time.monotonic()
        passed, self._written = now - self._written, now
        return passed

    def _towards(self, wanted: Array, limits: Array, passed: float) -> Array:
        """Return the next goal (m,): towards what is wanted, within limits and rates."""
        goal = bounded(wanted, limits)
        rates = self.rates
        if self.mode == 'tension':
            falling = np.maximum(rates, limits[:, 1] / STOP_TIME_MIN_S)
            rates = np.where(goal < self._goal, falling, rates)
        return approach(self._goal, goal, rates * min(passed, WRITE_STEP_MAX_S))

    def _may_retry(self, now: float) -> bool:
        """Whether it is time to look again for what was lost; the next time is later."""
        if now - self._retried < RETRY_PERIOD_S:
            return False
        self._retried = now
        return True


# -----------------------------------------------------------------------------
# Motors behind a serial port, which may go and come back.


class PortConfig(Protocol):
    """What the configuration of such a driver says at least."""

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
        """Give it back."""


class PortDriver(HardwareDriver):
    """
    Opens a port, asks who is there, finds the slack of the wires before their first torque.

    Attributes
    ----------
    cancelled : callable
        Asked while `enable` looks for slack; a true answer ends it.

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
        """Make the driver from what its configuration file says."""
        return cls(robot, cls.read_config(robot, config, mode, source), mode)  # type: ignore

    def open(self) -> None:
        """Open the port for this process alone and ask who is there."""
        self.link.open()
        try:
            self._shake_hands()
        except (DriverError, PortLostError) as error:
            self.link.close()
            raise DriverError(str(error)) from None
        self._is_open = True

    def close(self) -> None:
        """Give the port back; what the motors do then is up to their watchdogs."""
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
        """Check who is behind the open port, and read where the wires are."""

    def _check_motors(self) -> None:
        """Refuse to go on with motors that latched a fault."""

    @abstractmethod
    def _slack_unknown(self) -> bool:
        """Whether it is not known where pull is zero."""

    @abstractmethod
    def _find_slack(self) -> None:
        """Wind every wire until it is taut; MovedError where that fails after a motor moved."""

    @abstractmethod
    def _torque_on(self) -> None:
        """Switch all motors on, where they are."""

    @abstractmethod
    def _start_from_measured(self) -> None:
        """Let the next command begin at what is measured."""


# -----------------------------------------------------------------------------
# What the configuration files of all drivers say: motors of inputs, spools, limits, calibration.


def fields_of_inputs(
    top: ConfigFields, key: str, what: str, robot: Robot
) -> dict[str, ConfigFields]:
    """
    Return the fields of every input of the robot.

    Parameters
    ----------
    top : ConfigFields
    key : str
        Where they stand: `motors`, `tendons`.
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


def read_pull_limits(fields: ConfigFields, largest: float) -> tuple[float, float]:
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
