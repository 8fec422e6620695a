"""Emulated servos, spools and wires together: time passes for all of them at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .arm import Arm
from .motion import STEP
from .servo import Servo

LONGEST = 0.1  # [s]; after a longer pause of this process the emulated world skips time


@dataclass(frozen=True)
class Wire:
    """A wire on the spool of a servo: its id, the spool's radius [m], +1 or -1 winds."""

    servo: int
    radius: float
    direction: int = 1


class Rig:
    """Servos that wind wires of one arm."""

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

    def advance(self, passed: float) -> None:
        """Let time [s] pass."""
        passed = min(passed, LONGEST)
        for servo in self.servos.values():
            servo.protect(passed)
        steps = max(1, math.ceil(passed / STEP - 1e-9))
        for _ in range(steps):
            self._step(passed / steps)
        for servo in self.servos.values():
            servo.refresh()

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
        wound = (self._angles() - self._zero) @ self._lever
        self.tensions = self.arm.tensions(wound, step)
        loads = self._lever @ self.tensions
        for servo, load in zip(self.servos.values(), loads.tolist(), strict=True):
            servo.step(step, load)
