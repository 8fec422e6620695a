"""Running a node so that it ends safe: own signal handling, one executor, a safe end."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import rclpy
import rclpy.utilities
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..control.parent import end_with_parent
from ..exceptions import InputError, TendonRobotError

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Ending:
    """Tells that a signal asked the process to end; a second one ends it at once."""

    current: Ending | None = None

    def __init__(self) -> None:
        """Nothing was asked yet."""
        self.signal = 0
        Ending.current = self

    def __call__(self, number: int, frame: object) -> None:
        """Take a signal."""
        if self.signal:
            os._exit(128 + number)
        self.signal = number


def asked_to_end() -> bool:
    """Whether a signal came; for what takes long and can be cancelled."""
    return Ending.current is not None and bool(Ending.current.signal)


class Runnable(Protocol):
    """What `run` needs of a node."""

    @property
    def node(self) -> Node:
        """The node to spin."""

    def start(self) -> None:
        """Begin; called once before the first spin."""

    def running(self) -> bool:
        """Whether to go on; asked after every spin."""

    def end(self, spin: Callable[[float], None]) -> None:
        """End safe, while messages still go out; `spin` serves callbacks for some seconds."""


@contextlib.contextmanager
def ros(arguments: Sequence[str]) -> Iterator[Ending]:
    """
    Hold ROS open; signals set a flag instead of closing it under the safe end.

    Yields
    ------
    Ending
        Its `signal` is the number of the signal that came, or 0.

    """
    ending = Ending()
    end_with_parent()
    try:
        rclpy.init(args=['node', *arguments], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # RCLError, UnknownROSArgsError: what a person typed
        raise InputError(f'ROS arguments: {str(error).split(", at /")[0]}') from None
    before = {number: signal.signal(number, ending) for number in SIGNALS}
    try:
        yield ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        rclpy.utilities.try_shutdown()


def run(make: Callable[[], Runnable], arguments: Sequence[str]) -> int:
    """Run a node until a signal comes or it ends; return the exit code."""
    with ros(arguments) as ending:
        executor = SingleThreadedExecutor()
        runnable = None
        code = 0
        try:
            runnable = make()
            executor.add_node(runnable.node)
            runnable.start()
            while not ending.signal and runnable.running():
                executor.spin_once(timeout_sec=0.1)
        except TendonRobotError as error:
            print('error:', ' '.join(str(error).split()), file=sys.stderr)
            code = 1
        except Exception:
            traceback.print_exc()
            code = 1
        finally:
            if runnable is not None:
                _end(runnable, executor)
            executor.shutdown(timeout_sec=1.0)
    return code


def _end(runnable: Runnable, executor: SingleThreadedExecutor) -> None:
    def spin(seconds: float) -> None:
        executor.spin_once(timeout_sec=seconds)

    try:
        runnable.end(spin)
    except Exception:  # the end must go on
        traceback.print_exc()
    executor.remove_node(runnable.node)
    runnable.node.destroy_node()
