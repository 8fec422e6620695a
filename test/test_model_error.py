"""A description that knows its own error: written, read, said, and counted with."""

from dataclasses import replace

import arms
import numpy as np
import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros import Model, diagnose
from tendon_robot_ros.cli.robot import description
from tendon_robot_ros.common.errors import RobotDescriptionError
from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.diagnosis.add import add_effect, restore
from tendon_robot_ros.inference.crossval import model_error_of
from tendon_robot_ros.inference.description import with_cells
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.report.comparison import verdict
from tendon_robot_ros.report.diagnosis_text import addition_warnings
from tendon_robot_ros.robot import dump_robot, load_robot, parse_robot

ROBOT = replace(simulated.robot(cells=6), exact=True)
LOAD = {'tip_load': {'force_x': 0.1}}
HINGES = {'hinge_friction': {'lever': 2e-4}}
UNEVEN = with_cells(ROBOT, np.linspace(1.4, 0.7, 6), digits=12)


def of(robot, dataset):
    """Return measurements with another description of the robot."""
    return replace(dataset, robot=robot)


@pytest.mark.parametrize(
    ('text', 'size'), [('0.003', 0.003), ('3 mm', 0.003), ('0.3cm', 0.003), ('0', 0.0)]
)
def test_it_is_written_by_hand_with_or_without_a_unit(text, size):
    robot = parse_robot(dump_robot(ROBOT) + f'model_error: {text}\n')
    assert robot.model_error == pytest.approx(size)
    assert load_robot(dump_robot(robot)).model_error == pytest.approx(size)


@pytest.mark.parametrize('text', ['3 N', 'much', '-1e-3', '[1]', '3'])
def test_what_is_no_length_is_refused(text):
    with pytest.raises(RobotDescriptionError, match='model_error'):
        parse_robot(dump_robot(ROBOT) + f'model_error: {text}\n')


def test_an_effect_that_is_not_all_is_added_with_the_error_that_stays():
    dataset = of(ROBOT, measured(UNEVEN, HINGES))
    made = add_effect(dataset, ['hinge_friction'])
    assert made.more_at_work
    tips = compare(dataset, made.robot).best.per_marker_rms[-1]
    assert made.robot.model_error == pytest.approx(made.model_error, rel=1e-3)
    assert made.model_error == pytest.approx(tips, rel=0.5)
    assert any('model_error' in line for line in addition_warnings(made))
    assert 'known to be off by' in description(made.robot)
    assert restore(made.robot, 'hinge_friction')[0].model_error is None


def test_an_effect_that_is_all_leaves_no_error():
    made = add_effect(measured(ROBOT, HINGES), ['hinge_friction'])
    assert made.robot.model_error is None
    assert not made.more_at_work


ARMS = {
    'planar': replace(arms.planar(cells=6), gravity=(0.0, 0.0, 0.0)),
    'spatial': replace(arms.spatial(cells=3), gravity=(0.0, 0.0, 0.0)),
}
OFF = 2e-3  # [m] rms at the tip


def off_by_itself(robot, hidden=None):
    """Return measurements of an arm whose shapes deviate from every model, in each posture."""
    dataset = measured(robot, hidden)
    heights = dataset.arc_lengths / robot.length
    grown = np.linalg.cholesky(np.minimum.outer(heights, heights))
    drawn = np.random.default_rng(4).normal(0.0, OFF / np.sqrt(3.0), (8, len(heights), 3))
    if robot.name == 'planar':
        drawn[..., 1] = 0.0
    moved = np.einsum('jk,pkc->pjc', grown, drawn)
    return replace(dataset, positions=dataset.positions + moved[:, None])


@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
@pytest.mark.parametrize('arm', ARMS)
@pytest.mark.long
def test_what_is_known_raises_no_alarm_and_what_is_more_does(arm, exact):
    robot = replace(ARMS[arm], exact=exact)
    assert diagnose(off_by_itself(robot)).verdict != 'adequate'
    known = replace(robot, model_error=OFF)
    assert diagnose(off_by_itself(known)).verdict == 'adequate'
    found = diagnose(off_by_itself(known, LOAD))
    assert [effect.name for effect in found.effects] == ['tip_load']
    force = found.effects[0].parameters['force_x']
    assert force.low <= LOAD['tip_load']['force_x'] <= force.high
    assert 'is known to be off by' in found.remainder


