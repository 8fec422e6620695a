"""`investigate` with emulated motors that wind an arm which hides a load at its tip."""

import contextlib
import os
import re
import signal
import time
from types import SimpleNamespace

import numpy as np
import processes
import pytest
from emulated_board import needs_compiler
from source_tree import ROOT

pytest.importorskip('rclpy')
pytest.importorskip('serial')

from arms import coarse
from emulated import ForkedEmulator
from forked import Forked
from geometry_msgs.msg import Point, Pose, PoseArray
from ros_station import Station, start

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.control.inputs import Trajectory
from tendon_robot_ros.data import default_markers, load_dataset
from tendon_robot_ros.investigation.measuring import BrokenMeasurementError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.monitoring import StillMeasurement
from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.commands import investigate
from tendon_robot_ros.ros.commands.investigate import RunningArm
from tendon_robot_ros.ros.shared.interface import LISTEN
from tendon_robot_ros.simulation.plant import make_plant

pytestmark = [pytest.mark.ros, pytest.mark.long]
FORCES = {'kato_10_1': 0.003, 'spatial_3': 0.01}  # [N] across the tip
COARSE = 'coarse'  # kato_10_1 of fewer cells, which costs less
NOISE = 2e-4  # [m]
NEAR = 1e-3  # [m] of wire, less than postures differ by; motors hold it to a hundredth of that
PATIENCE = 500.0  # [s]


def places(shape, markers):
    """Return where (J, 3) [m] the markers on an arm are."""
    arcs = np.array([marker.arc_length for marker in markers])
    return shape.markers(arcs, np.array([marker.offset for marker in markers]))


class Tracked(Station):
    """Emulated motors, the nodes on them, and a tracker that sees what the motors pull."""

    def __init__(self, kind, mode, name, folder, stack):
        super().__init__(f'/investigate_{kind}_{mode}_{name}')
        self.robot = coarse('kato_10_1', 5) if name == COARSE else load_robot(name)
        described = dump_robot(self.robot)
        loaded = self.robot.with_effect('tip_load', {'force_x': FORCES[self.robot.name]})
        self.folder, self.arm = folder, make_plant(loaded)  # that the motors wind
        self.markers = default_markers(self.robot)
        wound = folder / 'loaded.yaml'
        wound.write_text(dump_robot(loaded))
        self.motors = stack.enter_context(ForkedEmulator(wound, kind=kind))
        self.random, self.wound = np.random.default_rng(1), None  # (m,) [m] wire on the spools
        self.publisher = self.node.create_publisher(PoseArray, 'measured_shape', LISTEN)
        self.node.create_timer(0.04, self.look)
        nodes = {
            'driver': {
                'robot': described, 'backend': kind, 'config': str(self.motors.config),
                'command_mode': mode,
            },
            'controller': {'model': described, 'command_mode': mode, 'state_timeout': 5.0},
            'monitor': {'folder': str(folder / 'recordings'), 'path': 'from_straight'},
        }  # fmt: skip
        for name, parameters in nodes.items():
            stack.enter_context(start(name, self.namespace, folder, **parameters))

    def look(self):
        """Publish what a tracker sees."""
        state = self.motors.ask('state')
        tensions, self.wound = np.array(state['tensions']), np.array(state['wound'])
        seen = places(self.arm.respond(np.maximum(tensions, 0.0)), self.markers)
        seen = seen + self.random.normal(0.0, NOISE, seen.shape)
        message = PoseArray()
        message.header.frame_id = f'{self.robot.name}_base'
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.poses = [Pose(position=Point(x=x, y=y, z=z)) for x, y, z in seen.tolist()]
        self.publisher.publish(message)

    def off_rest(self):
        """Return the wire [m] that every motor has wound since the arm was released."""
        return self.wound - self.rest

    def stands_as_said(self, words):
        """Return whether wires are wound as the command has said of a posture."""
        *_, line = (line for line in self.said().splitlines() if line.startswith(words))
        wound = dict(zip(self.robot.inputs, self.off_rest(), strict=True))
        said = re.findall(r'(\w+) (\S+) mm', line)
        return all(abs(wound[name] - 1e-3 * float(pull)) < NEAR for name, pull in said)

    @contextlib.contextmanager
    def investigating(self, *arguments):
        """Start the command; it writes to `found` and `investigate.log`."""
        with (self.folder / 'investigate.log').open('w') as log:
            command = ['investigate', '--output', str(self.folder / 'found'), '--speed', '1']
            command += [*arguments, '--ros-args', '-r', f'__ns:={self.namespace}']
            environment = {**os.environ, 'PYTHONPATH': str(ROOT), 'PYTHONUNBUFFERED': '1'}
            yield Forked(command, stdin=processes.DEVNULL, stdout=log, stderr=log, env=environment)

    def said(self):
        return (self.folder / 'investigate.log').read_text()

    def until_said(self, process, words):
        end = time.monotonic() + PATIENCE
        while words not in self.said():
            assert process.poll() is None and time.monotonic() < end, self.said()
            self.spin(0.1)


