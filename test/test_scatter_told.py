"""What is told of the sizes of imperfections: as many deviations as there are, and no more."""

import numpy as np
import pytest
from marks import slow
from scipy.stats import chi2
from simulated import CATALOGUE
from source_tree import ROOT

from tendon_robot_ros.diagnosis.report_rows import arm_report
from tendon_robot_ros.inference.candidates import likelihood_ratio_p_value
from tendon_robot_ros.inference.fit import Fit, with_imperfections
from tendon_robot_ros.inference.imperfections import Kind
from tendon_robot_ros.inference.intervals import SizeIntervals
from tendon_robot_ros.inference.marginal import (
    NEGLIGIBLE,
    PLAUSIBLE_FACTOR,
    SIZE_MAX,
    Prior,
    RandomEffects,
)
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.inference.statistics import chi2_isf
from tendon_robot_ros.report.sentences import as_built
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = ROOT / 'config' / 'robots'


def scattered(members, size, draws, seed=0):
    """Return the random effects of one kind that shows far beyond the noise, and residuals."""
    kinds = [Kind('cell_stiffness', '1', 0.03, tuple(map(str, range(members))))]
    random = RandomEffects(1e4 * np.eye(2 * members)[:, :members], np.zeros(members, int), kinds)
    off = np.random.default_rng(seed).normal(0.0, size, (draws, members))
    return random, off, off @ (1e4 * np.eye(2 * members)[:members])


@pytest.mark.parametrize('moved', [0, 3])
@pytest.mark.parametrize('size', [0.01, 0.03, 0.09])
def test_a_scatter_that_shows_is_told_as_the_sd_of_so_many_normal_deviates(size, moved):
    """
    Closed form: n s² / sigma² is chi² of n degrees of freedom, whatever is plausible.

    Members that parameters move as well tell nothing of the size.
    """
    random, off, residuals = scattered(12, size, 100)
    held, slopes, n = 0, 1e4 * np.eye(24)[:, :moved], 12 - moved
    for own, residual in zip(off, residuals, strict=True):
        found = random.estimate(residual, slopes, prior=Prior.NONE).values
        assert found == pytest.approx([np.sqrt(np.mean(own[moved:] ** 2))], rel=0.03)
        low, high = (float(end[0]) for end in SizeIntervals(random, found, slopes).ends(found))
        assert low == pytest.approx(found[0] * np.sqrt(n / chi2_isf(0.025, n)), rel=0.01)
        assert high == pytest.approx(found[0] * np.sqrt(n / chi2_isf(0.975, n)), rel=0.01)
        held += low <= size <= high
    assert 0.90 <= held / 100 <= 0.99


def test_a_scatter_that_is_not_found_is_below_what_noise_would_hide():
    """Closed form: of 12 deviations of s² + n, n the noise, the mean square was n at most."""
    seen, random = 100.0, scattered(12, 0.0, 1)[0]
    random = RandomEffects(seen * np.eye(24)[:, :12], random.owners, random.kinds)
    low, high = SizeIntervals(random, np.zeros(1)).ends(np.zeros(1))
    assert low[0] == 0.0
    assert high[0] == pytest.approx(np.sqrt(12 / chi2_isf(0.975, 12) - 1.0) / seen, rel=0.02)


@pytest.mark.parametrize(
    ('size', 'seen'),
    [
        (0.01, 30.0), slow(0.01, 100.0), slow(0.01, 300.0),
        slow(0.03, 30.0), (0.03, 100.0), slow(0.03, 300.0),
        slow(0.06, 30.0), slow(0.06, 100.0), (0.06, 300.0),
    ],
)  # fmt: skip
def test_intervals_hold_whatever_comes_out(size, seen):
    """Of a third, once and twice the plausible size; noise of 3.3, 1 and 0.33 %."""
    random, members = np.random.default_rng(0), scattered(12, 0.0, 1)[0]
    effects = RandomEffects(seen * np.eye(24)[:, :12], members.owners, members.kinds)
    held = []
    for _ in range(100):
        residual = np.append(seen * size * random.normal(size=12), np.zeros(12))
        residual += random.normal(size=24)
        found = effects.estimate(residual, np.zeros((24, 0)), prior=Prior.NONE).values
        low, high = SizeIntervals(effects, found).ends(found)
        held.append(low[0] <= size <= high[0])
    assert 0.90 <= np.mean(held) <= 0.99


