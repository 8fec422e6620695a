"""The command `emulate` in a process of its own, for tests, benchmarks and demonstrations."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Self, cast

import yaml

from ..common.errors import DriverError
from ..common.processes import Realtime, go_realtime


class EmulatorProcess:
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
        command = ['emulate', kind, '--ends-with-input']
        command += ['--robot', str(robot), '--write-config', str(self.config), *arguments]
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

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.end()
