"""
The shape is the equilibrium of the model with all effects that ROBOT lists.

Names are those of the tendons; a group of tendons is pulled by the name of the group. A tendon
that is not named is slack. With --pulls the wires are pulled by a length instead: the model
finds the tensions, and a wire that is pulled less than the geometry asks for is slack.

JSON: positions [n][3] in m, distal ends of the cells; bend [n][2] in rad; tensions
{tendon: [per cell, 0 beyond its end]} in N; pulls {tendon: m}; tip {position, direction}.

example: python -m tendon_robot_ros shape config/robots/kato_10_1.yaml \
    --tensions dist_right=0.51,dist_left=0.1
"""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import InputError
from ..common.words import columns, other_unit
from .options import add_json, add_robot, add_unit, emit, load_model, named_lengths, named_numbers

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

HELP = 'predict the shape under tensions or wire pulls'
# [m] less is no pull that a motor would make, but a number in metres
PULL_MIN_M = 5e-5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_robot(parser)
    inputs = parser.add_mutually_exclusive_group(required=True)
    inputs.add_argument('--tensions', metavar='NAME=N,...', help='tensions [N]')
    inputs.add_argument('--pulls', metavar='NAME=MM,...', help='wire pulls')
    add_unit(parser)
    what = 'show tensions above the limits of the robot as well'
    parser.add_argument('--beyond-limits', action='store_true', help=what)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Solve and print."""
    if args.tensions is not None:
        tensions = named_numbers('--tensions', args.tensions, 'N')
        model = load_model(args)
        high = dict(zip(model.inputs, model.limits[:, 1].tolist(), strict=True))
        for name, tension in ({} if args.beyond_limits else tensions).items():
            if tension > high.get(name, math.inf):  # no motor of this robot may pull so much
                raise InputError(
                    f'--tensions: {name} is {tension:g} N, above the limit of {high[name]:g} N in '
                    'the description; say --beyond-limits to see it all the same'
                )
        shape = model.shape(tensions)
    else:
        pulls = named_lengths('--pulls', args.pulls, args.unit)
        model = load_model(args)
        largest, reach = max(map(abs, pulls.values())), model.robot.length
        if largest > reach or 0.0 < largest < PULL_MIN_M:
            numbers = ','.join(part.rpartition('=')[2] for part in args.pulls.split(','))
            mend = other_unit(numbers, largest, args.unit, PULL_MIN_M, reach)
            raise InputError(
                f'--pulls: wires are pulled by up to {1e3 * largest:.4g} mm on an arm of '
                f'{1e3 * reach:.4g} mm{mend}'
            )
        shape = model.pull_shape(pulls)
    emit(args, shape_content(model, shape), shape_table(model, shape))
    return 0


def shape_content(model: Model, shape: Shape) -> dict[str, Any]:
    """Return what the JSON holds (SI)."""
    names = [tendon.name for tendon in model.robot.tendons]
    return {
        'positions': shape.positions.tolist(),
        'bend': shape.bend.tolist(),
        **({'twist': shape.twist.tolist()} if model.arrays.twists else {}),
        'tensions': dict(zip(names, shape.tendon_tensions.T.tolist(), strict=True)),
        'pulls': dict(zip(names, shape.tendon_pulls.tolist(), strict=True)),
        'tip': tip_content(shape),
    }


def tip_content(shape: Shape) -> dict[str, list[float]]:
    """Return position [m] and approach direction of the tip."""
    return {'position': shape.tip_position.tolist(), 'direction': shape.tip_direction.tolist()}


def tip_line(shape: Shape) -> str:
    """Format the position and direction of the tip."""
    at = ', '.join(f'{1e3 * value:.2f}' for value in shape.tip_position)
    along = ', '.join(f'{value:.3f}' for value in shape.tip_direction)
    return f'tip at ({at}) mm, direction ({along})'


def shape_table(model: Model, shape: Shape) -> str:
    """Return what a person reads: tip, bends of the sections, tensions and wire pulls."""
    robot, lines = model.robot, [tip_line(shape)]
    start = 0
    for section in robot.sections:
        x, y = np.degrees(shape.bend[start : start + section.cells].sum(axis=0))
        line = f'{section.name}: bends {x:.2f}° towards x, {y:.2f}° towards y'
        if model.arrays.twists:
            twist = np.degrees(shape.twist[start : start + section.cells].sum())
            line += f', twists {twist:.2f}°'
        lines.append(line)
        start += section.cells
    rows = [['tendon', 'tension [N]', 'at its end [N]', 'wire pull [mm]']]
    for k, tendon in enumerate(robot.tendons):
        along = shape.tendon_tensions[: robot.tendon_cells[k], k]
        rows.append(
            [
                tendon.name,
                f'{along[0]:.3f}',
                f'{along[-1]:.3f}',
                f'{1e3 * shape.tendon_pulls[k]:.3f}',
            ]
        )
    return '\n'.join([*lines, columns(rows)])
