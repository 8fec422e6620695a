"""What can be worked out with a pencil."""

from dataclasses import replace

import numpy as np
import pytest
from arms import planar, spatial, two_sections, wound
from reference import Reference
from scipy.optimize import brentq, minimize
from scipy.spatial.transform import Rotation

from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Tendon

K, L, R = 0.027, 0.007, 0.0055  # of the planar arm [N·m/rad], [m], [m]


def bend(robot, inputs):
    """Bends (n,) towards x."""
    return Model(robot).shape(inputs).bend[:, 0]


def test_without_effects_the_curvature_is_constant_and_the_tip_lies_on_the_circle():
    shape = Model(planar(15)).shape({'right': 0.8, 'left': 0.3})
    theta = 0.5 * R / K
    assert np.allclose(shape.bend, [theta, 0.0], rtol=1e-14)
    radius, angle = L / theta, 15 * theta
    circle = [radius * (1 - np.cos(angle)), 0.0, radius * np.sin(angle)]
    assert np.allclose(shape.tip_position, circle, rtol=0, atol=1e-15)
    assert np.allclose(
        shape.tip_direction, [np.sin(angle), 0.0, np.cos(angle)], rtol=0, atol=1e-14
    )
    assert np.allclose(shape.pulls, [-R * angle, R * angle], rtol=1e-13)


def test_hinged_cells_end_half_a_length_before_and_after_the_joint():
    shape = Model(planar(1, bends_as='hinge')).shape([0.0, 0.9])
    theta = 0.9 * R / K
    assert np.allclose(
        shape.tip_position, [0.5 * L * np.sin(theta), 0.0, 0.5 * L * (1 + np.cos(theta))]
    )


def test_bends_of_sections_add_their_tendons():
    found = bend(two_sections(2), [0.0, 0.4, 0.0, 0.6])
    assert np.allclose(found, [1.0 * R / K] * 2 + [0.6 * R / 0.021] * 2)


def test_three_equal_tensions_around_leave_a_spatial_arm_straight():
    shape = Model(spatial(3)).shape([0.7, 0.7, 0.7, 0.2, 0.2, 0.2])
    assert np.abs(shape.bend).max() < 1e-16


def test_friction_leaves_the_product_of_opposite_tensions_as_it_is():
    shape = Model(planar(20, {'tendon_friction': {'friction_coefficient': 0.4}})).shape([0.2, 1.0])
    left, right = shape.tendon_tensions.T
    assert np.allclose(left * right, 0.2, rtol=1e-12)
    assert np.all(np.diff(right) < 0.0) and np.all(np.diff(left) > 0.0)
    b = 0.4 * np.sin(shape.bend[:-1, 0] / 2)
    assert np.allclose(right[1:] / right[:-1], (1 - b) / (1 + b), rtol=1e-12)


def test_friction_on_an_arm_of_given_bend_is_a_geometric_series():
    """A stiff arm that is bent at rest: every eyelet turns the tendon by the same angle."""
    angle = 0.1
    effects = {
        'tendon_friction': {'friction_coefficient': 0.5},
        'pre_curvature': {'angle_x': angle, 'angle_y': 0.0},
    }
    shape = Model(planar(10, effects, stiffness=40.0)).shape([0.0, 100.0])
    b = 0.5 * np.sin(angle / 2)  # the tendon itself bends the arm by another 14 %
    exact = 0.5 * np.sin(shape.bend[:, 0] / 2)
    ratio = (1 - exact) / (1 + exact)
    assert np.allclose(shape.tendon_tensions[1:, 1], 100.0 * np.cumprod(ratio[:-1]), rtol=1e-11)
    series = 100.0 * ((1 - b) / (1 + b)) ** np.arange(10)
    assert np.allclose(shape.tendon_tensions[:, 1], series, rtol=0.06)


def test_many_small_cells_lose_tension_along_a_hyperbola():
    """The limit of eq. (9) for small angles: dT/ds = -mu r T^2 / K."""
    n, mu = 400, 0.3
    effects = {'tendon_friction': {'friction_coefficient': mu}}
    shape = Model(planar(n, effects, stiffness=0.027 * n / 15)).shape([0.0, 1.0])
    rate = mu * R / (0.027 * n / 15)
    assert np.allclose(
        shape.tendon_tensions[:, 1], 1.0 / (1.0 + rate * np.arange(n)), rtol=2.0 * rate
    )


