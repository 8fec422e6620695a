"""Arms as they are built: what is hidden is named in spite of imperfections nobody declared."""

from dataclasses import replace
from pathlib import Path

import arms
import numpy as np
import pytest
import yaml
from marks import slow
from simulated import CATALOGUE, measured

from tendon_robot_ros.data import Marker, load_dataset
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.patterns import Patterns
from tendon_robot_ros.inference.fitter import Fitter
from tendon_robot_ros.inference.imperfections import BuiltPredictor, imperfections
from tendon_robot_ros.inference.marginal import Likelihood, Prior, RandomEffects
from tendon_robot_ros.inference.outliers import find_outliers
from tendon_robot_ros.inference.predict import Predictor, free_parameters
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.report.diagnosis_text import lines
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.description import planar_axis
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.studies.cases import Case
from tendon_robot_ros.studies.plan import read_plan
from tendon_robot_ros.workspace.postures import default_postures

CASES = Path(__file__).parent / 'data' / 'as_built'
ROBOTS = Path(__file__).parents[1] / 'config' / 'robots'
PLANS = Path(__file__).parents[1] / 'benchmarks' / 'plans'
TRUTH = yaml.safe_load((CASES / 'truth.yaml').read_text(encoding='utf-8'))


def case(name, part='fit'):
    return load_dataset(CASES / name / part)


# what others diagnose as well (test_add.py), another arm that hides nothing, another spatial one
AGAIN = ('messy_002', 'messy_008', 'messy_015', 'messy_s0', 'messy_s2')


@pytest.mark.parametrize(
    'name',
    [slow(one) if one in AGAIN else one for one in TRUTH],
)
@pytest.mark.long
def test_what_an_arm_as_built_hides_is_named(name):
    found, hidden = diagnose(case(name)), TRUTH[name]['hidden']
    names = [effect.name for effect in found.effects]
    if hidden == 'none':
        assert found.verdict == 'adequate'
    elif hidden == 'soft_cell':
        assert found.verdict == 'outside_catalogue'
    else:
        assert found.verdict == 'missing_effect'
        assert names == [hidden]
        for key, value in TRUTH[name]['parameters'].items():
            fitted = found.effects[0].parameters[key]
            assert fitted.value == pytest.approx(value, rel=0.1, abs=2e-4)
            assert abs(fitted.value - value) < 1.5 * (fitted.high - fitted.low) / 2.0
    assert any('scatters by' in line for line in lines(found))


@pytest.mark.long
def test_an_exact_description_knows_no_scatter():
    dataset = case('messy_000')
    exact = replace(dataset.robot, exact=True)
    found = diagnose(dataset, exact)
    assert found.verdict != 'adequate'
    assert found.details['as_built'] is None


def test_a_cell_of_its_own_moves_the_markers_as_the_whole_model_does():
    predictor = Predictor(case('messy_s0'), case('messy_s0').robot, CATALOGUE)
    split = BuiltPredictor(predictor)
    np.testing.assert_allclose(split.markers({}), predictor.markers({}), atol=1e-12)
    n = split.robot.cells
    split.around = {'cell_kink': np.tile([1e-3, 0.0], n)}
    free = free_parameters(CATALOGUE['pre_curvature'], split.robot)[0]
    np.testing.assert_allclose(split.markers({}), predictor.markers({free: 1e-3}), atol=1e-9)


def test_an_arm_whose_tendons_wind_is_not_planar():
    assert planar_axis(arms.planar()) == 0
    assert planar_axis(arms.wound(arms.planar())) is None


def test_masses_beside_the_axis_are_those_of_the_cells():
    robot = replace(arms.wound(arms.spatial()), gravity=(0.0, 0.0, 9.81))
    robot = robot.with_effect('gravity', {'linear_density': 0.3})
    predictor = Predictor(measured(robot, count=3), robot, CATALOGUE)
    shown = BuiltPredictor(predictor).markers({})
    np.testing.assert_allclose(shown, predictor.markers({}), atol=1e-12)


