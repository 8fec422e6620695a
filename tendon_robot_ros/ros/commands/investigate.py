"""
The running robot chooses its own postures, until it knows what its description lacks.

Controller, driver and monitor run already, and the tracker sees the arm. Every posture is played
by the controller, within its limits; a stop of driver or controller ends it, Ctrl-C lets the arm
go. With one name left (or --add) the controller gets the better description, unless --keep. DIR
gets data, recording, diagnosis, report and description; --resume goes on. After a drift alarm of
the monitor the first postures are those that tell what has changed.

Topics: investigate/progress (std_msgs/String, JSON), investigate/status. Services:
investigate/start, investigate/stop. With --wait it starts when that is called, from the live page
for one.

example: python -m tendon_robot_ros investigate --output found --keep-out regions.yaml
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from ...common.arrays import Floats
from ...common.errors import InputError, NoEquilibriumError, TendonRobotError
from ...common.results import emit, narrate
from ...control.inputs import Refusal, Trajectory
from ...data import Marker, default_markers
from ...data.dataset import LOADINGS
from ...data.folder import read_markers
from ...drivers.safety import CYCLE_MAX_S
from ...investigation.goal import add_goal, goal_of
from ...investigation.loop import Investigation
from ...investigation.measuring import BETTER, BrokenMeasurementError, PostureMeasured
from ...model.model import Model
from ...monitoring.change import ChangeFinder
from ...monitoring.monitor import History, MonitorSettings, StillMeasurement, still_window
from ...monitoring.watch import load_change
from ...robot import Robot
from ...robot.estimates import natural_sizes
from ...robot.keep_out import KeepOut, load_keep_out
from ..shared import interface
from ..shared.lifecycle import OK, WARN, Status
from ..shared.messages import offer_trigger, points_of, seconds, tensions_and_pulls, time_now
from ..shared.parameters import parsed
from ..shared.robot_client import MESSAGES_MAX, TIP_AVERAGE_S, WORKING_CODES, Pilot, add_controller
from ..shared.runtime import SPIN_S, Ending, repeat, ros
from ..shared.timing import ANSWER_TIMEOUT_S, REACTION_TIMEOUT_S, SILENCE_S, STATUS_PERIOD_S

HELP = 'the running robot chooses postures by itself until it knows what its model lacks'
DRIVER = 'driver'  # name of the node whose status has the source of tensions
BY_GEARS = 'current'  # source of tensions: the current of motors, falsified by gear friction
# [1/s] of an input, in fractions of its largest tension (in pull mode of a tenth of the arm's
# length), so that a posture is reached in some seconds
SPEED = 0.2
# [rad] that an arm may bend beyond its description until a slack wire is taut: a missing effect
# would else pull the wire, and change the posture
SLACK_ANGLE = 0.6
SLIP_HINT = 'did its tendon slip, or does its motor stick?'
GEARS_HINT = (
    'the friction of its gears hides so little: start driver and controller with command_mode '
    'pull, then postures are wire lengths'
)


class StoppedError(TendonRobotError):
    """The service `~/stop` ended the investigation."""


class RunningArm(Pilot):
    """
    A `MeasurableArm` of a running controller, driver and monitor.

    Where the driver measures tensions, postures are tensions, whatever it commands; else wire
    lengths, also where it commands lengths and estimates tensions from the current of geared
    motors. A wire that is slack in a posture is let out by the travel of the described arm and a
    margin. A missing effect may pull it taut all the same: its length is measured, too. Every
    posture is reached from the released arm (`from_straight`), or one after the other
    (`sequence`).

    Parameters
    ----------
    args : argparse.Namespace
        Of the command: the names of the nodes, `path`, and the `speed` of an input in fractions of
        its largest tension per second [1/s].
    ending : Ending
    namespace : str, optional

    """

    _own: Model  # of the controller
    robot: Robot  # its description
    markers: Sequence[Marker]
    input_noise = MonitorSettings().setting_noise, 0.0  # relative 1 sd of an input: setting, trial

    def __init__(
        self, args: argparse.Namespace, ending: Ending, namespace: str | None = None
    ) -> None:
        """Create publishers and subscriptions."""
        super().__init__('investigate', ending, args.controller, namespace, (DRIVER, args.monitor))
        self.path, self.stop_requested = args.path, False
        self._monitor, self.speed = args.monitor, args.speed
        self._frames: list[tuple[float, Floats]] = []
        self._states, self._kinds = History(8.0), set[str]()

        def frame(message: PoseArray) -> None:
            self._frames.append((seconds(message.header.stamp), points_of(message)))
            del self._frames[:-MESSAGES_MAX]

        def states(message: JointState) -> None:
            try:
                tensions, pulls = tensions_and_pulls(message, self.inputs)
            except Refusal:
                return  # before the first command, or of another robot
            self._kinds.add('tension' if np.isfinite(tensions).all() else 'displacement')
            state = np.concatenate([tensions, pulls])
            if np.isfinite(self._states.inputs(state, self.input)).all():
                self._states.put(seconds(message.header.stamp), state)

        interface.subscribe(self, 'monitor/measured', frame, args.monitor, interface.STATE)
        interface.subscribe(self, 'tendon_states', states)
        self.input = 'tension'
        self._variances: list[float] = []  # [m²] of the mean positions so far

    def begin(self) -> None:
        """
        Wait for the robot and read its model and markers.

        Raises
        ------
        TendonRobotError
            A node does not answer, or does not work.

        """
        self.connect()
        self._own = self.model()
        self.robot = self._own.robot
        rows = parsed(self.parameter('markers', self._monitor), 'markers', list)
        self.markers = read_markers(rows, self.robot) or default_markers(self.robot)
        self._frames.clear()
        what = f'{self._monitor}/measured and tendon_states: does the tracker see the arm?'
        self.wait(lambda: self._frames and self._kinds, REACTION_TIMEOUT_S, what)
        self.spin(SILENCE_S)  # single readings of a load cell may be missing
        measured = 'tension' in self._kinds and not (self.pull and self._by_gears)
        self.input = 'tension' if measured else 'displacement'

    def change(self) -> ChangeFinder | None:
        """Return the change that the monitor has estimated; None: it has no alarm."""
        self.wait(lambda: self.statuses[self._monitor], SILENCE_S, 'its status', strict=False)
        if self.statuses[self._monitor].get('drift') != 'true' or self.input != 'tension':
            return None
        return load_change(self.triggered(f'{self._monitor}/change'), self._own.catalogue)

    @property
    def position_noise(self) -> float | None:
        """Standard deviation [m] of a coordinate of a trial, from the frames so far."""
        return max(float(np.sqrt(np.mean(self._variances))), 1e-6) if self._variances else None

    def _trial(self, inputs: Floats) -> StillMeasurement:
        """Go to a posture and record it; BrokenMeasurementError: in vain, it goes on."""

        def works() -> bool:
            passing = 'released', 'refused_released'  # another path has it resume
            return self.status.get('code') in (*WORKING_CODES, *passing)

        try:
            if self.path == 'from_straight':
                self._go(self._rest())
            self._go(self._command(inputs))
            return self._stand()
        except (StoppedError, BrokenMeasurementError, InputError):
            raise
        except TendonRobotError as error:
            late = self.status.get('code') == 'no_driver'  # it may come back soon
            again = late and self.wait(works, REACTION_TIMEOUT_S, 'the driver', strict=False)
            if not again and not works():
                raise
            raise BrokenMeasurementError(f'{error}; it goes on') from None

    def measure(self, inputs: Floats, trials: int) -> PostureMeasured:
        """Measure a posture: go there `trials` times, wait for rest, and record."""
        measurements = [self._trial(inputs) for _ in range(trials)]
        for one in measurements if self.input == 'tension' else ():
            # off by more than half: a tendon has slipped or a motor sticks, because neither
            # friction of a transmission nor noise of a load cell reaches that
            off = np.abs(one.inputs - inputs) - 0.5 * inputs
            worst = int(np.argmax(off))
            # ten standard deviations, so that noise does not decide for a request near zero
            noise = self.input_noise[0] * self.robot.tension_limits[1]
            if off[worst] > 10.0 * noise:
                raise BrokenMeasurementError(
                    f'{self.robot.inputs[worst]} pulls {one.inputs[worst]:.2f} N instead of '
                    f'{inputs[worst]:.2f} N: {GEARS_HINT if self._by_gears else SLIP_HINT}'
                )
        self._variances += [one.spread**2 / one.frames for one in measurements]
        # an unloaded load cell also reads less than 0
        minimum = 0.0 if self.input == 'tension' else -np.inf
        measured = np.array([np.maximum(one.inputs, minimum) for one in measurements])
        frames = sum(one.frames for one in measurements)
        return PostureMeasured(np.array([one.positions for one in measurements]), measured, frames)

    def release(self) -> None:
        """
        Release the arm, even after a signal, unless a stop or the driver has.

        A busy controller may refuse the path, or drop it while it does not hear the driver: it is
        sent again until it was played.
        """
        rest = self._rest()
        stamp, sent = self.play(self._move(rest)), time.monotonic()
        end = sent + REACTION_TIMEOUT_S
        with self.ending.interrupting(False):
            while not self.settled(stamp, ('played',)):
                now, code = time.monotonic(), self.status.get('code')
                # an older status may be of a release after which a path has had it resume
                released = code == 'released' and self._status_at > sent + TIP_AVERAGE_S
                if released or code == 'stopped':
                    break
                if now > end:
                    said = self.status.get('message')
                    self.get_logger().error(f'not released; the controller says: {said}')
                    break
                if self.status.get('target_stamp') != stamp and now - sent > ANSWER_TIMEOUT_S:
                    stamp, sent = self.play(self._move(rest)), now
                self.serve(SPIN_S)

    def attend(self) -> None:
        """Serve a message that has come; StoppedError: the service `~/stop` was called."""
        self.spin_once(0.0)

    def spin_once(self, timeout: float) -> None:
        """Serve one message; StoppedError: the service `~/stop` was called."""
        super().spin_once(timeout)
        if self.stop_requested:
            raise StoppedError('the investigation was stopped')

    def _rest(self) -> Floats:
        """Return the command (m,) [N] or [m] of the released arm."""
        lowest = self._own.limits[:, 0]
        return np.asarray(self._own.shape(lowest).pulls) if self.pull else lowest

    def _command(self, inputs: Floats) -> Floats:
        """Return the command (m,) for a posture: tensions [N], or wire pulls [m]."""
        low, high = self._own.limits.T
        if self.input == 'tension':
            tensions = np.clip(inputs, low, high)
            if not self.pull:
                return tensions
            try:
                return np.asarray(self._own.shape(tensions).pulls)
            except NoEquilibriumError as error:
                raise BrokenMeasurementError(f'no shape at these tensions: {error}') from None
        if not self.pull:
            raise InputError(
                'the driver takes tensions and does not measure them: nothing can be told'
            )
        try:
            pulls = self._own.pull_shape(inputs).pulls
        except (NoEquilibriumError, InputError) as error:
            raise BrokenMeasurementError(f'no shape at these wire pulls: {error}') from None
        out = SLACK_ANGLE * natural_sizes(self.robot)['radius']
        return np.where(np.isnan(inputs), pulls - out, inputs)

    def _move(self, target: Floats) -> Trajectory:
        """Return the straight path from the present command, at the set speed."""
        current = self._commands[-1][1]
        largest = self._own.limits[:, 1] if not self.pull else 0.1 * self.robot.length
        fraction = float(np.max(np.abs(target - current) / largest))
        # no shorter, so that no command jumps
        return Trajectory(np.array([max(fraction / self.speed, CYCLE_MAX_S)]), target[None])

    def _go(self, target: Floats) -> None:
        """Play the path to a command and wait for its end; what releases it later counts."""
        self.play_to_the_end(self._move(target), 'the arm to get there', REACTION_TIMEOUT_S)

    def _stand(self) -> StillMeasurement:
        """Wait until the arm is at rest and visible; return the mean of its frames."""
        window = still_window(self.robot, self.input, MonitorSettings())
        self._frames.clear()
        since, end = time_now(self), time.monotonic() + REACTION_TIMEOUT_S
        visible = 0
        while time.monotonic() < end:
            self.spin_once(SPIN_S)
            self.require_good()
            for at, positions in self._frames:
                inputs = self._states.at(at)
                if at < since or inputs is None or positions.shape[0] != len(self.markers):
                    continue
                visible += bool(np.isfinite(positions).any())
                window.put(at, self._states.inputs(inputs, self.input), positions)
            self._frames.clear()
            settled = window.settled()
            if settled is not None:
                return self._states.averaged(settled, self.input)
        if not visible:
            raise BrokenMeasurementError(f'the tracker saw nothing for {REACTION_TIMEOUT_S:g} s')
        raise BrokenMeasurementError(f'the arm did not stand within {REACTION_TIMEOUT_S:g} s')

    @property
    def _by_gears(self) -> bool:
        """Whether tensions are estimated from the current of geared motors."""
        return self.statuses[DRIVER].get('tension_source') == BY_GEARS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add_goal(parser, 1)
    path = 'let go before every posture, or go from one to the next'
    add('--path', choices=LOADINGS, default=LOADINGS[0], help=path)
    speed = f'of an input, in largest tensions per second (default: {SPEED:g})'
    add('--speed', type=float, default=SPEED, metavar='X', help=speed)
    add('--keep', action='store_true', help='do not send the controller what was found')
    add('--wait', action='store_true', help='wait for investigate/start; DIR gets a folder each')
    add('--monitor', default='monitor', metavar='NAME', help='of the node (default: monitor)')
    add_controller(parser)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Investigate once, or at every call of the service `~/start`."""
    goal_of(args)  # invalid arguments are refused before anything is started
    if not 0.001 <= args.speed <= 100.0:
        raise InputError(f'--speed: expected 0.001 to 100, got {args.speed:g}')
    regions = load_keep_out(args.keep_out) if args.keep_out else KeepOut()
    with ros(ros_arguments) as ending, RunningArm(args, ending) as arm:
        investigator = Investigator(arm, args, regions)
        if args.wait:
            investigator.serve()
        investigator.once(Path(args.output), args.resume)
    return 0


