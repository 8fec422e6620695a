"""
An emulated board: the real firmware; motors, encoders and load cells are emulated.

The reference firmware is compiled for this computer, so that the driver talks to the real thing.
"""

from __future__ import annotations

import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..common.errors import DriverError
from ..common.files import shared_file
from ..common.words import STANDARD_GRAVITY
from ..drivers.hardware import Spool
from ..drivers.serial_board.messages import ChannelFault, Protocol
from .port import COMMON_HELP, Command, Plug
from .rig import Arm
from .servo import STEP_S

SOURCES = ('protocol.c', 'control.c', 'board.c', 'host.c')
OUTBOX_BYTES = 8192  # [bytes] OUTBOX of firmware/host.c, else it would write behind this buffer


class Sensors(ctypes.Structure):
    """`struct sensors` of firmware/control.h."""

    _fields_ = (
        ('cell', ctypes.c_int32),
        ('fresh', ctypes.c_bool),
        ('ticks', ctypes.c_int32),
        ('current', ctypes.c_int16),
        ('faults', ctypes.c_uint16),
    )


def compiler() -> str | None:
    """Find a C compiler: $CC, cc, gcc or clang."""
    names = (os.environ.get('CC', ''), 'cc', 'gcc', 'clang')
    return next((path for name in names if name and (path := shutil.which(name))), None)


@functools.cache
def compiled_firmware(channels: int) -> bytes:
    """
    Compile the firmware of a board with so many channels; return the library for this computer.

    Raises
    ------
    DriverError
        The sources or a C compiler are missing, or it refuses.

    """
    if (found := shared_file(f'firmware/{SOURCES[0]}')) is None:
        raise DriverError('the folder firmware is missing; install the package again')
    source, cc = found.parent, compiler()
    if cc is None:
        raise DriverError('no C compiler for the emulated board; type: sudo apt install gcc')
    with tempfile.TemporaryDirectory(prefix='tendon_robot_ros_') as folder:
        output = Path(folder, 'board.so')
        command = [cc, '-std=c99', '-O2', '-fPIC', '-shared', f'-DCHANNELS={channels}']
        command += [str(source / part) for part in SOURCES] + ['-o', str(output)]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode:
            raise DriverError(f'{source}: {cc}: {(run.stderr.splitlines() or ["failed"])[0]}')
        return output.read_bytes()


class Firmware:
    """
    The firmware of one board, with bytes and sensors given by the caller.

    Attributes
    ----------
    channels : int
    duties : list of float
        Of the motors, -1 to 1.
    enabled : int
        Bit mask of the motors that are on.

    """

    def __init__(self, channels: int) -> None:
        """Switch a board with so many channels on."""
        self.channels = channels
        # a library of its own: the board's memory is that of the library
        with tempfile.TemporaryDirectory(prefix='tendon_robot_ros_') as folder:
            own = Path(folder, 'board.so')
            own.write_bytes(compiled_firmware(channels))
            self._library = ctypes.CDLL(str(own))
        pointer = ctypes.c_void_p
        self._library.host_step.argtypes = pointer, ctypes.c_uint32, pointer, pointer
        self._duties = (ctypes.c_float * channels)()
        self._enabled = ctypes.c_uint8()
        self._outbox = ctypes.create_string_buffer(OUTBOX_BYTES)
        self.sensors = (Sensors * channels)()
        self.power_on()

    def power_on(self) -> None:
        """Start anew: everything off, nothing known."""
        self._library.host_power_on()
        self.duties, self.enabled = [0.0] * self.channels, 0

    def receive(self, data: bytes) -> None:
        """Pass received bytes to the firmware."""
        self._library.host_receive(data, len(data))

    def step(self, now: int) -> None:
        """Let its clock go to `now` [µs] with the present `sensors`."""
        self._library.host_step(
            self.sensors, now & 0xFFFFFFFF, self._duties, ctypes.byref(self._enabled)
        )
        self.duties, self.enabled = list(self._duties), self._enabled.value

    def take(self) -> bytes:
        """Return the bytes that the firmware sends."""
        size = self._library.host_take(self._outbox)
        return self._outbox.raw[:size]


