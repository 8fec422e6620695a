"""Serial ports of any kind of motor: which there are, why one cannot be opened, writing."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
from pathlib import Path

# what an unplugged port raises: serial's error is an OSError, termios.error is none
PORT_ERRORS = (OSError, termios.error)
WRITE_TIMEOUT_S = 0.1  # [s] for which a port may take nothing
NAME_SHOWN = 60  # characters of a command: a message is a line


class PortLostError(Exception):
    """The port is gone; `reopen` may bring it back."""


def take_alone(file: int) -> None:
    """Let no other process open the port; a lock that pyserial takes binds its users only."""
    fcntl.ioctl(file, termios.TIOCEXCL)


def refuse_held(path: str) -> None:
    """
    Refuse a port that is open already: a program without a lock would share its answers.

    Raises
    ------
    OSError
        Somebody has it; `why_not` says who.

    """
    if held_by(path):
        raise OSError(errno.EBUSY, 'open already')


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
    if code in (errno.EAGAIN, errno.EBUSY) or 'lock' in str(error):
        return f'{path}: {held_by(path) or "another process has the port"}; stop it first'
    return f'{path}: cannot open: {error}'


def held_by(path: str, others: bool = False) -> str:
    """
    Say which process has a port open, '' where none is seen.

    Parameters
    ----------
    path : str
    others : bool
        Not this process.

    """
    wanted = os.path.realpath(path)
    for link in Path('/proc').glob('[0-9]*/fd/*'):
        try:
            if os.readlink(link) != wanted:
                continue
            if int(link.parts[2]) == os.getpid():
                if others:
                    continue
                return 'this process has the port already'
            command = Path('/proc', link.parts[2], 'cmdline').read_bytes()
            name = ' '.join(command.decode(errors='replace').replace('\0', ' ').split())
            return f'another process has the port (process {link.parts[2]}: {name[:NAME_SHOWN]})'
        except OSError:  # it has ended, or belongs to somebody else
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
