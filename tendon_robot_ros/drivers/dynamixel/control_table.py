"""
Control tables of the supported servos as data.

Addresses, sizes, units and limits are those of the e-manual's page of each motor; torque per
ampere is the printed stall torque over stall current at the recommended voltage. The X series
shares its addresses; only units, limits and defaults differ.

References
----------
ROBOTIS e-Manual, https://emanual.robotis.com/docs/en/dxl/x/ (one page per motor).

"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

from ...common.words import UNITS
from ..interface import FaultBit

RPM = UNITS['angle']['rev'] / UNITS['time']['min']  # [rad/s] the manual's unit of speed


class Counts(IntEnum):
    """Numbers of ticks and counts that the manual names."""

    TICKS_PER_TURN = 4096  # of the encoder: "Resolution"
    POSITION_MAX_TICKS = 256 * TICKS_PER_TURN - 1  # either way, in the extended position mode
    PWM_FULL = 885  # 100 %: address 36
    WATCHDOG_TRIPPED = 0xFF  # -1 as an unsigned byte: address 98


RADIANS_PER_TICK = math.tau / Counts.TICKS_PER_TURN


class OperatingMode(IntEnum):
    """Values of address 11."""

    CURRENT = 0
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5


class HardwareError(FaultBit):
    """Bits of address 70, and of address 63: which of them switch the torque off."""

    VOLTAGE = 0x01, 'input voltage outside its limits'
    OVERHEATING = 0x04, 'motor too hot'
    ENCODER = 0x08, 'motor encoder broken'
    SHOCK = 0x10, 'electrical shock, or too little power to run the motor'
    OVERLOAD = 0x20, 'load above the maximum output for too long'


class Register(NamedTuple):
    """A value of the control table: address, size [bytes], sign, and one count in SI units."""

    address: int
    size: int
    signed: bool = False
    unit: float = 1.0


REGISTERS = {
    'model_number': Register(0, 2),
    'firmware_version': Register(6, 1),
    'id': Register(7, 1),
    'baud_rate': Register(8, 1),
    'return_delay_time': Register(9, 1),
    'drive_mode': Register(10, 1),
    'operating_mode': Register(11, 1),
    'secondary_id': Register(12, 1),
    'homing_offset': Register(20, 4, signed=True),
    'temperature_limit': Register(31, 1),
    'max_voltage_limit': Register(32, 2, unit=0.1),
    'min_voltage_limit': Register(34, 2, unit=0.1),
    'pwm_limit': Register(36, 2),
    'current_limit': Register(38, 2),
    'startup_configuration': Register(60, 1),
    'pwm_slope': Register(62, 1),
    'shutdown': Register(63, 1),
    'torque_enable': Register(64, 1),
    'led': Register(65, 1),
    'status_return_level': Register(68, 1),
    'hardware_error_status': Register(70, 1),
    'velocity_i_gain': Register(76, 2),
    'velocity_p_gain': Register(78, 2),
    'position_d_gain': Register(80, 2),
    'position_i_gain': Register(82, 2),
    'position_p_gain': Register(84, 2),
    'feedforward_2nd_gain': Register(88, 2),
    'feedforward_1st_gain': Register(90, 2),
    'bus_watchdog': Register(98, 1, unit=0.02),
    'goal_pwm': Register(100, 2, signed=True),
    'goal_current': Register(102, 2, signed=True),
    'profile_acceleration': Register(108, 4),
    'profile_velocity': Register(112, 4, unit=0.229 * RPM),
    'goal_position': Register(116, 4, signed=True),
    'present_current': Register(126, 2, signed=True),
    'present_velocity': Register(128, 4, signed=True, unit=0.229 * RPM),
    'present_position': Register(132, 4, signed=True),
    'present_input_voltage': Register(144, 2, unit=0.1),
    'present_temperature': Register(146, 1),
}
# behind the last of them; indirect data begin there
TABLE_BYTES = max(register.address + register.size for register in REGISTERS.values())
GAINS = tuple(name for name in REGISTERS if name.endswith('_gain'))
# address 8 -> [1/s]
BAUD_RATES = {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}


# [1] of the stall current, before the gear moves: measured on an XM430-W350 (0.13 of 2.3 A)
FRICTION_CURRENT = 0.13 / 2.3


@dataclass(frozen=True)
class ServoModel:
    """
    What differs from motor to motor, as the manual prints it at the recommended voltage.

    Parameters
    ----------
    name : str
    number : int
        Model number, address 0.
    current_unit : float
        One count of current [A].
    current_limit : int
        Default and largest current limit [counts].
    stall_torque, stall_current : float
        [N·m], [A]
    no_load_rpm : float
        Speed without load [rev/min].
    voltage : tuple of float
        Lowest and highest recommended input voltage [V].
    temperature_limit : int
        Default shutdown temperature [°C].
    fast_read_firmware : int
        First firmware with the fast sync read.
    shutdown : int
        Default of address 63: which hardware errors switch the torque off.
    pwm_slope : int, optional
        Default of address 62, None where there is no such register.

    """

    name: str
    number: int
    current_unit: float
    current_limit: int
    stall_torque: float
    stall_current: float
    no_load_rpm: float
    voltage: tuple[float, float]
    temperature_limit: int
    fast_read_firmware: int
    shutdown: int
    pwm_slope: int | None = None

    @cached_property
    def torque_per_ampere(self) -> float:
        """Stall torque over stall current [N·m/A], before any calibration."""
        return self.stall_torque / self.stall_current

    @cached_property
    def no_load_speed(self) -> float:
        """Speed without load [rad/s]."""
        return self.no_load_rpm * RPM

    @cached_property
    def friction_current(self) -> float:
        """Current before the gear moves [A]: assumed, until a calibration replaces it."""
        return FRICTION_CURRENT * self.stall_current


# name, number, count [A], limit [counts], stall [N·m], [A], no load [rev/min], [V], [°C],
# firmware, shutdown, PWM slope: manual, the page of each motor
MODELS = {
    model.name: model
    for model in (
        ServoModel('XM430-W210', 1030, 2.69e-3, 1193, 3.0, 2.3, 77, (10.0, 14.8), 80, 45, 52),
        ServoModel('XM430-W350', 1020, 2.69e-3, 1193, 4.1, 2.3, 46, (10.0, 14.8), 80, 45, 52),
        ServoModel('XL330-M077', 1190, 1e-3, 1750, 0.215, 1.47, 383, (3.7, 6.0), 70, 46, 53, 140),
        ServoModel('XL330-M288', 1200, 1e-3, 1750, 0.52, 1.47, 103, (3.7, 6.0), 70, 46, 53, 140),
        ServoModel('XC330-T181', 1210, 1e-3, 910, 0.76, 0.80, 104, (6.5, 12.0), 70, 46, 52, 255),
        ServoModel('XC330-T288', 1220, 1e-3, 910, 0.92, 0.80, 65, (6.5, 12.0), 70, 46, 52, 255),
        ServoModel('XC330-M181', 1230, 1e-3, 2352, 0.60, 1.80, 129, (3.7, 6.0), 70, 46, 52, 140),
        ServoModel('XC330-M288', 1240, 1e-3, 2352, 0.93, 1.80, 81, (3.7, 6.0), 70, 46, 52, 140),
    )
}
MODEL_NAMES = {model.number: model.name for model in MODELS.values()}
# [model number] -> name of motors without current control: manual, address 0
WITHOUT_CURRENT = {
    1060: 'XL430-W250',
    1070: 'XC430-W150',
    1080: 'XC430-W240',
    1090: '2XL430-W250',
    1160: '2XC430-W250',
}
INSTEAD = (
    f'one of {", ".join(MODELS)}, or pull mode through backend: ros2_control (without current '
    'control nothing sets or limits the tension of a wire)'
)


def decode(register: Register, data: bytes) -> int:
    """Read the value of a register from its little-endian bytes."""
    return int.from_bytes(data, 'little', signed=register.signed)


def encode(register: Register, value: int) -> bytes:
    """Write the value of a register as little-endian bytes."""
    return value.to_bytes(register.size, 'little', signed=register.signed)
