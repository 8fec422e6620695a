"""Words that do something to the emulated board: faults for a person, or a test, to switch on."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...exceptions import InputError
from ..serial_board.messages import CHANNEL_FAULTS
from .board import NOISE, RADIUS, TICKS, BoardLine, BoardRig

GRAVITY = 9.80665  # [m/s²]
BRIDGE = {code: bit for bit, (code, _) in CHANNEL_FAULTS.items()}
HELP = """\
silent | hear         the board neither hears nor answers; it does again
spoil N | cut N | double N   the next N pieces it sends: a wrong byte, half missing, sent twice
slow SECONDS          before everything it sends; slow 0: as fast as ever
unplug [SECONDS]      pull the plug; with SECONDS put it back after that time
plug                  put it back
restart               the board loses its power for a moment
overheating CHANNEL | voltage CHANNEL   its motor bridge says so; cool CHANNEL: no longer
overload CHANNEL NEWTONS   something pulls at that load cell; overload CHANNEL 0: no longer
block CHANNEL | free CHANNEL   its motor does not turn; it does again
cell CHANNEL | mend CHANNEL   the cable of its load cell is off; it is on again
weight CHANNEL KG     hang a weight on a load cell
state                 print what motors and wires do, as JSON
quit"""


def obey(line: BoardLine, text: str) -> str:
    """
    Carry out one command; return what to answer.

    Raises
    ------
    InputError
        It is none of the known ones, or its values are wrong.

    """
    word, *values = text.split()
    try:
        return ACTIONS[word](line, values) or 'ok'
    except (ValueError, IndexError, KeyError) as error:
        raise InputError(f'{text!r}: {error}; type help') from None


def _set(owner: Callable[[BoardLine], Any], name: str, kind: type) -> Action:
    def change(line: BoardLine, values: list[str]) -> None:
        setattr(owner(line), name, kind(values[0]))

    return change


def _deaf(deaf: bool) -> Action:
    def change(line: BoardLine, values: list[str]) -> None:
        line.deaf = deaf

    return change


def _unplug(line: BoardLine, values: list[str]) -> None:
    line.unplug()
    if values:
        time.sleep(float(values[0]))
        line.plug()


def _bridge(code: str) -> Action:
    def fail(line: BoardLine, values: list[str]) -> None:
        line.rig.faults[int(values[0])] = BRIDGE.get(code, 0)

    return fail


def _block(blocked: bool) -> Action:
    def change(line: BoardLine, values: list[str]) -> None:
        channel = range(line.rig.channels)[int(values[0])]
        line.rig.blocked -= {channel}
        line.rig.blocked |= {channel} if blocked else set()

    return change


def _cell(broken: bool) -> Action:
    def change(line: BoardLine, values: list[str]) -> None:
        line.rig.cells[int(values[0])].broken = broken

    return change


def _hang(factor: float) -> Action:
    def change(line: BoardLine, values: list[str]) -> None:
        line.rig.cells[int(values[0])].hung = factor * float(values[1])

    return change


def state(line: BoardLine) -> dict[str, object]:
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
        'spool_radius': RADIUS,
        'ticks_per_turn': TICKS,
        'pull_limits': [-0.05, 0.05],
        'tension_gain': 0.03,
        'calibration': {
            name: {
                'zero': cell.zero,
                'newtons_per_count': cell.newtons_per_count,
                'scatter': NOISE,
            }
            for name, cell in zip(inputs, rig.cells, strict=True)
        },
        'tendons': {name: {'channel': i} for i, name in enumerate(inputs)},
    }


Action = Callable[[BoardLine, list[str]], str | None]
ACTIONS: dict[str, Action] = {
    'silent': _deaf(True),
    'hear': _deaf(False),
    'spoil': _set(lambda line: line.faults, 'spoilt', int),
    'cut': _set(lambda line: line.faults, 'cut', int),
    'double': _set(lambda line: line.faults, 'doubled', int),
    'slow': _set(lambda line: line.faults, 'delay', float),
    'unplug': _unplug,
    'plug': lambda line, values: line.plug(),
    'restart': lambda line, values: line.restart(),
    'overheating': _bridge('overheating'),
    'voltage': _bridge('voltage'),
    'cool': _bridge(''),
    'overload': _hang(1.0),
    'block': _block(True),
    'free': _block(False),
    'cell': _cell(True),
    'mend': _cell(False),
    'weight': _hang(GRAVITY),
    'state': lambda line, values: json.dumps(state(line)),
    'help': lambda line, values: HELP,
}
