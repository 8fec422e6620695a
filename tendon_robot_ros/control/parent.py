"""Child processes that end with the process that started them, however it ends (Linux)."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PARENT = 'TENDON_ROBOT_ROS_PARENT'
PR_SET_PDEATHSIG = 1


def child_environment() -> dict[str, str]:
    """Return the environment for a child that is to call `end_with_parent`."""
    return {**os.environ, 'PYTHONUNBUFFERED': '1', PARENT: str(os.getpid())}


def end_with_parent() -> None:
    """Have the kernel send SIGINT to this process when its parent dies, if it was told so."""
    parent = os.environ.pop(PARENT, '')
    if not parent or not sys.platform.startswith('linux'):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    if os.getppid() != int(parent):  # it died before that
        os.kill(os.getpid(), signal.SIGINT)
