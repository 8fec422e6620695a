"""An emulated board: the real firmware; motors, encoders and load cells are emulated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arm import Arm
from .faults import Faults
from .firmware import Firmware
from .plug import Plug

STEP = 1e-3  # [s] of firmware and physics
LONGEST = 0.1  # [s]; after a longer pause of this process the emulated world skips time
TOP_SPEED = 0.1  # [m/s] of the wire at full duty
LAG = 0.005  # [s] of the motor
DROOP = 0.002  # [m/s per N]
BACKDRIVE = 0.05  # [m/s per N] that a motor without power turns back ...
FRICTION = 0.05  # [N] ... above this
RADIUS, TICKS = 0.01, 2000  # [m] of the spools, ticks per turn
NOISE = 40.0  # [counts] 1 sd of a load cell
SATURATED = 0x7FFFFF


@dataclass
class CellModel:
    """A load cell and its converter: counts = zero + tension / newtons_per_count."""

    zero: float
    newtons_per_count: float
    hung: float = 0.0  # [N] weight hung on it for a calibration
    broken: bool = False  # its cable is off


class BoardRig:
    """Firmware, motors, load cells and wires of one arm."""

    def __init__(self, arm: Arm, channels: int, sample_rate: float = 80.0, seed: int = 0) -> None:
        """Take the arm and the number of its wires; load cells are sampled at a rate [Hz]."""
        self.arm, self.channels, self.sample_rate = arm, channels, sample_rate
        self.firmware = Firmware(channels)
        self.cells = [CellModel(8000.0 + 500.0 * i, 6e-6 + 1e-7 * i) for i in range(channels)]
        self.faults = np.zeros(channels, dtype=int)  # bits that the bridges report now
        self.blocked: set[int] = set()
        self.places = np.zeros(channels)  # [m] of wire wound
        self._zero = np.zeros(channels)  # [m] where the encoders began to count
        self.tensions = np.zeros(channels)  # [N]
        self.highest = np.zeros(channels)  # [N] seen since the start
        self._speeds = np.zeros(channels)
        self._random = np.random.default_rng(seed)
        self._time, self._next_sample = 0.0, 0.0

    @property
    def metres_per_tick(self) -> float:
        """Wire per tick of the encoders [m]."""
        return 2.0 * math.pi * RADIUS / TICKS

    def power_on(self) -> None:
        """Restart the board: motors off, encoders count from zero."""
        self.firmware.power_on()
        self._time = self._next_sample = 0.0
        self._zero = self.places.copy()

    def advance(self, passed: float) -> None:
        """Let time [s] pass."""
        steps = max(1, round(min(passed, LONGEST) / STEP))
        for _ in range(steps):
            self._step(min(passed, LONGEST) / steps)

    def _step(self, step: float) -> None:
        self.tensions = self.arm.tensions(self.places, step)
        self.highest = np.maximum(self.highest, self.tensions)
        self._time += step
        self._sense()
        self.firmware.step(round(1e6 * self._time))
        self._turn(np.array(self.firmware.duties), step)

    def _sense(self) -> None:
        fresh = self._time >= self._next_sample
        if fresh:
            self._next_sample = self._time + 1.0 / self.sample_rate
            noise = self._random.normal(0.0, NOISE, self.channels)
        ticks = np.rint((self.places - self._zero) / self.metres_per_tick).astype(int).tolist()
        for i, (sensor, cell) in enumerate(zip(self.firmware.sensors, self.cells, strict=True)):
            sensor.fresh = fresh and not cell.broken
            if sensor.fresh:
                force = float(self.tensions[i]) + cell.hung
                counts = cell.zero + force / cell.newtons_per_count + noise[i]
                sensor.cell = max(-SATURATED, min(SATURATED, round(counts)))
            sensor.ticks = ticks[i]
            sensor.current = min(30000, round(1000.0 * abs(self.firmware.duties[i])))
            sensor.faults = int(self.faults[i])

    def _turn(self, duties: NDArray[np.float64], step: float) -> None:
        on = np.array([self.firmware.enabled >> i & 1 for i in range(self.channels)], dtype=bool)
        driven = duties * TOP_SPEED - DROOP * self.tensions
        limp = np.where(self.tensions > FRICTION, -BACKDRIVE * self.tensions, 0.0)
        goal = np.where(on, driven, np.maximum(limp, -TOP_SPEED))
        goal[list(self.blocked)] = 0.0
        self._speeds += min(step / LAG, 1.0) * (goal - self._speeds)
        self.places = self.places + self._speeds * step


class BoardLine(Plug):
    """An emulated port with a board."""

    def __init__(self, rig: BoardRig, port: str | None = None) -> None:
        """Plug it in; `start` begins to let time pass."""
        self.rig, self.faults = rig, Faults()
        self.deaf = False
        super().__init__('board', port, idle=2.0 * STEP)

    def restart(self) -> None:
        """Take the power of the board away for a moment."""
        with self._lock:
            self.rig.power_on()

    def _let_time_pass(self, passed: float) -> None:
        self.rig.advance(passed)
        answer = self.rig.firmware.take()
        if not self.deaf:
            self._send(self.faults.on_the_way(answer))

    def _hear(self, data: bytes) -> None:
        if not self.deaf:
            self.rig.firmware.receive(data)

    def _plugged(self) -> None:
        self.rig.firmware.receive(b'\0')
