"""Displacement input: from wire pulls to tensions and shape, with slack wires."""

from dataclasses import replace

import numpy as np
import pytest
from arms import GRAVITY, planar, spatial, two_sections
from source_tree import ROOT

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.pulls import pull_shapes
from tendon_robot_ros.robot import load_robot

R, NAN = 0.0055, np.nan
FRICTION = {'tendon_friction': {'friction_coefficient': 0.3}}
REFINED = FRICTION | {
    'eyelet_wrap': {'fraction': 1.0},
    'straight_tendon': {'fraction': 1.0},
    'tendon_travel': {'fraction': 1.0},
}


def test_pcca_bends_each_section_by_its_pull_over_its_arm():
    """The closed form: constant curvature, whatever the stiffness."""
    shape = Model(two_sections(5)).pull_shape({'near_right': 0.004, 'far_right': 0.007})
    near, far = 0.004 / R, (0.007 - 0.004) / R
    assert np.allclose(shape.bend[:5, 0], near / 5, rtol=1e-6)
    assert np.allclose(shape.bend[5:, 0], far / 5, rtol=1e-6)
    assert shape.pulls == pytest.approx([-0.004, 0.004, -0.007, 0.007], abs=1e-8)
    assert shape.inputs[[0, 2]] == pytest.approx([0.0, 0.0])


def test_pcca_in_space_bends_towards_the_pulled_tendon():
    shape = Model(spatial(5)).pull_shape({'near_1': 0.003})
    angle = 2 * np.pi / 3
    bend = 0.003 / 0.006 / 5 * np.array([np.cos(angle), np.sin(angle)])
    assert np.allclose(shape.bend[:5], bend, rtol=1e-6)
    assert np.allclose(shape.bend[5:], 0.0, atol=1e-12)


@pytest.mark.parametrize('left', [NAN, None, -0.006])
def test_a_wire_without_a_pull_or_with_too_little_is_slack(left):
    """The right side is pulled by 4 mm: on the left 4 mm must be fed, and more is no matter."""
    model = Model(planar(6, FRICTION))
    shape = model.pull_shape({'left': left, 'right': 0.004})
    assert shape.inputs[0] == 0.0 and shape.pulls == pytest.approx([-0.004, 0.004], abs=1e-8)
    in_order = model.pull_shape([NAN, 0.004])
    assert np.allclose(shape.positions, in_order.positions, atol=1e-8)
    assert left == -0.006 or np.array_equal(shape.positions, in_order.positions)


def test_wires_that_cannot_be_so_short_together_are_refused():
    with pytest.raises(InputError) as caught:
        Model(planar(6, FRICTION)).pull_shape([0.002, 0.004])
    assert str(caught.value) == (
        'pulls: no tensions give left 2 mm, right 4 mm together (off by 3 mm); '
        'release one of the wires'
    )


def test_stretching_wires_may_both_be_pulled():
    effects = FRICTION | {'tendon_elongation': {'compliance': 0.01}}
    shape = Model(planar(6, effects)).pull_shape([0.0005, 0.002])
    assert shape.pulls == pytest.approx([0.0005, 0.002], abs=1e-8)
    assert (shape.inputs > 0.0).all()


def test_both_wires_fed_leave_the_arm_straight_and_slack():
    shape = Model(planar(6, FRICTION)).pull_shape([-0.001, -0.002])
    assert np.array_equal(shape.inputs, [0.0, 0.0])
    assert np.array_equal(shape.bend, np.zeros((6, 2)))


ROBOTS = {
    'pcca': two_sections(6),
    'fkm': two_sections(6, FRICTION),
    'refined': two_sections(6, REFINED, 'hinge'),
    'spatial': spatial(5, REFINED),
    'spatial fkm': spatial(5, FRICTION, 'arc'),
    'heavy': replace(
        two_sections(6, REFINED | {'gravity': {'linear_density': 0.2}}), gravity=GRAVITY
    ),
    'stretching': spatial(5, REFINED | {'tendon_elongation': {'compliance': 0.003}}),
    'sprung': spatial(
        5,
        REFINED
        | {
            'wire_spring': {'compliance': (1e-3, 8e-4, 6e-4, 4e-4, 3e-4, 2e-4)},
            'pull_zero': {'offset': 5e-4},
        },
    ),
    'remembering': two_sections(6, REFINED | {'friction_memory': {'presliding_length': 1e-4}}),
}


