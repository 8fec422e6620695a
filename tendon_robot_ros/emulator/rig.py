"""Arms that emulated motors pull on; servos, spools and wires, advanced together in time."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..common.arrays import Floats
from ..common.errors import TendonRobotError
from ..common.estimation import ITERATIONS_MAX
from ..common.words import STANDARD_GRAVITY
from ..drivers.dynamixel.control_table import REGISTERS
from ..drivers.interface import CYCLE_S
from ..robot.estimates import SAME_TENSION_N
from .servo import STEP_S, Load, Servo

# [N] of change in which an arm keeps its compliance: a probe for every wire costs as many calls of
# the model, so that one at every step would be slower than the time that it emulates
LINEAR_N = 0.2
SOFTER_MIN = 0.01  # [1] of the largest compliance: first addition, so that doubling ends soon
TRACE_MAX = 20_000  # [entries] so that more than 40 s are kept (benchmarks ask for so much)


class SpringArm:
    """
    Independent linear springs: the simplest arm that has slack and tension.

    Every emulated arm has the two methods of this one. `tensions` returns the tensions [N] for the
    wound wire, both shape (m,) [m], after `passed` s. `resistance` returns what a wire pulls now
    [N], and its stiffness if wound on alone [N/m]; of a slack wire the pull is negative: it rises
    through zero where the wire becomes taut.
    """

    def __init__(self, stiffness: Floats, slack: Floats | None = None) -> None:
        """Take stiffness [N/m] and slack [m] per wire, shape (m,)."""
        self.stiffness: Floats = np.asarray(stiffness, dtype=float)
        self.slack = np.zeros_like(self.stiffness) if slack is None else np.asarray(slack)
        self.weights = np.full_like(self.stiffness, np.inf)  # [N] that a spring pulls at most
        self._pull: Floats = -self.stiffness * self.slack

    def tensions(self, wound: Floats, passed: float) -> Floats:
        """Return stiffness times what is wound beyond the slack, or the weight."""
        self._pull = np.minimum(self.stiffness * (wound - self.slack), self.weights)
        return np.maximum(0.0, self._pull)

    def resistance(self, wire: int) -> tuple[float, float]:
        """Return the pull, negative while slack; a weight pulls the same wherever it hangs."""
        pull = float(self._pull[wire])
        return pull, 0.0 if pull >= self.weights[wire] else float(self.stiffness[wire])


class HangingWeights(SpringArm):
    """A weight on every wire, for a calibration: constant tension once it is off the ground."""

    def __init__(self, masses: Floats, stiffness: float = 2e4) -> None:
        """Take the masses [kg], shape (m,), and the stiffness of the wires [N/m]."""
        super().__init__(np.full(len(masses), stiffness))
        self.weights = STANDARD_GRAVITY * np.asarray(masses, dtype=float)

    def hang(self, wire: int, mass: float) -> None:
        """Hang another weight [kg] on a wire."""
        self.weights[wire] = STANDARD_GRAVITY * mass


class ElasticArm:
    """
    The inverse of an arm that is known by tensions -> pulls: tensions that hold so much wire.

    The wires stretch a little: wound = slack + pulls(tensions) + stretch * tension, a slack wire
    has less wound than that. Between two calls of `pulls` the arm is linear about the last one,
    with a compliance that is measured anew where the tensions have changed. With friction it is
    far from symmetric; where it is so skew that the linear arm would hold some wire by no
    tensions, or by several, it counts as softer.

    An arm gives way where it bends, and hardly at all where its wires pull against each other:
    there the fraction of a millimetre by which a bend is not linear is worth newtons. A new call
    of `pulls` therefore changes no tension at once: where it differs from the linear arm is wire
    that the arm still takes up or gives, with a time constant.
    """

    def __init__(
        self,
        pulls: Callable[[Floats], Floats],
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
            the arm cannot bear: it is then as linear as it was before.
        inputs : int
            Number of wires m.
        highest : float
            Largest tension [N].
        slack : float
            Loose wire at the start [m].
        period : float
            Shortest time between two calls of `pulls` [s].
        shown : mapping, optional
            Further values to report, such as the tip; `pulls` updates them.
        stretch : float
            How far the largest tension stretches a wire [m].

        """
        self.shown = {} if shown is None else shown
        self.pulls, self.highest, self.slack, self.period = pulls, highest, slack, period
        self._point = np.zeros(inputs)  # (m,) [N] tensions about which the arm is linear ...
        self._pulls = pulls(self._point)  # (m,) [m] ... and its pulls there
        self._stretch = stretch / highest  # [m/N]
        self._taut = np.zeros(inputs, dtype=bool)
        self._since = 0.0
        self._coming = np.zeros(inputs)  # (m,) [m] of wire that the arm is still to take up
        self._probe()
        self._linearise()

    def tensions(self, wound: Floats, passed: float) -> Floats:
        """Return the present tensions [N]; once a period `pulls` of the arm is called."""
        self._since += passed
        self._coming *= math.exp(-passed / CYCLE_S)  # else the arm would jump
        tensions = np.minimum(self._held(wound), self.highest)
        if self._since >= self.period:
            self._since = 0.0
            if np.abs(tensions - self._point).max() >= SAME_TENSION_N:
                self._evaluate(tensions, wound)
                tensions = np.minimum(self._held(wound), self.highest)
        return tensions

    def resistance(self, wire: int) -> tuple[float, float]:
        """Return the pull, negative while slack, and the stiffness while others are held."""
        stiffness = self._stiffness[wire]
        value = self._values[wire]
        return (value if self._taut[wire] else -stiffness * value), stiffness

    def _evaluate(self, tensions: Floats, wound: Floats) -> None:
        """Make the arm linear about tensions (m,) [N], with so much wire (m,) [m] wound."""
        with contextlib.suppress(TendonRobotError):
            self._point, self._pulls = tensions, self.pulls(tensions)
            if np.abs(tensions - self._probed).max() > LINEAR_N:
                self._probe()
            self._linearise()
            self._coming = self.slack + self._pulls + self._stretch * self._point - wound
            slack = tensions <= 0.0
            self._coming[slack] = np.minimum(0.0, self._coming[slack])

    def _probe(self) -> None:
        """Measure the compliance (m, m) [m/N] of arm and wires here, by differences."""
        step = 0.1 * LINEAR_N  # [N]
        probes = self._point + step * np.eye(len(self._point))
        rows = (np.array([self.pulls(probe) for probe in probes]) - self._pulls) / step
        self.pulls(self._point)
        self._compliance = rows.T + (self._stretch + softer(rows.T)) * np.eye(len(rows))
        self._probed = self._point

    def _linearise(self) -> None:
        """Set the offset of wound = offset + compliance @ tensions."""
        self._offset = self.slack + self._pulls + self._stretch * self._point
        self._offset -= self._compliance @ self._point
        self._pivot()

    def _held(self, wound: Floats) -> Floats:
        """Return tensions (m,) >= 0 [N] that hold so much wire; Murty's least-index method."""
        beyond = wound + self._coming - self._offset
        values = self._map @ beyond
        for _ in range(2 ** len(values)):
            wrong = np.flatnonzero(values < -1e-12)
            if not wrong.size:
                break
            self._taut[wrong[0]] ^= True
            self._pivot()
            values = self._map @ beyond
        self._values: list[float] = values.tolist()
        return np.where(self._taut, values, 0.0)

    def _pivot(self) -> None:
        """Map wire beyond the offset [m] to tensions [N] of taut wires, slack [m] of others."""
        taut, loose = np.flatnonzero(self._taut), np.flatnonzero(~self._taut)
        inverse = np.linalg.inv(self._compliance[np.ix_(taut, taut)])
        follows = self._compliance[np.ix_(loose, taut)] @ inverse
        self._map = np.zeros_like(self._compliance)
        self._map[np.ix_(taut, taut)] = inverse
        self._map[np.ix_(loose, taut)] = follows
        self._map[loose, loose] = -1.0
        alone = np.diag(self._compliance).copy()
        alone[loose] -= np.sum(follows * self._compliance[np.ix_(taut, loose)].T, axis=1)
        alone[taut] = 1.0 / np.diag(inverse)
        self._stiffness: list[float] = (1.0 / alone).tolist()


