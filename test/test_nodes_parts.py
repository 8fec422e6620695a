"""Small parts of the nodes: orientations, frames, parameters, files, sequences of a loader."""

import contextlib
import math
import re
import threading
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from source_tree import ROOT

pytest.importorskip('rclpy')

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseArray, PoseStamped, Quaternion
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from ros_station import OWN_EFFECT
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DriverError, InputError, TendonRobotError
from tendon_robot_ros.common.yaml_reading import ConfigFields
from tendon_robot_ros.control import Refusal, loading
from tendon_robot_ros.control.loading import Loader
from tendon_robot_ros.data.path_files import TendonRows
from tendon_robot_ros.drivers.safety import FOLLOWING, Decision
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.paths.path import Pace
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.commands import follow
from tendon_robot_ros.ros.commands.live import MESSAGES_MIN, Director
from tendon_robot_ros.ros.controller import node as controller_node
from tendon_robot_ros.ros.controller.node import ControllerNode
from tendon_robot_ros.ros.driver import backend as driver_backend
from tendon_robot_ros.ros.driver.backend import TrackerConfig
from tendon_robot_ros.ros.driver.node import DriverNode
from tendon_robot_ros.ros.monitor import node as monitor_node
from tendon_robot_ros.ros.monitor import watching
from tendon_robot_ros.ros.monitor.node import MonitorNode
from tendon_robot_ros.ros.monitor.watching import Adapting
from tendon_robot_ros.ros.shared import lifecycle, robot_client
from tendon_robot_ros.ros.shared.messages import Frames
from tendon_robot_ros.ros.shared.parameters import RemoteParameter, Spec, read_config
from tendon_robot_ros.ros.shared.robot_client import Pilot
from tendon_robot_ros.ros.shared.runtime import Ending, ros_arguments


class Clock(contextlib.nullcontext):
    """A clock of a node that stands at 10,000 s."""

    def __init__(self):
        super().__init__()
        self.handle = self

    def get_now(self):
        return SimpleNamespace(nanoseconds=10_000 * 10**9)


def frames():
    made = Frames.__new__(Frames)
    made.base, made._buffer = 'arm_base', None
    made._node = SimpleNamespace(get_clock=Clock, parameters={'stamp_tolerance': 2.0})
    return made


def header(frame, stamp=0.0):
    sec, rest = divmod(round(1e9 * stamp), 10**9)
    return Header(frame_id=frame, stamp=Time(sec=sec, nanosec=rest))


def test_without_tf_only_the_base_frame_will_do():
    rotation, shift = frames().of(header('arm_base'), 'target_pose')
    assert rotation.tolist() == np.eye(3).tolist()
    assert shift.tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(Refusal, match="frame 'map', expected 'arm_base'"):
        frames().of(header('map'), 'target_pose')
    with pytest.raises(Refusal, match="frame 'map', expected 'arm_base' or 'arm_tip'"):
        frames().of(header('map'), 'delta_twist', 'arm_tip')


