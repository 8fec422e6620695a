"""What a data set says about itself, and its parts."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from small_dataset import INPUTS, ROBOT, write

from tendon_robot_ros.common.errors import DataSetError, InputError
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.data.dataset import at_rest
from tendon_robot_ros.robot import parse_robot


@pytest.fixture
def small(tmp_path):
    """Read the small data set: 2 postures, 2 trials, 3 markers, some missing."""
    return load_dataset(write(tmp_path / 'small'))


@pytest.fixture
def sequence(tmp_path):
    """Read the small data set as a sequence with a posture that was not measured."""
    inputs = INPUTS + 'turn,2,2\n'
    return load_dataset(write(tmp_path / 'small', dataset='path: sequence', inputs=inputs))


def test_postures_at_rest_are_those_in_which_hardly_anything_pulls():
    inputs = np.array([[0.2, 0.2], [0.2, 10.0], [np.nan, 0.0], [0.62, 0.2]])
    assert at_rest(inputs).tolist() == [True, False, True, False]
    assert not at_rest(np.zeros((2, 2))).any(), 'nothing pulls anywhere: nothing tells'


def test_means_and_counts_leave_missing_markers_out(small):
    assert_array_equal(small.trials, [2, 1])
    assert_array_equal(small.counts, [[2, 2, 2], [1, 0, 1]])
    assert small.mean[0, 2] == pytest.approx([0.004, 0.0, 0.03])
    assert np.isnan(small.mean[1, 1]).all()
    assert_array_equal(small.trial_mask, [[True, True], [True, False]])


def test_inputs_hold_for_every_trial_unless_they_were_measured(small):
    assert small.inputs_by_trial.shape == (2, 2, 2)
    assert_array_equal(small.inputs_by_trial[1], [[1.0, 0.25], [1.0, 0.25]])
    measured = dataclasses.replace(small, trial_inputs=np.ones((2, 2, 2)))
    assert_array_equal(measured.inputs_by_trial, np.ones((2, 2, 2)))


def test_gravity_is_the_data_sets_then_the_robots_then_unknown(small):
    bare = parse_robot(ROBOT.replace('gravity:', '#'))
    assert small.gravity_for(small.robot) == (0.0, 0.0, 9.81)
    assert small.gravity_for(bare) is None
    said = dataclasses.replace(small, gravity=(0.0, 0.0, 0.0))
    assert said.gravity_for(small.robot) == (0.0, 0.0, 0.0)


def test_arrays_cannot_be_changed(small):
    for name in ('inputs', 'positions'):
        with pytest.raises(ValueError, match='read-only'):
            getattr(small, name)[0] = 0


def test_arrays_that_do_not_fit_are_refused(small):
    with pytest.raises(DataSetError) as caught:
        dataclasses.replace(small, inputs=np.zeros((2, 3)))
    assert str(caught.value) == (
        f'{small.name}: inputs: has shape (2, 3); expected (2, 2) from postures, trials, markers '
        'and inputs'
    )


def test_selected_postures_keep_the_order_of_the_file(small):
    both = small.select(['1', '0'])
    assert both.postures == ('0', '1')
    one = small.select(['1'])
    assert one.postures == ('1',)
    assert_array_equal(one.inputs, [[1.0, 0.25]])
    assert_array_equal(one.positions[0, 0, 2], [0.006, 0.0, 0.028])
    assert one.markers == small.markers


def test_a_sequence_keeps_the_way_to_the_selected_postures(sequence):
    part = sequence.select(['1'])
    assert part.postures == ('0', '1')
    assert_array_equal(part.trials, [0, 1])
    assert sequence.select(['0']).postures == ('0',)


@pytest.mark.parametrize(
    ('names', 'problem'), [(['7'], "no posture '7'"), ([], 'no posture is selected')]
)
def test_unknown_postures_cannot_be_selected(names, problem, small):
    with pytest.raises(InputError) as caught:
        small.select(names)
    assert str(caught.value) == f'{small.name}: {problem}; known: 0, 1'


def test_held_out_postures_are_the_same_for_the_same_seed(tmp_path):
    inputs = 'posture,left,right\n' + ''.join(f'{i},1,1\n' for i in range(12))
    shapes = 'posture,trial,marker,x,y,z\n' + ''.join(f'{i},0,1,0,0,0\n' for i in range(12))
    data = load_dataset(write(tmp_path, inputs=inputs, shapes=shapes))
    fit, check = data.hold_out(0.25, seed=3)
    assert (len(fit.postures), len(check.postures)) == (9, 3)
    assert set(fit.postures) | set(check.postures) == set(data.postures)
    assert check.postures == data.hold_out(0.25, seed=3)[1].postures
    assert check.postures != data.hold_out(0.25, seed=4)[1].postures


def test_only_measured_postures_of_a_sequence_are_held_out(sequence):
    fit, check = sequence.hold_out(0.5)
    assert fit.trials.astype(bool).sum() == check.trials.astype(bool).sum() == 1


@pytest.mark.parametrize('share', [0.0, 1.0, np.nan])
def test_both_parts_need_a_posture(share, small):
    with pytest.raises(InputError, match='of 2 measured postures; both parts need at least one'):
        small.hold_out(share)