Arm = SpringArm | ElasticArm  # what motors may wind


def softer(compliance: Floats) -> float:
    """
    Return the addition to the diagonal of a compliance [m/N] for which tensions are unique.

    They are where no principal minor is negative (a P-matrix, with the stretch of the wires).

    Parameters
    ----------
    compliance : ndarray, shape (m, m) [m/N]

    """
    wires = range(len(compliance))
    chosen = [np.array(list(itertools.combinations(wires, k + 1))) for k in wires]
    size, added = float(np.abs(np.diag(compliance)).max()), 0.0
    while size > 0.0:
        scaled = compliance / size + added * np.eye(len(compliance))
        minors = [np.linalg.det(scaled[some[:, :, None], some[:, None, :]]) for some in chosen]
        # wires that pull against each other have minors of zero, but for rounding
        if min(minor.min() for minor in minors) > -math.sqrt(np.finfo(float).eps):
            break
        added = max(2.0 * added, SOFTER_MIN)
    return added * size


class Wire(NamedTuple):
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
        Recent history: `time.monotonic` [s], of the motors [A], of the wires [N] and [m].
    highest, held, least, most : ndarray, shape (m,)
        Since the start: highest tension [N], and highest of what current and dry friction of the
        motor held of it [N], without the drag of a motor that the wire turns; least and most wire
        wound [m].

    """

    def __init__(self, servos: list[Servo], wires: list[Wire], arm: Arm) -> None:
        """Put the parts together; the present angles are where no wire is wound."""
        self.servos = {servo.identity: servo for servo in servos}
        self.wires, self.arm = wires, arm
        self._order = list(self.servos)
        self._lever = np.zeros((len(servos), len(wires)))
        for column, wire in enumerate(wires):
            self._lever[self._order.index(wire.servo), column] = wire.direction * wire.radius
        self._per_lever = np.zeros_like(self._lever)
        np.divide(1.0, self._lever, out=self._per_lever, where=self._lever != 0.0)
        self._of = [np.flatnonzero(lever).tolist() for lever in self._lever]
        self._zero = self._angles()
        self.tensions = np.zeros(len(wires))  # [N]
        self.highest, self.held, self.least, self.most = np.zeros((4, len(wires)))
        self.trace: deque[tuple[float, list[float], list[float], list[float]]] = deque(
            maxlen=TRACE_MAX
        )

    @property
    def wound(self) -> np.ndarray:
        """Wire on the spools since the start, shape (m,) [m]."""
        return np.asarray((self._angles() - self._zero) @ self._lever)

    def advance(self, passed: float) -> None:
        """Let time [s] pass."""
        for servo in self.servos.values():  # no watchdog takes such a pause for silence
            servo.protect(min(passed, REGISTERS['bus_watchdog'].unit))
        steps = max(1, math.ceil(passed / STEP_S - 1e-9))
        for _ in range(steps):
            self.turn(passed / steps)
            self.highest = np.maximum(self.highest, self.tensions)
            # less what the drag of motors that pay out adds
            drag = np.array([servo.motion.drag for servo in self.servos.values()])
            held = self.tensions - np.maximum(0.0, -drag @ self._per_lever)
            self.held = np.maximum(self.held, held)
        for servo in self.servos.values():
            servo.refresh()
        wound = self.wound
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

    def turn(self, step: float) -> None:
        """
        Let all motors turn for a step [s], until each balances what the wires pull at its end.

        A Gauss-Seidel iteration: each motor turns from the start of the step against the wires as
        the others leave them, until the pulls are those that it turned against. After a single
        iteration the wire of a motor that gives way could pull more than any motor holds. Where
        wires share a load an iteration reduces the imbalance only a little, so the first one
        starts from the angles that all motors would have at their present speeds.
        """
        begin = self._angles().tolist()
        self.tensions = self.arm.tensions(self.wound, step)
        speeds = [servo.motion.speed for servo in self.servos.values()]
        if any(speeds):
            for servo, speed in zip(self.servos.values(), speeds, strict=True):
                servo.motion.angle += speed * step
            self.tensions = self.arm.tensions(self.wound, 0.0)
        expected = dict.fromkeys(range(len(self.wires)), math.nan)  # [N] when their motor turned
        for _ in range(ITERATIONS_MAX):
            wound, balanced = self.wound, True
            for servo, lever, wires, start in zip(
                self.servos.values(), self._lever, self._of, begin, strict=True
            ):
                pulls = {i: max(0.0, self.arm.resistance(i)[0]) for i in wires}
                if all(abs(pull - expected[i]) < SAME_TENSION_N for i, pull in pulls.items()):
                    continue
                angle, balanced = servo.motion.angle, False
                # before it turned: lever [m/rad], pull [N] and stiffness [N/m] of its wires
                parts = [(lever[i], *self.arm.resistance(i)) for i in wires]
                load = Load([(r, pull - k * r * (angle - start), k) for r, pull, k in parts])
                servo.motion.angle = start
                servo.step(step, load)
                expected |= zip(wires, load.pulls(servo.motion.angle - start), strict=True)
                if servo.motion.angle != angle:
                    wound = wound + lever * (servo.motion.angle - angle)
                    self.tensions = self.arm.tensions(wound, 0.0)
            if balanced:
                return
