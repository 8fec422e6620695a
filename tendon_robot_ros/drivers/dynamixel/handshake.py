"""Check who is on the bus, and whether it is what the configuration says."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ...common.errors import DriverError
from ..ports import PortLostError
from .bus import Bus
from .config import DynamixelConfig
from .control_table import (
    INSTEAD,
    MODEL_NAMES,
    REGISTERS,
    WITHOUT_CURRENT,
)
from .motor import Motor
from .settings import read_table, refuse_settings

PING_ATTEMPTS = 3
OTHER_RATES = (57600, 1_000_000)  # as delivered, and what most people set


@contextmanager
def second_talker_told(bus: Bus) -> Iterator[None]:
    """Where a conversation fails because somebody else talks on the bus, say that instead."""
    try:
        yield
    except DriverError as error:
        talker = bus.second_talker()
        if not talker:
            raise
        raise type(error)(f'{bus.path}: {talker}; one program at a time: stop it first') from None


def shake_hands(bus: Bus, config: DynamixelConfig, motors: dict[int, Motor]) -> None:
    """
    Check every servo: there, the right model, settings that are safe to use.

    Raises
    ------
    DriverError
        With what was expected and what was found; servos at other baud rates are looked for.

    """
    with second_talker_told(bus):
        models = {identity: _who(bus, identity) for identity in motors}
        wrong = [i for i, motor in motors.items() if models[i] != motor.model.number]
        if wrong:
            _refuse_without_current(bus, models)
            raise DriverError(_difference(bus, motors, models))
        for motor in motors.values():
            table = read_table(bus, motor)
            refuse_settings(bus, motor, table)
            motor.firmware = table['firmware_version']
            low, high = table['min_voltage_limit'], table['max_voltage_limit']
            volt = REGISTERS['min_voltage_limit'].unit
            motor.voltage_limits = (volt * low, volt * high)
            motor.hottest = table['temperature_limit'] - config.margin
            motor.errors = table['hardware_error_status']
            motor.answers = True
    bus.fast = all(m.firmware >= m.model.fast_read_firmware for m in motors.values())


def _refuse_without_current(bus: Bus, models: dict[int, int | None]) -> None:
    """Say what else there is for motors that control no current."""
    without = {i: WITHOUT_CURRENT[n] for i, n in models.items() if n in WITHOUT_CURRENT}
    if without:
        named = ', '.join(f'{identity}: {name}' for identity, name in without.items())
        raise DriverError(f'{bus.path}: model: expected {INSTEAD}, found {named}')


def _who(bus: Bus, identity: int) -> int | None:
    """Ping a servo, again if the answer was lost."""
    for _ in range(PING_ATTEMPTS):
        number = bus.ping(identity)
        if number is not None:
            return number
    return None


def describe(models: dict[int, int]) -> str:
    """List ids and models."""
    return (
        ', '.join(
            f'{i}: {MODEL_NAMES.get(number, f"model number {number}")}'
            for i, number in sorted(models.items())
        )
        or 'none'
    )


def _difference(bus: Bus, motors: dict[int, Motor], models: dict[int, int | None]) -> str:
    expected = ', '.join(
        f'{i}: {m.model.name} ({" and ".join(m.names)})' for i, m in motors.items()
    )
    present = {i: number for i, number in models.items() if number is not None}
    present |= bus.everyone()
    parts = []
    for identity, number in sorted(present.items()):
        name = MODEL_NAMES.get(number, f'model number {number}')
        firmware = bus.read(identity, 'firmware_version')
        parts.append(f'{identity}: {name} firmware {firmware}')
    text = (
        f'{bus.path}: servos at {bus.baud} baud: expected {expected}; '
        f'found {", ".join(parts) or "none"}'
    )
    if all(present.get(i) == motor.model.number for i, motor in motors.items()):
        return (
            f'{bus.path}: all servos are there, but answers come late or broken; check the cable, '
            f'answer_time (now {bus.answer_time:g} s) and how busy this computer is'
        )
    if set(motors) <= set(present):
        return f'{text}; correct the models or ids'
    return f'{text}; {_elsewhere(bus)}check cable, motor supply, ids and baud rate'


def _elsewhere(bus: Bus) -> str:
    """Look for servos at other baud rates, a second each."""
    for baud in OTHER_RATES:
        if baud == bus.baud:
            continue
        other = Bus(bus.path, baud, bus.answer_time)
        bus.close()
        try:
            other.open()
            models = other.everyone()
        except (DriverError, PortLostError):
            continue
        finally:
            other.close()
        if models:
            break
    else:
        models = {}
    bus.reopen()
    return f'at {baud} baud: {describe(models)}; ' if models else ''
