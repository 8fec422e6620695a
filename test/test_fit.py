"""Fits find the parameters that made the data, and say how well they know them."""

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
import simulated
from arms import COARSE, planar
from marks import slow
from simulated import CATALOGUE, NOISE, measured

from tendon_robot_ros.diagnosis.add import fit_effects
from tendon_robot_ros.inference.crossval import left_out_squares
from tendon_robot_ros.inference.fitter import Fitter
from tendon_robot_ros.inference.intervals import intervals, values_of
from tendon_robot_ros.inference.noise import Whitener, input_slopes
from tendon_robot_ros.inference.predict import Predictor, free_parameters
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.inference.statistics import QUANTILE
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOT = simulated.robot(cells=8)
EXACT = replace(ROBOT, exact=True)
HIDDEN = [
    ('hinge_friction', {'lever': 2e-4}),
    ('backbone_stiffness', {'relative_change': -0.12}),
    ('tendon_stiffness', {'per_tendon': 8e-4}),
    ('nonlinear_stiffness', {'cubic': 5.0}),
    ('pre_curvature', {'angle_x': 0.01, 'angle_y': -0.004}),
    ('tip_load', {'force_x': 0.004, 'force_y': -0.001, 'force_z': 0.006}),
    ('transmission_loss', {'fraction': 0.08}),
    ('tension_offset', {'offset': 0.03}),
    ('base_misalignment', {'shift_x': 1e-3, 'rotation_y': 0.01}),
]


def settled(dataset, names, robot=None):
    """Return the session and the fit of effects."""
    session = Question.of(dataset, robot or dataset.robot, CATALOGUE).weigh()
    return fit_effects(session, names)


@pytest.mark.parametrize(('effect', 'values'), HIDDEN)
def test_a_fit_finds_what_the_robot_hides(effect, values):
    session, fit = settled(measured(ROBOT, {effect: values}), [effect])
    found = values_of(fit)[effect]
    for key, value in found.items():
        truth = values.get(key, 0.0)
        spread = (value.high - value.low) / (2 * 1.96)
        assert abs(value.value - truth) < 4.0 * spread, key
    assert fit.probability(session.noise.freedom) > 1e-3


@pytest.mark.parametrize('kind', ['tension', 'displacement'])
def test_tangents_are_what_small_changes_do(kind):
    """Of every effect that needs no history, on a settled arm without friction's kinks."""
    smooth = simulated.robot(lacks=('tendon_friction', *simulated.SHAPING))
    given = {
        'tension': [[0.6, 0.0], [0.2, 0.5], [1.2, 0.3]],
        'displacement': [[4e-3, np.nan], [2e-3, np.nan], [np.nan, 3e-3]],
    }
    dataset = simulated.postures(smooth, given[kind], input=kind)
    predictor = Predictor(dataset, smooth, CATALOGUE)
    memoryless = [e for e in CATALOGUE if e.stage != 'memory']
    memoryless = [e for e in memoryless if kind == 'displacement' or e.needs != 'pulls']
    checked = set()
    for effect in memoryless:
        frees = free_parameters(effect, smooth)
        point = {f: f.parameter.neutral + 0.3 * f.parameter.typical for f in frees}
        predictor.markers(point)
        found = predictor.tangent(point, frees, predictor.settled)
        for free, moves in zip(frees, found.markers, strict=True):
            h = 1e-3 * free.parameter.typical
            up, down = (predictor.markers({**point, free: point[free] + s}) for s in (h, -h))
            if up is None or down is None:
                continue  # a wire can let go within the difference
            checked.add(effect.name)
            off, settled_within = np.abs(moves - (up - down) / (2 * h)).max(), 1e-10 / h
            assert off < 1e-3 * np.abs(moves).max() + settled_within, (effect.name, free.key)
    assert len(checked) > 12