@pytest.mark.parametrize('name', ['messy_008', 'messy_s0'])
@pytest.mark.parametrize('hidden', ['gravity', 'tendon_stiffness', 'axial_compression'])
def test_slopes_of_imperfections_are_those_of_settled_shapes(name, hidden):
    dataset = case(name).select(case(name).postures[:4])
    split = BuiltPredictor(Predictor(dataset, dataset.robot, CATALOGUE))
    (free,) = free_parameters(CATALOGUE[hidden], split.robot)
    found = imperfections(split, {free: free.parameter.typical})
    first = {kind: list(np.flatnonzero(found.owners == k)) for k, kind in enumerate(found.kinds)}
    for kind, columns in list(first.items())[:-1]:
        for i in (0, len(kind) // 2):
            sides = []
            for side in (1e-5, -1e-5):
                split.around = {kind.name: side * np.eye(len(kind))[i]}
                sides.append(split.markers({free: free.parameter.typical}))
            slope = (sides[0] - sides[1]) / 2e-5
            np.testing.assert_allclose(
                found.moves[columns[i]], slope, atol=1e-4 * np.abs(slope).max()
            )


@pytest.mark.parametrize('kind', ['tension', 'displacement'])
@pytest.mark.parametrize('name', ['spatial_3', 'kato_10_1'])
def test_slopes_of_kinks_are_those_of_settled_shapes_where_tendons_feel_kinks(name, kind):
    """Friction that follows the travel beyond an eyelet, and motors that hold the wires' pulls."""
    robot = load_robot(ROBOTS / f'{name}.yaml')
    postures = default_postures(robot, 12, input=kind)
    plant = make_plant(robot, work=Workmanship(), seed=3)
    split = BuiltPredictor(
        Predictor(simulate(plant, postures, trials=1, seed=1, input=kind), robot, CATALOGUE)
    )
    n = sum(len(one) for one in split.kinds() if one.name == 'cell_kink')
    at = {'cell_kink': 1.7e-3 * np.random.default_rng(0).normal(size=n)}
    found = imperfections(split, {}, at)
    k = [one.name for one in found.kinds].index('cell_kink')
    for i in range(0, n, 5):
        sides = []
        for side in (1e-5, -1e-5):
            split.around = {'cell_kink': at['cell_kink'] + side * np.eye(n)[i]}
            sides.append(split.markers({}))
        slope = (sides[0] - sides[1]) / 2e-5
        moves = found.moves[found.owners == k][i]
        np.testing.assert_allclose(moves, slope, atol=0.02 * np.abs(slope).max())


def test_under_tensions_a_gain_counts_for_a_hole_off_its_place_too():
    """Without friction a tension and the radius at which it pulls act by their product alone."""
    dataset = case('messy_000')
    plain = replace(dataset.robot, effects={})
    split = BuiltPredictor(Predictor(dataset, plain, CATALOGUE))
    off, seen = np.array([0.02, -0.01]), []
    for kind in ('channel_gain', 'hole_radius'):
        split.around = {kind: off}
        seen.append(split.markers({}))
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-9)
    sizes = {kind.name: kind.plausible for kind in split.kinds()}
    assert 'hole_radius' not in sizes
    assert sizes['channel_gain'] == 0.01
    beside = {kind.name: kind.beside for kind in split.kinds()}
    assert beside.pop('channel_gain') == 0.01
    assert not any(beside.values())
    known = replace(plain, tolerances={'channel_gain': 0.003})
    kinds = BuiltPredictor(Predictor(dataset, known, CATALOGUE)).kinds()
    assert {kind.name: kind.plausible for kind in kinds}['channel_gain'] == 0.003
    assert not any(kind.beside for kind in kinds), 'who declares gains has measured them so'


