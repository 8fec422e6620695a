"""
Running a node so that it ends safely: signal handling, one executor, an orderly end.

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
from typing import IO, Any, Self

import rclpy
import rclpy.utilities
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ...common import processes
from ...common.errors import InputError, TendonRobotError
from ...common.files import shared_file
from .timing import CALL_TIMEOUT_S, SILENCE_S, VALUES_PERIOD_S

given: list[str] = []  # the ROS arguments of this process
RANGE, LOCALHOST_ONLY = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY'
TRANSPORTS, PROFILES = 'FASTDDS_BUILTIN_TRANSPORTS', 'FASTRTPS_DEFAULT_PROFILES_FILE'
# [s] because launch passes on the signal that the terminal or systemd has sent to all, too: an
# echo that comes so soon would else end a node before it has let the arm go
SIGNAL_ECHO_S = SILENCE_S
SPIN_S = VALUES_PERIOD_S  # [s] of one spin of an executor, after which conditions are checked


class Ending:
    """
    The request of a signal to end the process; a second signal later ends it at once.

    A thread receives the signal from the C part of Python. A handler of Python would wait until
    the main thread returns to the interpreter: 0.1 s in an executor, and longer in a model.
    """

    current: Ending  # the last one that was made

    def __init__(self, first: bool = False) -> None:
        """Start without a request; `first`: the process has priority over others."""
        self.signal, self.first, self.over = 0, first, False
        self._interrupts = self._came = False
        self._requested_at = 0.0
        self._actions: list[Callable[[], object]] = []
        Ending.current = self

    def then(self, action: Callable[[], object]) -> None:
        """Have a function called in the thread that receives the signal, as soon as it comes."""
        self._actions.append(action)
        if self.signal:
            action()

    def request(self, number: int) -> None:
        """Handle a signal."""
        now = time.monotonic()
        if self.signal:
            if now - self._requested_at > SIGNAL_ECHO_S and number != signal.SIGHUP:
                os._exit(128 + number)
            return
        self.signal, self._requested_at = number, now
        for action in self._actions:
            try:
                action()
            except Exception:  # the end must go on
                traceback.print_exc()

    @contextlib.contextmanager
    def interrupting(self, on: bool = True) -> Iterator[None]:
        """
        Have a signal raise KeyboardInterrupt in the main thread within the context, or not.

        Only the first one does: what then lets the arm go is not interrupted.
        """
        before, self._interrupts = self._interrupts, on
        try:
            yield
        finally:
            self._interrupts = before and not self._came
        if before and self._came:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Receive signals within the context."""

        def listen() -> None:
            while data := receiver.recv(16):
                for number in data:
                    if number in signals:
                        self.request(number)

        def handle(*_: object) -> None:
            now, self._interrupts, self._came = self._interrupts, False, True
            if now:
                raise KeyboardInterrupt

        signals = processes.ending_signals()
        receiver, sender = socket.socketpair()
        sender.setblocking(False)
        thread = threading.Thread(target=listen, name='signals', daemon=True)
        thread.start()
        previous = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
        handlers = {number: signal.signal(number, handle) for number in signals}
        try:
            yield
        finally:
            for number, handler in handlers.items():  # what ends by itself is not ended by an echo
                signal.signal(number, signal.SIG_IGN if self.over else handler)
            signal.set_wakeup_fd(previous)
            sender.close()
            thread.join()
            receiver.close()


Ending()  # of a process in which `ros` has not made one


class Runnable(Node):
    """A node as `run` expects it."""

    def running(self) -> bool:
        """Return whether to go on; called after every spin."""
        return True

    def end(self) -> None:
        """End safely, while messages are still sent."""


class ClientNode(Node):
    """A node that serves its own messages, when it is asked to; it ends with a `with` block."""

    def __init__(self, name: str, **options: Any) -> None:
        """Create the node and its executor; options as of a node of rclpy."""
        super().__init__(name, **options)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def serve(self, timeout: float) -> None:
        """Serve one message, if one comes within `timeout` [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def destroy_node(self) -> None:
        """Shut down the executor and destroy the node."""
        self._executor.shutdown()
        super().destroy_node()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Destroy the node."""
        self.destroy_node()


def without_shared_memory() -> None:
    """
    Disable the shared memory of Fast DDS for the nodes of this process and its children.

    Call it before the first node is created. Transports or a profile that the user has set stay;
    other middlewares do not read these variables. rmw_fastrtps adds the shared memory by itself
    where `ROS_AUTOMATIC_DISCOVERY_RANGE` is LOCALHOST; a profile then defines that range. With
    `ROS_STATIC_PEERS` a profile cannot, and the shared memory stays.
    """
    if os.environ.get(TRANSPORTS) or os.environ.get(PROFILES):
        return
    os.environ[TRANSPORTS] = 'UDPv4'
    localhost = os.environ.get(RANGE) == 'LOCALHOST' or os.environ.get(LOCALHOST_ONLY) == '1'
    profile = shared_file('config/fastdds_localhost.xml')
    if localhost and profile is not None and not os.environ.get('ROS_STATIC_PEERS'):
        os.environ[PROFILES] = str(profile)
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
        os.environ.pop(LOCALHOST_ONLY, None)


