"""
A diagnosis names what the robot hides, and nothing else.

Of the blind cases b, f, k and l: test_diagnose_command.py, where the same diagnoses are printed.
"""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from arms import planar, soft_cell
from marks import slow
from measurements import blind
from simulated import CATALOGUE, NOISE, measure, measured, postures

from tendon_robot_ros.common.errors import NoEquilibriumError, TendonRobotError
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.add import add_effect
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.select import gather
from tendon_robot_ros.diagnosis.verdict import differs
from tendon_robot_ros.inference import session as sessions
from tendon_robot_ros.report.diagnosis_text import lines

ROBOT = simulated.robot(cells=8)
EXACT = replace(ROBOT, exact=True)  # where imperfections are not the point: much sooner
NAMING = ('missing_effect', 'ambiguous', 'wrong_parameter', 'several')


def names(found):
    return [effect.name for effect in found.effects]


def test_a_robot_that_hides_nothing_is_adequate():
    found = diagnose(load_dataset(blind('a') / 'fit'))
    assert found.verdict == 'adequate'
    assert not found.effects
    assert found.error_before == found.error_after < 1.3 * found.noise_floor
    assert 1e-6 < found.details['detectable']['hinge_friction']['size'] < 1e-4


@pytest.mark.slow  # `make test-blind` says the same of this case
def test_a_cable_that_holds_the_arm_at_a_disk_is_a_string_or_a_force_at_a_place():
    found = diagnose(load_dataset(blind('g') / 'fit'))
    assert found.verdict == 'ambiguous'
    assert set(found.cannot_tell_apart) == {'point_load', 'tether'}
    assert found.error_after < 0.2 * found.error_before


@pytest.mark.long
def test_a_value_that_is_off_is_no_missing_effect():
    robot = replace(ROBOT, effects={**ROBOT.effects, 'hinge_friction': {'lever': 1e-4}})
    found = diagnose(measured(robot, {'hinge_friction': {'lever': 3e-4}}, count=12))
    assert (found.verdict, names(found)) == ('wrong_parameter', ['hinge_friction'])
    assert found.effects[0].present
    assert found.details['described'] == {'hinge_friction': {'lever': 1e-4}}


@pytest.mark.long
def test_two_effects_at_once_are_both_found():
    truths = {'hinge_friction': {'lever': 2e-4}, 'pre_curvature': {'angle_x': 0.01}}
    found = diagnose(measured(ROBOT, truths, count=12))
    assert found.verdict == 'several'
    assert set(names(found)) == set(truths) and not found.cannot_tell_apart
    assert 'cannot be told apart from: nothing' in found.text()


@pytest.mark.parametrize('robot', ['kato_10_1_single', 'spatial_3'])
@pytest.mark.long
def test_beside_a_load_a_stiffer_arm_is_one_that_is_pulled_less(robot):
    """Shapes by tensions tell the ratio of moment and stiffness only, whatever else acts."""
    hidden = {'tip_load': {'force_x': 0.006}, 'backbone_stiffness': {'relative_change': 0.12}}
    found = diagnose(measured(simulated.robot(robot), hidden, count=12))
    assert found.verdict == 'several' and 'tip_load' in names(found)
    assert {'backbone_stiffness', 'transmission_loss'} <= set(found.cannot_tell_apart)
    (other,) = set(names(found)) - {'tip_load'}
    assert f'{other} cannot be told apart from: ' in found.text()
    rows = {row.name: row for row in found.candidates}
    load = next(effect for effect in found.effects if effect.name == 'tip_load')
    told = load.parameters['force_x']
    assert told.low <= hidden['tip_load']['force_x'] <= told.high
    for name in set(found.cannot_tell_apart) - {other}:
        alternative = rows[f'tip_load + {name}']
        assert alternative.status == 'cannot be told apart'
        force, size = alternative.parameters['tip_load.force_x'], alternative.load.size
        assert told.low <= force.value <= told.high  # the load, whichever it is
        assert load.load.size.low <= size.value <= load.load.size.high


def test_without_the_true_effect_the_catalogue_has_no_answer(monkeypatch):
    every = sessions.candidates_of
    monkeypatch.setattr(
        sessions,
        'candidates_of',
        lambda *given: [c for c in every(*given) if c.names != ('hinge_friction',)],
    )
    found = diagnose(measured(EXACT, {'hinge_friction': {'lever': 3e-4}}, count=8))
    assert found.verdict == 'outside_catalogue'


@pytest.mark.parametrize('setting', [0.01, slow(0.03)])
@pytest.mark.long
def test_undeclared_setting_noise_yields_no_name(setting):
    dataset = measured(ROBOT, noise=replace(NOISE, setting=setting), count=12)
    found = diagnose(replace(dataset, setting_noise=0.0))
    assert found.verdict not in NAMING
    assert 'declare tension_noise: setting' in found.remainder


