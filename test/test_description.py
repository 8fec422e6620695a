"""What a fit found of wires is written so that the description pulls as they do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from arms import planar, spatial

from tendon_robot_ros.inference.description import with_members, wound
from tendon_robot_ros.inference.imperfections import GAIN, ZERO
from tendon_robot_ros.model.model import Model

SPRINGS = {'wire_spring': {'compliance': 1e-3}}


def test_gains_and_zeros_of_pulls_are_written_as_what_is_wound():
    robot = planar(5, SPRINGS | {'pull_zero': {'offset': 1e-3}})
    gain, zero = np.array([0.05, -0.02]), np.array([3e-4, -2e-4])
    written = wound(robot, {GAIN: gain, ZERO: zero})
    for pulls in ([-2e-3, 2e-3], [3e-3, -1e-3]):
        expected = Model(robot).pull_shape((1.0 + gain) * pulls + zero)
        found = Model(written).pull_shape(pulls)
        assert np.allclose(found.positions, expected.positions, rtol=0, atol=1e-8)
    twice = wound(written, {GAIN: gain, ZERO: zero})
    pulls = np.array([-2e-3, 2e-3])
    expected = Model(written).pull_shape((1.0 + gain) * pulls + zero)
    found = Model(twice).pull_shape(pulls)
    assert np.allclose(found.positions, expected.positions, rtol=0, atol=1e-8)


def test_what_was_not_found_is_not_written():
    robot = spatial(3, SPRINGS)
    assert wound(robot, {}) == robot
    zeros = {GAIN: np.zeros(6), ZERO: np.zeros(6)}
    assert wound(robot, zeros) == robot


def test_gains_of_tensions_are_written_to_tendons_whose_route_is_given_cell_by_cell():
    plain = replace(planar(), gravity=(0.0, 0.0, 0.0))
    routes = [tuple((x * share, 0.0) for share in np.linspace(1.0, 0.7, 6)) for x in (5e-3, -5e-3)]
    tendons = [
        replace(t, base=own[0], end=own[-1], offsets=own)
        for t, own in zip(plain.tendons, routes, strict=True)
    ]
    robot, gain = replace(plain, tendons=tuple(tendons)), np.array([0.05, -0.03])
    found = SimpleNamespace(as_built=True, members={GAIN: gain})
    inputs = np.array([[2.0, 0.1], [0.2, 1.5]])
    shown = Model(with_members(robot, found, 'tension')).shapes(inputs).positions
    np.testing.assert_allclose(
        shown, Model(robot).shapes(inputs * (1.0 + gain)).positions, atol=1e-7
    )