@pytest.mark.long
def test_an_interval_holds_what_the_model_is_off():
    loaded = of(ROBOT, measured(ROBOT, LOAD))
    sharp, wide = (
        diagnose(loaded, replace(ROBOT, model_error=error)).effects[0].parameters['force_x']
        for error in (None, 3e-3)
    )
    assert wide.high - wide.low > 3.0 * (sharp.high - sharp.low)


def test_a_response_that_is_off_is_off_by_the_same_share_of_every_change():
    session = Question.of(measured(ROBOT, LOAD), ROBOT, CATALOGUE).weigh()
    frees = next(one.frees for one in session.candidates if one.names == ('tip_load',))
    fit = session.fitter.fit(frees)
    changed = fit.values - np.array([session.predictor.value(free) for free in frees])
    more = replace(fit, response=0.1).interval_covariance - fit.interval_covariance
    np.testing.assert_allclose(more, 0.01 * np.outer(changed, changed), atol=1e-15)
    assert session.response_error == 0.0
    known = Question.of(session.dataset, replace(ROBOT, model_error=3e-3), CATALOGUE)
    blind = known.dataset.positions.copy()
    blind[:, :, -1] = np.nan  # then the marker before stands for the tip
    for one, last in ((known, -1), (known.about(replace(known.dataset, positions=blind)), -2)):
        tips = known.dataset.mean[:, last]
        moved = np.sqrt(((tips - tips.mean(axis=0)) ** 2).sum(axis=1).mean())
        assert one.response_error == pytest.approx(3e-3 / moved)


def test_a_comparison_says_whether_the_error_is_the_known_one():
    unchanged = of(ROBOT, measured(UNEVEN))
    size = float(compare(unchanged, ROBOT).best.per_marker_rms[-1])
    for error, said in ((size, 'as far off as'), (0.1 * size, 'times your repeatability')):
        assert said in verdict(compare(unchanged, replace(ROBOT, model_error=error)))


def test_observed_markers_are_in_the_frame_of_the_tracker():
    moved = ROBOT.with_effect('base_misalignment', {'shift_x': 0.01, 'rotation_z': 0.1})
    shape, seen = Model(ROBOT).shape({'left': 2.0}), Model(moved).shape({'left': 2.0})
    ends = Model(ROBOT).observed(shape)
    assert ends[-1] == pytest.approx(shape.tip_position)
    np.testing.assert_allclose(seen.tip_position, shape.tip_position)  # in the base frame
    c, s = np.cos(0.1), np.sin(0.1)
    turned = ends @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(Model(moved).observed(seen), turned + [0.01, 0.0, 0.0], atol=1e-12)
    one = Model(moved).observed(seen, [0.5 * ROBOT.length], [[0.0, 0.0, 0.0]])
    assert one.shape == (1, 3)


def test_postures_without_a_prediction_show_no_model_error():
    dataset = measured(ROBOT, {}, count=4)
    assert model_error_of(dataset, np.full(dataset.mean.shape[:2], np.nan), 1e-4) is None


def sizes_of_remainder(session):
    """Return the rms (P,) over the markers of a remainder of 1 m at the tip."""
    own = session.imperfections.moves[
        session.imperfections.owners == len(session.random.kinds) - 1
    ]
    return np.sqrt(np.square(own).sum(axis=(0, 3)).mean(axis=1))


@pytest.mark.parametrize('grows', [True, False])
@pytest.mark.parametrize('make', [arms.planar, arms.spatial])
def test_an_error_that_no_effect_explains_grows_with_the_bend_where_measurements_say_so(
    make, grows
):
    robot = replace(make(cells=6), gravity=(0.0, 0.0, 0.0))
    dataset = measured(robot, count=12)
    straight = np.zeros_like(dataset.mean)
    straight[..., 2] = dataset.arc_lengths
    bent = np.sqrt(np.square(dataset.mean - straight).sum(axis=2).mean(axis=1))
    walk = np.cumsum(np.random.default_rng(3).normal(size=dataset.mean.shape), axis=1)
    error = 1e-3 * walk * (bent[:, None, None] / bent.mean() if grows else 1.0)
    dataset = replace(dataset, positions=dataset.positions + error[:, None])
    before = Question.of(dataset, robot, CATALOGUE).weigh()
    even, sizes = map(sizes_of_remainder, (before, before.growing(before.base_fit())))
    np.testing.assert_allclose(even, even[0])
    assert np.square(sizes).mean() == pytest.approx(even[0] ** 2)
    if grows:
        assert np.corrcoef(sizes, bent)[0, 1] > 0.95
    else:
        np.testing.assert_allclose(sizes, even)
