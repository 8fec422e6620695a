"""
One emulated servo: its control table, what it answers, how it protects itself.

What happens on a watchdog trip is what the e-manual's "Bus Watchdog(98)" says and no more: the
servo stops, 98 reads -1, goal values are read-only (Data Range Error) until 0 is written to 98.
The manual does not say whether a stopped servo holds; here it is powerless in current mode and
holds its position in the position modes.
"""

from __future__ import annotations

import math

from ..drivers.dynamixel import control_table
from ..drivers.dynamixel.control_table import (
    CURRENT_MODE,
    CURRENT_POSITION_MODE,
    PWM_FULL,
    REGISTERS,
    TABLE_BYTES,
    WATCHDOG_TRIPPED,
    Register,
)
from .motion import TICK, Load, ServoMotion, drive

RESULT_FAIL, INSTRUCTION_ERROR = 0x01, 0x02
DATA_RANGE, DATA_LENGTH, DATA_LIMIT, ACCESS = 0x04, 0x05, 0x06, 0x07
ALERT = 0x80
EEPROM_END = 64
READ_ONLY = (
    'model_number',
    'firmware_version',
    'hardware_error_status',
    'moving',
    'present_current',
    'present_velocity',
    'present_position',
    'present_input_voltage',
    'present_temperature',
)
GOALS = ('goal_pwm', 'goal_current', 'goal_velocity', 'goal_position')
WITHIN_LIMIT = {'goal_current': 'current_limit', 'goal_pwm': 'pwm_limit'}
REVERSE, TIME_BASED, TORQUE_BY_GOAL = 0x01, 0x04, 0x08  # bits of the drive mode, address 10
TORQUE_AT_START = 0x01  # bit of the startup configuration, address 60
GAINS = {
    'velocity_i_gain': 400,
    'velocity_p_gain': 40,
    'position_d_gain': 0,
    'position_i_gain': 400,
    'position_p_gain': 400,
    'feedforward_2nd_gain': 0,
    'feedforward_1st_gain': 0,
}  # of the XL330-M077; only the position's own counts here
BY_ADDRESS = {register.address: name for name, register in REGISTERS.items()}


