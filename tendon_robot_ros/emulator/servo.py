"""
One emulated servo: its control table, its protection, its motor and gear with dry friction.

After a watchdog trip it behaves as in the e-manual's "Bus Watchdog(98)" and no more: the servo
stops, 98 reads -1, goal values are read-only (Data Range Error) until 0 is written to 98.
The manual does not say whether a stopped servo holds; here it is powerless in current mode and
holds its position in the position modes.

The dry friction is that of a geared servo: below it nothing moves, winding needs more current than
the wire's tension alone, paying out less. Drive mode, homing offset and secondary id have no
effect: the driver lets no torque come on with any but their defaults.

The addresses, units and enumerations are those of the driver's `control_table`: both are the
manual's. The behaviour of the servo is written here from the manual alone.

References
----------
ROBOTIS e-Manual, https://emanual.robotis.com/docs/en/dxl/x/ and /docs/en/dxl/protocol2/.

"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from ..drivers.dynamixel.control_table import (
    BAUD_RATES,
    RADIANS_PER_TICK,
    REGISTERS,
    TABLE_BYTES,
    Counts,
    HardwareError,
    OperatingMode,
    Register,
    ServoModel,
    decode,
    encode,
)

# [s] longest step of the integration, so that a goal of a 100 Hz driver is followed in ten steps
STEP_S = 1e-3
# [1] viscous drag at the no-load speed, in stall torques: small, because the servo's current loop
# hides most of it
DAMPING = 0.01
POSITION_GAIN = 40.0  # [1/s] of the position loop, so that a servo is 25 ms behind a moving goal
RAM_BEGIN = REGISTERS['torque_enable'].address  # the manual's "EEPROM area" ends before it


class StatusError(IntEnum):
    """Error numbers of a status packet, and its alert bit: manual, Protocol 2.0, "Error"."""

    RESULT_FAIL = 0x01
    INSTRUCTION = 0x02
    DATA_RANGE = 0x04
    DATA_LENGTH = 0x05
    DATA_LIMIT = 0x06
    ACCESS = 0x07
    ALERT = 0x80


PRESENT = {name for name in REGISTERS if name.startswith('present_')}
READ_ONLY = PRESENT | {'model_number', 'firmware_version', 'hardware_error_status'}
GOALS = ('goal_pwm', 'goal_current', 'goal_position')
WITHIN_LIMIT = {'goal_current': 'current_limit', 'goal_pwm': 'pwm_limit'}
# of the XL330-M077, by its manual; only the position's own counts here
GAINS = {
    'velocity_i_gain': 400,
    'velocity_p_gain': 40,
    'position_d_gain': 0,
    'position_i_gain': 400,
    'position_p_gain': 400,
    'feedforward_2nd_gain': 0,
    'feedforward_1st_gain': 0,
}
BY_ADDRESS = {register.address: name for name, register in REGISTERS.items()}


class Load(NamedTuple):
    """
    Torque of wires against a motor, and how it changes while the motor turns.

    Parameters
    ----------
    wires : list of (lever, pull, stiffness)
        Wire per angle [m/rad], tension [N], stiffness [N/m]; below zero a wire is slack, and
        becomes taut where pull + stiffness * lever * angle is zero.

    """

    wires: list[tuple[float, float, float]]

    def torque(self, turned: float = 0.0) -> float:
        """Return the torque [N·m] after a rotation by `turned` [rad]."""
        return sum(r * pull for (r, *_), pull in zip(self.wires, self.pulls(turned), strict=True))

    def pulls(self, turned: float) -> list[float]:
        """Return the tensions [N] after a rotation by `turned` [rad]."""
        return [max(0.0, pull + k * r * turned) for r, pull, k in self.wires]

    def stiffness(self, turned: float) -> float:
        """Return the derivative of the torque by the angle [N·m/rad]."""
        return sum(r * r * k for r, pull, k in self.wires if pull + k * r * turned > 0.0)


class ServoMotion:
    """
    State of one motor.

    Parameters
    ----------
    model : ServoModel
        Torque per ampere, friction and top speed.

    Attributes
    ----------
    angle : float
        Of the output shaft since the servo's zero [rad].
    speed : float
        [rad/s]
    current : float
        [A], signed like the torque.
    drag : float
        Against the speed [N·m]: viscous friction, and what keeps it from turning even faster when
        a wire turns it at its top speed.
    friction : float
        Dry friction of the gear at the output [N·m].
    damping : float
        Viscous friction [N·m·s/rad].

    """

    def __init__(self, model: ServoModel) -> None:
        """Stand still at the zero."""
        self.model = model
        self.angle = self.speed = self.current = self.drag = 0.0
        self.friction = model.friction_current * model.torque_per_ampere
        self.damping = DAMPING * model.stall_torque / model.no_load_speed

    @property
    def ticks(self) -> int:
        """Position as the encoder counts it."""
        return math.floor(self.angle / RADIANS_PER_TICK + 0.5)

    def drive_current(self, current: float, load: Load, step: float) -> None:
        """
        Give a current [A] against a load for one step [s].

        Damping, friction and wires as they are at its end balance. Without current only a load
        above the friction turns the gear backwards.
        """
        self.current = current
        torque = current * self.model.torque_per_ampere
        net = torque - load.torque()
        if abs(net) <= self.friction:
            self.speed = self.drag = 0.0
            return
        net -= math.copysign(self.friction, net)
        torque -= math.copysign(self.friction, net)
        turned, drag = 0.0, self.damping / step
        # Newton's method; the load is piecewise linear: an iteration, and one for every kink
        for _ in range(len(load.wires) + 2):
            before = turned
            turned += net / (drag + load.stiffness(turned + math.copysign(1e-9, net)))
            net = torque - load.torque(turned) - drag * turned
            if turned == before or abs(net) < 1e-9:
                break
        top = self.model.no_load_speed
        self.speed = max(-top, min(top, turned / step))
        self.angle += self.speed * step
        self.drag = torque - load.torque(self.speed * step)

    def drive_position(
        self, goal: float, limit: float, load: Load, step: float, top: float, gain: float
    ) -> None:
        """
        Turn towards an angle for one step.

        Parameters
        ----------
        goal : float
            [rad]
        limit : float
            Largest current [A].
        load : Load
        step : float
            [s]
        top : float
            Fastest turning [rad/s].
        gain : float
            Of the position loop, as a fraction of the usual one.

        """
        error, top = goal - self.angle, min(top, self.model.no_load_speed)
        speed = max(-top, min(top, gain * POSITION_GAIN * error))
        moves = abs(error) > 0.5 * RADIANS_PER_TICK
        friction = math.copysign(self.friction, speed) if moves else 0.0
        torque = load.torque(speed * step) + friction + self.damping * speed
        needed = torque / self.model.torque_per_ampere
        if abs(needed) <= limit:
            self.current, self.speed = needed, speed
            self.drag = self.damping * speed
            self.angle += speed * step
        else:
            self.drive_current(math.copysign(limit, needed), load, step)


class Servo:
    """A servo of one model with an id."""

    def __init__(
        self, model: ServoModel, identity: int, baud: int = 1_000_000, firmware: int = 48
    ) -> None:
        """Switch the power on."""
        self.model, self.identity, self.firmware = model, identity, firmware
        self.motion = ServoMotion(model)
        self.temperature = 30.0  # [°C]
        self.voltage = 0.5 * sum(model.voltage)  # [V]
        self._bytes = bytearray(TABLE_BYTES)
        eeprom = {
            'model_number': model.number,
            'firmware_version': firmware,
            'id': identity,
            'baud_rate': next(k for k, v in BAUD_RATES.items() if v == baud),
            'return_delay_time': 250,
            'operating_mode': OperatingMode.POSITION,
            'secondary_id': 255,
            'pwm_limit': Counts.PWM_FULL,
            'pwm_slope': model.pwm_slope or 0,
            'shutdown': model.shutdown,
            'temperature_limit': model.temperature_limit,
            'current_limit': model.current_limit,
            'max_voltage_limit': round(10 * model.voltage[1]) + 12,
            'min_voltage_limit': round(10 * model.voltage[0]) - 5,
        }
        for name, value in eeprom.items():
            self.put(name, value)
        self.boot()

    def boot(self) -> None:
        """
        Start the firmware: RAM goes to its defaults, turns are forgotten.

        With bit 0 of the startup configuration the torque comes on where the motor is.
        """
        self._bytes[RAM_BEGIN:] = bytes(TABLE_BYTES - RAM_BEGIN)
        self.put('status_return_level', 2)
        self.motion.angle = self.motion.ticks % Counts.TICKS_PER_TURN * RADIANS_PER_TICK
        self.motion.speed = self.motion.current = self.motion.drag = 0.0
        self.silence = 0.0  # [s] since the last instruction packet
        self._mode_to_defaults()
        self.refresh()
        if self.get('startup_configuration') & 1:
            self.put('goal_position', self.get('present_position'))
            self.put('torque_enable', 1)

    def get(self, name: str) -> int:
        """Read a register by name."""
        register = REGISTERS[name]
        start = register.address
        return decode(register, bytes(self._bytes[start : start + register.size]))

    def put(self, name: str, value: int) -> None:
        """Set a register by name, without any check: what the firmware itself does."""
        register = REGISTERS[name]
        start = register.address
        self._bytes[start : start + register.size] = encode(register, value)

    @property
    def torque(self) -> bool:
        """Whether the torque is on."""
        return self.get('torque_enable') == 1

    @property
    def tripped(self) -> bool:
        """Whether the bus watchdog has tripped."""
        return self.get('bus_watchdog') == Counts.WATCHDOG_TRIPPED

    @property
    def alert(self) -> int:
        """Alert bit of every status packet."""
        return StatusError.ALERT if self.get('hardware_error_status') else 0

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Answer a read: error byte and data."""
        if length < 1 or address + length > TABLE_BYTES:
            return StatusError.ACCESS | self.alert, b''
        return self.alert, bytes(self._bytes[address : address + length])

    def write(self, address: int, data: bytes) -> int:
        """Carry out a write; return the error byte."""
        position = 0
        while position < len(data):
            name = BY_ADDRESS.get(address + position)
            if name is None or name in READ_ONLY:
                return StatusError.ACCESS | self.alert
            register = REGISTERS[name]
            part = data[position : position + register.size]
            if len(part) < register.size:
                return StatusError.DATA_LENGTH | self.alert
            value = decode(register, part)
            if error := self._refusal(name, register, value):
                return error | self.alert
            self._accept(name, value)
            position += register.size
        return self.alert

    def _refusal(self, name: str, register: Register, value: int) -> int:
        """Return the error number with which a register refuses a value, 0 where it does not."""
        if register.address < RAM_BEGIN and self.torque:
            return StatusError.ACCESS
        if name in GOALS and self.tripped:
            return StatusError.DATA_RANGE
        if name == 'torque_enable' and value > 1:
            return StatusError.DATA_RANGE
        if name == 'torque_enable' and value and self._shut_down():
            return StatusError.RESULT_FAIL
        if name == 'bus_watchdog' and (value > 127 or (value and self.tripped)):
            return StatusError.DATA_RANGE
        if name in WITHIN_LIMIT and abs(value) > self.get(WITHIN_LIMIT[name]):
            return StatusError.DATA_LIMIT
        return 0

    def _accept(self, name: str, value: int) -> None:
        """Write a register, with the side effects of the firmware."""
        if name == 'torque_enable' and value and not self.torque:
            self.put('goal_position', self.get('present_position'))
            if self.get('operating_mode') == OperatingMode.CURRENT:
                self.put('goal_current', 0)
        before = self.get(name)
        self.put(name, value)
        if name == 'operating_mode' and value != before:
            self._mode_to_defaults()
        self.refresh()

    def _shut_down(self) -> bool:
        """Tell whether a hardware error keeps the torque off until a reboot."""
        return bool(self.get('hardware_error_status') & self.get('shutdown'))

    def _mode_to_defaults(self) -> None:
        """Reset what a new operating mode resets: gains, profile, goals, PWM."""
        for name, value in (GAINS | {'profile_velocity': 0, 'profile_acceleration': 0}).items():
            self.put(name, value)
        if self.get('operating_mode') == OperatingMode.CURRENT_BASED_POSITION:
            self.put('pwm_limit', Counts.PWM_FULL)
        in_current_mode = self.get('operating_mode') == OperatingMode.CURRENT
        self.put('goal_current', 0 if in_current_mode else self.get('current_limit'))
        self.put('goal_pwm', self.get('pwm_limit'))

    def fail(self, bits: int) -> None:
        """Set hardware errors; the ones that the shutdown mask names switch the torque off."""
        self.put('hardware_error_status', self.get('hardware_error_status') | bits)
        if self._shut_down():
            self.put('torque_enable', 0)

    def protect(self, passed: float) -> None:
        """Let time [s] pass for the watchdog, the temperature and the voltage."""
        self.silence += passed
        watchdog = self.get('bus_watchdog') * REGISTERS['bus_watchdog'].unit
        if self.torque and not self.tripped and 0 < watchdog < self.silence:
            self.put('bus_watchdog', Counts.WATCHDOG_TRIPPED)
            self.put('goal_position', self.motion.ticks)
            if self.get('operating_mode') == OperatingMode.CURRENT:
                self.put('goal_current', 0)
        if self.temperature > self.get('temperature_limit'):
            self.fail(HardwareError.OVERHEATING)
        low, high = self.get('min_voltage_limit'), self.get('max_voltage_limit')
        if not low <= self.voltage / REGISTERS['present_input_voltage'].unit <= high:
            self.fail(HardwareError.VOLTAGE)

    def step(self, step: float, load: Load) -> None:
        """Let the motor turn for at most `STEP_S` [s] against a load."""
        if not self.torque:
            self.motion.drive_current(0.0, load, step)
            return
        unit, model = self.model.current_unit, self.model
        duty = min(self.get('pwm_limit'), abs(self.get('goal_pwm'))) / Counts.PWM_FULL
        stalled = duty * model.stall_torque / model.torque_per_ampere  # [A]
        limit = min(self.get('current_limit') * unit, stalled)
        current = self.get('goal_current') * unit
        mode = self.get('operating_mode')
        if mode == OperatingMode.CURRENT:
            self.motion.drive_current(max(-limit, min(limit, current)), load, step)
            return
        if mode == OperatingMode.CURRENT_BASED_POSITION:
            limit = min(limit, abs(current))
        top, profile = duty * model.no_load_speed, self.get('profile_velocity')
        if profile:
            top = min(top, profile * REGISTERS['profile_velocity'].unit)
        goal = self.get('goal_position') * RADIANS_PER_TICK
        gain = self.get('position_p_gain') / GAINS['position_p_gain']
        self.motion.drive_position(goal, limit, load, step, top, gain)

    def refresh(self) -> None:
        """Write the readings of the sensors into the table."""
        motion = self.motion
        self.put('present_position', motion.ticks)
        self.put('present_current', round(motion.current / self.model.current_unit))
        self.put('present_velocity', round(motion.speed / REGISTERS['present_velocity'].unit))
        self.put('present_temperature', round(self.temperature))
        volt = REGISTERS['present_input_voltage'].unit
        self.put('present_input_voltage', round(self.voltage / volt))
