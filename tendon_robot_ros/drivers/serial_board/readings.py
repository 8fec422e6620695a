"""What is said of the board: measured values, faults, facts for diagnostics."""

from __future__ import annotations

import numpy as np

from ..interface import Array, Fault, Reading
from .config import BoardConfig
from .link import BoardLink
from .messages import CHANNEL_FAULTS, ChannelFault, Identity, Telemetry


def measured_tensions(config: BoardConfig, telemetry: Telemetry | None) -> Array:
    """Return measured tensions, shape (m,) [N]; nan where the load cell says nothing."""
    return _measured(config, telemetry, 'tensions', ChannelFault.LOAD_CELL)


def measured_pulls(config: BoardConfig, telemetry: Telemetry | None, zero: Array) -> Array:
    """Return wire pulls from `zero` [m], shape (m,) [m]; nan where the encoder says nothing."""
    return _measured(config, telemetry, 'pulls', ChannelFault.ENCODER) - np.nan_to_num(zero)


def _measured(config: BoardConfig, telemetry: Telemetry | None, name: str, fault: int) -> Array:
    if telemetry is None:
        return np.full(len(config.tendons), np.nan)
    values = getattr(telemetry, name)[config.places]
    return np.where(telemetry.faults[config.places] & fault, np.nan, values)


def board_reading(
    config: BoardConfig,
    telemetry: Telemetry | None,
    zero: Array,
    faults: tuple[Fault, ...],
    now: float,
) -> Reading:
    """Return what the newest telemetry says; `now` is `time.monotonic()` [s]."""
    values = measured_tensions(config, telemetry)
    spread = np.array(
        [
            np.nan if tendon.cell is None else tendon.cell.uncertainty(value)
            for tendon, value in zip(config.tendons, values, strict=True)
        ]
    )
    pulls = measured_pulls(config, telemetry, zero)
    return Reading(now, pulls, values, 'load_cell', np.nan_to_num(spread), faults)


def board_faults(
    config: BoardConfig,
    connected: bool,
    telemetry: Telemetry | None,
    restarted: Array,
    silent: bool,
) -> tuple[Fault, ...]:
    """
    Return what is wrong.

    Parameters
    ----------
    config : BoardConfig
    connected : bool
        Whether the port is there.
    telemetry : Telemetry or None
    restarted : ndarray of bool, shape (m,)
        Inputs that the board switched off by itself.
    silent : bool
        Whether the board heard nothing and released.

    """
    port = config.port
    if not connected:
        return (Fault('port', f'{port}: the port is gone; plug the board in again'),)
    if telemetry is None:
        message = f'{port}: no telemetry from the board; check its cable and supply'
        return (Fault('silent', message),)
    faults = latched_faults(config, telemetry)
    for tendon, off in zip(config.tendons, restarted, strict=True):
        if off:
            message = f'{port}: {tendon}: the board restarted or switched it off; reset'
            faults.append(Fault('restarted', message, True, (tendon.name,)))
    if silent:
        message = f'{port}: the board heard no command for {config.timeout:g} s, released'
        faults.append(Fault('watchdog', message))
    return tuple(faults)


def latched_faults(config: BoardConfig, telemetry: Telemetry | None) -> list[Fault]:
    """Return the faults that the board has latched."""
    if telemetry is None:
        return []
    return [
        Fault(
            str(bit.name).lower(),
            f'{config.port}: {tendon}: {words}; torque is off; remove the cause, then reboot it',
            True,
            (tendon.name,),
        )
        for tendon, bits in zip(config.tendons, telemetry.faults[config.places], strict=True)
        for bit, words in CHANNEL_FAULTS.items()
        if bits & bit
    ]


def board_facts(
    config: BoardConfig, link: BoardLink, identity: Identity | None, telemetry: Telemetry | None
) -> dict[str, str]:
    """Return facts about board and link: names with units to values as text."""
    facts = {
        'port': config.port,
        'baud_rate (1/s)': str(config.baud),
        'frames_missed': str(link.missed),
        'frames_bad': str(link.bad),
        'silence_until_release (s)': f'{config.timeout:g}',
        'release_to': config.release_to,
    }
    if identity is not None:
        facts |= {'channels': str(identity.channels), 'firmware': str(identity.firmware)}
    if telemetry is not None:
        facts['frames_bad_at_board'] = str(telemetry.bad)
    for tendon in config.tendons:
        if telemetry is not None:
            facts[f'{tendon}: current (A)'] = f'{telemetry.currents[tendon.channel]:.3f}'
        if tendon.cell is not None:
            doubt = float(tendon.cell.uncertainty(np.array(tendon.tension_limit)))
            facts[f'{tendon}: tension_uncertainty (N)'] = f'{doubt:.2g}'  # at its limit
    return facts
