"""Which further effects are worth a fit: told by a look that costs much less."""

import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.select import hint, several, swapped
from tendon_robot_ros.inference.session import Question

MEMORY = {'friction_memory': {'presliding_length': 1e-4}}
HINGES = {'hinge_friction': {'lever': 3e-4}}


@pytest.mark.parametrize('name', ['kato_10_1_single', 'spatial_3'])
@pytest.mark.parametrize('hidden', [HINGES, HINGES | MEMORY], ids=['alone', 'both'])
def test_memory_of_friction_is_fitted_beside_an_effect_only_where_there_may_be_one(name, hidden):
    robot = simulated.robot(name)
    session = Question.of(
        measured(robot, hidden, count=8, path='sequence'), robot, CATALOGUE
    ).weigh()
    (alone,) = session.fit_all([c for c in session.candidates if c.names == ('hinge_friction',)])
    (memory,) = [c for c in session.candidates if c.names == ('friction_memory',)]
    gain = hint(session, alone, alone.candidate.with_(memory)).gain
    assert (gain > 0.0) == (hidden != HINGES)


@pytest.mark.slow
def test_memory_of_friction_beside_another_effect_is_named():
    robot = simulated.robot('kato_10_1')
    hidden = {'hinge_friction': {'lever': 6e-4}} | MEMORY
    found = diagnose(measured(robot, hidden, seed=3, count=10, path='sequence'))
    assert found.verdict == 'several'
    assert {effect.name for effect in found.effects} == set(hidden)


@pytest.mark.long
@pytest.mark.parametrize('name', ['kato_10_1_single', 'spatial_3'])
def test_what_stands_for_one_of_several_does_not_do_what_another_of_them_does(name):
    robot = simulated.robot(name, exact=True)
    hidden = {'tip_load': {'force_x': 0.006}, 'backbone_stiffness': {'relative_change': 0.12}}
    session = Question.of(measured(robot, hidden, count=12), robot, CATALOGUE).weigh()
    single = {one.names[0]: one for one in session.candidates}
    load, stiffer = (single[name] for name in hidden)  # and one too many
    (best,) = session.fit_all([load.with_(single['tension_offset']).with_(stiffer)])
    names = [set(other.names) for other in swapped(session, best)]
    assert {'tip_load', 'tension_offset', 'transmission_loss'} in names
    assert not any({'backbone_stiffness', 'transmission_loss'} <= own for own in names)


@pytest.mark.long
def test_an_effect_that_others_make_needless_leaves_the_combination():
    robot = simulated.robot('spatial_3')
    described = robot.with_effect('tendon_friction', {'friction_coefficient': 0.02})
    hidden = {
        'tendon_friction': {'friction_coefficient': 0.25},
        'tip_load': {'force_x': 0.01, 'force_z': 0.02},  # [N]
    }
    session = Question.of(measured(described, hidden, count=10), described, CATALOGUE).weigh()
    first = session.fit_all([c for c in session.candidates if c.names == ('moment_arm',)])
    assert set(several(session, first)[1][0].names) == set(hidden)
