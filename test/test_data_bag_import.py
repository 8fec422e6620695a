"""Still segments of a recording become postures and trials."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip('rosbags')

from recorded import BENT, LEFT, LOADED_TWICE, REST, RIGHT, SMALL, STRAIGHT, TURNED, Recorder

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.data.bag_reader import Topics
from tendon_robot_ros.data.loading import draw_segments, import_bag, summary
from tendon_robot_ros.data.still_segments import Rule


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Record two postures, each loaded twice from rest, with 0.2 mm of noise at 100 Hz."""
    return Recorder().write(tmp_path_factory.mktemp('bag') / 'bag', LOADED_TWICE)


@pytest.fixture(scope='module')
def imported(bag):
    return import_bag(bag, SMALL)


@pytest.fixture(scope='module')
def by_topic(tmp_path_factory):
    """Record the same with a topic for each marker."""
    recorder = Recorder(by_topic=True, rate=50.0)
    return recorder.write(tmp_path_factory.mktemp('topics') / 'bag', LOADED_TWICE)


def test_segments_with_the_same_inputs_are_trials_of_one_posture(imported):
    data = imported.dataset
    assert data.postures == ('0', '1', '2')
    assert_array_equal(data.trials, [4, 2, 2])
    assert_allclose(data.inputs, [REST, LEFT, RIGHT], atol=1e-3)
    assert_allclose(data.mean, [STRAIGHT, BENT, TURNED], atol=1e-4)
    assert data.orientations is None  # the tracker gave no turn
    assert summary(imported) == '8 still segments: 3 postures x 2 to 4 trials x 3 markers'


def test_segments_lie_within_the_time_in_which_the_arm_stood(imported):
    time = 0.0
    for one, (_, _, way, stay) in zip(imported.segments, LOADED_TWICE, strict=True):
        begin, end = time + way, time + way + stay
        assert begin - 0.01 <= one.begin <= begin + 0.5
        assert end - 0.5 <= one.end <= end + 0.01
        time = end


def test_rest_can_be_left_out_and_measured_inputs_of_every_trial_are_kept(bag):
    data = import_bag(bag, SMALL, rest=0.2).dataset
    assert_allclose(data.inputs, [LEFT, RIGHT], atol=1e-3)
    assert_array_equal(data.trials, [2, 2])
    assert data.trial_inputs.shape == (2, 2, 2)
    assert np.ptp(data.trial_inputs[0, :, 0]) > 0


def test_short_stops_and_slow_motion_do_not_count(bag):
    assert len(import_bag(bag, SMALL, Rule(duration=2.5)).segments) == 4
    slow = Rule(speed=1e-4)
    with pytest.raises(Exception, match=r'is never slower than 0\.1 mm/s for 1 s \(at its slow'):
        import_bag(bag, SMALL, slow)


def test_in_a_sequence_every_segment_is_a_posture(bag):
    data = import_bag(bag, SMALL, description='path: sequence').dataset
    assert data.postures == tuple('01234567')
    assert data.path == 'sequence'
    assert_array_equal(data.trials, [1] * 8)


def test_other_inputs_are_another_posture_even_where_friction_holds_the_arm(tmp_path):
    plan = [(BENT, LEFT, 0.0, 2.0), (BENT, (1.2, 0.1), 0.2, 2.0)]
    data = import_bag(Recorder().write(tmp_path / 'bag', plan), SMALL).dataset
    assert_allclose(data.inputs, [LEFT, (1.2, 0.1)], atol=1e-3)
    coarse = import_bag(tmp_path / 'bag', SMALL, Rule(change=0.5)).dataset
    assert coarse.postures == ('0',)


def test_a_marker_that_was_lost_is_missing(tmp_path):
    recorder = Recorder(lost=((1, 2.0, 6.0), (2, 5.0, 5.5)))
    data = import_bag(recorder.write(tmp_path / 'bag', LOADED_TWICE), SMALL).dataset
    assert_array_equal(data.counts, [[4, 4, 4], [2, 1, 2], [2, 2, 2]])


