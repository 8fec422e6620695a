"""An emulated serial port that can be unplugged, what it does to answers, and its words."""

from __future__ import annotations

import abc
import contextlib
import os
import select
import shutil
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from ..common.errors import InputError


@dataclass
class Faults:
    """
    What is wrong with the answers at the moment.

    Parameters
    ----------
    spoilt, cut, doubled : int
        How many of the next answers get a wrong CRC, lose their second half, come twice.
    delay : float
        Before every answer [s].
    slept : float
        All delays so far, and the one that has begun [s].
    """

    spoilt: int = 0
    cut: int = 0
    doubled: int = 0
    delay: float = 0.0
    slept: float = 0.0

    def on_the_way(self, answer: bytes) -> bytes:
        """Do to an answer what the bus does to it."""
        if not answer:
            return answer
        if self.delay:
            self.slept += self.delay
            time.sleep(self.delay)
        if self.spoilt:
            self.spoilt -= 1
            answer = answer[:-1] + bytes([answer[-1] ^ 0x5A])
        if self.cut:
            self.cut -= 1
            answer = answer[: len(answer) // 2]
        if self.doubled:
            self.doubled -= 1
            answer += answer
        return answer


# -----------------------------------------------------------------------------
# An emulated serial port: a pseudo-terminal that can be unplugged, and its own thread.


class Plug(abc.ABC):
    """
    An emulated port; `port` is the path to open, `faults` what is wrong with its answers.

    A subclass says what happens as time passes and when bytes come; both with the lock held.
    """

    def __init__(self, name: str, port: str | None = None, idle: float = 0.005) -> None:
        """
        Plug it in; `start` begins to answer.

        Parameters
        ----------
        name : str
            Of the port, where no path is given.
        port : str, optional
            Path at which it appears.
        idle : float
            Between two looks at the clock when nothing arrives [s].

        """
        self._idle, self.faults, self._lived = idle, Faults(), 0.0
        if port and os.path.exists(port):
            raise InputError(f'{port}: there is a file of that name already')
        self._folder = Path(tempfile.mkdtemp(prefix='tendon_robot_ros_'))
        self.port = port or str(self._folder / name)
        self._master: int | None = None
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f'emulated {name}', daemon=True)
        self._before = time.monotonic()
        self.plug()

    @property
    def lived(self) -> float:
        """Its own time [s]: it stands still while nobody lets this process run."""
        return self._lived + self.faults.slept

    @abc.abstractmethod
    def _let_time_pass(self, passed: float) -> None:
        """Advance what is emulated by so many seconds."""

    @abc.abstractmethod
    def _hear(self, data: bytes) -> None:
        """Take what a client has sent."""

    @abc.abstractmethod
    def _plugged(self) -> None:
        """Begin anew with the bytes; the rest kept its power."""

    def start(self) -> Self:
        """Answer from now on, in a thread of its own."""
        self._before = time.monotonic()
        self._thread.start()
        return self

    def stop(self) -> None:
        """End the thread and take the port away."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.stop()

    def plug(self) -> None:
        """Make the port appear; the electronics kept their power."""
        with self._lock:
            if self._master is not None:
                return
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)
            os.symlink(os.ttyname(slave), self.port)
            os.close(slave)  # else a client's exclusive lock would outlive the client
            self._master = master
            self._plugged()

    def unplug(self) -> None:
        """Pull the plug: the port is gone, the electronics keep their power."""
        with self._lock:
            if self._master is None:
                return
            os.close(self._master)
            self._master = None
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.port)

    def _serve(self) -> None:
        while not self._end.is_set():
            data = self._receive()
            with self._lock:
                now = time.monotonic()
                passed, self._before = now - self._before, now
                self._let_time_pass(passed)
                if data:
                    self._hear(data)
                self._lived += min(passed, 2.0 * self._idle)

    def _receive(self) -> bytes:
        """Wait a little for bytes; none when there are none or nobody has the port open."""
        master = self._master
        if master is not None:
            with contextlib.suppress(OSError, ValueError):
                if not select.select([master], [], [], self._idle)[0]:
                    return b''
                return os.read(master, 4096)
        time.sleep(self._idle)
        return b''

    def _send(self, answer: bytes) -> None:
        if self._master is not None and answer:
            with contextlib.suppress(OSError):
                os.write(self._master, answer)


# -----------------------------------------------------------------------------
# Words that do something to what is emulated: faults for a person, or a test, to switch on.

Action = Callable[[Any, list[str]], str | None]  # of the line and the values behind the word
COMMON_HELP = """\
spoil N | cut N | double N   the next N pieces it sends: a wrong byte, half missing, sent twice
slow SECONDS          before everything it sends; slow 0: as fast as ever
unplug [SECONDS]      pull the plug; with SECONDS put it back after that time
plug                  put it back"""


def obey(line: Plug, text: str, actions: Mapping[str, Action]) -> str:
    """
    Carry out one command, of every line or one of its own `actions`; return what to answer.

    Raises
    ------
    InputError
        It is none of the known ones, or its values are wrong.

    """
    word, *values = text.split()
    try:
        return {**COMMON_ACTIONS, **actions}[word](line, values) or 'ok'
    except (ValueError, IndexError, KeyError) as error:
        raise InputError(f'{text!r}: {error}; type help') from None


def _set(name: str, kind: type) -> Action:
    def change(line: Plug, values: list[str]) -> None:
        setattr(line.faults, name, kind(values[0]))

    return change


def _unplug(line: Plug, values: list[str]) -> None:
    line.unplug()
    if values:
        time.sleep(float(values[0]))
        line.plug()


COMMON_ACTIONS: dict[str, Action] = {
    'spoil': _set('spoilt', int),
    'cut': _set('cut', int),
    'double': _set('doubled', int),
    'slow': _set('delay', float),
    'unplug': _unplug,
    'plug': lambda line, values: line.plug(),
}