class Servo:
    """A servo of one model with an id."""

    def __init__(
        self,
        model: control_table.ServoModel,
        identity: int,
        baud: int = 1_000_000,
        firmware: int = 48,
    ) -> None:
        """Switch the power on."""
        self.model, self.identity, self.firmware = model, identity, firmware
        self.motion = ServoMotion(model)
        self.temperature = 30.0  # [°C]
        self.voltage = 0.5 * sum(model.voltage)  # [V]
        self._bytes = bytearray(TABLE_BYTES)
        self._leg = 0.0  # [rad] from where the last goal position found it
        self._eeprom = {
            'model_number': model.number,
            'firmware_version': firmware,
            'id': identity,
            'baud_rate': next(k for k, v in control_table.BAUD_RATES.items() if v == baud),
            'return_delay_time': 250,
            'operating_mode': 3,
            'secondary_id': 255,
            'pwm_limit': PWM_FULL,
            'pwm_slope': model.pwm_slope or 0,
            'shutdown': model.shutdown,
            'temperature_limit': model.temperature_limit,
            'current_limit': model.current_limit,
            'max_voltage_limit': round(10 * model.voltage[1]) + 12,
            'min_voltage_limit': round(10 * model.voltage[0]) - 5,
        }
        for name, value in self._eeprom.items():
            self.put(name, value)
        self.boot()

    def boot(self) -> None:
        """
        Start the firmware: RAM goes to its defaults, turns are forgotten.

        With bit 0 of the startup configuration the torque comes on where the motor is.
        """
        self._bytes[EEPROM_END:] = bytes(TABLE_BYTES - EEPROM_END)
        self.put('status_return_level', 2)
        self.motion.angle = self.motion.ticks % control_table.TICKS_PER_TURN * TICK
        self.motion.speed = self.motion.current = self.motion.drag = 0.0
        self.silence = 0.0  # [s] since the last instruction packet
        self._mode_to_defaults()
        self.refresh()
        if self.get('startup_configuration') & TORQUE_AT_START:
            self.put('goal_position', self.get('present_position'))
            self.put('torque_enable', 1)

    def get(self, name: str) -> int:
        """Read a register by name."""
        register = REGISTERS[name]
        start = register.address
        return control_table.decode(register, bytes(self._bytes[start : start + register.size]))

    def put(self, name: str, value: int) -> None:
        """Set a register by name, without any check: what the firmware itself does."""
        register = REGISTERS[name]
        start = register.address
        self._bytes[start : start + register.size] = control_table.encode(register, value)

    @property
    def torque(self) -> bool:
        """Whether the torque is on."""
        return self.get('torque_enable') == 1

    @property
    def tripped(self) -> bool:
        """Whether the bus watchdog has tripped."""
        return self.get('bus_watchdog') == WATCHDOG_TRIPPED

    @property
    def alert(self) -> int:
        """Alert bit of every status packet."""
        return ALERT if self.get('hardware_error_status') else 0

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Answer a read: error byte and data."""
        if length < 1 or address + length > TABLE_BYTES:
            return ACCESS | self.alert, b''
        return self.alert, bytes(self._bytes[address : address + length])

    def write(self, address: int, data: bytes) -> int:
        """Carry out a write; return the error byte."""
        position = 0
        while position < len(data):
            name = BY_ADDRESS.get(address + position)
            if name is None or name in READ_ONLY:
                return ACCESS | self.alert
            register = REGISTERS[name]
            part = data[position : position + register.size]
            if len(part) < register.size:
                return DATA_LENGTH | self.alert
            error = self._write_one(name, register, control_table.decode(register, part))
            if error:
                return error | self.alert
            position += register.size
        return self.alert

    def _write_one(self, name: str, register: Register, value: int) -> int:
        if register.address < EEPROM_END and self.torque:
            return ACCESS
        if name in GOALS and self.tripped:
            return DATA_RANGE
        if name == 'torque_enable' and (value > 1 or (value and self._shut_down())):
            return DATA_RANGE if value > 1 else RESULT_FAIL
        if name == 'bus_watchdog' and (value > 127 or (value and self.tripped)):
            return DATA_RANGE
        if name in WITHIN_LIMIT and abs(value) > self.get(WITHIN_LIMIT[name]):
            return DATA_LIMIT
        on_by_goal = name in GOALS and self.get('drive_mode') & TORQUE_BY_GOAL
        if (on_by_goal or (name == 'torque_enable' and value)) and not self.torque:
            self.put('goal_position', self.get('present_position'))
            if self.get('operating_mode') == CURRENT_MODE:
                self.put('goal_current', 0)
        before = self.get(name)
        self.put(name, value)
        if on_by_goal and not self._shut_down():
            self.put('torque_enable', 1)
        if name == 'operating_mode' and value != before:
            self._mode_to_defaults()
        if name == 'goal_position':
            self._leg = abs(self._to_angle(value) - self.motion.angle)
        self.refresh()
        return 0

    def _shut_down(self) -> bool:
        """Tell whether a hardware error keeps the torque off until a reboot."""
        return bool(self.get('hardware_error_status') & self.get('shutdown'))

    def _mode_to_defaults(self) -> None:
        """Reset what a new operating mode resets: gains, profile, goals, PWM."""
        for name, value in GAINS.items():
            self.put(name, value)
        self.put('profile_velocity', 0)
        self.put('profile_acceleration', 0)
        if self.get('operating_mode') == CURRENT_POSITION_MODE:
            self.put('pwm_limit', PWM_FULL)
        in_current_mode = self.get('operating_mode') == CURRENT_MODE
        self.put('goal_current', 0 if in_current_mode else self.get('current_limit'))
        self.put('goal_pwm', self.get('pwm_limit'))

    def _to_angle(self, position: int) -> float:
        """Return the angle [rad] of a position as the table has it."""
        sign = -1 if self.get('drive_mode') & REVERSE else 1
        return sign * (position - self.get('homing_offset')) * TICK

    def _to_position(self, ticks: int) -> int:
        sign = -1 if self.get('drive_mode') & REVERSE else 1
        return sign * ticks + self.get('homing_offset')

    def _top_speed(self, duty: float) -> float:
        """Return how fast PWM and profile let it turn towards a goal [rad/s]."""
        top, profile = duty * self.model.no_load_speed, self.get('profile_velocity')
        if not profile or self.get('operating_mode') == CURRENT_MODE:
            return top
        if self.get('drive_mode') & TIME_BASED:
            return min(top, self._leg / (1e-3 * profile))
        return min(top, profile * control_table.RPM_PER_COUNT * 2.0 * math.pi / 60.0)

    def heard(self) -> None:
        """Note that an instruction packet went over the bus: it feeds the watchdog."""
        self.silence = 0.0

    def fail(self, bits: int) -> None:
        """Set hardware errors; the ones that the shutdown mask names switch the torque off."""
        self.put('hardware_error_status', self.get('hardware_error_status') | bits)
        if self._shut_down():
            self.put('torque_enable', 0)

    def protect(self, passed: float) -> None:
        """Let time [s] pass for the watchdog, the temperature and the voltage."""
        self.silence += passed
        watchdog = self.get('bus_watchdog') * control_table.WATCHDOG_UNIT_S
        if self.torque and not self.tripped and 0 < watchdog < self.silence:
            self._stop()
        if self.temperature > self.get('temperature_limit'):
            self.fail(0x04)
        low, high = self.get('min_voltage_limit'), self.get('max_voltage_limit')
        if not low <= self.voltage / control_table.VOLT_PER_COUNT <= high:
            self.fail(0x01)

    def _stop(self) -> None:
        """Trip the watchdog."""
        self.put('bus_watchdog', WATCHDOG_TRIPPED)
        self.put('goal_position', self._to_position(self.motion.ticks))
        if self.get('operating_mode') == CURRENT_MODE:
            self.put('goal_current', 0)

    def step(self, step: float, load: Load) -> None:
        """Let the motor turn for at most 1 ms [s] against a load."""
        if not self.torque:
            self.motion.limp(load, step)
            return
        unit, model = self.model.current_unit, self.model
        duty = min(self.get('pwm_limit'), abs(self.get('goal_pwm'))) / PWM_FULL
        stalled = duty * model.stall_torque / model.torque_per_ampere  # [A]
        sign = -1 if self.get('drive_mode') & REVERSE else 1
        drive(
            self.motion,
            self.get('operating_mode'),
            (sign * self.get('goal_current') * unit, self._to_angle(self.get('goal_position'))),
            min(self.get('current_limit') * unit, stalled),
            load,
            step,
            self._top_speed(duty),
            self.get('position_p_gain') / GAINS['position_p_gain'],
        )

    def refresh(self) -> None:
        """Put what the sensors say into the table."""
        motion = self.motion
        self.put('present_position', self._to_position(motion.ticks))
        self.put('present_current', round(motion.current / self.model.current_unit))
        self.put(
            'present_velocity',
            round(motion.speed / (2 * math.pi) * 60 / control_table.RPM_PER_COUNT),
        )
        self.put('present_temperature', round(self.temperature))
        self.put('present_input_voltage', round(self.voltage / control_table.VOLT_PER_COUNT))
        self.put('moving', int(abs(motion.speed) > 0.01))
