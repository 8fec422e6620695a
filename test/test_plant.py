"""A plant is another robot than the model of its owner, by as much as it should be."""

from dataclasses import replace

import numpy as np
import pytest
from arms import planar, spatial, two_sections, wound
from source_tree import ROOT

from tendon_robot_ros.common.errors import EffectError, InputError
from tendon_robot_ros.drivers.mock import MockDriver
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Section, load_robot
from tendon_robot_ros.robot.description import tendon_offsets
from tendon_robot_ros.simulation.hidden import CAUSES, Built, Workmanship
from tendon_robot_ros.simulation.plant import make_plant

ARCS, HINGES = 'kato_10_1', 'spatial_3'
TENSIONS = {
    ARCS: [[0.6, 0.1, 0.1, 0.4], [1.2, 0.3, 0.2, 0.9], [0.1, 0.1, 0.8, 0.1]],
    HINGES: [[0.8, 0.1, 0.1], [0.1, 1.0, 0.3], [0.6, 0.2, 0.9]],
}


def robot(name, **changed):
    return replace(load_robot(ROOT / 'config' / 'robots' / f'{name}.yaml'), **changed)


def largest(a, b):
    return np.linalg.norm(a - b, axis=-1).max()


@pytest.mark.parametrize('name', [ARCS, HINGES])
def test_without_scatter_and_secrets_it_is_nearly_the_owners_model(name):
    tensions = TENSIONS[name]
    own, real = Model(robot(name)), make_plant(robot(name), scatter=0.0)
    assert 0.0 < largest(real.shapes(tensions).positions, own.shapes(tensions).positions) < 2e-4
    assert real.parts == (3 if name == ARCS else 1)


def test_finer_cells_change_nothing_that_the_cells_do_not_decide():
    plain = robot(ARCS, effects={})
    tensions = TENSIONS[ARCS]
    fine = make_plant(plain, scatter=0.0, refine=4).shapes(tensions)
    coarse = Model(plain).shapes(tensions)
    np.testing.assert_allclose(fine.positions, coarse.positions, atol=1e-12)
    np.testing.assert_allclose(fine.bend, coarse.bend, atol=1e-12)
    np.testing.assert_allclose(fine.pulls, coarse.pulls, atol=1e-14)
    np.testing.assert_allclose(fine.cell_length.sum(), plain.length)


def test_finer_cells_twist_as_the_whole_ones_do():
    """Tendons that wind, by their rate or cell by cell, and weight beside the axis."""
    base = robot('spatial_6', gravity=(0.0, 4.0, 9.0))
    sections = tuple(
        replace(s, bends_as='arc', mass_offset=((0.0, 0.002),) * s.cells) for s in base.sections
    )
    effects = {'torsion': {'compliance': (1.3, 0.8)}, 'gravity': {'linear_density': 0.1}}
    wound = tuple(replace(t, helix=8.0) for t in base.tendons)
    whole = replace(base, sections=sections, tendons=wound, effects=effects)
    by_cell = tuple(
        replace(t, helix=0.0, offsets=tuple(map(tuple, at[:cells].tolist())))
        for t, at, cells in zip(
            wound, tendon_offsets(whole).swapaxes(0, 1), whole.tendon_cells, strict=True
        )
    )
    tensions = [[0.8, 0.1, 0.1, 0.3, 0.9, 0.1]]
    for plain in (whole, replace(whole, tendons=by_cell)):
        fine = make_plant(plain, scatter=0.0, refine=3)
        assert fine.parts == 3
        near, own = fine.shapes(tensions), Model(plain).shapes(tensions)
        assert np.abs(own.twist).max() > 3e-3
        assert largest(near.positions, own.positions) < 1e-4
        assert largest(near.positions, Model(base).shapes(tensions).positions) > 3e-3
        np.testing.assert_allclose(near.twist, own.twist, atol=1e-3)


@pytest.mark.parametrize('effect', ['tendon_stiffness', 'nonlinear_stiffness', 'pre_curvature'])
def test_what_counts_per_cell_is_shared_out_to_the_finer_ones(effect):
    plain = robot(ARCS, effects={})
    hidden = {effect: {}}
    fine = make_plant(plain, hidden, scatter=0.0, refine=3)
    coarse = make_plant(plain, hidden, scatter=0.0, refine=1)
    tensions = TENSIONS[ARCS]
    assert fine.model.robot.cells == 90
    assert coarse.model.robot.cells == 30
    near = fine.shapes(tensions).positions
    np.testing.assert_allclose(near, coarse.shapes(tensions).positions, atol=1e-9)
    assert largest(near, Model(plain).shapes(tensions).positions) > 1e-3


