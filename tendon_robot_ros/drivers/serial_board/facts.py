"""What is said of the board: readings, faults, facts for diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...exceptions import DriverError
from ..interface import Array, Fault, Reading
from . import messages

if TYPE_CHECKING:
    from .driver import SerialDriver


def mask(channels: np.ndarray) -> int:
    """Return a bit per channel, shape (k,)."""
    return int(np.bitwise_or.reduce(1 << channels, initial=0))


def chosen(known: Sequence[str], inputs: Sequence[str]) -> np.ndarray:
    """Return which of the known inputs are named, shape (m,); none named means all."""
    unknown = [name for name in inputs if name not in known]
    if unknown:
        raise DriverError(f'expected inputs of {", ".join(known)}, got {", ".join(unknown)}')
    return np.array([not inputs or name in inputs for name in known])


def tensions(driver: SerialDriver) -> Array:
    """Return measured tensions, shape (m,) [N]; nan where the load cell says nothing."""
    return _measured(driver, 'tensions', messages.CELL)


def pulls(driver: SerialDriver) -> Array:
    """Return measured wire pulls, shape (m,) [m]; nan where the encoder says nothing."""
    zero: Array = np.nan_to_num(driver.zero)
    return _measured(driver, 'pulls', messages.ENCODER) - zero


def _measured(driver: SerialDriver, name: str, fault: int) -> Array:
    found = driver.telemetry
    if found is None:
        return np.full(len(driver.inputs), np.nan)
    values = getattr(found, name)[driver.places]
    return np.where(found.faults[driver.places] & fault, np.nan, values)


def reading(driver: SerialDriver, now: float, tripped: bool) -> Reading:
    """Return the present reading."""
    values = tensions(driver)
    spread = np.array(
        [
            np.nan if tendon.cell is None else tendon.cell.uncertainty(value)
            for tendon, value in zip(driver.config.tendons, values, strict=True)
        ]
    )
    return Reading(
        time=now,
        pulls=pulls(driver),
        tensions=values,
        source='load_cell',
        tension_sd=np.nan_to_num(spread),
        faults=_faults(driver, tripped),
    )


def _faults(driver: SerialDriver, tripped: bool) -> tuple[Fault, ...]:
    port = driver.config.port
    if not driver.link.connected:
        return (Fault('port', f'{port}: the port is gone; plug the board in again'),)
    if driver.telemetry is None:
        message = f'{port}: no telemetry from the board; check its cable and supply'
        return (Fault('silent', message),)
    faults = list(latched(driver))
    for tendon, off in zip(driver.config.tendons, driver.restarted, strict=True):
        if off:
            message = f'{port}: {tendon}: the board restarted or switched it off; reset'
            faults.append(Fault('restarted', message, True, (tendon.name,)))
    if tripped:
        message = f'{port}: the board heard no command for {driver.config.timeout:g} s, released'
        faults.append(Fault('watchdog', message))
    return tuple(faults)


def latched(driver: SerialDriver) -> list[Fault]:
    """Return the faults that the board has latched."""
    found = driver.telemetry
    if found is None:
        return []
    bits = found.faults[driver.places]
    return [
        Fault(
            code,
            f'{driver.config.port}: {tendon}: {words}; torque is off; remove the cause, then '
            'reboot it',
            True,
            (tendon.name,),
        )
        for tendon, value in zip(driver.config.tendons, bits, strict=True)
        for bit, (code, words) in messages.CHANNEL_FAULTS.items()
        if value & bit
    ]


def describe(driver: SerialDriver) -> dict[str, str]:
    """Return facts about board and link: names and values as text, with units."""
    config, found, identity = driver.config, driver.telemetry, driver.identity
    said = {
        'port': f'{config.port}, {config.baud} baud',
        'board': 'not asked yet'
        if identity is None
        else f'{identity.channels} channels, firmware {identity.firmware}',
        'frames': f'{driver.link.missed} missed, {driver.link.bad} bad here, '
        f'{"?" if found is None else found.bad} bad at the board',
        'on silence': f'release after {config.timeout:g} s to {config.release_to}',
    }
    for tendon in config.tendons:
        current = '?' if found is None else f'{found.currents[tendon.channel]:.3f}'
        said[str(tendon)] = f'{current} A'
        if tendon.cell is not None:
            doubt = float(tendon.cell.uncertainty(np.array(tendon.tension_limit)))
            said[str(tendon)] += f', ±{doubt:.2g} N at {tendon.tension_limit:g} N'
    return said