def test_hinge_friction_takes_its_lever_times_all_tension():
    effects = {'hinge_friction': {'lever': 4e-4}}
    assert np.allclose(bend(planar(4, effects), [0.0, 0.5]), (R - 4e-4) * 0.5 / K)
    pair = bend(planar(4, effects), [0.5, 1.0])
    assert np.allclose(pair, (R * 0.5 - 4e-4 * 1.5) / K)
    assert np.array_equal(bend(planar(4, effects), [0.95, 1.0]), np.zeros(4))


def test_clearance_adds_to_the_arm():
    effects = {'eyelet_clearance': {'clearance': 2e-4}}
    arm = R + 2e-4 / np.sqrt(1.0 + 0.03**2)
    assert np.allclose(bend(planar(4, effects), [0.0, 0.5]), arm * 0.5 / K, rtol=1e-13)
    assert np.array_equal(bend(planar(4, effects), [0.5, 0.5]), np.zeros(4))


def test_tapered_offsets_are_taken_in_the_middle_of_each_cell():
    robot = planar(4)
    right = Tendon('right', (R, 0.0), (0.5 * R, 0.0), 'only')
    arms = R * (1.0 - 0.5 * np.array([1, 3, 5, 7]) / 8)
    found = bend(replace(robot, tendons=(robot.tendons[0], right)), [0.0, 0.5])
    assert np.allclose(found, arms * 0.5 / K, rtol=1e-13)


def test_a_tapered_tendon_of_a_short_section_tapers_to_its_own_end():
    robot = two_sections(2)
    near = replace(robot.tendons[1], end=(0.0, 0.0))
    robot = replace(robot, tendons=(robot.tendons[0], near, *robot.tendons[2:]))
    assert np.allclose(bend(robot, [0, 1.0, 0, 0]), [0.75 * R / K, 0.25 * R / K, 0, 0])


def test_the_rest_shape_adds_to_the_bend():
    effects = {'pre_curvature': {'angle_x': 0.03, 'angle_y': -0.02}}
    model = Model(planar(5, effects))
    assert np.allclose(model.shape([0.0, 0.0]).bend, [0.03, -0.02])
    assert np.allclose(model.shape([0.0, 0.4]).bend, [0.03 + 0.4 * R / K, -0.02])
    assert np.array_equal(model.shape([0.0, 0.0]).pulls, [0.0, 0.0])


def test_compression_shortens_cells_by_all_tension_in_them():
    effects = {'axial_compression': {'compliance': 0.01}}
    shape = Model(two_sections(2, effects)).shape([0.5, 0.5, 1.0, 1.0])
    assert np.allclose(np.diff(shape.positions[:, 2], prepend=0.0), [0.00679] * 2 + [0.00588] * 2)
    assert np.array_equal(shape.pulls, np.zeros(4))


@pytest.mark.parametrize(
    ('effect', 'values', 'expected'),
    [
        ('backbone_stiffness', {'relative_change': 0.25}, 0.5 * R / (1.25 * K)),
        ('section_stiffness', {'relative_change': (-0.2,)}, 0.5 * R / (0.8 * K)),
        ('tendon_stiffness', {'per_tendon': 1e-3}, 0.5 * R / (K + 2e-3)),
        ('transmission_loss', {'fraction': 0.2}, 0.4 * R / K),
        ('tension_offset', {'offset': -0.1}, 0.4 * R / K),
        ('moment_arm', {'relative_change': 0.1}, 0.55 * R / K),
    ],
)
def test_one_number_changes_the_constant_curvature(effect, values, expected):
    assert np.allclose(bend(planar(3, {effect: values}), [0.0, 0.5]), expected, rtol=1e-13)


def test_an_offset_pulls_no_slack_tendon_and_no_tendon_ever_pushes():
    effects = {'tension_offset': {'offset': -0.3}}
    shape = Model(planar(2, effects)).shape([0.0, 0.2])
    assert np.array_equal(shape.tendon_tensions, np.zeros((2, 2)))


