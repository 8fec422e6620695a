"""What the emulated servos pull on: wound wire in, wire tensions out."""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from .servo import STEP_S, Servo

Array = NDArray[np.float64]
APPROACH_SHARE = 0.3  # of the way to equilibrium in one period


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
            step[pulling] = APPROACH_SHARE * np.linalg.solve(part, short[pulling])
            tried = np.clip(self._tensions + step, 0.0, self.highest)
            with contextlib.suppress(TendonRobotError):
                self._pulls = self.pulls(tried)
                self._tensions = tried
        return self._tensions


# -----------------------------------------------------------------------------
# Emulated servos, spools and wires together: time passes for all of them at once.

MOMENTS_REMEMBERED_MAX = 20_000  # moments
TIME_STEP_MAX_S = 0.1  # [s]; after a longer pause of this process the emulated world skips time


@dataclass(frozen=True)
class Wire:
    """A wire on the spool of a servo: its id, the spool's radius [m], +1 or -1 winds."""

    servo: int
    radius: float
    direction: int = 1


class Rig:
    """
    Servos that wind wires of one arm.

    Attributes
    ----------
    tensions : ndarray, shape (m,) [N]
    trace : deque of (time, currents, tensions, wound)
        What was lately: `time.monotonic` [s], of the motors [A], of the wires [N] and [m].
    highest, least, most : ndarray, shape (m,)
        Since the start: highest tension [N], least and most wire wound [m].

    """

    def __init__(self, servos: list[Servo], wires: list[Wire], arm: Arm) -> None:
        """Put the parts together; the present angles are where no wire is wound."""
        self.servos = {servo.identity: servo for servo in servos}
        self.wires, self.arm = wires, arm
        self._order = list(self.servos)
        places = [self._order.index(wire.servo) for wire in wires]
        self._lever = np.zeros((len(servos), len(wires)))
        for wire, (column, place) in zip(wires, enumerate(places), strict=True):
            self._lever[place, column] = wire.direction * wire.radius
        self._zero = self._angles()
        self.tensions = np.zeros(len(wires))  # [N]
        self.highest, self.least, self.most = np.zeros((3, len(wires)))
        self.trace: deque[tuple[float, list[float], list[float], list[float]]] = deque(
            maxlen=MOMENTS_REMEMBERED_MAX
        )

    @property
    def wound(self) -> np.ndarray:
        """Wire on the spools since the start, shape (m,) [m]."""
        wound: np.ndarray = (self._angles() - self._zero) @ self._lever
        return wound

    def advance(self, passed: float) -> None:
        """Let time [s] pass."""
        passed = min(passed, TIME_STEP_MAX_S)
        for servo in self.servos.values():
            servo.protect(passed)
        steps = max(1, math.ceil(passed / STEP_S - 1e-9))
        for _ in range(steps):
            self._step(passed / steps)
        for servo in self.servos.values():
            servo.refresh()
        wound = self.wound
        self.highest = np.maximum(self.highest, self.tensions)
        self.least, self.most = np.minimum(self.least, wound), np.maximum(self.most, wound)
        currents = [servo.motion.current for servo in self.servos.values()]
        self.trace.append((time.monotonic(), currents, self.tensions.tolist(), wound.tolist()))

    def rebooted(self, identity: int) -> None:
        """Restart a servo; the spool stays where it is although the count of turns is lost."""
        place = self._order.index(identity)
        servo = self.servos[identity]
        before = servo.motion.angle
        servo.boot()
        self._zero[place] += servo.motion.angle - before

    def _angles(self) -> np.ndarray:
        return np.array([servo.motion.angle for servo in self.servos.values()])

    def _step(self, step: float) -> None:
        self.tensions = self.arm.tensions(self.wound, step)
        loads = self._lever @ self.tensions
        for servo, load in zip(self.servos.values(), loads.tolist(), strict=True):
            servo.step(step, load)
