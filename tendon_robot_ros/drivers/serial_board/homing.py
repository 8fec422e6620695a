"""Where pull is zero: every wire just taut, as its load cell says."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from ...exceptions import DriverError
from ..interface import Array
from . import facts, handshake

if TYPE_CHECKING:
    from .driver import SerialDriver

PERIOD = 0.01  # [s]
STEADY = 0.2  # [s]
CLOSE = 0.3  # of the wanted tension


def find_slack(driver: SerialDriver) -> Array:
    """
    Wind all wires to the homing tension; return where they are, shape (m,) [m] on the board.

    Raises
    ------
    DriverError
        A wire does not come to that tension in time.

    """
    config = driver.config
    wide = np.zeros(len(driver.inputs))
    if driver.telemetry is not None:  # the limits around where it stands now
        wide = driver.telemetry.pulls[driver.places]
    handshake.give_limits(driver.link, config, wide)
    driver.switch_on('tension')
    goal = np.full(len(driver.inputs), config.home_tension)
    deadline = time.monotonic() + config.home_time
    steady = time.monotonic()
    while time.monotonic() - steady < STEADY:
        driver.command('tension', goal)
        driver._read_again()
        found = facts.tensions(driver)
        faults = facts.latched(driver)
        away = ~(np.abs(found - goal) < CLOSE * goal)
        if away.any():
            steady = time.monotonic()
        if faults or time.monotonic() > deadline:
            names = ', '.join(n for n, bad in zip(driver.inputs, away, strict=True) if bad)
            reason = '; '.join(fault.message for fault in faults) or (
                f'{config.port}: {names}: not at {config.home_tension:g} N within '
                f'{config.home_time:g} s; is the wire attached, and the direction right?'
            )
            raise DriverError(f'no pull zero found: {reason}')
        time.sleep(PERIOD)
    assert driver.telemetry is not None
    return np.array(driver.telemetry.pulls[driver.places])
