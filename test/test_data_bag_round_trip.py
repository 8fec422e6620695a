"""A data set goes into a recording and comes back the same."""

import dataclasses

import numpy as np
import pytest
from measurements import TENTACLE, blind
from numpy.testing import assert_array_equal
from small_dataset import INPUTS, SHAPES, assert_same, write

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.data import load_dataset, save_dataset

pytest.importorskip('rosbags')

from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from tendon_robot_ros.data.bag_reader import poses_of
from tendon_robot_ros.data.bag_writer import POSE_ARRAY, Timing, export_bag
from tendon_robot_ros.data.loading import import_bag

QUICK = Timing(hold=1.0, move=0.2, rate=20.0)


@pytest.mark.parametrize(
    ('folder', 'storage', 'name'),
    [
        (TENTACLE, 'mcap', 'one.mcap'),
        (blind('b') / 'check', 'mcap', 'folder'),
        (blind('h') / 'check', 'sqlite3', 'folder'),
    ],
)
def test_folder_to_recording_to_folder(folder, storage, name, tmp_path):
    data = load_dataset(folder)
    bag = export_bag(data, tmp_path / name, storage, QUICK)
    imported = import_bag(bag)
    assert imported.left_out == ()
    copy = load_dataset(save_dataset(imported.dataset, tmp_path / 'copy'))
    assert_same(copy, data)
    assert copy.robot == dataclasses.replace(data.robot, source=copy.robot.source)


SPECIAL = {
    'slack tendons': {
        'dataset': 'input: displacement',
        'inputs': 'posture,left,right\n0,0.001,\n1,,0.002\n',
    },
    'missing markers': {},
    'everything described': {
        'dataset': 'gravity: [0, 9.81, 0]\nposition_noise: 1e-4\naccuracy: 1e-3\n'
        'tension_noise: {setting: 0.01, trial: 0.02}\n'
        'markers: [{name: 3, arc_length: 0.01}, '
        '{name: 1, arc_length: 0.02, offset: [0, 1e-3, 0]}]',
        'shapes': ''.join(line for line in SHAPES.splitlines(True) if ',2,' not in line),
    },
    'inputs of every trial': {
        'inputs': 'posture,trial,left,right\n0,0,0.5,0\n0,1,0.75,0\n1,0,1,0.25\n'
    },
    'sequence with a posture that was not measured': {
        'dataset': 'path: sequence',
        'inputs': INPUTS.replace('1,1.0', 'the turn,2,2\n1,1.0'),
        'shapes': SHAPES + '1,1,1,0.0021,0.0,0.0101\n',
    },
    'orientations': {
        'shapes': 'posture,trial,marker,x,y,z,qx,qy,qz,qw\n0,0,1,0,0,0.01,0,1,0,0\n'
        '0,1,1,0,0,0.01,,,,\n1,0,1,0,0,0.01,0,0,0,-1\n'
    },
}


@pytest.mark.parametrize('changed', SPECIAL.values(), ids=SPECIAL)
def test_everything_survives(changed, tmp_path):
    data = load_dataset(write(tmp_path / 'small', **changed))
    copy = load_dataset(save_dataset(data, tmp_path / 'copy'))
    for again in (copy, import_bag(export_bag(data, tmp_path / 'a.mcap', timing=QUICK)).dataset):
        assert_same(again, data)


def test_a_recording_names_its_types_and_latches_what_it_says_once(tmp_path):
    data = load_dataset(TENTACLE)
    bag = export_bag(data, tmp_path / 'bag', timing=QUICK)
    with AnyReader([bag]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        durable = {
            c.topic
            for c in reader.connections
            if c.ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        }
    assert kinds == {
        '/dataset/description': 'std_msgs/msg/String',
        '/dataset/label': 'std_msgs/msg/String',
        '/dataset/robot': 'std_msgs/msg/String',
        '/measured_shape': 'geometry_msgs/msg/PoseArray',
        '/tendon_states': 'sensor_msgs/msg/JointState',
    }
    assert durable == {'/dataset/description', '/dataset/label', '/dataset/robot'}


@pytest.mark.parametrize('count', [0, 1, 5])
def test_poses_are_a_row_each(count):
    from rosbags.typesys import Stores, get_typestore

    from tendon_robot_ros.data.bag_writer import Builder

    types = get_typestore(Stores.ROS2_JAZZY)
    positions, turned = np.random.default_rng(0).normal(size=(2, count, 4))
    message = Builder(types, 'Prüfstand').pose_array(7, positions[:, :3], turned)
    sent = types.deserialize_cdr(types.serialize_cdr(message, POSE_ARRAY), POSE_ARRAY)
    frame, rows = poses_of(sent)
    assert frame == 'Prüfstand'
    assert_array_equal(rows, np.hstack([positions[:, :3], turned]))


def test_nothing_is_overwritten(tmp_path):
    data = load_dataset(TENTACLE)
    bag = export_bag(data, tmp_path / 'a.mcap', timing=QUICK)
    before = bag.read_bytes()
    with pytest.raises(DataSetError, match=r'a\.mcap: is there already; name a new file'):
        export_bag(data, bag)
    assert bag.read_bytes() == before
    with pytest.raises(DataSetError, match=r'is not empty, it holds a\.mcap'):
        export_bag(data, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ['a.mcap']
