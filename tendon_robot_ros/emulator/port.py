"""
An emulated serial port that can be unplugged, faults of its answers, and its commands.

Also the command `emulate` in a process of its own, for tests, benchmarks and demonstrations.
"""

from __future__ import annotations

import abc
import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, ClassVar, Self, cast

import yaml

from ..common.errors import DriverError, InputError
from ..common.processes import Realtime, go_realtime
from ..drivers.serial_port import ANSWER_TIMEOUT_S

Command = Callable[[list[str]], str | None]  # takes the words behind the first, may answer
COMMON_HELP = """\
spoil N | cut N | double N   the next N pieces it sends: a wrong byte, half missing, sent twice
slow SECONDS          before everything it sends; slow 0: as fast as ever
unplug [SECONDS]      pull the plug; with SECONDS put it back after that time
plug                  put it back"""


class Plug(abc.ABC):
    """
    An emulated serial port with a thread of its own: a pseudo-terminal that can be unplugged.

    A subclass defines its motors (`rig`), the reaction to bytes and its commands; time passes, and
    bytes are received, with the lock held.

    Attributes
    ----------
    port : str
        The path to open.
    spoilt, cut, doubled : int
        Number of next answers that get a wrong CRC, lose their second half, arrive twice.
    delay : float
        Before every answer [s].
    slept : float
        All delays so far [s].
    help : str
        Its commands, for a person.

    """

    help: ClassVar[str] = COMMON_HELP
    rig: Any  # motors, and the arm that they pull on

    def __init__(self, name: str, port: str | None = None, idle: float = 0.005) -> None:
        """
        Plug it in; it answers within its context.

        Parameters
        ----------
        name : str
            Of the port, where no path is given.
        port : str, optional
            Path at which it appears.
        idle : float
            Time between two steps when nothing arrives [s].

        """
        self._idle, self._lived = idle, 0.0
        self.spoilt = self.cut = self.doubled = 0
        self.delay = self.slept = 0.0
        if port and os.path.exists(port):
            raise InputError(f'{port}: there is a file of that name already')
        self._folder = Path(tempfile.mkdtemp(prefix='tendon_robot_ros_'))
        self.port = port or str(self._folder / name)
        self._master: int | None = None
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f'emulated {name}', daemon=True)
        self.plug()

    @property
    def lived(self) -> float:
        """Its own time [s], which does not pass while this process is not scheduled."""
        return self._lived + self.slept

    def advance(self, passed: float) -> None:
        """Let time [s] pass for motors and wires; a longer pause of this process is skipped."""
        self.rig.advance(min(passed, ANSWER_TIMEOUT_S))

    @abc.abstractmethod
    def receive(self, data: bytes) -> None:
        """Receive the bytes of a client."""

    @abc.abstractmethod
    def connected(self) -> None:
        """Discard incomplete input after the port was plugged in again."""

    def commands(self) -> dict[str, Command]:
        """Return the commands by their first word: faults that a person or a test switches."""
        return {
            'spoil': lambda values: setattr(self, 'spoilt', int(values[0])),
            'cut': lambda values: setattr(self, 'cut', int(values[0])),
            'double': lambda values: setattr(self, 'doubled', int(values[0])),
            'slow': lambda values: setattr(self, 'delay', float(values[0])),
            'unplug': lambda values: self.unplug(float(values[0]) if values else None),
            'plug': lambda values: self.plug(),
            'state': lambda values: json.dumps(self.state()),
            'help': lambda values: self.help,
        }

    def state(self) -> dict[str, object]:
        """Return the state of motors and wires as plain values."""
        return {'port': self.port, 'time': time.monotonic(), **getattr(self.rig.arm, 'shown', {})}

    def obey(self, text: str) -> str:
        """
        Carry out one command; return the answer.

        Raises
        ------
        InputError
            The command is unknown, or its values are wrong.

        """
        word, *values = text.split()
        try:
            return self.commands()[word](values) or 'ok'
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(f'{text!r}: {error}; type help') from None

    def __enter__(self) -> Self:
        """Answer from now on, in a thread of its own."""
        self._before = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End the thread and take the port away."""
        self._end.set()
        self._thread.join()
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)

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
            self.connected()

    def unplug(self, seconds: float | None = None) -> None:
        """Pull the plug, and put it back after some seconds; the electronics keep their power."""
        with self._lock:
            if self._master is not None:
                os.close(self._master)
                self._master = None
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(self.port)
        if seconds is not None:
            time.sleep(seconds)
            self.plug()

    def _serve(self) -> None:
        while not self._end.is_set():
            data, master = b'', self._master
            try:
                if master is None:
                    time.sleep(self._idle)
                elif select.select([master], [], [], self._idle)[0]:
                    data = os.read(master, 4096)
            except (OSError, ValueError):  # nobody has the port open, or it was unplugged
                time.sleep(self._idle)
            with self._lock:
                now = time.monotonic()
                passed, self._before = now - self._before, now
                self.advance(passed)
                if data:
                    self.receive(data)
                self._lived += min(passed, 2.0 * self._idle)

    def _send(self, answer: bytes) -> None:
        """Send an answer with the present faults."""
        if not answer:
            return
        end = time.monotonic() + self.delay
        while (late := end - time.monotonic()) > 0.0:  # in parts: others wait by its own time
            part = min(late, self._idle)
            time.sleep(part)
            self.slept += part
        if self.spoilt:
            self.spoilt -= 1
            answer = answer[:-1] + bytes([answer[-1] ^ 0x5A])
        if self.cut:
            self.cut -= 1
            answer = answer[: len(answer) // 2]
        if self.doubled:
            self.doubled -= 1
            answer += answer
        if self._master is not None:
            with contextlib.suppress(OSError):
                os.write(self._master, answer)


class EmulatorProcess(contextlib.AbstractContextManager['EmulatorProcess']):
    """
    Emulated motors of a robot; they go before other work of the machine, where that is allowed.

    Attributes
    ----------
    port : str
        The port to give to a driver.
    config : Path
        A configuration for the driver, written by `emulate`.

    """

    def __init__(self, robot: str | Path, *arguments: str, kind: str = 'dynamixel') -> None:
        """Start `emulate KIND` for a robot description, with more of its arguments."""
        self._folder = tempfile.TemporaryDirectory(prefix='tendon_robot_ros_')
        self.config = Path(self._folder.name, 'motors.yaml')
        command = ['motors', 'emulate', kind, '--ends-with-input']
        command += ['--robot', str(robot), '--output', str(self.config), *arguments]
        self._conversation = threading.Lock()
        self.process = self.start(command)
        self._to = cast(IO[str], self.process.stdin)
        self._from = cast(IO[str], self.process.stdout)
        self.port = self._from.readline().strip()
        if not self.port:
            self.end()
            raise DriverError('emulate ended at once; its message is above')
        go_realtime(Realtime.EMULATOR, process=self.process.pid)

    def start(self, command: Sequence[str]) -> subprocess.Popen[str]:
        """Start a command of this package in a process of its own, with pipes to and from it."""
        return subprocess.Popen(
            [sys.executable, '-m', 'tendon_robot_ros', *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def say(self, text: str) -> str:
        """Send one of its commands; return the answer. Thread-safe."""
        with self._conversation:
            self._to.write(text + '\n')
            self._to.flush()
            return self._from.readline().strip()

    def ask(self, text: str) -> Any:
        """Send a command that answers in JSON; return the decoded answer."""
        return json.loads(self.say(text))

    def content(self) -> dict[str, Any]:
        """Return the configuration for the driver."""
        return cast(dict[str, Any], yaml.safe_load(self.config.read_text(encoding='utf-8')))

    def end(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait(10.0)
        self._to.close()
        self._from.close()
        self._folder.cleanup()

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.end()