@pytest.mark.parametrize(
    ('at', 'stamp', 'asked', 'taken'),
    [
        (0, 0.0, [0], True),  # static
        (0, 9999.0, [0], True),
        (6400, 0.0, [0], False),  # 3,600 s old: its publisher has gone
        (6400, 9999.0, [0], False),
        (9999, 0.0, [0], True),
        (9999, 9998.5, [0, 9998], True),  # where the frame was when that was measured
    ],
)
def test_with_tf_another_frame_is_brought_into_that_of_the_base_at_the_time_of_the_message(
    at, stamp, asked, taken
):
    made, times, half = frames(), [], np.sqrt(0.5)
    turned = SimpleNamespace(
        rotation=Quaternion(x=0.0, y=0.0, z=half, w=half),  # a quarter turn about z
        translation=SimpleNamespace(x=0.1, y=0.0, z=0.0),
    )

    def lookup(base, frame, time):
        times.append(time.nanoseconds // 10**9)
        return SimpleNamespace(transform=turned, header=SimpleNamespace(stamp=Time(sec=at)))

    made._buffer = SimpleNamespace(lookup_transform=lookup)
    given = (header('map', stamp), 'target_pose')
    if taken:
        rotation, shift = made.of(*given)
        assert rotation @ [1.0, 0.0, 0.0] + shift == pytest.approx([0.1, 1.0, 0.0])
    else:
        with pytest.raises(Refusal, match=r"transform from 'map' to 'arm_base' is 3.* s old"):
            made.of(*given)
    assert times == asked


@pytest.fixture
def status(monkeypatch):
    """Make the status of a node without ROS: `told`, what was logged, `sent` and `now` [s]."""
    told, sent, now = [], [], [0.0]
    log = SimpleNamespace(info=told.append, warning=told.append, error=told.append)
    node = SimpleNamespace(
        get_fully_qualified_name=lambda: '/driver',
        get_name=lambda: 'driver',
        create_publisher=lambda *given: SimpleNamespace(publish=sent.append),
        get_logger=lambda: log,
    )
    monkeypatch.setattr(lifecycle, 'stamp_now', lambda node: Time())
    monkeypatch.setattr(lifecycle, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    made = lifecycle.Status(node, 'tendon driver')
    made.told, made.sent, made.now = told, sent, now
    return made


def test_a_refusal_right_after_another_word_is_said_and_logged_once(status):
    for status.now[0] in (1.0, 3.5, 6.0):
        status.publish(lifecycle.WARN, 'starting', 'switches torque on')
        status.publish(lifecycle.ERROR, 'not_ready', 'no answer', once=True)
        status.publish(lifecycle.ERROR, 'not_ready', 'no port', once=True)
        assert status.sent[-2].message == 'no port'  # and in /diagnostics
    for status.now[0] in (8.5, 11.0):  # tried again and again
        status.publish(lifecycle.ERROR, 'not_ready', 'no port', once=True)
    assert status.told == 3 * [
        'starting: switches torque on', 'not_ready: no answer', 'not_ready: no port',
    ]  # fmt: skip


def test_the_last_state_that_stays_is_the_last_line_of_the_log(status):
    told, now = status.told, status.now
    for now[0] in np.arange(0.0, 1.9, 0.1):  # it comes and goes, and stays
        code = 'stopped' if now[0] < 0.25 or now[0] > 0.55 else 'following'
        status.publish(lifecycle.OK, code, 'so it is')
    assert told == ['stopped: so it is', 'following: so it is']
    for now[0] in np.arange(1.9, 9.0, 0.1):
        status.publish(lifecycle.OK, 'stopped', 'so it is')
    assert told[2:] == ['stopped: so it is']


def test_values_are_formatted_only_when_they_may_go_out(status):
    formatted = []

    def values():
        formatted.append(status.now[0])
        return {'tension (N)': str(status.now[0] > 0.5)}

    for status.now[0] in 100.0 + 0.02 * np.arange(200):  # unchanged: once a second
        status.publish(lifecycle.OK, 'holding', 'so it is', values)
    assert 35 < len(formatted) <= 40
    assert len(status.sent) in (2 * 4, 2 * 5)  # and in /diagnostics
    published = len(status.sent)
    status.now[0] += 0.02
    status.publish(lifecycle.ERROR, 'holding', 'so it is', values)  # news: at once
    status.publish(lifecycle.ERROR, 'holding', 'so it is', values, ['overload'])  # 20 ms later
    status.now[0] += 0.021
    status.publish(lifecycle.ERROR, 'holding', 'so it is', values, ['overload'])
    assert len(status.sent) == published + 4


@pytest.mark.parametrize('lag', [0.02, 0.05, 0.1, 0.15])
def test_a_tip_is_told_where_it_stands_however_slowly_the_motors_come_to_rest(monkeypatch, lag):
    monkeypatch.setattr(robot_client, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    pilot, now, there = Pilot.__new__(Pilot), [0.0], np.array([0.06, 0.0, 0.17])
    pilot._tips = {'measured': [], 'predicted': []}

    def spin(seconds):
        for at in np.arange(now[0], now[0] + seconds, 0.01) + 0.01:
            off = 0.08 * np.exp(-at / lag) * np.array([1.0, 0.0, -1.0])
            pilot._tips['measured'].append((at, there + off, np.array([0.0, 0.0, 1.0])))
            now[0] = at

    pilot.spin = spin
    pilot.stand()
    assert pilot.tip()[0] == pytest.approx(there, abs=3e-5)


def test_a_tip_that_the_tracker_lost_on_the_way_is_where_the_model_says(monkeypatch):
    pilot, there, way = Pilot.__new__(Pilot), np.array([0.06, 0.0, 0.17]), np.zeros(3)
    monkeypatch.setattr(robot_client, 'time', SimpleNamespace(monotonic=lambda: 5.0))
    rows = [(at, there, np.array([0.0, 0.0, 1.0])) for at in np.arange(0.0, 5.0, 0.1)]
    lost = [(at, way, view) for at, _, view in rows if at < 1.0]
    pilot._tips = {'measured': lost, 'predicted': rows}
    assert pilot.tip()[0] == pytest.approx(there) and not pilot.tips()[0]


def test_a_frame_in_which_the_tip_is_not_seen_is_no_place_of_it():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    pilot = Pilot('pilot', Ending())
    try:
        take = next(one.callback for one in pilot.subscriptions if 'measured' in one.topic_name)
        for x in (0.06, math.nan, 0.06):
            message = PoseStamped()
            message.pose.position.x = x
            take(message)
        assert len(pilot._tips['measured']) == 2
    finally:
        pilot.destroy_node()
        rclpy.shutdown()


def test_a_tip_error_is_the_mean_of_enough_frames_since_the_arm_stands_however_few_there_are():
    director = Director.__new__(Director)
    moving, off = np.array([0.01, 0.0, 0.0]), np.array([0.0, 0.003, 0.004])
    for rate in (30, 5):  # [Hz] that a busy machine hears
        times = np.arange(2 * rate + 15) / rate
        seen = [(at, moving if at < 2.0 else off) for at in times]
        director._errors, director._standing_since = seen, 2.0 - 1e-9
        assert len(director._standing()) == MESSAGES_MIN
        assert director.error() == pytest.approx(off)
        director._standing_since = 2.0 + 1e-9  # one frame less
        assert len(director._standing()) == MESSAGES_MIN - 1
    director._errors = [(3.0, np.full(3, np.nan))] * 20
    assert np.isnan(director.error()).all()


@pytest.mark.parametrize(
    ('spec', 'value', 'expected'),
    [
        (Spec('x', 1.0, '', 'm', 0.0, 10.0), 3, 3.0),
        (Spec('x', [''], ''), ['', 'a.py'], ['a.py']),
        (Spec('x', 'a', '', choices=('a', 'b')), 'b', 'b'),
        (Spec('x', False, ''), True, True),
    ],
)
def test_a_parameter_takes_what_fits(spec, value, expected):
    assert spec.checked(value) == expected


@pytest.mark.parametrize(
    ('spec', 'value', 'words'),
    [
        (Spec('x', 1.0, '', 'm', 0.0, 10.0), 11.0, 'x: expected 0 to 10 m, got 11'),
        (Spec('x', 1.0, '', 'm', 0.0, 10.0), float('nan'), 'x: expected 0 to 10 m, got nan'),
        (Spec('x', 1.0, ''), True, 'x: expected a number, got True'),
        (Spec('x', False, ''), 1, 'x: expected true or false, got 1'),
        (Spec('x', 'a', '', choices=('a', 'b')), 'c', "x: expected one of a, b, got 'c'"),
    ],
)
def test_a_parameter_refuses_what_does_not_fit(spec, value, words):
    with pytest.raises(InputError, match=words):
        spec.checked(value)


REGION = '[{name: lamp, sphere: {centre: [0.1, 0, 0.1], radius: 0.02}}]'


def test_parameters_that_are_refused_together_leave_everything_as_it_was():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = ControllerNode()
    try:
        region = Parameter('keep_out', value=f'keep_out: {REGION}')
        assert node.set_parameters_atomically([region]).successful
        bad = Parameter('prefer_stiffness_along', value='upwards')
        others = Parameter('keep_out', value=''), Parameter('model', value='kato_10_1')
        result = node.set_parameters_atomically([*others, bad])
        assert not result.successful and 'upwards' in result.reason
        assert node.set_parameters([Parameter('rate_limit', value=5.0)])[0].successful
        assert node._keep_out and node.parameters['keep_out'] == region.value
        assert not node._loading.change_requested
    finally:
        node._loading.cancel()
        node.destroy_node()
        rclpy.shutdown()


def test_an_attempt_to_configure_that_is_refused_starts_no_thread(monkeypatch):
    started, node = [], MagicMock(parameters={'keep_out': 'nowhere.yaml'})
    monkeypatch.setattr(controller_node, 'Worker', started.append)
    with pytest.raises(InputError, match='nowhere'):
        ControllerNode.configure(node)
    assert not started


def test_a_refusal_may_end_while_the_driver_says_its_status():
    node = MagicMock()
    decision = Decision(np.zeros(2), (), FOLLOWING)
    node._cycle = SimpleNamespace(decision=decision, held='', faults=())
    node._own.others.return_value = node._senders.names.return_value = ''
    refusals = iter([Refusal('stale', 'too old'), None, None])
    # the motor thread takes a good command meanwhile
    type(node)._refusal = property(lambda node: next(refusals))
    DriverNode._publish_status(node)
    assert node.status.publish.call_args.args[1:3] == (
        'refused_stale',
        'too old; following commands',
    )


@pytest.fixture
def monitor(monkeypatch):
    """Make what a monitor says of itself that compares with kato_10_1."""
    monkeypatch.setattr(monitor_node, 'Loader', MagicMock())
    node = MagicMock(_problem='', _unusable='', _in_use='kato_10_1', _loading='kato_10_1')
    node.monitor.model.inputs, node.monitor.problem = ('one', 'two'), ''
    node._measured.problem, node._last_error, node._frame_at = '', 1e-3, np.inf
    node.watching = None
    node.code = lambda: MonitorNode._condition(node)[1]
    return node


def test_a_monitor_compares_again_after_states_of_another_robot(monitor):
    MonitorNode._states(monitor, JointState(name=['others'], effort=[1.0]))
    assert monitor.code() == 'problem'
    MonitorNode._states(monitor, JointState(name=['one', 'two'], effort=[1.0, 1.0]))
    assert monitor.code() == 'comparing'


def test_a_shape_with_another_number_of_poses_is_refused():
    tracker, message = MagicMock(markers=range(30)), PoseArray(poses=3 * [Pose()])
    with pytest.raises(Refusal, match='measured_shape: expected 30 poses, one for each of the'):
        monitor_node.MarkerInput._shape(tracker, message)


@pytest.mark.parametrize('other', ['nowhere.yaml', 'spatial_3'])
def test_a_monitor_compares_again_after_the_controller_has_gone_back_to_its_model(monitor, other):
    MonitorNode._load(monitor, other)
    assert (monitor.code() == 'problem') == (other == 'nowhere.yaml')
    MonitorNode._load(monitor, 'kato_10_1')
    assert monitor.code() == 'comparing'
    assert monitor._loader is None and monitor._loading == 'kato_10_1'


def test_a_value_that_another_one_replaces_before_it_is_answered_is_answered_too():
    answers, pending, remote = [], [], RemoteParameter(MagicMock(), 'controller', 'model')
    remote._set = SimpleNamespace(ask=lambda request, done: pending.append(done) or True)
    for value in ('one', 'two'):
        remote.put(value, lambda *answer, value=value: answers.append((value, *answer)))
    assert answers == [('one', False, 'another value took its place')]
    pending[-1](SimpleNamespace(result=SimpleNamespace(successful=True, reason='')))
    remote.put('three', lambda *answer: None)
    assert answers[1:] == [('two', True, '')]


def test_an_undo_that_the_controller_refuses_can_be_asked_for_again(monkeypatch):
    answers, robots = [], [load_robot('kato_10_1'), load_robot('kato_10_1_single')]
    adaptation = SimpleNamespace(robot=robots[1], changes=[])

    def undo():
        adaptation.robot = adaptation.changes.pop().robot
        return MagicMock(parameters=())

    adaptation.undo = undo
    first, second = SimpleNamespace(robot=robots[0]), SimpleNamespace(robot=robots[0])
    adaptation.changes = [first, second]
    monkeypatch.setattr(Adapting, '_begin', lambda self, model: None)
    monkeypatch.setattr(Adapting, '_log_change', lambda *_: None)
    monkeypatch.setattr(watching.interface, 'topic', lambda name: ())
    adapting = Adapting(
        MagicMock(), MagicMock(), 'kato_10_1', lambda _, answer: answers.append(answer)
    )
    adapting._adaptation = adaptation
    adapting.undo()
    answers.pop()(False, 'it does not answer')
    assert adaptation.changes == [first, second] and adaptation.robot is robots[1]
    adapting.undo()
    answers.pop()(True, '')
    assert adaptation.changes == [first]


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('a: [', 'config: not valid YAML: line 1: '),
        ('a: ' + '[' * 3000, 'config: not valid YAML: brackets nested too deeply'),
        ('a: 2000-99-99', 'config: not valid YAML: month must be in 1..12'),
        ('- a: 1', 'config: expected keys with values'),
        ('nowhere', 'config: nowhere: No such file'),
        ('/dev/zero', 'config: /dev/zero: not a text file'),
    ],
)
def test_a_configuration_that_cannot_be_read_says_why(text, words):
    with pytest.raises(InputError, match=words):
        read_config(text)


@pytest.mark.parametrize('text', ['', 'mock', 'mock_twin'])
@pytest.mark.parametrize('backend', ['dynamixel', 'serial', 'ros2_control'])
@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_motors_without_a_configuration_of_theirs_say_what_is_missing(backend, mode, text):
    given = {'backend': backend, 'config': text, 'command_mode': mode}
    with pytest.raises(InputError) as told:
        driver_backend.make(load_robot('kato_10_1'), given, None)
    words = rf'configuration of the motors for backend {backend}, got (none|that of the mock arm)'
    assert re.search(words, str(told.value))
    example = re.search(r'copy (config/\w+\.yaml), put in your motors', str(told.value)).group(1)
    assert (ROOT / example).is_file()


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        ({'rate': 0}, 'tracker.rate: expected a finite number from 0.1 to 1000 .Hz., got 0'),
        ({'rate': 'fast'}, 'tracker.rate: expected a number from'),
        ({'noise': -1}, 'tracker.noise: expected a finite number from 0'),
        ({'seed': -3}, 'tracker.seed: expected a finite number from 0'),
        ({'missing': 2}, 'tracker.missing: expected a finite number from 0 to 1'),
        ({'speed': 1}, "tracker.speed: expected one of rate, noise, .*got 'speed'"),
        (30, 'tracker: expected keys with values, got 30'),
    ],
)
def test_an_impossible_tracker_of_the_mock_arm_is_refused(content, words):
    with pytest.raises(DriverError, match=words):
        ConfigFields('config', 'tracker', content).read(TrackerConfig)


