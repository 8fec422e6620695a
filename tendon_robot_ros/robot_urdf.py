"""The robot as a URDF, for RViz and TF: two revolute joints in the middle of every cell."""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from .robot import Robot

Floats = npt.NDArray[np.float64]


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


def urdf(robot: Robot) -> str:
    """
    Return the URDF text; lengths in m.

    Joint x of a cell bends it towards +x, joint y, which follows, towards +y. The root link is
    `base`, with +z along the straight arm.
    """
    radius = 1.15 * max(math.hypot(*at) for t in robot.tendons for at in (t.base, t.end))
    lengths = [s.cell_length for s in robot.sections for _ in range(s.cells)]
    colours = [i % 2 for i, s in enumerate(robot.sections) for _ in range(s.cells)]
    lines = ['<?xml version="1.0"?>', f'<robot name={quoteattr(robot.name)}>', *_MATERIALS]
    lines += _link('base', 0.5 * lengths[0], radius, 0)
    parent, before = 'base', 0.0
    for i, name in enumerate(_cell_names(robot)):
        up = 0.5 * (before + lengths[i])
        beyond = 0.5 * (lengths[i] + lengths[i + 1]) if i + 1 < len(lengths) else 0.5 * lengths[i]
        lines += _joint(f'{name}_x', parent, f'{name}_middle', up, '0 1 0')
        lines.append(f'  <link name="{name}_middle"/>')
        lines += _joint(f'{name}_y', f'{name}_middle', name, 0.0, '-1 0 0')
        lines += _link(name, beyond, radius, colours[i])
        parent, before = name, lengths[i]
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
