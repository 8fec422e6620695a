"""The emulated bus: a pseudo-terminal, the servos on it, and a thread that serves both."""

from __future__ import annotations

import json
import termios
import time

import numpy as np

from ..drivers.dynamixel.control_table import BAUD_RATES, HARDWARE_ERRORS, WATCHDOG_TRIPPED
from .port import COMMON_HELP, Action, Plug
from .protocol import InstructionReceiver, Responder
from .rig import HangingWeights, Rig
from .servo import Servo

PACKET_GAP_S = 0.02  # [s] of silence that ends a broken packet


class EmulatedBus(Plug):
    """
    An emulated port with servos; `port` is the path to open.

    Attributes
    ----------
    rig : Rig
    responder : Responder

    """

    def __init__(self, rig: Rig, port: str | None = None) -> None:
        """Plug it in, at a path of its own if none is given; `start` begins to answer."""
        self.rig = rig
        self.responder = Responder(rig)
        self._heard = time.monotonic()
        self._receiver = InstructionReceiver()
        super().__init__('dynamixel', port)

    def restart(self, identity: int) -> None:
        """Let a servo lose its power for a moment."""
        with self._lock:
            self.rig.rebooted(identity)

    def servo(self, identity: int) -> Servo:
        """Return the servo with an id."""
        return self.rig.servos[identity]

    def _let_time_pass(self, passed: float) -> None:
        self.rig.advance(passed)

    def _hear(self, data: bytes) -> None:
        now = time.monotonic()
        if now - self._heard > PACKET_GAP_S:
            self._plugged()
        self._heard = now
        speed = self._speed()
        for instruction in self._receiver.feed(data):
            self._send(self.faults.on_the_way(self.responder.carry_out(instruction, speed)))

    def _plugged(self) -> None:
        self._receiver = InstructionReceiver()

    def _speed(self) -> int | None:
        """Baud rate that the client has set, None when it is an odd one."""
        if self._master is None:
            return None
        try:
            code = termios.tcgetattr(self._master)[5]
        except termios.error:
            return None
        for baud in BAUD_RATES.values():
            if getattr(termios, f'B{baud}') == code:
                return baud
        return None


# -----------------------------------------------------------------------------
# Words that do something to the emulated bus: faults for a person, or a test, to switch on.

OF_WIRES = ('tensions', 'wound', 'highest', 'held', 'least', 'most')
HELP = f"""\
silent ID...          these servos neither hear nor answer; hear ID...: they do again
{COMMON_HELP}
overload ID, overheating ID, encoder ID, shock ID   a hardware error, until a reboot
hot ID CELSIUS        temperature of a motor
volts VOLTS           supply of all motors
restart ID...         the motor loses its power for a moment
trip ID...            its bus watchdog trips
weight ID KG          hang a weight on it (only with --weights)
state                 print what the servos and wires do, as JSON
log SECONDS           print what they accepted lately, as JSON: [time, id, register, value]
trace SECONDS         print what they did lately, as JSON: [time, [A], [N of wires], [m wound]]
quit"""


def _hardware_error(bit: int) -> Action:
    def fail(line: EmulatedBus, values: list[str]) -> None:
        for servo in map(int, values):
            line.servo(servo).fail(bit)

    return fail


def _silent(line: EmulatedBus, values: list[str]) -> None:
    line.responder.silent |= {line.servo(int(value)).identity for value in values}


def _hear(line: EmulatedBus, values: list[str]) -> None:
    line.responder.silent -= {int(value) for value in values}


def _hot(line: EmulatedBus, values: list[str]) -> None:
    line.servo(int(values[0])).temperature = float(values[1])


def _volts(line: EmulatedBus, values: list[str]) -> None:
    for servo in line.rig.servos.values():
        servo.voltage = float(values[0])


def _restart(line: EmulatedBus, values: list[str]) -> None:
    for value in values:
        line.restart(int(value))


def _trip(line: EmulatedBus, values: list[str]) -> None:
    for value in values:
        line.servo(int(value)).put('bus_watchdog', WATCHDOG_TRIPPED)


def _weight(line: EmulatedBus, values: list[str]) -> None:
    arm = line.rig.arm
    if not isinstance(arm, HangingWeights):
        raise ValueError('start the emulator with --weights')
    place = list(line.rig.servos).index(int(values[0]))
    arm.hang(place, float(values[1]))


def _state(line: EmulatedBus, values: list[str]) -> str:
    return json.dumps(state(line))


def _log(line: EmulatedBus, values: list[str]) -> str:
    begin = time.monotonic() - float(values[0])
    return json.dumps([entry for entry in line.responder.log.copy() if entry[0] >= begin])


def _trace(line: EmulatedBus, values: list[str]) -> str:
    begin = time.monotonic() - float(values[0])
    lately = [moment for moment in line.rig.trace.copy() if moment[0] >= begin]
    return json.dumps([[when, *(np.round(v, 6).tolist() for v in rest)] for when, *rest in lately])


def _help(line: EmulatedBus, values: list[str]) -> str:
    return HELP


def state(line: EmulatedBus) -> dict[str, object]:
    """Return what servos and wires do, as plain values."""
    names = (
        'torque_enable',
        'operating_mode',
        'goal_current',
        'goal_position',
        'present_current',
        'present_position',
        'bus_watchdog',
        'hardware_error_status',
        'current_limit',
    )
    return {
        'port': line.port,
        'time': time.monotonic(),
        **getattr(line.rig.arm, 'shown', {}),
        **{name: np.round(getattr(line.rig, name), 6).tolist() for name in OF_WIRES},
        'servos': {
            i: {name: servo.get(name) for name in names} for i, servo in line.rig.servos.items()
        },
        'extremes': {
            f'{i} {name}': list(values) for (i, name), values in line.responder.extremes.items()
        },
    }


ACTIONS: dict[str, Action] = {
    **{code: _hardware_error(bit) for bit, (code, _) in HARDWARE_ERRORS.items()},
    'silent': _silent,
    'hear': _hear,
    'hot': _hot,
    'volts': _volts,
    'restart': _restart,
    'trip': _trip,
    'weight': _weight,
    'state': _state,
    'log': _log,
    'trace': _trace,
    'help': _help,
}