@pytest.fixture
def made(request, tmp_path):
    with contextlib.ExitStack() as stack:
        station = Tracked(*request.param, tmp_path, stack)
        stack.callback(station.close)
        station.until_code(station.controller, 'holding', timeout=120.0)
        station.until_code(station.driver, 'following', 'released')
        station.look()
        station.rest = station.wound  # where the search for slack has left it
        yield station


STATIONS = {
    f'{kind}-{mode}-{name}': (kind, mode, name)
    for kind, mode in (('serial', 'tension'), ('serial', 'pull'), ('dynamixel', 'pull'))
    for name in FORCES
}


def ends_well(made, process):
    """Wait until an investigation has ended; look at what it has found and written."""
    made.until_said(process, 'written: ')
    end = time.monotonic() + 60.0
    while process.poll() is None and time.monotonic() < end:
        made.spin(0.1)
    assert process.returncode == 0, made.said()
    (verdict,) = (line for line in made.said().splitlines() if line.startswith('Missing: '))
    assert 'tip_load' in verdict
    assert 'the controller uses it' in made.said()
    data = load_dataset(made.folder / 'found' / 'data')
    _, high = made.robot.tension_limits
    if data.input == 'tension':
        assert np.nanmax(data.inputs) <= high
    written = made.folder / 'found' / 'better.yaml'
    assert f'model := {written}' in (made.folder / 'found' / 'report.html').read_text()
    better = load_robot(written)
    assert better.effects['tip_load']['force_x'] == pytest.approx(
        FORCES[made.robot.name], rel=0.15
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    'made',
    [pytest.param(one, id=name, marks=needs_compiler) for name, one in STATIONS.items()],
    indirect=True,
)
def test_emulated_motors_find_the_load_and_the_controller_uses_it(made):
    with made.investigating() as process:
        ends_well(made, process)


class Hesitating:
    """The part of a running arm that judges a measurement; its controller says these codes."""

    measure, _trial = RunningArm.measure, RunningArm._trial
    path = 'sequence'

    def __init__(self, *codes):
        self.codes = list(codes)

    @property
    def status(self):
        return {'code': self.codes[0]}

    def wait(self, condition, timeout, what, strict=True):
        del self.codes[:-1]
        return condition()

    def _command(self, inputs):
        return inputs

    def _go(self, target):
        raise TendonRobotError(f'the controller says {self.codes[0]}')


@pytest.mark.parametrize(
    'codes', [('no_driver', 'holding'), ('holding',), ('released',), ('refused_released',)]
)
def test_a_driver_that_was_late_breaks_a_measurement_and_not_the_investigation(codes):
    with pytest.raises(BrokenMeasurementError, match='it goes on'):
        Hesitating(*codes).measure(np.zeros(4), 1)


@pytest.mark.parametrize('codes', [('stopped',), ('driver_stopped',), ('no_driver', 'no_driver')])
def test_a_robot_that_is_stopped_or_gone_ends_the_investigation(codes):
    with pytest.raises(TendonRobotError, match=f'says {codes[0]}$') as caught:
        Hesitating(*codes).measure(np.zeros(4), 1)
    assert not isinstance(caught.value, BrokenMeasurementError)


class LetGo(Hesitating):
    """A running arm whose driver lets go after a path was sent."""

    _go, clear, settle = RunningArm._go, RunningArm.clear, RunningArm.settle
    play_to_the_end = RunningArm.play_to_the_end
    require_good, settled = RunningArm.require_good, RunningArm.settled
    status, _status_at, _since = {'code': 'playing'}, 0.0, np.inf

    def __init__(self):
        self._tips, self._commands = {}, []

    def _move(self, target):
        return Trajectory(np.array([1.0]), target[None])

    def play(self, path):
        return 'its stamp'

    def wait(self, condition, timeout, what, strict=True):
        self.status = {'code': 'released', 'message': 'the driver let go'}
        self._status_at = time.monotonic() + 1.0
        return condition()


def test_an_arm_that_was_let_go_meanwhile_is_not_recorded():
    with pytest.raises(BrokenMeasurementError, match='the driver let go; it goes on'):
        LetGo().measure(np.zeros(4), 1)