def test_the_arm_keeps_its_weight():
    heavy = {'gravity': {'linear_density': 0.01}}
    hanging = robot(ARCS, effects={}, gravity=(9.81, 0.0, 0.0))
    fine = make_plant(hanging, heavy, scatter=0.0).shapes([[0.0] * 4]).positions
    own = Model(hanging.with_effect('gravity', heavy['gravity'])).shapes([[0.0] * 4]).positions
    assert own[0, -1, 0] > 5e-3
    assert largest(fine, own) < 1e-4


def test_friction_at_the_owners_eyelets_is_the_capstans():
    alone = robot(ARCS)
    batch = make_plant(alone, scatter=0.0).shapes([[0.7, 0.0, 0.0, 0.0]])
    passed = batch.tendon_tensions[0, 1:15, 0] / batch.tendon_tensions[0, :14, 0]
    np.testing.assert_allclose(passed, np.exp(-0.33 * np.abs(batch.bend[0, :14, 0])), rtol=1e-12)
    quotient = make_plant(alone, scatter=0.0, capstan=False).shapes([[0.7, 0.0, 0.0, 0.0]])
    own = Model(alone).shapes([[0.7, 0.0, 0.0, 0.0]])
    assert largest(quotient.positions, own.positions) < 2e-6


def test_the_stiffness_scatters_as_much_as_it_was_told():
    real = make_plant(robot('kato_1_1'), scatter=0.1, refine=2, seed=3).model.robot
    stiffness = np.array([s.bending_stiffness[0] for s in real.sections]).reshape(-1, 2)
    assert (stiffness[:, 0] == stiffness[:, 1]).all()
    assert np.std(stiffness[:, 0] / 0.04) == pytest.approx(0.1, rel=0.3)
    again = make_plant(robot('kato_1_1'), scatter=0.1, refine=2, seed=3).model.robot
    assert again == real


def test_hidden_values_replace_those_of_the_owner():
    slippery = robot(ARCS).with_effect('tendon_friction', {'friction_coefficient': 0.1})
    hidden = {'tendon_friction': {'friction_coefficient': 0.33}}
    real = make_plant(slippery, hidden, scatter=0.0).shapes(TENSIONS[ARCS])
    assert largest(real.positions, Model(robot(ARCS)).shapes(TENSIONS[ARCS]).positions) < 2e-4


def test_what_tendons_have_one_each_is_theirs_in_finer_cells_too():
    arm = robot(ARCS)
    zeros = tuple((1e-3 * np.arange(1.0, len(arm.tendons) + 1.0)).tolist())
    tensions = np.full(len(arm.inputs), 0.2)
    plain, shifted = (
        make_plant(arm, hidden, scatter=0.0).respond(tensions).pulls
        for hidden in ({}, {'pull_zero': {'offset': zeros}})
    )
    assert plain - shifted == pytest.approx(zeros, abs=1e-9)


def test_a_soft_cell_bends_in_proportion_and_the_others_do_not():
    plain, tensions = robot(ARCS, effects={}), TENSIONS[ARCS]
    soft = {'soft_cell': {'cell': 12, 'factor': 0.5}}
    bend = make_plant(plain, soft, scatter=0.0).shapes(tensions).bend
    ratio = bend[..., 0] / Model(plain).shapes(tensions).bend[..., 0]
    np.testing.assert_allclose(ratio[:, 11], 2.0, rtol=1e-9)
    np.testing.assert_allclose(np.delete(ratio, 11, axis=1), 1.0, rtol=1e-9)


def test_the_cells_of_what_is_hidden_count_beyond_the_base_plate():
    plain = robot(ARCS, effects={})
    plate = Section('plate', 1, 1e-5, (1e3,), (1.0,), 'arc')
    arm = replace(plain, sections=(plate, *plain.sections))
    real = make_plant(arm, {'soft_cell': {'cell': 12, 'factor': 0.5}}, scatter=0.0)
    assert np.flatnonzero(real.damage.stiffness != 1.0) == [12]
    assert arm.cell_names[12] == 'cell 12'
    real.built.stiffness[12] = 0.3
    assert 'most cell 12: +30 %' in real.built.text(arm)[0]
    with pytest.raises(EffectError, match=r'from 1 \(base\) to 30, got 31'):
        make_plant(arm, {'soft_cell': {'cell': 31}})