@pytest.mark.parametrize(
    ('plant', 'words'),
    [
        (3, 'config: plant: expected keys with values, got 3'),
        ({'hiden': {}}, "config: plant.hiden: expected one of hidden, .*got 'hiden'"),
        ({'twin': 3}, 'config: plant.twin: expected true or false, got 3'),
    ],
)
def test_an_impossible_mock_arm_is_refused(plant, words):
    given = {'backend': 'mock', 'config': str({'plant': plant}), 'command_mode': 'tension'}
    with pytest.raises(DriverError, match=words):
        driver_backend.make(load_robot('kato_10_1'), given, None)


@pytest.mark.parametrize('plant', [{'twin': True}, {'refine': 1}], ids=lambda p: '-'.join(p))
def test_a_mock_arm_has_effects_of_the_users_own(tmp_path, plant):
    file = tmp_path / 'own.py'
    file.write_text(OWN_EFFECT)
    robot = load_robot('kato_10_1').with_effect('own', {'change': 0.1})
    config = str({'plant': plant | {'catalogue': [str(file)]}})
    given = {'backend': 'mock', 'config': config, 'command_mode': 'tension'}
    driver, _ = driver_backend.make(robot, given, None)
    assert 'own' in driver.plant.model.robot.effects


def test_a_configuration_comes_from_a_name_or_text():
    assert read_config('mock_twin')['plant'] == {'twin': True}
    assert read_config('{lag: 0.1}') == {'lag': 0.1}
    long = {f'number_{i}': i for i in range(40)}  # longer than the name of a file may be
    assert read_config(str(long)) == long
    assert read_config('') == {}


