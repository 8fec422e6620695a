"""follow, go-to and the example as a user runs them, against controller and mock driver."""

import json
import os
import sys

import numpy as np
import processes
import pytest

pytest.importorskip('rclpy')

from documents import environment
from forked import Forked
from plain import plain_numbers
from ros_station import INPUTS, held, holding, last, values
from source_tree import ROOT
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytestmark = [pytest.mark.ros, pytest.mark.long]
SPACE = '/follow'
PATH = """\
time,x,y,z
0,0.03,0,0.19
1,0.05,0,0.18
2,0.05,0,0.17
"""


station = held(SPACE)


def command(station, folder, *arguments):
    """Run a command while the station listens."""
    return station.finish(station.begin(folder, *arguments), 90.0)


def commanded(station):
    station.spin(0.2)
    return np.array(last(station.commands).effort)


def test_go_to_says_where_the_tip_went(station, tmp_path):
    done = command(station, tmp_path, 'go-to', '60', '0', '170')
    assert done.stdout.startswith('tip at (60.0, 0.0, 170.0) mm: 0.00 mm from the target'), done
    assert (done.returncode, done.stderr) == (0, '')
    done = command(station, tmp_path, 'go-to', '0.06', '0', '0.17')
    assert (done.returncode, done.stderr) == (
        1, 'error: target: 0.06 0 0.17 mm is 0.1803 mm from the base; if m is meant, say '
        '--unit m\n'
    )  # fmt: skip
    done = command(station, tmp_path, 'go-to', '0', '0', '29', '--unit', 'cm')
    assert 'as near as it can, 82.00 mm' in done.stdout
    done = command(station, tmp_path, 'go-to', '0', '0', '900')
    assert done.returncode == 1
    assert 'refused_too_far' in done.stderr
    assert done.stderr.count('\n') == 1


@pytest.mark.parametrize(
    ('node', 'what', 'key'),
    [('controller', 'control', 'position_error (m)'), ('driver', 'motors', 'lag (s)')],
)
def test_a_status_names_node_and_arm_and_holds_plain_numbers(station, node, what, key):
    station.go_to_point(0.03, 0.19)
    status = last(getattr(station, node))
    assert status.name == f'follow/{node}: {what}'
    assert status.hardware_id == 'kato_10_1'
    plain_numbers(values(status))
    assert float(values(status)[key]) < 0.1


def test_a_path_is_followed_reported_and_retreated(station, tmp_path):
    (tmp_path / 'path.csv').write_text(PATH)
    station.go_to_point(0.0, 0.2)
    before = commanded(station)
    station.commands.clear()
    done = command(station, tmp_path, 'follow', 'path.csv', '--retreat', '--tension-rate', '4')
    assert (done.returncode, done.stderr) == (0, '')
    lines = done.stdout.splitlines()
    assert lines[1].split()[:3] == ['row', 'time', '[s]']
    assert lines[4].split()[0] == '3'
    assert '50.0, 0.0, 170.0' in lines[4]
    assert float(lines[4].split()[-2]) < 0.1  # [mm] where it stands
    assert 'on the way: ' in lines[5]
    assert float(lines[5].split(', ')[1].split()[0]) < 1.0  # [mm] across the path
    assert (tmp_path / 'follow.png').stat().st_size > 20_000
    assert lines[-1] == 'retreated by the way flown'
    assert commanded(station) == pytest.approx(before, abs=1e-3)
    efforts = np.array([message.effort for _, message in station.commands])
    assert np.ptp(efforts, axis=0).max() > 0.2
    passed = station.tips[-1][0] - station.tips[0][0]
    assert passed > 2.0


def test_out_of_reach_nothing_moves(station, tmp_path):
    (tmp_path / 'far.csv').write_text('x,y,z\n0.03,0,0.2\n0.08,0,0.2\n')
    before = commanded(station)
    done = command(station, tmp_path, 'follow', 'far.csv')
    assert done.returncode == 1
    assert done.stderr.startswith('error: far.csv: ')
    assert 'out of reach, by up to ' in done.stderr
    assert 'nothing moved (--anyway would)' in done.stderr
    assert commanded(station) == pytest.approx(before)


def test_regions_hold_on_the_way_to_a_path_and_for_the_controller(station, tmp_path):
    """The path lies beyond a ball, and the arm before it."""
    ball = '[{name: lamp, sphere: {centre: [0.05, 0, 0.17], radius: 0.01}}]\n'
    (tmp_path / 'room.yaml').write_text(f'keep_out: {ball}')
    (tmp_path / 'beyond.csv').write_text('x,y,z\n0.07,0,0.165\n0.072,0,0.165\n')
    station.go_to_point(0.03, 0.175)
    before = commanded(station)
    done = command(station, tmp_path, 'follow', 'beyond.csv', '--keep-out', 'room.yaml')
    assert done.returncode == 1
    assert done.stderr.startswith('error: beyond.csv: at ') and 'would enter lamp' in done.stderr
    assert commanded(station) == pytest.approx(before)
    post = '{keep_out: [{name: post, sphere: {centre: [0, 0.1, 0.1], radius: 0.01}}]}'
    assert station.set('controller', 'keep_out', post).successful
    station.tips.clear()
    done = command(
        station, tmp_path, 'follow', 'beyond.csv', '--keep-out', 'room.yaml', '--anyway'
    )
    assert values(last(station.controller))['kept_out_of'] == 'lamp', done
    away = [message.pose.position for _, message in station.tips]
    assert min(np.hypot(at.x - 0.05, at.z - 0.17) for at in away) > 0.0095
    assert station.text('controller', 'keep_out') == post
    assert station.set('controller', 'keep_out', '').successful


