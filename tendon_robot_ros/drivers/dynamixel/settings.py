"""
Every register that steers motion: what it holds before the torque comes on.

One table says what, one loop sets or refuses and reads back: whatever another program left.

References
----------
ROBOTIS e-Manual, "Control Table Description" on the page of each motor.

"""

from __future__ import annotations

from dataclasses import dataclass

from ...common.errors import DriverError
from .bus import Bus
from .control_table import (
    GAINS,
    PWM_FULL,
    REGISTERS,
    OperatingMode,
)
from .motor import Motor

ATTEMPTS = 3  # of a question or a write


@dataclass(frozen=True)
class Setting:
    """
    What a register that steers motion holds before the torque comes on.

    Parameters
    ----------
    name : str
        Of the register.
    value : int, optional
        None: what the configuration, the command mode or the model says.
    why : str
        What another value does.
    refused : bool
        Another value belongs to how the arm is set up: it is refused; else it is overwritten.
    newer : bool
        There since the firmware that has the fast sync read.

    """

    name: str
    value: int | None
    why: str
    refused: bool = False
    newer: bool = False


# In the order in which they are written: a new operating mode resets gains (76 to 91), profile
# and PWM, and a goal PWM is at most the PWM limit. Goals (102, 116) are what is measured, see
# torque.py. The velocity limit (44) bounds the goal velocity and a profile velocity above 0, the
# position limits (48, 52) single-turn positions: nothing of that is used in modes 0, 4 and 5.
# Indirect addresses (168 and more) act where their data are read or written, which nobody here
# does.
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
    """Write a register, again if need be; raise DriverError when the servo refuses."""
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
    """Refuse what belongs to how the arm is set up and is not for this driver to change."""
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
    Bring all registers that steer motion to what they must hold; the torque is off.

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
    found = table = read_table(bus, motor)
    refuse_settings(bus, motor, table)
    if motor.gains.get(mode) != [table[name] for name in GAINS]:
        # nobody knows whose they are: another mode and back brings those of the manual
        other = (
            OperatingMode.EXTENDED_POSITION
            if mode == OperatingMode.CURRENT
            else OperatingMode.CURRENT
        )
        must_write(bus, motor, 'operating_mode', other)
        must_write(bus, motor, 'operating_mode', mode)
        table = read_table(bus, motor)
        motor.gains[mode] = [table[name] for name in GAINS]
    wanted = _wanted(motor, mode)
    for name, value in wanted.items():
        if found[name] != value:
            motor.settled[name] = f'{found[name]} to {value}'
        if table[name] != value:
            must_write(bus, motor, name, value)
    table = read_table(bus, motor)
    for name, value in wanted.items():
        if table[name] != value:
            raise DriverError(
                f'{bus.path}: {motor}: {name.replace("_", " ")} (address '
                f'{REGISTERS[name].address}): {value} was written, {table[name]} is read back; '
                'is another program on this bus, or its memory worn out?'
            )


def _wanted(motor: Motor, mode: int) -> dict[str, int]:
    """Return the registers that this servo has, name to what they must hold."""
    of_this_motor = {
        'operating_mode': mode,
        'current_limit': motor.strongest,
        'pwm_slope': motor.model.pwm_slope,
    }
    newer = motor.firmware >= motor.model.fast_read_firmware
    every = {
        setting.name: of_this_motor.get(setting.name, setting.value)
        for setting in SETTINGS
        if newer or not setting.newer
    }
    return {name: value for name, value in every.items() if value is not None}