def test_the_noise_of_inputs_acts_on_the_arm_as_it_is_built():
    dataset = case('messy_000').select(case('messy_000').postures[:4])
    question, split = (
        Question.of(dataset, dataset.robot, CATALOGUE),
        BuiltPredictor(Predictor(dataset, dataset.robot, CATALOGUE)),
    )
    n, seen = split.robot.cells, []
    members = {'cell_kink': np.full(n, 0.05), 'channel_gain': np.array([0.2, 0.1])}
    fit = question.weigh().base_fit()
    for at in ({}, members):
        session = question.weigh(fit.started_from(at, fit.built.sizes))
        split.around, share = at, session.noise.trial**2 / 5.0 + session.noise.setting**2
        variance = np.zeros_like(dataset.mean)
        for j in range(dataset.inputs.shape[1]):
            sides = []
            for side in (1e-3, -1e-3):
                inputs = dataset.inputs.copy()
                inputs[:, j] *= 1.0 + side
                sides.append(split.markers({}, inputs))
            variance += share * ((sides[0] - sides[1]) / 2e-3) ** 2
        tip = variance[:, -1].sum(axis=1) + 3.0 * session.noise.position**2 / 5.0
        seen.append(session.whitener.variance[:, -1].sum(axis=1))
        np.testing.assert_allclose(seen[-1], tip, rtol=0.02)
    assert np.abs(np.log(np.divide(*seen))).max() > 0.1, 'the arm as built answers otherwise'


SLACK_POSTURES = [
    [0.548, 0.298, 1.013],
    [0.1, 0.1, 0.651],
    [0.182, 0.182, 0.193],
    [0.484, 0.282, 0.679],
    [0.733, 0.165, 0.386],
    [0.1, 0.233, 0.1],
    [0.81, 0.585, 0.174],
    [0.1, 0.1, 0.1],
    [0.332, 0.912, 0.332],
    [0.259, 0.215, 0.235],
]


def test_a_fit_never_rises_where_friction_turns_over(monkeypatch):
    """Kinks decide which way a slack arm bends, and so how friction pulls: no slope tells."""
    robot = load_robot(ROBOTS / 'spatial_3.yaml')
    hidden = {'pre_curvature': {'angle_x': 0.004, 'angle_y': 0.0}}
    plant = make_plant(robot, hidden, seed=103, work=Workmanship())
    dataset = simulate(plant, np.array(SLACK_POSTURES), trials=3, seed=103)
    session = Question.of(dataset, robot, CATALOGUE.sized(natural_sizes(robot))).weigh()
    candidate = next(c for c in session.candidates if c.label == 'pre_curvature')
    places, found, start, go = [], [], None, Fitter.go
    monkeypatch.setattr(Fitter, 'go', lambda self, at: places.append(at) or go(self, at))
    for _ in range(3):
        begun, fitter = len(places), session.fitter
        fit = start = fitter.fit(candidate.frees, start)
        deviances = [place.deviance for place in places[begun:]]
        assert (np.diff(deviances) <= 0.0).all(), deviances
        found.append(fit.values[0])
        split, random = session.arm, fit.built.random
        split.around, sizes = fit.built.around, fit.built.sizes
        white = session.whitener.white(dataset.mean - split.markers(fit.point))
        worth = (
            random.misfit(white, sizes) + random.cost(fit.built.around, sizes) + fit.built.penalty
        )
        assert worth == pytest.approx(deviances[-1], rel=1e-6), 'what it is worth is predicted'
        assert fit.deviance < worth + 1e-6, 'no imperfections are more likely than the best'
        session = session.weigh(fit)
    assert len(places) >= 5, 'some steps were taken'
    np.testing.assert_allclose(found, found[0], atol=3e-4, err_msg='it stays where it was found')


def levels_case(key):
    """Return what a campaign measures in one of its cases, and the arm as it was built."""
    plan = read_plan(PLANS / 'diagnosis_levels.yaml')
    case = next(case for case in plan.cases if case.key == key)
    return plan.setup.simulated(case)