@pytest.mark.parametrize('cubic', [5.0, -0.4])
def test_a_cubic_spring_bends_to_its_root(cubic):
    moment = 1.5 * R
    root = brentq(lambda t: K * t * (1 + cubic * t * t) - moment, 0.0, 0.6, xtol=1e-16)
    assert np.allclose(
        bend(planar(2, {'nonlinear_stiffness': {'cubic': cubic}}), [0.0, 1.5]), root, rtol=1e-12
    )


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_the_arm_of_a_straight_tendon_is_the_derivative_of_its_travel(bends_as):
    model = Model(planar(1, {'straight_tendon': {'fraction': 1.0}}, bends_as))
    for tension in (0.5, 3.0):
        a = model.shape([0.0, tension]).bend[0, 0]
        travel = [model.shape([0.0, t]).pulls[1] for t in (tension * 0.999, tension * 1.001)]
        bends = [model.shape([0.0, t]).bend[0, 0] for t in (tension * 0.999, tension * 1.001)]
        arm = (travel[1] - travel[0]) / (bends[1] - bends[0])
        assert K * a / tension == pytest.approx(arm, rel=1e-6)
        half = 0.5 * a
        if bends_as == 'hinge':
            path, lever = L * (1 - np.cos(half)), 0.5 * L * np.sin(half)
        else:
            path = L - L * np.sin(half) / half
            lever = L / a * (np.sin(half) / half - np.cos(half))
        assert K * a / tension == pytest.approx(R * np.cos(half) + lever, rel=1e-9)
        pull = model.shape([0.0, tension]).pulls[1]
        assert pull == pytest.approx(path + 2 * R * np.sin(half), rel=1e-9)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_a_cantilever_deflects_under_a_small_force_as_in_the_textbook(bends_as):
    n, force = 20, 1e-6
    effects = {'tip_load': {'force_x': force, 'force_y': 0.0, 'force_z': 0.0}}
    tip = Model(planar(n, effects, bends_as)).shape([0.0, 0.0]).tip_position
    arms = (n - np.arange(n) - 0.5) * L
    beam = force * (n * L) ** 3 / (3.0 * K * L)  # EI = K L; arcs bow under loads, hinges do not
    textbook = {'arc': beam, 'hinge': force / K * (arms**2).sum()}[bends_as]
    assert tip[0] == pytest.approx(textbook, rel=1e-6)
    assert tip[0] == pytest.approx(beam, rel=1.0 / n**2)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_a_light_arm_held_out_sags_as_in_the_textbook(bends_as):
    n, density, g = 20, 1e-5, 9.81
    robot = planar(n, {'gravity': {'linear_density': density}}, bends_as)
    tip = Model(replace(robot, gravity=(g, 0.0, 0.0))).shape([0.0, 0.0]).tip_position
    weight, at = density * L * g, (np.arange(n) + 0.5) * L
    own = 0.125 * L if bends_as == 'arc' else 0.0  # how far a cell's own bend moves its middle
    moments = [weight * ((at[i + 1 :] - at[i]).sum() + own) for i in range(n)]
    bows = L**2 / (12.0 * K) * weight * (n - 0.5 - np.arange(n)) if bends_as == 'arc' else 0.0
    sags = (np.array(moments) / K * (n * L - at) + bows).sum()
    assert tip[0] == pytest.approx(sags, rel=1e-6)
    beam = density * g * (n * L) ** 4 / (8.0 * K * L)
    assert tip[0] == pytest.approx(beam, rel=0.4 / n**2 if bends_as == 'arc' else 1.0 / n)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_without_friction_the_equilibrium_has_the_least_energy(bends_as):
    effects = {
        'gravity': {'linear_density': 0.4},
        'tip_load': {'force_x': 0.02, 'force_y': 0.03, 'force_z': -0.05},
        'straight_tendon': {'fraction': 1.0},
        'pre_curvature': {'angle_x': 0.01, 'angle_y': 0.02},
        'torsion': {'compliance': 1.3},
    }
    robot = replace(wound(spatial(2, effects, bends_as)), gravity=(3.0, 1.0, -9.0))
    inputs = np.array([0.4, 0.0, 0.2, 0.9, 0.0, 0.1])
    shape, reference = Model(robot).shape(inputs), Reference(robot)
    tension = reference.tensions(inputs, shape.state)
    stiffness = np.array(reference.stiffness)[:, None]

    def energy(state):
        cells = reference.cells(state)
        elastic = 0.5 * (stiffness * (cells[:, :2] - reference.rest) ** 2).sum()
        elastic += 0.5 * (stiffness[:, 0] * cells[:, 2] ** 2).sum() / 1.3
        done = (tension * reference.travel(state)).sum()
        return 1e3 * (elastic + reference.energy(state, tension, np.zeros((4, 3))) - done)

    least = minimize(energy, np.zeros(12), tol=1e-10)
    assert energy(shape.state) <= least.fun + 1e-12
    assert np.allclose(shape.state, least.x, rtol=0, atol=1e-4)