def test_a_force_bends_the_arm_up_to_its_place():
    plain = robot(ARCS, effects={})
    place = 9.5 * plain.length / 30  # in the middle of the tenth cell
    held = {
        'point_load': {'arc_length': place, 'force_x': 1e-4}
    }  # so little that bends stay small
    bend = make_plant(plain, held, scatter=0.0, refine=1).shapes([[0.0] * 4]).bend[0, :, 0]
    length, stiffness = plain.length / 30, 0.027
    lever = np.maximum(9.5 - np.arange(30) - 0.5, 0.0) * length
    np.testing.assert_allclose(bend[:9], 1e-4 * lever[:9] / stiffness, rtol=1e-3)
    assert not bend[10:].any()


def test_gain_and_rotation_go_with_the_posture_and_stay_in_their_size():
    plain = robot(ARCS, effects={})
    tensions = np.column_stack([np.linspace(0.1, 1.0, 40)] + [np.zeros(40)] * 3)
    real = make_plant(plain, {'posture_gain': {'size': 0.1}}, scatter=0.0)
    gain = real.shapes(tensions).bend[:, 0, 0] / Model(plain).shapes(tensions).bend[:, 0, 0]
    assert 0.06 < np.abs(gain - 1.0).max() < 0.1
    np.testing.assert_allclose(
        real.shapes(tensions[7:8]).bend[0, 0, 0],
        gain[7] * (Model(plain).shapes(tensions[7:8]).bend[0, 0, 0]),
    )
    assert real.respond(tensions[7]).inputs == pytest.approx(tensions[7])
    turned = make_plant(plain, {'posture_rotation': {'size': 0.05}}, scatter=0.0)
    seen = turned.markers(
        np.zeros((5, 4)) + tensions[:5], np.array([plain.length]), np.zeros((1, 3))
    )
    true = turned.shapes(tensions[:5]).tip_position
    np.testing.assert_allclose(np.linalg.norm(seen[:, 0], axis=1), np.linalg.norm(true, axis=1))
    assert 1e-4 < largest(seen[:, 0], true) < 0.05 * 1.5 * plain.length
    pulls = np.array([0.003, -0.003, 0.002, -0.002])
    tip = np.array([plain.length]), np.zeros((1, 3))
    recorded = turned.markers(pulls[None], *tip, displacement=True)[0]
    live = turned.respond_to_pulls(pulls).markers(*tip)
    np.testing.assert_allclose(live, recorded, atol=1e-7)


def test_every_cause_shows_at_its_usual_size():
    tensions = TENSIONS[HINGES]
    arm = robot(HINGES)
    tip = np.array([arm.length])
    clean = make_plant(arm, scatter=0.0).markers(tensions, tip, np.zeros((1, 3)))
    for name in CAUSES:
        real = make_plant(arm, {name: None}, scatter=0.0)
        seen = real.markers(tensions, tip, np.zeros((1, 3)))
        assert 5e-4 < largest(seen, clean) < 0.04, name


def test_the_tracker_sees_a_misaligned_base():
    hidden = {'base_misalignment': {'shift_z': 0.002}}
    real = make_plant(robot(HINGES), hidden, scatter=0.0)
    seen = real.markers(TENSIONS[HINGES], np.array([0.06]), np.zeros((1, 3)))
    there = real.shapes(TENSIONS[HINGES]).positions[:, 9:10]
    np.testing.assert_allclose(seen - there, [[[0.0, 0.0, 0.002]]] * 3, atol=1e-12)
    arm = real.respond(TENSIONS[HINGES][0])
    live = arm.markers(np.array([0.06]), np.zeros((1, 3)))
    np.testing.assert_allclose(live - arm.positions[9], [[0.0, 0.0, 0.002]], atol=1e-12)


def test_a_mock_driver_moves_it():
    real = make_plant(robot(HINGES))
    with MockDriver(real.robot, real) as driver:
        driver.enable()
        driver.write(np.array([0.5, 0.1, 0.1]))
        assert np.isfinite(driver.read().pulls).all()
    pulled = real.respond_to_pulls([0.002, np.nan, np.nan])
    assert pulled.pulls[0] == pytest.approx(0.002, abs=1e-7)
    slack = real.shapes([[0.002, np.nan, np.nan]], displacement=True)
    assert slack.tip_position[0] == pytest.approx(pulled.positions[-1], abs=1e-6)


