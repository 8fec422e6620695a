"""Keys of the teleop: which velocity they mean, and for how long."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

# key -> (linear x y z, angular x y z), in units of the speeds
MOVES = {
    'd': (1, 0, 0, 0, 0, 0),
    'a': (-1, 0, 0, 0, 0, 0),
    'w': (0, 1, 0, 0, 0, 0),
    's': (0, -1, 0, 0, 0, 0),
    'r': (0, 0, 1, 0, 0, 0),
    'f': (0, 0, -1, 0, 0, 0),
    'i': (0, 0, 0, 1, 0, 0),
    'k': (0, 0, 0, -1, 0, 0),
    'l': (0, 0, 0, 0, 1, 0),
    'j': (0, 0, 0, 0, -1, 0),
}
ARROWS = {'\x1b[C': 'd', '\x1b[D': 'a', '\x1b[A': 'r', '\x1b[B': 'f'}
LEGEND = """\
hold a key to move the tip, let go to stop
  a d   -x +x  (arrows left, right)      j l   turn about -y +y
  s w   -y +y                            k i   turn about -x +x
  f r   -z +z  (arrows down, up)         + -   faster, slower
  t     base or tip axes                 space stop (latched)   c reset   q quit
"""


@dataclass
class Deadman:
    """
    A velocity that lives only as long as its key repeats.

    Terminals do not tell when a key is let go; they repeat it while it is held. The tip stops
    `hold` seconds after the last repeat.
    """

    hold: float = 0.15  # [s]
    key: str = ''
    until: float = -1.0

    def press(self, key: str, now: float) -> None:
        """Take a key."""
        self.key, self.until = key, now + self.hold

    def velocity(self, now: float, linear: float, angular: float) -> list[float] | None:
        """Return the six components [m/s, rad/s], or None when nothing is held."""
        if now >= self.until or self.key not in MOVES:
            return None
        speeds = [linear] * 3 + [angular] * 3
        return [part * speed for part, speed in zip(MOVES[self.key], speeds, strict=True)]


@contextmanager
def keyboard() -> Iterator[None]:
    """Read single keys from the terminal; it is itself again afterwards."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def pressed(wait: float) -> list[str]:
    """Return the keys that were pressed, after at most some seconds."""
    if not select.select([sys.stdin], [], [], wait)[0]:
        return []
    text = os.read(sys.stdin.fileno(), 1024).decode(errors='ignore')
    for arrow, key in ARROWS.items():
        text = text.replace(arrow, key)
    return list(text)
