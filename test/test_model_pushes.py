"""What pushes the arm at a place: point loads, tethers, contact; moments; closed forms."""

import math

import numpy as np
import pytest
from arms import planar, spatial

from tendon_robot_ros.model.model import Model

WALL = {'stiffness': 500.0, 'distance': 0.01, 'azimuth': math.pi, 'elevation': 0.0}
SLACK = [0.0, 0.0]
PULLED = [0.0, 0.9]
LENGTH = 0.042  # [m] of the planar arm of six cells
STACKED = planar(bends_as='hinge')  # a hinge does not bow: forces act where positions are
STIFFNESS = 0.027  # [N·m/rad] of a cell


def shape(effect, values, inputs=SLACK, robot=None):
    return Model((robot or planar()).with_effect(effect, values)).shape(inputs)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.parametrize('effect', ['tip_load', 'point_load'])
@pytest.mark.parametrize('axis', 'xy')
def test_a_moment_bends_all_cells_before_it_alike(bends_as, effect, axis):
    """M = K a in every cell, whatever the shape: about y towards x, about x away from y."""
    moment, cells = 0.01, 4 if effect == 'point_load' else 6
    values = {f'moment_{axis}': moment}
    if effect == 'point_load':
        values['arc_length'] = 4 * 0.007
    bend = shape(effect, values, robot=planar(bends_as=bends_as)).bend
    expected = np.zeros((6, 2))
    expected[:cells, 'yx'.index(axis)] = moment / STIFFNESS * (1.0 if axis == 'y' else -1.0)
    assert np.allclose(bend, expected, rtol=0, atol=1e-9)


def test_a_point_load_at_the_tip_is_a_tip_load():
    wrench = {'force_x': 0.3, 'force_y': -0.2, 'force_z': 0.1, 'moment_y': 0.004}
    ends = [
        shape(effect, values, PULLED).frames
        for effect, values in (
            ('tip_load', wrench),
            ('point_load', {**wrench, 'arc_length': LENGTH}),
        )
    ]
    assert np.allclose(*ends, rtol=0, atol=1e-12)


def test_nothing_bends_beyond_a_point_load():
    bend = shape('point_load', {'arc_length': 0.021, 'force_x': 0.4}).bend
    assert (bend[:3, 0] > 1e-3).all() and np.allclose(bend[3:], 0.0, rtol=0, atol=1e-12)


def test_a_load_within_a_cell_is_statically_the_same():
    """Its moment about a bend is its arm times the force, of an arm that is almost rigid."""
    robot = planar(stiffness=1e4)
    for place in (0.0245, 0.03, 0.0415):
        first = shape('point_load', {'arc_length': place, 'force_x': 1.0}, robot=robot).bend[0, 0]
        middle = 0.0035  # of the first cell, whose bend a force turns about
        assert first == pytest.approx((place - middle) / 1e4, rel=1e-3)


def test_a_force_that_follows_turns_with_the_arm():
    """A follower across a cantilever of one cell is held by the same moment at any size."""
    robot = planar(cells=1, bends_as='hinge')
    for force in (0.1, 5.0, 20.0):
        values = {'arc_length': 0.007, 'force_x': force, 'follows': 1.0}
        bend = shape('point_load', values, robot=robot).bend[0, 0]
        assert bend == pytest.approx(force * 0.0035 / STIFFNESS, rel=1e-9)


def test_a_tether_is_slack_or_pulls_along_itself():
    place, far = 0.035, {'point_x': 0.05, 'point_y': 0.02, 'point_z': 0.03}
    slack = {'arc_length': place, **far, 'slack_length': 0.2, 'stiffness': 9.0}
    assert not shape('tether', slack).bend.any()
    values = {'arc_length': place, **far, 'slack_length': 0.01, 'stiffness': 4.0, 'tension': 0.1}
    tied = shape('tether', values, robot=STACKED)
    away = np.array([*far.values()]) - tied.positions[4]
    size = 0.1 + 4.0 * (np.linalg.norm(away) - 0.01)
    force = dict(
        zip(('force_x', 'force_y', 'force_z'), size * away / np.linalg.norm(away), strict=True)
    )
    loaded = shape('point_load', {'arc_length': place, **force}, robot=STACKED)
    assert np.allclose(tied.positions, loaded.positions, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ('kind', 'curvature', 'is_pole'),
    [('wall', 0.0, 0.0), ('ball', 50.0, 0.0), ('pole', 50.0, 1.0)],
)
@pytest.mark.parametrize('spatially', [False, True])
def test_a_pulled_arm_stops_at_what_it_touches(kind, curvature, is_pole, spatially):
    """The push is normal to the surface, holds the depth by its stiffness, and is gone before."""
    robot, inputs = (spatial(), [1.5, 0.0, 0.0, 1.0, 0.2, 0.0]) if spatially else (STACKED, PULLED)
    free = Model(robot).shape(inputs)
    aside = free.tip_position * [0.6, 0.6, 0.9 if kind == 'ball' else 0.0]
    distance = float(np.linalg.norm(aside))
    normal = -aside / distance
    values = {'stiffness': 1e3, 'distance': distance, 'azimuth': math.atan2(*normal[1::-1])}
    values |= {'elevation': math.asin(normal[2]), 'curvature': curvature, 'is_pole': is_pole}
    values |= {'axis': 0.5 * math.pi}  # upright
    stopped = Model(robot.with_effect('contact', values)).shape(inputs)
    depth = -(stopped.positions + distance * normal) @ normal
    if curvature:
        off = stopped.positions + (distance + 1.0 / curvature) * normal
        off[:, 2] *= 1.0 - is_pole
        depth = 1.0 / curvature - np.linalg.norm(off, axis=1)
    assert 0.0 < depth.max() < 1e-3
    assert np.linalg.norm(stopped.tip_position - free.tip_position) > 1e-3
    beyond = {**values, 'distance': 10.0 * distance}
    apart = Model(robot.with_effect('contact', beyond)).shape(inputs)
    assert np.allclose(apart.positions, free.positions, rtol=0, atol=1e-12)


