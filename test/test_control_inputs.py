"""Every refusal says what came and what was expected; nothing gets past."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tendon_robot_ros.control import inputs
from tendon_robot_ros.control.inputs import Refusal

INPUTS = ('left', 'right')


@pytest.mark.parametrize(
    ('stamp', 'code', 'words'),
    [(98.0, 'stale', '2 s old'), (103.0, 'future', '3 s in the future')],
)
def test_old_and_future_stamps_are_refused(stamp, code, words):
    with pytest.raises(Refusal, match=words) as caught:
        inputs.check_stamp(stamp, 100.0, 0.5, 'target_pose')
    assert caught.value.code == code


def test_a_stamp_of_zero_means_now():
    inputs.check_stamp(0.0, 1e9, 0.5, 'target_pose')
    inputs.check_stamp(100.1, 100.0, 0.5, 'target_pose')


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused(bad):
    with pytest.raises(Refusal, match='expected finite numbers'):
        inputs.position([0.0, bad, 0.1], 1.0, 'target_point')
    with pytest.raises(Refusal, match='expected finite numbers'):
        inputs.direction([0.0, 0.0, bad, 1.0], 'target_pose')


def test_a_position_in_millimetres_is_refused():
    with pytest.raises(Refusal, match='positions are in metres'):
        inputs.position([50.0, 0.0, 100.0], 0.3, 'target_point')


@pytest.mark.parametrize('bad', [[0, 0, 0, 0], [0, 0, 0, 2], [1e-9, 0, 0, 0]])
def test_a_quaternion_that_is_no_orientation_is_refused(bad):
    with pytest.raises(Refusal, match=r'has norm .*, expected 1'):
        inputs.direction(bad, 'target_pose')


@given(st.floats(-math.pi, math.pi), st.floats(0.0, math.pi), st.floats(-math.pi, math.pi))
def test_the_direction_is_the_z_axis_whatever_the_roll(azimuth, polar, roll):
    # rotations by roll about z, then by polar about y, then by azimuth about z
    (cz, sz), (cy, sy), (cr, sr) = ((np.cos(a / 2), np.sin(a / 2)) for a in (azimuth, polar, roll))
    w = cz * cy * cr - sz * cy * sr
    z = cz * cy * sr + sz * cy * cr
    x = cz * sy * sr - sz * sy * cr
    y = cz * sy * cr + sz * sy * sr
    expected = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    assert inputs.direction([x, y, z, w], 'pose') == pytest.approx(expected, abs=1e-9)


def test_joint_values_are_put_in_the_order_of_the_robot():
    found = inputs.by_name(['right', 'left'], [2.0, 1.0], INPUTS, 'tendon_states', 'effort')
    assert found.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ('names', 'values', 'words'),
    [
        (['left', 'middle'], [1.0, 2.0], 'unknown middle; expected left, right'),
        (['left'], [1.0], 'missing right'),
        (['left', 'right', 'left'], [1.0, 2.0, 3.0], 'a name stands twice'),
        (['left', 'right'], [1.0], 'expected 2 values of effort, got 1'),
        ([], [], 'missing left, right'),
        (
            [f'n{i}' for i in range(100_000)],
            [],
            r'unknown n0, .*, n11 and 99988 more; expected left',
        ),
        (['left', 'x' * 10**6], [], r'unknown x{50}\.\.\.; expected left, right'),
    ],
)
def test_joint_names_must_be_those_of_the_robot(names, values, words):
    with pytest.raises(Refusal, match=words):
        inputs.by_name(names, values, INPUTS, 'tendon_command', 'effort')
