"""
A process that has loaded everything, and forks a node from itself at every line of its input.

Its argument is the robot whose model the nodes need.

A line is JSON: `{"start": NAME, "arguments": [...], "log": FILE}` is answered with the process id,
`{"code": PID}` with its exit code, or null while it runs. When the input ends, so do the nodes.
"""

import contextlib
import json
import os
import signal
import sys

from tendon_robot_ros.common.processes import child_environment
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.controller import node as controller
from tendon_robot_ros.ros.driver import node as driver

NODES = {'driver': driver.main, 'controller': controller.main}


def fork(name, arguments, log):
    """Fork a node; return its process id."""
    process = os.fork()
    if process:
        return process
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for file in (1, 2):
        os.dup2(out, file)
    os.close(0)
    os.setsid()
    code = 1
    try:
        code = NODES[name](arguments)
    finally:
        os._exit(code)


def exit_code(process):
    """Return the exit code of a node, negative for a signal; None while it runs."""
    ended, status = os.waitpid(process, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if ended else None


def main():
    model = Model(load_robot(sys.argv[1]))
    model.shape([0.5] * len(model.inputs))  # compiled, or read from the cache
    running = set()
    os.environ.update(child_environment())  # nodes end when this process does
    print('ready', flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        if 'start' in asked:
            answer = fork(asked['start'], asked['arguments'], asked['log'])
            running.add(answer)
        else:
            answer = exit_code(asked['code'])
            if answer is not None:
                running.discard(asked['code'])
        print(json.dumps(answer), flush=True)
    for process in running:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)


if __name__ == '__main__':
    main()
