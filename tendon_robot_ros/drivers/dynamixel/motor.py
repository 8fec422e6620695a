"""One servo as the driver knows it: its last readings, its limits, its faults."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from ..hardware import READINGS_MIN
from ..interface import Fault, latched
from .config import DynamixelConfig, MotorWire
from .control_table import REGISTERS, Counts, HardwareError, decode

# of that current, because a reading is rounded, rippled and a cycle old: a fraction [1] ...
CARRIED_MARGIN = 0.1
CARRIED_MARGIN_COUNTS = 3  # [counts] ... and some counts, because of small currents


def span(first: str, last: str) -> tuple[int, int]:
    """Return address and length [bytes] of all registers from one to another."""
    end = REGISTERS[last].address + REGISTERS[last].size
    return REGISTERS[first].address, end - REGISTERS[first].address


STATE = span('present_current', 'present_position')
HEALTH = span('present_input_voltage', 'present_temperature')


class Motor:
    """
    State of one servo.

    Parameters
    ----------
    identity : int
    wires : tuple of MotorWire
        The inputs it winds.
    mode : str
        `tension` or `pull`.

    Attributes
    ----------
    model : ServoModel
    names : tuple of str
        Of its inputs.
    torque_requested : bool
        The driver has switched the torque on.
    answers : bool
        It answered the last read.
    errors : int
        Hardware error status, address 70.
    restarted, tripped : bool
        It lost its power, or its torque was switched off; its bus watchdog tripped.
    ticks, current : int, optional
        Last good reading, position in ticks and current in counts.
    zero : float, optional
        Ticks at which the pulls are zero, None while unknown.
    gains : dict of int to list of int
        Operating mode -> gains (76 to 91) that the motor itself has for it.
    settled : dict of str to str
        Register -> how the driver has changed it, as text.

    """

    def __init__(self, identity: int, wires: tuple[MotorWire, ...], mode: str) -> None:
        """Know no reading of it yet."""
        self.identity, self.wires, self.mode = identity, wires, mode
        self.model, self.names = wires[0].model, tuple(wire.name for wire in wires)
        self.answers = True
        self.torque_requested = self.restarted = self.tripped = False
        self.firmware = self.errors = 0
        self.ticks: int | None = None
        self.current: int | None = None
        self.velocity = 0
        self.zero: float | None = None
        self.voltage: float | None = None
        self.voltage_limits = (0.0, math.inf)
        self.temperature: float | None = None
        self.hottest = math.inf
        # largest current [counts], and goal positions [ticks], while the driver itself moves it
        self.guided: tuple[int, tuple[int, int]] | None = None
        self.reduced_limit: int | None = None  # [counts] of current since a stop in pull mode
        self.gains: dict[int, list[int]] = {}
        self.settled: dict[str, str] = {}
        self._carried = 0  # [counts] largest current when `reduced_limit` began
        self._recent: deque[int] = deque(maxlen=READINGS_MIN)

    def __str__(self) -> str:
        """Name it in messages."""
        return f'{" and ".join(self.names)} (id {self.identity})'

    def take(self, data: bytes) -> None:
        """Decode the ten bytes of its state."""
        self.current = decode(REGISTERS['present_current'], data[0:2])
        self.velocity = decode(REGISTERS['present_velocity'], data[2:6])
        self.ticks = decode(REGISTERS['present_position'], data[6:10])
        self._recent.append(abs(self.current))

    @property
    def strongest(self) -> int:
        """
        Largest current it may ever be given [counts].

        In pull mode a motor holds what its current and its friction hold: at the current of the
        line of paying out it gives way at the limit. Where friction is too large for that it may
        wind to the limit.
        """
        amperes = []
        for wire in self.wires:
            lines = wire.calibration
            line = lines.wind if wire.resolution.coarse else lines.pay_out
            line = line if self.mode == 'pull' else lines.mean
            amperes.append(min(wire.current_limit, line.current(wire.tension_limit)))
        return max(1, math.floor(min(amperes) / self.model.current_unit + 1e-9))

    def strength(self, wire: MotorWire) -> tuple[float, float]:
        """
        Return the tensions [N] of one of its wires at its largest current.

        Returns
        -------
        winds, holds : float
            Up to which tension it winds the wire; above which the wire turns it. Between them, two
            friction bands, it stands.

        """
        amperes, lines = self.strongest * self.model.current_unit, wire.calibration
        return lines.wind.tension(amperes), lines.pay_out.tension(amperes)

    @property
    def current_bounds(self) -> tuple[int, int]:
        """Allowed goal currents [counts]; in tension mode only those that wind."""
        largest = self.strongest if self.reduced_limit is None else self.reduced_limit
        if self.guided is not None:
            largest = min(self.guided[0], largest)
        if self.mode == 'tension' and self.guided is None and self.wires[0].spool.direction < 0:
            return -largest, 0
        return 0, largest

    @property
    def position_bounds(self) -> tuple[int, int]:
        """Allowed goal positions [ticks]; the present one while the zero is unknown."""
        if self.guided is not None:
            return self.guided[1]
        present = self.ticks or 0
        if self.zero is None:
            return present, present
        low, high = -float(Counts.POSITION_MAX_TICKS), float(Counts.POSITION_MAX_TICKS)
        for wire in self.wires:
            ends = [self.zero + wire.spool.ticks(pull) for pull in wire.pull_limits]
            low, high = max(low, min(ends)), min(high, max(ends))
        return math.ceil(low), math.floor(high)

    def pull(self, wire: MotorWire) -> float:
        """Return the pull of one of its wires [m], nan while unknown."""
        if not self.answers or self.ticks is None or self.zero is None:
            return math.nan
        return wire.spool.pull(self.ticks - self.zero)

    def tension(self, wire: MotorWire) -> float:
        """Return the tension by current of its one wire [N], nan where not observable."""
        if not self.answers or self.current is None or len(self.wires) > 1:
            return math.nan
        amperes = wire.spool.direction * self.current * self.model.current_unit
        return wire.calibration.mean.tension(amperes)

    def goal(self, commands: list[float]) -> int:
        """
        Turn the commands of its wires into a goal: counts of current, or ticks.

        The bounds are not applied here but where goals become bytes.
        """
        wire, command = self.wires[0], commands[0]
        if self.mode == 'tension':
            amperes = wire.calibration.mean.current(command)
            return wire.spool.direction * max(0, round(amperes / self.model.current_unit))
        zero = self.ticks or 0 if self.zero is None else self.zero
        distance = sum(
            w.share * w.spool.ticks(c) for w, c in zip(self.wires, commands, strict=True)
        )
        return round(zero + distance)

    def limit_current(self, reduction: float, tension: float) -> None:
        """
        Reduce its current limit, from its present current to that of a tension.

        Parameters
        ----------
        reduction : float
            0: its limit again; 1: no more current than for `tension`.
        tension : float
            Of a wire [N].

        """
        if reduction <= 0.0:
            self.reduced_limit = None
            return
        amperes = min(wire.calibration.mean.current(tension) for wire in self.wires)
        end = min(max(0, round(amperes / self.model.current_unit)), self.strongest)
        if self.reduced_limit is None:
            largest = max(self._recent, default=self.strongest)
            carried = math.ceil(largest * (1.0 + CARRIED_MARGIN)) + CARRIED_MARGIN_COUNTS
            self._carried = min(max(carried, end), self.strongest)
        self.reduced_limit = round(end + max(0.0, 1.0 - reduction) * (self._carried - end))

    def faults(self, port: str, talker: str = '') -> Iterator[Fault]:
        """List its faults; `talker` names another program on the bus, '' for none."""

        def fault(code: str, words: str, hardware: bool = False) -> Fault:
            return Fault(code, f'{port}: {self}: {words}', hardware, self.names)

        yield from latched(f'{port}: {self}', HardwareError, self.errors, self.names)
        if self.restarted:
            words = 'it lost its power or its torque was switched off'
            yield fault('restarted', f'{words}; stays off until it is enabled again', True)
        if not self.answers:
            words = 'no answer; check its cable and the motor supply'
            yield fault('silent', f'no answer; {talker}' if talker else words)
        if self.tripped:
            yield fault('watchdog', 'its bus watchdog stopped it: no instruction came in time')
        if self.temperature is not None and self.temperature >= self.hottest:
            limit = f'released from {self.hottest:.0f} °C; let it cool'
            yield fault('temperature', f'{self.temperature:.0f} °C, {limit}')
        low, high = self.voltage_limits
        if self.voltage is not None and not low <= self.voltage <= high:
            words = f'supply {self.voltage:.1f} V, expected {low:.1f} to {high:.1f} V'
            yield fault('supply', words)

    def take_health(self, data: bytes) -> None:
        """Decode the three bytes of voltage and temperature."""
        self.voltage = int.from_bytes(data[:2], 'little') * REGISTERS['present_input_voltage'].unit
        self.temperature = float(data[2])


def make_motors(config: DynamixelConfig, mode: str) -> dict[int, Motor]:
    """Make the motors of a configuration: id to motor."""
    return {i: Motor(i, wires, mode) for i, wires in config.by_id.items()}
