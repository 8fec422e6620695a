"""Check who is on the bus, and whether it is what the configuration says."""

from __future__ import annotations

from ...common.errors import DriverError
from ..ports import PortLostError
from .bus import Bus
from .config import DynamixelConfig
from .control_table import MODEL_NAMES, VOLT_PER_COUNT
from .motor import Motor

REVERSE, TORQUE_BY_GOAL = 0x01, 0x08  # bits of the drive mode, address 10
PING_ATTEMPTS = 3
OTHER_RATES = (57600, 1_000_000)  # as delivered, and what most people set


def shake_hands(bus: Bus, config: DynamixelConfig, motors: dict[int, Motor]) -> None:
    """
    Check every servo: there, the right model, settings that are safe to use.

    Raises
    ------
    DriverError
        With what was expected and what was found; servos at other baud rates are looked for.

    """
    models = {identity: _who(bus, identity) for identity in motors}
    wrong = [i for i, motor in motors.items() if models[i] != motor.model.number]
    if wrong:
        raise DriverError(_difference(bus, motors, models))
    for motor in motors.values():
        motor.firmware = _ask(bus, motor, 'firmware_version')
        _check_settings(bus, config, motor)
        low, high = (
            VOLT_PER_COUNT * _ask(bus, motor, name)
            for name in ('min_voltage_limit', 'max_voltage_limit')
        )
        motor.voltage_limits = (low, high)
        motor.hottest = _ask(bus, motor, 'temperature_limit') - config.margin
        motor.errors = _ask(bus, motor, 'hardware_error_status')
        motor.answers = True
    bus.fast = all(m.firmware >= m.model.fast_read_firmware for m in motors.values())


def _who(bus: Bus, identity: int) -> int | None:
    """Ping a servo, again if the answer was lost."""
    for _ in range(PING_ATTEMPTS):
        number = bus.ping(identity)
        if number is not None:
            return number
    return None


def _ask(bus: Bus, motor: Motor, name: str) -> int:
    """Read a setting until two answers agree: a late one may be that of the register before."""
    lost, last = 0, None
    for _ in range(3 * PING_ATTEMPTS):
        value = bus.read(motor.identity, name)
        if value is None:
            lost += 1
            if lost == PING_ATTEMPTS:
                break
        elif value == last:
            return value
        else:
            last = value
    if bus.ping(motor.identity) is not None:
        raise DriverError(
            f'{bus.path}: {motor}: status return level (address 68): expected 2, got 0 as it '
            'seems: pings are answered, reads are not; write 2, or check the cable'
        )
    raise DriverError(
        f'{bus.path}: {motor}: {name}: no answer in {PING_ATTEMPTS} tries; check the cable'
    )


def _check_settings(bus: Bus, config: DynamixelConfig, motor: Motor) -> None:
    """Refuse settings under which this driver would not do what it says."""
    drive_mode = _ask(bus, motor, 'drive_mode')
    if drive_mode & (REVERSE | TORQUE_BY_GOAL):
        raise DriverError(
            f'{bus.path}: {motor}: drive mode (address 10): expected normal direction and no '
            f'"torque on by goal update", got {drive_mode:#04x}; write 0, and use direction: -1 '
            f'in {config.source}'
        )
    offset = _ask(bus, motor, 'homing_offset')
    if offset:
        raise DriverError(
            f'{bus.path}: {motor}: homing offset (address 20): expected 0, got {offset}: with '
            'some firmwares a tripped bus watchdog then makes the motor run; write 0'
        )
    level = _ask(bus, motor, 'status_return_level')
    if level != 2:
        raise DriverError(
            f'{bus.path}: {motor}: status return level (address 68): expected 2, got {level}: '
            'whether it took a command stays unknown; write 2'
        )


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
            return f'at {baud} baud: {describe(models)}; '
    return ''
