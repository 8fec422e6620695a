"""Diagnoses of data with a hidden cause: all blind cases, and every effect on four robots."""

import numpy as np
import pytest
import simulated
from confusion import NAMING, Confusion
from measurements import LETTERS, blind, truth
from simulated import CATALOGUE, measured

from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.add import add_effect
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.robot.estimates import natural_sizes

pytestmark = pytest.mark.blind
CONFUSION = Confusion()
ROBOTS = ('kato_10_1_single', 'kato_10_1', 'spatial_3', 'spatial_6')
OUTSIDE = ('soft_cell',)


@pytest.mark.parametrize('letter', LETTERS)
def test_a_blind_case_gets_the_right_verdict(letter):
    fit, check = (load_dataset(blind(letter) / part) for part in ('fit', 'check'))
    found, hidden = diagnose(fit), truth(letter)['hidden']
    name = {'wrong_stiffness': 'backbone_stiffness'}.get(hidden, hidden)
    right = CONFUSION.add(f'blind {letter}', () if hidden == 'none' else (name,), found)
    if hidden == 'none':
        assert found.verdict == 'adequate'
    elif hidden in OUTSIDE:
        assert found.verdict == 'outside_catalogue'
    else:
        assert right
        made = add_effect(fit, found.effects, check=check)
        assert made.check.gone is None or made.check.gone >= 0.9


def typical(effect, robot):
    """Return typical values of what a fit determines, with signs where both are possible."""
    values, sized = {}, CATALOGUE[effect].sized(natural_sizes(robot)).parameters
    for i, parameter in enumerate(one for one in sized if not one.only_described):
        sign = -1.0 if i % 2 and parameter.low < 0.0 else 1.0
        value = float(np.clip(sign * parameter.typical, parameter.low, parameter.high))
        values[parameter.name] = value
        if parameter.per_section:
            values[parameter.name] = [value * (-0.7) ** s for s in range(len(robot.sections))]
    return {'presliding_length': 1e-4} if effect == 'friction_memory' else values


def hiding(effect, name):
    """
    Return the owner's robot, and how to measure so that the effect can show.

    The simulated arm is exact and its description says so: small effects are not lost in scatter.
    """
    lacks = {'tendon_friction': ('tendon_friction', *simulated.SHAPING)}.get(effect, (effect,))
    gravity = (9.81, 0.0, 0.0) if effect == 'gravity' else (0.0, 0.0, 0.0)
    robot = simulated.robot(name, lacks=lacks, gravity=gravity, exact=True)
    needs = CATALOGUE[effect].needs
    path = 'sequence' if 'history' in needs else 'from_straight'
    kind = 'displacement' if 'pulls' in needs else 'tension'
    return robot, {'path': path, 'input': kind, 'count': 20 if path == 'sequence' else 12}


@pytest.mark.parametrize('name', ROBOTS)
@pytest.mark.parametrize('effect', CATALOGUE.names)
def test_every_effect_is_found_on_every_robot(effect, name):
    robot, options = hiding(effect, name)
    dataset = measured(robot, {effect: typical(effect, robot)}, seed=3, **options)
    found = diagnose(dataset)
    right = CONFUSION.add(name, (effect,), found)
    if effect in found.not_tested:
        assert found.verdict == 'adequate', 'what does not show raises no alarm'
    elif found.verdict == 'adequate':
        assert found.error_before < 1.2 * found.noise_floor, 'lost in the noise'
    elif len(robot.sections) == 1 and effect == 'section_stiffness':
        assert 'backbone_stiffness' in {*found.cannot_tell_apart, found.effects[0].name}
    else:
        assert right
    if right and found.effects[0].name == effect:
        for key, value in found.effects[0].parameters.items():
            assert not value.note.startswith('not determined'), key


@pytest.mark.parametrize('seed', range(10))
@pytest.mark.parametrize('name', ROBOTS[:3:2])
def test_clean_robots_stay_quiet(name, seed):
    found = diagnose(measured(simulated.robot(name), count=12, seed=100 + seed))
    CONFUSION.add(f'{name} {seed}', (), found)
    assert found.verdict == 'adequate'


def test_the_confusion_matrix(capsys):
    with capsys.disabled():
        print('\n' + CONFUSION.table())
    named = [row for row in CONFUSION.rows if row[2] in NAMING]
    assert np.mean([row[4] for row in named]) <= 3.0, 'mean size of the class'
