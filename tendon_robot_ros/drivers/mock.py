"""A driver without hardware: it moves a plant, with lag, sensor noise and faults on request."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError, TendonRobotError
from ..robot import Robot
from .interface import MODES, Driver, Fault, Reading

Array = NDArray[np.float64]
# what can be injected -> (message, reported by the motor itself, readings are lost)
FAULTS = {
    'silent': ('{who}: no answer; check cable and supply', False, True),
    'port': ('{who}: the port is gone; plug it in again', False, True),
    'overheating': ('{who}: overheating; let it cool, then reset', True, False),
    'overload': ('{who}: overload; relieve the tendon, then reset', True, False),
}


class PlantState(Protocol):
    """State of a plant's arm: a `Shape`, or anything with the same fields."""

    inputs: Array  # (m,) [N]
    pulls: Array  # (m,) [m]


class MockPlant(Protocol):
    """An arm to be moved; the driver does not know how it works."""

    def respond(self, tensions: Array) -> PlantState:
        """Return the arm under these tensions, (m,) [N]."""

    def respond_to_pulls(self, pulls: Array) -> PlantState:
        """Return the arm under these wire pulls, (m,) [m], nan = slack."""


@dataclass(frozen=True)
class MockConfig:
    """Configuration of a mock."""

    lag: float = 0.02  # [s] first-order, of motor and arm
    tension_noise: float = 0.0  # [N] 1 sd
    pull_noise: float = 0.0  # [m] 1 sd
    tension_source: str = 'load_cell'
    seed: int = 0

    @classmethod
    def checked(cls, config: Mapping[str, Any], source: str) -> Self:
        """Read a mapping; unknown keys and impossible values are refused."""
        known = [field.name for field in fields(cls)]
        for key in config:
            if key not in known:
                raise DriverError(f'{source}: expected one of {", ".join(known)}, got {key!r}')
        parsed = cls(**config)
        for key in ('lag', 'tension_noise', 'pull_noise'):
            value = getattr(parsed, key)
            if not (isinstance(value, (int, float)) and 0.0 <= value < 10.0):
                raise DriverError(
                    f'{source}: {key}: expected a number from 0 to 10, got {value!r}'
                )
        if parsed.tension_source not in ('load_cell', 'command'):
            raise DriverError(
                f'{source}: tension_source: expected load_cell or command, '
                f'got {parsed.tension_source!r}'
            )
        return parsed


