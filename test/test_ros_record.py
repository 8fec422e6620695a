"""A running robot is recorded; the recording is compared, diagnosed, drawn and replayed."""

import itertools
import math
import os
import re
import signal
import time

import numpy as np
import processes
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('rosbags')

from arms import coarse
from builtin_interfaces.msg import Duration
from forked import Forked
from geometry_msgs.msg import TransformStamped
from ros_station import INPUTS, PATIENT, holding, last, stamp
from rosbags.highlevel import AnyReader
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.data.loading import import_bag
from tendon_robot_ros.robot import dump_robot
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED

pytestmark = [pytest.mark.ros, pytest.mark.long]
SPACE = '/recorded'
STOOD, RATE = 1.5, PATIENT['driver']['rate']  # [s] in which it is seen at one place, [Hz]
FRAMES = ('', 'kato_10_1_base', 'kato_10_1_tip')
OF_ALL = ('/tf', '/tf_static', '/diagnostics')  # topics that no namespace has
ROBOT = coarse('kato_10_1', 5)  # a diagnosis of it costs less
HIDDEN = ('tendon_stiffness', {'per_tendon': 2.5e-4})


@pytest.fixture(scope='module')
def station(tmp_path_factory):
    """Give a mock arm whose tendons resist bending, which the controller's model lacks."""
    logs = tmp_path_factory.mktemp('logs')
    stiff = ROBOT.with_effect(*HIDDEN)
    config = 'plant: {twin: true}\ntracker: {noise: 0.0002}\nlag: 0.02'
    driver = {'robot': dump_robot(stiff), 'config': config}
    with holding(SPACE, logs, driver=driver, controller={'model': dump_robot(ROBOT)}) as station:
        station.go_to_point(0.0, 0.2)  # from now on its targets are a topic
        # of a type that the wheels of rclpy have: they have no tf2_msgs
        for topic, qos in (('/tf', COMMAND), ('/tf_static', LATCHED)):
            key = topic, TransformStamped
            station._publishers[key] = station.node.create_publisher(TransformStamped, topic, qos)
            station._publishers[key].publish(TransformStamped())
        yield station


def listeners(station):
    names = ['tendon_states', 'tendon_command', 'measured_tip', 'measured_shape']
    names += ['controller/status', 'controller/target_point', *OF_ALL]
    return np.array([station.node.count_subscribers(name) for name in names])


def recorded(station, folder, name, act):
    """Record while something happens."""
    before = listeners(station)
    process = station.begin(folder, 'record', name)
    assert process.stdout.readline() == f'recording to {name}; Ctrl-C ends\n'
    station.until(lambda: (listeners(station) > before).all(), 'the recorder at every topic')
    act()
    station.spin(0.5)
    process.send_signal(signal.SIGINT)
    return station.finish(process)


