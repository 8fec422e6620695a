"""A declared scatter of the cells' stiffness: quiet where it explains, and no excuse beyond."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from marks import slow
from simulated import CATALOGUE, NOISE, measured

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.inference.description import with_cells
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.session import Question

EXACT = simulated.robot(cells=8, exact=True)
CELLS = EXACT.cells
ROBOT = replace(EXACT, tolerances={'cell_stiffness': 0.02})
FINE = replace(NOISE, position=5e-5, setting=5e-4, trial=5e-4)  # scatter stands out of it


def scattered(seed, hidden=None, **cells):
    """Measure an arm whose cells scatter by 2 %; `cell_3=0.6` makes the third softer."""
    factors = 1.0 + 0.02 * np.random.default_rng(seed).normal(size=CELLS)
    for name, factor in cells.items():
        factors[int(name.removeprefix('cell_')) - 1] *= factor
    real = with_cells(EXACT, factors, digits=12)
    return replace(measured(real, hidden, seed=seed, noise=FINE, count=10), robot=ROBOT)


def test_the_fit_is_that_of_generalised_least_squares():
    """Its chi² is that with the covariance of the cells in the noise."""
    session = Question.of(scattered(1), ROBOT, CATALOGUE).weigh()
    cells, _ = session.imperfections.kinds
    assert (cells.name, cells.plausible, len(cells)) == ('cell_stiffness', 0.02, CELLS)
    fit = session.base_fit()
    here = session.predictor.markers({})
    white = session.whitener.white(session.dataset.mean - here)
    size, rest = fit.built.sizes
    assert 0.01 < size < 0.04
    columns = [*rest * session.whitener.white(session.imperfections.moves[CELLS:])]
    for i in range(CELLS):
        stiffness = np.where(np.arange(CELLS) == i, 1.001, 1.0)
        other = with_cells(ROBOT, stiffness, digits=12)
        moved = Predictor(session.dataset, other, session.catalogue).markers({})
        columns.append(size * session.whitener.white(moved - here) / 1e-3)
    scatter = np.eye(len(white)) + np.array(columns).T @ np.array(columns)
    assert fit.chi2 == pytest.approx(float(white @ np.linalg.solve(scatter, white)), rel=0.02)
    assert fit.freedom == len(white)


@pytest.mark.long
def test_scatter_alarms_where_nothing_is_declared_and_is_quiet_where_it_is():
    for seed in range(2):
        assert diagnose(scattered(seed), EXACT, CATALOGUE, 1).verdict != 'adequate'
        assert diagnose(scattered(seed), ROBOT, CATALOGUE, 1).verdict == 'adequate'


@pytest.mark.parametrize('seed', [1, slow(2)])
@pytest.mark.long
def test_an_effect_is_named_alone_in_spite_of_the_scatter(seed):
    found = diagnose(scattered(seed, {'hinge_friction': {'lever': 2e-4}}), ROBOT, CATALOGUE, 1)
    assert found.verdict == 'missing_effect'
    assert [effect.name for effect in found.effects] == ['hinge_friction']
    lever = found.effects[0].parameters['lever']
    assert lever.low < 2e-4 < lever.high


@pytest.mark.parametrize(('cell', 'factor'), [(3, 0.6), slow(6, 0.7)])
@pytest.mark.long
def test_scatter_is_no_excuse_for_a_soft_cell(cell, factor):
    found = diagnose(scattered(3, **{f'cell_{cell}': factor}), ROBOT, CATALOGUE, 1)
    assert found.verdict == 'outside_catalogue'
    assert f'cell {cell} bends' in found.remainder
