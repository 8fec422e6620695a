"""Which marker is where on the arm, and how two clouds of points lie to each other."""

import numpy as np
import pytest
from arms import COARSE
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.common.rotations import rigid_fit
from tendon_robot_ros.tables.markers import order_markers


def arc(radius, lengths, towards=0.0):
    """Return points (n, 3) [m] of a circular arc from the origin along +z."""
    angle = np.asarray(lengths) / radius
    across, along = radius * (1.0 - np.cos(angle)), radius * np.sin(angle)
    return np.stack([across * np.cos(towards), across * np.sin(towards), along], axis=1)


def test_markers_that_were_never_seen_together_have_no_order():
    lengths = np.array([0.03, 0.06, 0.09, 0.12])
    postures = np.array([arc(r, lengths, t) for r, t in ((1e5, 0), (0.1, 0), (0.08, 2), (0.1, 4))])
    postures[:2, 1], postures[2:, 2] = np.nan, np.nan
    with pytest.raises(DataSetError, match='some markers are never seen together'):
        order_markers(postures, COARSE)
    postures[2:, 1] = np.nan
    order = order_markers(postures, COARSE)
    assert (order.members, order.unseen) == ((0, 2, 3), (1,))


def test_order_and_places_follow_from_the_straight_arm():
    lengths = np.array([0.012, 0.03, 0.066, 0.12])
    postures = np.array([arc(r, lengths, t) for r, t in ((1e5, 0), (0.1, 0), (0.08, 2), (0.1, 4))])
    shuffled = [2, 0, 3, 1]
    order = order_markers(postures[:, shuffled] + 5.0, COARSE)
    assert [shuffled[j] for j in order.members] == [0, 1, 2, 3]
    assert_allclose(order.arc_lengths, lengths, atol=3e-4)  # bends of 0.8 rad between markers
    known = order_markers(postures[:, shuffled], COARSE, (0.01, 0.028, 0.064, 0.118))
    assert known.arc_lengths == (0.01, 0.028, 0.064, 0.118)


def test_metres_that_are_called_millimetres_are_refused():
    lengths = np.array([0.03, 0.06, 0.09, 0.12])
    postures = np.array([arc(r, lengths, t) for r, t in ((1e5, 0), (0.1, 0), (0.08, 2))])
    with pytest.raises(DataSetError, match=r'up to 0\.09 mm apart, the arm is 120 mm'):
        order_markers(1e-3 * postures, COARSE)


def test_places_are_measured_along_an_arm_that_is_never_straight():
    lengths = np.array([0.012, 0.03, 0.066, 0.12])
    random = np.random.default_rng(1)
    postures = np.array([arc(r, lengths, t) for r in (0.15, 0.1, 0.08, -0.1) for t in range(9)])
    order = order_markers(postures + random.normal(0.0, 2e-4, postures.shape), COARSE)
    assert_allclose(order.arc_lengths, lengths, atol=3e-4)
    even = np.array([arc(r, [0.03, 0.06, 0.09, 0.12]) for r in (1e5, 0.1, 0.07)])
    assert order_markers(even, COARSE).arc_lengths == (0.03, 0.06, 0.09, 0.12)


def test_markers_beside_the_arm_and_markers_that_stand_twice_are_left_out():
    lengths = np.array([0.03, 0.06, 0.09, 0.12])
    postures = np.array([arc(r, lengths) for r in (1e5, 0.1, 0.07)])
    base, twice = np.array([0.0, 0.0, -0.04]), postures[:, 1:2] + 1e-4
    everything = np.concatenate([postures, np.tile(base, (3, 1, 1)), twice], axis=1)
    order = order_markers(everything, COARSE)
    assert order.members == (0, 1, 2, 3)
    assert (order.off_arm, order.twice) == ((4,), (5,))


@pytest.mark.parametrize(
    ('places', 'message'),
    [
        ((0.03, 0.06), 'has 4 markers, but 2 places on the arm are given'),
        ((0.01, 0.02, 0.03, 0.04), 'are 90 mm apart where the arm is straightest, but 30 mm'),
    ],
)
def test_places_that_do_not_fit_are_refused(places, message):
    postures = np.array([arc(r, [0.03, 0.06, 0.09, 0.12]) for r in (1e5, 0.1, 0.07)])
    with pytest.raises(DataSetError, match=message):
        order_markers(postures, COARSE, places)


def test_a_rigid_fit_gives_rotation_and_shift_back():
    random = np.random.default_rng(2)
    points, turn = random.normal(size=(9, 3)), Rotation.random(random_state=3).as_matrix()
    found, shift = rigid_fit(points, points @ turn.T + [1.0, 2.0, 3.0], random.uniform(1, 2, 9))
    assert_allclose(found, turn, atol=1e-12)
    assert_allclose(shift, [1.0, 2.0, 3.0], atol=1e-12)
