"""`investigate` with emulated motors that wind an arm which hides a load at its tip."""

import contextlib
import os
import signal
import sys
import time

import numpy as np
import processes
import pytest
from emulated_board import needs_compiler
from source_tree import ROOT

pytest.importorskip('rclpy')
pytest.importorskip('serial')

from geometry_msgs.msg import Point, Pose, PoseArray
from ros_station import PATIENT, ForkedNode, Station, last

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.emulator.process import EmulatorProcess
from tendon_robot_ros.investigation.arm import BrokenMeasurementError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.shared.messages import LISTEN
from tendon_robot_ros.ros.shared.running_arm import RunningArm

pytestmark = pytest.mark.ros
ROBOT = load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')
LOADED = ROBOT.with_effect('tip_load', {'force_x': 0.003})
NOISE = 2e-4  # [m]
PATIENCE = 280.0  # [s]


class Tracked(Station):
    """Emulated motors, the nodes on them, and a tracker that sees what the motors pull."""

    def __init__(self, kind, mode, folder, stack):
        super().__init__(f'/investigate_{kind}_{mode}')
        self.folder, self.model = folder, Model(LOADED)
        described = folder / 'loaded.yaml'
        described.write_text(dump_robot(LOADED))
        self.motors = stack.enter_context(EmulatorProcess(described, kind=kind))
        self.random, self.tensions = np.random.default_rng(1), None
        self.publisher = self.node.create_publisher(PoseArray, 'measured_shape', LISTEN)
        self.node.create_timer(0.04, self.look)
        nodes = {
            'driver': {
                **PATIENT['driver'], 'robot': 'kato_10_1', 'backend': kind,
                'config': str(self.motors.config), 'command_mode': mode,
            },
            'controller': {
                **PATIENT['controller'], 'model': 'kato_10_1', 'command_mode': mode,
                'state_timeout': 5.0,
            },
            'monitor': {'folder': str(folder / 'recordings'), 'path': 'from_straight'},
        }  # fmt: skip
        self.log = stack.enter_context((folder / 'nodes.log').open('w'))
        for name, parameters in nodes.items():
            stack.enter_context(ForkedNode(name, parameters, self.namespace, self.log))

    def look(self):
        """Publish what a tracker sees."""
        self.tensions = np.array(self.motors.ask('state')['tensions'])
        seen = self.model.shape(np.maximum(self.tensions, 0.0)).positions
        seen = seen + self.random.normal(0.0, NOISE, seen.shape)
        message = PoseArray()
        message.header.frame_id = f'{ROBOT.name}_base'
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.poses = [Pose(position=Point(x=x, y=y, z=z)) for x, y, z in seen.tolist()]
        self.publisher.publish(message)

    @contextlib.contextmanager
    def investigating(self, *arguments):
        """Start the command; it writes to `found` and `investigate.log`."""
        with (self.folder / 'investigate.log').open('w') as log:
            command = [sys.executable, '-u', '-m', 'tendon_robot_ros', 'investigate']
            command += ['--output', str(self.folder / 'found'), '--speed', '1', *arguments]
            command += ['--ros-args', '-r', f'__ns:={self.namespace}']
            environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
            yield processes.Process(command, stdout=log, stderr=log, env=environment)

    def said(self):
        return (self.folder / 'investigate.log').read_text()

    def until_said(self, process, words):
        end = time.monotonic() + PATIENCE
        while words not in self.said():
            assert process.poll() is None and time.monotonic() < end, self.said()
            self.spin(0.1)


@pytest.fixture
def made(request, tmp_path):
    kind, mode = request.param
    with contextlib.ExitStack() as stack:
        station = Tracked(kind, mode, tmp_path, stack)
        stack.callback(station.close)
        station.until_code(station.controller, 'holding', timeout=120.0)
        yield station


def kinds(*all_):
    board = pytest.mark.slow, needs_compiler
    return [
        pytest.param((kind, mode), id=f'{kind}-{mode}', marks=marks or board)
        for kind, mode, marks in all_
    ]


@pytest.mark.parametrize(
    'made',
    kinds(
        ('serial', 'tension', ()),
        ('serial', 'pull', ()),
    ),
    indirect=True,
)
def test_emulated_motors_find_the_load_and_the_controller_uses_it(made):
    with made.investigating() as process:
        made.until_said(process, 'written: ')
        end = time.monotonic() + 60.0
        while process.poll() is None and time.monotonic() < end:
            made.spin(0.1)
    assert process.returncode == 0, made.said()
    assert 'consistent with tip_load' in made.said()
    assert 'the controller uses it' in made.said()
    data = load_dataset(made.folder / 'found' / 'data')
    high = ROBOT.tension_limits[1]
    if data.input == 'tension':
        assert np.nanmax(data.inputs) <= high


class Hesitating:
    """The part of a running arm that judges a measurement; its controller says these codes."""

    measure, _goes_on = RunningArm.measure, RunningArm._goes_on

    def __init__(self, *codes):
        self.codes = list(codes)

    @property
    def status(self):
        return {'code': self.codes[0]}

    def wait(self, condition, timeout, what, strict=True):
        del self.codes[:-1]
        return condition()

    def _measured(self, inputs, trials):
        raise TendonRobotError(f'the controller says {self.codes[0]}')


@pytest.mark.parametrize('codes', [('no_driver', 'holding'), ('holding',)])
def test_a_driver_that_was_late_breaks_a_measurement_and_not_the_investigation(codes):
    with pytest.raises(BrokenMeasurementError, match='it goes on'):
        Hesitating(*codes).measure(np.zeros(4), 1)


@pytest.mark.parametrize('codes', [('stopped',), ('driver_stopped',), ('no_driver', 'no_driver')])
def test_a_robot_that_is_stopped_or_gone_ends_the_investigation(codes):
    with pytest.raises(TendonRobotError, match=f'says {codes[0]}$') as caught:
        Hesitating(*codes).measure(np.zeros(4), 1)
    assert not isinstance(caught.value, BrokenMeasurementError)


@pytest.mark.parametrize(
    'made', kinds(('serial', 'tension', (pytest.mark.ros, needs_compiler))), indirect=True
)
def test_interrupted_it_lets_the_arm_go_and_keeps_what_it_has(made):
    with made.investigating() as process:
        made.until_said(process, 'posture 3:')
        made.until(lambda: made.tensions.max() > 0.3, 'the third posture')
        process.send_signal(signal.SIGINT)
        end = time.monotonic() + 60.0
        while process.poll() is None and time.monotonic() < end:
            made.spin(0.1)
        assert process.returncode == 130
        made.spin(1.0)
        assert made.tensions.max() < 0.3
        assert list(last(made.commands).effort) == pytest.approx([ROBOT.tension_limits[0]] * 4)
    assert len(load_dataset(made.folder / 'found' / 'data').postures) == 2
