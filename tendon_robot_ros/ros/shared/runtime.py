"""
Running a node so that it ends safe: own signal handling, one executor, a safe end.

Nodes reach each other by UDP, on one machine too. Fast DDS, the usual middleware of Jazzy, has a
shared-memory transport besides. A process that is killed while it holds a lock there, or leaves a
port behind, keeps every other process that sends to it from going on: for 0.3 to 1 s each time,
5.5 s at worst, with all its threads, because rclpy keeps Python's lock while it sends
(eProsima/Fast-DDS#6535, `benchmarks/bench_killed.py`). Neither a stop nor a watchdog would be
heard in that time. A node that has no shared memory does not wait.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import IO, Any, Self, cast

import rclpy
import rclpy.utilities
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ...common.errors import InputError, TendonRobotError
from ...common.files import shared_file
from ...common.processes import (
    child_environment,
    end_with_parent,
    ending_signals,
    go_first,
    print_without_waiting,
    switch_often,
)
from .timing import SILENCE_S, VALUES_PERIOD_S

given: list[str] = []  # what this process was told on its command line, for ROS
RANGE, ONLY_HERE = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY'
TRANSPORTS, PROFILES = 'FASTDDS_BUILTIN_TRANSPORTS', 'FASTRTPS_DEFAULT_PROFILES_FILE'
# [s] because launch passes on the signal that the terminal or systemd has sent to all, too: an
# echo that comes so soon would else end a node before it has let the arm go
SIGNAL_ECHO_S = SILENCE_S
SPIN_S = VALUES_PERIOD_S  # [s] of one spin of an executor, after which conditions are checked
# [s] for a process to end, else its starter would wait for ever: a release of 5 N at the default
# release_rate of 10 N/s takes 0.5 s of it
END_TIMEOUT_S = 5.0


class Ending:
    """
    Tells that a signal asked the process to end; one a while later ends it at once.

    A thread hears of the signal from the C part of Python. What Python itself calls waits until
    the main thread comes back to it, a tenth of a second in an executor and longer in a model.
    """

    current: Ending | None = None

    def __init__(self, first: bool = False) -> None:
        """Nothing was asked yet; `first`: the process goes before others."""
        self.signal, self.first, self.over = 0, first, False
        self._asked = 0.0
        self._actions: list[Callable[[], object]] = []
        Ending.current = self

    def then(self, action: Callable[[], object]) -> None:
        """Do something in the thread that hears the signal, as soon as it comes."""
        self._actions.append(action)
        if self.signal:
            action()

    def asked(self, number: int) -> None:
        """Take a signal."""
        now = time.monotonic()
        if self.signal:
            if now - self._asked > SIGNAL_ECHO_S and number != signal.SIGHUP:
                os._exit(128 + number)
            return
        self.signal, self._asked = number, now
        for action in self._actions:
            try:
                action()
            except Exception:  # the end must go on
                traceback.print_exc()

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Hear the signals."""

        def listen() -> None:
            while data := here.recv(16):
                for number in data:
                    if number in wanted:
                        self.asked(number)

        wanted = ending_signals()
        here, there = socket.socketpair()
        there.setblocking(False)
        thread = threading.Thread(target=listen, name='signals', daemon=True)
        thread.start()
        told = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
        before = {number: signal.signal(number, lambda *_: None) for number in wanted}
        try:
            yield
        finally:
            for number, handler in before.items():  # what ends by itself is not ended by an echo
                signal.signal(number, signal.SIG_IGN if self.over else handler)
            signal.set_wakeup_fd(told)
            there.close()
            thread.join()
            here.close()


def asked_to_end() -> bool:
    """Whether a signal came; for what takes long and can be cancelled."""
    return Ending.current is not None and bool(Ending.current.signal)


def goes_first() -> bool:
    """Whether this process was started to move motors."""
    return Ending.current is not None and Ending.current.first


def when_asked_to_end(action: Callable[[], object]) -> None:
    """Have something done as soon as a signal comes, by another thread."""
    if Ending.current is not None:
        Ending.current.then(action)


class Runnable:
    """What `run` asks of a node; a node inherits it before its class of rclpy."""

    @property
    def node(self) -> Node:
        """The node to spin: itself."""
        return cast(Node, self)

    def start(self) -> None:
        """Begin; called once before the first spin."""

    def running(self) -> bool:
        """Whether to go on; asked after every spin."""
        return True

    def end(self) -> None:
        """End safe, while messages still go out."""


