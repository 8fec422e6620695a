"""
Write a data set as a rosbag2 recording that Foxglove, PlotJuggler and `ros2 bag play` open.

The arm holds still at every measurement and moves in straight lines between them. `import-bag`
gives the same data set back.

example: python -m tendon_robot_ros export-bag data/tentacle tentacle.mcap
"""

from __future__ import annotations

import argparse

from ..common.errors import InputError
from ..data import load_dataset
from ..data.recording.writer import STORAGES, Timing, export_bag
from .options import progress

HELP = 'write a data set as a ROS 2 recording'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    default = Timing()
    parser.add_argument('data', metavar='DATA', help='folder of the data set')
    parser.add_argument('output', metavar='OUT', help='new folder, or new file that ends in .mcap')
    parser.add_argument('--robot', help='robot description instead of the one the data set names')
    parser.add_argument(
        '--storage', choices=STORAGES, default='mcap', help='of a folder (default: mcap)'
    )
    for name, value, text in (
        ('hold', default.hold, 'seconds that every measurement lasts'),
        ('move', default.move, 'seconds from one to the next'),
        ('rate', default.rate, 'messages per second'),
    ):
        parser.add_argument(
            f'--{name}', type=float, default=value, help=f'{text} (default: {value:g})'
        )


def run(args: argparse.Namespace) -> int:
    """Write the recording."""
    timing = Timing(args.hold, args.move, args.rate)
    if not (0 < timing.hold < 1e4 and 0 < timing.move < 1e4 and 1 <= timing.rate <= 1e4):
        raise InputError('--hold and --move are seconds above 0, --rate is from 1 to 10000')
    dataset = load_dataset(args.data, args.robot)
    with progress() as show:
        show(f'writing {dataset.trials.sum()} measurements', 0, 0)
        path = export_bag(dataset, args.output, args.storage, timing)
    print(f'{dataset.trials.sum()} measurements, {len(dataset.postures)} postures')
    print(f'written: {path}')
    return 0