@pytest.mark.long
def test_one_tendon_cannot_tell_and_the_proposed_posture_can():
    inputs = np.outer([0.3, 0.5, 0.7, 0.9, 1.1, 1.3], [1.0, 0.0])
    truths = {'hinge_friction': {'lever': 3e-4}}  # of an arm as built, 2.4e-4 would be seen
    arm = simulated.robot(cells=8)
    robot = replace(arm, exact=True)  # of an arm as built, a gain that is off does the same
    found = diagnose(measure(postures(robot, inputs), truths))
    assert found.verdict == 'ambiguous'
    assert {'hinge_friction', 'backbone_stiffness'} <= set(found.cannot_tell_apart)
    step = found.next_measurement
    assert step.input['right'] > 0.2, 'both tendons against each other'
    assert step.difference > 3.0 * step.noise
    proposed = [step.input[name] for name in arm.inputs]
    built = diagnose(replace(measure(postures(robot, inputs), truths), robot=arm))
    assert set(found.cannot_tell_apart) <= set(built.cannot_tell_apart)
    again = diagnose(measure(postures(robot, [*inputs, proposed]), truths, seed=1))
    assert (again.verdict, names(again)) == ('missing_effect', ['hinge_friction'])


def test_wire_pulls_show_a_stretching_tendon():
    robot = simulated.robot('spatial_3', cells=8, exact=True)
    hidden = {'tendon_elongation': {'compliance': 2e-3}}
    found = diagnose(measured(robot, hidden, count=8, input='displacement'))
    assert (found.verdict, names(found)) == ('ambiguous', ['tendon_elongation'])
    assert set(found.cannot_tell_apart) == {'tendon_elongation', 'wire_spring'}, 'one length'
    value = found.effects[0].parameters['compliance']
    assert value.low <= 2e-3 <= value.high


@pytest.mark.long
def test_what_is_good_enough_for_the_user_is_adequate():
    dataset = replace(measured(soft_cell(EXACT, 6, 0.75), count=8), robot=EXACT)
    assert diagnose(dataset).verdict == 'outside_catalogue'
    found = diagnose(replace(dataset, accuracy=5e-3))
    assert found.verdict == 'adequate'
    assert found.details['accuracy'] == 5e-3


def test_without_trials_or_a_declared_noise_nothing_can_be_judged():
    dataset = replace(measured(ROBOT, trials=1), position_noise=None)
    found = diagnose(dataset)
    assert found.verdict == 'cannot_judge'
    assert 'repeat the postures, or declare the noise' in found.remainder
    found = diagnose(measured(ROBOT, count=1))
    assert found.verdict == 'cannot_judge'


def test_progress_is_told():
    seen = []
    diagnose(measured(EXACT, count=3), progress=lambda *said: seen.append(said))
    assert seen[-1][1] <= seen[-1][2]
    assert all(what and done >= 1 for what, done, _ in seen)


def test_a_posture_without_an_equilibrium_is_left_out_and_named():
    real = replace(planar(3), exact=True)
    tensions = [[0.0, t] for t in (0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 3.0)]
    dataset = measure(postures(real, [*tensions, [0.5, 0.0], [1.0, 0.0], [1.5, 0.0]]))
    gives_way = {'nonlinear_stiffness': {'cubic': -0.5}}  # at 2.67 N
    dataset = replace(dataset, robot=replace(real, effects=gives_way))
    found = diagnose(dataset)
    assert found.details['unsettled'] == ['6']
    assert any(line.endswith('has no equilibrium: posture 6') for line in lines(found))
    assert (found.verdict, names(found)) == ('wrong_parameter', ['nonlinear_stiffness'])
    cubic = found.effects[0].parameters['cubic']
    assert cubic.low <= 0.0 <= cubic.high
    assert add_effect(dataset, names(found)).helps
    one_after_the_other = replace(dataset, path='sequence')
    with pytest.raises(NoEquilibriumError, match='posture 6 of simulated'):
        diagnose(one_after_the_other)


def test_a_description_without_an_equilibrium_is_an_error():
    robot = replace(ROBOT, effects={**ROBOT.effects, 'tip_load': {'force_z': -50.0}})
    with pytest.raises(TendonRobotError) as error:
        diagnose(replace(measured(ROBOT, count=3), robot=robot))
    assert isinstance(error.value, NoEquilibriumError) or 'tip_load' in str(error.value)


@pytest.mark.parametrize('lever', [0.0, 3e-4])
def test_an_effect_is_there_only_if_its_interval_leaves_out_what_is_described(lever):
    dataset = measured(ROBOT, {'hinge_friction': {'lever': lever}}, count=6)
    found = gather(sessions.Question.of(dataset, dataset.robot, CATALOGUE))
    (ranked,) = (r for r in found.singles if r.candidate.names == ('hinge_friction',))
    evidence = found.evidence()
    evidence = replace(evidence, departures={ranked.names: found.departures(ranked)})
    assert differs(evidence, ranked) == (lever > 0.0)
