"""Nodes as processes of their own, ended for certain when their starter ends."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import IO, Self

from ..control.parent import child_environment


class NodeProcess:
    """
    A node of this package in its own process.

    Parameters
    ----------
    name : str
        As on the command line.
    parameters : mapping
        ROS parameters; text is quoted as YAML.
    namespace : str
        Both for its topics and for the node.
    output : file, optional
        Where its messages go; default: where those of this process go.

    """

    def __init__(
        self,
        name: str,
        parameters: Mapping[str, object],
        namespace: str = '/',
        output: IO[str] | None = None,
        extra: Sequence[str] = (),
    ) -> None:
        """Start it; it gets SIGINT when this process dies, however that happens."""
        arguments = ['--ros-args', '-r', f'__ns:={namespace}']
        for key, value in parameters.items():
            arguments += ['-p', f'{key}:={_yaml(value)}']
        self.name = name
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'tendon_robot_ros', name, *arguments, *extra],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            text=True,
            env=child_environment(),
            start_new_session=True,
        )

    def end(self, timeout: float = 5.0) -> int:
        """Ask it to end safe, wait, and kill it if it does not; return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                return self.process.wait(timeout)
            except subprocess.TimeoutExpired:
                self.process.kill()
        return self.process.wait()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it."""
        self.end()


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace('\\', '\\\\').replace('"', '\\"').replace('\n', '\\n') + '"'
    return str(value)
