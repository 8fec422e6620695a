"""The small interface that every driver has: open, close, enable, disable, write, read."""

from __future__ import annotations

import abc
import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from itertools import compress
from typing import Any, NamedTuple, Self

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DriverError, MissingExtraError
from ..common.yaml_reading import ConfigFields
from ..robot import Robot

MODES = ('tension', 'pull')  # in the order of docs/serial_protocol.md, which numbers them
# [s] between two commands where a driver or a check itself moves motors, so that they go as
# smoothly as under a controller at 100 Hz
CYCLE_S = 0.01
# [s] near the command, after which motors have settled: five time constants of a drive of 20 ms,
# so that noise alone does not pass for settled
SETTLED_S = 0.1

# distances of motors in failed searches for slack, by port
_TRAVELLED: dict[str, dict[int, float]] = {}


def travelled(port: str) -> dict[int, float]:
    """
    Return the distances of the motors of a port in searches for slack; clearing resets them.

    The dict belongs to the port and to this process, not to a driver: every attempt, by any driver
    object, counts from the same origin, so that the bound of a search holds for all attempts
    together. Motion by hand or by a spring while the torque is off is not known here: a person
    resets.

    Returns
    -------
    dict of int to float
        Motor (its id or channel) -> signed distance since the first attempt, in the unit of the
        driver (ticks or m).

    """
    return _TRAVELLED.setdefault(port, {})


class Backend(NamedTuple):
    """Where a driver is, what it needs, and the example of its configuration in config/."""

    module: str
    driver: str
    example: str  # may name the {mode}
    extra: str = ''  # that installs what it needs


BACKENDS = {
    'mock': Backend('mock', 'MockDriver', 'mock'),
    'dynamixel': Backend('dynamixel.driver', 'DynamixelDriver', 'dynamixel_{mode}', 'dynamixel'),
    'serial': Backend('serial_board.driver', 'SerialDriver', 'serial_board', 'serial'),
    'ros2_control': Backend('ros2_control', 'Ros2ControlDriver', 'ros2_control'),
}


@dataclass(frozen=True)
class Fault:
    """
    A present fault; it is absent from the next reading when its cause is removed.

    Parameters
    ----------
    code : str
        Short and stable, for programs: `silent`, `port`, `overload`, `overheating`, `voltage`,
        `watchdog`, `encoder`, `limit`, ...
    message : str
        One line for a person: fault, place and remedy.
    hardware : bool
        The motor itself reports the error: its torque goes off at once, without a ramp.
    inputs : tuple of str
        The inputs it concerns; empty means all of them.

    """

    code: str
    message: str
    hardware: bool = False
    inputs: tuple[str, ...] = ()


class FaultBit(IntFlag):
    """A bit of a motor's status: a fault that it latches, and the words for it."""

    words: str

    def __new__(cls, value: int, words: str = '') -> Self:
        """Take the bit and its words."""
        bit = int.__new__(cls, value)
        bit._value_, bit.words = value, words
        return bit


def latched(
    where: str, bits: type[FaultBit], status: int, inputs: tuple[str, ...]
) -> Iterator[Fault]:
    """
    Yield the faults that a motor has latched, by the bits of its status.

    Parameters
    ----------
    where : str
        Port and motor; every message begins with it.
    bits : FaultBit
        Those of this kind of motor.
    status : int
    inputs : tuple of str
        Those that the motor winds.

    """
    for bit in bits:
        if status & bit:
            message = f'{where}: {bit.words}; torque is off; remove the cause, then reboot it'
            yield Fault(str(bit.name).lower(), message, True, inputs)


@dataclass(frozen=True)
class Reading:
    """
    Measured state of the motors at one time.

    Parameters
    ----------
    time : float
        `time.monotonic()` of the answer [s].
    pulls : ndarray, shape (m,) [m]
        Wire pull per input, positive = shorter = pulled; nan without an answer.
    tensions : ndarray, shape (m,) [N]
        Tension per input; nan where it is not observable.
    source : str
        Source of the tension: `load_cell`, `current` or `command`.
    tension_sd : ndarray, shape (m,) [N], optional
        Standard uncertainty of the tensions, None where it is not stated.
    faults : tuple of Fault
        Present faults.

    """

    time: float
    pulls: Floats
    tensions: Floats
    source: str
    tension_sd: Floats | None = None
    faults: tuple[Fault, ...] = ()


