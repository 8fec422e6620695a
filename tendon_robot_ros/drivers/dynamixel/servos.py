"""
Servos on a bus: who is there, registers that affect motion, torque on and off, coming back.

The handshake compares the servos with the configuration. One table lists the required values of
the registers; one loop sets or refuses them and reads them back, whatever another program left.
The torque comes on without a jump, and after an interruption a servo continues from where it is.

References
----------
ROBOTIS e-Manual, "Control Table Description" on the page of each motor.

"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from ...common.errors import DriverError
from ...common.processes import in_realtime
from ..serial_port import PortLostError
from .bus import Bus
from .config import DynamixelConfig
from .control_table import (
    GAINS,
    INSTEAD,
    MODEL_NAMES,
    REGISTERS,
    WITHOUT_CURRENT,
    Counts,
    HardwareError,
    OperatingMode,
)
from .motor import HEALTH, STATE, Motor

ATTEMPTS = 3  # [1] of a request or a write, so that one broken answer is no missing servo
# [1/s] as delivered (manual, address 8), and the usual one
OTHER_RATES = (57600, 1_000_000)
WATCHDOG_S = 0.2  # [s] of silence, because a busy computer is late by as much: docs/safety.md
# [s] of silence where this thread is in real time: four counts, docs/safety.md
WATCHDOG_REALTIME_S = 0.08
# [s] for which a tripped watchdog is a fault, so that a reader of diagnostics sees it
TRIP_REPORTED_S = 0.5
# [s] between two reads of what is not part of the state: a hardware error is noticed in two cycles
# of 100 Hz and no two become due in the same one, so that a cycle has at most one of them
POLL_PERIODS = {
    'hardware_error_status': 0.020,
    'bus_watchdog': 0.045,
    'torque_enable': 0.025,
    'health': 0.250,
}


class Setting(NamedTuple):
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
# Goals (102, 116) become the present state, see `hold`. The velocity limit (44) bounds the goal
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
    Setting('pwm_limit', Counts.PWM_FULL, 'it turns slowly and with little torque'),
    Setting('current_limit', None, 'it pulls more, or less, than it may'),
    Setting('startup_configuration', 0, 'its torque is on after a power cut', newer=True),
    Setting('pwm_slope', None, 'its torque comes late'),
    Setting('bus_watchdog', 0, 'a tripped one takes no goals; set when the torque is on'),
    Setting('goal_pwm', Counts.PWM_FULL, 'as the PWM limit'),
    Setting('profile_acceleration', 0, 'it follows late'),
    Setting('profile_velocity', 0, 'it follows slowly'),
)


def must_write(bus: Bus, motor: Motor, name: str, value: int) -> None:
    """Write a register in a few attempts; raise DriverError when the servo refuses."""
    for _ in range(ATTEMPTS):
        if (problem := bus.write(motor.identity, name, value)) is None:
            return
    raise DriverError(f'{bus.path}: {motor}: {name} = {value}: {problem}')


def read_table(bus: Bus, motor: Motor) -> dict[str, int]:
    """Read all registers of a servo; raise DriverError where it does not answer."""
    for _ in range(ATTEMPTS):
        if (table := bus.table(motor.identity)) is not None:
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
        in_current = mode == OperatingMode.CURRENT
        other = OperatingMode.EXTENDED_POSITION if in_current else OperatingMode.CURRENT
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
        if not (talker := bus.second_talker()):
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
            volt = REGISTERS['min_voltage_limit'].unit
            low, high = table['min_voltage_limit'], table['max_voltage_limit']
            motor.voltage_limits = (volt * low, volt * high)
            motor.hottest = table['temperature_limit'] - config.temperature_margin
            motor.errors = table['hardware_error_status']
            motor.answers = True
    bus.fast = all(m.firmware >= m.model.fast_read_firmware for m in motors.values())


def refuse_servos(bus: Bus, motors: dict[int, Motor], models: dict[int, int]) -> None:
    """Raise DriverError with the expected servos and those that answer (0: no answer)."""
    if without := {i: WITHOUT_CURRENT[n] for i, n in models.items() if n in WITHOUT_CURRENT}:
        named = ', '.join(f'{identity}: {name}' for identity, name in without.items())
        raise DriverError(f'{bus.path}: model: expected {INSTEAD}, found {named}')
    present = {i: number for i, number in models.items() if number} | bus.everyone()
    versions = {i: bus.read(i, 'firmware_version') for i in sorted(present)}
    firmware = {i: f' firmware {v}' for i, v in versions.items() if v is not None}
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


def watchdog_time(config: DynamixelConfig) -> tuple[float, str]:
    """
    Return after which silence [s] the motors stop by themselves, and why after that.

    Without a time of its own in the configuration it is short only where the calling thread,
    which is to talk to the motors, is in real time: a trip has no ramp.
    """
    if config.watchdog is not None:
        return config.watchdog, 'as configured'
    if in_realtime():
        return WATCHDOG_REALTIME_S, 'default in real time'
    return WATCHDOG_S, 'default without real time; docs/safety.md tells how to get it'


def watchdog_counts(seconds: float) -> int:
    """Return the value of address 98: at least one unit when it is on at all."""
    return min(127, math.ceil(seconds / REGISTERS['bus_watchdog'].unit - 1e-9))


def operating_mode(config: DynamixelConfig, mode: str) -> int:
    """Return the value of address 11."""
    if mode == 'tension':
        return OperatingMode.CURRENT
    if config.pull_operation == 'extended':
        return OperatingMode.EXTENDED_POSITION
    return OperatingMode.CURRENT_BASED_POSITION


def read_state(bus: Bus, motors: Collection[Motor]) -> None:
    """Read current, velocity and position of several servos."""
    blocks = bus.block(*STATE, [motor.identity for motor in motors])
    for motor in motors:
        data = blocks.get(motor.identity)
        motor.answers = data is not None
        if data is not None:
            motor.take(data)


def read_all(bus: Bus, motors: Collection[Motor]) -> None:
    """Read the state of servos; raise DriverError with those that do not answer."""
    read_state(bus, motors)
    if silent := [str(motor) for motor in motors if not motor.answers]:
        raise DriverError(f'{bus.path}: {", ".join(silent)}: no answer; check the cable')


def torque_on(bus: Bus, motors: Collection[Motor], mode: int, watchdog: int) -> None:
    """
    Switch the torque on where the motors are.

    Parameters
    ----------
    bus : Bus
    motors : collection of Motor
    mode : int
        Operating mode, address 11.
    watchdog : int
        Address 98, in units of 20 ms; 0 = off.

    Raises
    ------
    DriverError
        A hardware error keeps it off, or a servo does not take a value.

    """
    for motor in motors:
        if errors := bus.read(motor.identity, 'hardware_error_status'):
            words = ', '.join(bit.words for bit in HardwareError if errors & bit)
            raise DriverError(f'{bus.path}: {motor}: {words}; remove the cause, then reboot it')
        must_write(bus, motor, 'torque_enable', 0)
        settle(bus, motor, mode)
    read_all(bus, motors)
    hold(bus, motors, mode)
    for motor in motors:
        must_write(bus, motor, 'torque_enable', 1)
        motor.torque_requested, motor.restarted, motor.tripped = True, False, False
    hold(bus, motors, mode)
    for motor in motors:
        must_write(bus, motor, 'bus_watchdog', watchdog)


def send_currents(bus: Bus, currents: Mapping[Motor, int]) -> None:
    """Send goal currents [counts], within the bounds of each motor."""
    goals = {motor.identity: current for motor, current in currents.items()}
    bus.send_goals('goal_current', goals, {m.identity: m.current_bounds for m in currents})


def send_positions(bus: Bus, positions: Mapping[Motor, int]) -> None:
    """Send goal positions [ticks], within the bounds of each motor."""
    goals = {motor.identity: ticks for motor, ticks in positions.items()}
    bus.send_goals('goal_position', goals, {m.identity: m.position_bounds for m in positions})


def hold(bus: Bus, motors: Collection[Motor], mode: int) -> None:
    """Make the present state the goal: the measured current, or the measured position."""
    chosen = [motor for motor in motors if motor.ticks is not None]
    if mode == OperatingMode.CURRENT:
        send_currents(bus, {motor: motor.current or 0 for motor in chosen})
        return
    if mode == OperatingMode.CURRENT_BASED_POSITION:
        send_currents(bus, {motor: motor.current_bounds[1] for motor in chosen})
    ticks = {motor.identity: motor.ticks or 0 for motor in chosen}
    bus.send_goals('goal_position', ticks, {i: (goal, goal) for i, goal in ticks.items()})


def torque_off(bus: Bus, motors: Collection[Motor]) -> None:
    """
    Switch the torque off; a servo that does not answer gets two attempts.

    Where the port is lost, the motors are switched off when it comes back.
    """
    for motor in motors:
        motor.torque_requested = motor.restarted = motor.tripped = False
    for motor in motors:
        for _ in range(2):
            if bus.write(motor.identity, 'torque_enable', 0) is None:
                break


def come_back(bus: Bus, motor: Motor, mode: int, watchdog: int) -> bool:
    """
    Read the state of a servo after a lost connection, and continue from its position.

    A servo that lost its power stays off: somebody may have used the switch in the motor supply.

    Returns
    -------
    bool
        Whether it answers again.

    """
    known = bus.ping(motor.identity) == motor.model.number
    torque, state = (
        bus.read(motor.identity, name) if known else None
        for name in ('torque_enable', 'bus_watchdog')
    )
    if torque is None or state is None:
        motor.answers = False
        return False
    read_state(bus, [motor])
    if not motor.torque_requested:
        if torque:
            torque_off(bus, [motor])
    elif not torque or (watchdog and state == 0):
        lost_power(motor)
        bus.write(motor.identity, 'torque_enable', 0)
    else:
        recover_watchdog(bus, motor, mode, watchdog, tripped=state == Counts.WATCHDOG_TRIPPED)
    return motor.answers


def lost_power(motor: Motor) -> None:
    """Note that a servo lost its torque by itself; its count of turns is unknown now."""
    motor.restarted, motor.torque_requested, motor.zero = True, False, None


def recover_watchdog(bus: Bus, motor: Motor, mode: int, watchdog: int, tripped: bool) -> None:
    """Clear a tripped watchdog, hold what is measured now, and arm it again."""
    if tripped:
        bus.write(motor.identity, 'bus_watchdog', 0)
    hold(bus, [motor], mode)
    if tripped:
        bus.write(motor.identity, 'bus_watchdog', watchdog)
    motor.tripped = False


class Watch:
    """
    Polls of registers beside the state, one kind per cycle, whichever is most overdue.

    The alert bit of a status packet is hidden in group reads, so hardware errors are read from
    address 70. A bad value is read once more before anything follows from it: a late answer of
    another read may look like it.
    """

    def __init__(self, bus: Bus, mode: int) -> None:
        """Take the operating mode, address 11."""
        self.bus, self.mode = bus, mode
        self.watchdog = 0  # address 98
        self.due: dict[str, float] = {}
        self.tripped: list[Motor] = []  # whose watchdog had tripped at this poll
        self._reported = -math.inf

    def poll(self, motors: list[Motor], now: float) -> None:
        """Do the most overdue poll, if any, for the servos that answer."""
        self.tripped = []
        for motor in motors:
            motor.tripped = motor.tripped and now - self._reported < TRIP_REPORTED_S
        late = {name: now - self.due.get(name, 0.0) for name in POLL_PERIODS}
        name = max(late, key=lambda n: late[n] / POLL_PERIODS[n])
        if late[name] < 0.0 or not motors:
            return
        self.due[name] = now + POLL_PERIODS[name]
        register = REGISTERS.get(name)  # or health: several in a row
        where = HEALTH if register is None else (register.address, register.size)
        blocks = self.bus.block(*where, [motor.identity for motor in motors])
        for motor in motors:
            data = blocks.get(motor.identity)
            if data is None:
                motor.answers = False  # read twice already
            elif register is None:
                motor.take_health(data)
            else:
                self.check(name, motor, data[0])

    def check(self, register: str, motor: Motor, value: int) -> None:
        """Act on the value of a polled register, if it is bad and another read confirms it."""
        bad = {
            'hardware_error_status': value != motor.errors,
            'bus_watchdog': motor.torque_requested and value != self.watchdog,
            'torque_enable': motor.torque_requested and not value,
        }
        if not bad[register] or self.bus.read(motor.identity, register) != value:
            return
        if register == 'hardware_error_status':
            motor.errors = value
            if value:
                torque_off(self.bus, [motor])
        elif register == 'torque_enable':  # switched off by itself: an error, or the power
            status = self.bus.read(motor.identity, 'hardware_error_status') or 0
            self.check('hardware_error_status', motor, status)
            if not motor.errors:
                lost_power(motor)
        elif value == Counts.WATCHDOG_TRIPPED:
            recover_watchdog(self.bus, motor, self.mode, self.watchdog, tripped=True)
            motor.tripped, self._reported = True, time.monotonic()
            self.tripped.append(motor)
        elif value == 0:  # it has forgotten its watchdog
            lost_power(motor)
            self.bus.write(motor.identity, 'torque_enable', 0)