@pytest.mark.parametrize('robot', ROBOTS.values(), ids=ROBOTS)
def test_pulls_of_a_shape_give_the_shape_back(robot):
    """One or two tendons per section pull, all others are slack."""
    model, random = Model(robot), np.random.default_rng(3)
    per_section = len(robot.inputs) // 2
    for _ in range(8):
        tensions = np.zeros((2, per_section))
        for s in range(2):
            pulling = random.choice(per_section, per_section - 1, replace=False)
            tensions[s, pulling] = random.uniform(0.1, 0.9, per_section - 1)
        tensions = tensions.reshape(-1)
        shape = model.shape(tensions)
        again = model.pull_shape(np.where(tensions > 0.0, shape.pulls, NAN))
        assert np.array_equal(again.inputs > 0.0, tensions > 0.0)
        assert np.allclose(again.pulls[tensions > 0], shape.pulls[tensions > 0], rtol=0, atol=1e-8)
        if robot is ROBOTS['spatial fkm']:
            continue  # signs of single cells flip: now and then two tensions give the same pulls
        assert np.allclose(again.positions, shape.positions, rtol=0, atol=1e-6)
        assert np.allclose(again.inputs, tensions, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize('robot', ['kato_10_1', 'kato_1_1'])
def test_of_wires_that_pull_against_each_other_lengths_hold_one(robot):
    """Moments balance whatever the tension of a pair; wires that stretch leave one slack."""
    model = Model(load_robot(ROOT / f'config/robots/{robot}.yaml'))
    random = np.random.default_rng(2)
    for tensions in random.uniform(0.1, 1.5, (12, 4)):
        asked = model.shape(tensions).pulls
        held = model.pull_shape(asked)
        assert np.minimum(held.inputs[::2], held.inputs[1::2]) == pytest.approx(0.0, abs=1e-6)
        assert np.allclose(held.pulls, asked, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(
    ('robot', 'most'),
    [(spatial(6, REFINED, 'hinge'), 1.0), ('spatial_3', 2.0), ('spatial_6', 2.0)],
    ids=['small', 'spatial_3', 'spatial_6'],
)
def test_pulls_of_any_posture_of_a_spatial_arm_are_met(robot, most):
    """All tendons pull hard, so that friction holds and turns at many guides."""
    model = Model(load_robot(robot))
    random = np.random.default_rng(0)
    for tensions in random.uniform(0.1, most, (20, len(model.inputs))):
        asked = model.shape(tensions).pulls
        assert np.allclose(model.pull_shape(asked).pulls, asked, rtol=0.0, atol=5e-6)


def test_the_same_lengths_give_the_same_arm_wherever_it_comes_from():
    model = Model(two_sections(8, REFINED, 'hinge'))
    pulls = model.shape([0.9, 0.1, 0.2, 0.7]).pulls
    first = model.pull_shape(pulls)
    for tensions in ([0.9, 0.1, 0.2, 0.7], [0.0, 0.8, 0.3, 0.0], [1.0, 1.0, 1.0, 1.0]):
        again = model.pull_shape(pulls, model.shape(tensions))
        assert np.allclose(again.inputs, first.inputs, rtol=0.0, atol=1e-3)


def test_a_group_of_tendons_is_pulled_by_its_mean():
    model = Model(load_robot(ROOT / 'config/robots/kato_1_1.yaml'))
    shape = model.pull_shape({'prox_right': 0.0009, 'dist_right': 0.0013})
    assert shape.pulls[[1, 3]] == pytest.approx([0.0009, 0.0013], abs=1e-9)
    assert shape.tendon_pulls[3:6] == pytest.approx([0.0009] * 3, abs=1e-9)


def test_a_batch_of_pulls_equals_single_ones_and_may_start_from_guesses():
    model = Model(two_sections(5, REFINED))
    rows = np.array([[NAN, 0.003, NAN, 0.006], [0.002, NAN, NAN, 0.004], [NAN, NAN, 0.005, NAN]])
    batch = pull_shapes(model, rows)
    for row, positions in zip(rows, batch.positions, strict=True):
        assert np.allclose(model.pull_shape(row).positions, positions, rtol=0, atol=1e-9)
    again = pull_shapes(model, rows, batch.inputs, batch.state)
    assert np.allclose(again.positions, batch.positions, rtol=0, atol=1e-9)


def test_pulls_in_a_sequence_remember():
    model = Model(planar(8, REFINED | {'friction_memory': {'presliding_length': 1e-4}}))
    tensions = np.array([[0.0, 0.5], [0.0, 1.0], [0.0, 0.6]])
    forward = model.sequence(tensions)
    rows = np.where(tensions > 0.0, forward.pulls, NAN)
    batch = pull_shapes(model, rows, memory=model.arrays.fresh_memory())
    assert np.allclose(batch.positions, forward.positions, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ('pulls', 'message'),
    [
        ({'up': 0.1}, "pulls: unknown 'up'; planar has left, right"),
        ([0.1], 'pulls: expected 2 lengths [m] (blank: slack), got [0.1]'),
        ([np.inf, 0.0], 'pulls: expected 2 lengths [m] (blank: slack), got [inf, 0.0]'),
        (['a', 'b'], "pulls: expected 2 lengths [m] (blank: slack), got ['a', 'b']"),
    ],
)
def test_pulls_that_are_none_are_refused(pulls, message):
    with pytest.raises(InputError) as caught:
        Model(planar(2)).pull_shape(pulls)
    assert str(caught.value) == message
