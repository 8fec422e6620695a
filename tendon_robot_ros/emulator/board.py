"""An emulated board: the real firmware; motors, encoders and load cells are emulated."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.words import STANDARD_GRAVITY
from ..drivers.serial_board.messages import CELL_COUNTS_MAX, CHANNEL_FAULTS
from .firmware import Firmware
from .port import COMMON_HELP, Action, Plug
from .rig import TIME_STEP_MAX_S, Arm

STEP_S = 1e-3  # [s] of firmware and physics
SPEED_MAX = 0.1  # [m/s] of the wire at full duty
MOTOR_LAG_S = 0.005  # [s] of the motor
SPEED_DROOP = 0.002  # [m/s per N]
BACKDRIVE_SLOPE = 0.05  # [m/s per N] that a motor without power turns back ...
BACKDRIVE_FRICTION_N = 0.05  # [N] ... above this
SPOOL_RADIUS, TICKS_PER_TURN = 0.01, 2000  # [m] of the spools, ticks per turn
CELL_NOISE_COUNTS = 40.0  # [counts] 1 sd of a load cell


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
        return 2.0 * math.pi * SPOOL_RADIUS / TICKS_PER_TURN

    def power_on(self) -> None:
        """Restart the board: motors off, encoders count from zero."""
        self.firmware.power_on()
        self._time = self._next_sample = 0.0
        self._zero = self.places.copy()

    def advance(self, passed: float) -> None:
        """Let time [s] pass."""
        steps = max(1, round(min(passed, TIME_STEP_MAX_S) / STEP_S))
        for _ in range(steps):
            self._step(min(passed, TIME_STEP_MAX_S) / steps)

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
            noise = self._random.normal(0.0, CELL_NOISE_COUNTS, self.channels)
        ticks = np.rint((self.places - self._zero) / self.metres_per_tick).astype(int).tolist()
        for i, (sensor, cell) in enumerate(zip(self.firmware.sensors, self.cells, strict=True)):
            sensor.fresh = fresh and not cell.broken
            if sensor.fresh:
                force = float(self.tensions[i]) + cell.hung
                counts = cell.zero + force / cell.newtons_per_count + noise[i]
                sensor.cell = max(-CELL_COUNTS_MAX, min(CELL_COUNTS_MAX, round(counts)))
            sensor.ticks = ticks[i]
            sensor.current = min(30000, round(1000.0 * abs(self.firmware.duties[i])))
            sensor.faults = int(self.faults[i])

    def _turn(self, duties: NDArray[np.float64], step: float) -> None:
        on = np.array([self.firmware.enabled >> i & 1 for i in range(self.channels)], dtype=bool)
        driven = duties * SPEED_MAX - SPEED_DROOP * self.tensions
        limp = np.where(
            self.tensions > BACKDRIVE_FRICTION_N, -BACKDRIVE_SLOPE * self.tensions, 0.0
        )
        goal = np.where(on, driven, np.maximum(limp, -SPEED_MAX))
        goal[list(self.blocked)] = 0.0
        self._speeds += min(step / MOTOR_LAG_S, 1.0) * (goal - self._speeds)
        self.places = self.places + self._speeds * step


class EmulatedBoard(Plug):
    """An emulated port with a board."""

    def __init__(self, rig: BoardRig, port: str | None = None) -> None:
        """Plug it in; `start` begins to let time pass."""
        self.rig = rig
        self.deaf = False
        super().__init__('board', port, idle=2.0 * STEP_S)

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


# -----------------------------------------------------------------------------
# Words that do something to the emulated board: faults for a person, or a test, to switch on.

BRIDGE = {code: bit for bit, (code, _) in CHANNEL_FAULTS.items()}
HELP = f"""\
silent | hear         the board neither hears nor answers; it does again
{COMMON_HELP}
restart               the board loses its power for a moment
overheating CHANNEL | voltage CHANNEL   its motor bridge says so; cool CHANNEL: no longer
overload CHANNEL NEWTONS   something pulls at that load cell; overload CHANNEL 0: no longer
block CHANNEL | free CHANNEL   its motor does not turn; it does again
cell CHANNEL | mend CHANNEL   the cable of its load cell is off; it is on again
weight CHANNEL KG     hang a weight on a load cell
state                 print what motors and wires do, as JSON
quit"""


def _deaf(deaf: bool) -> Action:
    def change(line: EmulatedBoard, values: list[str]) -> None:
        line.deaf = deaf

    return change


def _bridge(code: str) -> Action:
    def fail(line: EmulatedBoard, values: list[str]) -> None:
        line.rig.faults[int(values[0])] = BRIDGE.get(code, 0)

    return fail


def _block(blocked: bool) -> Action:
    def change(line: EmulatedBoard, values: list[str]) -> None:
        channel = range(line.rig.channels)[int(values[0])]
        line.rig.blocked -= {channel}
        line.rig.blocked |= {channel} if blocked else set()

    return change


def _cell(broken: bool) -> Action:
    def change(line: EmulatedBoard, values: list[str]) -> None:
        line.rig.cells[int(values[0])].broken = broken

    return change


def _hang(factor: float) -> Action:
    def change(line: EmulatedBoard, values: list[str]) -> None:
        line.rig.cells[int(values[0])].hung = factor * float(values[1])

    return change


def state(line: EmulatedBoard) -> dict[str, object]:
    """Return what motors and wires do, as plain values."""
    rig = line.rig
    return {
        'port': line.port,
        'time': time.monotonic(),
        **getattr(rig.arm, 'shown', {}),
        'enabled': [bool(rig.firmware.enabled >> i & 1) for i in range(rig.channels)],
        'tensions': np.round(rig.tensions, 4).tolist(),
        'highest': np.round(rig.highest, 4).tolist(),
        'wound': np.round(rig.places, 6).tolist(),
        'duties': np.round(rig.firmware.duties, 4).tolist(),
    }


def config(rig: BoardRig, inputs: Sequence[str]) -> dict[str, Any]:
    """Return a configuration for the driver, without its port; the load cells are calibrated."""
    return {
        'spool_radius': SPOOL_RADIUS,
        'ticks_per_turn': TICKS_PER_TURN,
        'pull_limits': [-0.05, 0.05],
        'tension_gain': 0.03,
        'calibration': {
            name: {
                'zero': cell.zero,
                'newtons_per_count': cell.newtons_per_count,
                'scatter': CELL_NOISE_COUNTS,
            }
            for name, cell in zip(inputs, rig.cells, strict=True)
        },
        'tendons': {name: {'channel': i} for i, name in enumerate(inputs)},
    }


ACTIONS: dict[str, Action] = {
    'silent': _deaf(True),
    'hear': _deaf(False),
    'restart': lambda line, values: line.restart(),
    'overheating': _bridge('overheating'),
    'voltage': _bridge('voltage'),
    'cool': _bridge(''),
    'overload': _hang(1.0),
    'block': _block(True),
    'free': _block(False),
    'cell': _cell(True),
    'mend': _cell(False),
    'weight': _hang(STANDARD_GRAVITY),
    'state': lambda line, values: json.dumps(state(line)),
    'help': lambda line, values: HELP,
}
