"""Every equilibrium of the kernel satisfies the laws as test/reference.py states them."""

from dataclasses import replace

import numpy as np
import pytest
from arms import GRAVITY, TYPICAL, planar, section, soft_cell, spatial, two_sections, wound
from reference import Reference
from source_tree import ROOT

from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot


def check(robot, inputs, accuracy=1e-7):
    """Compare one posture: bends, tensions, positions and wire pulls."""
    shape, reference = Model(robot).shape(inputs), Reference(robot)
    assert np.abs(reference.implied(inputs, shape.state) - shape.state).max() < accuracy
    tension = reference.tensions(inputs, shape.state)
    assert np.allclose(tension, shape.tendon_tensions, rtol=1e-7, atol=1e-12)
    assert np.allclose(
        reference.positions(shape.state, tension), shape.positions, rtol=0, atol=1e-12
    )
    assert np.allclose(
        reference.wire_pulls(shape.state, tension), shape.tendon_pulls, rtol=0, atol=1e-10
    )


def some(random, robot):
    """Return random tensions, one in three of them slack."""
    m = len(robot.inputs)
    return random.uniform(0.05, 2.0, m) * (random.random(m) > 0.33)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.parametrize('effect', TYPICAL)
def test_each_effect_with_friction_in_space(effect, bends_as):
    effects = {'tendon_friction': TYPICAL['tendon_friction'], effect: TYPICAL[effect]}
    robot = replace(spatial(3, effects, bends_as, taper=0.6), gravity=GRAVITY)
    random = np.random.default_rng(1)
    for _ in range(2):
        check(robot, some(random, robot))


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.parametrize(
    'names',
    [[], ['torsion'], ['straight_tendon'], ['torsion', 'tendon_friction', 'tendon_travel']],
)
def test_tendons_that_wind_and_weight_beside_the_axis(names, bends_as):
    effects = {name: TYPICAL[name] for name in [*names, 'gravity']}
    robot = replace(wound(spatial(3, effects, bends_as, taper=0.6)), gravity=GRAVITY)
    random = np.random.default_rng(6)
    for _ in range(2):
        check(robot, some(random, robot))


def wound_spatial(cells, effects, bends_as):
    """Return a spatial arm whose tendons wind and whose weight lies beside the axis."""
    return wound(spatial(cells, effects, bends_as))


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.parametrize('make', [two_sections, spatial, wound_spatial])
def test_all_effects_at_once(make, bends_as):
    robot = replace(make(4, TYPICAL, bends_as), gravity=GRAVITY)
    random = np.random.default_rng(2)
    for _ in range(4):
        check(robot, some(random, robot))


def test_any_mix_of_effects():
    random = np.random.default_rng(3)
    for _ in range(15):
        names = [name for name in TYPICAL if random.random() < 0.4]
        robot = spatial(
            3, {name: TYPICAL[name] for name in names}, random.choice(['arc', 'hinge'])
        )
        robot = replace(robot, gravity=tuple(random.normal(0.0, 5.0, 3)))
        check(robot, some(random, robot))


def test_three_sections_with_tendons_of_any_number_and_cells_of_their_own():
    robot = spatial(2, TYPICAL)
    third = section('last', 3, 0.004, 0.01, 'arc')
    third = replace(third, bending_stiffness=(0.02, 0.01, 0.005), mass_profile=(2.0, 1.0, 0.5))
    far = replace(robot.tendons[0], name='extra', section='last', base=(0.002, 0.003))
    effects = dict(TYPICAL) | {'section_stiffness': {'relative_change': (0.1, 0.2, -0.1)}}
    robot = replace(
        robot,
        sections=(*robot.sections, third),
        tendons=(*robot.tendons[:4], far),
        effects=effects,
        gravity=GRAVITY,
    )
    check(robot, [0.4, 0.0, 1.1, 0.3, 0.9])


def test_one_cell():
    check(planar(1, {'straight_tendon': {'fraction': 1.0}}, 'hinge'), [0.0, 2.0])


def test_a_cell_that_bends_far_among_others_that_do_not():
    robot = planar(4, {'straight_tendon': {'fraction': 1.0}}, length=0.02)
    robot = soft_cell(robot, 3, 0.04)
    bends = np.abs(Model(robot).shape([0.0, 0.5]).bend[:, 0])
    assert bends[2] > 1.6 and bends[[0, 1, 3]].max() < 0.4  # half_turn: series and closed form
    check(robot, [0.0, 0.5])


@pytest.mark.parametrize('largest', [1e-3, 0.05, 1.0])
def test_tendons_on_opposite_sides_that_hardly_slide(largest):
    """Those that travel alike share their direction of friction, of opposite sign."""
    robot = two_sections(6, {'tendon_friction': TYPICAL['tendon_friction']})
    random = np.random.default_rng(5)
    for _ in range(3):
        check(robot, largest * random.random(len(robot.inputs)))


def test_the_papers_recursion_to_the_letter():
    """Equations 2, 8, 9 and 10 of Kato et al. 2015 for a plane, in ten lines."""
    robot = load_robot(ROOT / 'config/robots/kato_10_1.yaml')
    tension, arm = np.array([0.05, 0.4, 0.05, 0.6]), [-5.5e-3, 5.5e-3, -5.5e-3, 5.5e-3]
    shape, ends, angle, tip = Model(robot).shape(tension), [15, 15, 30, 30], 0.0, np.zeros(2)
    for i in range(30):
        present = [k for k in range(4) if i < ends[k]]
        assert np.allclose(shape.tendon_tensions[i, present], tension[present], rtol=1e-12)
        moment = sum(arm[k] * tension[k] for k in present)
        theta = moment / 0.027
        assert shape.bend[i] == pytest.approx([theta, 0.0], abs=1e-14)
        chord = 0.0069333333333333 * np.sinc(0.5 * theta / np.pi)
        tip += chord * np.array([np.sin(angle + 0.5 * theta), np.cos(angle + 0.5 * theta)])
        angle += theta
        assert shape.positions[i] == pytest.approx([tip[0], 0.0, tip[1]], abs=1e-14)
        b = 0.33 * np.sin(abs(theta) / 2)
        for k in present:
            tension[k] *= ((1 - b) / (1 + b)) ** (np.sign(arm[k]) * np.sign(moment))
