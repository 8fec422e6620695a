"""The keyboard moves the tip while a key repeats, and never longer."""

import os
import pty
import sys
import time
from types import SimpleNamespace

import processes
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from forked import Forked
from geometry_msgs.msg import TwistStamped
from ros_station import Station, last

from tendon_robot_ros.ros.commands.teleop import MOVES, Deadman, TeleopNode

pytestmark = pytest.mark.ros


def test_a_key_counts_until_it_no_longer_repeats():
    deadman = Deadman(hold=0.15)
    assert deadman.velocity(0.0, 0.01, 0.3) is None
    deadman.press('d', 1.0)
    assert deadman.velocity(1.1, 0.01, 0.3) == pytest.approx([0.01, 0, 0, 0, 0, 0])
    deadman.press('d', 1.1)
    assert deadman.velocity(1.2, 0.01, 0.3) is not None
    assert deadman.velocity(1.26, 0.01, 0.3) is None


def test_every_direction_has_a_key_either_way():
    deadman, moves = Deadman(), set()
    for key in MOVES:
        deadman.press(key, 0.0)
        moves.add(tuple(deadman.velocity(0.1, 0.01, 0.3)))
    assert {tuple(-part for part in move) for move in moves} == moves
    assert all(any(move[axis] for move in moves) for axis in range(5))


@pytest.fixture
def terminal():
    ours, theirs = pty.openpty()
    process = Forked(
        ['teleop', '--ros-args', '-r', '__ns:=/keys'],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    )
    station = Station('/keys')
    yield ours, process, station
    process.kill()
    process.wait()
    station.close()
    os.close(ours)
    os.close(theirs)


def test_held_keys_move_letting_go_stops_and_q_ends(terminal):
    keyboard, process, station = terminal
    twists = station.hear(TwistStamped, 'controller/delta_twist')

    def hold(seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            os.write(keyboard, b'd')
            station.spin(0.03)

    station.until(
        lambda: station.node.count_publishers('/keys/controller/delta_twist') > 0, 'the teleop'
    )
    station.until(lambda: (hold(0.1), twists)[1], 'a twist')
    assert twists[0][1].twist.linear.x == pytest.approx(0.01)
    assert last(twists).header.frame_id == 'kato_10_1_base'
    station.until(lambda: last(twists).twist.linear.x == 0.0, 'the stop')
    count = len(twists)
    station.spin(0.3)
    assert len(twists) == count  # silence: the controller stops by itself, too
    os.write(keyboard, b'q')
    station.until(lambda: process.poll() is not None, 'the end')
    assert process.returncode == 0


def test_without_a_terminal_it_says_so():
    run = processes.run(
        [sys.executable, '-m', 'tendon_robot_ros', 'teleop'],
        stdin=processes.DEVNULL,
        timeout=30,
    )
    assert run.returncode == 1
    assert run.stderr == (
        'error: teleop: expected a terminal to read keys from, got a pipe or file\n'
    )


def test_it_tells_once_why_the_tip_does_not_move(capsys):
    node = SimpleNamespace(_problem='')

    def says(code, message):
        values = [KeyValue(key='code', value=code)]
        TeleopNode._receive(node, DiagnosticStatus(message=message, values=values))
        return capsys.readouterr().out

    refused = "delta_twist: frame 'kato_10_1_base', expected 'my_arm_base' or 'my_arm_tip'"
    assert says('refused_frame', refused) == f'refused_frame: {refused}\n'
    assert says('refused_frame', refused) == ''
    assert says('jogging', 'following a twist') == ''
    assert says('released', 'the driver let go') == 'released: the driver let go\n'
