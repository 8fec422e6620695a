"""
Find tensions within ROBOT's limits for a target of the tip: position, direction, or both.

The direction is the approach axis; roll about it is free. A target counts as reached within 0.1 mm
and 0.2 degrees. Otherwise the nearest tip is given: `at_limit` if more tension would reach the
target, else `nearest`.

JSON: tensions {name: N} and pulls {name: m} of what can be commanded (tendons, or groups of
them); tip {position, direction}; error {position in m, direction in rad}; status; region (that
keeps the arm away); tip_stiffness {x, y, z, softest} in N/m, null where nothing gives way.

example: python -m tendon_robot_ros reach config/robots/kato_10_1.yaml \
    --position 60,0,150 --direction 1,0,0
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import InputError
from ..common.words import columns
from ..model.tip_task import Preferences
from ..robot.keep_out import load_keep_out
from .options import (
    add_json,
    add_robot,
    add_unit,
    emit,
    load_model,
    named_numbers,
    position,
    vector,
)
from .shape import tip_content, tip_line

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach

WEIGHTS = 'low_tension', 'stiffness', 'slack', 'limit'
HELP = 'find tensions for a target of the tip'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_robot(parser)
    parser.add_argument('--position', nargs='+', metavar='X,Y,Z', help='of the tip, base frame')
    add_unit(parser)
    what = 'of the tip; its length is ignored'
    parser.add_argument('--direction', nargs='+', metavar='X,Y,Z', help=what)
    parser.add_argument(
        '--keep-out', metavar='YAML', help='regions that no part of the arm may enter'
    )
    parser.add_argument(
        '--prefer',
        metavar='NAME=WEIGHT,...',
        help=f'what freedom is left is used for: {", ".join(WEIGHTS)} (docs/control.md)',
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Search and print."""
    position_text, direction_text = (
        None if parts is None else ','.join(part.strip(',') for part in parts)
        for parts in (args.position, args.direction)
    )
    direction = vector('--direction', direction_text)
    if position_text is None and direction is None:
        raise InputError('target: expected --position, --direction, or both, got neither')
    model = load_model(args)
    target = position('--position', position_text, args.unit, model.robot.length)
    wants = preferences(args.prefer)
    regions = load_keep_out(args.keep_out) if args.keep_out else None
    reach = model.reach(target, direction, preferences=wants, keep_out=regions)
    emit(args, reach_content(model, reach), reach_table(model, reach))
    return 0


def preferences(text: str | None) -> Preferences | None:
    """Read weights of preferences, None where there are none."""
    if text is None:
        return None
    weights = named_numbers('--prefer', text, '1')
    for name in weights:
        if name not in WEIGHTS:
            raise InputError(f'--prefer: expected one of {", ".join(WEIGHTS)}, got {name!r}')
    return replace(Preferences(low_tension=0.0), **weights)  # type: ignore[arg-type]


def stiffness_content(model: Model, reach: Reach) -> dict[str, float]:
    """Return the stiffness of the tip [N/m] along the axes, and where it is softest."""
    tip = model.tip_stiffness(reach.shape)
    along = {axis: tip.along(row) for axis, row in zip('xyz', np.eye(3).tolist(), strict=True)}
    return {**along, 'softest': tip.softest[0]}


def reach_content(model: Model, reach: Reach) -> dict[str, Any]:
    """Return what the JSON holds (SI)."""
    return {
        'tensions': dict(zip(model.inputs, reach.tensions.tolist(), strict=True)),
        'pulls': dict(zip(model.inputs, reach.pulls.tolist(), strict=True)),
        'tip': tip_content(reach.shape),
        'error': {'position': reach.position_error, 'direction': reach.direction_error},
        'status': reach.status,
        'region': reach.region,
        'tip_stiffness': {
            axis: value if np.isfinite(value) else None
            for axis, value in stiffness_content(model, reach).items()
        },
    }


def reach_table(model: Model, reach: Reach) -> str:
    """Return what a person reads: status, tip, stiffness, tensions and wire pulls."""
    limit = f' ({", ".join(reach.at_limit)} at the limit)' if reach.at_limit else ''
    limit += f' (kept out of {reach.region})' if reach.region else ''
    stiff = stiffness_content(model, reach)
    rows = [['input', 'tension [N]', 'wire pull [mm]']]
    for name, tension, pull in zip(model.inputs, reach.tensions, reach.pulls, strict=True):
        rows.append([name, f'{tension:.3f}', f'{1e3 * pull:.3f}'])
    return '\n'.join(
        [
            f'{reach.status}{limit}: off by {1e3 * reach.position_error:.3f} mm, '
            f'{np.degrees(reach.direction_error):.3f}°',
            tip_line(reach.shape),
            'the tip is {x:.3g}, {y:.3g}, {z:.3g} N/m stiff along x, y, z, at least '
            '{softest:.3g}'.format(**stiff),
            columns(rows),
        ]
    )
