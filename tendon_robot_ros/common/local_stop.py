"""
A stop on the same computer, past the middleware.

Discovery of DDS takes 0.1 to 3 s, longer on a busy machine. A process of the same computer is
reached at once by a socket whose name is the kernel's (unix(7), abstract): it needs no file, and
is gone with its process. Who does not run Linux, or runs in another network namespace, is found
by the middleware alone.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from .words import NAME_LENGTH_MAX

SOCKETS = Path('/proc/net/unix')
NAME = re.compile(
    r'@tendon_robot_ros\.stop\.(?P<domain>\d+)\.\d+\.\d+\.(?P<kind>driver|controller)(?P<node>/.*)'
)
STOP, STOPPED = b'stop\n', b'stopped\n'
# [s] without a word after which another process counts as gone: who connects and says nothing
# would else keep out all others, and a busy machine is silent for tenths of a second
SILENCE_S = 1.0
_number = itertools.count()


class Stoppable(NamedTuple):
    """Who can be stopped so: a node with its namespace, and whether it drives motors."""

    node: str
    drives: bool


class StopListener:
    """
    Offers a stop to other processes of this computer, in a thread that does nothing else.

    Parameters
    ----------
    domain : int
        ROS_DOMAIN_ID: who stops looks for its own alone.
    who : Stoppable
    stop : callable
        Called in that thread; the stop must hold when it returns.

    """

    def __init__(self, domain: int, who: Stoppable, stop: Callable[[], object]) -> None:
        """Begin to listen."""
        self._stop = stop
        self._socket: socket.socket | None = None
        kind, node = 'driver' if who.drives else 'controller', who.node[:NAME_LENGTH_MAX]
        own = f'{domain}.{os.getpid()}.{next(_number)}'
        with contextlib.suppress(OSError):  # no Linux
            listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listening.bind(f'\0tendon_robot_ros.stop.{own}.{kind}{node}')
            listening.listen()
            self._socket = listening
            self._thread = threading.Thread(target=self._listen, name='local stop', daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Listen no more."""
        if self._socket is not None:
            self._socket.shutdown(socket.SHUT_RDWR)
            self._thread.join()
            self._socket.close()
            self._socket = None

    def _listen(self) -> None:
        assert self._socket is not None
        while True:
            try:
                person, _ = self._socket.accept()
            except OSError:  # closed
                return
            with contextlib.suppress(OSError), person:
                person.settimeout(SILENCE_S)
                if person.recv(len(STOP)) == STOP:
                    self._stop()
                    person.sendall(STOPPED)


def stop_local(domain: int, below: str, timeout: float) -> dict[Stoppable, bool]:
    """
    Stop all of a domain on this computer.

    Parameters
    ----------
    domain : int
        ROS_DOMAIN_ID.
    below : str
        Namespace: only nodes in it and below it; '/' for all.
    timeout : float
        For all answers [s].

    Returns
    -------
    dict
        For each, whether it has said that it is stopped.

    """
    end, below = time.monotonic() + timeout, below.rstrip('/') + '/'
    requests: list[tuple[Stoppable, socket.socket]] = []
    for name in _listening():
        if int(name['domain']) != domain or not name['node'].startswith(below):
            continue
        person = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        who = Stoppable(name['node'], name['kind'] == 'driver')
        try:
            person.settimeout(timeout)
            person.connect('\0' + name[0][1:])
            person.sendall(STOP)
        except OSError:  # it has ended meanwhile
            person.close()
        else:
            requests.append((who, person))
    confirmed = {}
    for who, person in requests:
        with contextlib.suppress(OSError), person:
            person.settimeout(max(end - time.monotonic(), 1e-3))
            confirmed[who] = False
            confirmed[who] = person.recv(len(STOPPED)) == STOPPED
    return confirmed


def _listening() -> list[re.Match[str]]:
    """Return the names of all listeners of this computer, each once, in their order."""
    try:
        lines = SOCKETS.read_text().splitlines()
    except OSError:
        return []
    matches = {name[0]: name for line in lines if (name := NAME.search(line)) is not None}
    return [matches[text] for text in sorted(matches)]