def test_the_tracker_sees_the_robot_through_its_own_frame():
    values = {'shift_x': 0.01, 'shift_y': -0.02, 'shift_z': 0.005}
    values |= {'rotation_x': 0.1, 'rotation_y': -0.2, 'rotation_z': 0.3}
    model = Model(planar(3, {'base_misalignment': values}))
    points = model.shape([0.0, 1.0]).positions
    expected = Rotation.from_rotvec([0.1, -0.2, 0.3]).apply(points) + [0.01, -0.02, 0.005]
    assert np.allclose(model.measured(points), expected, rtol=0, atol=1e-15)
    assert model.measured(points[None, None]).shape == (1, 1, 3, 3)


def antagonists(cells, compliance, pretension):
    """Return one section whose two wires end in springs and are pulled more than commanded."""
    effects = {'wire_spring': {'compliance': compliance}, 'pull_zero': {'offset': pretension}}
    return Model(planar(cells, effects))


def test_wires_that_end_in_springs_share_a_pull_with_the_arm():
    """Both taut: b = 2 r p / (c K / n + 2 r^2), whatever the pretension; one slack: r (p + z)."""
    c, z, p = 4e-4, 2e-3, 1e-3
    model = antagonists(6, c, z)
    k, r = model.arrays.cells[0, 1] / 6, 0.0055
    bend = model.pull_shape([-p, p]).bend[:, 0].sum()
    assert bend == pytest.approx(2.0 * r * p / (c * k + 2.0 * r * r), rel=1e-8)
    shape = model.pull_shape([-0.02, 4e-3])
    assert shape.inputs[0] == 0.0
    assert shape.bend[:, 0].sum() == pytest.approx(r * (4e-3 + z) / (c * k + r * r), rel=1e-8)


def test_a_spring_takes_the_same_of_a_long_wire_as_of_a_short_one():
    for cells in (3, 9):
        plain, sprung = (
            Model(planar(cells, effects)).shape([0.2, 1.0])
            for effects in ({}, {'wire_spring': {'compliance': (1e-3, 2e-3)}})
        )
        assert np.array_equal(plain.positions, sprung.positions)
        assert np.allclose(sprung.pulls - plain.pulls, [0.2e-3, 2e-3], rtol=0, atol=1e-15)


def test_what_is_commanded_is_what_is_wound_less_the_offset_over_the_gain():
    effects = {
        'pull_zero': {'offset': (1e-3, -2e-3)},
        'spool_gain': {'relative_change': (0.25, 0.0)},
    }
    plain, wound = (Model(planar(4, given)).shape([0.3, 1.0]) for given in ({}, effects))
    expected = (plain.pulls - [1e-3, -2e-3]) / [1.25, 1.0]
    assert np.allclose(wound.pulls, expected, rtol=0, atol=1e-15)


def test_elongation_adds_strain_to_the_wire_pull_only():
    plain = Model(planar(4)).shape([0.3, 1.0])
    stretched = Model(planar(4, {'tendon_elongation': {'compliance': 0.01}})).shape([0.3, 1.0])
    assert np.array_equal(plain.positions, stretched.positions)
    assert np.allclose(stretched.pulls - plain.pulls, 0.01 * 4 * L * np.array([0.3, 1.0]))
