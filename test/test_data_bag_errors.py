"""What is wrong with a recording is said in one line, and nothing is written."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip('rosbags')

from recorded import BENT, LEFT, SMALL, Recorder
from small_dataset import write

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DataSetError, MissingExtraError, TendonRobotError
from tendon_robot_ros.data import bag_writer, load_dataset
from tendon_robot_ros.data.bag_reader import Topics
from tendon_robot_ros.data.bag_writer import (
    JOINT_STATE,
    POSE_ARRAY,
    STRING,
    BagWriter,
    Builder,
    export_bag,
)
from tendon_robot_ros.data.loading import import_bag

STILL = [(BENT, LEFT, 0.0, 2.0)]


def error_of(bag, robot=SMALL, **options):
    with pytest.raises(DataSetError) as caught:
        import_bag(bag, robot, **options)
    return str(caught.value).replace(str(bag), 'BAG')


@pytest.mark.parametrize(
    ('name', 'message'),
    [
        ('no', 'is not there; name a rosbag2 folder or an .mcap file'),
        (
            '',
            'is a folder without metadata.yaml, and no recording; name a rosbag2 folder, or an '
            '.mcap or .db3 file',
        ),
        ('old.bag', 'is a ROS 1 bag; convert it: rosbags-convert --src BAG --dst NEW'),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, name, message):
    (tmp_path / 'old.bag').write_bytes(b'#ROSBAG V2.0\n')
    assert error_of(tmp_path / name) == f'BAG: {message}'


def test_a_missing_topic_is_named_with_those_that_would_do(tmp_path):
    bag = Recorder(by_topic=True, rate=20.0).write(tmp_path / 'bag', STILL)
    assert error_of(bag) == (
        'BAG: topic /measured_shape is not in it, and no topic or frame of /tf is called 1, 2, 3; '
        'say which is which marker, --marker 1=NAME for each; there: /tracker/m0, /tracker/m1, '
        '/tracker/m2'
    )
    assert error_of(bag, topics=Topics(markers={'tip': 'tip'})) == (
        'BAG: topic /tip is not in it; name one that is a geometry_msgs/msg/PoseStamped; there: '
        '/tracker/m0, /tracker/m1, /tracker/m2'
    )
    assert error_of(bag, topics=Topics(shape='tendon_states')) == (
        'BAG: topic /tendon_states is a sensor_msgs/msg/JointState; name one that is a '
        'geometry_msgs/msg/PoseArray; there: none'
    )


def test_a_recording_without_a_robot(tmp_path):
    bag = Recorder(rate=20.0).write(tmp_path / 'bag', STILL)
    assert error_of(bag, robot=None) == (
        'BAG: it holds no robot description; name one with --robot robot.yaml'
    )


@pytest.mark.parametrize(
    ('recorder', 'options', 'message'),
    [
        (
            {'names': ('left', 'up')},
            {},
            "the tendon states do not name 'right'; they name left, up; use the robot description "
            'of the robot that was recorded',
        ),
        (
            {'tensions': False},
            {'description': 'input: tension'},
            "the tension of 'left' was not observed (effort is empty or NaN); say input: "
            'displacement in a dataset.yaml and name it with --description',
        ),
        (
            {},
            {'description': 'markers: [{name: tip, arc_length: 0.03}]'},
            'the shape has 3 poses, but there are 1 markers; list the markers in a dataset.yaml '
            'and name it with --description',
        ),
        (
            {'by_topic': True},
            {'topics': Topics(markers={'nose': 'tracker/m0'})},
            "no marker 'nose' is described; known: 1, 2, 3, tip; list it in a dataset.yaml and "
            'name that with --description',
        ),
        (
            {'lost': ((0, 0, 9), (1, 0, 9), (2, 0, 9))},
            {},
            'no marker was ever seen; record the markers again',
        ),
    ],
    ids=['tendon', 'tension', 'poses', 'marker', 'unseen'],
)
def test_what_does_not_fit_is_said(recorder, options, message, tmp_path):
    bag = Recorder(rate=20.0, **recorder).write(tmp_path / 'bag', STILL)
    assert error_of(bag, **options) == f'BAG: {message}'


def stills(folder, frames, label=''):
    """Write a message about the same state and shape every 0.1 s, each in a frame."""
    with BagWriter(folder) as writer:
        writer.add_topic('/dataset/label', STRING)
        writer.add_topic('/tendon_states', JOINT_STATE)
        writer.add_topic('/measured_shape', POSE_ARRAY)
        writer.write('/dataset/label', 0, Builder(writer.types).string(label))
        for i, frame in enumerate(frames):
            build, time = Builder(writer.types, frame), i * 10**8
            state = build.joint_state(time, ['left', 'right'], [0, 0], [1, 1])
            writer.write('/tendon_states', time, state)
            writer.write('/measured_shape', time, build.pose_array(time, BENT, [[0, 0, 0, 1]] * 3))
    return folder


@pytest.mark.parametrize(
    ('frames', 'label', 'message'),
    [
        (
            ['base', 'camera'],
            '',
            "shapes are given in the frames 'base', 'camera'; record all markers in the frame of "
            'the base',
        ),
        (
            ['base'] * 30,
            'posture 3',
            'label \'posture 3\'; write {"posture": ..., "trial": ...} as JSON, or nothing',
        ),
    ],
)
def test_frames_that_differ_and_labels_that_are_none_are_refused(tmp_path, frames, label, message):
    assert error_of(stills(tmp_path / 'bag', frames, label)) == f'BAG: {message}'


@pytest.fixture(scope='module')
def exported(tmp_path_factory):
    """Write one small recording in each storage."""
    folder = tmp_path_factory.mktemp('exported')
    data = load_dataset(write(folder / 'small'))
    mcap = export_bag(data, folder / 'mcap') / 'mcap.mcap'
    return [mcap, export_bag(data, folder / 'sqlite3', 'sqlite3') / 'sqlite3.db3']


@settings(max_examples=60)
@given(
    storage=st.integers(0, 1),
    end=st.floats(0.0, 1.0) | st.just(1.0),
    places=st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255))),
)
def test_a_damaged_recording_is_read_or_refused_in_one_line(exported, storage, end, places):
    content = bytearray(exported[storage].read_bytes())
    del content[round(end * len(content)) :]
    for place, flip in places if content else ():
        content[int(place * len(content))] ^= flip
    path = exported[storage].with_stem('damaged')
    path.write_bytes(content)
    try:
        import_bag(path)
    except TendonRobotError as error:
        message = str(error)
    else:
        message = ''
    assert '\n' not in message


@pytest.mark.parametrize(
    ('factor', 'tension', 'message'),
    [
        (1e3, 1.0, 'a marker is 27 m away, but the robot is only 0.03 m long; record metres in '
         'the base frame (are these mm?)'),
        (1.0, 1e3, 'a tendon is 1000 N, but tension_limits end at 5 N; raise tension_limits of '
         'the robot description to what was applied, or give N (1 N if in mN)'),
        (1.0, 20.0, 'a tendon is 20 N, but tension_limits end at 5 N; raise tension_limits of '
         'the robot description to what was applied, or give N (0.196 N if in g or '
         '0.02 N if in mN)'),
        (1.0, -1.0, 'a tendon is -1 N, but a tendon cannot push; zero its load cell at rest, to '
         'within 0.05 N, or turn its sign around'),
    ],
)  # fmt: skip
def test_other_units_are_refused(factor, tension, message, tmp_path):
    plan = [(BENT * factor, (tension, 0.0), 0.0, 2.0)]
    bag = Recorder(noise=0.0, ripple=0.0).write(tmp_path / 'bag', plan)
    assert error_of(bag) == f'BAG: {message}'


def test_a_load_cell_that_shows_less_than_nothing_shows_nothing(tmp_path):
    bag = Recorder(ripple=0.0).write(tmp_path / 'bag', [(BENT, (1.0, -0.02), 0.0, 2.0)])
    assert import_bag(bag, SMALL).dataset.inputs.tolist() == [[1.0, 0.0]]


def test_the_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_writer, 'find_spec', lambda name: None)
    data = load_dataset(write(tmp_path / 'small'))
    for call in (lambda: import_bag(tmp_path / 'a'), lambda: export_bag(data, tmp_path / 'a')):
        with pytest.raises(MissingExtraError) as caught:
            call()
        assert str(caught.value) == (
            'rosbags is not installed; type: python -m pip install "tendon_robot_ros[bags]"'
        )


def test_the_commands_go_there_and_back(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'small')
    assert main(['export', 'bag', 'small', 'a.mcap', '--rate', '1']) == 1
    assert '--rate is from 4' in capsys.readouterr().err
    assert main(['export', 'bag', 'small', 'a.mcap', '--rate', '4']) == 0
    assert capsys.readouterr().out == '3 measurements, 2 postures\nwritten: a.mcap\n'
    assert main(['import', 'bag', 'a.mcap', '--output', 'out', '--picture', 'a.png']) == 0
    assert capsys.readouterr().out == (
        '3 still segments: 2 postures x 1 to 2 trials x 3 markers\nwritten: out\npicture: a.png\n'
    )
    assert load_dataset('out').postures == ('0', '1')


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--output', 'small'], 'small: holds a data set already; name a new folder or allow '
         '--overwrite'),
        (['--output', 'o', '--picture', 'a.doc'], '--picture a.doc: end the name with .png, .svg, '
         '.pdf'),
        (['--output', 'o', '--marker', 'tip'], '--marker tip: write NAME=TOPIC, each name once'),
        (['--output', 'o', '--speed', '0'], '--speed [mm/s], --duration [s] and --same are '
         'above 0'),
        (['--output', 'o', '--duration', '1e-9'], 'a.mcap: 9 s are too long to look for 1e-09 s '
         'of stillness; ask for a longer duration or import a part of the recording'),
        (['--output', 'o', '--description', 'no.yaml'], 'no.yaml: cannot be read (No such file or '
         'directory); name a dataset.yaml'),
    ],
)  # fmt: skip
def test_a_command_that_fails_writes_nothing(options, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    export_bag(load_dataset(write(tmp_path / 'small')), 'a.mcap')
    assert main(['import', 'bag', 'a.mcap', *options]) == 1
    assert capsys.readouterr().err == f'error: {message}\n'
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.mcap', 'small']
