"""The viewer as a process: it is there first, survives the others, and says what it needs."""

import urllib.request

import numpy as np
import processes
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('viser')

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseArray, PoseStamped
from ros_station import LATCHED, ForkedNode, Station, last, start, values
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.shared.interface import LISTEN
from tendon_robot_ros.ros.shared.messages import pose_array
from tendon_robot_ros.ros.shared.runtime import ros
from tendon_robot_ros.ros.viewer.node import ViewerNode

pytestmark = pytest.mark.ros
LOADED = 120.0  # [s] a busy machine may need to load the model


@pytest.fixture
def shown(request, tmp_path):
    """Start a viewer; give the station, its log and its port."""
    made = []

    def make(**parameters):
        space, port = f'/{request.node.name[:40]}', processes.free_port()
        log = (tmp_path / 'viewer.log').open('w+')
        made.append(log)
        made.insert(0, ForkedNode('viewer', {'port': float(port), **parameters}, space, log))
        station = Station(space)
        made.append(station)
        station.viewer = station.hear(DiagnosticStatus, 'viewer/status', LATCHED)
        station.until_code(station.viewer, 'serving', timeout=LOADED)
        return station, tmp_path / 'viewer.log', port

    yield make
    for one in made:
        (one.end if isinstance(one, ForkedNode) else one.close)()


def hears(station, *names):
    station.until(
        lambda: values(last(station.viewer))['hears'] == ', '.join(names), f'{names}', LOADED
    )


def test_it_survives_that_all_others_come_go_and_come_again(shown, tmp_path):
    station, _, port = shown()
    hears(station)
    for _ in range(2):
        with (
            start('driver', station.namespace, tmp_path) as driver,
            start('controller', station.namespace, tmp_path) as controller,
        ):
            hears(station, 'controller', 'driver')
            driver.process.kill()
            controller.process.kill()
        hears(station)
        with urllib.request.urlopen(f'http://127.0.0.1:{port}', timeout=30.0) as answer:
            assert answer.status == 200


def test_what_it_cannot_show_does_not_end_it(shown, tmp_path):
    station, log, _ = shown()
    described = tmp_path / 'arm.yaml'
    described.write_text(dump_robot(load_robot('kato_10_1')))
    with start('controller', station.namespace, tmp_path, model=str(described)):
        hears(station, 'controller')
        described.write_text('name: half of')  # as an editor leaves it for a moment
        station.until(lambda: 'the model of the controller: ' in log.read_text(), 'its word')
    for topic, message in (
        ('monitor/measured', PoseArray()),  # of a tracker that sees nothing
        ('tendon_states', JointState(name=['one', 'two'], effort=[1.0])),
    ):
        for _ in range(5):  # one alone might be lost
            station.send(topic, message)
            station.spin(0.1)
    before = len(station.viewer)
    station.until(lambda: len(station.viewer) > before + 1, 'that it goes on')


def test_beyond_this_machine_it_draws_a_token(shown):
    _, log, _ = shown(host='0.0.0.0')
    assert 'token for commands from the page: ' in log.read_text()


def test_a_tracker_in_a_frame_of_its_own_moves_neither_the_arm_nor_a_target():
    base, arm = Header(frame_id='base'), np.ones((2, 3))
    port = f'port:={processes.free_port()}'
    rclpy.try_shutdown()  # a station before has begun without these arguments
    with ros(['--ros-args', '-r', '__ns:=/framed', '-p', port]):
        viewer, station = ViewerNode(), Station('/framed')
        station.executor.add_node(viewer)
        try:
            tracker = station.node.create_publisher(PoseArray, 'measured_shape', LISTEN)
            targets = station.hear(PointStamped, 'controller/target_point')

            def measure():
                tracker.publish(pose_array(Header(frame_id='camera'), -arm))
                station.send('controller/predicted_tip', PoseStamped(header=base))
                station.send('monitor/measured', pose_array(base, arm))
                viewer.page.commands.put(('target', (0.05, 0.0, 0.1)))

            station.repeat(measure, 1.0, lambda: targets, 'a target')
            assert {message.header.frame_id for _, message in targets} == {'base'}
            assert np.array_equal(viewer.state.measured, arm)
        finally:
            viewer.end()
            station.close()
            viewer.destroy_node()