@contextlib.contextmanager
def ros(arguments: Sequence[str], first: bool = False) -> Iterator[Ending]:
    """
    Initialise ROS for a context; a signal sets a flag, so that nodes can end safely.

    Yields
    ------
    Ending
        Its `signal` is the number of the signal that came, or 0.

    """
    ending = Ending(first)
    processes.end_with_parent()
    without_shared_memory()
    given[:] = arguments
    try:
        rclpy.init(args=['node', *arguments], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # RCLError, UnknownROSArgsError: arguments of the user
        raise InputError(f'ROS arguments: {str(error).split(", at /")[0]}') from None
    try:
        with ending.listening():
            yield ending
    finally:
        rclpy.utilities.try_shutdown()


def make_executor() -> Executor:
    """
    Return the executor that needs the least processor time.

    The executor of events needs half the time of the other, which creates a wait set for every
    message; not every rclpy has it.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def repeat(node: Node, period: float, action: Callable[[], object]) -> Any:
    """
    Have an executor call a function every `period` [s]; return the timer.

    Its clock is monotonic: that of ROS stands still when the computer's is set back, and with
    `use_sim_time` until `/clock` is published.
    """
    return node.create_timer(period, action, clock=Clock(clock_type=ClockType.STEADY_TIME))


def run(make: Callable[[], Runnable], arguments: Sequence[str], first: bool = False) -> int:
    """
    Run a node until a signal comes or it ends.

    Parameters
    ----------
    make : callable
        Creates the node.
    arguments : sequence of str
        As on the command line.
    first : bool
        Whether it moves motors: it then has priority over other work, where that is allowed.

    Returns
    -------
    int
        The exit code.

    """
    if first:
        processes.go_first()
        processes.switch_often()
        processes.print_without_waiting()
    with ros(arguments, first) as ending:
        executor = make_executor()
        runnable, code = None, 1
        try:
            runnable = make()
            executor.add_node(runnable)
            ending.then(lambda: executor.create_task(lambda: None))  # ends its wait
            gc.freeze()  # imported objects stay: a collection need not scan them
            while not ending.signal and runnable.running():
                executor.spin_once(timeout_sec=SPIN_S)
            code = 0
        except (TendonRobotError, NameValidationException) as error:  # parameters
            print('error:', ' '.join(str(error).rstrip(' ^').split()), file=sys.stderr)
        except Exception:
            traceback.print_exc()
        finally:
            if runnable is not None:
                try:
                    runnable.end()
                except Exception:  # the end must go on
                    traceback.print_exc()
                executor.remove_node(runnable)
                runnable.destroy_node()
            executor.shutdown(timeout_sec=1.0)
            ending.over = bool(ending.signal)
    return code


class NodeProcess(contextlib.AbstractContextManager['NodeProcess']):
    """
    A node of this package in its own process.

    Parameters
    ----------
    name : str
        Of the command that starts it.
    parameters : mapping
        ROS parameters: name -> value.
    namespace : str
        Of the node and its topics.
    output : file, optional
        Receives its messages; default: the output of this process.
    own : sequence of str
        Further arguments of the command.

    """

    def __init__(
        self,
        name: str,
        parameters: Mapping[str, object],
        namespace: str = '/',
        output: IO[str] | None = None,
        own: Sequence[str] = (),
    ) -> None:
        """Start the process; it gets SIGINT when this one dies, however that happens."""
        arguments = [*own, *ros_arguments(parameters, namespace)]
        self.name = name
        streams = {'stdin': subprocess.DEVNULL, 'stdout': output, 'stderr': output}
        self.process = processes.own_process('tendon_robot_ros', name, *arguments, **streams)

    def end(self, timeout: float = CALL_TIMEOUT_S) -> int:
        """Send SIGINT, wait, and kill the process after `timeout` [s]; return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                return self.process.wait(timeout)
            except subprocess.TimeoutExpired:
                self.process.kill()
        return self.process.wait()

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self.end()


def ros_arguments(parameters: Mapping[str, object], namespace: str) -> list[str]:
    """Return the command-line arguments for parameters (as YAML) and a namespace."""
    arguments = ['--ros-args', '-r', f'__ns:={namespace}']
    for key, value in parameters.items():
        # JSON is YAML: quoted text stays text
        arguments += ['-p', f'{key}:={json.dumps(value, ensure_ascii=False, default=str)}']
    return arguments
