"""Child processes that end with their parent (Linux), priorities, one thread for matrices."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from subprocess import Popen

PARENT = 'TENDON_ROBOT_ROS_PARENT'


class Linux(IntEnum):
    """Numbers of the kernel: manual of prctl(2) and of proc(5), include/linux/sched.h."""

    PR_SET_PDEATHSIG = 1
    PF_EXITING = 0x4


def child_environment() -> dict[str, str]:
    """Return the environment for a child that is to call `end_with_parent`."""
    return {**os.environ, 'PYTHONUNBUFFERED': '1', PARENT: str(os.getpid())}


def own_process(module: str, *arguments: str, **streams: Any) -> Popen[str]:
    """
    Start a module of this package in a process of its own, with streams of text.

    It ends with this one by `end_with_parent`; Ctrl-C reaches this one alone, which ends it.
    """
    from subprocess import Popen  # slow: a stop would wait for it

    command = [sys.executable, '-m', module, *arguments]
    return Popen(command, text=True, start_new_session=True, env=child_environment(), **streams)


def end_with_parent(parent: int = 0, by: signal.Signals = signal.SIGINT) -> None:
    """Let the kernel signal this process when its parent dies; see `child_environment`."""
    parent = parent or int(os.environ.pop(PARENT, '0'))
    if not parent or not sys.platform.startswith('linux'):
        return
    ctypes.CDLL(None).prctl(Linux.PR_SET_PDEATHSIG, by)
    if os.getppid() != parent:  # it died before that
        os.kill(os.getpid(), by)


# [s] instead of 5 ms, because a thread that talks to motors waits so long after each of its words
SWITCH_INTERVAL_S = 0.0005
# [1] nice value of what goes first, so that threads of the kernel, at -20, stay before it
FIRST_NICENESS = -15
LOAN_MAX_S = 0.05  # [s] lent at once, else a computation would keep a processor from others


class Realtime(IntEnum):
    """
    Priorities under SCHED_RR (sched(7)): a higher one has the processor first.

    All are below 50, where the kernel serves devices.
    """

    EMULATOR = 20  # the electronics of a motor wait for no program
    DRIVER = 5
    CONTROLLER = 4
    MOCK_DRIVER = 3
    COMPUTATION = 2  # lent for a while, after all that moves motors


def switch_often() -> None:
    """Let no thread's Python hold up that of another for more than a moment."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)


def go_first() -> None:
    """
    Have this thread, and all it starts, preferred to others; do nothing where it may not.

    Also the session (autogroup) where this process leads it: a nice value weighs within it only,
    and what solves beside the commands holds Python's lock at times, for which they wait while
    others have the processor. The session of a terminal stays as it is: all that a person runs
    there would go first, too. Who was started with a nice value of its own keeps it. Needs root,
    CAP_SYS_NICE or a line `nice -15` in /etc/security/limits.conf.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) == 0:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, FIRST_NICENESS)
            if os.getsid(0) == os.getpid():
                Path('/proc/self/autogroup').write_text(str(FIRST_NICENESS))


def go_realtime(
    priority: int = Realtime.DRIVER, but: Sequence[str] = (), process: int | None = None
) -> None:
    """
    Have the threads that this process, or another, has now scheduled in real time, if allowed.

    Nice values weigh within a session only (autogroups), and a busy machine is late by tens of
    milliseconds all the same. What is started later is as before, and threads of Python whose
    name is in `but`: those that compute for long. Needs root, CAP_SYS_NICE or a line `rtprio 5`
    in /etc/security/limits.conf. Who was started with a nice value of its own keeps it.
    """
    if os.getpriority(os.PRIO_PROCESS, 0) > 0 or not sys.platform.startswith('linux'):
        return
    excluded = {thread.native_id for thread in threading.enumerate() if thread.name in but}
    for thread in {int(name) for name in os.listdir(f'/proc/{process or "self"}/task')} - excluded:
        _scheduled(thread, os.SCHED_RR | os.SCHED_RESET_ON_FORK, priority)


class RealtimeLoan:
    """
    Lends real-time scheduling to a thread while it computes.

    Its priority is below that of what moves motors. The allowance runs down while it works and
    fills up as fast otherwise, so that it works in real time for half of the time at most. A
    thread that is itself in real time calls `limit` often: then a computation that never ends does
    not keep a processor from others. While the thread waits for work it keeps its priority: taken
    back at once, it would still hold Python's lock, and others would wait until it has a processor
    again.
    """

    def __init__(self) -> None:
        """Begin with all of the allowance."""
        self._lock = threading.Lock()
        self._borrower: int | None = None
        self._working = False
        self._allowance, self._counted = LOAN_MAX_S, time.monotonic()

    def begin(self, thread: int) -> None:
        """Lend to a thread (its native id) while the allowance lasts; never blocks."""
        lent = self._working and self._borrower is not None
        if lent or not self._lock.acquire(blocking=False):
            return
        self._count()
        self._working = True
        if self._borrower is None and self._allowance > 0.0:
            policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
            if _scheduled(thread, policy, Realtime.COMPUTATION):
                self._borrower = thread
        self._lock.release()

    def end(self) -> None:
        """Stop counting, because the thread is about to wait for work."""
        with self._lock:
            self._count()
            self._working = False

    def limit(self) -> None:
        """End the loan if the allowance is used up; never blocks."""
        if self._borrower is None or not self._lock.acquire(blocking=False):
            return
        self._count()
        if self._working and self._allowance <= 0.0:
            _scheduled(self._borrower, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)
            self._borrower = None
        self._lock.release()

    def _count(self) -> None:
        before, self._counted = self._counted, time.monotonic()
        passed = self._counted - before
        lent = self._working and self._borrower is not None
        self._allowance = min(self._allowance + (-passed if lent else passed), LOAN_MAX_S)


def _scheduled(thread: int, policy: int, priority: int) -> bool:
    """Set the scheduling policy of a thread; return whether that was permitted."""
    try:
        os.sched_setscheduler(thread, policy, os.sched_param(priority))
    except OSError:  # not allowed, or ended meanwhile
        return False
    return True


def in_realtime() -> bool:
    """Return whether this thread is scheduled in real time."""
    if not sys.platform.startswith('linux'):
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_RR, os.SCHED_FIFO)


def go_with_others() -> None:
    """Reset the priority inherited from a parent with a raised one."""
    if os.getpriority(os.PRIO_PROCESS, 0) < 0:
        os.setpriority(os.PRIO_PROCESS, 0, 0)


# Ctrl-C, kill, and a terminal that is closed or whose connection breaks
ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def ending_signals() -> list[signal.Signals]:
    """Return the signals that terminate this process; `nohup` removes the last one."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [one for one in ENDING_SIGNALS if one != signal.SIGHUP or not ignored]


