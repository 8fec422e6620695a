"""What counts as tested, why something does not, and how likely a gain is by luck."""

from dataclasses import replace

import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.data import join
from tendon_robot_ros.inference.candidates import gain_p_value, why_untested
from tendon_robot_ros.inference.session import Question

ROBOT = simulated.robot()
HARDLY = 'these postures hardly show it'


def untested(robot=ROBOT, **options):
    """Return what the default postures of a robot do not show, with the reason."""
    dataset = measured(robot, **options)
    session = Question.of(dataset, robot, CATALOGUE).weigh()
    seen = session.tested(session.candidates, {})
    rest = [c for c in session.candidates if c not in seen]
    return {c.names[0]: why_untested(CATALOGUE[c.names[0]], dataset, robot) for c in rest}


def test_what_does_not_act_is_not_tested():
    found = untested()
    assert found['gravity'] == 'set to zero'
    assert found['friction_memory'] == 'every posture loaded from straight'
    assert found['tendon_elongation'] == 'wire pulls not commanded'
    assert found['tendon_travel'] == HARDLY
    assert 'hinge_friction' not in found


def test_without_friction_its_shapes_are_not_tested():
    found = untested(simulated.robot(lacks=('tendon_friction', *simulated.SHAPING)))
    for effect in ('eyelet_wrap', 'tendon_travel', 'friction_memory'):
        assert found[effect] == 'acts on tendon_friction, which the description lacks'
    assert 'tendon_friction' not in found


def test_gravity_counts_only_where_its_direction_is_known():
    assert untested(simulated.robot(gravity=None))['gravity'] == 'direction of gravity unknown'
    assert 'gravity' not in untested(simulated.robot(gravity=(9.81, 0.0, 0.0)))


def test_memory_needs_tendons_that_are_let_go():
    assert 'friction_memory' not in untested(path='sequence', count=10)
    dataset = measured(ROBOT, count=4)
    rising = replace(dataset, path='sequence', inputs=dataset.inputs.cumsum(axis=0))
    reason = why_untested(CATALOGUE['friction_memory'], rising, ROBOT)
    assert reason == 'no unloading'
    again = join([rising, replace(rising, name='again')])  # from straight
    assert why_untested(CATALOGUE['friction_memory'], again, ROBOT) == 'no unloading'


def test_elongation_shows_when_wire_pulls_are_commanded():
    assert 'tendon_elongation' not in untested(input='displacement')


def test_tolerances_become_nuisances_only_where_declared():
    assert Question.of(measured(ROBOT), ROBOT, CATALOGUE).nuisances == []
    robot = replace(ROBOT, tolerances={
        'bending_stiffness': 0.02, 'friction_coefficient': 0.05, 'rotation': 2e-3})  # fmt: skip
    nuisances = Question.of(measured(robot), robot, CATALOGUE).nuisances
    assert [(n.quantity, n.free.key, n.spread) for n in nuisances] == [
        ('bending_stiffness', 'relative_change', 0.02),
        ('friction_coefficient', 'friction_coefficient', pytest.approx(0.05 * 0.33)),
        ('rotation', 'rotation_x', 2e-3),
        ('rotation', 'rotation_y', 2e-3),
        ('rotation', 'rotation_z', 2e-3),
    ]


def test_friction_without_friction_is_no_nuisance():
    robot = simulated.robot(lacks=('tendon_friction', *simulated.SHAPING))
    robot = replace(robot, tolerances={'friction_coefficient': 0.05})
    assert Question.of(measured(robot), robot, CATALOGUE).nuisances == []


def test_luck_is_fair_on_clean_data():
    """Gains of one-sided and of two-sided parameters by luck, as often as they say."""
    one, two = [], []
    robot = replace(ROBOT, exact=True)  # else imperfections take the gains, which this arm has not
    for seed in range(40):
        session = Question.of(measured(robot, seed=seed, count=5), robot, CATALOGUE).weigh()
        base = session.base_fit()
        names = {'hinge_friction': one, 'backbone_stiffness': two}
        for ranked in session.fit_all([c for c in session.candidates if c.names[0] in names]):
            fit = ranked.fit
            chance = gain_p_value(base, session.whitener, fit.deviance, fit.markers, 1)
            level = 0.4 if fit.one_sided else 0.2
            names[ranked.candidate.names[0]].append(chance < level)
    assert 0.05 <= sum(one) / 40 <= 0.38
    assert 0.05 <= sum(two) / 40 <= 0.38