@pytest.mark.parametrize('text', ['plain', 'with "quotes" and \\', 'two\nlines: true', ''])
def test_text_passes_the_command_line_as_text(text):
    import yaml

    *_, argument = ros_arguments({'said': text}, '/')
    assert yaml.safe_load(argument.removeprefix('said:=')) == text


def test_a_loader_tells_what_takes_so_long(monkeypatch, tmp_path):
    robot, doing = load_robot('kato_10_1'), []
    monkeypatch.setattr(loading, 'compiled_mark', lambda catalogue: tmp_path / 'not_there')
    monkeypatch.setattr(Loader, '_compile', lambda loader, _: doing.append(loader.doing))
    monkeypatch.setattr(loading, 'load', lambda *_: doing.append(made.doing))
    gate = threading.Event()

    def read():
        gate.wait(10.0)
        return robot

    made = Loader(read, [])
    assert (made.doing, made.done) == ('loading', False)
    gate.set()
    made.result()
    assert doing == ['compiling', 'building']


@pytest.mark.parametrize(
    ('effect', 'values', 'words'),
    [
        ('magnetism', {'strength': 1.0}, "unknown effect 'magnetism'"),
        ('eyelet_wrap', {'fraction': 7.0}, 'fraction'),
    ],
)
def test_a_loader_says_what_is_wrong_with_an_effect(effect, values, words):
    robot = load_robot('kato_10_1').with_effect(effect, values)
    with pytest.raises(TendonRobotError, match=words):
        Loader(lambda: robot, []).result()