def test_a_soft_cell_is_looked_for_beyond_where_friction_turns_over():
    """On the near side it gains 5 over no effect."""
    setup = replace(read_plan(PLANS / 'diagnosis.yaml').setup, seed=71)
    made = setup.simulated(Case('hinged', 'soft_cell', 0.65, 3))
    session = Question.of(made.fit, made.robot, CATALOGUE).weigh()
    session = session.without_outliers()
    base = session.fitter.over_reversals(session.base_fit())
    found = Patterns(session.fitter, base, reversals=True).soft_cell()
    assert found.deviance < base.deviance - 20.0
    assert abs(found.cell - made.values['cell']) <= 1
    assert found.size == pytest.approx(1.0 / made.values['factor'], rel=0.1)


def test_a_fit_looks_beyond_where_friction_turns_over():
    """One posture lies by a turn of friction: on the near side cells scatter by ten times."""
    made = levels_case('hinged/gravity/0.69461/0/0/0/0.3333/0')
    session = Question.of(made.fit, made.robot, CATALOGUE).weigh()
    session = session.without_outliers()
    frees = next(one.frees for one in session.candidates if one.names == ('gravity',))
    near = session.fitter.fit(frees)
    for _ in range(2):
        session = session.weigh(near)
        near = session.fitter.fit(frees, near)
    fitter = session.fitter
    far = fitter.over_reversals(near)
    assert far.deviance < near.deviance - 20.0
    built = np.sqrt(np.mean(made.built.stiffness**2))
    assert near.built.sizes[0] > 4.0 * built, 'else there is nothing to look for'
    assert far.built.sizes[0] == pytest.approx(built, rel=0.5)
    again = fitter.over_reversals(far)
    assert again.built.sizes[0] == pytest.approx(far.built.sizes[0], rel=0.1), 'the same side'


@pytest.mark.slow  # test_a_fit_looks_beyond_where_friction_turns_over is the same at one place
def test_fits_look_beyond_turns_of_friction_at_the_last_weights_too():
    """There was nothing beyond them at the weights before; the other side is 28 better."""
    setup = replace(read_plan(PLANS / 'diagnosis.yaml').setup, seed=53)
    made = setup.simulated(Case('hinged', 'nonlinear_stiffness', 0.5662455489603104, 0))
    found = diagnose(made.fit, catalogue=CATALOGUE)
    assert found.verdict == 'missing_effect'
    assert [effect.name for effect in found.effects] == ['nonlinear_stiffness']


@pytest.mark.long
def test_what_kinks_would_imitate_is_named():
    """Kinks of five times the usual size predict postures that are left out as well as it does."""
    setup = replace(read_plan(PLANS / 'diagnosis_spatial.yaml').setup, seed=77)
    made = setup.simulated(Case('spatial_3', 'pre_curvature', 1.0, 4))
    (found,) = diagnose(made.fit, catalogue=CATALOGUE).effects
    assert found.name == 'pre_curvature'
    for name, true in made.values.items():
        assert found.parameters[name].low < true < found.parameters[name].high


@pytest.mark.parametrize('name', ['messy_008', 'messy_s0'])
def test_where_friction_does_not_turn_over_a_fit_stays_as_it_is(name):
    dataset = case(name)
    session = Question.of(dataset, dataset.robot, CATALOGUE).weigh()
    fit = session.base_fit()
    found = session.fitter.over_reversals(fit)
    assert found is fit or found.deviance < fit.deviance


def small():
    """Return random effects of two kinds, with a residual drawn from them."""
    random = np.random.default_rng(4)
    split = BuiltPredictor(Predictor(case('messy_000'), case('messy_000').robot, CATALOGUE))
    found = imperfections(split, {})
    columns = random.normal(size=(300, len(found.owners)))
    return RandomEffects(columns, found.owners, found.kinds), random


def test_the_likelihood_is_that_of_the_full_covariance():
    effects, random = small()
    residual = random.normal(size=300)
    sizes = np.array([0.03, 0.002, 0.001, 0.02, 4e-4, 3e-3, 1e-3])
    scaled = effects.columns * sizes[effects.owners]
    full = np.eye(300) + scaled @ scaled.T
    assert effects.log_determinant(sizes) == pytest.approx(np.linalg.slogdet(full)[1])
    white = effects.lift(effects.root(sizes), residual)
    assert white @ white == pytest.approx(residual @ np.linalg.solve(full, residual))