def without_shared_memory() -> None:
    """
    Have the nodes of this process, and of its children, do without the shared memory of Fast DDS.

    To be called before the first node. Who has set transports or a profile of his own keeps them;
    other middlewares do not read these variables. rmw_fastrtps adds the shared memory by itself
    where `ROS_AUTOMATIC_DISCOVERY_RANGE` is LOCALHOST; a profile then says what that means. With
    `ROS_STATIC_PEERS` it cannot, and the shared memory stays.
    """
    if os.environ.get(TRANSPORTS) or os.environ.get(PROFILES):
        return
    os.environ[TRANSPORTS] = 'UDPv4'
    here = os.environ.get(RANGE) == 'LOCALHOST' or os.environ.get(ONLY_HERE) == '1'
    profile = shared_file('config/fastdds_localhost.xml')
    if here and profile is not None and not os.environ.get('ROS_STATIC_PEERS'):
        os.environ[PROFILES] = str(profile)
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
        os.environ.pop(ONLY_HERE, None)


@contextlib.contextmanager
def ros(arguments: Sequence[str], first: bool = False) -> Iterator[Ending]:
    """
    Hold ROS open; signals set a flag instead of closing it under the safe end.

    Yields
    ------
    Ending
        Its `signal` is the number of the signal that came, or 0.

    """
    ending = Ending(first)
    end_with_parent()
    without_shared_memory()
    given[:] = arguments
    try:
        rclpy.init(args=['node', *arguments], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # RCLError, UnknownROSArgsError: what a person typed
        raise InputError(f'ROS arguments: {str(error).split(", at /")[0]}') from None
    try:
        with ending.listening():
            yield ending
    finally:
        rclpy.utilities.try_shutdown()


def make_executor() -> Executor:
    """
    Return the executor that costs least.

    The one that is driven by events takes half the processor time of the other, which makes a new
    wait set for every message; it is young, and not in every rclpy.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def repeat(node: Node, period: float, action: Callable[[], object]) -> Any:
    """
    Have an executor call something every `period` seconds; return the timer.

    By a clock that nobody sets: that of ROS stands still when the computer's is set back, and with
    `use_sim_time` until somebody publishes `/clock`.
    """
    return node.create_timer(period, action, clock=Clock(clock_type=ClockType.STEADY_TIME))


def run(make: Callable[[], Runnable], arguments: Sequence[str], first: bool = False) -> int:
    """
    Run a node until a signal comes or it ends.

    Parameters
    ----------
    make : callable
        Makes the node.
    arguments : sequence of str
        As on the command line.
    first : bool
        It moves motors: it goes before other work of the machine, where that is allowed.

    Returns
    -------
    int
        The exit code.

    """
    if first:
        go_first()
        switch_often()
        print_without_waiting()
    with ros(arguments, first) as ending:
        executor = make_executor()
        runnable = None
        code = 0
        try:
            runnable = make()
            executor.add_node(runnable.node)
            ending.then(lambda: executor.create_task(lambda: None))  # wakes it
            runnable.start()
            gc.freeze()  # what is imported stays: a collection need not look at it
            while not ending.signal and runnable.running():
                executor.spin_once(timeout_sec=SPIN_S)
        except TendonRobotError as error:
            print('error:', ' '.join(str(error).split()), file=sys.stderr)
            code = 1
        except Exception:
            traceback.print_exc()
            code = 1
        finally:
            if runnable is not None:
                try:
                    runnable.end()
                except Exception:  # the end must go on
                    traceback.print_exc()
                executor.remove_node(runnable.node)
                runnable.node.destroy_node()
            executor.shutdown(timeout_sec=1.0)
            ending.over = bool(ending.signal)
    return code


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
    extra, own : sequence of str
        More of ROS, and of its own arguments.

    """

    def __init__(
        self,
        name: str,
        parameters: Mapping[str, object],
        namespace: str = '/',
        output: IO[str] | None = None,
        extra: Sequence[str] = (),
        own: Sequence[str] = (),
    ) -> None:
        """Start it; it gets SIGINT when this process dies, however that happens."""
        arguments = [*ros_arguments(parameters, namespace), *extra]
        self.name = name
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'tendon_robot_ros', name, *own, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            text=True,
            env=child_environment(),
            start_new_session=True,
        )

    def end(self, timeout: float = END_TIMEOUT_S) -> int:
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

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.end()


def ros_arguments(parameters: Mapping[str, object], namespace: str) -> list[str]:
    """Return what a command line says of parameters, as YAML, and namespace."""
    arguments = ['--ros-args', '-r', f'__ns:={namespace}']
    for key, value in parameters.items():
        # JSON is YAML: text stays text, whatever is in it
        arguments += ['-p', f'{key}:={json.dumps(value, ensure_ascii=False, default=str)}']
    return arguments