def test_whether_a_size_is_told_does_not_depend_on_what_comes_out():
    """To print only what comes out large would pick what comes out too large."""
    robot, kinds = load_robot(ROBOTS / 'kato_10_1_single.yaml'), []
    for work in (None, Workmanship()):
        plant = make_plant(robot, work=work, seed=1, scatter=0.0)
        dataset = simulate(plant, default_postures(robot, 12), seed=1)
        session = Question.of(dataset, robot, CATALOGUE).weigh()
        report = arm_report(session, session.fitter.fit((), None))
        kinds.append({kind['kind']: kind for kind in report['kinds']})
    exact, usual = kinds
    for name in ('cell_stiffness', 'cell_kink', 'position'):
        assert exact[name]['told'] and usual[name]['told']
        assert exact[name]['low'] == 0.0 and exact[name]['high'] < 1.5 * usual[name]['plausible']
    said = as_built({'kinds': [exact['cell_stiffness'], {**usual['position'], 'high': None}]})
    assert ' of the cells below ' in said[0] and 'position of the tracker above ' in said[0]


def test_chance_pays_an_effect_along_imperfections_no_more_often_than_is_said():
    """An effect that stands for two of six imperfections may make the others' spread small."""
    random, _, residuals = scattered(6, 0.02, 300)
    noise = np.random.default_rng(1).normal(size=residuals.shape)
    slopes, freedoms, chances = 1e4 * np.eye(12)[:, :2], [], []
    for residual in residuals + noise:
        base = random.estimate(residual, np.zeros((12, 0)))
        fit = random.estimate(residual, slopes, base.values)
        shift = np.where(np.arange(12) < 2, residual, 0.0)
        freedoms.append(random.freedom(shift, base.values))
        chances.append(likelihood_ratio_p_value(base.deviance - fit.deviance, 2, freedoms[-1]))
    np.testing.assert_allclose(freedoms, 7.0, rtol=5e-3)  # six, and the prior as one more
    for level in (0.05, 0.2):
        assert np.mean(np.array(chances) < level) == pytest.approx(level, rel=0.4)


def told_fit(random, residual, slope):
    """Return a fit of one parameter that moves markers as imperfections may."""
    sizes = random.estimate(residual, slope[:, None], prior=Prior.LOGARITHMS).values
    lifted = random.lift(random.root(sizes), np.column_stack([slope, residual]))
    value = -(lifted[:, 0] @ lifted[:, 1]) / (lifted[:, 0] @ lifted[:, 0])
    there = residual + value * slope
    plain = Fit(('free',), (), np.array([value]), there, slope[:, None], np.zeros((0, 0, 3)))
    return with_imperfections(plain, random, sizes, {})


@pytest.mark.parametrize('members', [1, slow(3), 6, slow(20)])
@pytest.mark.long
def test_intervals_hold_as_often_as_they_say(members):
    """Exact over arms whose sizes are drawn from the prior, however few members tell the size."""
    draws, inside, plain = np.random.default_rng(members), [], []
    slope = np.where(np.arange(2 * members) < members, 1e4, 0.0)  # the mean of all members
    for _ in range(200):
        size = 0.03 * PLAUSIBLE_FACTOR ** draws.normal()
        random, _, residuals = scattered(members, size, 1, seed=draws)
        fit = told_fit(random, residuals[0] + draws.normal(size=2 * members), slope)
        inside.append(abs(fit.values[0]) < 1.96 * np.sqrt(fit.interval_covariance[0, 0]))
        plain.append(abs(fit.values[0]) < 1.96 * np.sqrt(fit.covariance[0, 0]))
    assert np.mean(plain) <= np.mean(inside)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.035)  # 2.3 sd


def test_a_size_that_nothing_tells_is_as_plausible_as_before():
    """The error of what acts like one member is normal, its sd log-normal up to the largest."""
    z = np.linspace(*np.log([NEGLIGIBLE, SIZE_MAX]) / np.log(PLAUSIBLE_FACTOR), 2001)
    ends = np.geomspace(1.0, 9.0, 400)
    chances = chi2.sf((ends[:, None] * PLAUSIBLE_FACTOR**-z) ** 2, 1)
    half = np.interp(-0.05, -np.average(chances, axis=1, weights=np.exp(-0.5 * z**2)), ends)
    for beside in (0.0, 0.01):  # a gain of one input of 1 %, and a hole of 1 %: 1.4 %
        kind = Kind('channel_gain', '1', 0.01, ('only',), beside)
        random = RandomEffects(1e6 * np.eye(2)[:, :1], np.zeros(1, int), [kind])
        fit = told_fit(random, np.array([1e4, 0.3]), np.array([1e6, 0.0]))
        told = 1.96 * np.sqrt(fit.interval_covariance[0, 0])
        assert told == pytest.approx(half * np.hypot(0.01, beside), rel=0.05)
        assert random.estimate(np.array([1e4, 0.3]), np.zeros((2, 0))).values == [0.01]


