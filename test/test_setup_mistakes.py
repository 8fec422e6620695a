"""Mistakes of the set-up are named as what they are, and arms without one are left alone."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.comparison.predict import Predictor
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.setup_mistakes import find_mistake
from tendon_robot_ros.report.diagnosis_text import lines

ROBOT = simulated.robot()
FLOOR = 2e-4


@pytest.fixture(scope='module')
def right():
    return measured(ROBOT, count=8)


def turned(dataset, angle):
    c, s = np.cos(angle), np.sin(angle)
    return dataset.positions @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


MISTAKES = {
    'inputs_swapped': lambda d: {'inputs': d.inputs[:, ::-1]},
    'axes': lambda d: {'positions': d.positions[..., [1, 0, 2]]},
    'registration': lambda d: {'positions': turned(d, 0.7) + [0.02, 0.0, 0.01]},
    'markers_from_the_tip': lambda d: {'positions': d.positions[:, :, ::-1]},
    'unit_of_inputs': lambda d: {'inputs': d.inputs / 9.81},
    'unit_of_positions': lambda d: {'positions': d.positions * 1000.0},
}


@pytest.mark.parametrize('name', MISTAKES)
def test_a_mistake_is_named_with_the_error_before_and_after(right, name):
    wrong = replace(right, **MISTAKES[name](right))
    found = find_mistake(Predictor(wrong, ROBOT, CATALOGUE), FLOOR)
    assert found is not None
    same = {'inputs_swapped': ('inputs_swapped', 'axes')}  # a mirrored planar arm is both
    assert found.name in same.get(name, (name,))
    assert found.after < 1e-3


def test_markers_a_cell_further_than_said_are_named_and_the_tip_marker_is_among_them(right):
    cell = ROBOT.sections[0].cell_length
    markers = tuple(replace(m, arc_length=max(m.arc_length - cell, 0.0)) for m in right.markers)
    wrong = replace(right, markers=markers)
    found = find_mistake(Predictor(wrong, ROBOT, CATALOGUE), FLOOR)
    assert found is not None and found.name == 'markers_elsewhere'
    assert '1 cell nearer to the tip' in found.sentence


def test_a_mistake_without_which_nothing_settles_says_the_best_factor(right):
    section = ROBOT.sections[0]
    soft = replace(section, bending_stiffness=tuple(0.1 * k for k in section.bending_stiffness))
    found = diagnose(replace(right, robot=replace(ROBOT, sections=(soft,))))
    assert found.details['mistake']['name'] == 'unit_of_inputs'
    assert 'divided by 10' in found.remainder


def test_a_frozen_marker_is_named(right):
    positions = right.positions.copy()
    positions[:, :, 9] = positions[0, 0, 9]
    found = find_mistake(Predictor(replace(right, positions=positions), ROBOT, CATALOGUE), FLOOR)
    assert found is not None
    assert 'marker 10 stands still' in found.sentence


def test_a_diagnosis_says_the_mistake_and_nothing_else(right):
    wrong = replace(right, positions=right.positions[:, :, ::-1])
    found = diagnose(wrong)
    assert found.verdict == 'cannot_judge'
    assert found.effects == ()
    assert any('numbered from the tip' in line for line in lines(found))


PHYSICS = {
    'hinge_friction': {'lever': 3e-4},
    'tip_load': {'force_x': 3e-3},
    'nonlinear_stiffness': {'cubic': 3.0},
    'base_misalignment': {'rotation_y': 0.08},
}


@pytest.mark.parametrize('hidden', PHYSICS)
def test_physics_is_no_mistake(hidden):
    dataset = measured(ROBOT, {hidden: PHYSICS[hidden]}, count=8)
    assert find_mistake(Predictor(dataset, ROBOT, CATALOGUE), FLOOR) is None
