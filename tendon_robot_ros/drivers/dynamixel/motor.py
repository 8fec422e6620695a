"""One servo as the driver knows it: what it said last, what it is allowed, what is wrong."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from ..interface import Fault
from .config import DynamixelConfig, WireConfig
from .control_table import (
    POSITION_MAX_TICKS,
    REGISTERS,
    ServoModel,
    decode,
    hardware_errors,
)

STATE = (REGISTERS['present_current'].address, 10)  # current, velocity, position: 126 to 135
HEALTH = (REGISTERS['present_input_voltage'].address, 3)  # voltage and temperature: 144 to 146
LATELY = 5  # readings of which the largest current is what a motor carries
CARRIED_MARGIN = 0.1  # of that, and counts: a reading is rounded, rippled and a cycle old
CARRIED_MARGIN_COUNTS = 3


@dataclass
class Motor:
    """
    A servo and what is known of it.

    Parameters
    ----------
    identity : int
    wires : tuple of WireConfig
        The inputs it winds.
    mode : str
        `tension` or `pull`.

    Attributes
    ----------
    wanted : bool
        Torque shall be on.
    answers : bool
        It answered when it was last asked.
    errors : int
        Hardware error status, address 70.
    restarted, tripped : bool
        It lost its power, or its torque was taken; its bus watchdog tripped.
    ticks, current : int, optional
        Last good reading, position in ticks and current in counts.
    zero : float, optional
        Ticks at which the pulls are zero, None while unknown.
    gains : dict of int to list of int
        Operating mode -> gains (76 to 91) that the motor itself has for it.
    settled : dict of str to str
        Register -> what the driver has changed, in words.

    """

    identity: int
    wires: tuple[WireConfig, ...]
    mode: str
    firmware: int = 0
    wanted: bool = False
    answers: bool = True
    errors: int = 0
    restarted: bool = False
    tripped: bool = False
    ticks: int | None = None
    current: int | None = None
    velocity: int = 0
    zero: float | None = None
    voltage: float | None = None
    voltage_limits: tuple[float, float] = (0.0, math.inf)
    temperature: float | None = None
    hottest: float = math.inf
    guided: tuple[int, tuple[int, int]] | None = None  # while the driver itself moves it
    weakened: int | None = None  # [counts] what it may hold since a stop in pull mode
    gains: dict[int, list[int]] = field(default_factory=dict)
    settled: dict[str, str] = field(default_factory=dict)
    _carried: int = 0  # [counts] what it may have held when that began
    _lately: deque[int] = field(default_factory=lambda: deque(maxlen=LATELY))

    @property
    def model(self) -> ServoModel:
        """Its model."""
        return self.wires[0].model

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its inputs."""
        return tuple(wire.name for wire in self.wires)

    def __str__(self) -> str:
        """Name it in messages."""
        return f'{" and ".join(self.names)} (id {self.identity})'

    def take(self, data: bytes) -> None:
        """Take the ten bytes of its state."""
        current, velocity = REGISTERS['present_current'], REGISTERS['present_velocity']
        self.current = decode(current, data[0:2])
        self.velocity = decode(velocity, data[2:6])
        self.ticks = decode(REGISTERS['present_position'], data[6:10])
        self._lately.append(abs(self.current))

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
            line = wire.calibration.mean
            if self.mode == 'pull':
                coarse = wire.resolution.coarse
                line = wire.calibration.wind if coarse else wire.calibration.pay_out
            amperes.append(min(wire.current_limit, line.current(wire.tension_limit)))
        return max(1, math.floor(min(amperes) / self.model.current_unit + 1e-9))

    def strength(self, wire: WireConfig) -> tuple[float, float]:
        """
        Return what its largest current does to one of its wires [N].

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
        """Goal currents it may be given [counts]: in tension mode only those that wind."""
        most = self.strongest if self.weakened is None else self.weakened
        if self.guided is not None:
            most = min(self.guided[0], most)
        if self.mode == 'tension' and self.guided is None and self.wires[0].spool.direction < 0:
            return -most, 0
        return 0, most

    @property
    def position_bounds(self) -> tuple[int, int]:
        """Goal positions it may be given [ticks]; where it is, while the zero is unknown."""
        if self.guided is not None:
            return self.guided[1]
        here = self.ticks or 0
        if self.zero is None:
            return here, here
        low, high = -float(POSITION_MAX_TICKS), float(POSITION_MAX_TICKS)
        for wire in self.wires:
            ends = [
                self.zero + wire.spool.ticks(pull)
                if math.isfinite(pull)
                else math.copysign(POSITION_MAX_TICKS, pull)
                for pull in wire.pull_limits
            ]
            low, high = max(low, min(ends)), min(high, max(ends))
        return math.ceil(low), math.floor(high)

    def pull(self, wire: WireConfig) -> float:
        """Return the pull of one of its wires [m], nan while unknown."""
        if not self.answers or self.ticks is None or self.zero is None:
            return math.nan
        return wire.spool.pull(self.ticks - self.zero)

    def tension(self, wire: WireConfig) -> float:
        """Return the tension by current of its one wire [N], nan where not observable."""
        if not self.answers or self.current is None or len(self.wires) > 1:
            return math.nan
        amperes = wire.spool.direction * self.current * self.model.current_unit
        return wire.calibration.tension(amperes)

    def goal(self, commands: list[float]) -> int:
        """
        Turn the commands of its wires into a goal: counts of current, or ticks.

        The bounds are not applied here but where goals become bytes.
        """
        wire, command = self.wires[0], commands[0]
        if self.mode == 'tension':
            amperes = wire.calibration.current(command)
            return wire.spool.direction * max(0, round(amperes / self.model.current_unit))
        zero = self.ticks or 0 if self.zero is None else self.zero
        way = sum(w.share * w.spool.ticks(c) for w, c in zip(self.wires, commands, strict=True))
        return round(zero + way)

    def weaken(self, share: float, least: float) -> None:
        """
        Let it hold less, by a share of the way from what it carries to a tension.

        Parameters
        ----------
        share : float
            0: its limit again; 1: no more current than for `least`.
        least : float
            Tension of a wire [N].

        """
        if share <= 0.0:
            self.weakened = None
            return
        amperes = min(wire.calibration.current(least) for wire in self.wires)
        end = min(max(0, round(amperes / self.model.current_unit)), self.strongest)
        if self.weakened is None:
            lately = max(self._lately, default=self.strongest)
            carried = math.ceil(lately * (1.0 + CARRIED_MARGIN)) + CARRIED_MARGIN_COUNTS
            self._carried = min(max(carried, end), self.strongest)
        self.weakened = round(end + max(0.0, 1.0 - share) * (self._carried - end))

    def faults(self, port: str, talker: str = '') -> Iterator[Fault]:
        """List what is wrong with it; `talker` says who else talks on the bus."""
        who = f'{port}: {self}'
        advice = 'torque is off; remove the cause, then reboot it'
        for code, words in hardware_errors(self.errors):
            yield Fault(code, f'{who}: {words}; {advice}', True, self.names)
        if self.restarted:
            words = 'it lost its power or its torque was switched off'
            advice = 'stays off until it is enabled again'
            yield Fault('restarted', f'{who}: {words}; {advice}', True, self.names)
        for code, words in self._mild(talker):
            yield Fault(code, f'{who}: {words}', False, self.names)

    def _mild(self, talker: str) -> Iterator[tuple[str, str]]:
        """List codes and words of what does not take its torque."""
        if not self.answers:
            blamed = 'no answer; check its cable and the motor supply'
            yield 'silent', f'no answer; {talker}' if talker else blamed
        if self.tripped:
            yield 'watchdog', 'its bus watchdog stopped it: no instruction came in time'
        if self.temperature is not None and self.temperature >= self.hottest:
            yield (
                'temperature',
                f'{self.temperature:.0f} °C, released from {self.hottest:.0f} °C; let it cool',
            )
        low, high = self.voltage_limits
        if self.voltage is not None and not low <= self.voltage <= high:
            yield 'supply', f'supply {self.voltage:.1f} V, expected {low:.1f} to {high:.1f} V'

    def take_health(self, data: bytes) -> None:
        """Take the three bytes of voltage and temperature."""
        self.voltage = int.from_bytes(data[:2], 'little') * REGISTERS['present_input_voltage'].unit
        self.temperature = float(data[2])


def make_motors(config: DynamixelConfig, mode: str) -> dict[int, Motor]:
    """Make the motors of a configuration: id to motor."""
    return {i: Motor(i, config.on(i), mode) for i in config.ids}