def test_a_large_ball_is_a_wall_and_a_hollow_one_holds_from_all_sides():
    flat = shape('contact', WALL, PULLED).positions
    near = shape('contact', {**WALL, 'curvature': 1e-6}, PULLED).positions
    assert np.allclose(flat, near, rtol=0, atol=1e-7)
    tube = {'stiffness': 3e3, 'distance': 0.004, 'azimuth': 0.0, 'elevation': 0.0}
    tube |= {'curvature': -250.0, 'is_pole': 1.0, 'axis': 0.5 * math.pi}
    for inputs in ([0.0, 0.9], [0.9, 0.0]):
        held = shape('contact', tube, inputs).positions
        assert 0.0039 < np.abs(held[:, 0]).max() < 0.0045


def rubbing(spatially, coefficient):
    """Return an arm of hinges, a wall that its tip reaches, tensions, and the normal (3,)."""
    robot, inputs = STACKED, np.array(PULLED)
    if spatially:
        robot, inputs = spatial(), np.array([1.5, 0.0, 0.0, 1.0, 0.2, 0.0])
    aside = Model(robot).shape(inputs).tip_position * [0.6, 0.6, 0.0]
    normal = -aside / np.linalg.norm(aside)
    wall = {**WALL, 'distance': float(-aside @ normal), 'azimuth': math.atan2(*normal[1::-1])}
    wall['friction_coefficient'] = coefficient
    return robot, wall, inputs, normal


def pushed_by(wall, normal, tip):
    """Return the normal force [N] on a tip (3,), and how far the tip is along the wall (3,)."""
    return wall['stiffness'] * -(tip @ normal + wall['distance']), tip - (tip @ normal) * normal


def tip_under(robot, inputs, force):
    load = dict(zip(('force_x', 'force_y', 'force_z'), force.tolist(), strict=True))
    return Model(robot.with_effect('tip_load', load)).shape(inputs).tip_position


@pytest.mark.parametrize('spatially', [False, True])
@pytest.mark.parametrize('coefficient', [0.1, 0.4])
def test_what_slides_along_a_wall_is_held_by_its_share_of_the_normal_force(spatially, coefficient):
    """Coulomb: from straight the tip comes down along the wall, and friction points against it."""
    robot, wall, inputs, normal = rubbing(spatially, coefficient)
    tip = Model(robot.with_effect('contact', wall)).shape(inputs).tip_position
    push, place = pushed_by(wall, normal, tip)
    slid = place - [0.0, 0.0, robot.length]
    assert push > 0.01 and np.linalg.norm(slid) * wall['stiffness'] > coefficient * push
    force = push * (normal - coefficient * slid / np.linalg.norm(slid))
    assert np.allclose(tip, tip_under(robot, inputs, force), rtol=0, atol=1e-9)


@pytest.mark.parametrize('spatially', [False, True])
def test_what_turns_back_on_a_wall_sticks_until_friction_has_turned_round(spatially):
    """Within the cone it moves by no more than friction over stiffness; beyond, it slides."""
    robot, wall, inputs, normal = rubbing(spatially, 0.4)
    arm = Model(robot.with_effect('contact', wall))
    path = arm.sequence(np.array([1.0, 0.998, 0.7])[:, None] * inputs).tip_position
    (push, there), (_, stuck), (last, back) = (pushed_by(wall, normal, tip) for tip in path)
    slid = there - [0.0, 0.0, robot.length]
    before = -0.4 * push * slid / np.linalg.norm(slid)
    held = before - wall['stiffness'] * (stuck - there)
    normal_force = pushed_by(wall, normal, path[1])[0]
    assert np.linalg.norm(held) < 0.4 * normal_force
    force = normal_force * normal + held
    assert np.allclose(path[1], tip_under(robot, 0.998 * inputs, force), rtol=0, atol=1e-9)
    returned = back - stuck
    assert returned @ slid < 0.0
    friction = held - wall['stiffness'] * returned
    force = last * (normal + 0.4 * friction / np.linalg.norm(friction))
    assert np.allclose(path[2], tip_under(robot, 0.7 * inputs, force), rtol=0, atol=1e-9)
    forgets = Model(robot.with_effect('contact', {**wall, 'friction_coefficient': 0.0}))
    assert np.linalg.norm(path[1] - path[0]) < 0.7 * np.linalg.norm(
        np.subtract(*(forgets.shape(share * inputs).tip_position for share in (1.0, 0.998)))
    )


@pytest.mark.parametrize('spatially', [False, True])
def test_a_wall_without_friction_is_one_without_memory(spatially):
    robot, wall, inputs, _ = rubbing(spatially, 0.0)
    smooth = Model(robot.with_effect('contact', wall))
    wall.pop('friction_coefficient')
    shares = np.array([0.5, 1.0, 0.9])[:, None] * inputs
    assert not smooth.remembers
    alone = Model(robot.with_effect('contact', wall)).shapes(shares).positions
    assert np.array_equal(smooth.shapes(shares).positions, alone)
    assert np.allclose(smooth.sequence(shares).positions, alone, rtol=0, atol=1e-9)
