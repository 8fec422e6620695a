"""What is said of the board: readings, faults, facts for diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np

from ...common.errors import DriverError, MovedError
from ...robot import Robot
from ..hardware import HardwareDriver
from ..interface import Array, Fault, Reading
from ..ports import travelled
from . import messages
from .config import BoardConfig, limits, read_config
from .link import (
    BoardLink,
    LinkLostError,
    ask,
    configure,
    give_limits,
    identify,
    let_go,
    telemetry,
)
from .messages import Telemetry


def channel_mask(channels: np.ndarray) -> int:
    """Return a bit per channel, shape (k,)."""
    return int(np.bitwise_or.reduce(1 << channels, initial=0))


def measured_tensions(driver: SerialDriver) -> Array:
    """Return measured tensions, shape (m,) [N]; nan where the load cell says nothing."""
    return _measured(driver, 'tensions', messages.CELL)


def measured_pulls(driver: SerialDriver) -> Array:
    """Return measured wire pulls, shape (m,) [m]; nan where the encoder says nothing."""
    zero: Array = np.nan_to_num(driver.zero)
    return _measured(driver, 'pulls', messages.ENCODER) - zero


def _measured(driver: SerialDriver, name: str, fault: int) -> Array:
    telemetry = driver.telemetry
    if telemetry is None:
        return np.full(len(driver.inputs), np.nan)
    values = getattr(telemetry, name)[driver.places]
    return np.where(telemetry.faults[driver.places] & fault, np.nan, values)


def driver_reading(driver: SerialDriver, now: float, tripped: bool) -> Reading:
    """Return the present reading."""
    values = measured_tensions(driver)
    spread = np.array(
        [
            np.nan if tendon.cell is None else tendon.cell.uncertainty(value)
            for tendon, value in zip(driver.config.tendons, values, strict=True)
        ]
    )
    return Reading(
        time=now,
        pulls=measured_pulls(driver),
        tensions=values,
        source='load_cell',
        tension_sd=np.nan_to_num(spread),
        faults=_faults(driver, tripped),
    )


def _faults(driver: SerialDriver, tripped: bool) -> tuple[Fault, ...]:
    port = driver.config.port
    if not driver.link.connected:
        return (Fault('port', f'{port}: the port is gone; plug the board in again'),)
    if driver.telemetry is None:
        message = f'{port}: no telemetry from the board; check its cable and supply'
        return (Fault('silent', message),)
    faults = list(latched_faults(driver))
    for tendon, off in zip(driver.config.tendons, driver.restarted, strict=True):
        if off:
            message = f'{port}: {tendon}: the board restarted or switched it off; reset'
            faults.append(Fault('restarted', message, True, (tendon.name,)))
    if tripped:
        message = f'{port}: the board heard no command for {driver.config.timeout:g} s, released'
        faults.append(Fault('watchdog', message))
    return tuple(faults)


def latched_faults(driver: SerialDriver) -> list[Fault]:
    """Return the faults that the board has latched."""
    telemetry = driver.telemetry
    if telemetry is None:
        return []
    bits = telemetry.faults[driver.places]
    return [
        Fault(
            code,
            f'{driver.config.port}: {tendon}: {words}; torque is off; remove the cause, then '
            'reboot it',
            True,
            (tendon.name,),
        )
        for tendon, value in zip(driver.config.tendons, bits, strict=True)
        for bit, (code, words) in messages.CHANNEL_FAULTS.items()
        if value & bit
    ]


def driver_facts(driver: SerialDriver) -> dict[str, str]:
    """Return facts about board and link: names and values as text, with units."""
    config, telemetry, identity = driver.config, driver.telemetry, driver.identity
    facts = {
        'port': f'{config.port}, {config.baud} baud',
        'board': 'not asked yet'
        if identity is None
        else f'{identity.channels} channels, firmware {identity.firmware}',
        'frames': f'{driver.link.missed} missed, {driver.link.bad} bad here, '
        f'{"?" if telemetry is None else telemetry.bad} bad at the board',
        'on silence': f'release after {config.timeout:g} s to {config.release_to}',
    }
    for tendon in config.tendons:
        current = '?' if telemetry is None else f'{telemetry.currents[tendon.channel]:.3f}'
        facts[str(tendon)] = f'{current} A'
        if tendon.cell is not None:
            doubt = float(tendon.cell.uncertainty(np.array(tendon.tension_limit)))
            facts[str(tendon)] += f', ±{doubt:.2g} N at {tendon.tension_limit:g} N'
    return facts


# -----------------------------------------------------------------------------
# Where pull is zero: every wire just taut, as its load cell says.

CYCLE_S = 0.01  # [s]
STEADY_FOR_S = 0.2  # [s]
TENSION_WITHIN_SHARE = 0.3  # of the wanted tension
TRAVEL_END_WITHIN_M = 5e-4  # [m] to the end of `home_travel`: the board goes no further


def find_slack(driver: SerialDriver) -> Array:
    """
    Wind all wires to the homing tension; return where they are, shape (m,) [m] on the board.

    Raises
    ------
    MovedError
        A wire does not come to that tension in time, or within `home_travel` of where the first
        attempt began.
    DriverError
        The board refuses: nothing has moved.

    """
    start = _places(driver)
    gone = travelled(driver.config.port)
    origin = start - np.array([gone.get(channel, 0.0) for channel in driver.places.tolist()])
    away = np.abs(start - origin) > driver.config.home_travel
    if away.any():
        raise MovedError(f'no pull zero found: {_too_far(driver, away)}')
    travel = driver.config.home_travel
    give_limits(driver.link, driver.config, origin, (-travel, travel))
    driver.switch_on('tension')
    try:
        pulls = _wind(driver, origin)
    except (DriverError, LinkLostError) as error:
        _remember(driver, origin)
        raise MovedError(f'no pull zero found: {error}') from None
    gone.clear()
    return pulls


def _places(driver: SerialDriver) -> Array:
    """Return where the wires are, shape (m,) [m] on the board."""
    if driver.telemetry is None:
        raise DriverError(f'{driver.config.port}: no telemetry; check cable and supply')
    return np.array(driver.telemetry.pulls[driver.places], dtype=float)


def _wind(driver: SerialDriver, origin: Array) -> Array:
    """Ask for the homing tension until every wire has it."""
    config = driver.config
    goal = np.full(len(driver.inputs), config.home_tension)
    deadline = time.monotonic() + config.home_time
    steady = time.monotonic()
    while time.monotonic() - steady < STEADY_FOR_S:
        if driver.cancelled():
            raise DriverError(f'{config.port}: looking for slack was cancelled; torque is off')
        driver.command('tension', goal)
        driver._read_again()
        away = ~(np.abs(measured_tensions(driver) - goal) < TENSION_WITHIN_SHARE * goal)
        if away.any():
            steady = time.monotonic()
        if faults := latched_faults(driver):
            raise DriverError('; '.join(fault.message for fault in faults))
        ended = away & (
            np.abs(_places(driver) - origin) > config.home_travel - TRAVEL_END_WITHIN_M
        )
        if ended.any():
            raise DriverError(_too_far(driver, ended))
        if time.monotonic() > deadline:
            raise DriverError(
                f'{config.port}: {_names(driver, away)}: not at {config.home_tension:g} N within '
                f'{config.home_time:g} s; is the wire attached, and the direction right?'
            )
        time.sleep(CYCLE_S)
    return _places(driver)


def _remember(driver: SerialDriver, origin: Array) -> None:
    """Torque off; note how far a search went that found nothing."""
    driver.disable()
    try:
        driver._read_again()
        way = _places(driver) - origin
    except (DriverError, LinkLostError):  # on its own the board may wind to the end
        way = np.full(len(driver.inputs), driver.config.home_travel)
    gone = zip(driver.places.tolist(), way.tolist(), strict=True)
    travelled(driver.config.port).update(gone)


def _too_far(driver: SerialDriver, which: Array) -> str:
    return (
        f'{driver.config.port}: {_names(driver, which)}: no resistance within home_travel = '
        f'{driver.config.home_travel:g} m; is the wire on its spool, is direction right?'
    )


def _names(driver: SerialDriver, which: Array) -> str:
    return ', '.join(n for n, bad in zip(driver.inputs, which, strict=True) if bad)


# -----------------------------------------------------------------------------
# A board with load cells behind the driver interface: it closes the tension loop itself.

HEARTBEAT_PERIOD_S = 0.1  # [s]
TELEMETRY_SILENT_S = 0.1  # [s] without telemetry
PORT_FLUSH_AFTER_S = 0.05  # [s]; after a longer pause what waits in the port is thrown away


class SerialDriver(HardwareDriver):
    """
    Drives the wires of a robot with a board that speaks docs/serial_protocol.md.

    Attributes
    ----------
    link : BoardLink
    telemetry : Telemetry or None
        The newest; None while nothing comes.
    cancelled : callable
        Asked while `enable` looks for slack; a true answer ends it.

    """

    def __init__(self, robot: Robot, config: BoardConfig, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        super().__init__(robot, mode, config.port, *limits(config, robot, mode))
        self.config = config
        self.port = config.port
        self.link = BoardLink(config.port, config.baud)
        self.telemetry: Telemetry | None = None
        self.places = np.array([tendon.channel for tendon in config.tendons])
        self.identity: messages.Identity | None = None
        self.zero = np.full(len(self.inputs), np.nan)  # [m] on the board where pull is 0
        self.wanted = np.zeros(len(self.inputs), dtype=bool)  # torque should be on
        self.restarted = np.zeros(len(self.inputs), dtype=bool)
        self.cancelled: Callable[[], bool] = lambda: False
        self._tripped = False
        self._heard = self._read_at = -np.inf

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str
    ) -> Self:
        """Make the driver from what its configuration file says."""
        return cls(robot, read_config(robot, config, mode, source), mode)

    def open(self) -> None:
        """Open the port for this process alone, ask who is there, tell it its configuration."""
        self.link.open()
        try:
            self.identity = identify(self.link, self.config)
            let_go(self.link, self.identity.channels)
            ask(self.link, messages.CLEAR, b'\xff')
            self._configure()
            if self._hear(1.0) is None:
                raise DriverError(f'{self.config.port}: no telemetry; check the baud rate')
        except (DriverError, LinkLostError) as error:
            self.link.close()
            raise DriverError(str(error)) from None
        self._zero_here()
        self.restarted[:] = False
        self._is_open = True

    def close(self) -> None:
        """Give the port back; the board releases when it hears nothing."""
        self._is_open = False
        self.link.close()

    def enable(self) -> None:
        """Torque on where the arm is; with `zero: find`, wind up the slack first."""
        self._require_open('enable')
        failed: type[DriverError] = DriverError
        try:
            self._read_again()
            latched = [fault.message for fault in latched_faults(self)]
            if latched:
                raise DriverError('; '.join(latched))
            if self.config.zero == 'find' and not np.isfinite(self.zero).all():
                self.zero = find_slack(self)
                failed = MovedError
                give_limits(self.link, self.config, self.zero)
            self.switch_on(self.mode)
        except MovedError:
            self.disable()
            raise
        except (DriverError, LinkLostError) as error:
            self.disable()
            raise failed(str(error)) from None
        self.wanted[:], self.restarted[:] = True, False
        self._start_from_measured()

    def switch_on(self, mode: str) -> None:
        """Torque on in a mode, where the wires are."""
        mask = channel_mask(self.places)
        ask(self.link, messages.ENABLE, bytes((messages.MODES[mode], mask)))
        self._read_again()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once."""
        chosen = self._chosen(inputs)
        self.wanted[chosen] = self.restarted[chosen] = False
        try:
            if self.link.connected:
                content = bytes((channel_mask(self.places[chosen]),))
                ask(self.link, messages.DISABLE, content, attempts=2)
        except (DriverError, LinkLostError):
            pass  # read() says so, and switches off what came back unwanted

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Clear latched faults of motors, after their cause was removed; leaves them off."""
        self._require_open('reboot')
        chosen = self._chosen(inputs)
        self.disable(inputs)
        try:
            content = bytes((channel_mask(self.places[chosen]),))
            ask(self.link, messages.CLEAR, content)
            self._read_again()
        except LinkLostError as error:
            raise DriverError(f'{error}: lost while clearing faults') from None
        again = [f.message for f in latched_faults(self) if not inputs or f.inputs[0] in inputs]
        if again:
            raise DriverError('; '.join(again))

    def describe(self) -> dict[str, str]:
        """Return facts about board and link."""
        return driver_facts(self)

    def write(self, command: Array) -> None:
        """Command tensions [N] or pulls [m], shape (m,), kept within limits and rates."""
        self._require_open('write')
        wanted, passed = self.checked(command), self._since_write()
        if passed > self.config.timeout:
            return  # the board may have released meanwhile: read() looks first where the arm is
        self._goal = self._towards(wanted, self.limits, passed)
        try:
            if self.link.connected and self.wanted.any():
                self.command(self.mode, self._goal)
        except LinkLostError:
            pass  # read() says so and tries to get it back

    def command(self, mode: str, goal: Array) -> None:
        """Send one command, shape (m,) [N] or [m], to all channels in one frame."""
        assert self.identity is not None
        values = np.zeros(self.identity.channels)
        values[self.places] = goal if mode == 'tension' else goal + self.zero
        self.link.send(messages.COMMAND, messages.command(mode, values))

    def read(self) -> Reading:
        """Take the newest telemetry; look after silence, restarts and lost ports."""
        self._require_open('read')
        now = time.monotonic()
        try:
            if self.link.connected or self._reopened(now):
                self._converse(now)
        except (LinkLostError, DriverError):  # DriverError: it came back and went away again
            self.telemetry = None
        return driver_reading(self, time.monotonic(), self._tripped)

    def _converse(self, now: float) -> None:
        if now - self.link.sent_at > HEARTBEAT_PERIOD_S:
            self.link.send(messages.HEARTBEAT)
        if now - self._read_at > PORT_FLUSH_AFTER_S:
            self.link.flush()
        lost = self.telemetry is None
        heard = self._hear(min(3.0 * self.config.period, 0.03))
        self._read_at = time.monotonic()
        if heard is None:
            if self._read_at - self._heard > max(TELEMETRY_SILENT_S, 5.0 * self.config.period):
                self.telemetry = None
            return
        if not heard.flags & messages.CONFIGURED:
            self._come_back()
            heard = self.telemetry or heard
        enabled = np.array([heard.enabled >> i & 1 for i in self.places], dtype=bool)
        healthy = heard.faults[self.places] == 0
        self.restarted |= self.wanted & ~enabled & healthy
        self._tripped = bool(heard.flags & messages.SILENCE) and bool(self.wanted.any())
        if lost or self._tripped:
            self._start_from_measured()
        if np.any(enabled & ~self.wanted):  # it was switched off while the port was lost
            content = bytes((channel_mask(self.places[enabled & ~self.wanted]),))
            self.link.send(messages.DISABLE, content)

    def _come_back(self) -> None:
        """Tell a board that had no power what it must know; its motors stay off."""
        self.restarted |= self.wanted
        if self.config.zero == 'find':
            self.zero[:] = np.nan
        self._configure()
        self._hear(0.1)

    def _configure(self) -> None:
        configure(self.link, self.config, np.nan_to_num(self.zero))

    def _hear(self, wait: float) -> Telemetry | None:
        """Take the newest telemetry, None when none came."""
        assert self.identity is not None
        heard = telemetry(self.link, self.identity.channels, wait)
        if heard is not None:
            self.telemetry, self._heard = heard, time.monotonic()
        return heard

    def _read_again(self) -> None:
        """Take telemetry that is newer than what was just asked for."""
        self.link.flush()
        if self._hear(0.5) is None:
            raise DriverError(f'{self.config.port}: no telemetry; check cable and supply')
        self._read_at = time.monotonic()

    def _reopened(self, now: float) -> bool:
        if not self._may_retry(now):
            return False
        self.telemetry = None
        if not self.link.reopen():
            return False
        self.link.send(messages.HEARTBEAT)
        self._heard = now
        return True

    def _start_from_measured(self) -> None:
        """Let the next command begin at what is measured."""
        value = measured_tensions(self) if self.mode == 'tension' else measured_pulls(self)
        self._goal = np.where(np.isfinite(value), value, self._goal)
        self._written = time.monotonic()

    def _zero_here(self) -> None:
        if self.config.zero == 'here' and self.telemetry is not None:
            measured = self.telemetry.pulls[self.places]
            self.zero = np.where(np.isfinite(self.zero), self.zero, measured)
            give_limits(self.link, self.config, self.zero)
