"""The robot as a URDF, for RViz and TF: two revolute joints in the middle of every cell."""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from ..common.rotations import about
from . import Robot

Floats = npt.NDArray[np.float64]
Transform = tuple[str, str, Floats, float]  # parent, child, rotation (3, 3), shift up [m]


def joint_names(robot: Robot) -> tuple[str, ...]:
    """Return the joints in the order of `joint_angles`: cell_01_x, cell_01_y, cell_02_x ..."""
    return tuple(f'{name}_{axis}' for name in _cell_names(robot) for axis in 'xy')


def joint_angles(frames: Floats) -> Floats:
    """
    Return the angles (2n,) [rad] that point every cell of the URDF as the model's frames do.

    Two joints cannot bend without twist, a cell of the model does: the twist that the joints leave
    behind is carried along and taken off in the next cell. Directions are exact; positions too
    where cells bend as hinges (an arc is drawn as two straight halves).

    Parameters
    ----------
    frames : (n, 3, 3)
        At the distal ends of the cells.

    """
    angles, frame = np.empty((len(frames), 2)), np.eye(3)
    for i, wanted in enumerate(frames):
        x, y, z = frame.T @ wanted[:, 2]
        alpha, beta = math.atan2(x, z), math.asin(min(max(y, -1.0), 1.0))
        angles[i] = alpha, beta
        s, c, t, d = math.sin(alpha), math.cos(alpha), math.sin(beta), math.cos(beta)
        about_y = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, d, t], [0.0, -t, d]])
        frame = frame @ about_y @ about_x
    return angles.reshape(-1)


def transforms(robot: Robot, angles: Floats, prefix: str) -> list[Transform]:
    """
    Return parent, child, rotation (3, 3) and shift up [m] of every link of the URDF.

    Parameters
    ----------
    robot : Robot
    angles : (2n,) [rad]
        As `joint_angles` returns them.
    prefix : str
        Of the links; the last one is the tip.

    """
    parent, before, made = f'{prefix}base', 0.0, list[Transform]()
    lengths = [s.cell_length for s in robot.sections for _ in range(s.cells)]
    for i, name in enumerate(_cell_names(robot)):
        up, middle, child = 0.5 * (before + lengths[i]), f'{prefix}{name}_middle', prefix + name
        made.append((parent, middle, about(1, angles[2 * i]), up))
        made.append((middle, child, about(0, -angles[2 * i + 1]), 0.0))
        parent, before = child, lengths[i]
    return [*made, (parent, f'{prefix}tip', np.eye(3), 0.5 * before)]


def urdf(robot: Robot, prefix: str = '') -> str:
    """
    Return the URDF text; lengths in m.

    Joint x of a cell bends it towards +x, joint y, which follows, towards +y. The root link is
    `base`, with +z along the straight arm. With a prefix, such as the one of the nodes' frames,
    the links begin with it, and the tip has a link of its own.
    """
    radius = 1.15 * max(math.hypot(*at) for t in robot.tendons for at in (t.base, t.end))
    lengths = [s.cell_length for s in robot.sections for _ in range(s.cells)]
    colours = [i % 2 for i, s in enumerate(robot.sections) for _ in range(s.cells)]
    lines = ['<?xml version="1.0"?>', f'<robot name={quoteattr(robot.name)}>', *_MATERIALS]
    lines += _link(f'{prefix}base', 0.5 * lengths[0], radius, 0)
    parent, before = f'{prefix}base', 0.0
    for i, name in enumerate(_cell_names(robot)):
        up = 0.5 * (before + lengths[i])
        beyond = 0.5 * (lengths[i] + lengths[i + 1]) if i + 1 < len(lengths) else 0.5 * lengths[i]
        link, middle = prefix + name, f'{prefix}{name}_middle'
        lines += _joint(f'{name}_x', parent, middle, up, '0 1 0')
        lines.append(f'  <link name="{middle}"/>')
        lines += _joint(f'{name}_y', middle, link, 0.0, '-1 0 0')
        lines += _link(link, beyond, radius, colours[i])
        parent, before = link, lengths[i]
    if prefix:
        lines += _tip(parent, f'{prefix}tip', 0.5 * before)
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


def _tip(parent: str, name: str, up: float) -> list[str]:
    return [
        f'  <link name="{name}"/>',
        '  <joint name="tip" type="fixed">',
        f'    <parent link="{parent}"/><child link="{name}"/>',
        f'    <origin xyz="0 0 {up:.9g}"/>',
        '  </joint>',
    ]


def _joint(name: str, parent: str, child: str, up: float, axis: str) -> list[str]:
    return [
        f'  <joint name="{name}" type="revolute">',
        f'    <parent link="{parent}"/><child link="{child}"/>',
        f'    <origin xyz="0 0 {up:.9g}"/><axis xyz="{axis}"/>',
        '    <limit lower="-3.1416" upper="3.1416" effort="0" velocity="10"/>',
        '  </joint>',
    ]