class Investigator:
    """ROS interface of an investigation: services, progress, status."""

    def __init__(self, arm: RunningArm, args: argparse.Namespace, regions: KeepOut) -> None:
        """Create publishers and services."""
        self.arm, self.args, self.regions = arm, args, regions
        self._start_requested = False
        self._busy = False
        self._status = Status(arm, 'investigation')
        self._progress = arm.create_publisher(*interface.topic('investigate/progress'))
        self._tour = arm.create_publisher(*interface.topic('tour'))
        offer_trigger(arm, '~/start', self._start)
        offer_trigger(arm, '~/stop', self._stop)
        repeat(arm, STATUS_PERIOD_S, self._publish_status)

    def serve(self) -> None:
        """Investigate at every call of the service `~/start`, until a signal comes."""
        while True:
            self._start_requested = self.arm.stop_requested = False
            while not self._start_requested:
                self.arm.spin_once(0.1)
            folder = Path(self.args.output) / time.strftime('%Y-%m-%d_%H-%M-%S')
            try:
                self.once(folder, False)
            except TendonRobotError as error:
                self.arm.stop_requested = False
                self.publish_news('failed', ' '.join(str(error).split()), {})

    def once(self, folder: Path, resume: bool) -> Investigation:
        """Investigate, write the results, and send the controller the better description."""
        args = self.args
        self._busy = True
        try:
            self._tour.publish(Bool(data=False))
            self.arm.begin()
            goal, change = goal_of(args), self.arm.change()
            investigation = Investigation(
                self.arm, goal, folder, self.regions, self.publish_news, resume, change
            )
            with self.arm.ending.interrupting():  # a diagnosis may take a minute
                investigation.run()
            emit(args, investigation.to_json(), '\n'.join(investigation.write_results()))
            if (folder / BETTER).exists() and not args.keep:
                better = str((folder / BETTER).resolve())
                accepted, reason = self.arm.put('model', better, 2.0 * REACTION_TIMEOUT_S)
                answer = 'uses it' if accepted else f'refuses it: {reason}'
                self.publish_news('sent', f'the controller {answer}', {'taken': accepted})
            return investigation
        finally:
            self._busy = False
            self._tour.publish(Bool(data=True))
            self._publish_status()

    def publish_news(self, kind: str, text: str, content: dict[str, Any]) -> None:
        """Print and publish progress."""
        narrate(self.args, text)
        self._progress.publish(String(data=json.dumps({'kind': kind, 'text': text, **content})))

    def _publish_status(self) -> None:
        """Publish the status."""
        code = 'asking' if self._busy else 'waiting'
        text = 'investigating' if self._busy else 'call ~/start to investigate'
        self._status.publish(WARN if self._busy else OK, code, text)

    def _start(self) -> str:
        if self._busy:
            raise TendonRobotError('an investigation runs already')
        self._start_requested = True
        return 'investigating'

    def _stop(self) -> str:
        if not self._busy:
            raise TendonRobotError('no investigation runs')
        self.arm.stop_requested = True
        return 'stopping'
