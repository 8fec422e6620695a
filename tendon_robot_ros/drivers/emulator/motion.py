"""
Motor, gear and wires of an emulated servo: current in, turning out, with dry friction.

The gear's dry friction is what a geared servo shows: below it nothing moves, winding needs more
current than the wire's pull alone, paying out less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..dynamixel.tables import (
    CURRENT_MODE,
    CURRENT_POSITION_MODE,
    TICKS_PER_TURN,
    Model,
)

TICK = 2.0 * math.pi / TICKS_PER_TURN  # [rad]
STEP = 1e-3  # [s], longest step of the integration
_DAMPING = 0.01  # share of stall torque over no-load speed; the current loop hides the rest
_POSITION_GAIN = 40.0  # [1/s]


@dataclass
class Motion:
    """
    State of one motor.

    Parameters
    ----------
    model : Model
        Torque per ampere, friction and top speed.
    angle : float
        Of the output shaft since the servo's zero [rad].
    speed : float
        [rad/s]
    current : float
        [A], signed like the torque.

    """

    model: Model
    angle: float = 0.0
    speed: float = 0.0
    current: float = 0.0

    @property
    def friction(self) -> float:
        """Dry friction of the gear at the output [N·m]."""
        return self.model.friction_current * self.model.torque_per_ampere

    @property
    def ticks(self) -> int:
        """Position as the encoder counts it."""
        return math.floor(self.angle / TICK + 0.5)

    def limp(self, load: float, step: float) -> None:
        """Turn without power: only a load above the friction turns the gear backwards."""
        self.current = 0.0
        self._turn(0.0, load, step)

    def drive_current(self, current: float, load: float, step: float) -> None:
        """Give a current [A] against a load torque [N·m] for one step [s]."""
        self.current = current
        self._turn(current * self.model.torque_per_ampere, load, step)

    def drive_position(self, goal: float, limit: float, load: float, step: float) -> None:
        """Turn towards an angle [rad] with at most the given current [A]."""
        way = goal - self.angle
        wanted = max(
            -self.model.no_load_speed, min(self.model.no_load_speed, _POSITION_GAIN * way)
        )
        friction = math.copysign(self.friction, wanted) if abs(way) > 0.5 * TICK else 0.0
        needed = (load + friction + self._damping * wanted) / self.model.torque_per_ampere
        if abs(needed) <= limit:
            self.current, self.speed = needed, wanted
            self.angle += wanted * step
        else:
            self.drive_current(math.copysign(limit, needed), load, step)

    @property
    def _damping(self) -> float:
        return _DAMPING * self.model.stall_torque / self.model.no_load_speed

    def _turn(self, torque: float, load: float, step: float) -> None:
        net = torque - load
        if abs(net) <= self.friction:
            self.speed = 0.0
            return
        speed = (net - math.copysign(self.friction, net)) / self._damping
        top = self.model.no_load_speed
        self.speed = max(-top, min(top, speed))
        self.angle += self.speed * step


def drive(
    motion: Motion, mode: int, goals: tuple[float, float], limit: float, load: float, step: float
) -> None:
    """
    Advance a motor whose torque is on.

    Parameters
    ----------
    motion : Motion
    mode : int
        Operating mode, address 11.
    goals : tuple of float
        Goal current [A] and goal angle [rad].
    limit : float
        Current limit [A].
    load : float
        Torque of the wires against positive turning [N·m].
    step : float
        [s]

    """
    current, angle = goals
    if mode == CURRENT_MODE:
        motion.drive_current(max(-limit, min(limit, current)), load, step)
    else:
        strongest = min(limit, abs(current)) if mode == CURRENT_POSITION_MODE else limit
        motion.drive_position(angle, strongest, load, step)
