"""Cells that twist: closed forms, symmetries, conservation, and exact rods."""

from dataclasses import replace

import numpy as np
import pytest
from arms import planar, section, spatial, turned, wound
from reference import Reference
from scipy.optimize import brentq

from tendon_robot_ros.common.rotations import about, turned_in_plane
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Robot, Tendon
from tendon_robot_ros.robot.description import helix_angles

K, L, R = 0.05, 0.01, 0.006
TORSION = {'torsion': {'compliance': 1.3}}


def around(cells=8, helix=0.0, effects=None, count=3):
    """Return an arm with tendons evenly around it, which wind about it [rad/m]."""
    tendons = []
    for angle in 2.0 * np.pi * np.arange(count) / count:
        at = (float(R * np.cos(angle)), float(R * np.sin(angle)))
        tendons.append(Tendon(f't{len(tendons)}', at, at, 'only', helix=helix))
    return Robot(
        'around', (section('only', cells, L, K),), tuple(tendons), (0.0, 9.0), effects or {}
    )


def weighing(cells, weight, beside):
    """Return an arm held level whose weight [N] lies beside the axis [m], all in its last cell."""
    robot = around(cells, effects=TORSION | {'gravity': {'linear_density': 1.0}})
    last = replace(
        robot.sections[0],
        mass_profile=(1e-12,) * (cells - 1) + (weight / (9.81 * L),),
        mass_offset=((0.0, 0.0),) * (cells - 1) + ((0.0, beside),),
    )
    return Model(replace(robot, sections=(last,), gravity=(9.81, 0.0, 0.0)))


def test_a_moment_about_the_axis_twists_a_straight_rod_by_the_moment_over_its_stiffness():
    """A weight beside the axis at the tip: M L / GJ, half in the cell in whose middle it is."""
    weight, beside, cells = 1e-6, 0.02, 8
    shape = weighing(cells, weight, beside).shape([0.0] * 3)
    expected = -1.3 * weight * beside / K * np.array([1.0] * (cells - 1) + [0.5])
    assert np.allclose(shape.twist, expected, rtol=1e-6)
    # the frames carry it: about z, from base to tip
    turn = np.arctan2(shape.frames[:, 1, 0], shape.frames[:, 0, 0])
    assert np.allclose(turn, np.cumsum(expected), rtol=1e-6)


@pytest.mark.parametrize('straight', [0.0, 1.0])
def test_tendons_that_wind_unwind_a_straight_arm(straight):
    """K phi / compliance = -sum T r² sin(helix + phi) / chord, and no bend."""
    helix, tension = 15.0, 4.0
    effects = TORSION | {'straight_tendon': {'fraction': straight}}
    shape = Model(around(8, helix, effects)).shape([tension] * 3)

    def balance(twist):
        across = 2.0 * R * np.sin(0.5 * (helix * L + twist))
        return K * twist / 1.3 + 3.0 * tension * R**2 * np.sin(helix * L + twist) / np.hypot(
            L, across
        )

    assert np.allclose(shape.twist, brentq(balance, -helix * L, 0.0, xtol=1e-15), rtol=1e-9)
    assert np.allclose(shape.bend, 0.0, atol=1e-12)
    assert np.allclose(shape.tip_position, [0.0, 0.0, 8 * L], atol=1e-12)


def test_tendons_along_the_arm_stiffen_it_in_twist():
    """A small moment about the axis: phi = M / (K / compliance + sum T r² / L)."""
    weight, beside, tension = 1e-6, 0.02, 5.0
    stiffness = K / 1.3 + 3.0 * tension * R**2 / L
    twist = weighing(1, weight, beside).shape([tension] * 3).twist[0]
    assert twist == pytest.approx(-0.5 * weight * beside / stiffness, rel=1e-6)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_a_planar_arm_under_a_planar_load_does_not_twist(bends_as):
    effects = {
        'tendon_friction': {'friction_coefficient': 0.3},
        'straight_tendon': {'fraction': 1.0},
        'tip_load': {'force_x': 0.02, 'force_y': 0.0, 'force_z': -0.03},
        'gravity': {'linear_density': 0.3},
    }
    robot = replace(planar(8, effects, bends_as), gravity=(3.0, 0.0, -9.0))
    flat, twisting = (
        Model(replace(robot, effects=effects | more)).shape([0.3, 1.2]) for more in ({}, TORSION)
    )
    assert np.array_equal(twisting.twist, np.zeros(8))
    assert np.allclose(twisting.bend, flat.bend, rtol=0, atol=1e-9)
    assert np.allclose(twisting.pulls, flat.pulls, rtol=0, atol=1e-11)


def test_without_a_load_tendons_along_the_arm_do_not_twist_it():
    robot = spatial(4, {'straight_tendon': {'fraction': 1.0}, **TORSION})
    shape = Model(robot).shape([0.3, 0.0, 1.1, 0.5, 0.0, 0.2])
    assert np.abs(shape.twist).max() < 1e-12 < 1e-2 < np.abs(shape.bend).max()


