"""
Take an effect out of a robot description.

Where `add` had replaced the values of an effect that was there before, these come back; remove
once more to take it out.

example: python -m tendon_robot_ros remove hinge_friction --robot better.yaml --output plain.yaml
"""

from __future__ import annotations

import argparse

from ..common.files import file_to_write
from ..diagnosis.add import restore
from ..robot import load_robot
from .options import add_overwrite, refuse_existing, write_description

HELP = 'take an effect out of a robot description'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('effect', metavar='EFFECT', help='an effect that ROBOT lists')
    parser.add_argument('--robot', required=True, metavar='ROBOT', help='description (YAML)')
    add, to = parser.add_argument, file_to_write('--output')
    add('--output', type=to, required=True, metavar='NEW', help='the new description')
    add_overwrite(parser)


def run(args: argparse.Namespace) -> int:
    """Remove and write."""
    refuse_existing('--output', args.output, args.overwrite)
    robot, back = restore(load_robot(args.robot), args.effect)
    write_description(robot, args.output)
    if back is None:
        print(f'removed: {args.effect}')
    else:
        shown = ', '.join(f'{key} = {value}' for key, value in back.items())
        print(f'{args.effect}: as before the fit again ({shown}); remove it once more to drop it')
    print(f'written: {args.output}')
    return 0
