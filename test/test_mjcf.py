"""The export for MuJoCo: at rest under tensions it has the model's shape without friction."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arms import TYPICAL, made, planar, section, spatial, two_sections
from source_tree import ROOT

from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.mjcf import Laws, mjcf, unsaid
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Tendon, load_robot

STRAIGHT = {'straight_tendon': {'fraction': 1.0}}
DOWN = (3.0, -4.0, -8.0)  # [m/s²]
FOUND = (  # what a diagnosis adds
    *('backbone_stiffness', 'section_stiffness', 'tendon_stiffness', 'pre_curvature'),
    *('moment_arm', 'transmission_loss', 'tension_offset', 'gravity', 'tip_load'),
)


def chain_of_three(bends_as='hinge', tendons=3):
    """Return three sections with tendons all around, or in one plane."""
    names = ('near', 'middle', 'far')
    angles = np.arange(tendons) * 2.0 * np.pi / tendons
    places = [(0.006 * float(np.cos(a)), 0.006 * float(np.sin(a))) for a in angles]
    sections = tuple(section(name, 6, 0.006, 0.04, bends_as) for name in names)
    wires = [(f'{name}_{j}', at, name) for name in names for j, at in enumerate(places)]
    return made('three', sections, wires, {})


def settled(text, robot, tensions):
    """Return where the cells end (n, 3) [m] once the arm stands still under tensions [N]."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key('rest').id)
    for tendon in robot.tendons:
        data.actuator(tendon.name).ctrl = tensions.get(tendon.group or tendon.name, 0.0)
    for _ in range(40_000):
        mujoco.mj_step(model, data)
        if data.time > 0.2 and np.abs(data.qvel).max() < 1e-5:
            return np.array([data.site(name).xpos for name in robot.cell_names])
    raise AssertionError(f'it still moves by {np.abs(data.qvel).max()} rad/s')


def frictionless(robot):
    """Return the robot without what the file leaves out."""
    for effect in unsaid(Laws(Model(robot))):
        robot = robot.without_effect(effect.name)
    return robot


def added(robot, *names, **more):
    """Return the robot with what a diagnosis found, and gravity."""
    effects = {name: TYPICAL[name] for name in names or FOUND} | more
    return replace(robot, effects=robot.effects | effects, gravity=DOWN)


TRUNK = load_robot(ROOT / 'data/trunk/robot.yaml')
KATO = load_robot('kato_10_1')
ONE_CELL = planar(1, stiffness=0.01, length=0.06)
CASES = {
    'planar, one section': (planar(15), {'right': 1.2}),
    'planar, one section, straight': (planar(15, STRAIGHT, 'hinge'), {'right': 1.2, 'left': 0.3}),
    'planar, two sections': (KATO, {'prox_right': 1.5, 'dist_left': 0.4, 'prox_left': 0.3}),
    'planar, three sections': (
        chain_of_three('arc', 2), {'near_0': 1.0, 'middle_1': 1.0, 'far_0': 0.7}),
    'planar, a section that is one arc': (ONE_CELL, {'right': 2.0}),
    'spatial, one section': (load_robot('spatial_3'), {'one': 1.5, 'two': 0.6}),
    'spatial, two sections': (load_robot('spatial_6'), {'prox_one': 1.0, 'dist_three': 1.4}),
    'spatial, three sections': (
        chain_of_three(), {'near_0': 1.0, 'middle_1': 1.0, 'far_2': 0.7}),
    'spatial, three sections, straight': (
        replace(chain_of_three(), effects=STRAIGHT),
        {'near_0': 1.0, 'middle_1': 1.0, 'far_2': 0.7}),
    'a trunk with its weight': (TRUNK, {'m3p': 20.0, 'm6n': 10.0}),
    'planar, as diagnosed': (added(two_sections(8)), {'near_right': 1.0, 'far_left': 0.4}),
    'spatial, as diagnosed': (added(spatial(8)), {'near_0': 1.2, 'far_1': 0.6}),
    'spatial, as diagnosed, straight': (
        added(spatial(8, STRAIGHT)), {'near_0': 1.2, 'far_1': 0.6}),
    'spatial, twisting': (
        added(spatial(8, STRAIGHT), 'tip_load', torsion={'compliance': 1.3}),
        {'near_0': 1.2, 'far_1': 0.6}),
    'a tendon that winds': (
        replace(planar(10, STRAIGHT, 'hinge'), tendons=(
            Tendon('left', (-0.005, 0.0), (-0.005, 0.0), 'only', helix=15.0),
            Tendon('right', (0.005, 0.0), (0.005, 0.0), 'only'))),
        {'left': 1.5, 'right': 0.2}),
}  # fmt: skip


