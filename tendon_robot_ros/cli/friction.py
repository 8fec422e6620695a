"""
Measure the friction coefficient between wire and eyelet from slip angles.

SLIP_ANGLES is a CSV file with the columns measurement (a name) and angle_deg: the angle of a
slanted test piece at which the wire slips (Kato et al. 2015, section IV.A). The coefficient is the
tangent. Outliers are named and stay in the mean. With --robot and --output the coefficient is
written into a robot description as tendon_friction.

example: python -m tendon_robot_ros friction data/slip_angles/scale_10_1.csv \
    --robot robot.yaml --output with_friction.yaml
"""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from ..common.errors import InputError
from ..common.files import file_to_write
from ..common.words import listed
from ..paper.slip import SlipFriction, read_slip_angles, slip_friction, with_friction
from ..robot import load_robot
from .options import add_json, add_overwrite, emit, next_step, refuse_existing, write_description

HELP = 'friction coefficient from slip angles, into a robot description'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('angles', metavar='SLIP_ANGLES', help='CSV file: measurement,angle_deg')
    add('--robot', metavar='ROBOT', help='robot description to write the coefficient into')
    to = file_to_write('--output')
    add('--output', type=to, metavar='NEW', help='the new description')
    add_json(parser)
    add_overwrite(parser)


def run(args: argparse.Namespace) -> int:
    """Read, compute, write."""
    if (args.robot is None) != (args.output is None):
        raise InputError('friction: --robot and --output go together; give both or neither')
    refuse_existing('--output', args.output, args.overwrite)
    friction = slip_friction(*read_slip_angles(args.angles))
    text = lines(friction)
    if args.output:
        date = datetime.now(UTC).date().isoformat()
        robot = with_friction(load_robot(args.robot), friction, Path(args.angles).name, date)
        write_description(robot, args.output)
        text.append(next_step(args.output))
    emit(args, friction.to_json(), '\n'.join(text))
    return 0


def lines(friction: SlipFriction) -> list[str]:
    """Say what was found."""
    text = [
        f'friction coefficient: {friction.mean:.3f} ± {friction.sd:.3f} '
        f'(mean ± SD of the tangent, n = {friction.n})',
        f'95 % interval of the mean: {friction.low:.3f} to {friction.high:.3f}',
    ]
    if friction.outliers:
        text.append(
            f'outliers: {listed(friction.outliers)}; without them {friction.mean_without:.3f}. '
            'Look at how they were measured; nothing was removed.'
        )
    else:
        text.append('outliers: none')
    return text
