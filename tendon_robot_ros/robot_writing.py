"""The robot description back to YAML."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from .robot import Robot, Section, Tendon


def dump_robot(robot: Robot) -> str:
    """Write a robot description as YAML text; `parse_robot` reads the same robot back."""
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
    return {**plain, 'bends_as': section.bends_as}


def _plain_tendon(tendon: Tendon) -> dict[str, Any]:
    straight = tendon.base == tendon.end
    offset = (
        list(tendon.base) if straight else {'base': list(tendon.base), 'end': list(tendon.end)}
    )
    plain = {'name': tendon.name, 'offset': offset, 'section': tendon.section}
    return plain if tendon.group is None else {**plain, 'group': tendon.group}
