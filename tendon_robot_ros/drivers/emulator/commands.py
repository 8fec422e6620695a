"""Words that do something to the emulated bus: faults for a person, or a test, to switch on."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np

from ...exceptions import InputError
from ..dynamixel.tables import HARDWARE_ERRORS, WATCHDOG_TRIPPED
from .arm import HangingWeights
from .line import Line

BITS = {code: bit for bit, (code, _) in HARDWARE_ERRORS.items()}
HELP = """\
silent ID...          these servos neither hear nor answer; hear ID...: they do again
spoil N | cut N | double N   the next N answers: wrong CRC, second half missing, sent twice
slow SECONDS          before every answer; slow 0: as fast as ever
unplug [SECONDS]      pull the plug; with SECONDS put it back after that time
plug                  put it back
overload ID, overheating ID, encoder ID, shock ID   a hardware error, until a reboot
hot ID CELSIUS        temperature of a motor
volts VOLTS           supply of all motors
restart ID...         the motor loses its power for a moment
trip ID...            its bus watchdog trips
weight ID KG          hang a weight on it (only with --weights)
state                 print what the servos and wires do, as JSON
log SECONDS           print what they accepted lately, as JSON: [time, id, register, value]
quit"""


def obey(line: Line, text: str) -> str:
    """
    Carry out one command; return what to answer.

    Raises
    ------
    InputError
        It is none of the known ones, or its values are wrong.

    """
    word, *values = text.split()
    try:
        action = ACTIONS.get(word) or _hardware_error(word)
        return action(line, values) or 'ok'
    except (ValueError, IndexError, KeyError) as error:
        raise InputError(f'{text!r}: {error}; type help') from None


def _hardware_error(word: str) -> Callable[[Line, list[str]], str | None]:
    bit = BITS[word]

    def fail(line: Line, values: list[str]) -> None:
        for servo in map(int, values):
            line.servo(servo).fail(bit)

    return fail


def _set(name: str, kind: type) -> Callable[[Line, list[str]], None]:
    def change(line: Line, values: list[str]) -> None:
        setattr(line.faults, name, kind(values[0]))

    return change


def _silent(line: Line, values: list[str]) -> None:
    line.responder.silent |= {line.servo(int(value)).identity for value in values}


def _hear(line: Line, values: list[str]) -> None:
    line.responder.silent -= {int(value) for value in values}


def _unplug(line: Line, values: list[str]) -> None:
    line.unplug()
    if values:
        time.sleep(float(values[0]))
        line.plug()


def _plug(line: Line, values: list[str]) -> None:
    line.plug()


def _hot(line: Line, values: list[str]) -> None:
    line.servo(int(values[0])).temperature = float(values[1])


def _volts(line: Line, values: list[str]) -> None:
    for servo in line.rig.servos.values():
        servo.voltage = float(values[0])


def _restart(line: Line, values: list[str]) -> None:
    for value in values:
        line.restart(int(value))


def _trip(line: Line, values: list[str]) -> None:
    for value in values:
        line.servo(int(value)).put('bus_watchdog', WATCHDOG_TRIPPED)


def _weight(line: Line, values: list[str]) -> None:
    arm = line.rig.arm
    if not isinstance(arm, HangingWeights):
        raise ValueError('start the emulator with --weights')
    place = list(line.rig.servos).index(int(values[0]))
    arm.hang(place, float(values[1]))


def _state(line: Line, values: list[str]) -> str:
    return json.dumps(state(line))


def _log(line: Line, values: list[str]) -> str:
    begin = time.monotonic() - float(values[0])
    return json.dumps([entry for entry in line.responder.log.copy() if entry[0] >= begin])


def _help(line: Line, values: list[str]) -> str:
    return HELP


def state(line: Line) -> dict[str, object]:
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
        'tensions': np.round(line.rig.tensions, 4).tolist(),
        'servos': {
            i: {name: servo.get(name) for name in names} for i, servo in line.rig.servos.items()
        },
        'extremes': {
            f'{i} {name}': list(values) for (i, name), values in line.responder.extremes.items()
        },
    }


ACTIONS: dict[str, Callable[[Line, list[str]], str | None]] = {
    'silent': _silent,
    'hear': _hear,
    'spoil': _set('spoilt', int),
    'cut': _set('cut', int),
    'double': _set('doubled', int),
    'slow': _set('delay', float),
    'unplug': _unplug,
    'plug': _plug,
    'hot': _hot,
    'volts': _volts,
    'restart': _restart,
    'trip': _trip,
    'weight': _weight,
    'state': _state,
    'log': _log,
    'help': _help,
}