def test_the_sizes_of_imperfections_are_recovered():
    weak, random = small()
    effects = RandomEffects(1e3 * weak.columns, weak.owners, weak.kinds)  # far above the noise
    true = np.where(np.isfinite(effects.plausible), 2.0 * effects.plausible, 0.0)
    found = [
        effects.estimate(
            effects.columns @ (true[effects.owners] * random.normal(size=len(effects.owners)))
            + random.normal(size=300),
            np.zeros((300, 0)),
        ).values
        for _ in range(20)
    ]
    assert np.median(found, axis=0)[0] == pytest.approx(true[0], rel=0.3)


def unexplained(name):
    """Return the random effects of a case, and what the description leaves (N,)."""
    dataset = case(name)
    session = Question.of(dataset, dataset.robot, CATALOGUE).weigh()
    return session.random, session.fitter.residual(session.predictor.markers({}))


@pytest.mark.parametrize('prior', [Prior.SIZES, Prior.NONE])
def test_slopes_of_the_likelihood_are_those_of_its_value_beside_parameters(prior):
    random, residual = unexplained('messy_008')
    beside = np.random.default_rng(2).normal(size=(len(residual), 3))
    work = Likelihood(random, residual, beside, None, prior)
    size = np.where(np.isfinite(random.plausible), random.plausible, 1e-3)
    log = np.log(size**2)

    def slope(log):
        return work.slopes(np.exp(log)).gradient * np.exp(log)

    moves = 1e-4 * np.eye(len(log))
    value = [work.deviance(np.exp(log + d)) - work.deviance(np.exp(log - d)) for d in moves]
    np.testing.assert_allclose(slope(log), np.array(value) / 2e-4, rtol=1e-5, atol=1e-4)
    bend = [(slope(log + d) - slope(log - d)) / 2e-4 for d in moves]
    here = work.slopes(size**2)
    found = here.curvature * np.outer(size**2, size**2) + np.diag(slope(log))
    np.testing.assert_allclose(found, bend, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize('name', ['messy_008', 'messy_s0', 'messy_000'])
def test_the_likeliest_sizes_are_found_whatever_is_missing(name):
    """What scatter cannot explain bends the likelihood: a search may give up on its way."""
    random, residual = unexplained(name)
    nothing = np.zeros((len(residual), 0))
    found = random.estimate(residual, nothing)
    for share in (0.5, 1.0, 2.0):
        other = random.estimate(residual, nothing, share * found.values)
        assert other.deviance > found.deviance - 0.05
    work = Likelihood(random, residual, nothing, None)
    moved = np.abs(work.slopes(found.values**2).gradient * found.values**2)
    assert moved[~random.few].max() < 0.2


def test_readings_that_the_other_trials_contradict_are_found_and_no_others():
    dataset = case('messy_000')
    positions = dataset.positions.copy()
    positions[4, 2, 7] += [0.0, 3e-3, 0.0]
    positions[8, 1] = dataset.positions[8, 1] * 1.2  # a trial that slipped
    changed = replace(dataset, positions=positions)
    found = find_outliers(Predictor(changed, changed.robot, CATALOGUE), {})
    assert found.readings[4, 2, 7]
    assert np.argwhere(found.trials).tolist() == [[8, 1]]
    assert found.readings.sum() < 12
    assert np.isnan(found.without(changed).positions[8, 1]).all()


def test_a_tip_that_three_inputs_may_move_anywhere_has_no_outliers():
    """Only where fewer pull is anything left of the noise: that is no outlier."""
    robot = load_robot(ROBOTS / 'spatial_3.yaml')
    tip = (Marker('tip', robot.length),)
    for seed in range(3):
        plant = make_plant(robot, seed=seed, scatter=0.0)
        dataset = simulate(plant, default_postures(robot, 12), seed=seed, markers=tip)
        assert not find_outliers(Predictor(dataset, robot, CATALOGUE), {}).readings.any()
