"""Which further effects are worth a fit: told by a look that costs much less."""

import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.joint import hints
from tendon_robot_ros.diagnosis.session import Session

MEMORY = {'friction_memory': {'presliding_length': 1e-4}}
HINGES = {'hinge_friction': {'lever': 3e-4}}


@pytest.mark.parametrize('name', ['kato_10_1_single', 'spatial_3'])
@pytest.mark.parametrize('hidden', [HINGES, HINGES | MEMORY], ids=['alone', 'both'])
def test_memory_of_friction_is_fitted_beside_an_effect_only_where_there_may_be_one(name, hidden):
    robot = simulated.robot(name)
    session = Session(
        measured(robot, hidden, count=8, path='sequence'), robot, CATALOGUE, workers=1
    )
    assert session.weigh({})
    (alone,) = session.fit_all([c for c in session.candidates if c.names == ('hinge_friction',)])
    (memory,) = [c for c in session.candidates if c.names == ('friction_memory',)]
    assert hints(session, alone, alone.candidate.with_(memory)) == (hidden != HINGES)


@pytest.mark.slow
def test_memory_of_friction_beside_another_effect_is_named():
    robot = simulated.robot('kato_10_1')
    hidden = {'hinge_friction': {'lever': 6e-4}} | MEMORY
    found = diagnose(measured(robot, hidden, seed=3, count=10, path='sequence'), workers=1)
    assert found.verdict == 'several'
    assert {effect.name for effect in found.effects} == set(hidden)
