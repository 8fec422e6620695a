"""
Draw a recording: the path of the tip, how far it was from its targets, and the commands.

example: python -m tendon_robot_ros plot run1
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..common.errors import InputError
from ..common.files import file_to_write, refuse_ending
from ..data.path_files import Moves, Places, read_moves
from ..paths.path import PathRun
from ..report.pictures import draw_run
from .options import progress

HELP = 'draw a recording: tip, targets, commands'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder, or .mcap or .db3 file')
    to = file_to_write('--output')
    parser.add_argument('--output', type=to, metavar='PNG', help='(default: BAG.png)')


def run(args: argparse.Namespace) -> int:
    """Read and draw."""
    bag = Path(args.bag)
    output = Path(args.output or f'{bag.parent / bag.stem}.png')
    refuse_ending('--output', output)
    with progress() as show:
        show(f'reading {bag}', 0, 0)
        moves = read_moves(bag)
    if not len(moves.tips):
        raise InputError(f'{bag}: no measured_tip and no predicted_tip in it: nothing to draw')
    path_run = as_run(moves)
    seconds = float(path_run.tip_times[-1])
    print(
        f'{seconds:.1f} s, {len(moves.targets)} targets, {len(moves.tips)} tips'
        f'{"" if moves.measured else " as the model sees them"}, {len(moves.commands)} commands'
    )
    print(f'picture: {draw_run(path_run, output, f"{bag.name}, {seconds:.1f} s")}')
    return 0


def as_run(moves: Moves) -> PathRun:
    """Return a recording as a run; a target stands until the next one."""
    targets = standing_targets(moves, float(moves.tips.times[-1]))
    return PathRun(
        inputs=moves.inputs,
        target_times=targets.times,
        targets=targets.positions,
        target_directions=targets.directions,
        row_times=moves.targets.times,
        tip_times=moves.tips.times,
        tips=moves.tips.positions,
        tip_directions=moves.tips.directions,
        measured=moves.measured,
        command_times=moves.command_times,
        commands=moves.commands,
        pull=moves.pull,
    )


def standing_targets(moves: Moves, end: float) -> Places:
    """Return targets as a curve: each from its time to its end, then NaN until the next one."""
    targets = moves.targets
    if not len(targets):
        return targets
    until = np.append(targets.times[1:], max(end, targets.times[-1]))
    for i, time in enumerate(targets.times):
        over = moves.trajectory_times[moves.trajectory_times > time]
        until[i] = min([until[i], *over[:1]])
    times = np.column_stack([targets.times, until - 2e-6, until - 1e-6]).reshape(-1)
    positions = np.repeat(targets.positions, 3, axis=0)
    ended = until < np.append(targets.times[1:], np.inf)
    positions[2::3][ended] = np.nan
    return Places(times, positions, np.repeat(targets.directions, 3, axis=0))
