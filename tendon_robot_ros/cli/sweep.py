"""
Write a path along which the view angle stays, for `follow`.

A robot of two sections in a plane keeps its direction while the tip moves through all postures
that have it, from the highest to the lowest (section IV.B of Kato et al. 2015); a spatial robot
looks once around. The path is a CSV file of tip targets, or of tensions, which need no inverse.

example: python -m tendon_robot_ros sweep config/robots/kato_10_1.yaml --view 180
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from ..common.errors import InputError
from ..common.files import file_to_write, new_file
from ..data.path_files import TendonRows, TipRows, write_path
from .options import add_robot, load_model, progress

HELP = 'write a path that keeps the view angle: looking around'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_robot(parser)
    parser.add_argument('--view', type=float, default=180.0, help='angle [°] (default: 180)')
    parser.add_argument('--steps', type=int, default=40, help='rows (default: 40)')
    parser.add_argument('--tensions', action='store_true', help='tensions instead of tip targets')
    to, what = file_to_write('--output'), '(default: sweep.csv)'
    parser.add_argument('--output', type=to, default='sweep.csv', metavar='CSV', help=what)


def run(args: argparse.Namespace) -> int:
    """Find the postures and write them."""
    from ..paths.path import Pace, stretched
    from ..workspace.view_angle import look_around

    if not 0.0 < args.view <= 180.0:
        raise InputError(f'--view: expected more than 0° and at most 180°, got {args.view:g}')
    if args.steps < 2:
        raise InputError(f'--steps: expected at least 2, got {args.steps}')
    model = load_model(args)
    with progress() as show:
        show(f'looking for {args.steps} postures', 0, 0)
        postures = look_around(model, math.radians(args.view), args.steps)
    places = np.array([posture.position for posture in postures])
    rows: TipRows | TendonRows = TipRows(None, places, np.array([p.direction for p in postures]))
    if args.tensions:
        tensions = np.array([posture.tensions for posture in postures])
        slow = 0.1 * Pace().tension  # [N/s] so that a person can follow it and stop
        rows = TendonRows(stretched(np.zeros(len(tensions)), tensions, slow), tensions)
    with new_file(Path(args.output)) as draft:
        write_path(draft, rows, model.inputs)
    low, high = 1e3 * places.min(axis=0), 1e3 * places.max(axis=0)
    spans = ', '.join(
        f'{axis} {a:.1f} to {b:.1f}' for axis, a, b in zip('xyz', low, high, strict=True)
    )
    print(f'{len(postures)} postures at the {args.view:g}° view; tip {spans} mm')
    print(f'written: {args.output}   next: python -m tendon_robot_ros follow {args.output}')
    return 0