def test_an_arm_that_is_stiff_in_twist_is_the_limit_of_softer_ones():
    load = {'tip_load': {'force_x': 0.05, 'force_y': 0.02, 'force_z': -0.03}}
    inputs = [0.3, 0.0, 1.1, 0.5, 0.0, 0.2]
    tips = [
        Model(wound(spatial(4, load | {'torsion': {'compliance': c}}))).shape(inputs).tip_position
        for c in (0.0, 1e-7, 1e-3)
    ]
    assert 1e-6 < 1e3 * np.linalg.norm(tips[2] - tips[0]) < 1.0
    assert np.linalg.norm(tips[1] - tips[0]) < 2e-4 * np.linalg.norm(tips[2] - tips[0])


def test_a_wound_arm_turned_about_z_moves_the_same_way():
    effects = TORSION | {'straight_tendon': {'fraction': 1.0}, 'gravity': {'linear_density': 0.3}}
    robot = replace(wound(spatial(3, effects), beside=(0.0, 0.0)), gravity=(2.0, 1.0, 9.0))
    on_axis = tuple(replace(s, mass_offset=()) for s in robot.sections)
    robot, angle = replace(robot, sections=on_axis), 1.1
    turn = about(2, angle)
    for row in ([0.3, 0.0, 1.1, 0.5, 0.0, 0.2], [0.0, 1.3, 0.2, 0.0, 0.9, 0.4]):
        one, other = Model(robot).shape(row), Model(turned(robot, angle)).shape(row)
        assert np.allclose(other.positions, one.positions @ turn.T, rtol=0, atol=1e-10)
        assert np.allclose(other.twist, one.twist, rtol=0, atol=1e-9)
        assert np.allclose(other.pulls, one.pulls, rtol=0, atol=1e-11)


def test_pulling_the_wires_does_the_work_that_the_arm_stores():
    """The integral of T d(pull) is the elastic energy plus that of the load."""
    effects = TORSION | {
        'straight_tendon': {'fraction': 1.0},
        'tip_load': {'force_x': 0.05, 'force_y': -0.08, 'force_z': 0.03},
    }
    robot = wound(spatial(3, effects, 'arc'))
    model, reference = Model(robot), Reference(robot)
    share = np.linspace(0.0, 1.0, 201)[:, None]
    shapes = model.shapes(share * [0.9, 0.1, 1.6, 1.2, 0.3, 0.4])
    mean = 0.5 * (shapes.inputs[1:] + shapes.inputs[:-1])
    work = (mean * np.diff(shapes.pulls, axis=0)).sum()

    def energy(b):
        stiffness, cells = np.array(reference.stiffness), reference.cells(shapes.state[b])
        stored = 0.5 * (stiffness[:, None] * cells[:, :2] ** 2).sum()
        stored += 0.5 * (stiffness * cells[:, 2] ** 2).sum() / 1.3
        still = np.zeros((robot.cells, 3))
        return stored + reference.energy(shapes.state[b], shapes.tendon_tensions[b], still)

    assert work == pytest.approx(energy(-1) - energy(0), rel=2e-5)
    assert np.abs(shapes.twist[-1]).max() > 0.01


def test_an_offset_per_cell_is_the_same_as_one_that_winds():
    robot = around(6, 12.0, TORSION | {'straight_tendon': {'fraction': 1.0}})
    places = (np.arange(6) + 0.5) * L * 12.0
    tendons = []
    for tendon in robot.tendons:
        listed = tuple(map(tuple, turned_in_plane(np.array([tendon.base]), places).tolist()))
        tendons.append(replace(tendon, helix=0.0, offsets=listed))
    listed = replace(robot, tendons=tuple(tendons))
    one, other = (Model(r).shape([0.5, 2.0, 0.1]) for r in (robot, listed))
    assert np.allclose(one.positions, other.positions, rtol=0, atol=1e-12)
    assert np.allclose(one.twist, other.twist, rtol=0, atol=1e-12)


def test_a_straight_tendon_that_crosses_the_axis_does_not_wind():
    base, end = (0.004, 0.003), (-0.004, -0.003)
    listed = np.linspace(base, end, 9)
    middles = tuple(map(tuple, (0.5 * (listed[1:] + listed[:-1])).tolist()))
    crossing = Tendon('crossing', base, end, 'only')
    both = (crossing, replace(crossing, offsets=middles))
    ends = Tendon('ends', base, (0.0, 0.0), 'only', offsets=(base,) * 7 + ((0.0, 0.0),))
    robot = replace(around(8), tendons=(*both, ends))
    assert not helix_angles(robot).any()
    bends = [Model(replace(robot, tendons=(one,))).shape([2.0]) for one in both]
    assert np.allclose(bends[0].bend, bends[1].bend, rtol=0, atol=1e-12)
    assert np.allclose(bends[0].pulls, bends[1].pulls, rtol=0, atol=1e-12)
