"""What the servos say, as a reading, and as text for diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..interface import Fault, Reading
from .bus import Bus
from .config import Config
from .motor import Motor


def facts(
    bus: Bus, config: Config, motors: Iterable[Motor], latency: int | None
) -> dict[str, str]:
    """Describe port, reading, failures and every servo: names to values with units."""
    out = {
        'port': f'{config.port} at {config.baud} baud',
        'latency_timer': 'none' if latency is None else f'{latency} ms',
        'group read': 'fast sync read' if bus.fast else 'sync read',
        'tension uncertainty': f'{_doubt(config):.3g} N',
        'bus watchdog': f'{config.watchdog:g} s' if config.watchdog else 'off',
    }
    out |= {what: str(count) for what, count in bus.failures.items()}
    for motor in motors:
        warm = '' if motor.temperature is None else f', {motor.temperature:.0f} °C'
        power = '' if motor.voltage is None else f', {motor.voltage:.1f} V'
        torque = 'on' if motor.wanted else 'off'
        out[str(motor)] = (
            f'{motor.model.name} firmware {motor.firmware}, torque {torque}{warm}{power}'
        )
        for wire in motor.wires:
            known = 'calibrated' if wire.calibration.measured else 'data sheet, not calibrated'
            out[f'tension of {wire.name}'] = f'{wire.resolution}; {known}'
    return out


def _doubt(config: Config) -> float:
    """Return the largest uncertainty of a tension told from current [N]."""
    return max(wire.resolution.band for wire in config.wires)


def reading(
    config: Config,
    motors: Mapping[int, Motor],
    observable: NDArray[np.bool_],
    now: float,
    faults: tuple[Fault, ...] | None = None,
) -> Reading:
    """
    Put together what was last read.

    Parameters
    ----------
    config : Config
    motors : mapping of id to Motor
    observable : ndarray of bool, shape (m,)
        Inputs whose tension the current shows well enough.
    now : float
        `time.monotonic()` [s].
    faults : tuple of Fault, optional
        Instead of the motors' own: they cannot be asked.

    """
    pairs = [(motors[wire.motor], wire) for wire in config.wires]
    tensions = np.where(observable, [motor.tension(wire) for motor, wire in pairs], np.nan)
    spread = [
        wire.calibration.uncertainty(t) for (_, wire), t in zip(pairs, tensions, strict=True)
    ]
    if faults is None:
        every = (motor.faults(config.port) for motor in motors.values())
        faults = tuple(fault for some in every for fault in some)
    pulls = np.array([motor.pull(wire) for motor, wire in pairs])
    return Reading(now, pulls, tensions, 'current', np.array(spread), faults)
