"""
Print what ROBOT is, what one newton does to it, and whether that is plausible.

Sections, tendons, limits, tolerances, and the physical effects of its model. With --urdf print a
URDF instead, for RViz and TF: two revolute joints per cell, `<name>_x` towards x and `<name>_y`
towards y, and where cells twist a third, `<name>_z`, about its axis.

example: python -m tendon_robot_ros describe config/robots/kato_10_1.yaml
"""

from __future__ import annotations

import argparse
import math

from ..common.words import columns
from ..robot import Robot, load_robot
from ..robot.description import XY
from ..robot.estimates import handling

HELP = 'print a robot description, or a URDF of it'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('robot', metavar='ROBOT', help='robot description (YAML)')
    parser.add_argument('--urdf', action='store_true', help='print a URDF')


def run(args: argparse.Namespace) -> int:
    """Read and print."""
    robot = load_robot(args.robot)
    if args.urdf:
        from ..robot.urdf import urdf

        print(urdf(robot))
    else:
        print(description(robot))
    return 0


def description(robot: Robot) -> str:
    """Return the description for a reader (mm)."""
    low, high = robot.tension_limits
    own = robot.own_sections
    length = sum(section.cells * section.cell_length for section in own)
    plate = ', on a base plate with holes' if len(own) < len(robot.sections) else ''
    size = (
        f'{_count(len(own), "section")}, {_count(sum(s.cells for s in own), "cell")}, '
        f'{_count(len(robot.tendons), "tendon")}, {1e3 * length:g} mm{plate}'
    )
    lines = [
        f'robot {robot.name}: {size}',
        f'model: {model_name(robot)}',
        f'commanded: {", ".join(robot.inputs)}, {low:g} to {high:g} N each',
    ]
    if robot.gravity is not None:
        lines.append(f'gravity: {", ".join(f"{g:g}" for g in robot.gravity)} m/s²')
    lines += ['', section_table(robot), '', tendon_table(robot), '', *handling(robot), '']
    lines.append('effects:' if robot.effects else 'effects: none')
    for name, values in robot.effects.items():
        texts = ', '.join(
            f'{key} {", ".join(map(str, v)) if isinstance(v, tuple) else v}'
            for key, v in values.items()
        )
        lines.append(f'  {name}: {texts}{" (fitted)" if name in robot.fitted else ""}')
    if robot.tolerances:
        shown = ', '.join(f'{name} {value:g}' for name, value in robot.tolerances.items())
        lines.append(f'not sure (1 sd): {shown}')
    return '\n'.join(lines)


def model_name(robot: Robot) -> str:
    """Name the model after the effects that it lists."""
    names = list(robot.effects)
    if not names:
        return 'PCCA (no effects)'
    if names == ['tendon_friction']:
        friction = robot.effects['tendon_friction'].get('friction_coefficient')
        return f'FKM (tendon_friction, friction coefficient {friction})'
    base = 'FKM' if 'tendon_friction' in names else 'PCCA'
    return f'{base} + {", ".join(name for name in names if name != "tendon_friction")}'


def _count(number: int, what: str) -> str:
    return f'{number} {what}{"" if number == 1 else "s"}'


def section_table(robot: Robot) -> str:
    """Return a row for every section."""
    beside = any(section.mass_offset for section in robot.sections)
    rows = [['section', 'cells', 'cell [mm]', 'stiffness [N·m/rad]', 'bends as']]
    rows[0] += ['weight at x, y [mm]'] * beside
    for section in robot.sections:
        low, high = min(section.bending_stiffness), max(section.bending_stiffness)
        stiffness = f'{low:g}' if low == high else f'{low:g} to {high:g}'
        sizes = [str(section.cells), f'{1e3 * section.cell_length:g}', stiffness]
        weight = [_route(section.mass_offset or ((0.0, 0.0),))] * beside
        rows.append([section.name, *sizes, section.bends_as, *weight])
    return columns(rows)


def _route(offsets: tuple[XY, ...]) -> str:
    """Format the offsets [m] of both ends of a tendon, in millimetres."""
    first, last = ('{:g}, {:g}'.format(*(1e3 * v for v in at)) for at in (offsets[0], offsets[-1]))
    return first if first == last else f'{first} to {last}'


def tendon_table(robot: Robot) -> str:
    """Return a row for every tendon."""
    rows = [['tendon', 'offset x, y [mm]', 'ends in', 'pulled by']]
    for tendon in robot.tendons:
        offset = _route((tendon.base, tendon.end))
        if tendon.helix:
            offset += f', winds {1e-3 * math.degrees(tendon.helix):.4g}°/mm'
        elif tendon.offsets:
            offset += f' in {len(tendon.offsets)} steps'
        rows.append([tendon.name, offset, tendon.section, tendon.group or tendon.name])
    return columns(rows)
