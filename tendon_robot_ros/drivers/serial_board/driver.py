"""A board with load cells behind the driver interface: it closes the tension loop itself."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from ...common.errors import DriverError, MovedError
from ...robot import Robot
from ..hardware import PortDriver
from ..interface import Array, Reading
from ..ports import PortLostError, travelled
from . import messages
from .config import BoardConfig, limits, read_config
from .link import BoardLink, ask, configure, give_limits, identify, let_go, telemetry
from .messages import BoardFlag, Message, Telemetry
from .readings import (
    board_facts,
    board_faults,
    board_reading,
    latched_faults,
    measured_pulls,
    measured_tensions,
)

HEARTBEAT_PERIOD_S = 0.1  # [s]
TELEMETRY_SILENT_S = 0.1  # [s] without telemetry
PORT_FLUSH_AFTER_S = 0.05  # [s]; after a longer pause what waits in the port is thrown away


class SerialDriver(PortDriver):
    """
    Drives the wires of a robot with a board that speaks docs/serial_protocol.md.

    Attributes
    ----------
    link : BoardLink
    telemetry : Telemetry or None
        The newest; None while nothing comes.
    """

    config: BoardConfig
    link: BoardLink
    read_config = staticmethod(read_config)

    def __init__(self, robot: Robot, config: BoardConfig, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        link = BoardLink(config.port, config.baud)
        super().__init__(robot, mode, config, link, *limits(config, robot, mode))
        self.telemetry: Telemetry | None = None
        self.identity: messages.Identity | None = None
        self.zero = np.full(len(self.inputs), np.nan)  # [m] on the board where pull is 0
        self.wanted = np.zeros(len(self.inputs), dtype=bool)  # torque should be on
        self.restarted = np.zeros(len(self.inputs), dtype=bool)
        self._tripped = False
        self._heard = self._read_at = -np.inf

    def _shake_hands(self) -> None:
        """Ask who is there, and tell it its configuration."""
        self.identity = identify(self.link, self.config)
        let_go(self.link, self.identity.channels)
        ask(self.link, Message.CLEAR, b'\xff')
        self._configure()
        if self._hear(1.0) is None:
            raise DriverError(f'{self.config.port}: no telemetry; check the baud rate')
        self._zero_here()
        self.restarted[:] = False

    def _check_motors(self) -> None:
        self.read_again()
        if latched := latched_faults(self.config, self.telemetry):
            raise DriverError('; '.join(fault.message for fault in latched))

    def _slack_unknown(self) -> bool:
        return not bool(np.isfinite(self.zero).all())

    def _find_slack(self) -> None:
        self.zero = find_slack(self)
        try:
            give_limits(self.link, self.config, self.zero)
        except (DriverError, PortLostError) as error:
            raise MovedError(str(error)) from None

    def _torque_on(self) -> None:
        self.switch_on(self.mode)
        self.wanted[:], self.restarted[:] = True, False

    def switch_on(self, mode: str) -> None:
        """Torque on in a mode, where the wires are."""
        mask = channel_mask(self.config.places)
        ask(self.link, Message.ENABLE, bytes((messages.MODES.index(mode), mask)))
        self.read_again()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once."""
        chosen = self._chosen(inputs)
        self.wanted[chosen] = self.restarted[chosen] = False
        try:
            if self.link.connected:
                content = bytes((channel_mask(self.config.places[chosen]),))
                ask(self.link, Message.DISABLE, content, attempts=2)
        except (DriverError, PortLostError):
            pass  # read() says so, and switches off what came back unwanted

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Clear latched faults of motors, after their cause was removed; leaves them off."""
        self._require_open('reboot')
        chosen = self._chosen(inputs)
        self.disable(inputs)
        try:
            content = bytes((channel_mask(self.config.places[chosen]),))
            ask(self.link, Message.CLEAR, content)
            self.read_again()
        except PortLostError as error:
            raise DriverError(f'{error}: lost while clearing faults') from None
        latched = latched_faults(self.config, self.telemetry)
        again = [f.message for f in latched if not inputs or f.inputs[0] in inputs]
        if again:
            raise DriverError('; '.join(again))

    def describe(self) -> dict[str, str]:
        """Return facts about board and link."""
        return board_facts(self.config, self.link, self.identity, self.telemetry)

    def silence(self) -> str:
        """Return what the board was told."""
        return f'{self.config.timeout:g} s (command_timeout of the board)'

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
        except PortLostError:
            pass  # read() says so and tries to get it back

    def command(self, mode: str, goal: Array) -> None:
        """Send one command, shape (m,) [N] or [m], to all channels in one frame."""
        assert self.identity is not None
        values = np.zeros(self.identity.channels)
        values[self.config.places] = goal if mode == 'tension' else goal + self.zero
        self.link.send(Message.COMMAND, messages.command(mode, values))

    def read(self) -> Reading:
        """Take the newest telemetry; look after silence, restarts and lost ports."""
        self._require_open('read')
        now = time.monotonic()
        try:
            if self.link.connected or self._reopened(now):
                self._converse(now)
        except (PortLostError, DriverError):  # DriverError: it came back and went away again
            self.telemetry = None
        config, telemetry = self.config, self.telemetry
        connected, restarted = self.link.connected, self.restarted
        faults = board_faults(config, connected, telemetry, restarted, self._tripped)
        return board_reading(config, telemetry, self.zero, faults, time.monotonic())

    def measured_tensions(self) -> Array:
        """Return measured tensions, shape (m,) [N]."""
        return measured_tensions(self.config, self.telemetry)

    def _converse(self, now: float) -> None:
        if now - self.link.sent_at > HEARTBEAT_PERIOD_S:
            self.link.send(Message.HEARTBEAT)
        if now - self._read_at > PORT_FLUSH_AFTER_S:
            self.link.flush()
        lost = self.telemetry is None
        heard = self._hear(min(3.0 * self.config.period, 0.03))
        self._read_at = time.monotonic()
        if heard is None:
            if self.link.clock() - self._heard > max(TELEMETRY_SILENT_S, 5.0 * self.config.period):
                self.telemetry = None
            return
        if not heard.flags & BoardFlag.CONFIGURED:
            self._come_back()
            heard = self.telemetry or heard
        enabled = np.array([heard.enabled >> i & 1 for i in self.config.places], dtype=bool)
        healthy = heard.faults[self.config.places] == 0
        self.restarted |= self.wanted & ~enabled & healthy
        self._tripped = bool(heard.flags & BoardFlag.SILENCE) and bool(self.wanted.any())
        if lost or self._tripped:
            self._start_from_measured()
        if np.any(enabled & ~self.wanted):  # it was switched off while the port was lost
            content = bytes((channel_mask(self.config.places[enabled & ~self.wanted]),))
            self.link.send(Message.DISABLE, content)

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
            self.telemetry, self._heard = heard, self.link.clock()
        return heard

    def read_again(self) -> None:
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
        self.link.send(Message.HEARTBEAT)
        self._heard = self.link.clock()
        return True

    def _start_from_measured(self) -> None:
        """Let the next command begin at what is measured."""
        if self.mode == 'tension':
            value = self.measured_tensions()
        else:
            value = measured_pulls(self.config, self.telemetry, self.zero)
        self._goal = np.where(np.isfinite(value), value, self._goal)
        self._written = time.monotonic()

    def _zero_here(self) -> None:
        if self.config.zero == 'here' and self.telemetry is not None:
            measured = self.telemetry.pulls[self.config.places]
            self.zero = np.where(np.isfinite(self.zero), self.zero, measured)
            give_limits(self.link, self.config, self.zero)


def channel_mask(channels: np.ndarray) -> int:
    """Return a bit per channel, shape (k,)."""
    return int(np.bitwise_or.reduce(1 << channels, initial=0))


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
    origin = start - np.array(
        [gone.get(channel, 0.0) for channel in driver.config.places.tolist()]
    )
    away = np.abs(start - origin) > driver.config.home_travel
    if away.any():
        raise MovedError(f'no pull zero found: {_too_far(driver, away)}')
    travel = driver.config.home_travel
    give_limits(driver.link, driver.config, origin, (-travel, travel))
    driver.switch_on('tension')
    try:
        pulls = _wind(driver, origin)
    except (DriverError, PortLostError) as error:
        _remember(driver, origin)
        raise MovedError(f'no pull zero found: {error}') from None
    gone.clear()
    return pulls


def _places(driver: SerialDriver) -> Array:
    """Return where the wires are, shape (m,) [m] on the board."""
    if driver.telemetry is None:
        raise DriverError(f'{driver.config.port}: no telemetry; check cable and supply')
    return np.array(driver.telemetry.pulls[driver.config.places], dtype=float)


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
        driver.read_again()
        away = ~(np.abs(driver.measured_tensions() - goal) < TENSION_WITHIN_SHARE * goal)
        if away.any():
            steady = time.monotonic()
        if faults := latched_faults(driver.config, driver.telemetry):
            raise DriverError('; '.join(fault.message for fault in faults))
        reach = config.home_travel - TRAVEL_END_WITHIN_M
        ended = away & (np.abs(_places(driver) - origin) > reach)
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
        driver.read_again()
        way = _places(driver) - origin
    except (DriverError, PortLostError):  # on its own the board may wind to the end
        way = np.full(len(driver.inputs), driver.config.home_travel)
    gone = zip(driver.config.places.tolist(), way.tolist(), strict=True)
    travelled(driver.config.port).update(gone)


def _too_far(driver: SerialDriver, which: Array) -> str:
    return (
        f'{driver.config.port}: {_names(driver, which)}: no resistance within home_travel = '
        f'{driver.config.home_travel:g} m; is the wire on its spool, is direction right?'
    )


def _names(driver: SerialDriver, which: Array) -> str:
    return ', '.join(n for n, bad in zip(driver.inputs, which, strict=True) if bad)
