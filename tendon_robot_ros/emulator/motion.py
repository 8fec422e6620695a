"""
Motor and gear of an emulated servo, with dry friction.

The gear's dry friction is what a geared servo shows: below it nothing moves, winding needs more
current than the wire's pull alone, paying out less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..drivers.dynamixel.control_table import (
    CURRENT_MODE,
    CURRENT_POSITION_MODE,
    TICKS_PER_TURN,
    ServoModel,
)

TICK = 2.0 * math.pi / TICKS_PER_TURN  # [rad]
STEP_S = 1e-3  # [s], longest step of the integration
_DAMPING = 0.01  # share of stall torque over no-load speed; the current loop hides the rest
_POSITION_GAIN = 40.0  # [1/s]
NEWTON_STEPS_MAX = 5


@dataclass(frozen=True)
class Load:
    """
    Torque of wires against a motor, and how it changes while the motor turns.

    Parameters
    ----------
    wires : list of (lever, pull, stiffness)
        Wire per angle [m/rad], tension [N], stiffness [N/m]; below zero a wire is slack, and
        becomes taut where pull + stiffness * lever * angle is zero.

    """

    wires: list[tuple[float, float, float]]

    def torque(self, turned: float = 0.0) -> float:
        """Return the torque [N·m] after another so many radians."""
        return sum(r * pull for (r, *_), pull in zip(self.wires, self.pulls(turned), strict=True))

    def pulls(self, turned: float) -> list[float]:
        """Return the tensions [N] after another so many radians."""
        return [max(0.0, pull + k * r * turned) for r, pull, k in self.wires]

    def stiffness(self, turned: float) -> float:
        """Return how the torque changes there [N·m/rad]."""
        return sum(r * r * k for r, pull, k in self.wires if pull + k * r * turned > 0.0)


@dataclass
class ServoMotion:
    """
    State of one motor.

    Parameters
    ----------
    model : ServoModel
        Torque per ampere, friction and top speed.
    angle : float
        Of the output shaft since the servo's zero [rad].
    speed : float
        [rad/s]
    current : float
        [A], signed like the torque.
    drag : float
        Against the speed [N·m]: viscous friction, and what keeps it from turning even faster when
        a wire turns it at its top speed.

    """

    model: ServoModel
    angle: float = 0.0
    speed: float = 0.0
    current: float = 0.0
    drag: float = 0.0

    @property
    def friction(self) -> float:
        """Dry friction of the gear at the output [N·m]."""
        return self.model.friction_current * self.model.torque_per_ampere

    @property
    def ticks(self) -> int:
        """Position as the encoder counts it."""
        return math.floor(self.angle / TICK + 0.5)

    def limp(self, load: Load, step: float) -> None:
        """Turn without power: only a load above the friction turns the gear backwards."""
        self.current = 0.0
        self._turn(0.0, load, step)

    def drive_current(self, current: float, load: Load, step: float) -> None:
        """Give a current [A] against a load for one step [s]."""
        self.current = current
        self._turn(current * self.model.torque_per_ampere, load, step)

    def drive_position(
        self,
        goal: float,
        limit: float,
        load: Load,
        step: float,
        top: float = math.inf,
        gain: float = 1.0,
    ) -> None:
        """Turn towards an angle [rad] with at most the given current [A] and speed [rad/s]."""
        way, top = goal - self.angle, min(top, self.model.no_load_speed)
        wanted = max(-top, min(top, gain * _POSITION_GAIN * way))
        friction = math.copysign(self.friction, wanted) if abs(way) > 0.5 * TICK else 0.0
        torque = load.torque(wanted * step) + friction + self._damping * wanted
        needed = torque / self.model.torque_per_ampere
        if abs(needed) <= limit:
            self.current, self.speed = needed, wanted
            self.drag = self._damping * wanted
            self.angle += wanted * step
        else:
            self.drive_current(math.copysign(limit, needed), load, step)

    @property
    def _damping(self) -> float:
        return _DAMPING * self.model.stall_torque / self.model.no_load_speed

    def _turn(self, torque: float, load: Load, step: float) -> None:
        """Turn for one step [s]: damping, friction and wires as they are at its end balance."""
        net = torque - load.torque()
        if abs(net) <= self.friction:
            self.speed = self.drag = 0.0
            return
        net -= math.copysign(self.friction, net)
        torque -= math.copysign(self.friction, net)
        turned, drag = 0.0, self._damping / step
        for _ in range(NEWTON_STEPS_MAX):  # the load is piecewise linear: one more per kink
            before = turned
            turned += net / (drag + load.stiffness(turned + math.copysign(1e-9, net)))
            net = torque - load.torque(turned) - drag * turned
            if turned == before or abs(net) < 1e-9:
                break
        top = self.model.no_load_speed
        self.speed = max(-top, min(top, turned / step))
        self.angle += self.speed * step
        self.drag = torque - load.torque(self.speed * step)


def drive(
    motion: ServoMotion,
    mode: int,
    goals: tuple[float, float],
    limit: float,
    load: Load,
    step: float,
    top: float = math.inf,
    gain: float = 1.0,
) -> None:
    """
    Advance a motor whose torque is on.

    Parameters
    ----------
    motion : ServoMotion
    mode : int
        Operating mode, address 11.
    goals : tuple of float
        Goal current [A] and goal angle [rad].
    limit : float
        Current limit [A].
    load : Load
        Of the wires against positive turning.
    step : float
        [s]
    top : float
        Fastest turning towards a goal [rad/s].
    gain : float
        Of the position, as a share of what is usual.

    """
    current, angle = goals
    if mode == CURRENT_MODE:
        motion.drive_current(max(-limit, min(limit, current)), load, step)
    else:
        strongest = min(limit, abs(current)) if mode == CURRENT_POSITION_MODE else limit
        motion.drive_position(angle, strongest, load, step, top, gain)
