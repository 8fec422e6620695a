"""
After a release of the driver nothing moves until somebody asks for it anew.

The driver follows no commands until it is told to resume. The controller tells it when a new
target, trajectory or twist has come, and until then holds what is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .checks import Refusal
from .state import Target

if TYPE_CHECKING:
    from .modes import Twist
    from .trajectory import Trajectory

GO_ON = 'send another target or call reset'


@dataclass
class Release:
    """What the driver says of releases, and what waits for it to follow again."""

    why: str = ''  # it let go of the arm; '' while it follows
    count: int | None = None  # how often it has, None before it was heard
    over: int | None = None  # the count of the last one after which it followed again
    dropped: Target | None = None  # what was asked for when the target was taken back
    waiting: Callable[[], None] | None = None  # what was asked for since
    stamp: str = ''  # of that
    twisted: float = -np.inf  # [s] when a twist last was more than zero

    def heard(self, why: str, count: int) -> tuple[bool, bool]:
        """Return whether there was another release, and whether the last one is over."""
        new, over = count != self.count, bool(self.why) and not why
        first = self.count is None
        if new:
            self.count, self.why = count, why
        return new and not first, over and not new

    def wait(self, ask: Callable[[], None], asked: Target | Trajectory) -> bool:
        """
        Keep what was asked for until the driver follows; False: it does.

        Raises
        ------
        Refusal
            A sender repeats what it said before, stamp and all: that is no new target.

        """
        if not self.why:
            return False
        if isinstance(asked, Target) and self.dropped and _same(asked, self.dropped):
            raise Refusal('released', f'the same target as before the release; {GO_ON}')
        self.waiting, self.stamp = ask, asked.stamp
        return True

    def twist(self, now: float, twist: Twist, timeout: float) -> bool:
        """Take a twist; False: of a released arm, which the next one moves if it was let go of."""
        goes_on, self.twisted = now - self.twisted <= timeout, now if twist.moves else -np.inf
        if self.why and twist.moves and not goes_on:
            self.waiting, self.stamp = _nothing, ''
        return not self.why


def _nothing() -> None:
    """Ask for nothing but that the driver follows: a twist is repeated."""


def _same(target: Target, other: Target) -> bool:
    pairs = zip(vars(target).values(), vars(other).values(), strict=True)
    return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs)