class Gearmotor(NamedTuple):
    """
    The motor, encoder and spool behind every wire, and what a load cell adds.

    No product: it winds 0.1 m/s without load and stalls at 50 N.
    """

    speed: float = 0.1  # [m/s] of the wire at full duty, without load
    droop: float = 0.002  # [m/s per N] slower under load
    lag: float = 0.005  # [s] first-order
    backdrive: float = 0.05  # [m/s per N] with which a load turns it back without power ...
    friction: float = 0.05  # [N] ... above this
    spool: Spool = Spool(radius=0.01, direction=1, ticks_per_turn=2000)
    cell_noise: float = 40.0  # [counts] 1 sd of a load cell
    cell_rate: float = 80.0  # [Hz] at which its converter samples


@dataclass
class CellModel:
    """A load cell and its converter: counts = zero + tension / newtons_per_count."""

    zero: float
    newtons_per_count: float
    hung: float = 0.0  # [N] weight hung on it for a calibration
    broken: bool = False  # its cable is off


class BoardRig:
    """Firmware, motors, load cells and wires of one arm."""

    def __init__(self, arm: Arm, channels: int) -> None:
        """Take the arm and the number of its wires."""
        self.arm, self.channels = arm, channels
        self.motor = Gearmotor()
        self.firmware = Firmware(channels)
        self.cells = [CellModel(8000.0 + 500.0 * i, 6e-6 + 1e-7 * i) for i in range(channels)]
        self.faults = np.zeros(channels, dtype=int)  # bits that the bridges report now
        self.blocked: set[int] = set()
        self.places = np.zeros(channels)  # [m] of wire wound
        self._zero = np.zeros(channels)  # [m] where the encoders began to count
        self.tensions = np.zeros(channels)  # [N]
        self.highest = np.zeros(channels)  # [N] since the start
        self._speeds = np.zeros(channels)
        self._random = np.random.default_rng(0)
        self._time, self._next_sample = 0.0, 0.0

    @property
    def enabled(self) -> list[bool]:
        """Which motors are on."""
        return [bool(self.firmware.enabled >> i & 1) for i in range(self.channels)]

    def power_on(self) -> None:
        """Restart the board: motors off, encoders count from zero."""
        self.firmware.power_on()
        self._time = self._next_sample = 0.0
        self._zero = self.places.copy()

    def advance(self, passed: float) -> None:
        """Let time [s] pass."""
        steps = max(1, round(passed / STEP_S))
        for _ in range(steps):
            self._time += passed / steps
            self.tensions = self.arm.tensions(self.places, passed / steps)
            self.highest = np.maximum(self.highest, self.tensions)
            self.sense()
            self.firmware.step(round(1e6 * self._time))
            self.turn(passed / steps)

    def sense(self) -> None:
        """Pass the readings of encoders, load cells and bridges to the firmware."""
        fresh = self._time >= self._next_sample
        if fresh:
            self._next_sample = self._time + 1.0 / self.motor.cell_rate
            noise = self._random.normal(0.0, self.motor.cell_noise, self.channels)
        ticks = np.rint((self.places - self._zero) / self.motor.spool.metres_per_tick).astype(int)
        for i, (sensor, cell) in enumerate(zip(self.firmware.sensors, self.cells, strict=True)):
            sensor.fresh = fresh and not cell.broken
            if sensor.fresh:
                force = float(self.tensions[i]) + cell.hung
                counts = cell.zero + force / cell.newtons_per_count + noise[i]
                largest = Protocol.CELL_COUNTS_MAX
                sensor.cell = max(-largest, min(largest, round(counts)))
            sensor.ticks = int(ticks[i])
            sensor.current = min(30000, round(1000.0 * abs(self.firmware.duties[i])))
            sensor.faults = int(self.faults[i])

    def turn(self, step: float) -> None:
        """Let the motors turn for a step [s], driven by the firmware's duties or by the wires."""
        motor = self.motor
        driven = np.array(self.firmware.duties) * motor.speed - motor.droop * self.tensions
        pulled = np.where(self.tensions > motor.friction, -motor.backdrive * self.tensions, 0.0)
        goal = np.where(self.enabled, driven, np.maximum(pulled, -motor.speed))
        goal[list(self.blocked)] = 0.0
        self._speeds += min(step / motor.lag, 1.0) * (goal - self._speeds)
        self.places = self.places + self._speeds * step

    def config(self, inputs: Sequence[str]) -> dict[str, Any]:
        """Return a configuration for the driver, without its port, with calibrated load cells."""
        return {
            'spool_radius': self.motor.spool.radius,
            'ticks_per_turn': self.motor.spool.ticks_per_turn,
            'pull_limits': [-0.05, 0.05],
            'tension_gain': 0.03,
            'calibration': {
                name: {
                    **{key: getattr(cell, key) for key in ('zero', 'newtons_per_count')},
                    'scatter': self.motor.cell_noise,
                }
                for name, cell in zip(inputs, self.cells, strict=True)
            },
            'tendons': {name: {'channel': i} for i, name in enumerate(inputs)},
        }


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


