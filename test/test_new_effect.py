"""A built-in effect is one file and one line: the plant, the diagnosis, the docs find it there."""

import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import simulated
from source_tree import ROOT

from tendon_robot_ros import effects
from tendon_robot_ros.diagnosis.add import add_effect
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import catalogue as effects_catalogue
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.report.diagnosis_page import diagnosis_page
from tendon_robot_ros.report.diagnosis_text import lines
from tendon_robot_ros.simulation.hidden import Built, Damage, plant_catalogue
from tendon_robot_ros.simulation.plant import make_plant, parts_per_cell, real_robot

sys.path.insert(0, str(ROOT / 'tools'))
import effects_page

NAME, LOSS = 'soft_pulley', {'soft_pulley': {'loss': 0.06}}


@pytest.fixture(scope='module')
def catalogue(tmp_path_factory):
    """Put the file among the others and its name into the list; nothing else."""
    folder = tmp_path_factory.mktemp('effects')
    shutil.copy(ROOT / 'examples' / f'{NAME}.py', folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, '__path__', [*effects.__path__, str(folder)])
        patch.setattr(effects_catalogue, 'BUILT_IN', (*effects_catalogue.BUILT_IN, NAME))
        yield load_catalogue()
    sys.modules.pop(f'{effects.__name__}.{NAME}', None)


@pytest.fixture(scope='module')
def dataset(catalogue):
    return simulated.measured(simulated.robot(exact=True), LOSS, count=8, catalogue=catalogue)


@pytest.fixture(scope='module')
def diagnosis(dataset, catalogue):
    return diagnose(dataset, catalogue=catalogue)


@pytest.mark.slow  # kernels of its own
def test_the_diagnosis_names_it_and_the_reports_show_it(diagnosis):
    assert diagnosis.verdict.may_add
    assert [effect.name for effect in diagnosis.effects] == [NAME]
    assert any(
        line.startswith('Missing: a pulley that gives way, loss 0.0') for line in lines(diagnosis)
    )
    assert f'>{NAME}<' in ''.join(diagnosis_page(diagnosis).parts)


@pytest.mark.slow
def test_it_is_added_with_its_interval(dataset, diagnosis, catalogue):
    made = add_effect(dataset, diagnosis.effects, None, catalogue)
    loss = made.values[NAME]['loss']
    assert loss.low < 0.06 < loss.high
    assert made.robot.effects[NAME]['loss'] == pytest.approx(0.06, rel=0.1)


def test_a_plant_has_it_in_its_finer_cells(catalogue):
    owner = simulated.robot(lacks=simulated.SHAPING)
    n = owner.cells
    hidden = {**owner.effects, **LOSS}
    assert parts_per_cell(owner, hidden, catalogue, 3) == 3
    none = Damage(owner, 0)
    real = real_robot(owner, hidden, catalogue, 3, none, True, Built.exact(owner))
    assert real.cells == 3 * n and real.effects[NAME] == LOSS[NAME]
    assert NAME in plant_catalogue(catalogue)


@pytest.mark.slow  # a kernel of its own
def test_a_plant_does_with_it_what_the_model_does(catalogue):
    owner = simulated.robot(lacks=simulated.SHAPING)
    tensions = [[0.1, 0.6], [0.9, 0.2]]
    model = [
        Model(robot, catalogue).shapes(tensions).tip_position
        for robot in (owner, owner.with_effect(NAME, LOSS[NAME]))
    ]
    plant = [
        make_plant(owner, hidden, scatter=0.0, capstan=False, catalogue=catalogue)
        .shapes(tensions)
        .tip_position
        for hidden in ({}, LOSS)
    ]
    np.testing.assert_allclose(plant[1] - plant[0], model[1] - model[0], rtol=0.05, atol=2e-5)


def test_the_page_of_effects_gets_its_row_and_its_section(catalogue, monkeypatch):
    monkeypatch.setattr(effects_page, 'CATALOGUE', catalogue)
    row = '| `soft_pulley` `loss` | 1/N | 0 to 0.15 | 0 | 0.05 |'
    assert row in effects_page.parameters()
    assert effects_page.begun(catalogue[NAME]).startswith(
        '## soft_pulley\n\nA pulley that gives way: part of the tension is lost, '
    )


def test_a_name_that_is_there_already_is_refused(catalogue):
    with pytest.raises(effects_catalogue.EffectError, match='soft_pulley: the name is taken'):
        effects_catalogue.Catalogue([*catalogue, replace(catalogue[NAME], title='again')])
