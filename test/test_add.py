"""Adding effects: values with intervals into a description, and the error that falls."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import simulated
import yaml
from arms import soft_cell
from marks import slow
from measurements import blind, truth
from simulated import CATALOGUE, NOISE, measured
from source_tree import ROOT

from tendon_robot_ros.common.errors import EffectError, InputError
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.add import add_effect, restore
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.inference import crossval
from tendon_robot_ros.inference.outliers import find_outliers
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.statistics import rms
from tendon_robot_ros.report.diagnosis_text import addition_warnings
from tendon_robot_ros.robot import dump_robot, load_robot, parse_robot

ROBOT = replace(simulated.robot(), exact=True)  # as those are that are simulated
HINGES = {'hinge_friction': {'lever': 2e-4}}
AS_BUILT = ROOT / 'test' / 'data' / 'as_built'
NOWHERE = 'outside the catalogue'
NAMED = {'none': NOWHERE, 'tether': NOWHERE, 'soft_cell': NOWHERE,
         'wrong_stiffness': 'backbone_stiffness'}  # fmt: skip


def added(letter, exact=False):
    """Add to a blind case what it hides; return the addition and what is hidden."""
    hidden = truth(letter)
    fit, check = (load_dataset(blind(letter) / part) for part in ('fit', 'check'))
    name = NAMED.get(hidden['hidden'], hidden['hidden'])
    robot = replace(fit.robot, exact=True) if exact else None
    return add_effect(fit, [name], robot, check=check), hidden['parameters'], name


# one of every kind of arm; b is added by the command (test_diagnose_command.py), and as many
# effects are added to other arms below
@pytest.mark.parametrize('letter', [*map(slow, 'bdfij'), *'cek'])
def test_adding_what_a_blind_case_hides_removes_its_error(letter):
    made, true, name = added(letter)
    for key, value in made.values[name].items():
        assert value.low <= true[key] <= value.high, key
    assert made.check.gone >= 0.9
    assert made.fitted.after < 1.3 * made.fitted.floor
    assert made.more_at_work == ''


def test_what_only_one_posture_shows_counts_as_described_where_that_is_left_out():
    lone = add_effect(measured(ROBOT, {'tip_load': {'force_x': 0.05}}, count=1), ['tip_load'])
    assert lone.fitted.after < 0.2 * lone.fitted.before
    assert lone.check.after == pytest.approx(lone.check.before)


@pytest.mark.blind
def test_memory_is_added_to_a_sequence():
    """The arm is exact; imperfections that it has not would take a part of so short a length."""
    made, true, name = added('h', exact=True)
    value = made.values[name]['presliding_length']
    assert value.low <= true['presliding_length'] <= value.high
    assert made.check.gone >= 0.9


@pytest.fixture(scope='module')
def hinged():
    """Return measurements of hinge friction and what was added."""
    dataset = measured(ROBOT, HINGES)
    return dataset, add_effect(dataset, ['hinge_friction'])


def test_the_staircase_is_what_the_descriptions_say(hinged):
    dataset, made = hinged
    for robot, error in ((ROBOT, made.fitted.before), (made.robot, made.fitted.after)):
        markers = Predictor(dataset, robot, CATALOGUE).markers({})
        assert error == pytest.approx(rms(dataset.mean - markers), rel=1e-9)
    assert made.check.kind == 'left out'
    assert made.fitted.after <= made.check.after < 1.2 * made.fitted.after
    assert made.check.before == made.fitted.before


@functools.cache
def diagnosed(name):
    """Return measurements of an arm as built, their diagnosis, and what is named as added."""
    dataset = load_dataset(AS_BUILT / name / 'fit')
    found = diagnose(dataset)
    return dataset, found, add_effect(dataset, [effect.name for effect in found.effects])


# of another arm that hides hinge friction (messy_002) test_diagnose_command.py says the same
@pytest.mark.parametrize('name', [slow('messy_002'), slow('messy_008'), 'messy_s0'])
@pytest.mark.long
def test_a_diagnosis_and_an_addition_tell_the_same_numbers_of_an_arm_as_built(name):
    dataset, found, made = diagnosed(name)
    hidden = yaml.safe_load((AS_BUILT / 'truth.yaml').read_text(encoding='utf-8'))[name]['hidden']
    assert (found.verdict, [e.name for e in found.effects]) == ('missing_effect', [hidden])
    numbers = (made.fitted.before, made.fitted.after, made.fitted.floor)
    said = (found.error_before, found.error_after, found.noise_floor)
    assert said == pytest.approx(numbers, rel=0.02)
    alone = made.fitted.after if made.fitted.alone is None else made.fitted.alone
    assert found.error_alone == pytest.approx(alone, rel=0.02)
    assert found.effects[0].explained == pytest.approx(min(made.fitted.gone, 1.0), abs=0.01)
    best = next(row for row in found.candidates if row.status == 'best')
    assert best.held_out == pytest.approx(made.check.after, rel=0.02)
    assert (best.error, best.explained) == (found.error_after, found.effects[0].explained)
    for robot, error in ((dataset.robot, said[0]), (made.robot, said[1])):
        markers = Predictor(dataset, robot, CATALOGUE).markers({})
        left = rms(without_outliers(dataset).mean - markers)
        assert error == pytest.approx(left, rel=0.02), 'each is that of a description'


@pytest.mark.parametrize('name', [slow('messy_002'), 'messy_s0'])
@pytest.mark.long
def test_all_that_the_file_says_otherwise_is_named(name):
    dataset, _, made = diagnosed(name)
    assert made.beside
    (line,) = [one for one in addition_warnings(made) if one.startswith('after: ')]
    before, after = dataset.robot, made.robot
    for key in set(before.effects) | set(after.effects):
        changed = before.effects.get(key) != after.effects.get(key)
        assert (key in line) == (changed and key not in made.values), key
    stiff = [[k for s in r.sections for k in s.bending_stiffness] for r in (before, after)]
    changes = 100.0 * (np.array(stiff[1]) / np.array(stiff[0]) - 1.0)
    changes = changes[changes != 0.0]
    told = f'stiffness of {len(changes)} cells ({changes.min():+.2g} to {changes.max():+.2g} %)'
    assert told in line
    moved = sum(a.base != b.base for a, b in zip(before.tendons, after.tendons, strict=True))
    assert f'offset of {moved} tendons' in line
    same = replace(after, sections=before.sections, tendons=before.tendons, effects=before.effects)
    rest = replace(same, fitted=before.fitted, gravity=before.gravity, source=before.source)
    assert rest == before, 'nothing else is written'


@pytest.mark.long
def test_an_arm_as_found_that_has_no_equilibrium_on_a_posture_left_out_is_not_written(monkeypatch):
    dataset, _, made = diagnosed('messy_s0')
    assert made.beside and made.check.after < made.check.before
    squares_of = crossval.left_out_squares

    def without_one(fitter, fit, beside=True, folds=()):
        squares = squares_of(fitter, fit, beside, folds)
        squares[0] = np.nan if beside else squares[0]
        return squares

    monkeypatch.setattr(crossval, 'left_out_squares', without_one)
    assert not add_effect(dataset, list(made.values)).beside


def without_outliers(dataset):
    return find_outliers(Predictor(dataset, dataset.robot, CATALOGUE), {}).without(dataset)


def test_the_file_says_where_its_values_come_from(hinged):
    _, made = hinged
    robot = parse_robot(dump_robot(made.robot))
    origin = robot.fitted['hinge_friction']
    lever = origin['parameters']['lever']
    assert robot.effects['hinge_friction']['lever'] == pytest.approx(lever['value'], rel=1e-3)
    assert lever['low'] < lever['value'] < lever['high']
    assert lever['value'] == pytest.approx(2e-4, rel=0.2)
    assert lever['unit'] == 'm'
    assert origin['data'] == 'simulated'
    assert len(origin['date']) == 10
    assert origin['error']['unit'] == 'm'
    for kind in ('fitted', 'left_out'):
        errors = origin['error'][kind]
        assert errors['before'] > errors['after'] > 0.5 * errors['floor']
    assert yaml.safe_load(yaml.safe_dump(made.to_json()))['check']['kind'] == 'left out'


def test_removing_undoes_adding_and_leaves_the_arm_as_it_is_built(hinged):
    dataset, made = hinged
    robot, back = restore(made.robot, 'hinge_friction')
    assert back is None
    assert 'hinge_friction' not in robot.effects | robot.fitted
    assert robot.sections == made.robot.sections
    exact = replace(ROBOT, exact=True)
    added = add_effect(dataset, ['hinge_friction'], exact).robot
    assert dump_robot(restore(added, 'hinge_friction')[0]) == dump_robot(exact)
    with pytest.raises(InputError, match=r"effects: no 'tip_load' to remove; listed: tendon_fric"):
        restore(made.robot, 'tip_load')


def test_an_effect_that_is_there_gets_new_values_and_its_old_ones_back():
    before = {'lever': 1e-4}
    robot = replace(ROBOT, effects={**ROBOT.effects, 'hinge_friction': before})
    made = add_effect(measured(robot, {'hinge_friction': {'lever': 3e-4}}), ['hinge_friction'])
    assert made.robot.effects['hinge_friction']['lever'] == pytest.approx(3e-4, rel=0.1)
    assert made.robot.fitted['hinge_friction']['replaces'] == before
    robot, back = restore(made.robot, 'hinge_friction')
    assert back == before == robot.effects['hinge_friction']
    robot, back = restore(robot, 'hinge_friction')
    assert back is None
    assert 'hinge_friction' not in robot.effects


def test_two_effects_are_added_together():
    hidden = HINGES | {'pre_curvature': {'angle_x': 0.01, 'angle_y': 0.0}}
    made = add_effect(measured(ROBOT, hidden), ['hinge_friction', 'pre_curvature'])
    assert list(made.values) == ['hinge_friction', 'pre_curvature']
    assert made.check.gone > 0.95
    assert made.robot.fitted['hinge_friction']['together_with'] == ['pre_curvature']


def test_a_value_per_section_goes_into_the_file_as_such():
    robot = simulated.robot('kato_10_1')
    hidden = {'section_stiffness': {'relative_change': (0.2, -0.1)}}
    made = add_effect(measured(robot, hidden), ['section_stiffness'])
    changes = made.robot.effects['section_stiffness']['relative_change']
    assert changes == pytest.approx((0.2, -0.1), abs=0.03)
    assert list(made.values['section_stiffness']) == [
        'relative_change[proximal]', 'relative_change[distal]']  # fmt: skip
    assert parse_robot(dump_robot(made.robot)).effects == made.robot.effects


def test_tolerances_are_reported_and_widen_the_interval():
    robot = replace(ROBOT, tolerances={'bending_stiffness': 0.05})
    made = add_effect(measured(robot, HINGES), ['hinge_friction'])
    assert set(made.moved) == {'bending_stiffness'}
    assert abs(made.moved['bending_stiffness']) < 2.0
    assert made.robot.fitted['hinge_friction']['tolerances_moved'].keys() == made.moved.keys()
    value = made.values['hinge_friction']['lever']
    exact = add_effect(measured(ROBOT, HINGES), ['hinge_friction']).values['hinge_friction']
    assert value.high - value.low > exact['lever'].high - exact['lever'].low


def test_tolerances_that_moved_are_written_where_the_prediction_needs_them(tmp_path):
    """The errors that are printed are those of the file, read again."""
    robot = replace(ROBOT, tolerances={'bending_stiffness': 0.05})
    hidden = HINGES | {'backbone_stiffness': {'relative_change': 0.08}}
    dataset, check = (measured(robot, hidden, seed=seed, which=seed) for seed in (0, 1))
    made = add_effect(dataset, ['hinge_friction'], check=check)
    (tmp_path / 'new.yaml').write_text(dump_robot(made.robot), encoding='utf-8')
    again = load_robot(tmp_path / 'new.yaml')
    assert list(made.values) == ['hinge_friction']
    moved = again.effects['backbone_stiffness']['relative_change']
    assert moved == pytest.approx(0.08, abs=0.015)
    for data, errors in ((dataset, made.fitted), (check, made.check)):
        assert compare(data, [('new', again)]).models[-1].rms == pytest.approx(errors.after)
        assert errors.after < 1.2 * errors.floor
    left_out = add_effect(dataset, ['hinge_friction']).check
    assert left_out.after == pytest.approx(made.check.after, rel=0.2)


def test_gravity_goes_into_a_file_that_did_not_know_where_down_is():
    robot = simulated.robot(gravity=None)
    dataset = measured(simulated.robot(gravity=(9.81, 0.0, 0.0)), {'gravity': {
        'linear_density': 0.05}})  # fmt: skip
    made = add_effect(replace(dataset, robot=robot), ['gravity'])
    assert made.robot.gravity == (9.81, 0.0, 0.0)
    assert made.check.gone > 0.95


def test_what_remains_widens_the_intervals_and_is_said():
    robot = replace(ROBOT, exact=True)  # else the soft cell is found, and nothing remains
    dataset = replace(measured(soft_cell(ROBOT, 10, 0.6)), robot=robot)
    made = add_effect(dataset, ['backbone_stiffness'])
    assert made.probability < 1e-6
    assert made.more_at_work.startswith('more is at work than these effects: what is left')
    assert made.robot.fitted['backbone_stiffness']['more_at_work'] == made.more_at_work
    value = made.values['backbone_stiffness']['relative_change']
    clean = add_effect(
        measured(robot, {'backbone_stiffness': {'relative_change': -0.02}}), ['backbone_stiffness']
    )
    exact = clean.values['backbone_stiffness']['relative_change']
    assert value.high - value.low > 1.3 * (exact.high - exact.low)


@pytest.mark.parametrize(('name', 'reason'), [
    ('gravity', 'set to zero'),
    ('tendon_elongation', 'wire pulls not commanded'),
    ('friction_memory', 'every posture loaded from straight'),
    ('tendon_travel', 'these postures hardly show it'),
])  # fmt: skip
def test_what_the_postures_do_not_show_is_refused(name, reason):
    robot = simulated.robot(lacks=('tendon_travel',))
    with pytest.raises(InputError) as error:
        add_effect(measured(robot, count=4), [name])
    assert str(error.value) == (
        f'{name}: these measurements cannot tell its value ({reason}); nothing was written'
    )


def test_an_unknown_effect_is_refused_with_the_known_ones():
    with pytest.raises(EffectError, match="unknown effect 'hinge_fiction'; known: tendon_fric"):
        add_effect(measured(ROBOT, count=2), ['hinge_fiction'])


def test_without_any_noise_to_weigh_by_nothing_is_added():
    dataset = replace(measured(ROBOT, trials=1), position_noise=None)
    with pytest.raises(InputError, match='one trial per posture and no position_noise'):
        add_effect(dataset, ['hinge_friction'])


def test_stretching_tendons_are_added_to_wire_pulls():
    robot = simulated.robot('spatial_3')
    hidden = {'tendon_elongation': {'compliance': 2e-3}}
    steady = {'input': 'displacement', 'noise': replace(NOISE, setting=0.0, trial=0.0)}
    fit, check = (measured(robot, hidden, count=n, which=w, seed=w, **steady)
                  for n, w in ((8, 0), (6, 1)))  # fmt: skip
    made = add_effect(fit, ['tendon_elongation'], check=check)
    assert made.values['tendon_elongation']['compliance'].value == pytest.approx(2e-3, rel=0.15)
    assert made.check.gone > 0.9


def test_a_declared_accuracy_weighs_where_the_effects_are_not_the_whole_story():
    """What is left is no noise: neither the error on postures left out nor the file gets worse."""
    hidden = HINGES | {'pre_curvature': {'angle_x': 0.0, 'angle_y': 0.02}}
    dataset = measured(ROBOT, hidden)
    alone = add_effect(dataset, ['hinge_friction'])
    weighed = add_effect(replace(dataset, accuracy=2e-3), ['hinge_friction'])
    assert alone.more_at_work and weighed.more_at_work and alone.accuracy is None
    assert weighed.check.after <= alone.check.after
    if weighed.accuracy is not None:
        assert weighed.robot.fitted['hinge_friction']['weighed_by_accuracy'] == 2e-3
    right = add_effect(replace(measured(ROBOT, HINGES), accuracy=2e-3), ['hinge_friction'])
    assert right.accuracy is None and right.probability == pytest.approx(
        add_effect(measured(ROBOT, HINGES), ['hinge_friction']).probability
    )
