"""Rotations in their three forms, and the colours that mean something."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tendon_robot_ros.common.colours import COLOURS, ERROR, MEASURED, PREDICTED, rgb
from tendon_robot_ros.common.rotations import (
    about,
    bent,
    from_quaternion,
    quaternions,
    rotated,
    towards,
)

ANGLE = st.floats(-3.1, 3.1)
VECTOR = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_a_quaternion_becomes_the_rotation_that_becomes_it_again(numbers):
    quaternion = np.array(numbers) / np.linalg.norm(numbers)
    rotation = from_quaternion(quaternion.tolist())
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-9)
    back = quaternions(rotation[None])[0]
    assert abs(back @ quaternion) == pytest.approx(1.0, abs=1e-9)


@given(ANGLE)
def test_bending_towards_an_axis_turns_about_the_other(angle):
    assert bent(np.array([1.0, 0.0]), np.array(angle)) == pytest.approx(about(1, angle), abs=1e-12)
    assert bent(np.array([0.0, 1.0]), np.array(angle)) == pytest.approx(
        about(0, -angle), abs=1e-12
    )


@given(ANGLE, st.integers(0, 1))
def test_a_rotation_vector_turns_as_the_matrix_does(angle, axis):
    vector = np.array([0.6, 0.0, 0.8])
    turned = rotated(vector, angle * np.eye(3)[axis])
    assert turned == pytest.approx(about(axis, angle) @ vector, abs=1e-9)


@given(VECTOR)
def test_the_shortest_turn_towards_a_direction_ends_there(direction):
    direction = np.array(direction) / np.linalg.norm(direction)
    assert towards(direction)[:, 2] == pytest.approx(direction, abs=1e-9)


def test_no_model_has_the_colour_of_what_was_measured():
    assert MEASURED not in COLOURS and ERROR not in COLOURS
    assert COLOURS[0] == PREDICTED
    assert rgb(MEASURED) == (213, 94, 0)
