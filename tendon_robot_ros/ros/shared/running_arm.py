"""The running robot as an investigation asks it: driven by the controller, seen by the monitor."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import yaml
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from ...common.errors import InputError, NoEquilibriumError, TendonRobotError
from ...control.checks import Refusal, by_name
from ...control.state import Trajectory
from ...data import Marker, default_markers
from ...investigation.record import BrokenMeasurementError, PostureMeasured
from ...model.model import Model
from ...monitoring import History, StillMeasurement, StillWindow
from ...monitoring.change import ChangeFinder, load_change
from ...monitoring.monitor import read_markers
from ...robot import Robot
from ...robot.estimates import natural_sizes
from .messages import LISTEN, STATE, seconds
from .parameters import RemoteText
from .robot_client import WORKING_CODES, Pilot
from .runtime import Ending

Array = NDArray[np.float64]
DRIVER = 'driver'  # name of the node whose status says how tensions are told
BY_GEARS = 'current'  # tensions that motors tell by their current: gear friction hides them
STILL_TIME_S, STILL_SPEED = 0.6, 0.002  # [s], [m/s] as of the monitor
KIND_LISTEN_S = 1.0  # [s] to hear whether tensions are measured
STAND_TIMEOUT_S = 20.0  # [s] for an arm to stand and be seen
MOVE_PATIENCE_S = 15.0  # [s] besides the time of a move
MOVE_MIN_S = 0.4  # [s]
SETTING_NOISE = 0.002  # [1] relative 1 sd of a measured input, as in the monitor
SLACK_TURN = 0.6  # [rad] that an arm may bend beyond its description until a slack wire is taut
OFF_SHARE, OFF_LIMIT_SHARE = 0.5, 0.02  # of what is asked, of the limit: off by more is broken
SLIP_HINT = 'did its tendon slip, or does its motor stick?'
GEARS_HINT = (
    'the friction of its gears hides so little: start driver and controller with command_mode '
    'pull, then postures are wire lengths'
)
RELEASE_S = 10.0  # [s] that letting go may take
LATE_S = 5.0  # [s] that states of the driver may be missing in a measurement that is repeated


class StoppedError(TendonRobotError):
    """Somebody asked to end it."""


class RunningArm(Pilot):
    """
    A `MeasurableArm` of a running controller, driver and monitor.

    Where the driver measures tensions, postures are tensions, whatever it commands; else wire
    lengths, also where it commands lengths and tells tensions by the current of geared motors.
    A wire that a posture leaves slack is let out by what the described arm needs and a little
    more. What the description lacks may pull it taut all the same: its length is measured, too.
    Every posture is reached from the released arm (`from_straight`), or one after the
    other (`sequence`).

    Parameters
    ----------
    controller, monitor : str
        Names of the nodes.
    ending : Ending
    namespace : str, optional
    path : str
    speed : float
        Of an input, in shares of its largest tension per second [1/s].

    """

    def __init__(
        self,
        controller: str,
        monitor: str,
        ending: Ending,
        namespace: str | None = None,
        path: str = 'from_straight',
        speed: float = 0.2,
    ) -> None:
        """Connect."""
        super().__init__('investigate', controller, ending, namespace, (DRIVER, monitor))
        self.path, self.stop_asked = path, False
        self._monitor, self.speed = monitor, speed
        self._frames: list[tuple[float, Array]] = []
        self._states, self._kinds = History(8.0), set[str]()
        self.create_subscription(PoseArray, f'{monitor}/measured', self._hear_frame, STATE)
        self.create_subscription(JointState, 'tendon_states', self._hear_states, LISTEN)
        self._own: Model | None = None
        self.input = 'tension'
        self._variances: list[float] = []  # [m²] of the means so far

    def begin(self) -> None:
        """
        Wait for the robot and take its model and markers.

        Raises
        ------
        TendonRobotError
            A node does not come, or does not work.

        """
        self.connect()
        self._own = self.model()
        texts: list[str] = []
        remote = RemoteText(self, self._monitor, 'markers')

        def asked() -> bool:
            remote.ask(texts.append)
            return bool(texts)

        self.wait(
            asked, 10.0, f'the parameter markers of {self._monitor}: is the monitor running?'
        )
        rows = yaml.safe_load(texts[0]) or []
        self.markers: Sequence[Marker] = read_markers(rows, self.robot) or default_markers(
            self.robot
        )
        self.clear_frames()
        self.wait(
            lambda: self._frames and self._kinds,
            10.0,
            f'{self._monitor}/measured and tendon_states: does the tracker see the arm?',
        )
        self.spin(KIND_LISTEN_S)  # a reading of a cell may be missing now and then
        measured = 'tension' in self._kinds and not (self.pull and self._by_gears)
        self.input = 'tension' if measured else 'displacement'

    def change(self) -> ChangeFinder | None:
        """Return what the monitor knows of a change; None where it has no alarm."""
        self.wait(lambda: self.statuses[self._monitor], KIND_LISTEN_S, 'its status', strict=False)
        if self.statuses[self._monitor].get('drift') != 'true' or self.input != 'tension':
            return None
        assert self._own is not None
        told = self.triggered(f'{self._monitor}/change')
        return load_change(told, self._own.catalogue)

    @property
    def robot(self) -> Robot:
        """The description that the controller uses."""
        assert self._own is not None
        return self._own.robot

    @property
    def position_noise(self) -> float | None:
        """Standard deviation [m] of a coordinate of a trial: of the frames of those so far."""
        return max(float(np.sqrt(np.mean(self._variances))), 1e-6) if self._variances else None

    @property
    def input_noise(self) -> tuple[float, float]:
        """Relative 1 sd of an input."""
        return SETTING_NOISE, 0.0

    def measure(self, inputs: Array, trials: int) -> PostureMeasured:
        """Go there, wait until it stands, and record; from rest every time."""
        try:
            return self._measured(inputs, trials)
        except (StoppedError, BrokenMeasurementError, InputError):
            raise
        except TendonRobotError as error:
            if not self._goes_on():
                raise
            raise BrokenMeasurementError(f'{error}; it goes on') from None

    def _goes_on(self) -> bool:
        """Tell whether the controller takes commands, or does so again soon: a driver was late."""

        def works() -> bool:
            return self.status.get('code') in (*WORKING_CODES, 'released')

        late = self.status.get('code') == 'no_driver'
        return works() or (late and self.wait(works, LATE_S, 'the driver', strict=False))

    def _measured(self, inputs: Array, trials: int) -> PostureMeasured:
        """Measure once."""
        stood = []
        for _ in range(trials):
            if self.path == 'from_straight':
                self._go(self._rest())
            self._go(self._command(inputs))
            stood.append(self._stand())
        if self.input == 'tension':
            for one in stood:
                self._refuse_slack(inputs, one.inputs)
        self._variances += [one.spread**2 / one.frames for one in stood]
        least = 0.0 if self.input == 'tension' else -np.inf  # a cell near none reads below it, too
        taken = np.array([np.maximum(one.inputs, least) for one in stood])
        frames = sum(one.frames for one in stood)
        return PostureMeasured(np.array([one.positions for one in stood]), taken, frames)

    def release(self) -> None:
        """Let go, even after a signal; a controller that is stopped has let go already."""
        if self._own is None or not self._commands:
            return
        stamp = self.play(self._move(self._rest()))
        end = time.monotonic() + RELEASE_S
        while time.monotonic() < end and not self.settled(stamp, ('played',)):
            self._executor.spin_once(timeout_sec=0.05)
            if self.status.get('code') == 'stopped':
                return

    def clear_frames(self) -> None:
        """Forget what was seen."""
        self._frames.clear()

    def spin_once(self, timeout: float) -> None:
        """Serve one message; end when somebody asked for it."""
        super().spin_once(timeout)
        if self.stop_asked:
            raise StoppedError('the investigation was stopped')

    def _rest(self) -> Array:
        """Return the command (m,) [N] or [m] of the released arm."""
        assert self._own is not None
        lowest = self._own.limits[:, 0]
        return np.asarray(self._own.shape(lowest).pulls) if self.pull else lowest

    def _command(self, inputs: Array) -> Array:
        """Return what to command for a posture: tensions [N], or wire pulls [m]."""
        assert self._own is not None
        low, high = self._own.limits.T
        if self.input == 'tension':
            tensions = np.clip(inputs, low, high)
            return np.asarray(self._shape(tensions).pulls) if self.pull else tensions
        if not self.pull:
            raise InputError(
                'the driver takes tensions and does not measure them: nothing can be told'
            )
        try:
            pulls = self._own.pull_shape(inputs).pulls
        except (NoEquilibriumError, InputError) as error:
            raise BrokenMeasurementError(f'no shape at these wire pulls: {error}') from None
        out = SLACK_TURN * natural_sizes(self.robot)['radius']
        return np.where(np.isnan(inputs), pulls - out, inputs)

    def _shape(self, tensions: Array):  # type: ignore[no-untyped-def]
        assert self._own is not None
        try:
            return self._own.shape(tensions)
        except NoEquilibriumError as error:
            raise BrokenMeasurementError(f'no shape at these tensions: {error}') from None

    def _move(self, target: Array) -> Trajectory:
        """Return the straight way from the command of now, as fast as is allowed."""
        assert self._own is not None
        here = self._commands[-1][1]
        most = self._own.limits[:, 1] if not self.pull else 0.1 * self.robot.length
        share = float(np.max(np.abs(target - here) / most))
        return Trajectory(np.array([max(share / self.speed, MOVE_MIN_S)]), target[None])

    def _go(self, target: Array) -> None:
        """Drive there and wait until the controller says so."""
        way = self._move(target)
        stamp = self.play(way)
        self.settle(stamp, way.times[-1] + MOVE_PATIENCE_S, 'the arm to get there')

    def _stand(self) -> StillMeasurement:
        """Wait until the arm stands and is seen."""
        robot = self.robot
        tension = self.input == 'tension'
        change = 0.01 * robot.tension_limits[1] if tension else 0.002 * robot.length
        window = StillWindow(STILL_TIME_S, STILL_SPEED, change)
        self.clear_frames()
        since, end = self._now(), time.monotonic() + STAND_TIMEOUT_S
        seen = 0
        while time.monotonic() < end:
            self.spin_once(0.05)
            self.require_good()
            for at, positions in self._frames:
                inputs = self._states.at(at)
                if at < since or inputs is None or positions.shape[0] != len(self.markers):
                    continue
                seen += bool(np.isfinite(positions).any())
                window.put(at, self._own_half(inputs), positions)
            self.clear_frames()
            settled = window.settled()
            if settled is not None:
                mean = self._states.mean(settled.begin, settled.end)
                inputs = settled.inputs if mean is None else self._own_half(mean)
                return StillMeasurement(
                    inputs, settled.positions, settled.spread, settled.frames,
                    settled.begin, settled.end,
                )  # fmt: skip
        if not seen:
            raise BrokenMeasurementError(f'the tracker saw nothing for {STAND_TIMEOUT_S:g} s')
        raise BrokenMeasurementError(f'the arm did not stand within {STAND_TIMEOUT_S:g} s')

    def _refuse_slack(self, asked: Array, measured: Array) -> None:
        """Raise where motors do not pull what is asked: a slipped tendon, a motor that sticks."""
        high = self.robot.tension_limits[1]
        off = np.abs(measured - asked) - OFF_SHARE * asked
        worst = int(np.argmax(off))
        if off[worst] > OFF_LIMIT_SHARE * high:
            raise BrokenMeasurementError(
                f'{self.robot.inputs[worst]} pulls {measured[worst]:.2f} N instead of '
                f'{asked[worst]:.2f} N: {GEARS_HINT if self._by_gears else SLIP_HINT}'
            )

    @property
    def _by_gears(self) -> bool:
        """Whether geared motors tell tensions by their current."""
        return self.statuses[DRIVER].get('tension_source') == BY_GEARS

    def _own_half(self, state: Array) -> Array:
        """Return the tensions, or the wire pulls, of a state."""
        return np.split(state, 2)[0 if self.input == 'tension' else 1]

    def _now(self) -> float:
        return 1e-9 * float(self.get_clock().now().nanoseconds)

    def _hear_frame(self, message: PoseArray) -> None:
        points = np.array([[p.position.x, p.position.y, p.position.z] for p in message.poses])
        self._frames.append((seconds(message.header.stamp), points.reshape(-1, 3)))
        del self._frames[:-500]

    def _hear_states(self, message: JointState) -> None:
        if self._own is None:
            return
        names, blank = message.name, [float('nan')] * len(message.name)
        try:
            tensions = by_name(
                names, message.effort or blank, self._own.inputs, 'tendon_states', 'effort'
            )
            pulls = by_name(
                names, message.position or blank, self._own.inputs, 'tendon_states', 'position'
            )
        except Refusal:
            return
        self._kinds.add('tension' if np.isfinite(tensions).all() else 'displacement')
        state = np.concatenate([tensions, pulls])
        if np.isfinite(self._own_half(state)).all():
            self._states.put(seconds(message.header.stamp), state)
