"""Questions to the board that it must answer: who it is, and that it took its configuration."""

from __future__ import annotations

import time

import numpy as np

from ...exceptions import DriverError
from ..interface import Array
from . import messages
from .config import Config
from .frames import VERSION, Frame
from .link import Link
from .messages import Identity, Telemetry

BOOT_TIME = 4.0  # [s]; opening the port restarts many boards, their boot loader waits 2 s
ANSWER = 0.1  # [s]
ATTEMPTS = 8
RELEASE_TIME = 10.0  # [s] that a board left running by another process gets


def identify(link: Link, config: Config) -> Identity:
    """
    Ask who is there until it answers.

    Raises
    ------
    DriverError
        Nobody, another version of the protocol, or too few channels.

    """
    deadline = time.monotonic() + BOOT_TIME
    while time.monotonic() < deadline:
        link.send(messages.HELLO)
        for frame in wait_for(link, messages.IDENTITY, ANSWER):
            identity = messages.read_identity(frame)
            if identity is not None:
                return _suits(link, config, identity)
    raise DriverError(
        f'{link.path}: no answer at {config.baud} baud for {BOOT_TIME:g} s; is the firmware on '
        'the board, and is the baud rate that of pins.h?'
    )


def _suits(link: Link, config: Config, identity: Identity) -> Identity:
    if identity.version != VERSION:
        raise DriverError(
            f'{link.path}: protocol: expected version {VERSION}, got {identity.version}; '
            'put the firmware of this package on the board'
        )
    for tendon in config.tendons:
        if tendon.channel >= identity.channels:
            raise DriverError(
                f'{config.source}: {tendon}: the board has channels 0 to {identity.channels - 1}'
            )
    return identity


def wait_for(link: Link, kind: int, wait: float) -> list[Frame]:
    """Return the frames of a kind as soon as there is one; none after `wait` [s]."""
    deadline = time.monotonic() + wait
    while (left := deadline - time.monotonic()) > 0.0:
        found = [frame for frame in link.receive(left) if frame.type == kind]
        if found:
            return found
    return []


def ask(link: Link, kind: int, payload: bytes, attempts: int = ATTEMPTS) -> None:
    """
    Send a message until the board says what it did with it.

    Raises
    ------
    DriverError
        It refuses, or does not answer.

    """
    for _ in range(attempts):
        sequence = link.send(kind, payload)
        deadline = time.monotonic() + ANSWER
        while (left := deadline - time.monotonic()) > 0.0:
            for frame in wait_for(link, messages.RESULT, left):
                if frame.payload[:2] == bytes((kind, sequence)) and len(frame.payload) == 3:
                    if frame.payload[2] == 0:
                        return
                    reason = messages.REFUSALS.get(frame.payload[2], 'an unknown reason')
                    raise DriverError(
                        f'{link.path}: the board refused {messages.NAMES[kind]}: {reason}'
                    )
    raise DriverError(f'{link.path}: no answer to {messages.NAMES[kind]}; check cable and supply')


def configure(link: Link, config: Config, zeros: Array) -> None:
    """Give the board all it must know; its motors are off. `zeros`: shape (m,) [m]."""
    for tendon in config.tendons:
        cell = tendon.cell
        if cell is not None:
            values = (cell.zero, cell.newtons_per_count, tendon.metres_per_tick)
            ask(link, messages.CALIBRATION, messages.calibration(tendon.channel, *values))
    give_limits(link, config, zeros)
    content = messages.settings(
        config.timeout,
        config.release_to,
        config.period,
        config.release_rate,
        config.rest,
        config.gain,
    )
    ask(link, messages.SETTINGS, content)


def give_limits(link: Link, config: Config, zeros: Array) -> None:
    """Give the board the limits; it counts wire from its own zero, `zeros`: shape (m,) [m]."""
    for tendon, zero in zip(config.tendons, zeros, strict=True):
        low, high = (limit + zero for limit in tendon.pull_limits)
        values = (0.0, tendon.tension_limit, low, high, config.tension_rate, config.pull_rate)
        ask(link, messages.LIMITS, messages.limits(tendon.channel, np.array(values)))


def telemetry(link: Link, channels: int, wait: float) -> Telemetry | None:
    """Return the newest telemetry; waits for one up to `wait` [s]."""
    for frame in reversed(wait_for(link, messages.TELEMETRY, wait)):
        if messages.is_telemetry(frame, channels):
            return messages.read_telemetry(frame)
    return None


def let_go(link: Link, channels: int) -> None:
    """Release what another process has left under tension, then torque off."""
    found = telemetry(link, channels, 0.3)
    if found is not None and found.enabled:
        ask(link, messages.RELEASE, bytes((messages.RELEASES['limp'],)))
        deadline = time.monotonic() + RELEASE_TIME
        while found is not None and found.enabled and time.monotonic() < deadline:
            link.send(messages.HEARTBEAT)
            found = telemetry(link, channels, 0.1)
    ask(link, messages.DISABLE, b'\xff')
