"""The robot description back to YAML."""

from __future__ import annotations

from typing import Any

import yaml

from .description import Section, Tendon
from .loading import RobotLike, load_robot


def dump_robot(robot: RobotLike) -> str:
    """Write a robot description as YAML text; `parse_robot` reads the same robot back."""
    robot = load_robot(robot)
    content: dict[str, Any] = {
        'name': robot.name,
        'sections': [_plain_section(section) for section in robot.sections],
        'tendons': [_plain_tendon(tendon) for tendon in robot.tendons],
        'tension_limits': list(robot.tension_limits),
    }
    if robot.gravity is not None:
        content['gravity'] = list(robot.gravity)
    if robot.tolerances:
        content['tolerances'] = dict(robot.tolerances)
    if robot.exact:
        content['exact'] = True
    content['effects'] = {
        name: {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in values.items()
        }
        for name, values in robot.effects.items()
    }
    if robot.fitted:
        content['fitted'] = robot.fitted
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True)


def _plain_section(section: Section) -> dict[str, Any]:
    def short(values: tuple[float, ...]) -> float | list[float]:
        return values[0] if len(set(values)) == 1 else list(values)

    plain = {
        'name': section.name,
        'cells': section.cells,
        'cell_length': section.cell_length,
        'bending_stiffness': short(section.bending_stiffness),
    }
    if set(section.mass_profile) != {1.0}:
        plain['mass_profile'] = short(section.mass_profile)
    if section.mass_offset:
        rows = [list(at) for at in section.mass_offset]
        plain['mass_offset'] = rows[0] if len(set(section.mass_offset)) == 1 else rows
    return {**plain, 'bends_as': section.bends_as}


def _plain_tendon(tendon: Tendon) -> dict[str, Any]:
    offset: Any = list(tendon.base)
    if tendon.offsets:
        offset = {'cells': [list(at) for at in tendon.offsets]}
    elif tendon.base != tendon.end or tendon.helix:
        offset = {'base': list(tendon.base), 'end': list(tendon.end)}
        if tendon.helix:
            offset['helix'] = tendon.helix
    plain = {'name': tendon.name, 'offset': offset, 'section': tendon.section}
    if tendon.drum is not None:
        plain['drum'] = tendon.drum
        if tendon.winding != 1:
            plain['winding'] = tendon.winding
    return plain if tendon.group is None else {**plain, 'group': tendon.group}
