"""Markers anywhere along the arm, on it or off it."""

import numpy as np
import pytest
from arms import planar, spatial
from scipy.spatial.transform import Rotation

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.model.model import Model

L = 0.007


def placed(model, inputs, arc_length, offset=(0.0, 0.0, 0.0)):
    return model.shape(inputs).markers(np.array([arc_length]), np.array([offset]))[0]


def test_markers_at_the_ends_of_cells_are_the_positions():
    shape = Model(spatial(3)).shape([0.3, 0.0, 0.9, 0.4, 0.0, 0.0])
    ends = np.arange(1, 7) * 0.006
    assert np.array_equal(shape.markers(ends, np.zeros((6, 3))), shape.positions)
    off = shape.markers(ends, np.tile([1e-3, 2e-3, 3e-3], (6, 1)))
    assert np.allclose(off, shape.positions + shape.frames @ [1e-3, 2e-3, 3e-3], atol=1e-15)


def test_a_marker_in_an_arc_moves_on_the_circle():
    model = Model(planar(4))
    theta = 1.2 * 0.0055 / 0.027
    for share in (0.0, 0.2, 0.5, 3.7):
        angle, radius = share * theta, L / theta
        frame = Rotation.from_rotvec([0.0, angle, 0.0])
        on = [radius * (1 - np.cos(angle)), 0.0, radius * np.sin(angle)]
        expected = on + frame.apply([1e-3, 2e-3, -1e-3])
        found = placed(model, [0.0, 1.2], share * L, (1e-3, 2e-3, -1e-3))
        assert np.allclose(found, expected, rtol=0, atol=1e-15)


def test_a_marker_in_a_hinged_cell_sits_on_the_half_before_or_after():
    model = Model(planar(1, bends_as='hinge'))
    theta = 1.2 * 0.0055 / 0.027
    joint, turn = np.array([0.0, 0.0, 0.5 * L]), Rotation.from_rotvec([0.0, theta, 0.0])
    offset = np.array([1e-3, 0.0, 2e-3])
    before = placed(model, [0.0, 1.2], 0.3 * L, offset)
    assert np.allclose(before, [0.0, 0.0, 0.3 * L] + offset, rtol=0, atol=1e-15)
    after = placed(model, [0.0, 1.2], 0.8 * L, offset)
    assert np.allclose(after, joint + turn.apply([0.0, 0.0, 0.3 * L] + offset), rtol=0, atol=1e-15)


def test_the_end_of_a_cell_belongs_to_that_cell():
    """Within a nanometre: 2 x 0.007 need not be 0.014 in floating point."""
    model = Model(planar(3, bends_as='hinge'))
    end = placed(model, [0.0, 1.5], 2 * L, (1e-3, 0.0, 0.0))
    for nearly in (2 * L - 5e-10, 2 * L + 5e-10):
        assert np.allclose(placed(model, [0.0, 1.5], nearly, (1e-3, 0, 0)), end, atol=2e-9)
    beyond = placed(model, [0.0, 1.5], 2 * L + 2e-9, (1e-3, 0.0, 0.0))
    assert np.allclose(beyond, end, atol=1e-8)  # the frame of the next cell's first half is equal


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_markers_are_continuous_along_the_arm(bends_as):
    shape = Model(spatial(3, bends_as=bends_as)).shape([0.9, 0.0, 0.2, 0.0, 0.0, 0.5])
    along = np.linspace(0.0, 0.036, 2001)
    points = shape.markers(along, np.zeros((2001, 3)))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.allclose(steps, 0.036 / 2000, rtol=2e-3)
    assert np.allclose(points[0], 0.0) and np.allclose(points[-1], shape.tip_position)


def test_markers_shorten_with_a_compressed_arm():
    model = Model(planar(4, {'axial_compression': {'compliance': 0.02}}))
    assert placed(model, [1.0, 1.0], 2.5 * L)[2] == pytest.approx(2.5 * L * 0.96)


def test_a_batch_places_markers_on_every_posture():
    model = Model(planar(4))
    batch = model.shapes([[0.0, 1.0], [0.5, 0.0]])
    found = batch.markers(np.array([0.01, 0.02]), np.zeros((2, 3)))
    assert found.shape == (2, 2, 3)
    assert np.array_equal(found[1, 1], placed(model, [0.5, 0.0], 0.02))


@pytest.mark.parametrize('arc_length', [0.0281, -0.001, np.nan])
def test_the_marker_that_is_not_on_the_arm_is_named_and_refused(arc_length):
    model = Model(planar(4))
    with pytest.raises(InputError) as caught:
        model.observed(model.shape([0.0, 1.0]), [0.01, arc_length, 0.02])
    assert str(caught.value) == (
        f'markers: expected arc lengths from 0 to 0.028 m (the tip), got {arc_length:g} m'
    )
