"""The robot as a URDF, for RViz and TF: revolute joints in the middle of every cell."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from ..common.arrays import Floats
from ..common.rotations import about
from . import Robot
from .estimates import natural_sizes

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
    links = [
        (joint.parent, joint.child, about(joint.axis, joint.sign * angle), joint.up)
        for joint, angle in zip(_joints(robot, prefix), angles.tolist(), strict=True)
    ]
    tip = 0.5 * float(robot.cell_lengths[-1])
    return [*links, (links[-1][1], f'{prefix}tip', np.eye(3), tip)]


class _Joint(NamedTuple):
    """A revolute joint of a cell."""

    name: str
    parent: str
    child: str
    up: float  # [m] along the parent
    axis: int  # x (0), y (1) or z (2)
    sign: int  # of the rotation about it


def _joints(robot: Robot, prefix: str) -> Iterator[_Joint]:
    """Yield the joints from the base to the tip."""
    axes, parent, before = joint_axes(robot), f'{prefix}base', 0.0
    for cell, length in zip(_cell_names(robot), robot.cell_lengths.tolist(), strict=True):
        up, before = 0.5 * (before + length), length
        children = ['_middle', ''] if len(axes) == 2 else ['_middle', '_bent', '']
        about_axes = zip(axes, children, (1, 0, 2), (1, -1, 1), strict=False)
        for name, ending, axis, sign in about_axes:
            child = f'{prefix}{cell}{ending}'
            yield _Joint(f'{cell}_{name}', parent, child, up, axis, sign)
            parent, up = child, 0.0


def urdf(robot: Robot, prefix: str = '') -> str:
    """
    Return the URDF text; lengths in m.

    Joint x of a cell bends it towards +x, joint y, which follows, towards +y; where cells twist,
    joint z turns it about its axis. The root link is `base`, with +z along the straight arm. With
    a prefix, such as the one of the nodes' frames, the links begin with it, and the tip has a link
    of its own.
    """
    radius = 1.15 * natural_sizes(robot)['radius']
    lengths = robot.cell_lengths.tolist()
    colours = [i % 2 for i, s in enumerate(robot.sections) for _ in range(s.cells)]
    lines = ['<?xml version="1.0"?>', f'<robot name={quoteattr(robot.name)}>', *_MATERIALS]
    lines += _link(f'{prefix}base', 0.5 * lengths[0], radius, 0)
    halves, axes = 0.5 * np.append(lengths, 0.0), len(joint_axes(robot))
    beyond = (halves[:-1] + halves[1:]).tolist()
    for count, joint in enumerate(_joints(robot, prefix)):
        cell, within = divmod(count, axes)
        direction = ' '.join(map(str, (joint.sign * np.eye(3, dtype=int)[joint.axis]).tolist()))
        lines += [
            f'  <joint name="{joint.name}" type="revolute">',
            f'    <parent link="{joint.parent}"/><child link="{joint.child}"/>',
            f'    <origin xyz="0 0 {joint.up:.9g}"/><axis xyz="{direction}"/>',
            '    <limit lower="-3.1416" upper="3.1416" effort="0" velocity="10"/>',
            '  </joint>',
        ]
        if within == axes - 1:
            lines += _link(joint.child, beyond[cell], radius, colours[cell])
        else:
            lines.append(f'  <link name="{joint.child}"/>')
    if prefix:
        lines += [
            f'  <link name="{prefix}tip"/>',
            '  <joint name="tip" type="fixed">',
            f'    <parent link="{joint.child}"/><child link="{prefix}tip"/>',
            f'    <origin xyz="0 0 {halves[-2]:.9g}"/>',
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