def test_friction_remembers_from_call_to_call():
    arm = robot(HINGES).with_effect('friction_memory', {'presliding_length': 1e-4})
    real = make_plant(arm)
    rows = [[1.0, 0.1, 0.1], [0.3, 0.1, 0.1]]
    one_by_one = [real.respond(row).positions for row in rows]
    np.testing.assert_allclose(one_by_one, real.shapes(rows, sequence=True).positions, atol=1e-9)
    assert largest(one_by_one[1], make_plant(arm).shapes(rows[1:]).positions[0]) > 1e-4


@pytest.mark.parametrize('arm', [two_sections(4), spatial(4)], ids=['planar', 'spatial'])
@pytest.mark.parametrize(
    'hidden',
    [
        {'bending_hysteresis': {'lag': 0.03, 'presliding': 2.0}},
        {
            'tendon_friction': {'friction_coefficient': 0.3},
            'friction_memory': {'presliding_length': 1e-4},
        },
    ],
    ids=lambda hidden: next(iter(hidden)),
)
def test_pulls_from_both_sides_leave_it_where_the_model_with_memory_says(arm, hidden):
    arm = arm.with_effect('wire_spring', {'compliance': 2e-3})
    real = make_plant(arm, hidden, refine=1, scatter=0.0, capstan=False)
    model = Model(replace(arm, effects=arm.effects | hidden))
    low, middle, high = np.outer([1e-3, 3e-3, 5e-3], [1.0, np.nan] + [0.4] * (len(arm.inputs) - 2))
    tips = []
    for side in (low, high):
        real.forget()
        last = None
        for pulls in (side, middle):
            last = model.follow_pulls(last, pulls)
            there = real.respond_to_pulls(pulls)
        np.testing.assert_allclose(there.positions, last.positions, rtol=0, atol=1e-6)
        tips.append(there.tip_position)
    assert largest(*tips) > 1e-5


@pytest.mark.parametrize(
    ('hidden', 'message'),
    [
        ({'magic': {}}, "unknown hidden effect 'magic'; in the catalogue: tendon_friction, "),
        ({'soft_cell': {'celll': 3}}, "soft_cell: expected one of cell, factor, got 'celll'"),
        ({'soft_cell': {'cell': 31}}, 'cell: expected a whole number from 1 (base) to 30, got 31'),
        ({'soft_cell': {'cell': np.nan}}, 'expected a whole number from 1 (base) to 30, got nan'),
        ({'soft_cell': {'factor': 0.0}}, 'soft_cell: expected a size that leaves stiffness and'),
        ({'stiffness_gradient': {'relative_change': -2.0}}, 'stiffness_gradient: expected a size'),
        ({'posture_gain': {'size': 1.0}}, 'posture_gain: expected a size that leaves'),
        (
            {'tip_load': {'force': 1}},
            'tip_load: expected one of force_x, force_y, force_z, moment_x',
        ),
        (
            {'hinge_friction': {'lever': -1.0}},
            'hinge_friction: lever: expected a number from 0 to 0.00275 [m], got -1',
        ),
        ({'hinge_friction': {'lever': 'big'}}, 'hinge_friction: lever: expected one number, got'),
        (
            {'section_stiffness': {'relative_change': [0.1]}},
            'section_stiffness: relative_change: expected 2 numbers, one per section, got 1',
        ),
    ],
)
def test_what_cannot_be_hidden_is_refused(hidden, message):
    with pytest.raises(EffectError) as refusal:
        make_plant(robot(ARCS), hidden)
    assert message in str(refusal.value)


def test_tendons_may_end_on_the_axis():
    plain = robot(ARCS, effects={})
    tendons = tuple(replace(tendon, end=(0.0, 0.0)) for tendon in plain.tendons)
    tapered, tensions = replace(plain, tendons=tendons), TENSIONS[ARCS]
    bends = make_plant(tapered, scatter=0.0, refine=1).shapes(tensions).bend
    np.testing.assert_allclose(bends, Model(tapered).shapes(tensions).bend, atol=1e-12)


def test_senseless_plants_are_refused():
    with pytest.raises(InputError, match='refine: expected a whole number from 1 on, got 0'):
        make_plant(robot(ARCS), refine=0)


def test_a_planar_arm_is_kinked_in_its_plane_and_one_whose_tendons_wind_in_every_direction():
    flat, winds = (Built.draw(one, Workmanship(), 3).kink for one in (planar(), wound(planar())))
    assert flat[:, 0].all() and not flat[:, 1].any()
    assert winds.all()
