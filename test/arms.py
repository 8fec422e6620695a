"""Robots for the tests of the model: small ones, any number of sections, tendons, effects."""

from dataclasses import replace

import numpy as np
from source_tree import ROOT

from tendon_robot_ros.common.rotations import turned_in_plane
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.description import with_cells
from tendon_robot_ros.robot import Robot, Section, Tendon, load_robot

GRAVITY = (1.0, -2.0, 9.4)
OWN_SIZES = {  # where the typical size, or its sign, would show less
    'tendon_friction': {'friction_coefficient': 0.3},
    'eyelet_wrap': {'fraction': 0.7},
    'tendon_travel': {'fraction': 0.6},
    'straight_tendon': {'fraction': 0.8},
    'eyelet_clearance': {'clearance': 2e-4},
    'hinge_friction': {'lever': 2e-4},
    'bending_hysteresis': {'lag': 0.02, 'presliding': 0.5},
    'backbone_stiffness': {'relative_change': 0.1},
    'section_stiffness': {'relative_change': (0.2, -0.1)},
    'tendon_stiffness': {'per_tendon': 5e-4},
    'nonlinear_stiffness': {'cubic': 3.0},
    'pre_curvature': {'angle_x': 0.02, 'angle_y': -0.03},
    'torsion': {'compliance': 1.3},
    'gravity': {'linear_density': 0.3},
    'tip_load': {'force_x': 0.01, 'force_y': -0.02, 'force_z': 0.03}
    | {'moment_x': 1e-3, 'moment_y': 2e-3, 'moment_z': -5e-4},
    'point_load': {'arc_length': 0.0185, 'force_x': 0.08, 'force_y': -0.03, 'force_z': 0.02}
    | {'moment_x': 1e-3, 'moment_y': 2e-3, 'moment_z': -5e-4, 'follows': 0.3},
    'tether': {'arc_length': 0.0175, 'point_x': 0.06, 'point_y': -0.02, 'point_z': 0.02}
    | {'slack_length': 0.02, 'stiffness': 1.0, 'tension': 0.1},
    # a soft pole of 20 mm beside the base, 2 mm inside the straight arm
    'contact': {'stiffness': 10.0, 'distance': -0.002, 'azimuth': 0.4, 'elevation': 0.05}
    | {'curvature': 50.0, 'is_pole': 1.0, 'axis': 0.5, 'thickness': 0.001}
    | {'friction_coefficient': 0.3},
    'axial_compression': {'compliance': 3e-3},
    'transmission_loss': {'fraction': 0.1},
    'tension_offset': {'offset': 0.05},
    'moment_arm': {'relative_change': 0.1},
    'tendon_elongation': {'compliance': 2e-3},
    'wire_spring': {'compliance': 8e-4},
    'backlash': {'width': 5e-4},
    'pull_zero': {'offset': 5e-4},
    'spool_gain': {'relative_change': 0.05},
}
TYPICAL = {  # every effect at a size that matters; these two have tests of their own
    effect.name: OWN_SIZES.get(effect.name, {p.name: p.typical for p in effect.parameters})
    for effect in load_catalogue()
    if effect.name not in ('friction_memory', 'base_misalignment')
}

UNITS = {  # unit -> powers of length and force
    '1': (0, 0),
    'rad': (0, 0),
    '1/rad²': (0, 0),
    'm': (1, 0),
    'N': (0, 1),
    '1/N': (0, -1),
    'm/N': (1, -1),
    'N·m/rad': (1, 1),
    'N·m': (1, 1),
    'N/m': (-1, 1),
    '1/m': (-1, 0),
    'kg/m': (-1, 1),
}
CATALOGUE = load_catalogue()
VECTORS = [  # effects with directions, and the stems of their components
    (effect.name, p.name.removesuffix('_x'))
    for effect in CATALOGUE
    if effect.stage != 'measurement'  # the tracker's frame is not the robot's
    for p in effect.parameters
    if p.name.endswith('_x')
]
THREE = load_robot(ROOT / 'config/robots/spatial_3.yaml')


def section(name, cells, length, stiffness, bends_as='arc'):
    """Return a section of equal cells."""
    return Section(name, cells, length, (stiffness,) * cells, (1.0,) * cells, bends_as)


COARSE = replace(
    THREE, sections=(section(THREE.sections[0].name, 8, 0.015, 0.016, THREE.sections[0].bends_as),)
)


def coarse(robot, cells=None):
    """Return a robot of so many cells per section (half of them), as long and as soft."""
    robot, sections = load_robot(robot), []
    for one in robot.sections:
        count = cells or one.cells // 2
        longer = one.cells / count
        compliance = longer * float(np.mean(np.reciprocal(one.bending_stiffness)))
        length = longer * one.cell_length
        sections.append(section(one.name, count, length, 1.0 / compliance, one.bends_as))
    return replace(robot, sections=tuple(sections))


def soft_cell(robot, cell, factor):
    """Return a robot of which one cell (from 1) is so many times as stiff as described."""
    factors = np.where(np.arange(robot.cells) == cell - 1, factor, 1.0)
    return with_cells(robot, factors, digits=12)


