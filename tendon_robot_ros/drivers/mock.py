"""A driver without hardware: it moves a plant, with lag, sensor noise and faults on request."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np

from ..common.arrays import Bools, Floats
from ..common.errors import DriverError, TendonRobotError
from ..common.yaml_reading import ConfigFields, in_range, one_of
from ..robot import Robot
from .hardware import HardwareDriver
from .interface import Fault, Reading

# what can be injected -> (message, reported by the motor itself, readings are lost)
FAULTS = {
    'silent': ('{who}: no answer; check cable and supply', False, True),
    'port': ('{who}: the port is gone; plug it in again', False, True),
    'overheating': ('{who}: overheating; let it cool, then reset', True, False),
    'overload': ('{who}: overload; relieve the tendon, then reset', True, False),
}


@dataclass(frozen=True)
class MockConfig:
    """Configuration of a mock."""

    # first-order, of motor and arm
    lag: Annotated[float, in_range(0.0, 10.0, 's')] = 0.02
    # 1 sd of each
    tension_noise: Annotated[float, in_range(0.0, 10.0, 'N')] = 0.0
    pull_noise: Annotated[float, in_range(0.0, 10.0, 'm')] = 0.0
    tension_source: Annotated[str, one_of('load_cell', 'command')] = 'load_cell'
    seed: Annotated[int, lambda one, key: one.whole(key, 0, 2**32 - 1)] = 0


class MockDriver(HardwareDriver):
    """
    Moves a plant instead of motors.

    The plant is any object with `respond(tensions)` and `respond_to_pulls(pulls)`, (m,) [N] or
    [m], nan = slack. Both return a state with `inputs` (m,) [N] and `pulls` (m,) [m], as `Shape`.
    The motors lag by the time of `clock` [s].
    """

    clock = staticmethod(time.monotonic)

    def __init__(
        self, robot: Robot, plant: Any, config: MockConfig | None = None, mode: str = 'tension'
    ) -> None:
        """Take the plant; it starts straight and slack."""
        m = len(robot.inputs)
        pull_max = 2.0 * math.pi * max(max(map(abs, (*t.base, *t.end))) for t in robot.tendons)
        limits = robot.tension_limits if mode == 'tension' else (-pull_max, pull_max)
        super().__init__(robot, mode, 'MockDriver', np.tile(limits, (m, 1)), np.full(m, np.inf))
        self.config, self.plant = config or MockConfig(), plant
        self._random = np.random.default_rng(self.config.seed)
        self._on, self._actual = np.zeros(m, dtype=bool), np.zeros(m)
        self._updated = self.clock()
        self._injected: dict[str, Fault] = {}
        self.truth: Any = None  # the arm as it is, for a mock tracker and for tests, once it moved
        self._given: Floats | None = None  # what the plant last responded to
        self._problem = ''

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str, plant: Any
    ) -> Self:
        """Make the driver from its configuration."""
        return cls(robot, plant, ConfigFields(source, '', dict(config)).read(MockConfig), mode)

    def open(self) -> None:
        """Read the plant once."""
        if 'port' in self._injected:
            raise DriverError(self._injected['port'].message)
        self._is_open = True
        self._updated = self.clock()
        self._advance()

    def close(self) -> None:
        """Forget the port."""
        self._is_open = False

    def enable(self) -> None:
        """Torque on, holding the measured state."""
        self._require_open('enable')
        if hard := [fault.message for fault in self._injected.values() if fault.hardware]:
            raise DriverError('enable: ' + '; '.join(hard))
        self._advance()
        if self.mode == 'pull' and self.truth is not None:
            self._actual = np.where(self._on, self._actual, self.truth.pulls)
        self._goal = self._actual.copy()
        self._on[:] = True

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off: the wire goes slack."""
        self._advance()
        self._on &= ~self._chosen(inputs)

    def write(self, command: Floats) -> None:
        """Command every input; what is off stays off."""
        self._require_open('write')
        values = self.checked(command)
        self._advance()
        received = np.clip(values, np.minimum(self._goal, self.limits[:, 0]), self.limits[:, 1])
        self._goal = np.where(self._lost(), self._goal, received)

    def read(self) -> Reading:
        """Return the plant's state with noise."""
        self._require_open('read')
        self._advance()
        state, lost = self.truth, self._lost()
        pulls, tensions = np.zeros((2, len(self.inputs)))
        if state is not None:
            pulls = self._random.normal(state.pulls, self.config.pull_noise)
            tensions = self._random.normal(state.inputs, self.config.tension_noise)
        if self.config.tension_source == 'command':
            command = np.where(self._on, self._goal, 0.0)
            tensions = command if self.mode == 'tension' else np.full_like(pulls, np.nan)
        problem = [Fault('plant', self._problem)] if self._problem else []
        sd = np.full_like(pulls, self.config.tension_noise)
        return Reading(
            time=time.monotonic(),
            pulls=np.where(lost, np.nan, pulls),
            tensions=np.where(lost, np.nan, tensions),
            source=self.config.tension_source,
            tension_sd=sd if self.config.tension_source == 'load_cell' else None,
            faults=(*self._injected.values(), *problem),
        )

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Clear the injected hardware errors; torque is off."""
        self.disable(inputs)
        self._injected = {k: f for k, f in self._injected.items() if not f.hardware}

    def inject(self, code: str, inputs: Sequence[str] = ()) -> None:
        """Inject a fault: a key of `FAULTS`, for some inputs or all."""
        if code not in FAULTS:
            raise DriverError(f'fault: expected one of {", ".join(FAULTS)}, got {code!r}')
        self._chosen(inputs)  # refuses unknown ones
        message, hardware, _ = FAULTS[code]
        who = ', '.join(inputs) or 'all motors'
        fault = Fault(code, message.format(who=who), hardware, tuple(inputs))
        self._injected = {**self._injected, code: fault}  # another thread may be reading the old

    def clear(self) -> None:
        """Clear all injected faults."""
        self._injected = {}

    def describe(self) -> dict[str, str]:
        """Facts for diagnostics."""
        return {
            'backend': 'mock',
            'lag (s)': f'{self.config.lag:g}',
            'tension_noise (N)': f'{self.config.tension_noise:g}',
        }

    def _lost(self) -> Bools:
        lost = [fault for code, fault in self._injected.items() if FAULTS[code][2]]
        names = [name for fault in lost for name in fault.inputs or self.inputs]
        return np.isin(self.inputs, names)

    def _advance(self) -> None:
        """Let the motors follow their command since the last call, and the arm the motors."""
        now = self.clock()
        passed, self._updated = max(now - self._updated, 0.0), now
        part = 1.0 if self.config.lag <= 0.0 else -math.expm1(-passed / self.config.lag)
        goal = np.where(self._on, self._goal, 0.0)
        self._actual = self._actual + part * (goal - self._actual)
        self._actual = np.where(np.abs(self._actual - goal) < 1e-9, goal, self._actual)
        inputs = self._actual.copy()
        if self.mode == 'pull':
            inputs[~self._on] = np.nan  # slack
        if self._given is not None and np.array_equal(inputs, self._given, equal_nan=True):
            return
        self._given = inputs
        respond = self.plant.respond if self.mode == 'tension' else self.plant.respond_to_pulls
        try:
            self.truth, self._problem = respond(inputs), ''
        except TendonRobotError as error:  # the arm stays where it is, the reading says why
            self._problem = f'mock arm: {error}'
