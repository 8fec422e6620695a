"""Identification while running: the recursive estimate, and what follows it."""

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.data import default_markers
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.monitoring.adaptation import Adaptation, RecursiveEstimate
from tendon_robot_ros.monitoring.change import JUDGED_POSTURES
from tendon_robot_ros.robot import dump_robot, load_robot, parse_robot
from tendon_robot_ros.workspace.postures import default_postures

NOISE = 0.3
WIDE = np.full(2, -1e3), np.full(2, 1e3)


def rows(count, size, seed):
    return np.random.default_rng(seed).normal(size=(count, 3, size))


def fed(estimate, columns, truths, seed):
    """Let an estimate learn measurements (k, 3) of a state (k, p)."""
    random = np.random.default_rng([seed, 1])
    for own, truth in zip(columns, truths, strict=True):
        seen = own @ truth + NOISE * random.normal(size=3)
        estimate.learn(seen - own @ estimate.mean, own, NOISE**2 * np.eye(3))
    return estimate


def test_of_constant_parameters_it_is_least_squares_with_the_prior():
    columns, truth, random = rows(40, 4, 0), np.array([0.5, -1.0, 0.3, 0.8]), [1]
    estimate = RecursiveEstimate(*WIDE, others=2, memories=[1.0])
    seen = columns @ truth + NOISE * np.random.default_rng(random).normal(size=(40, 3))
    for own, y in zip(columns, seen, strict=True):
        estimate.learn(y - own @ estimate.mean, own, NOISE**2 * np.eye(3))
    stacked = columns.reshape(-1, 4)
    told = stacked.T @ stacked / NOISE**2 + np.eye(4)
    batch = np.linalg.solve(told, stacked.T @ seen.ravel() / NOISE**2)
    assert estimate.mean == pytest.approx(batch, abs=1e-9)
    assert estimate.covariance == pytest.approx(np.linalg.inv(told), abs=1e-10)


def test_what_does_not_change_is_remembered_and_a_step_is_followed():
    """Before the step the filter that forgets nothing leads; after it one that does."""
    columns = 0.3 * rows(120, 2, 2)
    truths = np.where(np.arange(120)[:, None] < 80, [0.2, -0.4], [1.4, -0.4])
    estimate = fed(RecursiveEstimate(*WIDE), columns[:80], truths[:80], 3)
    assert estimate.memory > 0.95
    assert estimate.weights[0] == max(estimate.weights)
    sd = np.sqrt(np.diag(estimate.covariance))
    assert np.abs(estimate.mean - truths[0]).max() < 3.5 * sd.max()
    lengths = []
    for i in range(80, 120):
        fed(estimate, columns[i : i + 1], truths[i : i + 1], i)
        lengths.append(abs(estimate.mean[0] - 1.4))
    assert np.mean(lengths[20:]) < 0.3, 'a filter of 80 measurements would still be 0.8 off'
    kept = fed(RecursiveEstimate(*WIDE, memories=[1.0]), columns, truths, 3)
    assert abs(kept.mean[0] - 1.4) > 0.5


def test_without_excitation_nothing_moves_and_the_covariance_never_exceeds_the_prior():
    estimate = fed(RecursiveEstimate(*WIDE, others=1), rows(10, 3, 4), np.zeros((10, 3)), 4)
    mean, before = estimate.mean, estimate._filters[-1].covariance[:2, :2]
    for _ in range(2000):
        estimate.learn(np.zeros(3), np.zeros((3, 3)), np.eye(3))
    assert estimate.mean == pytest.approx(mean, abs=0.2)
    for one in estimate._filters:
        widest = np.linalg.eigvalsh(one.covariance[:2, :2])[-1]
        assert widest < 1.0 + 1e-9
    assert widest > np.linalg.eigvalsh(before)[-1], 'the last one forgets'


def test_it_never_leaves_its_interval_and_comes_back_at_once():
    columns = 0.5 * rows(90, 2, 5)
    estimate = RecursiveEstimate(np.array([-1.0, -1.0]), np.array([1.0, 1.0]))
    for own in columns[:60]:
        fed(estimate, own[None], np.array([[6.0, 0.5]]), 6)
        assert (np.abs(estimate.mean) <= 1.0).all()
    assert estimate.mean[0] == 1.0
    fed(estimate, columns[60:], np.tile([-0.5, 0.5], (30, 1)), 7)
    assert estimate.mean == pytest.approx([-0.5, 0.5], abs=0.3)


# -----------------------------------------------------------------------------
# A description that follows an arm.

ROBOT = load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')
TRACKER_NOISE = 2e-4