def test_with_json_nothing_else_is_on_stdout(station, tmp_path):
    (tmp_path / 'tensions.csv').write_text(f'time,{",".join(INPUTS)}\n0,0.5,0.1,0.1,0.5\n')
    done = command(station, tmp_path, 'follow', 'tensions.csv', '--json', '--retreat')
    assert json.loads(done.stdout)['picture'] == 'follow.png'
    assert done.stderr.splitlines() == [
        '1 rows of tensions, 0.0 s', 'retreated by the way flown'
    ]  # fmt: skip


def test_tensions_from_a_file_are_played(station, tmp_path):
    rows = ['time,' + ','.join(INPUTS), '0,0.5,0.1,0.1,0.5', '1,0.9,0.1,0.1,0.7']
    (tmp_path / 'tensions.csv').write_text('\n'.join(rows) + '\n')
    done = command(station, tmp_path, 'follow', 'tensions.csv')
    assert (done.returncode, done.stderr) == (0, '')
    assert '0.90, 0.10, 0.10, 0.70' in done.stdout
    assert commanded(station) == pytest.approx([0.9, 0.1, 0.1, 0.7])
    rows[2] = '1,5.9,0.1,0.1,0.7'
    (tmp_path / 'tensions.csv').write_text('\n'.join(rows) + '\n')
    done = command(station, tmp_path, 'follow', 'tensions.csv')
    assert done.returncode == 1
    assert 'refused_limits' in done.stderr
    assert 'prox_left: expected 0.1 to 5 N, got 5.9' in done.stderr
    assert commanded(station) == pytest.approx([0.9, 0.1, 0.1, 0.7])


def test_a_trajectory_as_a_topic_is_played_or_refused_with_its_reason(station):
    message = JointTrajectory(joint_names=list(INPUTS))
    point = JointTrajectoryPoint(effort=[1.0, 0.1, 0.1, 0.4])
    point.time_from_start.nanosec = 500_000_000
    message.points = [point]
    station.send('controller/tendon_trajectory', message)
    station.until_code(station.controller, 'played')
    assert commanded(station) == pytest.approx([1.0, 0.1, 0.1, 0.4])
    message.points = [JointTrajectoryPoint(positions=[0.0] * 4)]
    station.send('controller/tendon_trajectory', message)
    station.until_code(station.controller, 'refused_mode')
    assert 'is in tension mode: expected effort, got none' in last(station.controller).message
    message.joint_names[0] = 'prox_middle'
    message.points = [point]
    station.send('controller/tendon_trajectory', message)
    station.until_code(station.controller, 'refused_names')
    message.points = []
    station.send('controller/tendon_trajectory', message)
    station.until_code(station.controller, 'holding')
    assert values(last(station.controller))['code'] == 'holding'


def test_a_long_trajectory_does_not_stall_the_commands(station):
    message = JointTrajectory(joint_names=list(INPUTS))
    for i in range(500):
        point = JointTrajectoryPoint(effort=[1.0 + 0.3 * np.sin(0.04 * i), 0.1, 0.1, 0.4])
        point.time_from_start.nanosec = (i % 250) * 4_000_000
        point.time_from_start.sec = i // 250
        message.points.append(point)
    station.commands.clear()
    station.driver.clear()
    station.send('controller/tendon_trajectory', message)
    station.until_code(station.controller, 'played')
    assert not [m for _, m in station.driver if values(m)['code'] != 'following']


def test_without_a_controller_it_says_what_to_look_for(tmp_path):
    (tmp_path / 'path.csv').write_text(PATH)
    less_patient = (
        'from functools import partialmethod\n'
        'from tendon_robot_ros.cli.main import main\n'
        'from tendon_robot_ros.ros.shared.robot_client import Pilot\n'
        'Pilot.connect = partialmethod(Pilot.connect, 3.0)\n'
        'raise SystemExit(main(["follow", "path.csv", "--controller", "none"]))\n'
    )
    pipes = {'stdout': processes.PIPE, 'stderr': processes.PIPE}
    with Forked(['-c', less_patient], cwd=tmp_path, env=environment(), **pipes) as process:
        _, told = process.communicate(timeout=60)
    assert process.returncode == 1
    assert 'waited 3 s in vain for ' in told
    assert 'are driver and controller running, in this namespace and ROS_DOMAIN_ID?' in told


def test_the_example_sends_the_tip_to_a_point(tmp_path):
    with holding('/', tmp_path):
        run = processes.run(
            [sys.executable, ROOT / 'examples' / 'go_to.py', '60', '170'],
            timeout=60,
            env=os.environ,
        )
    assert run.stdout == 'tip at (60.0, 0.0, 170.0) mm\n', run.stderr