@pytest.mark.parametrize('name', CASES)
def test_at_rest_it_has_the_shape_of_the_model(name):
    described, tensions = CASES[name]
    robot = frictionless(described)
    shape = Model(robot).shape(tensions)
    found = settled(mjcf(Model(described)), robot, tensions)
    off = np.linalg.norm(found - shape.positions, axis=1).max() / robot.length
    straight = np.column_stack([np.zeros((robot.cells, 2)), np.cumsum(robot.cell_lengths)])
    moved = np.linalg.norm(shape.positions - straight, axis=1).max() / robot.length
    assert moved > 0.1, 'the case bends the arm'
    print(f'{name}: off by {100.0 * off:.2f} % of the length, moved by {100.0 * moved:.0f} %')
    assert off < 0.02


def test_the_keyframe_is_the_arm_at_rest():
    robot = added(spatial(6), 'pre_curvature')
    model = mujoco.MjModel.from_xml_string(mjcf(Model(robot)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    tip = Model(robot).shape(np.zeros(6)).tip_position
    assert data.site('tip').xpos == pytest.approx(tip, abs=0.01 * robot.length)


def test_what_mujoco_cannot_say_stands_in_the_head():
    robot = replace(load_robot('spatial_3'), effects=load_robot('spatial_3').effects | {
        'friction_memory': {'presliding_length': 4e-4}, 'hinge_friction': {'lever': 1e-4},
        'wire_spring': {'compliance': 1e-4}})  # fmt: skip
    head, _, rest = mjcf(Model(robot)).partition('-->')
    for name in ('tendon_friction', 'eyelet_wrap', 'tendon_travel', 'friction_memory',
                 'hinge_friction'):  # fmt: skip
        title = load_catalogue()[name].title
        assert f'\n  {name}: {title}\n' in head.partition('MuJoCo cannot')[2]
    assert 'because it is about wires or tracker:\n  wire_spring' in head
    assert 'straight_tendon' not in head and '<spatial' in rest
    assert 'Not in this file' not in mjcf(Model(planar()))


@pytest.mark.parametrize('gravity', [None, (0.0, 0.0, 0.0), DOWN])
def test_masses_are_those_of_the_description_wherever_down_is(gravity):
    robot = replace(planar(), effects={'gravity': {'linear_density': 0.3}}, gravity=gravity)
    text = mjcf(Model(robot))
    masses = mujoco.MjModel.from_xml_string(text).body_mass
    assert masses.sum() == pytest.approx(0.3 * robot.length)
    assert 'Masses are made up' not in text


def test_dashes_in_a_name_do_not_end_the_head():
    text = mjcf(Model(replace(planar(), name='arm ---- 2')))
    assert text.startswith('<!--\narm - - - - 2, written by ')
    assert mujoco.MjModel.from_xml_string(text).nu == 2


def test_a_law_that_is_no_gain_and_offset_is_left_out_and_said():
    soft = load_catalogue(ROOT / 'examples/soft_pulley.py')
    robot = replace(planar(), effects={'soft_pulley': {'loss': 0.1}})
    assert '\n  soft_pulley: a pulley that gives way' in mjcf(Model(robot, soft))
    gain, offset, enough = Laws(
        Model(added(planar(), 'transmission_loss', 'tension_offset'))
    ).gain(0)
    assert (gain, offset, enough) == (pytest.approx(0.9), pytest.approx(0.05), True)
