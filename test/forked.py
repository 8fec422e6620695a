"""
Commands of the package, forked from a process that has loaded what they need.

A node needs most of a second of processor time to import its modules and to read the compiled
model, and the tests start two hundred. One server in every process of tests loads all that once.
What it forks has arguments, environment, folder and files of its own, is a child of the process of
the tests (see `processes.adopt`), dies with it, and ends as `python -m tendon_robot_ros` does, but
leaves its memory to the kernel. That commands start and end as a person types them, the tests of
live and demo and the pages show.
"""

import atexit
import contextlib
import ctypes
import gc
import importlib
import importlib.util
import inspect
import io
import json
import os
import signal
import socket
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path

import processes
from processes import DEVNULL, ROOT, SET_DEATH_SIGNAL, Process

LONGEST = 100_000  # bytes of arguments and environment
WANTED = 'control', 'diagnosis', 'monitoring', 'simulation.plant'
MESSAGES = (
    'builtin_interfaces.msg', 'diagnostic_msgs.msg', 'geometry_msgs.msg', 'lifecycle_msgs.msg',
    'lifecycle_msgs.srv', 'rcl_interfaces.msg', 'rcl_interfaces.srv', 'sensor_msgs.msg',
    'std_msgs.msg', 'std_srvs.srv', 'trajectory_msgs.msg', 'visualization_msgs.msg',
)  # fmt: skip
ROBOT = ROOT / 'config' / 'robots' / 'kato_10_1.yaml'


class Forked(Process):
    """
    A command of the package: `Forked(['driver', '--ros-args', ...])`; else as a `Process`.

    `Forked(['-c', text])` runs lines of Python.
    """

    server = connection = None

    def __init__(self, arguments, **settings):
        settings = {'text': True} | settings
        super(Process, self).__init__([str(argument) for argument in arguments], **settings)
        processes.started.append(self)

    def _execute_child(
        self, arguments, executable, before, close, kept, folder, environment, *more
    ):
        """Have the server fork, where `subprocess` would; what it makes of pipes stays."""
        pipes = more[3:9]  # ends of the child and of this process: input, output, errors
        given = [
            number if file == -1 else file
            for number, file in enumerate((pipes[0], pipes[3], pipes[5]))
        ]
        asked = {
            'arguments': arguments,
            'folder': str(folder or Path.cwd()),
            'environment': dict(os.environ if environment is None else environment),
        }
        self.pid = _ask(json.dumps(asked).encode(), given)
        self._child_created = True
        self._close_pipe_fds(*pipes)


def _ask(message, files):
    if Forked.server is None or Forked.server.poll() is not None:
        Forked.server, Forked.connection = _start()
    socket.send_fds(Forked.connection, [message], files)
    answer = Forked.connection.recv(100)
    assert answer, 'the server of forked commands has ended'
    return int(answer)


def _start():
    """Start the server; return it and the connection to it."""
    processes.adopt()
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, __file__, str(there.fileno()), str(os.getpid())]
    one_thread = {**os.environ, 'OPENBLAS_NUM_THREADS': '1', 'MKL_NUM_THREADS': '1'}
    server = Process(
        command,
        stdin=DEVNULL,
        stdout=DEVNULL,
        pass_fds=[there.fileno()],
        cwd=ROOT,
        env=one_thread,
    )
    processes.started.remove(server)  # it ends with this process, not with the test
    processes.kept.add(server.pid)
    there.close()
    return server, here


# -----------------------------------------------------------------------------
# The server.


def load():
    """
    Import what commands import, and read the compiled model.

    rclpy's tracing (LTTng) has two threads, which wait for a daemon and hold no lock: what is
    forked does without them. There must be no other.
    """
    from tendon_robot_ros.control.loading import load as load_model
    from tendon_robot_ros.effects import load_catalogue
    from tendon_robot_ros.robot import load_robot

    ros = importlib.util.find_spec('rclpy') is not None
    for name in WANTED:
        importlib.import_module(f'tendon_robot_ros.{name}')
    for command in importlib.import_module('tendon_robot_ros.cli.main').COMMANDS.values():
        if ros or '.ros.' not in command:
            importlib.import_module(command.partition(':')[0])
    importlib.import_module('matplotlib.figure')
    load_model(load_robot(ROBOT), load_catalogue())
    threads = 1
    if ros:
        importlib.import_module('rclpy.lifecycle')
        for name in MESSAGES:
            for kind in vars(importlib.import_module(name)).values():
                if hasattr(type(kind), '__import_type_support__'):
                    type(kind).__import_type_support__()
        importlib.import_module('rosidl_generator_py')
        threads += 2
    # rclpy looks for the caller of its first log message in the files of all modules
    inspect.getmodule(inspect.currentframe())
    gc.collect()
    gc.freeze()
    assert len(os.listdir('/proc/self/task')) <= threads, 'a fork takes no threads along'
    warnings.filterwarnings('ignore', '.*multi-threaded, use of fork', DeprecationWarning)


def serve(connection, tests):
    """Fork at every request; return it in the child, None when there are no more."""
    while True:
        message, files, *_ = socket.recv_fds(connection, LONGEST, 3)
        if not message:
            return None
        between = os.fork()
        if not between:
            if os.fork():
                os._exit(0)  # the process of the tests becomes the parent
            os.setsid()
            while os.getppid() != tests:
                time.sleep(0.001)
            connection.send(str(os.getpid()).encode())
            connection.close()
            return json.loads(message), files
        for file in files:
            os.close(file)
        os.waitpid(between, 0)


def become(asked, files, tests):
    """Take arguments, environment, folder and files as a process that is started anew."""
    ctypes.CDLL(None).prctl(SET_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != tests:
        os._exit(1)
    for number, file in enumerate(files):
        os.dup2(file, number)
    for file in files:
        os.close(file)
    os.environ.clear()
    os.environ.update(asked['environment'])
    os.chdir(asked['folder'])
    tempfile.tempdir = None
    # nodes collect what they loaded before they begin: here that is what all of them share, and
    # each would copy it, which is most of what its start would cost
    gc.unfreeze = lambda: None
    sys.argv = ['tendon_robot_ros', *asked['arguments']]
    size = 0 if os.environ.get('PYTHONUNBUFFERED') else -1
    own = [os.fdopen(0, 'rb', closefd=False), os.fdopen(1, 'wb', size, closefd=False)]
    sys.stdin = io.TextIOWrapper(own[0])
    sys.stdout = io.TextIOWrapper(own[1], write_through=not size)
    sys.stderr = io.TextIOWrapper(os.fdopen(2, 'wb', 0, closefd=False), write_through=True)


def run(arguments):
    """Run a command, or lines of Python; return the exit code."""
    if arguments[0] == '-c':
        exec(compile(arguments[1], '<string>', 'exec'), {'__name__': '__main__'})
        return 0
    from tendon_robot_ros.cli.main import main as command_line

    return command_line()


def end(code):
    """End as the interpreter does, but free no memory: all that is loaded would be copied."""
    threading._shutdown()  # waits for threads
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def main():
    """Serve the process of the tests; the exit code is that of the command in what was forked."""
    connection, tests = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])
    sys.path.insert(0, str(ROOT))  # what is forked may start workers that look for this file's
    load()
    asked = serve(connection, tests)
    if asked is None:
        return 0
    become(*asked, tests)
    try:
        code = run(asked[0]['arguments'])
    except SystemExit as ending:
        code = ending.code
    if isinstance(code, int | None):
        with contextlib.suppress(OSError):  # a pipe that is closed: Python knows what to say
            end(code or 0)
    return code


if __name__ == '__main__':
    sys.exit(main())
