"""
The processes that tests start: none outlives its test, nor the process that runs the tests.

Every one leads a group of its own, which is killed with it, and gets SIGKILL from the kernel when
the process of the tests dies. What it starts itself in yet other groups comes back to the process
of the tests as a child (`adopt`), where conftest.py finds it.
"""

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from subprocess import DEVNULL, PIPE, STDOUT, CompletedProcess, TimeoutExpired

__all__ = ['DEVNULL', 'PIPE', 'STDOUT', 'CompletedProcess', 'Process', 'TimeoutExpired',
           'free_port', 'package', 'run', 'until']  # fmt: skip

ROOT = Path(__file__).resolve().parents[1]
SET_DEATH_SIGNAL, SET_SUBREAPER = 1, 36  # prctl
PATIENCE = 240.0  # [s] for a command; a test's own limit is longer (conftest.py)
started = []
kept = set()  # process ids of what is to stay until the tests end


class Process(subprocess.Popen):
    """A command in a group of its own."""

    def __init__(self, command, **settings):
        wrapper = [sys.executable, '-I', '-S', Path(__file__).resolve(), str(os.getpid())]
        settings = {'text': True, 'start_new_session': True} | settings
        super().__init__([*wrapper, *command], **settings)
        self.args = command
        started.append(self)

    def end(self):
        """Kill it and its group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.wait()
        for stream in (self.stdin, self.stdout, self.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):  # what was never written goes nowhere
                    stream.close()

    def __exit__(self, *_):
        self.end()


def package(*arguments):
    """Return the command that runs a command of the package."""
    return [sys.executable, '-m', 'tendon_robot_ros', *map(str, arguments)]


def run(command, timeout=PATIENCE, **settings):
    """Run a command to its end; return its code and what it printed."""
    settings = {'stdin': DEVNULL, 'stdout': PIPE, 'stderr': PIPE} | settings
    with Process(command, **settings) as process:
        out, err = process.communicate(timeout=timeout)
    return CompletedProcess(command, process.returncode, out, err)


def until(condition, what='it', seconds=30.0):
    """Wait until something holds; what takes long to ask is asked less often."""
    end = time.monotonic() + seconds
    asked = time.thread_time()
    while not condition():
        assert time.monotonic() < end, f'waited {seconds} s for {what}'
        cost, asked = time.thread_time() - asked, time.thread_time()
        time.sleep(min(max(0.002, 4.0 * cost), 0.05))


def free_port():
    """Return a port of this machine on which nobody listens."""
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        return taken.getsockname()[1]


def adopt():
    """Become the parent of what children leave behind."""
    ctypes.CDLL(None).prctl(SET_SUBREAPER, 1)


def children():
    """Return the command line of every child of this process, by process id."""
    found = {}
    for path in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError, IndexError):  # it ended meanwhile
            state, parent = path.joinpath('stat').read_text().rpartition(')')[2].split()[:2]
            if int(parent) == os.getpid() and state != 'Z' and int(path.name) not in kept:
                line = path.joinpath('cmdline').read_bytes().replace(b'\0', b' ').decode()
                if 'resource_tracker' not in line:  # Python keeps one for multiprocessing
                    found[int(path.name)] = line.strip()
    return found


def left(before, patience=5.0):
    """Return the children that are new and stay; kill them."""
    end = time.monotonic() + patience
    while (new := children().keys() - before.keys()) and time.monotonic() < end:
        time.sleep(0.05)
    lines = children()
    for pid in new:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return [lines[pid] for pid in new if pid in lines]


if __name__ == '__main__':
    ctypes.CDLL(None).prctl(SET_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != int(sys.argv[1]):  # it died before that
        sys.exit(1)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):  # which Python ignores
        signal.signal(number, signal.SIG_DFL)
    os.execvp(sys.argv[2], sys.argv[2:])
