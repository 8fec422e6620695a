"""The measured trunk: two data sets, one of them with a known load."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.data import join, load_dataset
from tendon_robot_ros.diagnosis.add import Addition, add_effect, fit_effects
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.crossval import Errors
from tendon_robot_ros.inference.fitter import Fitter
from tendon_robot_ros.inference.noise import input_slopes
from tendon_robot_ros.inference.outliers import find_outliers
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.session import Question

TRUNK = ROOT / 'data' / 'trunk'


@pytest.fixture(scope='module')
def both():
    """Read both data sets as one."""
    return join([load_dataset(TRUNK / name) for name in ('base', 'payload_100')])


def test_the_trunk_loads_and_compares(both):
    assert both.positions.shape == (18, 29, 3, 3)
    assert len(np.unique(both.groups)) == 9
    found = compare(both, leave_out=False)
    assert found.models[0].rms == pytest.approx(12.57e-3, abs=2e-5)


def test_the_known_weight_pulls_its_own_postures_down(both):
    predictor = Predictor(both, both.robot, load_catalogue())
    shown = predictor.markers({})
    down = shown[9:, -1, 2] - shown[:9, -1, 2]
    assert (down[np.arange(9) != 4] > 3e-4).all() and abs(down[4]) < 1e-4  # c4 hangs straight


def test_an_input_counts_though_an_error_of_one_sd_leaves_some_postures_without_equilibrium(both):
    predictor = Predictor(both, both.robot, load_catalogue())
    assert (np.abs(input_slopes(predictor, {})).max(axis=(0, 2, 3)) > 1e-3).all()


@pytest.mark.parametrize('name', ['base', 'payload_100'])
def test_a_visit_to_the_rest_is_hardly_ever_a_wild_reading(name):
    """The play of the wires is the same there as anywhere."""
    dataset = load_dataset(TRUNK / name)
    wild = find_outliers(Predictor(dataset, dataset.robot, load_catalogue()), {})
    assert wild.trials.sum() <= 1 and not wild.readings[dataset.postures.index('c4')].any()


def test_every_folder_keeps_its_licence():
    for name in ('base', 'payload_100'):
        assert 'MIT License' in (TRUNK / name / 'LICENSE.txt').read_text(encoding='utf-8')


def test_a_fit_that_makes_others_worse_is_not_written(tmp_path, monkeypatch, capsys):
    data = TRUNK / 'base'
    robot = load_dataset(data).robot
    fitted = Errors('fitted', 'base', 9, 8e-3, 7e-3, 1e-3)
    worse = Errors('left out', 'base', 9, 8e-3, 8.1e-3, 1e-3)
    made = Addition(robot, {}, fitted, worse, 0.5)
    monkeypatch.setattr('tendon_robot_ros.cli.diagnosis.add_effect', lambda *args, **options: made)
    new = tmp_path / 'new.yaml'
    assert main(['effect', 'add', 'gravity', '--data', str(data), '--output', str(new)]) == 2
    assert 'Nothing was written: the error on postures' in capsys.readouterr().out
    assert not new.exists()
    better = replace(made, check=replace(worse, after=7e-3))
    monkeypatch.setattr(
        'tendon_robot_ros.cli.diagnosis.add_effect', lambda *args, **options: better
    )
    assert main(['effect', 'add', 'gravity', '--data', str(data), '--output', str(new)]) == 0
    assert new.exists()


def test_the_order_in_which_effects_are_named_does_not_matter(both, monkeypatch):
    """Springs of the wires join first, and what has no equilibrium alone waits for the rest."""
    few, joined = both.select(both.postures[::6]), []
    session = Question.of(few, few.robot, load_catalogue()).weigh()
    plain = Fitter.fit

    def fit(fitter, frees, start=None, **options):
        names = list(dict.fromkeys(free.effect for free in frees))
        joined.append(names)
        if names[-1] == 'pre_curvature' and len(names) < 3:
            raise ArithmeticError('no start of the fit has an equilibrium')
        return plain(fitter, (), **options)

    monkeypatch.setattr(Fitter, 'fit', fit)
    fit_effects(session, ['pre_curvature', 'gravity', 'wire_spring'])
    whole = ['wire_spring', 'gravity', 'pre_curvature']
    ways = [['wire_spring'], ['wire_spring', 'pre_curvature'], whole[:2], whole]
    assert joined == [*ways, *[['pre_curvature', 'gravity', 'wire_spring']] * 2]


def test_where_an_effect_led_the_arm_may_have_no_equilibrium_without_it():
    """It was the end of `diagnose data/trunk/base`."""
    base = load_dataset(TRUNK / 'base')
    session = Question.of(base, base.robot, load_catalogue()).weigh()
    fit = session.base_fit()
    assert fit.built is not None
    slack = {'pull_zero': np.ones_like(fit.built.around['pull_zero'])}  # a metre of every wire
    away = replace(fit, built=replace(fit.built, around=slack))
    with pytest.raises(ArithmeticError):
        session.fitter.fit((), away)
    assert session.base_fit([away]).deviance == pytest.approx(fit.deviance)


@pytest.mark.slow
def test_from_the_trunk_without_a_load_the_unknown_weight_is_in_a_small_class(tmp_path):
    effects = 'wire_spring gravity pull_zero moment_arm base_misalignment axial_compression'
    base = load_dataset(TRUNK / 'base')
    alone = add_effect(base, effects.split()).robot
    assert diagnose(base, robot=alone).verdict == 'adequate'
    shutil.copytree(TRUNK, tmp_path / 'unknown')
    told = tmp_path / 'unknown' / 'payload_100' / 'dataset.yaml'
    lines = told.read_text(encoding='utf-8').splitlines(keepends=True)
    assert sum(line.startswith('known:') for line in lines) == 1
    told.write_text(
        ''.join(line for line in lines if not line.startswith('known:')), encoding='utf-8'
    )
    found = diagnose(load_dataset(told.parent), robot=alone)
    assert 'tip_load' in found.cannot_tell_apart and len(found.cannot_tell_apart) <= 3
    load = next(one for one in found.candidates if one.name == 'tip_load').parameters['force_z']
    assert load.low < 0.98 < load.high
