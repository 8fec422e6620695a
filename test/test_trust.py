"""The procedure's own alarm rate and smallest sizes, by simulating the user's postures."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from simulated import CATALOGUE, NOISE, measured

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.data import save_dataset
from tendon_robot_ros.diagnosis import trust as trust_module
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.trust import (
    assess,
    simulated_measurements,
    smallest_sizes,
    wilson,
)
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.inference.statistics import chi2_noncentrality
from tendon_robot_ros.report.diagnosis_text import trust_lines

ROBOT = simulated.robot(cells=8, exact=True)
DRUM = """
from tendon_robot_ros.effects import Effect, Parameter


def law(tension, factor):
    return tension * factor


PARAMETERS = (Parameter('factor', '1', 0.5, 2.0, 1.0, typical=0.1),)
EFFECT = Effect('drum', 'a drum of another size', 'actuation', PARAMETERS, law, divisible=True)
"""


@pytest.fixture(scope='module')
def trust():
    dataset = measured(ROBOT, {'hinge_friction': {'lever': 2e-4}}, count=5, trials=3)
    return assess(dataset, workers=1, runs=16, seconds=500.0)  # enough


@pytest.mark.long
def test_clean_data_rarely_alarms_and_small_effects_are_seen(trust):
    assert (trust['runs'], trust['checked']) == (16, 8)
    assert trust['alarm_rate'] <= 1 / 16
    assert trust['alarm_rate_low'] <= trust['alarm_rate'] <= trust['alarm_rate_high']
    assert trust['detected'] >= 4
    sizes = {
        name: one['size'] for name, own in trust['detectable'].items() for one in own.values()
    }
    assert 1e-6 < sizes['hinge_friction'] < 2e-4
    assert 'gravity' not in sizes, 'these postures do not show it'


@pytest.mark.long
def test_it_is_told_in_words(trust):
    found = diagnose(measured(ROBOT, count=3))
    assert trust_lines(found) == []
    lines = trust_lines(replace(found, details={'trust': trust}))
    assert lines[0].startswith('With nothing missing, this procedure raises an alarm in ')
    assert '16 simulated on your postures' in lines[0]
    assert 'hinge_friction lever ' in lines[1]
    assert lines[2].startswith('Of 8 simulated robots with an effect of such a size, ')


def test_time_is_kept():
    dataset = measured(ROBOT, count=3, trials=3)
    short = assess(dataset, workers=1, runs=200, seconds=0.5)
    assert 1 <= short['runs'] < 200


def test_without_noise_there_is_nothing_to_simulate():
    dataset = replace(measured(ROBOT, count=3, trials=1), position_noise=None)
    assert assess(dataset, workers=1) is None


def test_a_simulated_set_keeps_what_was_not_seen_and_has_the_noise():
    dataset = measured(ROBOT, count=4)
    positions = dataset.positions.copy()
    positions[1, 2, 3] = np.nan
    dataset = replace(dataset, positions=positions)
    predictor = Predictor(dataset, ROBOT, CATALOGUE)
    quiet = replace(NOISE, trial=0.0, setting=0.0)
    again = simulated_measurements(predictor, {}, quiet, np.random.default_rng(0))
    np.testing.assert_array_equal(np.isnan(again.positions), np.isnan(positions))
    left = again.positions - predictor.markers({})[:, None]
    assert np.nanstd(left) == pytest.approx(NOISE.position, rel=0.05)


def test_tolerances_and_imperfections_hide_their_twins():
    exact = measured(ROBOT, count=5)
    loose = replace(exact, robot=replace(ROBOT, tolerances={'bending_stiffness': 0.05}))
    built = replace(exact, robot=replace(ROBOT, exact=False))
    sizes = []
    for dataset in (exact, loose, built):
        session = Question.of(dataset, dataset.robot, CATALOGUE).weigh()
        tested = session.tested(session.candidates, {})
        seen = smallest_sizes(session.fit_all(tested), session.nuisances)
        sizes.append({one.free.effect: one.size for one in seen})
    assert sizes[1]['backbone_stiffness'] > 0.15 > 5.0 * sizes[0]['backbone_stiffness']
    assert sizes[1]['hinge_friction'] > 1.2 * sizes[0]['hinge_friction']
    assert sizes[2]['backbone_stiffness'] > 5.0 * sizes[0]['backbone_stiffness'], (
        'gains do the same'
    )


@pytest.mark.long
def test_what_is_hidden_is_a_size_away_from_where_nothing_acts(tmp_path):
    (tmp_path / 'drum.py').write_text(DRUM)
    dataset = measured(ROBOT, count=5)
    session = Question.of(dataset, ROBOT, load_catalogue([str(tmp_path / 'drum.py')])).weigh()
    tested = session.tested(session.candidates, {})
    seen = smallest_sizes(session.fit_all(tested), session.nuisances)
    drum = next(one for one in seen if one.free.effect == 'drum')
    assert drum.size < 0.1
    assert drum.value == 1.0 + drum.size


def test_power_and_rates_are_as_tables_say():
    assert chi2_noncentrality(0.8, 0.05, 1) == pytest.approx((1.96 + 0.8416) ** 2, rel=1e-3)
    assert chi2_noncentrality(0.8, 0.05, 3) == pytest.approx(10.90, rel=1e-3)
    assert wilson(0, 100) == pytest.approx((0.0, 0.0370), abs=1e-3)
    assert wilson(5, 100) == pytest.approx((0.0215, 0.1118), abs=1e-3)
    assert wilson(0, 0) == (0.0, 1.0)


@pytest.mark.long
def test_how_long_it_takes_is_said_and_shown(tmp_path, capsys, monkeypatch):
    dataset = measured(ROBOT, count=3, trials=3)
    shown = []
    assess(dataset, workers=1, seconds=1.0, progress=lambda *one: shown.append(one))
    assert {total for _, _, total in shown} == {1}, 'seconds end it'
    done = [one for _, one, _ in shown]
    assert done == sorted(done) and done[0] == 0
    assert shown[0][0] == '0 simulated with nothing missing [s]'
    assert shown[-1][0].endswith('simulated with an effect [s]')
    save_dataset(dataset, tmp_path / 'data')
    monkeypatch.setattr(trust_module, 'assess', lambda *_, **__: None)
    assert main(['diagnose', str(tmp_path / 'data'), '--trust']) == 0
    assert 'simulating your postures; that takes about 50 s' in capsys.readouterr().err