class Busy(LetGo):
    """A running arm that is released; its controller says one code after the other."""

    release = RunningArm.release
    ending = SimpleNamespace(interrupting=contextlib.nullcontext)
    status, _status_at = {'code': 'released'}, 0.0  # of long ago: it has resumed since

    def __init__(self, codes):
        self.codes, self.sent, self.errors = list(codes), 0, []

    def _rest(self):
        return np.zeros(4)

    def play(self, path):
        self.sent += 1
        return str(self.sent)

    def serve(self, timeout):
        time.sleep(0.01)
        code = self.codes.pop(0) if len(self.codes) > 1 else self.codes[0]
        stamp = str(self.sent) if code.startswith('play') else 'of another'
        self.status = {'code': code, 'target_stamp': stamp, 'message': f'it is {code}'}
        self._status_at = time.monotonic()

    def get_logger(self):
        return SimpleNamespace(error=self.errors.append)


@pytest.mark.parametrize(
    ('codes', 'again', 'says'),
    [
        (['playing', 'played'], False, []),
        (['stopped'], False, []),
        (['released'], False, []),
        ([*['no_driver'] * 30, 'played'], True, []),
        ([*['refused_stale'] * 30, 'playing', 'played'], True, []),
        (['playing'], False, ['not released; the controller says: it is playing']),
    ],
)
def test_an_arm_is_let_go_by_a_controller_that_is_busy(codes, again, says, monkeypatch):
    times = {'TIP_AVERAGE': 0.01, 'ANSWER_TIMEOUT': 0.2, 'REACTION_TIMEOUT': 0.5 if says else 60.0}
    for name, seconds in times.items():
        monkeypatch.setattr(investigate, f'{name}_S', seconds)
    arm = Busy(codes)
    arm.release()
    assert (arm.sent > 1, arm.errors) == (again, says)


class Unloaded:
    """A running arm whose description lacks a load; it goes where it is told at once."""

    measure, _trial = RunningArm.measure, RunningArm._trial
    _command = RunningArm._command
    input, pull, path = 'displacement', True, 'sequence'

    def __init__(self, name):
        self.robot = load_robot(ROOT / 'config' / 'robots' / f'{name}.yaml')
        self.truth = Model(self.robot.with_effect('tip_load', {'force_x': FORCES[name]}))
        self._own, self._variances = Model(self.robot), []
        self.markers = default_markers(self.robot)

    def _go(self, target):
        self.pulls = target

    def _stand(self):
        seen = self.seen(self.pulls)
        return StillMeasurement(self.pulls, seen, NOISE, 15, 0.0, 0.6)

    def seen(self, pulls):
        return places(self.truth.pull_shape(pulls), self.markers)


@pytest.mark.parametrize('pull', [0.0008, 0.0035, 0.01])
def test_a_load_that_nobody_described_leaves_a_slack_wire_slack(pull):
    arm = Unloaded('spatial_3')
    inputs = np.array([np.nan, pull, np.nan])
    assert (arm.truth.pull_shape(arm._command(inputs)).inputs[np.isnan(inputs)] == 0.0).all()


def test_a_slack_wire_that_a_load_pulls_taut_is_recorded_at_its_length(monkeypatch):
    """Let out by less than the load takes it is taut: its posture is another one."""
    monkeypatch.setattr(investigate, 'SLACK_ANGLE', 0.2)
    arm = Unloaded('spatial_3')
    inputs = np.array([np.nan, 0.0035, np.nan])
    assert arm.truth.pull_shape(arm._command(inputs)).inputs[2] > 0.0
    measured = arm.measure(inputs, 1)
    assert np.abs(arm.seen(measured.inputs[0]) - measured.positions[0]).max() < 1e-6  # [m]


def let_go(made, process):
    """Interrupt a command; wait until it has ended and the arm is let go."""
    process.send_signal(signal.SIGINT)
    end = time.monotonic() + 60.0
    while process.poll() is None and time.monotonic() < end:
        made.spin(0.1)
    assert process.returncode == 130
    made.until(lambda: np.abs(made.off_rest()).max() < NEAR, 'the arm to be let go')


@pytest.mark.parametrize('made', [('dynamixel', 'pull', COARSE)], indirect=True)
def test_interrupted_it_lets_the_arm_go_and_goes_on_where_it_was(made):
    """To its end it is run by the slow tests above."""
    with made.investigating('--trials', '1') as process:
        made.until_said(process, 'posture 2:')
        made.until(lambda: made.stands_as_said('posture 2:'), 'the second posture')
        let_go(made, process)
    assert len(load_dataset(made.folder / 'found' / 'data').postures) == 1
    with made.investigating('--trials', '1', '--resume') as process:
        made.until_said(process, 'posture 3:')
        let_go(made, process)
    assert 'posture 2:' in made.said() and 'posture 1:' not in made.said()
    assert len(load_dataset(made.folder / 'found' / 'data').postures) == 2