def tour():
    """Return the tensions (6, 4) [N] of six postures."""
    random, rows = np.random.default_rng(4), np.full((6, 4), 0.2)
    for i, row in enumerate(rows):
        row[[i % 2, 2 + i // 2 % 2]] = random.uniform(0.5, 1.3, 2)
    return rows


def stood(station, row):
    """Tell whether the arm has been seen under these tensions for as long as counts."""
    now = stamp(last(station.states))
    lately, seen = since(station.states, now - STOOD), since(station.tips, now - STOOD)
    if min(len(lately), len(seen)) < 0.5 * STOOD * RATE:
        return False
    return np.abs([m.effort for m in lately] - row).max() < 0.003


def since(heard, time):
    """Return the messages after a time [s]."""
    return [m for _, m in itertools.takewhile(lambda one: stamp(one[1]) > time, reversed(heard))]


def go_to_tensions(station, row):
    """Play a trajectory of one point, and wait until the arm has stood at its end."""
    way = JointTrajectoryPoint(effort=row.tolist(), time_from_start=Duration(nanosec=600_000_000))
    message = JointTrajectory(joint_names=INPUTS, points=[way])

    def taken():
        return np.abs(np.array(last(station.commands).effort) - row).max() < 1e-9

    station.send_until('controller/tendon_trajectory', message, taken, 'the end of the way')
    station.until(lambda: stood(station, row), f'the arm under {row}', 120.0)


@pytest.fixture(scope='module')
def folder(station, tmp_path_factory):
    """Give a folder with the recording of a tour."""
    folder = tmp_path_factory.mktemp('recording')

    def go():
        for row in tour():
            station.send('/tf', TransformStamped())
            go_to_tensions(station, row)

    done = recorded(station, folder, 'run', go)
    assert (done.returncode, done.stderr) == (0, '')
    assert 'messages of ' in done.stdout
    return folder


def test_the_file_holds_definitions_and_every_topic(folder):
    with AnyReader([folder / 'run']) as reader:  # no types but those in the file
        topics = {c.topic: c for c in reader.connections}
        assert all(c.msgdef.data.strip() for c in topics.values())
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            header = getattr(message, 'header', None)
            assert header is None or header.frame_id in FRAMES, connection.topic
    for name in ('tendon_states', 'tendon_command', 'measured_shape', 'controller/status'):
        assert topics[f'{SPACE}/{name}'].msgcount > 10
    assert [topics[name].msgcount for name in OF_ALL[:2]] == [len(tour()), 1]
    assert topics['/diagnostics'].msgcount > 10
    assert topics['/dataset/robot'].msgcount == 1
    content = (folder / 'run' / 'run.mcap').read_bytes()
    assert content.startswith(b'\x89MCAP0\r\n')
    assert content.count(b'ros2msg') >= len(topics)


def test_what_stood_still_is_a_measurement_with_its_noise(folder):
    found = import_bag(folder / 'run').dataset
    assert dump_robot(found.robot) == dump_robot(ROBOT)
    assert found.input == 'tension'
    assert found.path == 'sequence'
    for row in tour():  # a busy machine may add others: the driver releases when it hears nothing
        assert np.abs(found.inputs - row).max(axis=1).min() < 0.005
    assert 1.4e-5 < found.position_noise < 1e-4  # 0.2 mm in 10 to 200 frames: at most 8 s at 25 Hz


def test_it_goes_through_compare_and_diagnose(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    code, done = main(['compare', 'run']), capsys.readouterr()
    assert code == 0, done.err
    assert 'still segments: ' in done.err
    assert 'kato_10_1 (FKM)' in done.out
    assert 'Ask why: ' in done.out
    code, done = main(['diagnose', 'run/run.mcap']), capsys.readouterr()
    assert code == 0, done.err
    said = re.search(
        r'In the description: tendon_stiffness: per_tendon = ([\d.]+) '
        r'(?:± ([\d.]+)|.*\(95 %: ([\d.]+) to ([\d.]+)\))',
        done.out,
    )
    assert said, done.out
    value, half, low, high = (float(number or 'nan') for number in said.groups())
    doubt = 0.5 * (high - low) if math.isnan(half) else half
    assert abs(value - 1e3 * HIDDEN[1]['per_tendon']) < 1.5 * doubt  # 95 %: so 99.7 %
    assert doubt < 0.25 * value  # it says something


def test_it_is_drawn(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    code, done = main(['plot', 'run']), capsys.readouterr()
    progress = 'reading run, '  # where that takes long
    assert (code, [s for s in done.err.splitlines() if not s.startswith(progress)]) == (0, [])
    assert (folder / 'run.png').stat().st_size > 20_000


@pytest.fixture(scope='module')
def short(station, tmp_path_factory):
    """Give a folder with the recording of two targets, and the last command of it."""
    folder = tmp_path_factory.mktemp('short')

    def act():
        station.go_to_point(0.06, 0.17)
        station.spin(0.3)
        station.go_to_point(-0.05, 0.18)

    assert recorded(station, folder, 'targets', act).returncode == 0
    return folder, list(last(station.commands).effort)


def test_its_commands_are_replayed(station, short):
    folder, ended = short
    station.go_to_point(0.0, 0.2)
    assert list(last(station.commands).effort) != pytest.approx(ended, abs=1e-2)
    done = station.finish(station.begin(folder, 'follow', 'targets', '--commands'))
    assert (done.returncode, done.stderr) == (0, '')
    station.spin(0.2)
    assert list(last(station.commands).effort) == pytest.approx(ended, abs=1e-6)


def test_its_targets_are_replayed(station, short):
    folder, _ = short
    station.go_to_point(0.0, 0.2)
    began = time.monotonic()
    done = station.finish(station.begin(folder, 'follow', 'targets'))
    assert (done.returncode, done.stderr) == (0, '')
    assert '60.0, 0.0, 170.0' in done.stdout
    assert '-50.0, 0.0, 180.0' in done.stdout
    places = np.array(
        [(m.pose.position.x, m.pose.position.z) for at, m in station.tips if at > began]
    )
    for target in ((0.06, 0.17), (-0.05, 0.18)):
        assert np.linalg.norm(places - target, axis=1).min() < 0.03


def test_a_recording_that_is_not_there_is_said(station, tmp_path):
    done = station.finish(station.begin(tmp_path, 'follow', 'targets.mcap', '--picture', 'a.png'))
    assert done.returncode == 1
    assert 'targets.mcap: is not there' in done.stderr


def test_where_nothing_runs_it_says_so(tmp_path):
    command = ['record', 'none', '--duration', '1', '--ros-args', '-r', '__ns:=/nobody']
    alone = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}  # /diagnostics has no namespace
    pipes = {'stdout': processes.PIPE, 'stderr': processes.PIPE}
    with Forked(command, cwd=tmp_path, env=alone, **pipes) as process:
        told, _ = process.communicate(timeout=60)
    assert process.returncode == 1
    assert 'nothing was published here: is the robot running, in this namespace?' in told