@pytest.mark.parametrize(
    ('lost', 'counts'),
    [
        ((1, 2.0, 6.0), [[4, 4, 4], [2, 1, 2], [2, 2, 2]]),
        ((1, 8.0, 99.0), [[4, 2, 4], [2, 1, 2], [2, 0, 2]]),
        ((1, 0.0, 12.0), [[4, 2, 4], [2, 1, 2], [2, 1, 2]]),
    ],
)
def test_a_marker_whose_topic_is_silent_leaves_the_others_as_they_are(tmp_path, lost, counts):
    recorder = Recorder(by_topic=True, rate=50.0, lost=(lost,), silent=True)
    topics = Topics(markers={str(i + 1): f'tracker/m{i}' for i in range(3)})
    data = import_bag(recorder.write(tmp_path / 'bag', LOADED_TWICE), SMALL, topics=topics).dataset
    assert_array_equal(data.counts, counts)


def test_nothing_is_measured_before_the_first_tendon_state(tmp_path):
    late = Recorder(since=9.0).write(tmp_path / 'late', LOADED_TWICE)
    data = import_bag(late, SMALL).dataset
    assert_allclose(data.inputs, [RIGHT, REST, LEFT], atol=1e-3)
    assert_allclose(data.mean, [TURNED, STRAIGHT, BENT], atol=1e-4)
    assert_array_equal(data.trials, [2, 2, 1])
    last = Recorder(since=23.3).write(tmp_path / 'last', LOADED_TWICE)
    with pytest.raises(DataSetError, match='inputs and markers are hardly recorded at the same'):
        import_bag(last, SMALL)


def test_nothing_is_measured_while_no_tendon_state_comes(tmp_path):
    found = import_bag(Recorder(until=9.0).write(tmp_path / 'bag', LOADED_TWICE), SMALL)
    assert_allclose(found.dataset.inputs, [REST, LEFT, RIGHT], atol=1e-3)
    assert_array_equal(found.dataset.trials, [2, 1, 1])
    assert found.left_out[0].endswith('no tendon state came for 1 s before them')


def test_every_marker_can_have_its_own_topic_and_the_tip_needs_no_description(by_topic):
    topics = Topics(markers={'3': 'tracker/m2', '1': '/tracker/m0'})
    data = import_bag(by_topic, SMALL, topics=topics, rest=0.2).dataset
    assert [marker.name for marker in data.markers] == ['3', '1']
    assert_allclose(data.mean, [BENT[[2, 0]], TURNED[[2, 0]]], atol=1e-4)
    data = import_bag(by_topic, SMALL, topics=Topics(markers={'tip': 'tracker/m2'})).dataset
    assert data.markers[0].arc_length == pytest.approx(0.03)
    topics = Topics(markers={'1': 'tracker/m0', '2': '/tracker/m0'})
    with pytest.raises(DataSetError, match='/tracker/m0 is given for marker 1 and for marker 2'):
        import_bag(by_topic, SMALL, topics=topics)


def test_pulls_are_taken_where_no_tension_was_observed(tmp_path):
    bag = Recorder(tensions=False).write(tmp_path / 'bag', LOADED_TWICE)
    data = import_bag(bag, SMALL, rest=0.2e-3).dataset
    assert data.input == 'displacement'
    assert_allclose(data.inputs, [[1e-3, 1e-4], [1e-4, 7e-4]], atol=1e-6)


def test_the_picture_shows_the_segments(imported, tmp_path):
    from matplotlib.image import imread

    picture = draw_segments(imported, tmp_path / 'segments.png')
    image = imread(picture)
    green = (image[..., 1] > image[..., 0] + 0.05) & (image[..., 1] > image[..., 2] + 0.05)
    blocks = np.count_nonzero(np.diff(green[image.shape[0] // 2].astype(int)) == 1)
    assert blocks >= 8