def made(name, sections, tendons, effects):
    """Return a robot of sections and of tendons, each by its name, (x, y) [m] and section."""
    wires = tuple(Tendon(wire, at, at, where) for wire, at, where in tendons)
    return Robot(name, sections, wires, tension_limits=(0.0, 5.0), effects=effects or {})


def planar(cells=6, effects=None, bends_as='arc', stiffness=0.027, length=0.007, arm=0.0055):
    """Return one section with a tendon to each side."""
    tendons = ('left', (-arm, 0.0), 'only'), ('right', (arm, 0.0), 'only')
    sections = (section('only', cells, length, stiffness, bends_as),)
    return made('planar', sections, tendons, effects)


def two_sections(cells=4, effects=None, bends_as='arc'):
    """Return two sections with two tendons each, in one plane."""
    near = section('near', cells, 0.007, 0.027, bends_as)
    far = section('far', cells, 0.006, 0.021, bends_as)
    tendons = [
        (f'{where}_{side}', (x, 0.0), where)
        for where in ('near', 'far')
        for side, x in (('left', -0.0055), ('right', 0.0055))
    ]
    return made('two_sections', (near, far), tendons, effects)


def spatial(cells=4, effects=None, bends_as='hinge', taper=1.0):
    """Return two sections with three tendons each, all around; `taper` of the offsets."""
    near = section('near', cells, 0.006, 0.05, bends_as)
    far = section('far', cells, 0.006, 0.03, bends_as)
    tendons = []
    for s, name in enumerate(('near', 'far')):
        for j in range(3):
            angle = np.pi / 3 * (2 * j + s)
            at = (float(0.006 * np.cos(angle)), float(0.006 * np.sin(angle)))
            tendons.append((f'{name}_{j}', at, name))
    robot = made('spatial', (near, far), tendons, effects)
    ends = (replace(t, end=(taper * t.base[0], taper * t.base[1])) for t in robot.tendons)
    return replace(robot, tendons=tuple(ends))


def wound(robot, helix=(20.0, -15.0), beside=(0.002, -0.003)):
    """Return the robot with tendons that wind about it [rad/m] and weight beside the axis [m]."""
    tendons = tuple(replace(tendon, helix=helix[k % 2]) for k, tendon in enumerate(robot.tendons))
    sections = tuple(
        replace(s, mass_offset=tuple((x + 1e-3 * i, y) for i in range(s.cells)))
        for s in robot.sections
        for x, y in (beside,)
    )
    return replace(robot, tendons=tendons, sections=sections)


def misses(model, moved, to_first_order, solved):
    """
    Yield by how much shapes to first order miss those that are solved, and how far these move [m].

    Both are functions of the model as it is, which is moved by effect, parameter and step.
    """
    for effect, parameter, step in moved:
        value, slopes, differences = model.arrays.get(effect, parameter, 0), [], []
        for side in (step, -step):
            model.arrays.set(effect, parameter, None, value + side)
            slopes.append(to_first_order().positions)
            differences.append(solved().positions)
        model.arrays.set(effect, parameter, None, value)
        expected = np.subtract(*differences)
        yield np.abs(np.subtract(*slopes) - expected).max(), np.abs(expected).max()


def turned(robot, angle):
    """Return the robot turned about z, with what of its effects and gravity has a direction."""

    def turn(x, y):
        return tuple(turned_in_plane(np.array([x, y]), angle).tolist())

    effects = {name: dict(values) for name, values in robot.effects.items()}
    if 'point_load' in effects:  # what follows the arm turns as the axes of its frames do not
        assert effects['point_load'].get('follows', 0.0) == 0.0
    if 'contact' in effects:
        effects['contact']['azimuth'] += angle
    for name, stem in VECTORS:
        if name in effects:
            x, y = (effects[name].get(f'{stem}_{axis}', 0.0) for axis in 'xy')
            effects[name][f'{stem}_x'], effects[name][f'{stem}_y'] = turn(x, y)
    gravity = robot.gravity and (*turn(*robot.gravity[:2]), robot.gravity[2])
    tendons = tuple(replace(t, base=turn(*t.base), end=turn(*t.end)) for t in robot.tendons)
    return replace(robot, tendons=tendons, effects=effects, gravity=gravity)


def scaled(robot, length, stiffness):
    """Return a robot whose lengths and bending stiffness are so many times as large."""
    sections = tuple(
        replace(
            section,
            cell_length=length * section.cell_length,
            bending_stiffness=tuple(stiffness * k for k in section.bending_stiffness),
        )
        for section in robot.sections
    )
    tendons = tuple(
        replace(t, base=tuple(length * x for x in t.base), end=tuple(length * x for x in t.end))
        for t in robot.tendons
    )
    force = stiffness / length
    limits = tuple(force * limit for limit in robot.tension_limits)
    effects = {
        name: {key: factor(name, key, length, force) * value for key, value in values.items()}
        for name, values in robot.effects.items()
    }
    return replace(
        robot, sections=sections, tendons=tendons, tension_limits=limits, effects=effects
    )


def factor(effect, key, length, force):
    """Return what a parameter of an effect is multiplied by."""
    unit = {p.name: p.unit for p in CATALOGUE[effect].parameters}[key]
    powers = UNITS[unit]
    return length ** powers[0] * force ** powers[1]
