"""Who sent what, when, and in which frame: a recording that mixes it up is named or set right."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip('rosbags')

from recorded import BENT, LEFT, LOADED_TWICE, RIGHT, SMALL, TURNED, Recorder

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.data.bag_reader import TF, Topics, alternating
from tendon_robot_ros.data.loading import import_bag
from tendon_robot_ros.robot import dump_robot

RATE = 25.0
TURN = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])  # quarter about z
SHIFT = np.array([0.3, -0.2, 0.1])


def turned(places):
    """Tell places in a frame from which TURN and SHIFT lead to the base."""
    x, y, z = (np.asarray(places) - SHIFT).T
    return np.array([y, -x, z]).T


@dataclass
class Mixed(Recorder):
    """Write more, or otherwise."""

    rate: float = RATE
    tf: bool = False  # markers as frames of /tf
    parent: str = 'base'
    static: tuple = ()  # (parent, child, shift, turn)
    second: object = None  # (time [s], inputs) -> inputs of a second sender, or None
    signed: bool = False
    late: float = 0.0  # [s] by which the clock is set back after half of the time
    tracker: object = None  # places in the base frame -> places as written
    lost_as: object = None  # what is written for a marker that was lost

    def _transform(self, time, parent, child, shift, turn):
        types = self.build._types
        return types['geometry_msgs/msg/TransformStamped'](
            header=types['std_msgs/msg/Header'](
                stamp=types['builtin_interfaces/msg/Time'](sec=0, nanosec=0), frame_id=parent
            ),
            child_frame_id=child,
            transform=types['geometry_msgs/msg/Transform'](
                translation=types['geometry_msgs/msg/Vector3'](*map(float, shift)),
                rotation=types['geometry_msgs/msg/Quaternion'](*map(float, turn)),
            ),
        )

    def _states(self, writer, time, inputs, name):
        message = self.build.joint_state(time, self.names, np.full(2, np.nan), inputs)
        message.header.frame_id = name if self.signed else ''
        writer.write('/tendon_states', time, message)

    def _write(self, writer, time, shape, inputs):
        connections, now = writer._connections, 1e-9 * (time - 1_700_000_000_000_000_000)
        half = sum(way + stay for *_, way, stay in LOADED_TWICE) / 2
        if self.late and now > half:
            time -= round(1e9 * self.late)
        if (self.tf or self.static) and '/tf' not in connections:
            writer.add_topic('/tf', TF)
            writer.add_topic('/tf_static', TF, latched=True)
            message = writer.types.types[TF]
            fixed = [self._transform(time, *one) for one in self.static]
            writer.write('/tf_static', time, message(transforms=fixed))
        shape = shape if self.tracker is None else self.tracker(shape)
        if self.by_topic:
            super()._write(writer, time, shape, inputs)
            return
        self._states(writer, time, inputs, '/driver (process 1)')
        if self.second is not None and (other := self.second(now, inputs)) is not None:
            self._states(writer, time + 3_000_000, np.array(other), '/driver (process 2)')
        seen = np.isfinite(shape).all(axis=1)
        if self.tf:
            moved = [
                self._transform(time, self.parent, f'tag{i + 1}', shape[i], [0.0, 0.0, 0.0, 1.0])
                for i in np.flatnonzero(seen)
            ]
            writer.write('/tf', time, writer.types.types[TF](transforms=moved))
            return
        if self.lost_as is not None:
            shape = np.where(seen[:, None], shape, self.lost_as)
        message = self.build.pose_array(
            time, shape, np.tile([0.0, 0.0, 0.0, 1.0], (len(shape), 1))
        )
        writer.write('/measured_shape', time, message)


def imported(tmp_path, topics=None, **options):
    bag = Mixed(**options).write(tmp_path / 'bag', LOADED_TWICE)
    return import_bag(bag, SMALL, topics=topics, rest=0.2)


def is_right(found, markers=(0, 1, 2)):
    assert_allclose(found.dataset.inputs, [LEFT, RIGHT], atol=1e-3)
    assert_allclose(found.dataset.mean, [BENT[list(markers)], TURNED[list(markers)]], atol=2e-4)
    assert_array_equal(found.dataset.trials, [2, 2])


@pytest.mark.parametrize('lost_as', [0.0, 9999.0, -1.0, -3.7e28, np.nan])
def test_what_a_tracker_writes_for_a_lost_marker_is_left_out(tmp_path, lost_as):
    lost = ((1, 3.0, 4.5), (2, 9.0, 9.4))
    found = imported(tmp_path, lost=lost, lost_as=lost_as)
    is_right(found)
    told = [line for line in found.left_out if 'are none' in line]
    assert len(told) == (not np.isnan(lost_as))


def test_markers_of_topics_of_their_own_that_hold_the_last_place_are_left_out(tmp_path):
    class Holding(Recorder):
        def _write(self, writer, time, shape, inputs):
            shape[1] = self.last = shape[1] if np.isfinite(shape[1]).all() else self.last
            super()._write(writer, time, shape, inputs)

    holding = Holding(rate=RATE, by_topic=True, lost=((1, 2.2, 5.4),))
    bag = holding.write(tmp_path / 'bag', LOADED_TWICE)
    topics = Topics(markers={str(i + 1): f'tracker/m{i}' for i in range(3)})
    found = import_bag(bag, SMALL, topics=topics, rest=0.2)
    is_right(found)
    assert found.left_out[0].endswith('while other markers change')


STATIC = ('base', 'camera', SHIFT, TURN)


@pytest.mark.parametrize(
    ('static', 'parent', 'tracker'),
    [
        ((), 'base', None),
        ((STATIC,), 'camera', turned),
        ((('room', 'camera', (0, 0, 0), (0, 0, 0, 1)), ('room', 'small_base', *(
            turned([[0.0, 0.0, 0.0]])[0], -TURN * [1, 1, 1, -1],
        ))), 'camera', turned),
    ],
)  # fmt: skip
def test_markers_that_come_as_transforms_are_read(tmp_path, static, parent, tracker):
    topics = Topics(markers={'1': 'tag1', '3': '/tag3'})
    options = {'static': static, 'parent': parent, 'tracker': tracker, 'lost': ((2, 9.0, 9.4),)}
    is_right(imported(tmp_path, topics, tf=True, **options), (0, 2))


def test_frames_that_are_no_markers_are_named(tmp_path):
    with pytest.raises(DataSetError) as caught:
        imported(tmp_path, tf=True)
    assert re.sub('.*bag: ', '', str(caught.value)) == (
        'topic /measured_shape is not in it, and no topic or frame of /tf is called 1, 2, 3; say '
        'which is which marker, --marker 1=NAME for each; there: tag1, tag2, tag3'
    )


@pytest.mark.parametrize(
    'options', [{}, {'static': (STATIC,), 'frame': 'camera', 'tracker': turned}]
)
def test_topics_that_are_called_as_the_markers_are_read(tmp_path, options):
    bag = Mixed(by_topic=True, **options).write(tmp_path / 'bag', LOADED_TWICE)
    places = ', '.join(f'{{name: m{i}, arc_length: {0.01 * (i + 1)}}}' for i in range(3))
    is_right(import_bag(bag, SMALL, description=f'markers: [{places}]', rest=0.2))


def test_a_shape_in_a_frame_that_is_joined_with_the_base_is_taken_there(tmp_path):
    found = imported(tmp_path, static=(STATIC,), frame='camera', tracker=turned)
    is_right(found)
    assert found.recording.frame == 'base'


def test_a_frame_that_nothing_joins_with_the_base_is_refused_where_it_is_not_found(tmp_path):
    with pytest.raises(DataSetError, match="frame 'optitrack', and no transform in it says where"):
        imported(tmp_path, frame='optitrack', tracker=turned)


def test_import_bag_finds_where_a_trackers_frame_lies(tmp_path, capsys):
    (tmp_path / 'robot.yaml').write_text(dump_robot(SMALL))
    errors = []
    for name, frame, tracker in (('a', 'base', None), ('b', 'optitrack', turned)):
        Mixed(frame=frame, tracker=tracker).write(tmp_path / name, LOADED_TWICE)
        robot, out = str(tmp_path / 'robot.yaml'), str(tmp_path / f'{name}_data')
        assert (
            main(['import', 'bag', str(tmp_path / name), '--robot', robot, '--output', out]) == 0
        )
        errors.append(load_dataset(out).mean)
    assert "'optitrack', which no transform joins with the base" in capsys.readouterr().out
    chords = [np.linalg.norm(np.diff(one, axis=1), axis=2) for one in errors]
    assert_allclose(chords[1], chords[0], atol=2e-6)
    assert np.abs(errors[1]).max() < 0.05  # the tracker stood 0.3 m off


def resting(now, inputs):
    return 0.1, 0.1


def later(now, inputs):
    return (0.1, 0.1) if now > 8.0 else None


def mirrored(now, inputs):
    return -inputs


@pytest.mark.parametrize('signed', [True, False])
@pytest.mark.parametrize('second', [resting, later, mirrored])
def test_two_programs_that_publish_other_states_are_named(tmp_path, second, signed):
    with pytest.raises(DataSetError, match='two programs publish the tendon states') as caught:
        imported(tmp_path, second=second, signed=signed)
    names = '(/driver (process 1), /driver (process 2))'
    assert (names in str(caught.value)) == signed
    assert ('ros2 topic info --verbose' in str(caught.value)) != signed
    if signed:
        is_right(import_bag(tmp_path / 'bag', SMALL, topics=Topics(sender='process 1'), rest=0.2))


def test_two_programs_that_say_the_same_are_no_problem(tmp_path):
    is_right(imported(tmp_path, second=lambda now, inputs: inputs + 1e-3, signed=True))


def test_a_clock_that_was_set_back_is_named(tmp_path):
    with pytest.raises(DataSetError, match=r'from \d.* s inputs and markers of two different tim'):
        imported(tmp_path, late=5.0)


@pytest.mark.parametrize('messages', [856, 36_000])
@pytest.mark.parametrize('draw', ['normal', 'uniform'])
def test_noise_of_what_does_not_move_is_no_second_sender(draw, messages):
    random = np.random.default_rng(3)
    values = getattr(random, draw)(size=(messages, 90))
    assert alternating(np.arange(messages) / 50.0, values) is None
    begin = messages // 2  # of ten seconds with two senders
    values[begin : begin + 500 : 2] += 10.0
    assert alternating(np.arange(messages) / 50.0, values)[2] == pytest.approx(10.0, abs=3.0)


@pytest.mark.parametrize('messages', [0, 1, 11])
def test_a_few_messages_do_not_tell_of_a_second_sender(messages):
    values = np.tile(np.arange(messages)[:, None] % 2 * 10.0, 3)
    assert alternating(np.arange(messages) / 50.0, values) is None


def test_two_trackers_on_one_topic_are_named(tmp_path):
    class Two(Mixed):
        def _write(self, writer, time, shape, inputs):
            super()._write(writer, time, shape, inputs)
            array = self.build.pose_array(time, BENT, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))
            writer.write('/measured_shape', time + 1_000_000, array)

    with pytest.raises(DataSetError, match='two programs publish markers on one topic'):
        import_bag(Two().write(tmp_path / 'bag', LOADED_TWICE), SMALL)


CHANGED = {  # what a tracker publishes for the markers from 9 s on and before, and what is said
    'numbered anew': (
        ([0, 3, 2, 1], [0, 1, 2, 3]),
        'poses 1, 3 of the shape are one marker, numbered anew',
    ),
    'exchanged': (
        ([0, 2, 1], [0, 1, 2]),
        'pose 1 of the shape and pose 2 of the shape exchange',
    ),
}


@pytest.mark.parametrize('name', CHANGED)
def test_markers_that_change_their_places_in_the_shape_are_put_back(name, tmp_path):
    orders, words = CHANGED[name]

    class Changed(Mixed):
        def _write(self, writer, time, shape, inputs):
            self.count = getattr(self, 'count', 0) + 1
            unseen = np.vstack([shape, np.full(3, np.nan)])
            super()._write(writer, time, unseen[orders[self.count <= 9.0 * RATE]], inputs)

    found = import_bag(Changed().write(tmp_path / 'bag', LOADED_TWICE), SMALL, rest=0.2)
    is_right(found)
    assert found.left_out[0].startswith(words)
