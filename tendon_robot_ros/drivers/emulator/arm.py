"""What the emulated servos pull on: wound wire in, wire tensions out."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...exceptions import TendonRobotError

Array = NDArray[np.float64]
PART = 0.3  # of the way to equilibrium in one period


class Arm(Protocol):
    """Something with wires."""

    def tensions(self, wound: Array, passed: float) -> Array:
        """Return the tensions [N] for the wound wire, both shape (m,) [m], after `passed` s."""
        ...


class SpringArm:
    """Independent linear springs: the simplest arm that has slack and tension."""

    def __init__(self, stiffness: Array, slack: Array | None = None) -> None:
        """Take stiffness [N/m] and slack [m] per wire, shape (m,)."""
        self.stiffness = np.asarray(stiffness, dtype=float)
        self.slack = np.zeros_like(self.stiffness) if slack is None else np.asarray(slack)

    def tensions(self, wound: Array, passed: float) -> Array:
        """Return stiffness times what is wound beyond the slack."""
        return self.stiffness * np.maximum(0.0, wound - self.slack)


class HangingWeights:
    """A weight on every wire, for a calibration: constant tension once it is off the ground."""

    def __init__(self, masses: Array, gravity: float = 9.80665, stiffness: float = 2e4) -> None:
        """Take the masses [kg], shape (m,), gravity [m/s²] and the wire's stiffness [N/m]."""
        self.weights = np.asarray(masses, dtype=float) * gravity
        self.stiffness = stiffness

        self.gravity = gravity

    def hang(self, wire: int, mass: float) -> None:
        """Hang another weight [kg] on a wire."""
        self.weights[wire] = mass * self.gravity

    def tensions(self, wound: Array, passed: float) -> Array:
        """Return the weight, or less while the wire only begins to lift it."""
        return np.clip(self.stiffness * wound, 0.0, self.weights)


class RelaxedArm:
    """
    An arm known by tensions -> pulls, turned round: tensions relax until the pulls fit.

    The wires stretch a little: wound = slack + pull of the arm + tension / wire stiffness. A full
    solve per step would be slow; one call per period, with the compliance of the straight arm,
    is quick and settles on the same equilibrium.
    """

    def __init__(
        self,
        pulls: Callable[[Array], Array],
        inputs: int,
        highest: float,
        slack: float = 0.0,
        period: float = 0.004,
        shown: Mapping[str, Any] | None = None,
        stretch: float = 1e-3,
    ) -> None:
        """
        Take the arm.

        Parameters
        ----------
        pulls : callable
            Tensions, shape (m,) [N], to wire pulls, shape (m,) [m]; may raise for tensions that
            the arm cannot bear, which are then not taken.
        inputs : int
            Number of wires m.
        highest : float
            Largest tension [N] the arm is asked for.
        slack : float
            Loose wire at the start [m].
        period : float
            Shortest time between two calls of `pulls` [s].
        shown : mapping, optional
            More to tell of the arm, such as its tip; `pulls` keeps it up to date.
        stretch : float
            How far the largest tension stretches a wire [m].

        """
        self.shown = {} if shown is None else shown
        self.pulls, self.highest, self.slack, self.period = pulls, highest, slack, period
        self._tensions = np.zeros(inputs)
        self._pulls = pulls(self._tensions)
        self._stretch = stretch / highest  # [m/N]
        probe = 0.1 * highest
        columns = [pulls(probe * row) - self._pulls for row in np.eye(inputs)]
        self._compliance = np.array(columns).T / probe + self._stretch * np.eye(inputs)
        self._since = 0.0

    def tensions(self, wound: Array, passed: float) -> Array:
        """Return the present tensions [N]; every period they come nearer to equilibrium."""
        self._since += passed
        if self._since >= self.period:
            self._since = 0.0
            short = wound - self.slack - self._pulls - self._stretch * self._tensions
            pulling = (self._tensions > 0.0) | (short > 0.0)  # the others stay slack
            step = np.zeros_like(short)
            part = self._compliance[np.ix_(pulling, pulling)]
            step[pulling] = PART * np.linalg.solve(part, short[pulling])
            tried = np.clip(self._tensions + step, 0.0, self.highest)
            with contextlib.suppress(TendonRobotError):
                self._pulls = self.pulls(tried)
                self._tensions = tried
        return self._tensions