ROOM = 'keep_out: [{name: lamp, sphere: {centre: [0.05, 0, 0.17], radius: 0.01}}]\n'


@pytest.mark.parametrize('pull', [False, True])
def test_a_file_of_the_tendons_is_refused_whose_way_enters_a_region(tmp_path, monkeypatch, pull):
    """Both rows are outside of the ball, the way between them is not."""
    room = tmp_path / 'room.yaml'
    room.write_text(ROOM)
    model = Model(load_robot('kato_10_1'))
    shapes = [
        model.shape(model.limits[:, 0]),
        *(model.reach(tip).shape for tip in ([0.03, 0.0, 0.175], [0.07, 0.0, 0.165])),
    ]
    rows = np.array([shape.pulls if pull else shape.inputs for shape in shapes])
    pilot = SimpleNamespace(
        pull=pull, model=lambda: model, commands=lambda: (np.zeros(1), rows[:1])
    )
    played = []
    monkeypatch.setattr(follow, 'run_tendons', lambda _, when, values: played.append(when))
    options = SimpleNamespace(
        path='wires.csv', backwards=False, plan=False, keep_out=str(room), anyway=False, json=None
    )
    outside = TendonRows(np.array([0.0, 1.0]), rows[:2])
    follow._tendons(pilot, outside, options, Pace())
    assert len(played) == 1
    way = float(np.abs(rows[1] - rows[0]).max())
    rate = Pace().pull if pull else Pace().tension
    assert played[0][0] == pytest.approx(0.05) and played[0][-1] >= way / rate
    into = TendonRows(np.array([0.0, 1.0]), rows[1:])
    with pytest.raises(InputError, match=r'wires.csv: at \d\.\d\d s the arm would enter lamp'):
        follow._tendons(pilot, into, options, Pace())
    assert len(played) == 1
    options.keep_out = None
    follow._tendons(pilot, into, options, Pace())
    assert len(played) == 2


