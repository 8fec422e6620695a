"""The saved views name topics that the nodes really publish, and take, in the right type."""

import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from source_tree import ROOT

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time
from control_rig import ROBOTS
from geometry_msgs.msg import PoseArray
from ros_station import ForkedNode, holding, last
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.urdf import joint_angles, joint_names, transforms, urdf
from tendon_robot_ros.ros.commands.robot_model import stamped
from tendon_robot_ros.ros.shared.interface import LATCHED

SPACE = '/views'
RVIZ = yaml.safe_load((ROOT / 'config' / 'robot.rviz').read_text())['Visualization Manager']
FOXGLOVE = json.loads((ROOT / 'config' / 'foxglove.json').read_text())
TYPES = {
    'RobotModel': 'std_msgs/msg/String',
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'PoseArray': 'geometry_msgs/msg/PoseArray',
    'Pose': 'geometry_msgs/msg/PoseStamped',
    'PublishPoint': 'geometry_msgs/msg/PointStamped',
}


def rviz_topics():
    """Yield topic and type of every display and tool that has one."""
    for item in [*RVIZ['Displays'], *RVIZ['Tools']]:
        topic = item.get('Topic') or item.get('Description Topic')
        if topic:
            yield topic['Value'], TYPES[item['Class'].split('/')[1]], topic


def foxglove_paths():
    """Yield every topic with its message path."""
    for panel, told in FOXGLOVE['configById'].items():
        if panel.startswith('3D!'):
            yield from told['topics']
            yield told['publish']['pointTopic']
            yield told['publish']['poseTopic']
        yield from (path['value'] for path in told.get('paths', ()))
        yield from (told[key] for key in ('topicToRender', 'topicPath') if key in told)


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    logs = tmp_path_factory.mktemp('logs')
    with (
        holding(SPACE, logs) as station,
        ForkedNode('robot-model', {}, SPACE),
        ForkedNode('monitor', {'folder': str(logs), 'force_rate': 5.0}, SPACE),
    ):
        station.described = station.hear(String, 'robot_description', LATCHED)
        station.joints = station.hear(JointState, 'cell_joint_states')
        station.shapes = station.hear(PoseArray, 'controller/predicted_shape')
        station.until(lambda: station.described and station.joints, 'the model', 60.0)
        yield station


def known(station, wanted):
    """Return the types of topics by name, once all that are wanted are discovered."""

    def seen():
        names = station.node.get_topic_names_and_types()
        return {name.removeprefix(SPACE): kinds[0] for name, kinds in names}

    station.until(lambda: not set(wanted) - seen().keys(), f'topics {sorted(wanted)}')
    return seen()


@pytest.mark.ros
def test_rviz_listens_to_topics_that_exist_in_their_type(running):
    found = list(rviz_topics())
    assert len(found) >= 6
    topics = known(running, {'/' + name for name, *_ in found})
    for name, kind, _ in found:
        assert topics['/' + name] == kind, name


@pytest.mark.ros
def test_rviz_hears_what_is_published_reliably_or_not(running):
    known(running, {'/' + name for name, *_ in rviz_topics()})
    for name, _, topic in rviz_topics():
        for publisher in running.node.get_publishers_info_by_topic(f'{SPACE}/{name}'):
            latched = publisher.qos_profile.durability.name == 'TRANSIENT_LOCAL'
            assert latched or topic['Durability Policy'] == 'Volatile'


@pytest.mark.ros
def test_foxglove_plots_fields_that_exist(running):
    paths = list(foxglove_paths())
    assert len(paths) > 12
    topics = known(running, {path.partition('.')[0] for path in paths})
    for path in paths:
        topic, _, fields = path.partition('.')
        assert topic in topics, path
        package, _, name = topics[topic].partition('/msg/')
        kind = getattr(__import__(f'{package}.msg', fromlist=[name]), name)
        message = kind()
        for field in filter(None, re.sub(r'\[\d+\]', '', fields).split('.')):
            message = getattr(message, field)


def test_every_panel_of_the_layout_is_described_and_shown():
    def shown(layout):
        if isinstance(layout, str):
            return {layout}
        return shown(layout['first']) | shown(layout['second'])

    assert shown(FOXGLOVE['layout']) == set(FOXGLOVE['configById'])


@pytest.mark.ros
def test_the_joints_move_the_urdf_to_where_the_model_is(running):
    running.go_to_point(0.06, 0.17)
    robot = load_robot(ROBOTS / 'kato_10_1.yaml')
    text = last(running.described).data
    assert text == urdf(robot, 'kato_10_1_')
    tree = ElementTree.fromstring(text)
    revolute = [j.get('name') for j in tree.iter('joint') if j.get('type') == 'revolute']
    assert list(last(running.joints).name) == revolute == list(joint_names(robot))

    def tip():
        place = np.zeros(3)
        turned = np.eye(3)
        angles = np.array(last(running.joints).position)
        for _, _, rotation, up in transforms(robot, angles, 'kato_10_1_'):
            place = place + turned @ [0.0, 0.0, up]
            turned = turned @ rotation
        return place

    running.until(lambda: np.allclose(tip(), [0.06, 0.0, 0.17], atol=2e-4), 'the tip there')


def test_the_frames_are_those_of_the_urdf_from_base_to_tip():
    robot = load_robot(ROBOTS / 'spatial_6.yaml')
    shape = Model(robot).shape([0.1, 1.5, 0.1, 0.1, 0.1, 1.2])
    angles = joint_angles(robot, shape.frames)
    messages = stamped(robot, angles, 'spatial_6_', Time(sec=1))
    tree = ElementTree.fromstring(urdf(robot, 'spatial_6_'))
    pairs = [
        (j.find('parent').get('link'), j.find('child').get('link')) for j in tree.iter('joint')
    ]
    assert [(m.header.frame_id, m.child_frame_id) for m in messages] == pairs
    assert pairs[0][0] == 'spatial_6_base'
    assert pairs[-1][1] == 'spatial_6_tip'
    place, turned = np.zeros(3), np.eye(3)
    for _, _, rotation, up in transforms(robot, angles, ''):
        place, turned = place + turned @ [0.0, 0.0, up], turned @ rotation
    assert place == pytest.approx(shape.tip_position, abs=1e-9)
    assert turned[:, 2] == pytest.approx(shape.tip_direction, abs=1e-9)
