"""Mistakes of the set-up are named as what they are, and arms without one are left alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated
from marks import slow
from simulated import CATALOGUE, measured

from tendon_robot_ros.common.rotations import about, rigid_fit
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.marker_hypotheses import in_one_place, miscounted
from tendon_robot_ros.diagnosis.result import EffectFinding
from tendon_robot_ros.diagnosis.setup_hypotheses import dead_inputs, gravities
from tendon_robot_ros.diagnosis.setup_mistakes import (
    Explaining,
    find_mistake,
    implausible,
    mended_rivals,
)
from tendon_robot_ros.diagnosis.stepwise import Stepwise
from tendon_robot_ros.inference.description import with_cells
from tendon_robot_ros.inference.intervals import Value
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.inference.statistics import rms
from tendon_robot_ros.report.diagnosis_text import lines
from tendon_robot_ros.robot import parse_robot

ROBOT = simulated.robot()
FLOOR = 2e-4


@pytest.fixture(scope='module')
def right():
    return measured(ROBOT, count=8)


def turned(dataset, angle):
    return dataset.positions @ about(2, angle).T


MISTAKES = {
    'inputs_swapped': lambda d: {'inputs': d.inputs[:, ::-1]},
    'axes': lambda d: {'positions': d.positions[..., [1, 0, 2]]},
    'registration': lambda d: {'positions': turned(d, 0.7) + [0.02, 0.0, 0.01]},
    'markers_from_the_tip': lambda d: {'positions': d.positions[:, :, ::-1]},
    'unit_of_inputs': lambda d: {'inputs': d.inputs / 9.81},
    'unit_of_positions': lambda d: {'positions': d.positions * 1000.0},
}


@pytest.mark.parametrize('name', MISTAKES)
def test_a_mistake_is_named_with_the_error_before_and_after(right, name):
    wrong = replace(right, **MISTAKES[name](right))
    found = find_mistake(Predictor(wrong, ROBOT, CATALOGUE), FLOOR)
    assert found is not None
    same = {'inputs_swapped': ('inputs_swapped', 'axes')}  # a mirrored planar arm is both
    assert found.name in same.get(name, (name,))
    assert found.after < 1e-3


def test_markers_a_cell_further_than_said_are_named_and_the_tip_marker_is_among_them(right):
    cell = ROBOT.sections[0].cell_length
    markers = tuple(replace(m, arc_length=max(m.arc_length - cell, 0.0)) for m in right.markers)
    wrong = replace(right, markers=markers)
    found = find_mistake(Predictor(wrong, ROBOT, CATALOGUE), FLOOR)
    assert found is not None and found.name == 'markers_elsewhere'
    assert '1 cell nearer to the tip' in found.sentence


def test_markers_on_both_sides_of_the_arm_are_as_far_apart_as_described(right):
    staggered = tuple(
        replace(m, offset=(0.0, 0.02 * (-1.0) ** i, 0.0)) for i, m in enumerate(right.markers)
    )
    hidden = {'backbone_stiffness': {'relative_change': 0.3}}
    wide = simulated.measure(replace(right, markers=staggered), hidden)
    assert find_mistake(Predictor(wide, ROBOT, CATALOGUE), FLOOR) is None


def test_neighbours_that_were_never_seen_together_tell_no_unit():
    right = measured(simulated.robot(cells=4), {'backbone_stiffness': {'relative_change': 0.3}})
    positions = right.positions.copy()
    positions[::2, :, 2] = positions[1::2, :, 1] = np.nan
    hidden = replace(right, positions=positions)
    assert find_mistake(Predictor(hidden, right.robot, CATALOGUE), FLOOR) is None


def test_a_mistake_without_which_nothing_settles_says_the_best_factor(right):
    found = diagnose(replace(right, robot=with_cells(ROBOT, 0.1)))
    assert found.details['mistake']['name'] == 'unit_of_inputs'
    assert 'divided by 10' in found.remainder


def test_a_frozen_marker_is_named(right):
    positions = right.positions.copy()
    positions[:, :, 9] = positions[0, 0, 9]
    found = find_mistake(Predictor(replace(right, positions=positions), ROBOT, CATALOGUE), FLOOR)
    assert found is not None
    assert 'marker 10 stands still' in found.sentence


def test_a_marker_that_was_seen_once_is_not_frozen(right):
    positions = right.positions.copy()
    positions[1:, :, 9] = np.nan
    positions[0, :, 9] += 0.05
    once = replace(right, positions=positions)
    assert find_mistake(Predictor(once, ROBOT, CATALOGUE), FLOOR) is None


def test_a_diagnosis_says_the_mistake_and_nothing_else(right):
    wrong = replace(right, positions=right.positions[:, :, ::-1])
    found = diagnose(wrong)
    assert found.verdict == 'cannot_judge'
    assert found.effects == ()
    assert any('numbered from the tip' in line for line in lines(found))


PHYSICS = {
    'hinge_friction': {'lever': 3e-4},
    'tip_load': {'force_x': 3e-3},
    'nonlinear_stiffness': {'cubic': 3.0},
    'base_misalignment': {'rotation_y': 0.08},
}


@pytest.mark.parametrize('hidden', PHYSICS)
def test_physics_is_no_mistake(hidden):
    dataset = measured(ROBOT, {hidden: PHYSICS[hidden]}, count=8)
    assert find_mistake(Predictor(dataset, ROBOT, CATALOGUE), FLOOR) is None


LIMP = """
name: limp
sections: [{name: arm, cells: 11, cell_length: 0.02, bending_stiffness: 1.9, bends_as: arc}]
tendons:
- {name: tendon_1, section: arm, offset: [0.01, 0.0]}
- {name: tendon_2, section: arm, offset: [-0.005, 0.0086603]}
- {name: tendon_3, section: arm, offset: [-0.005, -0.0086603]}
tension_limits: [0.4, 10.0]
gravity: [9.81, 0.0, 0.0]
effects: {gravity: {linear_density: 0.1364}}
"""


@pytest.fixture(scope='module')
def limp():
    return parse_robot(LIMP)


def cut(robot, count):
    """Return a robot of the first cells only."""
    (section,) = robot.sections
    stiffness, mass = (getattr(section, k)[:count] for k in ('bending_stiffness', 'mass_profile'))
    shorter = replace(section, cells=count, bending_stiffness=stiffness, mass_profile=mass)
    return replace(robot, sections=(shorter,))


@pytest.mark.long
def test_a_tip_load_that_a_miscount_could_nearly_do_is_named(limp):
    dataset = measured(limp, {'tip_load': {'force_x': 0.1}}, count=8)
    looked = find_mistake(Predictor(dataset, limp, CATALOGUE), FLOOR, 1e-3)
    assert looked is not None and looked.name == 'cells'  # and leaves no more than usual
    found = diagnose(dataset)
    assert [effect.name for effect in found.effects] == ['tip_load']
    force = found.effects[0].parameters['force_x']
    assert force.low < 0.1 < force.high
    assert not any('gravity' in caveat for caveat in found.details['caveats'])
    Stepwise(dataset, limp, CATALOGUE)  # improve does not refuse it either


@pytest.mark.long
def test_a_miscount_that_no_effect_explains_is_said(limp):
    right = measured(limp, count=6)
    along = tuple(replace(m, arc_length=m.arc_length * 10 / 11) for m in right.markers)
    found = diagnose(replace(right, robot=cut(limp, 10), markers=along))
    assert found.verdict == 'cannot_judge'
    assert 'with 11 cells instead of 10 in the arm' in found.details['mistake']['sentence']


def registered(dataset):
    """Return the data set as an import lays it onto the model as described, upright."""
    robot = replace(dataset.robot, tolerances={'position': 2e-3, 'rotation': 0.035})
    markers = Predictor(dataset, robot, CATALOGUE).markers({})
    down = np.array(robot.gravity) / np.linalg.norm(robot.gravity)
    turn, shift = rigid_fit(dataset.mean.reshape(-1, 3), markers.reshape(-1, 3), axis=down)
    return replace(dataset, robot=robot, positions=dataset.positions @ turn.T + shift)


def a_cell_too_few(dataset):
    """Return the data set as it is of an arm of a cell less, its last marker at the tip."""
    cell = dataset.robot.sections[0].cell_length
    markers = tuple(replace(m, arc_length=m.arc_length - cell) for m in dataset.markers)
    return replace(dataset, robot=cut(dataset.robot, dataset.robot.cells - 1), markers=markers)


BESIDE = {
    'spatial, a cell too few': (a_cell_too_few, 'cells', 'with 11 cells instead of 10 in the arm'),
    'spatial, the modulus ten times too large': (
        lambda d: replace(d, robot=with_cells(d.robot, 10.0)), 'stiffness',
        'with the bending stiffness divided by 10'),
    'spatial, mN for N': (
        lambda d: replace(d, inputs=1e-3 * d.inputs), 'unit_of_inputs',
        'with all inputs multiplied by 1000'),
    'planar, tensions ten times too large': (
        lambda d: replace(d, inputs=10.0 * d.inputs), 'unit_of_inputs',
        'with all inputs divided by 10'),
}  # fmt: skip


FEW = ('spatial, a cell too few',)  # fewer postures: each of its fits takes long


@pytest.mark.parametrize('name', [slow(one) if one in FEW else one for one in BESIDE])
def test_a_mistake_beside_a_missing_effect_is_said_with_the_effect(name, limp):
    make, mistake, sentence = BESIDE[name]
    count = 5 if name in FEW else 8
    if name.startswith('planar'):
        wrong = make(measured(ROBOT, {'hinge_friction': {'lever': 3e-4}}, count=count))
    else:
        right = measured(limp, {'tendon_friction': {'friction_coefficient': 0.12}}, count=count)
        wrong = registered(make(right))
    found = diagnose(wrong)
    assert found.details['mistake']['name'] == mistake
    assert sentence in found.remainder
    assert found.effects == ()


def midway(dataset):
    """Return the data set with markers 4 and 5 taken for each other from the fourth posture on."""
    positions = dataset.positions.copy()
    positions[3:, :, [3, 4]] = positions[3:, :, [4, 3]]
    return replace(dataset, positions=positions)


def dead(dataset):
    inputs = dataset.inputs.copy()
    inputs[:, 1] = 0.5
    return replace(dataset, inputs=inputs)


BESIDE_A_LOAD = {
    'exchanged half way': (midway, 'markers_exchanged', 'with markers 4 and 5 exchanged in '),
    'dead load cell': (dead, 'input_dead', 'input tendon_2 reads 0.5 N in every posture'),
}  # fmt: skip


@pytest.mark.parametrize('frame', ['known', slow('found')])
@pytest.mark.parametrize('name', ['exchanged half way', slow('dead load cell')])
def test_a_mistake_beside_a_load_is_said_with_what_and_where(name, frame, limp):
    make, mistake, sentence = BESIDE_A_LOAD[name]
    wrong = make(measured(limp, {'tip_load': {'force_x': 0.1}}, count=6))
    found = diagnose(registered(wrong) if frame == 'found' else wrong)
    assert found.details['mistake']['name'] == mistake
    assert sentence in found.remainder
    assert found.effects == ()


def test_a_dead_load_cell_is_given_what_it_read_beside_a_load(limp):
    right = measured(limp, {'tip_load': {'force_x': 0.3}}, count=6)
    wrong = dead(right)
    predictor = Predictor(wrong, limp, CATALOGUE)
    (alone,) = dead_inputs(predictor, predictor.markers({}))
    beside = Explaining(CATALOGUE, 1e-3).with_effect(predictor, alone)
    off = [float(np.abs(one.mended.inputs - right.inputs).max()) for one in (alone, beside)]
    assert off[1] < 0.2 * off[0]


def test_an_explanation_is_as_good_from_more_trials_as_from_one():
    dataset = measured(simulated.robot(cells=4), {'tip_load': {'force_x': 2e-3}}, count=4)
    once = replace(dataset, positions=dataset.mean[:, None], trial_inputs=None, trial_names=())
    thrice = replace(once, positions=np.repeat(once.positions, 3, axis=1))
    scores = [Explaining(CATALOGUE, 1e-3).explain(one, 0, 0.0).score for one in (once, thrice)]
    assert scores[1] == pytest.approx(scores[0])


LOADED = """
name: loaded
sections: [{name: arm, cells: 20, cell_length: 0.005, bending_stiffness: 0.03, bends_as: hinge}]
tendons:
- {name: a, section: arm, offset: [0.0, 0.006]}
- {name: b, section: arm, offset: [-0.0052, -0.003]}
- {name: c, section: arm, offset: [0.0052, -0.003]}
tension_limits: [0.1, 2.0]
gravity: [0.0, 0.0, 9.81]
effects: {gravity: {linear_density: 0.06}}
"""


@pytest.mark.long
def test_a_marker_elsewhere_is_tried_though_all_nearer_to_the_base_leave_less():
    arm = parse_robot(LOADED)
    right = measured(arm, {'tip_load': {'force_z': 0.09}}, count=8)
    own = [3, 7, 11, 15, 19]
    markers = [right.markers[j] for j in own]
    markers[-1] = replace(markers[-1], arc_length=0.095)
    wrong = replace(right, markers=tuple(markers), positions=right.positions[:, :, own])
    session = Question.of(wrong, arm, CATALOGUE).weigh()
    _, found = mended_rivals(session, 2e-3)
    assert 'with marker 20 at 100 mm along the arm instead of 95.0 mm' in found[0].mistake.sentence
    assert found[0].explained.names == ('tip_load',)


@pytest.mark.parametrize('when', ['before', 'after'])
def test_gravity_may_be_wrong_before_the_frame_was_found_or_be_written_so_after(when, limp):
    """The import lays the frame by the gravity that it is given; a later one turns nothing."""
    right = measured(limp, {'tip_load': {'force_x': 0.1}}, count=6)
    x, y, z = limp.gravity
    upside_down = {'robot': replace(limp, gravity=(-x, -y, -z)), 'gravity': (-x, -y, -z)}
    found = registered(right)
    tolerant = replace(upside_down['robot'], tolerances=found.robot.tolerances)
    if when == 'before':
        wrong = registered(replace(right, **upside_down))
    else:
        wrong = replace(found, robot=tolerant, gravity=(-x, -y, -z))
    predictor = Predictor(wrong, wrong.robot, CATALOGUE)
    likely = [
        one.after
        for one in gravities(predictor, predictor.markers({}))
        if one.mended.gravity == pytest.approx(limp.gravity)
    ]
    left = rms(found.mean - Predictor(found, found.robot, CATALOGUE).markers({}))
    assert min(likely) == pytest.approx(left, rel=0.02)


@pytest.mark.long
def test_half_as_many_cells_on_the_same_length_are_told_beside_a_load():
    """The right number alone leaves more than others: a load makes up for the wrong one."""
    rubs = LOADED.replace('effects: {', 'effects: {tendon_friction: {friction_coefficient: 0.2}, ')
    half = parse_robot(
        rubs.replace('cells: 20, cell_length: 0.005', 'cells: 10, cell_length: 0.01')
    )
    right = measured(parse_robot(rubs), {'tip_load': {'force_x': 0.06}}, count=8)
    own = [3, 7, 11, 15, 19]
    wrong = replace(
        right,
        robot=half,
        markers=tuple(right.markers[j] for j in own),
        positions=right.positions[:, :, own],
    )
    session = Question.of(wrong, half, CATALOGUE).weigh()
    _, found = mended_rivals(session, 2e-3)
    said = 'with 20 cells of 5 mm instead of 10 in the arm (markers stay)'
    assert said in found[0].mistake.sentence  # twice the tensions do nearly the same
    (one,) = (one for one in found if one.mistake.sentence.startswith(said))
    assert one.explained.names == ('tip_load',)
    assert one.explained.residual < session.whitener.floor()


@pytest.mark.long
def test_a_light_arm_may_hang_upside_down_where_a_load_makes_up_for_it():
    light = parse_robot(LIMP.replace('0.1364', '0.03'))
    right = measured(light, {'tip_load': {'force_x': 0.2}}, count=6)
    up = (-9.81, 0.0, 0.0)
    found = diagnose(replace(right, robot=replace(light, gravity=up), gravity=up))
    assert [effect.name for effect in found.effects] == ['tip_load']
    (said,) = (caveat for caveat in found.details['caveats'] if 'with gravity' in caveat)
    assert said.startswith('with gravity [9.81, 0, 0], or ')
    assert 'and tip_load the error would fall to ' in said
    assert said.endswith('values of tip_load depend on it')


def test_a_stiffness_that_no_rod_is_off_by_is_said(limp):
    value = Value(1.4, 1.3, 1.5, '1')
    found = SimpleNamespace(effects=[EffectFinding('backbone_stiffness',
                                                   {'relative_change': value}, 1.0)],
                            details={})  # fmt: skip
    assert implausible(found)[0].startswith('backbone_stiffness of +140 % is no tolerance: check')
    usual = EffectFinding(
        'backbone_stiffness', {'relative_change': replace(value, value=0.3)}, 1.0
    )
    assert implausible(SimpleNamespace(effects=[usual], details={})) == []
    found.details = {'described': {'backbone_stiffness': {'relative_change': 1.2}}}
    assert implausible(found) == []  # of what is described


@pytest.mark.parametrize('hidden', [{}, {'tip_load': {'force_x': 2e-3}}])
@pytest.mark.parametrize(('end', 'how'), [('tip', 'stay'), ('base', 'as far from the tip')])
def test_markers_cut_at_an_end_of_an_arm_with_cells_too_few_are_said(end, how, hidden):
    """Markers in one place cannot be apart: the arm goes on, whatever effect is missing."""
    robot = simulated.robot('spatial_3')
    right = measured(robot, hidden, count=6)
    described = cut(robot, 18)
    shift = 0.0 if end == 'tip' else described.length - robot.length
    places = np.clip(right.arc_lengths + shift, 0.0, described.length).tolist()
    markers = tuple(replace(m, arc_length=s) for m, s in zip(right.markers, places, strict=True))
    found = diagnose(replace(right, robot=described, markers=markers))
    assert found.verdict == 'cannot_judge'
    sentence = found.details['mistake']['sentence']
    assert 'are described in one place and are ' in sentence
    assert f'; with 20 cells instead of 18 in the arm (markers {how})' in sentence


def test_cells_are_counted_where_routes_and_weight_are_described_cell_by_cell():
    text = LOADED.replace('effects:', 'exact: true\neffects:')
    text = text.replace('[0.0, 0.006]', '{cells: %s}')
    text = text.replace('bends_as: hinge', 'bends_as: hinge, mass_offset: %s')

    def arm(cells):
        each = (cells * [[0.001, 0.0]], cells * [[0.0, 0.006]])
        return parse_robot((text % each).replace('cells: 20', f'cells: {cells}'))

    right = measured(arm(20), count=4)
    kept = replace(right, markers=right.markers[:18], positions=right.positions[:, :, :18])
    predictor = Predictor(replace(kept, robot=arm(18)), arm(18), CATALOGUE)
    found = list(miscounted(predictor, predictor.markers({})))
    best = min(found, key=lambda one: one.after)
    assert best.sentence == 'with 20 cells instead of 18 in the arm (markers stay)'


def test_markers_that_sit_in_one_place_are_no_mistake():
    dataset = measured(simulated.robot('spatial_3'), count=6)
    twice = replace(dataset, markers=(*dataset.markers, replace(dataset.markers[-1], name='two')),
                    positions=dataset.positions[:, :, [*range(20), 19]])  # fmt: skip
    assert in_one_place(twice, twice.robot, FLOOR) == ([], 0.0)