class EmulatedBoard(Plug):
    """An emulated port with a board."""

    help = HELP
    rig: BoardRig

    def __init__(self, rig: BoardRig, port: str | None = None) -> None:
        """Plug it in; its clock starts with its context."""
        self.rig = rig
        self.deaf = False
        super().__init__('board', port, idle=2.0 * STEP_S)

    def commands(self) -> dict[str, Command]:
        """Return its commands by their first word."""
        rig = self.rig
        return {
            **super().commands(),
            'silent': lambda values: setattr(self, 'deaf', True),
            'hear': lambda values: setattr(self, 'deaf', False),
            'restart': lambda values: self.restart(),
            'overheating': functools.partial(self.fail, ChannelFault.OVERHEATING),
            'voltage': functools.partial(self.fail, ChannelFault.VOLTAGE),
            'cool': functools.partial(self.fail, ChannelFault(0)),
            'overload': functools.partial(self.hang, 1.0),
            'weight': functools.partial(self.hang, STANDARD_GRAVITY),
            'block': lambda values: rig.blocked.add(range(rig.channels)[int(values[0])]),
            'free': lambda values: rig.blocked.discard(range(rig.channels)[int(values[0])]),
            'cell': lambda values: setattr(rig.cells[int(values[0])], 'broken', True),
            'mend': lambda values: setattr(rig.cells[int(values[0])], 'broken', False),
        }

    def restart(self) -> None:
        """Take the power of the board away for a moment."""
        with self._lock:
            self.rig.power_on()

    def fail(self, fault: ChannelFault, values: list[str]) -> None:
        """Let the bridge of a channel report a fault."""
        self.rig.faults[int(values[0])] = fault

    def hang(self, unit: float, values: list[str]) -> None:
        """Hang a weight on the load cell of a channel, in a unit [N]."""
        self.rig.cells[int(values[0])].hung = unit * float(values[1])

    def state(self) -> dict[str, object]:
        """Return the state of motors and wires as plain values."""
        rig = self.rig
        return {
            **super().state(),
            'enabled': rig.enabled,
            'tensions': np.round(rig.tensions, 4).tolist(),
            'highest': np.round(rig.highest, 4).tolist(),
            'wound': np.round(rig.places, 6).tolist(),
            'duties': np.round(rig.firmware.duties, 4).tolist(),
        }

    def advance(self, passed: float) -> None:
        """Advance by a time [s]; send the bytes of the board."""
        super().advance(passed)
        answer = self.rig.firmware.take()
        if not self.deaf:
            self._send(answer)

    def receive(self, data: bytes) -> None:
        """Pass received bytes to the board."""
        if not self.deaf:
            self.rig.firmware.receive(data)

    def connected(self) -> None:
        """Terminate an incomplete frame."""
        self.rig.firmware.receive(b'\0')
