"""
Send the tip of the running robot to a place in the base frame (mm), and say where it went.

example: python -m tendon_robot_ros go-to 60 0 170
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from ...common.errors import InputError
from ...common.rotations import angle_between
from ...common.words import TYPED_LENGTHS, other_unit, read_quantity
from ...report.pictures import place
from ..shared.robot_client import Pilot, add_controller
from ..shared.runtime import ros
from ..shared.timing import MOVE_TIMEOUT_S

HELP = 'send the tip to a place, say where it went'
# [m] of a tip from its base, so that a number in another unit is detected
DISTANCE_MIN_M = 1e-3
DISTANCE_MAX_M = 20.0  # [m] because the largest continuum arms have a few metres


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    for axis in 'xyz':
        parser.add_argument(axis, help='a number in --unit, or with its own: 60, 60mm, 0.06m')
    parser.add_argument(
        '--unit', choices=TYPED_LENGTHS, default=TYPED_LENGTHS[0], help='(default: mm)'
    )
    parser.add_argument(
        '--direction',
        type=float,
        nargs=3,
        metavar=('DX', 'DY', 'DZ'),
        help='where the tip is to look, of any length (default: as it comes)',
    )
    add_controller(parser)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Send a target and wait until the arm is at rest."""
    target, along = _target((args.x, args.y, args.z), args.unit), None
    if args.direction is not None:
        along = np.array(args.direction)
        size = float(np.linalg.norm(along))
        if not 1e-9 < size < np.inf:
            raise InputError(f'--direction: expected a direction, got {args.direction}')
        along /= size
    with ros(ros_arguments) as ending:
        pilot = Pilot('go_to', args.controller, ending)
        try:
            pilot.connect()
            pilot.clear()
            pilot.settle(pilot.send(target, along), MOVE_TIMEOUT_S, 'the arm to stand there')
            pilot.stand()
            tip, direction = pilot.tip()
            miss = f'{1e3 * np.linalg.norm(tip - target):.2f} mm'
            if along is not None:
                miss += f' and {np.degrees(angle_between(direction, along)):.2f}°'
            measured = pilot.tips()[0]
            print(
                f'tip at ({place(tip)}) mm{"" if measured else ", as the model sees it"}: '
                f'{miss} from the target; {pilot.status["message"]}'
            )
            return 0
        finally:
            pilot.destroy_node()


def _target(texts: Sequence[str], unit: str) -> np.ndarray:
    """Parse a position (3,) [m]; InputError: no tip is at that distance (another unit?)."""
    pairs = zip('xyz', texts, strict=True)
    target = np.array([read_quantity(axis, text, unit, 'length') for axis, text in pairs])
    distance = float(np.linalg.norm(target))
    if not DISTANCE_MIN_M < distance < DISTANCE_MAX_M:
        mend = other_unit(','.join(texts), distance, unit, DISTANCE_MIN_M, DISTANCE_MAX_M)
        raise InputError(
            f'target: {" ".join(texts)} {unit} is {1e3 * distance:.4g} mm from the base{mend}'
        )
    return target
