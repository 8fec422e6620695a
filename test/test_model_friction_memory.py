"""Friction that remembers: Dahl's law, unloading, and the same answer however it is cut."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from arms import GRAVITY, planar, spatial, two_sections
from reference import Reference

from tendon_robot_ros.common.errors import RobotDescriptionError
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.inverse import reach
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.tip_task import COLD, TRACK, TipTask
from tendon_robot_ros.robot import load_robot

R, MU, LENGTH = 0.0055, 0.4, 2e-4
EFFECTS = {
    'tendon_friction': {'friction_coefficient': MU},
    'friction_memory': {'presliding_length': LENGTH},
}
FULL = EFFECTS | {
    'eyelet_wrap': {'fraction': 1.0},
    'straight_tendon': {'fraction': 1.0},
    'tendon_travel': {'fraction': 1.0},
}


def test_two_cells_follow_dahls_law_in_closed_form():
    model = Model(planar(2, EFFECTS))
    shape = model.shape([0.0, 1.0])
    theta = shape.bend[0, 0]
    assert theta == pytest.approx(R / 0.027)
    s = 1.0 - np.exp(-R * theta / LENGTH)
    b = MU * np.sin(theta / 2)
    ratio = ((1 - b) / (1 + b)) ** s
    assert shape.tendon_tensions[1, 1] == pytest.approx(ratio, rel=1e-12)
    # and back by half: the travel reverses, s' = -1 + (1 + s) exp(-d / length)
    back = model.shape([0.0, 0.5], memory=shape.memory)
    half = back.bend[0, 0]
    s = -1.0 + (1.0 + s) * np.exp(-R * (theta - half) / LENGTH)
    b = MU * np.sin(half / 2)
    ratio = ((1 - b) / (1 + b)) ** s
    assert back.tendon_tensions[1, 1] == pytest.approx(0.5 * ratio, rel=1e-12)


LAW = load_catalogue()['friction_memory'].law
EXPONENTS = 0.0, 0.3, 0.999999, 1.0, 1.000001, 1.7, 2.0


@pytest.mark.parametrize('exponent', EXPONENTS)
def test_the_direction_of_friction_follows_its_law(exponent):
    """Parts of a way are the whole, left is right, full friction is never passed, slope [18]."""
    random = np.random.default_rng(8)
    for s, first, second in zip(*random.uniform(-1, 1, (3, 60)), strict=True):
        first, second = 3.0 * LENGTH * abs(first), 3.0 * LENGTH * abs(second)
        after = LAW(0.0, s, first, LENGTH, exponent)
        assert s <= after <= 1.0
        whole = LAW(0.0, s, first + second, LENGTH, exponent)
        assert LAW(0.0, after, second, LENGTH, exponent) == pytest.approx(whole, abs=1e-9)
        assert LAW(0.0, -s, -first, LENGTH, exponent) == pytest.approx(-after, abs=1e-15)
        step = 1e-6 * LENGTH
        slope = (LAW(0.0, s, step, LENGTH, exponent) - s) / step
        assert slope * LENGTH == pytest.approx((1.0 - s) ** exponent, rel=1e-4, abs=1e-6)
    assert LAW(0.0, 0.4, 0.0, LENGTH, exponent) == 0.4


def test_the_exponents_between_springs_and_hyperbolas_have_their_closed_forms():
    for s, way in zip(*np.random.default_rng(2).uniform(-1, 1, (2, 50)), strict=True):
        way = 2.5 * abs(way)
        springs = LAW(0.0, s, way * LENGTH, LENGTH, 0.0)
        assert springs == pytest.approx(np.clip(s + way, -1.0, 1.0))
        half = max(np.sqrt(1.0 - s) - 0.5 * way, 0.0) ** 2  # Torricelli: it ends
        assert 1.0 - LAW(0.0, s, way * LENGTH, LENGTH, 0.5) == pytest.approx(half, abs=1e-12)
        hyperbola = (1.0 - s) / (1.0 + (1.0 - s) * way)
        assert 1.0 - LAW(0.0, s, way * LENGTH, LENGTH, 2.0) == pytest.approx(hyperbola)


def test_a_description_without_the_exponent_is_dahls_and_one_without_a_length_refused():
    with pytest.raises(RobotDescriptionError, match='presliding_length'):
        Model(planar(2, {'friction_memory': {}}))
    rows = [[0.0, 1.0], [0.0, 0.5]]
    listed = EFFECTS['friction_memory'] | {'exponent': 1.0}
    one = Model(planar(4, EFFECTS)).sequence(rows)
    other = Model(planar(4, EFFECTS | {'friction_memory': listed})).sequence(rows)
    assert np.array_equal(one.bend, other.bend)


def test_a_shape_that_follows_another_is_that_of_the_sequence():
    model = Model(two_sections(4, FULL))
    tensions = [[0.0, 0.9, 0.0, 0.2], [0.0, 0.4, 0.0, 0.6], [0.3, 0.0, 0.0, 0.1]]
    last = None
    for row, shape in zip(tensions, model.sequence(tensions).bend, strict=True):
        last = model.follow(last, row)
        np.testing.assert_allclose(last.bend, shape, atol=1e-9)
    forgets = Model(two_sections(4, {'tendon_friction': EFFECTS['tendon_friction']}))
    after = forgets.follow(forgets.shape(tensions[0]), tensions[1])
    np.testing.assert_allclose(after.bend, forgets.shape(tensions[1]).bend, atol=1e-9)


@pytest.mark.parametrize('robot', [two_sections(4, FULL), spatial(3, FULL)])
def test_loading_in_one_go_satisfies_the_laws_with_dahls_signs(robot):
    inputs = np.array([0.0, 0.8, 0.0, 0.6, 0.0, 0.3][: len(robot.inputs)])
    shape, reference = Model(robot).shape(inputs), Reference(robot)
    travel = reference.travel(shape.state)
    beyond = np.cumsum(travel[::-1], axis=0)[::-1] - travel
    signs = np.sign(beyond) * (1.0 - np.exp(-np.abs(beyond) / LENGTH))
    steady = np.abs(reference.implied(inputs, shape.state, signs) - shape.state).max()
    assert steady < 2e-3  # exact only where no travel reverses on the way
    if len(robot.inputs) == 4:
        assert steady < 1e-6


def test_memory_fades_into_the_plain_model_as_the_arm_slides_far():
    plain = {name: FULL[name] for name in FULL if name != 'friction_memory'}
    short = FULL | {'friction_memory': {'presliding_length': 1e-6}}
    inputs = [0.0, 1.4]
    one = Model(planar(8, short)).shape(inputs)
    other = Model(planar(8, plain)).shape(inputs)
    assert np.allclose(one.positions, other.positions, rtol=0, atol=2e-6)


def test_on_the_way_back_the_arm_lags_behind():
    model = Model(planar(10, FULL))
    rows = [[0.0, t] for t in (0.5, 1.0, 1.5, 1.0, 0.5, 0.0)]
    tip = model.sequence(rows).tip_position[:, 0]
    assert tip[3] > tip[1] + 1e-3 and tip[4] > tip[0] + 1e-3
    assert tip[5] == pytest.approx(0.0, abs=1e-9)  # no tension, no friction


def test_a_closed_loop_comes_back_to_where_it_was():
    model = Model(planar(6, FULL))
    rows = np.array([[0.0, 0.6], [0.0, 1.2], [0.0, 0.6]] + [[0.0, 1.2], [0.0, 0.6]] * 8)
    tips = model.sequence(rows).tip_position
    assert np.linalg.norm(tips[-1] - tips[-3]) < 1e-6


@pytest.mark.parametrize('robot', [planar(8, FULL), two_sections(4, FULL), spatial(3, FULL)])
def test_a_sequence_does_not_depend_on_how_it_is_cut(robot):
    random = np.random.default_rng(4)
    corners = np.vstack(
        [np.zeros(len(robot.inputs)), random.uniform(0, 1, (3, len(robot.inputs)))]
    )
    model = Model(robot)
    coarse = model.sequence(corners[1:]).positions
    shares = np.linspace(0.0, 1.0, 21)[1:, None]
    fine = np.vstack([a + shares * (b - a) for a, b in itertools.pairwise(corners)])
    cut = model.sequence(fine).positions[19::20]
    assert np.abs(coarse - cut).max() < 2e-6


def test_calls_one_after_the_other_equal_a_sequence_and_leave_the_memory_they_are_given():
    more = {'hinge_friction': {'lever': 1e-4}, 'gravity': {'linear_density': 0.1}}
    model = Model(replace(spatial(3, FULL | more), gravity=GRAVITY))
    rows, memory = np.random.default_rng(6).uniform(0.0, 1.0, (6, 6)), None
    for row, positions in zip(rows, model.sequence(rows).positions, strict=True):
        given = None if memory is None else memory.copy()
        one, shape = (model.shape(row, memory=memory) for _ in range(2))
        assert np.array_equal(shape.positions, positions)
        assert np.array_equal(one.positions, positions)
        assert memory is None or np.array_equal(memory, given)
        memory = shape.memory


def test_without_memory_the_order_of_postures_does_not_matter():
    model = Model(planar(4, {name: FULL[name] for name in FULL if name != 'friction_memory'}))
    rows = [[0.0, 1.0], [0.9, 0.0], [0.3, 0.5]]
    assert np.allclose(model.sequence(rows).positions, model.shapes(rows).positions, atol=1e-12)


def test_hinge_friction_holds_the_bend_on_the_way_back():
    effects = EFFECTS | {'hinge_friction': {'lever': 5e-4}}
    model = Model(planar(5, {k: v for k, v in effects.items() if k != 'tendon_friction'}))
    bends = model.sequence([[0.0, 1.0], [0.0, 0.9], [0.0, 0.6]]).bend[:, :, 0]
    assert np.allclose(bends[0], (R - 5e-4) / 0.027)
    assert np.allclose(bends[1], bends[0])  # it sticks: 0.9 (R + lever) > 1.0 (R - lever)
    assert np.allclose(bends[2], 0.6 * (R + 5e-4) / 0.027)


def test_a_search_goes_to_the_end_of_a_narrow_valley_before_it_looks_elsewhere():
    robot = load_robot('kato_10_1').with_effect('friction_memory', {'presliding_length': 2e-4})
    robot = robot.with_effect('backbone_stiffness', {'relative_change': -0.03})
    model = Model(robot.with_effect('tendon_friction', {'friction_coefficient': 0.363}))
    here, place = model.follow(None, model.limits[:, 0]), np.array([0.0438, 0.0, 0.2029])

    def found_at(place, policy):
        return reach(replace(TipTask.at(model, place, memory=here.memory), guess=here), policy)

    near = found_at(place, TRACK)
    assert near.status == 'reached'
    found = found_at(place, COLD)
    assert found.tensions.max() < 1.1 * near.tensions.max()
    beyond = place + [5e-4, 0.0, 0.0]  # what takes 4 N against 4 N is left a little off
    found = found_at(beyond, COLD)
    assert found.position_error < 5e-4 and found.tensions.max() < 2.0


@pytest.mark.parametrize(
    ('name', 'seeds'),
    [('kato_10_1', (8, 9, 10, 17)), ('spatial_3', (6, 11, 21)), ('spatial_6', (1, 6))],
)
def test_a_way_at_once_is_that_way_in_many_steps(name, seeds):
    robot = load_robot(name).with_effect('friction_memory', {'presliding_length': LENGTH})
    model = Model(robot)
    low, high = model.limits.T
    for seed in seeds:  # eyelets turn on these
        random = np.random.default_rng(seed)
        begin, end = low + random.random((2, len(low))) * 0.25 * (high - low)
        start = model.shape(begin)
        last = start
        for share in np.linspace(0.0, 1.0, 65)[1:]:
            last = model.follow(last, begin + share * (end - begin))
        off = model.follow(start, end).tip_position - last.tip_position
        assert np.linalg.norm(off) < 3e-5, seed