def described(value=0.30e-3, low=0.18e-3, high=0.42e-3):
    """Return a description with a fitted lever [m]."""
    origin = {'parameters': {'lever': {'value': value, 'low': low, 'high': high, 'unit': 'm'}}}
    return ROBOT.with_effect('hinge_friction', {'lever': value}, origin)


def seen_of(lever, count, seed):
    """Return tensions (P, m) [N] and markers (P, J, 3) [m] of an arm with a lever [m]."""
    model = Model(ROBOT.with_effect('hinge_friction', {'lever': lever}))
    tensions = np.clip(default_postures(ROBOT, count, seed), *ROBOT.tension_limits)
    markers = default_markers(ROBOT)
    arcs, offsets = (np.array([getattr(m, k) for m in markers]) for k in ('arc_length', 'offset'))
    exact = np.array([model.shape(t).markers(arcs, offsets) for t in tensions])
    return tensions, exact + np.random.default_rng(seed).normal(0.0, TRACKER_NOISE, exact.shape)


def followed(adaptation, lever, count, seed, change=True):
    """Stand at postures; return the changes."""
    postures = zip(*seen_of(lever, count, seed), strict=True)
    made = (adaptation.update(tensions, seen, change) for tensions, seen in postures)
    return [one for one in made if one is not None]


def lever(robot):
    return robot.effects['hinge_friction']['lever']


def test_a_lever_follows_slowly_within_its_interval_and_is_given_back():
    adaptation = Adaptation(Model(described()), default_markers(ROBOT), TRACKER_NOISE)
    assert followed(adaptation, 0.30e-3, 12, 1) == [], 'it is as described'
    changes = followed(adaptation, 0.39e-3, 20, 2)
    assert lever(adaptation.robot) == pytest.approx(0.39e-3, abs=0.02e-3)
    for change in changes:
        (one,) = change.parameters
        assert abs(one.after - one.before) <= 0.25 * 0.24e-3 + 1e-9
        assert change.error_after < change.error_before
        assert f'{one.before:.4g} -> {one.after:.4g} m' in str(one)
    postures = [change.posture for change in changes]
    assert len(changes) >= 2
    assert min(np.diff(postures)) >= JUDGED_POSTURES
    assert postures[0] >= 12
    again = parse_robot(dump_robot(adaptation.robot))
    assert again.fitted['hinge_friction']['parameters']['lever']['high'] == 0.42e-3
    undone = []
    while (back := adaptation.undo()) is not None:
        undone.append(back)
    ways = [(p.after, p.before) for change in reversed(changes) for p in change.parameters]
    assert [(p.before, p.after) for back in undone for p in back.parameters] == ways
    assert lever(adaptation.robot) == 0.30e-3
    assert adaptation.robot == described()


def test_a_lever_beyond_its_interval_stays_at_its_end_and_it_is_said():
    adaptation = Adaptation(Model(described(high=0.33e-3)), default_markers(ROBOT), TRACKER_NOISE)
    followed(adaptation, 0.36e-3, 6 * JUDGED_POSTURES, 3)
    assert lever(adaptation.robot) <= 0.33e-3
    assert 'hinge_friction.lever is at the end of its interval: investigate' in adaptation.text


def test_what_no_value_explains_is_not_followed():
    adaptation = Adaptation(Model(described()), default_markers(ROBOT), TRACKER_NOISE)
    followed(adaptation, 0.30e-3, 10, 4)
    before = adaptation.values()
    tensions, seen = seen_of(0.30e-3, 8, 5)
    for t, y in zip(tensions, seen + np.array([0.02, 0.0, 0.0]), strict=True):
        assert adaptation.update(t, y) is None
    assert adaptation.values() == before
    assert 'something else has changed' in adaptation.text


@pytest.mark.parametrize(
    ('robot', 'why'),
    [
        (ROBOT, 'tendon_friction.friction_coefficient has no interval'),
        (ROBOT.with_effect('hinge_friction', {'lever': 3e-4}), 'lever has no interval'),
        (described(low=0.33e-3), 'lever is outside its interval'),
    ],
)
def test_what_has_no_interval_does_not_follow(robot, why):
    adaptation = Adaptation(Model(robot), default_markers(ROBOT), TRACKER_NOISE)
    assert why in adaptation.text
    assert followed(adaptation, 0.39e-3, 10, 6) == []


def test_only_the_estimate_moves_where_nothing_may_follow():
    adaptation = Adaptation(Model(described()), default_markers(ROBOT), TRACKER_NOISE)
    assert followed(adaptation, 0.39e-3, 12, 7, change=False) == []
    value, sd = adaptation.values()['hinge_friction.lever']
    assert value == pytest.approx(0.39e-3, abs=4 * sd)
    assert adaptation.robot == described()