class MockDriver(Driver):
    """Moves a plant instead of motors."""

    def __init__(
        self,
        robot: Robot,
        plant: MockPlant,
        config: MockConfig | None = None,
        mode: str = 'tension',
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Take the plant; it starts straight and slack."""
        if mode not in MODES:
            raise DriverError(f'mode: expected one of {", ".join(MODES)}, got {mode!r}')
        self.robot, self.inputs, self.mode = robot, robot.inputs, mode
        m = len(self.inputs)
        self.config = config or MockConfig()
        pull_max = 2.0 * math.pi * max(max(map(abs, (*t.base, *t.end))) for t in robot.tendons)
        limits = robot.tension_limits if mode == 'tension' else (-pull_max, pull_max)
        self.limits = np.tile(np.array(limits, dtype=float), (m, 1))
        self.rates = np.full(m, np.inf)
        self.plant, self._clock = plant, clock
        self._random = np.random.default_rng(self.config.seed)
        self._is_open, self._on = False, np.zeros(m, dtype=bool)
        self._command, self._actual = np.zeros(m), np.zeros(m)
        self._updated = clock()
        self._injected: dict[str, Fault] = {}
        self._state: PlantState | None = None
        self._given: Array | None = None  # what the plant last responded to
        self._problem = ''

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str, plant: MockPlant
    ) -> Self:
        """Make the driver from its configuration."""
        return cls(robot, plant, MockConfig.checked(config, source), mode)

    @property
    def truth(self) -> PlantState | None:
        """The arm as it is, for a mock tracker and for tests."""
        return self._state

    def open(self) -> None:
        """Read the plant once."""
        if 'port' in self._injected:
            raise DriverError(self._injected['port'].message)
        self._is_open = True
        self._updated = self._clock()
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
        if self.mode == 'pull' and self._state is not None:
            self._actual = np.where(self._on, self._actual, self._state.pulls)
        self._command = self._actual.copy()
        self._on[:] = True

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off: the wire goes slack."""
        self._advance()
        for name in inputs or self.inputs:
            self._on[self.inputs.index(name)] = False

    def write(self, command: Array) -> None:
        """Command every input; what is off stays off."""
        self._require_open('write')
        values = self.checked(command)
        self._advance()
        lowest = np.minimum(self._command, self.limits[:, 0])
        received = np.clip(values, lowest, self.limits[:, 1])
        self._command = np.where(self._lost(), self._command, received)

    def read(self) -> Reading:
        """Return the plant's state with noise."""
        self._require_open('read')
        self._advance()
        state, lost = self._state, self._lost()
        pulls, tensions = np.zeros((2, len(self.inputs)))
        if state is not None:
            pulls = np.array(state.pulls) + self._noise(self.config.pull_noise)
            tensions = np.array(state.inputs) + self._noise(self.config.tension_noise)
        if self.config.tension_source == 'command':
            command = np.where(self._on, self._command, 0.0)
            tensions = command if self.mode == 'tension' else np.full_like(pulls, np.nan)
        problem = [Fault('plant', self._problem)] if self._problem else []
        sd = self.config.tension_noise if self.config.tension_source == 'load_cell' else None
        return Reading(
            time=time.monotonic(),
            pulls=np.where(lost, np.nan, pulls),
            tensions=np.where(lost, np.nan, tensions),
            source=self.config.tension_source,
            tension_sd=None if sd is None else np.full_like(pulls, sd),
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
        for name in inputs:
            if name not in self.inputs:
                raise DriverError(
                    f'fault: expected inputs of {", ".join(self.inputs)}, got {name!r}'
                )
        message, hardware, _ = FAULTS[code]
        who = ', '.join(inputs) or 'all motors'
        self._injected[code] = Fault(code, message.format(who=who), hardware, tuple(inputs))

    def clear(self) -> None:
        """Clear all injected faults."""
        self._injected.clear()

    def describe(self) -> dict[str, str]:
        """Facts for diagnostics."""
        return {
            'backend': 'mock',
            'lag (s)': f'{self.config.lag:g}',
            'tension_noise (N)': f'{self.config.tension_noise:g}',
        }

    def _lost(self) -> NDArray[np.bool_]:
        lost = np.zeros(len(self.inputs), dtype=bool)
        for code, fault in self._injected.items():
            if FAULTS[code][2]:
                names = fault.inputs or self.inputs
                lost |= np.isin(self.inputs, names)
        return lost

    def _noise(self, sd: float) -> Array:
        if sd > 0.0:
            return self._random.normal(0.0, sd, len(self.inputs))
        return np.zeros(len(self.inputs))

    def _require_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'MockDriver: {what}: the driver is not open; call open() first')

    def _advance(self) -> None:
        """Let the motors follow their command since the last call, and the arm the motors."""
        now = self._clock()
        passed, self._updated = max(now - self._updated, 0.0), now
        part = 1.0 if self.config.lag <= 0.0 else -math.expm1(-passed / self.config.lag)
        goal = np.where(self._on, self._command, 0.0)
        before = self._actual
        self._actual = before + part * (goal - before)
        near = np.abs(self._actual - goal) < 1e-9
        self._actual = np.where(near, goal, self._actual)
        inputs = self._actual.copy()
        if self.mode == 'pull':
            inputs[~self._on] = np.nan  # slack
        if self._given is not None:
            same = inputs == self._given
            if same.all() or (same | (np.isnan(inputs) & np.isnan(self._given))).all():
                return
        self._given = inputs
        respond = self.plant.respond if self.mode == 'tension' else self.plant.respond_to_pulls
        try:
            self._state, self._problem = respond(inputs), ''
        except TendonRobotError as error:  # the arm stays where it is, the reading says why
            self._problem = f'mock arm: {error}'
