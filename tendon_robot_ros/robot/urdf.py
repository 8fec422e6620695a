"""The robot as a URDF, for RViz and TF: revolute joints in the middle of every cell."""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

import numpy as np

from ..common.arrays import Floats
from ..common.rotations import about
from . import Robot

Transform = tuple[str, str, Floats, float]  # parent, child, rotation (3, 3), shift up [m]


def joint_axes(robot: Robot) -> str:
    """Return the axes of the joints of a cell: two that bend it, one more where it twists."""
    return 'xyz' if 'torsion' in robot.effects else 'xy'


def joint_names(robot: Robot) -> tuple[str, ...]:
    """Return the joints in the order of `joint_angles`: cell_01_x, cell_01_y, cell_02_x ..."""
    return tuple(f'{name}_{axis}' for name in _cell_names(robot) for axis in joint_axes(robot))


def joint_angles(robot: Robot, frames: Floats) -> Floats:
    """
    Return the angles (n j,) [rad] of the j joints of every cell that place it as the model does.

    Two joints cannot bend without twist, a cell of the model does: the twist that remains is
    carried along and compensated in the next cell. Directions are exact; positions too
    where cells bend as hinges (an arc is drawn as two straight halves). With the third joint of
    cells that twist the frames are exact, too.

    Parameters
    ----------
    robot : Robot
    frames : (n, 3, 3)
        At the distal ends of the cells.

    """
    axes = len(joint_axes(robot))
    angles, frame = np.empty((len(frames), axes)), np.eye(3)
    for i, target in enumerate(frames):
        x, y, z = frame.T @ target[:, 2]
        angles[i, :2] = math.atan2(x, z), math.asin(min(max(y, -1.0), 1.0))
        frame = frame @ about(1, angles[i, 0]) @ about(0, -angles[i, 1])
        if axes == 3:
            residual = frame.T @ target
            angles[i, 2] = math.atan2(residual[1, 0], residual[0, 0])
            frame = target
    return angles.reshape(-1)


def transforms(robot: Robot, angles: Floats, prefix: str) -> list[Transform]:
    """
    Return parent, child, rotation (3, 3) and shift up [m] of every link of the URDF.

    Parameters
    ----------
    robot : Robot
    angles : (n j,) [rad]
        As `joint_angles` returns them.
    prefix : str
        Of the links; the last one is the tip.

    """
    parent, before, links = f'{prefix}base', 0.0, list[Transform]()
    lengths = robot.cell_lengths.tolist()
    axes = len(joint_axes(robot))
    for i, name in enumerate(_cell_names(robot)):
        cell_angles = angles[axes * i : axes * (i + 1)]
        up, middle, child = 0.5 * (before + lengths[i]), f'{prefix}{name}_middle', prefix + name
        bent = f'{prefix}{name}_bent' if axes == 3 else child
        links.append((parent, middle, about(1, cell_angles[0]), up))
        links.append((middle, bent, about(0, -cell_angles[1]), 0.0))
        if axes == 3:
            links.append((bent, child, about(2, cell_angles[2]), 0.0))
        parent, before = child, lengths[i]
    return [*links, (parent, f'{prefix}tip', np.eye(3), 0.5 * before)]


def urdf(robot: Robot, prefix: str = '') -> str:
    """
    Return the URDF text; lengths in m.

    Joint x of a cell bends it towards +x, joint y, which follows, towards +y; where cells twist,
    joint z turns it about its axis. The root link is `base`, with +z along the straight arm. With
    a prefix, such as the one of the nodes' frames, the links begin with it, and the tip has a link
    of its own.
    """
    radius = 1.15 * max(math.hypot(*at) for t in robot.tendons for at in (t.base, t.end))
    lengths = robot.cell_lengths.tolist()
    colours = [i % 2 for i, s in enumerate(robot.sections) for _ in range(s.cells)]
    lines = ['<?xml version="1.0"?>', f'<robot name={quoteattr(robot.name)}>', *_MATERIALS]
    lines += _link(f'{prefix}base', 0.5 * lengths[0], radius, 0)
    parent, before, twists = f'{prefix}base', 0.0, len(joint_axes(robot)) == 3
    for i, name in enumerate(_cell_names(robot)):
        up = 0.5 * (before + lengths[i])
        beyond = 0.5 * (lengths[i] + lengths[i + 1]) if i + 1 < len(lengths) else 0.5 * lengths[i]
        link, middle = prefix + name, f'{prefix}{name}_middle'
        lines += _joint(f'{name}_x', parent, middle, up, '0 1 0')
        lines.append(f'  <link name="{middle}"/>')
        bent = f'{prefix}{name}_bent' if twists else link
        lines += _joint(f'{name}_y', middle, bent, 0.0, '-1 0 0')
        if twists:
            lines.append(f'  <link name="{bent}"/>')
            lines += _joint(f'{name}_z', bent, link, 0.0, '0 0 1')
        lines += _link(link, beyond, radius, colours[i])
        parent, before = link, lengths[i]
    if prefix:
        lines += [
            f'  <link name="{prefix}tip"/>',
            '  <joint name="tip" type="fixed">',
            f'    <parent link="{parent}"/><child link="{prefix}tip"/>',
            f'    <origin xyz="0 0 {0.5 * before:.9g}"/>',
            '  </joint>',
        ]
    return '\n'.join([*lines, '</robot>'])


_MATERIALS = (
    '  <material name="section_0"><color rgba="0.20 0.45 0.70 1"/></material>',
    '  <material name="section_1"><color rgba="0.90 0.55 0.15 1"/></material>',
)


def _cell_names(robot: Robot) -> list[str]:
    width = max(2, len(str(robot.cells)))
    return [f'cell_{i + 1:0{width}d}' for i in range(robot.cells)]


def _link(name: str, length: float, radius: float, colour: int) -> list[str]:
    return [
        f'  <link name="{name}">',
        f'    <visual><origin xyz="0 0 {0.5 * length:.9g}"/>'
        f'<geometry><cylinder radius="{radius:.9g}" length="{length:.9g}"/></geometry>'
        f'<material name="section_{colour}"/></visual>',
        '  </link>',
    ]


def _joint(name: str, parent: str, child: str, up: float, axis: str) -> list[str]:
    return [
        f'  <joint name="{name}" type="revolute">',
        f'    <parent link="{parent}"/><child link="{child}"/>',
        f'    <origin xyz="0 0 {up:.9g}"/><axis xyz="{axis}"/>',
        '    <limit lower="-3.1416" upper="3.1416" effort="0" velocity="10"/>',
        '  </joint>',
    ]