@pytest.mark.parametrize('kind', ['tension', 'displacement'])
@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_3'])
def test_tangents_of_all_effects_together_are_those_of_each_alone(name, kind):
    """As described, where most effects are off: one of them may have unknowns of its own."""
    described = simulated.robot(name)
    inputs = np.random.default_rng(1).uniform(0.05, 0.4, (3, len(described.inputs)))
    if kind == 'displacement':
        inputs = Model(described).shapes(inputs).pulls
    predictor = Predictor(simulated.postures(described, inputs, input=kind), described, CATALOGUE)
    frees = [f for e in CATALOGUE if e.stage != 'memory' for f in free_parameters(e, described)]
    predictor.markers({})
    tensions = predictor.settled.tensions
    acting = Predictor(simulated.postures(described, tensions), described, CATALOGUE)
    acting.markers({})
    on = predictor.model.arrays.on.copy()
    together = predictor.tangent({}, frees, predictor.settled)
    assert (predictor.model.arrays.on == on).all()
    for q, free in enumerate(frees):
        alone = predictor.tangent({}, [free], predictor.settled)
        under_tension = acting.tangent({}, [free], predictor.settled)  # before pulls are held
        shares = map(attrgetter('markers', 'states', 'tensions'), (alone, together, under_tension))
        for one, all_of_them, before in zip(*shares, strict=True):
            # pulls that are held take nearly all of what moves away: rounding of differences is
            # left, times the condition of the tensions that hold them (some 1e3 here)
            enough = 1e-4 * np.abs(one).max() + 1e-5 * np.abs(before).max() + 1e-12
            assert np.allclose(all_of_them[q], one[0], rtol=0, atol=enough), free


def test_a_large_effect_is_found_from_far_away():
    plain = simulated.robot(lacks=('tendon_friction', *simulated.SHAPING))
    truth = {'tendon_friction': {'friction_coefficient': 0.5}}
    _, fit = settled(measured(plain, truth), ['tendon_friction'])
    assert fit.values[0] == pytest.approx(0.5, abs=0.01)


def test_two_effects_are_fitted_together():
    truth = {'hinge_friction': {'lever': 2e-4}, 'pre_curvature': {'angle_x': 0.01, 'angle_y': 0.0}}
    dataset = measured(EXACT, truth)
    _, fit = settled(dataset, ['hinge_friction', 'pre_curvature'])
    assert fit.values[0] == pytest.approx(2e-4, rel=0.1)
    assert fit.values[1] == pytest.approx(0.01, rel=0.1)
    _, loose = settled(dataset, ['hinge_friction', 'pre_curvature'], ROBOT)
    spread = np.sqrt(np.diag(loose.covariance)[:2])
    assert (np.abs(loose.values[:2] - [2e-4, 0.01]) < 3.0 * spread).all()
    assert (spread > np.sqrt(np.diag(fit.covariance)[:2])).all(), 'imperfections may have done it'


def test_a_step_that_is_too_long_is_shortened_not_the_end_of_a_fit():
    robot = replace(planar(), gravity=(0.0, 0.0, 0.0), exact=True)
    dataset = measured(robot, {'tip_load': {'force_x': 0.05}}, 6, 3, input='displacement')
    session = Question.of(dataset, robot, CATALOGUE).weigh()
    stiffness, load = (
        free_parameters(session.catalogue[name], robot)
        for name in ('tendon_stiffness', 'tip_load')
    )
    alone = session.fitter.fit(load)
    assert session.fitter.fit((*stiffness, *load)).chi2 < alone.chi2 + 0.01


def test_a_fit_that_begins_with_the_derivatives_of_another_ends_where_it_would_without_them():
    """Also far from that, where they are no use, and with the parameters in another order."""
    dataset = measured(
        EXACT, {'hinge_friction': {'lever': 2e-4}, 'tension_offset': {'offset': 0.03}}
    )
    session = Question.of(dataset, EXACT, CATALOGUE).weigh()
    frees = [
        free
        for name in ('hinge_friction', 'tension_offset')
        for free in free_parameters(session.catalogue[name], EXACT)
    ]
    fitter, ends = session.fitter, []
    far = fitter.fit(frees[::-1], {free: 2.0 * free.parameter.typical for free in frees}, steps=1)
    for start in (far, replace(far, tangent=None), far.point):
        ends.append(fitter.fit(frees, start))
    for end in ends[:2]:
        assert end.values == pytest.approx(ends[2].values, rel=1e-3)
        assert end.chi2 == pytest.approx(ends[2].chi2, abs=0.01)
    assert far.tangent.of(frees[:1]).markers.shape == (1, *dataset.mean.shape)
    assert replace(far.tangent, at={}).of(frees) is None


def test_values_stay_within_their_bounds():
    _, fit = settled(measured(ROBOT, {'backbone_stiffness': {'relative_change': -0.1}}),
                     ['hinge_friction'])  # fmt: skip
    assert fit.values[0] == 0.0
    assert values_of(fit)['hinge_friction']['lever'].note == 'at its bound'


