"""
A board with load cells behind the driver interface: it closes the tension loop itself.

Readings, faults and facts come from its telemetry; where pull is zero, every wire is just taut, as
its load cell says.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from itertools import compress

import numpy as np

from ...common.arrays import Bools, Floats
from ...common.errors import DriverError, MovedError
from ...robot import Robot
from ..hardware import STANDING_S
from ..interface import CYCLE_S, MODES, Fault, latched, travelled
from ..safety import CYCLE_MAX_S
from ..serial_port import ANSWER_TIMEOUT_S, PortDriver, PortLostError, lost_while
from . import messages
from .config import BoardConfig, read_config
from .link import BoardLink
from .messages import BoardFlag, ChannelFault, Message, Telemetry

TENSION_TOLERANCE = 0.3  # [1] of the homing tension, because friction and noise are large there
TRAVEL_TOLERANCE_M = 5e-4  # [m] to the end of `home_travel`, because the board goes no further


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
    device, source = 'board', 'load_cell'

    def __init__(self, robot: Robot, config: BoardConfig, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        super().__init__(robot, mode, config, config.tendons)
        self.link = BoardLink(config.port, config.baudrate)
        self.released_after = config.command_timeout
        # (m,) each: channel of every input; metres that the board counts per metre of its wire
        self._places = np.array([tendon.channel for tendon in config.tendons])
        self._counted = np.array([tendon.counted for tendon in config.tendons])
        self.telemetry: Telemetry | None = None
        self.zero = np.full(len(self.inputs), np.nan)  # [m] on the board where pull is 0
        # (m,) each: the driver has switched the torque on; the board has switched it off
        self.torque_requested, self.restarted = np.zeros((2, len(self.inputs)), dtype=bool)
        self._tripped = False  # the board received nothing and released
        self._received_at = self._read_at = -np.inf

    def _shake_hands(self) -> None:
        """Identify the board and send its configuration."""
        self.link.identify(self.config)
        self.link.let_go()
        self.link.ask(Message.CLEAR, b'\xff')
        self.zero[:] = np.nan  # anybody may have turned the spools since it was closed
        self.link.configure(self.config)
        if self._receive(1.0) is None:
            raise DriverError(f'{self.config.port}: no telemetry; check the baud rate')
        self._zero_in_place()
        self.restarted[:] = False

    def _check_motors(self) -> None:
        self.read_fresh()
        self._refuse_latched()

    def _slack_unknown(self) -> bool:
        return not bool(np.isfinite(self.zero).all())

    def _torque_on(self) -> None:
        self._zero_in_place()
        self.link.give_limits(self.config, np.nan_to_num(self.zero))
        self.switch_on(self.mode)
        self.torque_requested[:], self.restarted[:] = True, False

    def switch_on(self, mode: str) -> None:
        """Torque on in a mode, where the wires are."""
        every = np.ones(len(self.inputs), dtype=bool)
        self.link.ask(Message.ENABLE, bytes((MODES.index(mode),)) + self._mask(every))
        self.read_fresh()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once."""
        chosen = self._chosen(inputs)
        self.torque_requested[chosen] = self.restarted[chosen] = False
        # read() reports a failure, and switches motors off that are on without a request
        with suppress(DriverError, PortLostError):
            self.link.ask(Message.DISABLE, self._mask(chosen), attempts=2)

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Clear latched faults of motors, after their cause was removed; leaves them off."""
        self._require_open('reboot')
        chosen = self._chosen(inputs)
        self.disable(inputs)
        with lost_while('clearing faults'):
            self.link.ask(Message.CLEAR, self._mask(chosen))
            self.read_fresh()
        self._refuse_latched(inputs)

    def describe(self) -> dict[str, str]:
        """Return facts about board and link."""
        config, telemetry = self.config, self.telemetry
        facts = {
            'port': config.port,
            'baud_rate (1/s)': str(config.baudrate),
            'frames_missed': str(self.link.missed),
            'frames_bad': str(self.link.receiver.bad),
            'silence_until_release (s)': f'{config.command_timeout:g}',
            'release_to': config.release_to,
        }
        if (identity := self.link.identity) is not None:
            facts['channels'] = str(identity.channels)
            facts['firmware'] = str(identity.firmware)
        if telemetry is not None:
            facts['frames_bad_at_board'] = str(telemetry.bad)
        for tendon in config.tendons:
            if telemetry is not None:
                facts[f'{tendon}: current (A)'] = f'{telemetry.currents[tendon.channel]:.3f}'
            doubt = tendon.cell.uncertainty(tendon.tension_limit)
            facts[f'{tendon}: tension_uncertainty (N)'] = f'{doubt:.2g}'  # at its limit
        return facts

    def silence(self) -> str:
        """Return the time-out that the board was configured with."""
        return f'{self.config.command_timeout:g} s (command_timeout of the board)'

    def _send(self) -> None:
        if self.torque_requested.any():
            self.command(self.mode, self._goal)

    def command(self, mode: str, goal: Floats) -> None:
        """Send one command, shape (m,) [N] or [m], to all channels in one frame."""
        values = np.zeros(self.link.channels)
        if mode == 'pull':
            goal = self._counted * (goal + np.nan_to_num(self.zero))
        values[self._places] = goal
        self.link.send(Message.COMMAND, messages.command(mode, values))

    def _forget_readings(self) -> None:
        self.telemetry = None

    def _tensions(self) -> tuple[Floats, Floats]:
        tensions = self._channels('tensions', ChannelFault.LOAD_CELL)
        both = zip(self.config.tendons, tensions.tolist(), strict=True)
        return tensions, np.array([wire.cell.uncertainty(tension) for wire, tension in both])

    def _pulls(self) -> Floats:
        """Return wire pulls from the zero, shape (m,) [m]; nan where the encoder has a fault."""
        return np.asarray(self._board_pulls(ChannelFault.ENCODER) - np.nan_to_num(self.zero))

    def _channels(self, name: str, fault: int) -> Floats:
        """Return a value of the telemetry, shape (m,); nan where a channel has the fault."""
        if self.telemetry is None:
            return np.full(len(self.inputs), np.nan)
        values: Floats = np.array(getattr(self.telemetry, name)[self._places], dtype=float)
        values[self.telemetry.faults[self._places] & fault != 0] = np.nan
        return values

    def _mask(self, which: Bools) -> bytes:
        """Return a byte with a bit for the channel of each input that is chosen, shape (m,)."""
        return bytes((int(np.bitwise_or.reduce(1 << self._places[which], initial=0)),))

    def _faults(self) -> tuple[Fault, ...]:
        """Return the present faults."""
        port = self.config.port
        if self.telemetry is None:
            message = f'{port}: no telemetry from the board; check its cable and supply'
            return (Fault('silent', message),)
        faults = self._latched_faults()
        for tendon in compress(self.config.tendons, self.restarted):
            message = f'{port}: {tendon}: the board restarted or switched it off; reset'
            faults.append(Fault('restarted', message, True, (tendon.name,)))
        if self._tripped:
            silence = f'the board heard no command for {self.config.command_timeout:g} s, released'
            faults.append(Fault('watchdog', f'{port}: {silence}'))
        return tuple(faults)

    def _latched_faults(self) -> list[Fault]:
        """Return the faults that the board has latched."""
        assert self.telemetry is not None
        faults: list[Fault] = []
        for tendon in self.config.tendons:
            where, bits = f'{self.config.port}: {tendon}', self.telemetry.faults[tendon.channel]
            faults += latched(where, ChannelFault, int(bits), (tendon.name,))
        return faults

    def _refuse_latched(self, inputs: Sequence[str] = ()) -> None:
        """Raise DriverError with the faults that the board has latched, for some inputs or all."""
        faults = self._latched_faults()
        if remaining := [f.message for f in faults if not inputs or f.inputs[0] in inputs]:
            raise DriverError('; '.join(remaining))

    def _converse(self, now: float) -> None:
        """Take the newest telemetry; act on what the board did by itself."""
        if now - self.link.sent_at > ANSWER_TIMEOUT_S:
            self.link.send(Message.HEARTBEAT)
        if now - self._read_at > CYCLE_MAX_S:
            self.link.flush()
        lost = self.telemetry is None
        newest = self._receive(min(3.0 * self.config.period, 0.03))
        if newest is None:
            silence = self.link.clock() - self._received_at
            if silence > max(ANSWER_TIMEOUT_S, 5.0 * self.config.period):
                self.telemetry = None
            return
        if not newest.flags & BoardFlag.CONFIGURED:
            # it had no power, and counts wire from a new zero: send its configuration again; its
            # motors stay off
            self.restarted |= self.torque_requested
            self.zero[:] = np.nan
            self.link.configure(self.config)
            newest = self._receive(ANSWER_TIMEOUT_S) or newest
        enabled = np.array([newest.enabled >> i & 1 for i in self._places], dtype=bool)
        healthy = newest.faults[self._places] == 0
        self.restarted |= self.torque_requested & ~enabled & healthy
        silent = bool(newest.flags & BoardFlag.SILENCE)
        self._tripped = silent and bool(self.torque_requested.any())
        if lost or self._tripped:
            self._start_from_measured()
        if np.any(enabled & ~self.torque_requested):  # it was switched off while the port was lost
            self.link.send(Message.DISABLE, self._mask(enabled & ~self.torque_requested))

    def _receive(self, wait: float) -> Telemetry | None:
        """Take the newest telemetry, None when none came."""
        newest = self.link.telemetry(wait)
        self._read_at = time.monotonic()
        if newest is not None:
            self.telemetry, self._received_at = newest, self.link.clock()
        return newest

    def read_fresh(self) -> None:
        """Take telemetry that is newer than the last message to the board."""
        self.link.flush()
        if self._receive(0.5) is None:
            raise DriverError(f'{self.config.port}: no telemetry; check cable and supply')

    def _zero_in_place(self) -> None:
        if self.config.zero == 'here':
            self.zero = np.where(np.isfinite(self.zero), self.zero, self._board_pulls())

    def _find_slack(self) -> None:
        """
        Wind all wires to the homing tension, within `home_travel` of where the search began.

        Raises
        ------
        MovedError
            A wire does not reach that tension in time.
        DriverError
            The board refuses before anything has moved.
        """
        channels, travel = self._places.tolist(), self.config.home_travel
        distances, start = travelled(self.config.port), self._board_pulls()
        origin = start - np.array([distances.get(channel, 0.0) for channel in channels])
        try:
            self._refuse_too_far(np.abs(start - origin) > travel)
        except DriverError as error:
            raise MovedError(f'no pull zero found: {error}') from None
        self.link.give_limits(self.config, origin, (-travel, travel))
        self.switch_on('tension')
        self.zero = self._wind_until_taut(origin)

    def _wind_until_taut(self, origin: Floats) -> Floats:
        """Command the homing tension until every wire has it; return where they are, (m,) [m]."""
        config = self.config
        goal = np.full(len(self.inputs), config.home_tension)
        deadline = time.monotonic() + config.home_time
        steady = time.monotonic()
        try:
            while time.monotonic() - steady < STANDING_S:
                self.refuse_cancelled()
                self.command('tension', goal)
                self.read_fresh()
                tensions, _ = self._tensions()
                off_target = ~(np.abs(tensions - goal) < TENSION_TOLERANCE * goal)
                if off_target.any():
                    steady = time.monotonic()
                self._refuse_latched()
                reach = config.home_travel - TRAVEL_TOLERANCE_M
                self._refuse_too_far(off_target & (np.abs(self._board_pulls() - origin) > reach))
                if time.monotonic() > deadline:
                    names = ', '.join(compress(self.inputs, off_target))
                    raise DriverError(
                        f'{config.port}: {names}: not at '
                        f'{config.home_tension:g} N within {config.home_time:g} s; is the wire '
                        'attached, and the direction right?'
                    )
                time.sleep(CYCLE_S)
        except (DriverError, PortLostError) as error:
            self.disable()
            try:
                self.read_fresh()
                distance = self._board_pulls() - origin
            except (DriverError, PortLostError):  # on its own the board may wind to the end
                distance = np.full(len(self.inputs), config.home_travel)
            travelled(config.port).update(
                zip(self._places.tolist(), distance.tolist(), strict=True)
            )
            raise MovedError(f'no pull zero found: {error}') from None
        return self._board_pulls()

    def _board_pulls(self, fault: int = 0) -> Floats:
        """Return the wire pulls from the board's zero, (m,) [m]; nan where there is the fault."""
        return np.asarray(self._channels('pulls', fault) / self._counted)

    def _refuse_too_far(self, which: Bools) -> None:
        """Raise DriverError for inputs (m,) whose search for slack has gone too far."""
        if which.any():
            names = ', '.join(compress(self.inputs, which))
            raise DriverError(
                f'{self.config.port}: {names}: no resistance within home_travel = '
                f'{self.config.home_travel:g} m; is the wire on its spool, is direction right?'
            )
