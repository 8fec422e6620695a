"""A string from the arm to a fixed point is told from a load that is always the same."""

import numpy as np
import pytest
import simulated
from measurements import blind

from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.tether import Answer, Tether
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

PLACES = np.array([[0.0, 0.0, 0.0], [0.02, -0.01, 0.03], [-0.04, 0.01, 0.0]])
ARMS = {  # robot, cell, fixed point [m], pull of the straight arm [N]
    'planar': ('kato_10_1_single', 8, (0.12, 0.0, 0.15), 0.06),
    'spatial': ('spatial_3', 8, (0.07, 0.08, 0.1), 0.05),
}


def string(stiffening=0.0, distance=0.1):
    """Return a string that pulls with 0.2 N along x at the origin."""
    return Tether(np.array([0.2, 0.0, 0.0]), 1.0 / distance, stiffening, np.zeros(3))


@pytest.mark.parametrize('stiffening', [0.0, 15.0])
def test_a_string_pulls_towards_its_fixed_point_with_what_its_length_says(stiffening):
    tether = string(stiffening)
    pulls, _ = tether.pulls(PLACES)
    way = np.array([0.1, 0.0, 0.0]) - PLACES
    length = np.linalg.norm(way, axis=1)
    size = 0.2 * (1.0 + stiffening * (length - 0.1))
    np.testing.assert_allclose(tether.fixed_point, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(pulls, (size / length)[:, None] * way, rtol=1e-12)


def test_a_string_does_not_push():
    pulls, slopes = string(stiffening=50.0).pulls(np.array([[0.05, 0.0, 0.0]]))
    assert not pulls.any() and not slopes.any()


def test_a_string_to_a_far_point_is_a_constant_force():
    pulls, slopes = string(distance=1e6).pulls(PLACES)
    np.testing.assert_allclose(pulls, [[0.2, 0.0, 0.0]] * 3, atol=1e-7)
    np.testing.assert_allclose(slopes, 0.0, atol=1e-6)


def test_its_slopes_are_those_of_differences():
    tether, step = string(stiffening=15.0), 1e-6
    _, slopes = tether.pulls(PLACES)
    for j, one in enumerate(step * np.eye(3)):
        moved = (tether.pulls(PLACES + one)[0] - tether.pulls(PLACES - one)[0]) / (2.0 * step)
        np.testing.assert_allclose(slopes[:, :, j], moved, atol=1e-7)


def test_an_arm_that_gives_way_along_a_spring_rests_where_both_pull_alike():
    give, stiffening = 0.3, 15.0  # [m/N]; the spring has 0.2 * 15 N/m
    arm = Answer(np.zeros((1, 3)), np.zeros((1, 3)), give * np.eye(3)[None], None, None)
    pulls = string(stiffening).settled(arm)
    np.testing.assert_allclose(pulls, [[0.2 / (1.0 + give * 0.2 * stiffening), 0.0, 0.0]])


def middle(arm):
    """Return the middle of the cell where it is tied."""
    robot = simulated.robot(ARMS[arm][0], cells=10)
    return {'arc_length': (ARMS[arm][1] - 0.5) / robot.cells * robot.length}


def diagnosed(arm, hidden):
    """Diagnose an arm as built, of ten cells, that hides something."""
    robot = simulated.robot(ARMS[arm][0], cells=10)
    plant = make_plant(robot, hidden, seed=3, work=Workmanship())
    measured = simulate(plant, default_postures(robot, 12, 0, 'tension', 'from_straight'), seed=3)
    return diagnose(measured, robot, workers=1)


@pytest.mark.parametrize('arm', ARMS)
def test_a_string_is_named_with_its_place_and_its_fixed_point(arm):
    _, _, point, tension = ARMS[arm]
    anchor = dict(zip(('point_x', 'point_y', 'point_z'), point, strict=True))
    found = diagnosed(arm, {'tether': {**middle(arm), 'tension': tension, **anchor}})
    assert found.verdict is Verdict.MISSING_EFFECT
    assert [effect.name for effect in found.effects] == ['tether']
    told = found.effects[0].parameters
    for key, value in (anchor | middle(arm)).items():
        assert told[key].value == pytest.approx(value, abs=0.01), key
    assert told['arc_length'].low <= middle(arm)['arc_length'] <= told['arc_length'].high
    assert told['tension'].value == pytest.approx(tension, rel=0.2)
    assert found.error_after < 0.1 * found.error_before


@pytest.mark.parametrize('arm', ARMS)
def test_a_load_that_is_always_the_same_stays_a_tip_load(arm):
    force = 0.5 * ARMS[arm][3]
    found = diagnosed(arm, {'tip_load': {'force_x': force, 'force_z': -force}})
    assert found.verdict in (Verdict.MISSING_EFFECT, Verdict.AMBIGUOUS)
    assert found.effects[0].name == 'tip_load'


@pytest.mark.parametrize('arm', ARMS)
def test_a_constant_force_within_the_arm_is_named_with_its_place(arm):
    """A string imitates it with one parameter more, and explains no more than chance."""
    force = {'force_x': ARMS[arm][3], 'force_z': -ARMS[arm][3]}
    found = diagnosed(arm, {'point_load': middle(arm) | force})
    assert [effect.name for effect in found.effects] == ['point_load']
    told = found.effects[0].parameters
    place = middle(arm)['arc_length']
    assert told['arc_length'].low <= place <= told['arc_length'].high
    for key, value in force.items():
        assert told[key].value == pytest.approx(value, rel=0.05), key


def test_friction_that_settles_elsewhere_lets_no_string_win():
    """The prior rows of a pattern are their own sum, not what a settled shape leaves of chi²."""
    found = diagnose(load_dataset(blind('c') / 'fit'))
    assert found.verdict is Verdict.MISSING_EFFECT
    assert [effect.name for effect in found.effects] == ['tendon_friction']