@pytest.mark.parametrize('times', [0.5, 2.0, 20.0])
def test_an_interval_is_that_of_all_sizes_that_an_imperfection_may_have(times):
    """By quadrature over the size, which ends where what scatters more is no imperfection."""
    random, _, residuals = scattered(6, times * 0.03, 1)
    slope = np.where(np.arange(12) < 6, 1e4, 0.0)  # the mean of all members, which five tell
    sizes = random.estimate(residuals[0], slope[:, None], prior=Prior.LOGARITHMS).values
    told = random.mixture(residuals[0], slope[:, None], sizes).covariance()[0, 0]
    s = np.geomspace(NEGLIGIBLE * 0.03, SIZE_MAX * 0.03, 4000)
    members = residuals[0][:6] / 1e4
    z = np.log(s / 0.03) / np.log(PLAUSIBLE_FACTOR)
    density = s**-5.0 * np.exp(-0.5 * (z**2 + np.var(members) * 6 / s**2))
    assert told == pytest.approx(np.average(s**2, weights=density) / 6, rel=0.1)


def test_the_spread_of_imperfections_is_a_root_of_their_covariance():
    """Closed form: of a member of the sd s that a column of length c shows 1 / (1 / s² + c²)."""
    kinds = [Kind('cell_stiffness', '1', 0.03, tuple('abc')), Kind('channel_gain', '1', 0.01, 'd')]
    lengths, sizes = np.array([0.0, 20.0, 100.0, 100.0]), np.array([0.03, 0.01])
    random = RandomEffects(np.diag(lengths), np.array([0, 0, 0, 1]), kinds)
    plain = Fit((), (), np.zeros(0), np.ones(4), np.zeros((4, 0)), np.zeros((0, 0, 3)))
    spread = with_imperfections(plain, random, sizes, {}).spread
    root = np.concatenate([spread['cell_stiffness'], spread['channel_gain']])
    expected = 1.0 / (sizes[[0, 0, 0, 1]] ** -2 + lengths**2)  # as before where nothing shows it
    np.testing.assert_allclose(root @ root.T, np.diag(expected), atol=1e-12)


def test_sizes_at_all_their_bounds_leave_an_interval():
    """Of an arm that nothing describes: no other sizes than the largest are drawn then."""
    kinds = [Kind(f'kind {i}', '1', 0.01, ('only',)) for i in range(12)]
    random = RandomEffects(1e3 * np.eye(12), np.arange(12), kinds)
    residual, slope = np.full(12, 1e4), np.ones(12)
    fit = told_fit(random, residual * np.linspace(-1.0, 1.0, 12), slope)
    assert 0.0 < fit.interval_covariance[0, 0] < np.inf


def test_noise_alone_is_told_by_many_deviations():
    random, _, residuals = scattered(6, 0.02, 1)
    base = random.estimate(residuals[0], np.zeros((12, 0)))
    beside = np.where(np.arange(12) < 6, 0.0, 1.0)  # no imperfection moves these
    assert random.freedom(beside, base.values) == np.inf
    assert likelihood_ratio_p_value(9.0, 2) == pytest.approx(np.exp(-4.5))
    assert likelihood_ratio_p_value(9.0, 2, 7.0) == pytest.approx(
        (1 + 2 / 7 * 3.5 * np.expm1(1.0)) ** -3.5
    )


def test_a_scatter_that_does_not_show_may_be_none():
    random, _, _ = scattered(3, 0.0, 1)
    for slope in (1e-2, 1.0):  # what is plausible moves nothing by more than 0.03 sd
        random = RandomEffects(slope * np.eye(6)[:, :3], np.zeros(3, int), random.kinds)
        size = np.array([1e-3])
        low, high = SizeIntervals(random, size).ends(size)
        assert low[0] == 0.0 and high[0] >= 0.03


def test_a_value_of_one_tendon_that_the_postures_leave_open_stays_as_described():
    """The right wire is never wound, so that nothing tells the gain of its spool."""
    robot = load_robot(ROBOTS / 'kato_10_1_single.yaml')
    robot = robot.with_effect('wire_spring', {'compliance': 1e-3})
    robot = robot.with_effect('spool_gain', {'relative_change': (0.0, 0.0)})
    hidden = {'spool_gain': {'relative_change': (0.1, 0.0)}}
    plant = make_plant(robot, hidden, seed=3, work=Workmanship().times(0.3))
    rows = np.outer(np.linspace(0.1, 1.0, 8), [np.linalg.norm(robot.tendons[0].base), 0.0])
    steady = SimulatedNoise(setting=0.0, trial=0.0)  # else it would be wound a little
    dataset = simulate(plant, rows, input='displacement', noise=steady)
    session = Question.of(dataset, robot, CATALOGUE).prepared()
    (gains,) = (one for one in session.candidates if one.names == ('spool_gain',))
    told = session.fitter.for_values(session.fitter.fit(gains.frees))
    assert [free.label for free in told.frees] == ['left']
    assert told.values[0] == pytest.approx(0.1, abs=2.0 * np.sqrt(told.interval_covariance[0, 0]))