def coverage(effect, values, seeds=40):
    """Share of intervals that hold the true value."""
    held = []
    for seed in range(seeds):
        session, fit = settled(measured(ROBOT, {effect: values}, seed=seed, count=6), [effect])
        for free, (low, high) in intervals(session.fitter, fit).items():
            held.append(low <= values.get(free.parameter.name, 0.0) <= high)
    return float(np.mean(held))


@pytest.mark.parametrize(('effect', 'values'), [HIDDEN[0], slow(*HIDDEN[1])])
@pytest.mark.long
def test_intervals_hold(effect, values):
    assert coverage(effect, values) >= 0.85  # 40 seeds: 95 % within 2.9 sd


@pytest.mark.parametrize('size', [0.0, slow(1.0)])
@pytest.mark.long
def test_intervals_hold_at_a_bound(size):
    values = {'lever': 1e-5 * size}
    assert coverage('hinge_friction', values, 20) >= 0.85


def test_where_the_curvature_misleads_the_profile_decides():
    robot = simulated.robot(lacks=('eyelet_wrap',))
    session, fit = settled(
        measured(robot, {'eyelet_wrap': {'fraction': 0.6}}, trials=2), ['eyelet_wrap']
    )
    (low, high) = intervals(session.fitter, fit)[fit.frees[0]]
    for end in (low, high):
        if 0.0 < end < 1.0:
            pinned = session.predictor.markers({fit.frees[0]: end})
            white = session.whitener.white(session.dataset.mean - pinned)
            assert white @ white - fit.chi2 == pytest.approx(3.84, rel=0.25)
    assert 0.0 <= low < fit.values[0] <= high <= 1.0


@pytest.mark.parametrize('seed', [0, slow(2)])
def test_an_interval_goes_on_where_another_parameter_is_at_its_bound(seed):
    """How a small lag begins is hardly told: other presliding fits, another lag with it."""
    hidden = {'lag': 0.00375, 'presliding': 3.0}
    plant = make_plant(COARSE, {'bending_hysteresis': hidden}, seed=seed)
    inputs = np.random.default_rng(seed).permutation(default_postures(COARSE, 14))
    dataset = simulate(plant, inputs, trials=2, path='sequence', seed=seed)
    session, fit = settled(dataset, ['bending_hysteresis'])
    told = session.fitter.for_values(fit)
    ends = intervals(session.fitter, told)
    low, high = np.array(ends[fit.frees[0]]) - told.values[0]
    assert 0.5 < -high / low < 2.0
    assert low < hidden['lag'] - told.values[0] < high


@pytest.mark.parametrize('seed', [1, 3])
def test_an_interval_ends_where_its_profile_has_risen_even_if_that_is_flat_for_long(seed):
    """How a small lag begins: fast or faster, nothing tells."""
    arm = replace(COARSE, exact=True)
    plant = make_plant(arm, {'bending_hysteresis': {'lag': 0.00375, 'presliding': 3.0}}, seed=seed)
    inputs = np.random.default_rng(seed).permutation(default_postures(arm, 14))
    dataset = simulate(plant, inputs, trials=2, path='sequence', seed=seed)
    session, fit = settled(dataset, ['bending_hysteresis'], arm)
    lag, free = fit.frees
    for end in intervals(session.fitter, fit)[free]:
        pinned = replace(free, parameter=replace(free.parameter, low=end, high=end))
        rise = session.fitter.fit((lag, pinned), {**fit.point, pinned: end}).chi2 - fit.chi2
        bound = end in (free.parameter.low, free.parameter.high)
        assert rise < 3.84 if bound else rise == pytest.approx(3.84, rel=0.05)


@pytest.mark.parametrize('effect', ['moment_arm', 'backbone_stiffness'])
def test_an_interval_ends_where_the_model_itself_with_other_gains_fits_that_much_worse(effect):
    """Gains of 5 % that nobody knows bend the arm as the effect does."""
    robot, work = replace(ROBOT, effects={}), replace(Workmanship(), gain=0.05)
    plant = make_plant(robot, {effect: {'relative_change': 0.1}}, refine=1, seed=1, work=work)
    dataset = simulate(plant, default_postures(robot, 10), trials=4, seed=1)
    session, fit = settled(dataset, [effect])
    fitter = session.fitter
    told = fitter.for_values(fit)
    free = told.frees[0]
    claimed = QUANTILE * np.sqrt(told.interval_covariance[0, 0] / told.covariance[0, 0])
    for end in intervals(fitter, told)[free]:
        pinned, here = replace(free, parameter=replace(free.parameter, low=end, high=end)), told
        for _ in range(3):
            fitter.linearise_around(here.members)
            here = fitter.fit((pinned,), {pinned: end}, sizes=told.built.sizes)
        assert np.sqrt(here.chi2 - told.chi2) == pytest.approx(claimed, rel=0.1)


