"""A backbone that keeps part of its bend: Dahl's law in two directions, loops and derivatives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from arms import COARSE, misses, planar, spatial, two_sections
from marks import slow

from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.derivatives import path_near
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.pulls import pull_shapes
from tendon_robot_ros.report.comparison import comparison_page
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

LAG, RATIO, STIFFNESS, ARM = 0.03, 2.0, 0.027, 0.0055
HELD = {'bending_hysteresis': {'lag': LAG, 'presliding': RATIO}}
FRICTION = {'tendon_friction': {'friction_coefficient': 0.3}, 'tendon_travel': {'fraction': 1.0}}
# soft, and so near that all cells touch it in all postures
WALL = {'contact': {'stiffness': 0.3, 'distance': -0.05, 'azimuth': 3.0}}
WALL['contact']['friction_coefficient'] = 0.2
REMEMBERED = {'tendon_friction': {'friction_coefficient': 0.3}}
REMEMBERED['friction_memory'] = {'presliding_length': 1e-3}
PATHS = 'tensions', 'pulls', 'tensions, friction that remembers'
LAW = load_catalogue()['bending_hysteresis'].law


def test_the_moment_held_tends_to_the_lag_along_the_motion():
    random = np.random.default_rng(4)
    for held, angle, size in zip(
        random.uniform(-0.5, 0.5, (40, 2)),
        random.uniform(0, 2 * np.pi, 40),
        random.uniform(0, 0.1, 40),
        strict=True,
    ):
        u = np.array([math.cos(angle), math.sin(angle)])
        most, kept = STIFFNESS * LAG, math.exp(-RATIO * size / LAG)
        after = LAW(*(most * held), *(size * u), STIFFNESS, LAG, RATIO)
        assert np.allclose(after, most * (u + (held - u) * kept), rtol=0, atol=1e-15)
        # two parts of a straight motion are the whole; full resistance is never passed
        first = LAW(*(most * held), *(0.3 * size * u), STIFFNESS, LAG, RATIO)
        assert np.allclose(LAW(*first, *(0.7 * size * u), STIFFNESS, LAG, RATIO), after)
        assert np.hypot(*after) <= most
        # where it turns back from full resistance, the cell is stiffer by twice K presliding
        step = 1e-7 * LAG
        back = np.subtract(LAW(*(-most * u), *(step * u), STIFFNESS, LAG, RATIO), -most * u)
        assert back @ u / step == pytest.approx(2.0 * RATIO * STIFFNESS, rel=1e-5)
    assert LAW(0.1, -0.2, 0.0, 0.0, STIFFNESS, LAG, RATIO) == (0.1, -0.2)
    assert LAW(0.1, -0.2, 0.3, 0.4, STIFFNESS, 0.0, RATIO) == (0.0, 0.0)


def test_a_loop_of_one_cell_has_its_closed_form():
    """Loaded far, let go, pulled from the other side, let go: bends M / K - u lag, and +- lag."""
    model = Model(planar(1, HELD))
    far = 4.0
    turns = model.sequence([[0.0, far], [0.0, 0.0], [far, 0.0], [0.0, 0.0]]).bend[:, 0, 0]
    elastic = far * ARM / STIFFNESS
    # e^(-2 x 0.8 / 0.03) of the loading is left of what came before
    assert turns == pytest.approx([elastic - LAG, LAG, LAG - elastic, -LAG], abs=1e-9)


@pytest.mark.parametrize('robot', [two_sections(4, HELD), spatial(3, HELD)])
@pytest.mark.parametrize('friction', [{}, FRICTION], ids=['alone', 'with friction'])
def test_a_shape_that_follows_another_is_that_of_the_sequence(robot, friction):
    model = Model(replace(robot, effects=robot.effects | friction))
    random = np.random.default_rng(3)
    tensions = random.uniform(0.0, 1.0, (6, len(robot.inputs)))
    last, shapes = None, model.sequence(tensions)
    for row, bend in zip(tensions, shapes.bend, strict=True):
        last = model.follow(last, row)
        assert np.allclose(last.bend, bend, rtol=0, atol=1e-9)
    # the same tensions from another side hold another shape, by up to the lag
    there = np.abs(model.shape(tensions[-1]).bend - shapes.bend[-1]).max()
    assert 0.1 * LAG < there < 2.0 * LAG
    pulled = pull_shapes(model, shapes.pulls, memory=model.arrays.fresh_memory())
    assert np.allclose(pulled.pulls, shapes.pulls, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ('by_pulls', 'friction'), [(False, {}), (True, {}), (False, REMEMBERED)], ids=PATHS
)
@pytest.mark.parametrize('robot', [two_sections(4), spatial(3)])
def test_derivatives_along_a_path_are_those_of_differences(robot, by_pulls, friction):
    """Friction that remembers follows the tensions between the postures, too."""
    effects = HELD | {'wire_spring': {'compliance': 1e-3}, 'tip_load': {'force_x': 0.01}, **WALL}
    effects |= friction
    model = Model(replace(robot, effects=effects))
    tensions = np.random.default_rng(5).uniform(0.1, 1.0, (8, len(robot.inputs)))
    base = model.sequence(tensions)
    commanded = base.pulls if by_pulls else tensions

    def solved():
        if by_pulls:
            fresh = model.arrays.fresh_memory()
            return pull_shapes(model, commanded, base.inputs, base.state, fresh)
        return model.sequence(commanded)

    path = path_near(model, base.inputs, base.state, by_pulls)
    assert np.allclose(path(commanded).positions, base.positions, rtol=0, atol=1e-9)
    moved = [('bending_hysteresis', 'lag', 1e-5), ('bending_hysteresis', 'presliding', 1e-3)]
    moved += [('contact', 'friction_coefficient', 1e-4), ('contact', 'distance', 1e-8)]
    moved += [('backbone_stiffness', 'relative_change', 1e-4), ('tip_load', 'force_y', 1e-6)]
    moved += [
        (name, key, 1e-3 * size) for name, own in friction.items() for key, size in own.items()
    ]
    for error, size in misses(model, moved, lambda: path(commanded), solved):
        assert error < 1e-3 * size + 1e-9


@pytest.mark.parametrize('robot', [two_sections(4), slow(COARSE)], ids=['planar', 'spatial'])
@pytest.mark.long
def test_it_is_named_where_the_arm_remembers_and_its_loops_are_drawn(robot):
    """A sequence of an arm as built: named alone, with its size."""
    true = {'lag': 0.24 / robot.cells, 'presliding': 1.5}
    plant = make_plant(robot, {'bending_hysteresis': true}, seed=2)
    tensions = default_postures(robot, 10)
    data = simulate(plant, np.concatenate([tensions, tensions[::-1]]), trials=1, path='sequence')
    found = diagnose(data)
    assert [effect.name for effect in found.effects] == ['bending_hysteresis']
    for key, value in found.effects[0].parameters.items():
        assert value.value == pytest.approx(true[key.partition('[')[0]], rel=0.15)
    named = robot.with_effect('bending_hysteresis', true)
    page = comparison_page(compare(data, [('plain', robot), ('named', named)]))
    figures = [f for f in page.parts if 'Tip over' in f]
    assert 'What the arm remembers' in ''.join(page.parts) and figures
    one_by_one = simulate(plant, tensions[:4], trials=2)
    page = comparison_page(compare(one_by_one, [('plain', robot)]))
    assert 'What the arm remembers' not in ''.join(page.parts)
