"""Patterns without physics find where and when a model fails."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from arms import soft_cell
from simulated import CATALOGUE, NOISE, measured

from tendon_robot_ros.diagnosis.patterns import Pattern, Patterns, independent
from tendon_robot_ros.inference.description import with_cells
from tendon_robot_ros.inference.session import Question

ROBOT = replace(simulated.robot(), exact=True)  # scatter takes its share of every pattern


def patterns_of(dataset, robot=ROBOT):
    """Fit the patterns to measurements that the description does not explain."""
    session = Question.of(replace(dataset, robot=robot), robot, CATALOGUE).weigh()
    fit = session.base_fit()
    found = Patterns(session.fitter, fit).fitted(session.progress)
    return fit, {pattern.name: pattern for pattern in found}


@pytest.mark.parametrize(('cell', 'factor'), [(4, 0.6), (7, 1.6)])
def test_scatter_blurs_the_place_of_a_soft_cell_and_the_cells_alike_are_said(cell, factor):
    dataset = measured(soft_cell(ROBOT, cell, factor))
    fit, found = patterns_of(dataset, replace(ROBOT, exact=False))
    soft = found['soft_cell']
    assert cell in soft.alike and soft.cell in soft.alike and len(soft.alike) <= 2
    assert soft.size == pytest.approx(1.0 / factor, rel=0.08)
    assert soft.deviance < fit.deviance - 13.0


@pytest.mark.parametrize(('cell', 'factor'), [(4, 0.6), (11, 0.8), (7, 1.6)])
def test_a_soft_cell_is_found_at_its_place(cell, factor):
    fit, found = patterns_of(measured(soft_cell(ROBOT, cell, factor)))
    soft = found['soft_cell']
    assert soft.cell == cell
    assert soft.size == pytest.approx(1.0 / factor, rel=0.08)
    assert soft.score == min(pattern.score for pattern in found.values())
    assert soft.deviance < fit.deviance - 13.0


def test_a_stiffness_that_changes_along_the_arm_is_a_taper():
    fit, found = patterns_of(measured(with_cells(ROBOT, np.linspace(0.9, 1.1, 15))))
    taper = found['taper']
    assert taper.size == pytest.approx(1.1 / 0.9 - 1.0, abs=0.05)
    assert taper.score == min(pattern.score for pattern in found.values())
    assert taper.deviance < fit.deviance - 13.0
    assert taper.gain_p < 1e-9


def test_a_stiffness_that_is_another_one_everywhere_is_no_taper():
    fit, found = patterns_of(measured(with_cells(ROBOT, np.full(15, 0.95))))
    assert found['taper'].deviance < fit.deviance - 100.0
    assert found['taper'].gain_p > 0.01


def test_inputs_that_were_not_what_was_set_are_a_gain_per_posture():
    dataset = measured(ROBOT, noise=replace(NOISE, setting=0.08), count=12)
    _, found = patterns_of(dataset)
    gains = found['gain_per_posture']
    assert 0.03 < np.std(gains.values) < 0.15
    # a wire pull is no tension
    assert 'inputs that were not what was set: by' in gains.text(dataset.postures)


def test_an_input_that_was_nearly_three_times_what_was_set_is_found():
    arm = simulated.robot(cells=5, exact=True)
    dataset = measured(arm)
    inputs = dataset.inputs.copy()
    inputs[7] /= 2.9
    _, found = patterns_of(replace(dataset, inputs=inputs), arm)
    assert found['gain_per_posture'].values[7] == pytest.approx(1.9, abs=0.01)


def test_a_base_that_turns_is_a_rotation_per_posture():
    dataset = measured(ROBOT)
    angles = np.linspace(-0.03, 0.03, len(dataset.postures))
    c, s = np.cos(angles), np.sin(angles)
    x, y = dataset.positions[..., 0], dataset.positions[..., 1]
    turned = dataset.positions.copy()
    turned[..., 0] = c[:, None, None] * x - s[:, None, None] * y
    turned[..., 1] = s[:, None, None] * x + c[:, None, None] * y
    _, found = patterns_of(replace(dataset, positions=turned))
    rotation = found['rotation_per_posture']
    assert rotation.score == min(pattern.score for pattern in found.values())
    np.testing.assert_allclose(rotation.values, np.abs(angles), atol=0.02)


def test_on_clean_data_no_pattern_gains_much():
    fit, found = patterns_of(measured(ROBOT))
    for pattern in found.values():
        assert pattern.score > fit.chi2 + 2.0 * fit.rank - 9.21


@pytest.mark.parametrize(
    ('ratio', 'words'),
    [(1.04, '4 % more than'), (0.96, '4 % less than'), (1.4, '1.4 times as much as'),
     (0.5, '0.5 times as much as')],
)  # fmt: skip
def test_a_cell_that_bends_a_little_more_is_not_said_to_bend_as_it_should(ratio, words):
    pattern = Pattern('soft_cell', 0.0, 1, 1.0, 4, ratio, alike=(4,))
    assert f'cell 4 bends {words} it should.' in pattern.text(())


def test_places_that_move_markers_alike_count_as_one():
    one, other = np.eye(4)[:, :1], np.eye(4)[:, 1:2]
    assert independent(np.hstack([one, one, one])) == pytest.approx(1.0)
    assert independent(np.hstack([one, other, np.zeros((4, 1))])) == pytest.approx(2.0)
    assert independent(np.zeros((4, 2))) == 0.0


def test_a_line_that_patterns_are_far_above_changes_nothing_below_it():
    dataset = measured(soft_cell(ROBOT, 4, 0.2), count=6)
    robot = replace(ROBOT, exact=False)
    session = Question.of(replace(dataset, robot=robot), robot, CATALOGUE).weigh()
    fit = session.base_fit()
    whole = {one.name: one for one in Patterns(session.fitter, fit).fitted(session.progress)}
    line = whole['soft_cell'].score
    raced = {one.name: one for one in Patterns(session.fitter, fit, line).fitted(session.progress)}
    assert fit.deviance > line + 60.0, 'the base is far behind'
    assert raced['soft_cell'].deviance == pytest.approx(whole['soft_cell'].deviance, abs=1e-6)
    assert raced['soft_cell'].cell == whole['soft_cell'].cell
    for name, one in raced.items():
        assert (one.score < line - 9.21) == (whole[name].score < line - 9.21)
