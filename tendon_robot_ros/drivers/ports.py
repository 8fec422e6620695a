"""Serial ports of any kind of motor: which there are, why one cannot be opened, writing."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import termios
from pathlib import Path

# what an unplugged port raises: serial's error is an OSError, termios.error is none
PORT_ERRORS = (OSError, termios.error)
WRITE_TIMEOUT_S = 0.1  # [s] for which a port may take nothing


class PortLostError(Exception):
    """The port is gone; `reopen` may bring it back."""


def take_alone(file: int) -> None:
    """Let no other process open the port; a lock that pyserial takes binds its users only."""
    fcntl.ioctl(file, termios.TIOCEXCL)


def write_all(file: int, data: bytes) -> None:
    """
    Write to a port that does not block.

    pyserial's own write, with a time-out, says that a port takes nothing also where it took all
    at once and this process was late to notice.

    Raises
    ------
    OSError
        The port is gone, or has taken nothing for `WRITE_TIMEOUT_S`.

    """
    while data:
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(file, data) :]
        if data and not select.select([], [file], [], WRITE_TIMEOUT_S)[1]:
            raise TimeoutError(f'the port took nothing for {WRITE_TIMEOUT_S:g} s')


def why_not(path: str, error: BaseException) -> str:
    """Say in words why a port cannot be opened, and what to do."""
    code = getattr(error, 'errno', None)
    if not os.path.exists(path):
        return (
            f'{path}: no such port; is the adapter plugged in? '
            f'found: {", ".join(present_ports()) or "no USB serial port"}'
        )
    if code == 13:
        return (
            f'{path}: not allowed; type: sudo usermod -aG dialout $USER, then log out and in again'
        )
    if code in (11, 16) or 'lock' in str(error):
        return f'{path}: another process has the port{_holder(path)}; stop it first'
    return f'{path}: cannot open: {error}'


def _holder(path: str) -> str:
    """Name the process that has the port open, where it may be seen."""
    wanted = os.path.realpath(path)
    for link in Path('/proc').glob('[0-9]*/fd/*'):
        try:
            if os.readlink(link) == wanted and int(link.parts[2]) != os.getpid():
                command = Path('/proc', link.parts[2], 'cmdline').read_bytes()
                name = command.replace(b'\0', b' ').decode(errors='replace').strip()
                return f' (process {link.parts[2]}: {name[:60]})'
        except OSError:
            continue
    return ''


def present_ports() -> list[str]:
    """List the USB serial ports, by the name that stays when they are plugged in again."""
    by_id = sorted(str(path) for path in Path('/dev/serial/by-id').glob('*'))
    return by_id or sorted(str(path) for path in Path('/dev').glob('ttyUSB*'))


# -----------------------------------------------------------------------------
# How far motors have gone in searches for slack that failed.
#
# It belongs to the port and to this process, not to a driver: whoever tries again, with whatever
# object, goes on from the same beginning, so that the bound of a search holds for all attempts
# together. What a hand or a spring turns while the torque is off does not count: a person resets.

_BY_PORT: dict[str, dict[int, float]] = {}


def travelled(port: str) -> dict[int, float]:
    """
    Return what the motors of a port have gone since the first attempt; clear it to forget.

    Returns
    -------
    dict of int to float
        Motor (its id or channel) -> signed way, in the unit of the driver (ticks or m).

    """
    return _BY_PORT.setdefault(port, {})