@pytest.mark.ros
def test_a_path_is_planned_with_the_effects_of_the_controllers_user(tmp_path, monkeypatch):
    path = tmp_path / 'own.py'
    path.write_text(OWN_EFFECT)
    # compiling is the business of test_ros_reload.py
    monkeypatch.setattr(robot_client, 'load', lambda robot, catalogue: (robot, catalogue))
    if not rclpy.ok():
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    controller = Node('controller', namespace='/planned')
    controller.declare_parameter('model', 'kato_10_1')
    controller.declare_parameter('effects', [str(path)])
    executor = SingleThreadedExecutor()
    executor.add_node(controller)
    serving = threading.Thread(target=executor.spin)
    serving.start()
    pilot = robot_client.Pilot('pilot', Ending(), namespace='/planned')
    try:
        robot, catalogue = pilot.model()
    finally:
        pilot.destroy_node()
        executor.shutdown()
        serving.join()
        controller.destroy_node()
    assert robot.name == 'kato_10_1'
    assert catalogue['own'].parameters[0].name == 'change'


def test_a_path_or_a_region_that_is_not_there_is_said_before_a_controller_is_asked_for(
    monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(follow, 'Pilot', None)  # asking for it would be no InputError
    there = tmp_path / 'path.csv'
    there.write_text('x,y,z\n0,0,0.1\n')
    assert main(['follow', str(tmp_path / 'none.csv')]) == 1
    assert 'none.csv: cannot be read (No such file or directory); name' in capsys.readouterr().err
    assert main(['follow', str(there), '--keep-out', str(tmp_path / 'none.yaml')]) == 1
    assert 'none.yaml: cannot be read' in capsys.readouterr().err