class Driver(abc.ABC):
    """
    Motors behind the inputs of one robot.

    The life of a driver is open, enable, (write, read) many times, disable, close; one thread uses
    it. Faults of the running hardware never raise: `read` reports them, in bounded time, and
    tries to restore a lost connection. A driver that restores it starts from the measured state.
    Misuse (not open, wrong shape, not finite) raises `DriverError`.

    Attributes
    ----------
    robot : Robot
        The robot whose inputs are driven.
    inputs : tuple of str, length m
        Names of the inputs, in the robot's order.
    mode : str
        `tension` [N] or `pull` [m]: quantity that `write` commands.
    limits : ndarray, shape (m, 2)
        Lowest and highest command per input, in the unit of the mode.
    rates : ndarray, shape (m,)
        Largest change of the command per second, in the unit of the mode.
    port : str
        Path of the serial port, empty where there is none.
    limits_current : bool
        Whether `limit_current` has an effect: motors that hold their position by current.

    """

    robot: Robot
    inputs: tuple[str, ...]
    mode: str
    limits: Floats
    rates: Floats
    port: str = ''
    limits_current: bool = False

    @abc.abstractmethod
    def open(self) -> None:
        """Open the port and shake hands; torque stays off. Raise DriverError when it fails."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close the port; never raises, may be called twice. Torque does not change."""

    @abc.abstractmethod
    def enable(self) -> None:
        """Torque on, holding the measured state: no jump. Raise DriverError when refused."""

    @abc.abstractmethod
    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once for the named inputs, or all. Never raises: `read` reports faults."""

    @abc.abstractmethod
    def write(self, command: Floats) -> None:
        """Command every input, shape (m,) [N] or [m], kept within limits and rates."""

    def limit_current(self, reduction: float, tension: float) -> None:
        """
        Reduce the current limit of the motors in pull mode, from the next command on.

        Without `limits_current` this has no effect.

        Parameters
        ----------
        reduction : float
            0: a motor holds up to its limit; 1: no wire with more than `tension`; between them a
            fraction of the range from its current when the reduction was last 0.
        tension : float
            [N]

        """
        return

    @abc.abstractmethod
    def read(self) -> Reading:
        """Return the present state and faults; inputs that do not answer are nan."""

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Restart the named motors, or all, after a hardware error; leaves torque off."""
        raise DriverError(f'{type(self).__name__}: reboot: this kind of motor has no reboot')

    def reset(self) -> None:
        """Reset the bound of searches for slack, after a check of the wires; moves nothing."""
        travelled(self.port).clear()

    def describe(self) -> dict[str, str]:
        """Return facts for diagnostics: names and values as text, with units."""
        return {}

    def strength(self) -> str:
        """Return as text up to which tension motors wind and hold; empty: to the limits."""
        return ''

    def silence(self) -> str:
        """Return as text after which silence the motors stop, and why; empty where unknown."""
        return ''

    def checked(self, command: Floats) -> Floats:
        """Return the command as an array; refuse a wrong shape or a value that is not finite."""
        values = np.asarray(command, dtype=float)
        if values.shape != (len(self.inputs),):
            raise DriverError(
                f'{type(self).__name__}: write: expected {len(self.inputs)} values for '
                f'{", ".join(self.inputs)}, got shape {values.shape}'
            )
        if not np.all(np.isfinite(values)):
            bad = ', '.join(compress(self.inputs, ~np.isfinite(values)))
            raise DriverError(
                f'{type(self).__name__}: write: expected finite values, got '
                f'nan or inf for {bad}; nothing was sent'
            )
        return values

    def __enter__(self) -> Self:
        """Open the driver."""
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        """Torque off, then close."""
        self.disable()
        self.close()


def make_driver(
    backend: str,
    robot: Robot,
    config: Mapping[str, Any],
    *,
    mode: str = 'tension',
    source: str = 'driver',
    **parts: Any,
) -> Driver:
    """
    Make a driver that is not open yet; imports only the chosen backend.

    Parameters
    ----------
    backend : str
        `mock`, `dynamixel`, `serial` or `ros2_control`.
    robot : Robot
        Gives the inputs and the tension limits.
    config : mapping
        Content of the backend's configuration file (its document in docs/).
    mode : str
        `tension` or `pull`.
    source : str
        Names the configuration in messages, usually its path.
    **parts
        Further objects of a backend: the mock takes `plant`, ros2_control `link`.

    Raises
    ------
    DriverError
        Unknown backend or mode, or a configuration the backend refuses.
    MissingExtraError
        The backend's package is not installed.

    """
    given = ConfigFields(source, '', {'backend': backend, 'command_mode': mode})
    chosen = BACKENDS[given.choice('backend', tuple(BACKENDS))]
    given.choice('command_mode', MODES)
    try:
        kind = getattr(importlib.import_module(f'.{chosen.module}', __package__), chosen.driver)
    except ModuleNotFoundError as error:
        missing, own = error.name or '', __name__.split('.')[0]
        if chosen.extra and missing.split('.')[0] != own:
            raise MissingExtraError(missing, chosen.extra) from None
        raise
    driver: Driver = kind.from_config(robot, config, mode=mode, source=source, **parts)
    return driver
