"""Intervals of an improved description: what imperfections of an arm may do to them counts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.comparison.noise import Noise, Whitener
from tendon_robot_ros.comparison.predict import free_parameters
from tendon_robot_ros.diagnosis.as_built import Imperfections, Kind
from tendon_robot_ros.diagnosis.described_arm import blocks_of_the_arm
from tendon_robot_ros.diagnosis.fit import Fit, covariance_of
from tendon_robot_ros.diagnosis.improved_values import as_known, covariance_as_built

ROBOT = simulated.robot()


@pytest.fixture(scope='module')
def linear():
    """Return a linear world: weights of a search and of the noise, slopes, an imperfection."""
    rng = np.random.default_rng(0)
    dataset = simulated.postures(ROBOT, rng.uniform(0.1, 1.0, (6, len(ROBOT.inputs))), trials=1)
    P, J = len(dataset.postures), len(dataset.markers)
    noise, slopes = Noise(1e-3, 0.0, 0.0, np.inf, 'declared'), np.zeros((P, 2, J, 3))
    plain = Whitener(dataset, noise, slopes)
    moves = rng.normal(size=(2, P, J, 3))
    shift = 0.3 * moves[:1] + rng.normal(size=(1, P, J, 3))
    remainder = np.zeros((1, P, J, 3))
    remainder[0, 0, 0, 0] = 1e-9  # as good as none
    kinds = (Kind('channel_gain', '1', 5e-3, ('x',)), Kind('remainder', 'm', np.inf, ('0',)))
    found = Imperfections(kinds, np.concatenate([shift, remainder]))
    return SimpleNamespace(
        rng=rng, dataset=dataset, plain=plain, moves=moves, shift=shift, found=found,
        search=Whitener(dataset, noise, slopes, 3e-3, 1e-3),
    )  # fmt: skip


def fitted(world, off, spread):
    """Return the fit of two parameters with priors, by the weights of a search."""
    frees = free_parameters(CATALOGUE['pre_curvature'], ROBOT)[:2]
    jacobian = np.vstack([-world.search.white(world.moves).T, np.diag(1.0 / spread)])
    residual = np.append(world.search.white(off), np.zeros(2))
    values = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    markers = np.tensordot(values, world.moves, 1)
    left = residual + jacobian @ values
    return Fit(frees, (), values, left, jacobian, markers)


def test_the_covariance_is_that_of_many_arms_with_noise_and_imperfections(linear):
    world, spread = linear, np.full(2, 10.0)
    found, shape = [], world.dataset.mean.shape
    for _ in range(1500):
        arm = 5e-3 * world.rng.normal() * world.shift[0]
        found.append(fitted(world, arm + 1e-3 * world.rng.normal(size=shape), spread).values)
    off = 5e-3 * world.shift[0] + 1e-3 * world.rng.normal(size=shape)
    one = fitted(world, off, spread)
    said = covariance_as_built(one, world.search, world.plain, off, world.found)
    np.testing.assert_allclose(said, np.cov(np.array(found).T), rtol=0.15, atol=5e-8)
    without = covariance_of(one.jacobian)
    assert said[0, 0] > 2.0 * without[0, 0], 'the search alone knows nothing of it'


def test_without_imperfections_it_is_that_of_noise_through_the_weights(linear):
    world, spread = linear, np.full(2, 10.0)
    none = replace(world.found, moves=1e-9 * world.found.moves)
    off = 1e-3 * world.rng.normal(size=world.dataset.mean.shape)
    same = SimpleNamespace(**{**vars(world), 'search': world.plain})
    one = fitted(same, off, spread)
    said = covariance_as_built(one, world.plain, world.plain, off, none)
    left = max(1.0, one.chi2 / (world.plain.size - 2))
    np.testing.assert_allclose(said, left * covariance_of(one.jacobian), rtol=1e-3)


def test_what_a_parameter_stands_for_is_no_imperfection_beside_it(linear):
    world = linear
    kinds = (replace(world.found.kinds[0], name='position'), world.found.kinds[1])
    found = replace(world.found, kinds=kinds)
    off = 1e-3 * world.rng.normal(size=world.dataset.mean.shape)
    one = fitted(world, off, np.full(2, 10.0))
    frame = free_parameters(CATALOGUE['base_misalignment'], ROBOT)[:2]
    said = [
        covariance_as_built(fit, world.search, world.plain, off, found)[0, 0]
        for fit in (one, replace(one, frees=frame))
    ]
    assert said[0] > 2.0 * said[1]


def test_what_the_arm_itself_may_do_counts_for_the_values_of_effects():
    """Stiffness along the arm trades with an effect: the interval is as wide as both together."""
    dataset = measured(replace(ROBOT, exact=True), count=4)
    profile = next(blocks_of_the_arm(ROBOT))
    lever = free_parameters(CATALOGUE['hinge_friction'], ROBOT)
    jacobian = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.1, 1.0]])
    frees = (*lever, *profile.frees[:2])
    fit = Fit(frees, (), np.array([1e-4, 0.0, 0.0]), np.zeros(3), jacobian, dataset.mean)
    known = as_known(None, SimpleNamespace(fit=fit), None, None)
    assert known.frees == lever and known.values == [1e-4]
    assert known.covariance[0, 0] == pytest.approx(np.linalg.inv(jacobian.T @ jacobian)[0, 0])
