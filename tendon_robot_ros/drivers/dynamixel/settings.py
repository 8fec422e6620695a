"""
Handshake with the servos, and the values of all registers that affect motion before torque on.

The handshake compares the servos with the configuration. One table lists the required values of
the registers; one loop sets or refuses them and reads them back, whatever another program left.

References
----------
ROBOTIS e-Manual, "Control Table Description" on the page of each motor.

"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from ...common.errors import DriverError
from ..hardware import PortLostError
from .bus import Bus
from .config import DynamixelConfig
from .control_table import (
    GAINS,
    INSTEAD,
    MODEL_NAMES,
    PWM_FULL,
    REGISTERS,
    WITHOUT_CURRENT,
    OperatingMode,
)
from .motor import Motor

ATTEMPTS = 3  # [1] of a request or a write, so that one broken answer is no missing servo
# [1/s] as delivered (manual, address 8), and the usual one
OTHER_RATES = (57600, 1_000_000)


@dataclass(frozen=True)
class Setting:
    """
    Required value of a register that affects motion, before the torque comes on.

    Parameters
    ----------
    name : str
        Of the register.
    value : int, optional
        None: the value of the configuration, the command mode or the model.
    why : str
        Consequence of another value.
    refused : bool
        Another value belongs to the setup of the arm and is refused; else it is overwritten.
    newer : bool
        The register exists since the firmware that has the fast sync read.

    """

    name: str
    value: int | None
    why: str
    refused: bool = False
    newer: bool = False


# [register counts] In the order in which they are written, so that none undoes another: a new
# operating mode resets gains (76 to 91), profile and PWM, and a goal PWM is at most the PWM limit.
# Goals (102, 116) become the present state, see torque.py. The velocity limit (44) bounds the goal
# velocity and a profile velocity above 0, the position limits (48, 52) single-turn positions:
# nothing of that is used in modes 0, 4 and 5. Indirect addresses (168 and more) act where their
# data are read or written, which nothing here does.
SETTINGS = (
    Setting('return_delay_time', 0, 'answers come late'),
    Setting(
        'drive_mode',
        0,
        'bit 0 turns the motor round (use direction: -1 for that), bit 2 moves it by time instead '
        'of speed, bit 3 is "torque on by goal update"',
        refused=True,
    ),
    Setting(
        'homing_offset',
        0,
        'with some firmwares a tripped bus watchdog then makes the motor run',
        refused=True,
    ),
    Setting('status_return_level', 2, 'whether it took a command stays unknown', refused=True),
    Setting('secondary_id', 255, 'it also obeys what another motor is told'),
    Setting('operating_mode', None, 'goals mean something else'),
    Setting('pwm_limit', PWM_FULL, 'it turns slowly and with little torque'),
    Setting('current_limit', None, 'it pulls more, or less, than it may'),
    Setting('startup_configuration', 0, 'its torque is on after a power cut', newer=True),
    Setting('pwm_slope', None, 'its torque comes late'),
    Setting('bus_watchdog', 0, 'a tripped one takes no goals; set when the torque is on'),
    Setting('goal_pwm', PWM_FULL, 'as the PWM limit'),
    Setting('profile_acceleration', 0, 'it follows late'),
    Setting('profile_velocity', 0, 'it follows slowly'),
)


def must_write(bus: Bus, motor: Motor, name: str, value: int) -> None:
    """Write a register in a few attempts; raise DriverError when the servo refuses."""
    for _ in range(ATTEMPTS):
        problem = bus.write(motor.identity, name, value)
        if problem is None:
            return
    raise DriverError(f'{bus.path}: {motor}: {name} = {value}: {problem}')


def read_table(bus: Bus, motor: Motor) -> dict[str, int]:
    """Read all registers of a servo; raise DriverError where it does not answer."""
    for _ in range(ATTEMPTS):
        table = bus.table(motor.identity)
        if table is not None:
            return table
    if bus.ping(motor.identity) is not None:
        raise DriverError(
            f'{bus.path}: {motor}: status return level (address 68): expected 2, got 0 as it '
            'seems: pings are answered, reads are not; write 2, or check the cable'
        )
    raise DriverError(f'{bus.path}: {motor}: no answer in {ATTEMPTS} tries; check the cable')


def refuse_settings(bus: Bus, motor: Motor, table: dict[str, int]) -> None:
    """Refuse values that belong to the setup of the arm, which this driver does not change."""
    for setting in SETTINGS:
        if setting.refused and table[setting.name] != setting.value:
            words = setting.name.replace('_', ' ')
            raise DriverError(
                f'{bus.path}: {motor}: {words} (address {REGISTERS[setting.name].address}): '
                f'expected {setting.value}, got {table[setting.name]}: {setting.why}; '
                f'write {setting.value}'
            )


def settle(bus: Bus, motor: Motor, mode: int) -> None:
    """
    Set all registers that affect motion to their required values; the torque is off.

    Registers of the flash memory are written only when they differ: they wear.

    Parameters
    ----------
    bus : Bus
    motor : Motor
    mode : int
        Operating mode, address 11.

    Raises
    ------
    DriverError
        A setting is refused, or the servo does not keep what was written.

    """
    original = table = read_table(bus, motor)
    refuse_settings(bus, motor, table)
    if motor.gains.get(mode) != [table[name] for name in GAINS]:
        # their origin is unknown: a change of mode and back restores those of the manual
        other = (
            OperatingMode.EXTENDED_POSITION
            if mode == OperatingMode.CURRENT
            else OperatingMode.CURRENT
        )
        must_write(bus, motor, 'operating_mode', other)
        must_write(bus, motor, 'operating_mode', mode)
        table = read_table(bus, motor)
        motor.gains[mode] = [table[name] for name in GAINS]
    of_this_motor = {
        'operating_mode': mode,
        'current_limit': motor.strongest,
        'pwm_slope': motor.model.pwm_slope,
    }
    newer = motor.firmware >= motor.model.fast_read_firmware
    required = {
        setting.name: value
        for setting in SETTINGS
        if newer or not setting.newer
        if (value := of_this_motor.get(setting.name, setting.value)) is not None
    }
    for name, value in required.items():
        if original[name] != value:
            motor.settled[name] = f'{original[name]} to {value}'
        if table[name] != value:
            must_write(bus, motor, name, value)
    table = read_table(bus, motor)
    for name, value in required.items():
        if table[name] != value:
            raise DriverError(
                f'{bus.path}: {motor}: {name.replace("_", " ")} (address '
                f'{REGISTERS[name].address}): {value} was written, {table[name]} is read back; '
                'is another program on this bus, or its memory worn out?'
            )


@contextmanager
def naming_second_talker(bus: Bus) -> Iterator[None]:
    """Name another program on the bus in the message of a conversation that failed."""
    try:
        yield
    except DriverError as error:
        talker = bus.second_talker()
        if not talker:
            raise
        raise type(error)(f'{bus.path}: {talker}; one program at a time: stop it first') from None


def shake_hands(bus: Bus, config: DynamixelConfig, motors: dict[int, Motor]) -> None:
    """
    Check that every servo answers, is the right model, and has safe settings.

    Raises
    ------
    DriverError
        With the expected servos and those that answer, also at other baud rates.

    """
    with naming_second_talker(bus):
        models = dict.fromkeys(motors, 0)  # id -> model number, 0 where nobody answers
        for _ in range(ATTEMPTS):
            for identity in [i for i, number in models.items() if not number]:
                models[identity] = bus.ping(identity) or 0
        if any(models[i] != motor.model.number for i, motor in motors.items()):
            refuse_servos(bus, motors, models)
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


def refuse_servos(bus: Bus, motors: dict[int, Motor], models: dict[int, int]) -> None:
    """Raise DriverError with the expected servos and those that answer (0: no answer)."""
    without = {i: WITHOUT_CURRENT[n] for i, n in models.items() if n in WITHOUT_CURRENT}
    if without:
        named = ', '.join(f'{identity}: {name}' for identity, name in without.items())
        raise DriverError(f'{bus.path}: model: expected {INSTEAD}, found {named}')
    present = {i: number for i, number in models.items() if number} | bus.everyone()
    firmware = {i: f' firmware {bus.read(i, "firmware_version")}' for i in sorted(present)}
    if all(present.get(i) == motor.model.number for i, motor in motors.items()):
        raise DriverError(
            f'{bus.path}: all servos are there, but answers come late or broken; check the cable, '
            f'answer_time (now {bus.answer_time:g} s) and how busy this computer is'
        )
    expected = ', '.join(
        f'{i}: {m.model.name} ({" and ".join(m.names)})' for i, m in motors.items()
    )
    text = (
        f'{bus.path}: servos at {bus.baud} baud: expected {expected}; found '
        f'{servo_names(present, firmware)}'
    )
    if set(motors) <= set(present):
        raise DriverError(f'{text}; correct the models or ids')
    other = ''
    for baud in OTHER_RATES:  # a second each
        if not other and baud != bus.baud and (models := servos_at(bus, baud)):
            other = f'at {baud} baud: {servo_names(models)}; '
    raise DriverError(f'{text}; {other}check cable, motor supply, ids and baud rate')


def servo_names(models: dict[int, int], firmware: dict[int, str] | None = None) -> str:
    """List ids with the names of their models, and their firmware where it is known."""
    names = {i: MODEL_NAMES.get(n, f'model number {n}') for i, n in sorted(models.items())}
    return ', '.join(f'{i}: {n}{(firmware or {}).get(i, "")}' for i, n in names.items()) or 'none'


def servos_at(bus: Bus, baud: int) -> dict[int, int]:
    """Return id and model number of the servos at another baud rate; the bus is open after it."""
    other = Bus(bus.path, baud, bus.answer_time)
    bus.close()
    try:
        other.open()
        return other.everyone()
    except (DriverError, PortLostError):
        return {}
    finally:
        other.close()
        bus.reopen()