@contextmanager
def handled_by(
    handle: Callable[[int], object], signals: Sequence[signal.Signals]
) -> Iterator[None]:
    """Have a function called with the number of every one of some signals that comes."""
    before = {one: signal.signal(one, lambda number, _: handle(number)) for one in signals}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


@contextmanager
def ends_between() -> Iterator[Callable[[], None]]:
    """
    Have what asks this process to end wait for a good moment: what moves motors ends safe.

    Yields
    ------
    callable
        Raises KeyboardInterrupt when a signal has come; so does the end of the block.

    """
    came: list[int] = []

    def check() -> None:
        if came:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # others hear no signals
        yield check
        return
    with handled_by(came.append, ending_signals()):
        yield check
    check()


def print_without_waiting() -> None:
    """
    Have what this process prints dropped where a terminal or a pipe takes no more of it.

    A line of the log holds Python's lock until it is written: a terminal that somebody has stopped
    (Ctrl-S), or whose connection hangs, would stop every thread. Only this process's own
    description of the file changes: others go on waiting for it.
    """
    for number in (1, 2):
        with contextlib.suppress(OSError):  # a socket, a terminal of another user
            kind = os.fstat(number).st_mode
            if stat.S_ISFIFO(kind) or stat.S_ISCHR(kind):
                flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY
                own = os.open(f'/proc/self/fd/{number}', flags)
                os.dup2(own, number)
                os.close(own)


@contextmanager
def one_thread() -> Iterator[None]:
    """
    Keep the linear algebra of numpy and scipy to one thread, also where they came first.

    Who imports numpy before this package has as many threads as cores, and a diagnosis takes
    ten times as long. Works as a decorator as well.
    """
    with threadpool_limits(limits=1, user_api='blas'):
        yield


# [s] of long work between two saves, two lines of a log, and two looks for new workers, because a
# lost computer then costs no more than this
UPKEEP_S = 5.0
EXIT_TIMEOUT_S = 4.0  # [s] to end by itself, because launch kills after five


class ComputingThread(threading.Thread):
    """
    Runs compiled code beside the rest; the end of the process asks it to end and waits for it.

    A daemon would go on while the interpreter takes its memory away, which ends in a crash.
    """

    def __init__(
        self, target: Callable[[], object], name: str, end: Callable[[], object] = lambda: None
    ) -> None:
        """Take what runs, and what asks it to end."""
        super().__init__(target=target, name=name, daemon=True)
        self.end = end


@atexit.register
def _wait_for_compiled_code() -> None:
    threads = [one for one in threading.enumerate() if isinstance(one, ComputingThread)]
    for thread in threads:
        thread.end()
    until = time.monotonic() + EXIT_TIMEOUT_S
    for thread in threads:
        thread.join(max(0.0, until - time.monotonic()))