def test_what_no_posture_shows_has_no_interval():
    dataset = measured(ROBOT)
    session = Question.of(dataset, ROBOT, CATALOGUE).weigh()
    gravity = next(c for c in session.candidates if c.names == ('gravity',))
    fit = session.fitter.fit(gravity.frees)
    value = values_of(fit)['gravity']['linear_density']
    assert value.note == 'not determined by these postures'
    high = fit.frees[0].parameter.high
    assert intervals(session.fitter, fit)[fit.frees[0]] == (0.0, high)


def test_a_declared_tolerance_takes_part_with_its_prior():
    robot = replace(ROBOT, tolerances={'bending_stiffness': 0.05}, exact=True)
    dataset = measured(robot, {'backbone_stiffness': {'relative_change': 0.04}})
    session = Question.of(dataset, robot, CATALOGUE).weigh()
    base = session.base_fit()
    assert base.values[-1] == pytest.approx(0.04, abs=0.01)
    assert base.prior_z['bending_stiffness'] == pytest.approx(0.8, abs=0.2)
    assert base.probability(session.noise.freedom) > 1e-3
    claimed = session.fitter.fit(
        next(c for c in session.candidates if c.names == ('backbone_stiffness',)).frees
    )
    assert claimed.nuisances == ()


def test_leaving_a_posture_out_keeps_the_priors_of_imperfections():
    dataset = measured(ROBOT, {'backbone_stiffness': {'relative_change': 0.05}}, count=6)
    session, fit = settled(dataset, ['backbone_stiffness'])
    owners, by_hand = session.whitener.owners, 0.0
    priors = np.ones(len(fit.jacobian) - len(owners), dtype=bool)
    for p in range(6):
        kept = np.append(owners != p, priors)
        step = np.linalg.lstsq(fit.jacobian[kept], fit.residual[kept], rcond=None)[0]
        left = (fit.residual - fit.jacobian @ step)[: len(owners)][owners == p]
        by_hand += float(left @ left)
    assert fit.held_out(owners)[0] == pytest.approx(by_hand, rel=1e-3)


def refitted(dataset, session, fit):
    """Yield what a fit without each posture leaves (P, J, 3) [m] of all of them."""
    for name in dataset.postures:
        part = dataset.select([other for other in dataset.postures if other != name])
        predictor = Predictor(part, EXACT, CATALOGUE)
        whitener = Whitener(part, session.noise, input_slopes(predictor, fit.point))
        refit = Fitter(predictor, whitener).fit(fit.frees, fit.point)
        yield dataset.mean - session.predictor.markers(refit.point)


def test_leaving_a_posture_out_is_what_refitting_without_it_gives():
    dataset = measured(EXACT, {'backbone_stiffness': {'relative_change': 0.05}}, count=6)
    session, fit = settled(dataset, ['backbone_stiffness'])
    total, probability = fit.held_out(session.whitener.owners)
    by_hand = sum(
        float((session.whitener.white(off)[session.whitener.owners == p] ** 2).sum())
        for p, off in enumerate(refitted(dataset, session, fit))
    )
    assert total == pytest.approx(by_hand, rel=0.01)
    assert total > fit.chi2
    assert 0.001 < probability <= 1.0


def test_leaving_postures_out_keeps_a_value_within_its_bounds_and_the_others_follow():
    dataset = measured(EXACT, {'backbone_stiffness': {'relative_change': 0.05}}, seed=2, count=6)
    session, fit = settled(dataset, ['backbone_stiffness', 'hinge_friction'])
    assert fit.values[1] == 0.0
    squares = left_out_squares(session.fitter, fit)
    left = [off[p] ** 2 for p, off in enumerate(refitted(dataset, session, fit))]
    assert squares.mean() == pytest.approx(np.sum(left, axis=2).mean(), rel=0.01)


def test_noise_that_is_not_known_well_makes_the_judgement_milder():
    data = measured(simulated.robot(), noise=replace(NOISE, position=2.2e-4))
    _, fit = settled(data, ['hinge_friction'])
    assert fit.probability(40.0) > fit.probability(np.inf)
