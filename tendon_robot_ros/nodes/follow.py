"""
Take the running controller along a path: FILE.csv, or what a recording (BAG) was sent.

A CSV file has the columns x,y,z [m] in the base frame; as you like dx,dy,dz (where the tip looks)
and time [s]. Or time and the robot's tendons, in newtons; in metres where the controller is in
pull mode. Slower than `time` where the limits ask for it. A table and a picture say what was
reached.

example: python -m tendon_robot_ros follow sweep.csv --retreat
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..analysis.flight import Flight
from ..control.path import TipPath, set_points, tip_path
from ..control.path_plan import Pace, Plan, plan
from ..data.bag_moves import read_moves
from ..data.bag_reader import is_bag
from ..data.path_file import TendonRows, TipRows, read_path
from ..exceptions import InputError
from ..report.flight_picture import PICTURES, draw_flight
from ..report.flight_text import lines
from .flying import fly_back, fly_tendons, fly_tips
from .pilot import Pilot, add_controller
from .runtime import ros

HELP = 'take the tip along a path, or replay a recording; say what was reached'
RATE = 50.0  # [Hz] of targets
FLAGS = {
    'backwards': 'from the last row to the first',
    'retreat': 'at the end go back by the way flown, the whole arm, to where it was before',
    'hold-direction': 'keep looking where the tip looks now, all along the path',
    'linear': 'straight lines between rows (default: a smooth curve through them)',
    'commands': 'of a recording: play its tendon commands, not its targets',
    'plan': 'say what would be done, move nothing',
    'anyway': 'start although part of the path is out of reach: as near as it can',
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add, pace = parser.add_argument, Pace()
    add('path', metavar='FILE', help='CSV file, rosbag2 folder, or .mcap or .db3 file')
    for name, text in FLAGS.items():
        add(f'--{name}', action='store_true', help=text)
    for name, value, text in (
        ('speed', 1e3 * pace.speed, 'mm/s of the tip'),
        ('turning', math.degrees(pace.turning), '°/s of its direction'),
        ('tension-rate', pace.tension, 'N/s of every tension'),
        ('pull-rate', 1e3 * pace.pull, 'mm/s of every wire, in pull mode'),
    ):
        text = f'at most so many {text} (default: {value:.3g})'
        add(f'--{name}', type=float, default=value, metavar='LIMIT', help=text)
    add('--picture', default='follow.png', metavar='PNG', help='(default: follow.png)')
    add_controller(parser)


def run(args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
    """Follow and report; Ctrl-C leaves the arm at the target of the moment."""
    pace = _pace(args)
    if Path(args.picture).suffix not in PICTURES:
        raise InputError(f'--picture {args.picture}: end the name with {", ".join(PICTURES)}')
    with ros(ros_arguments) as ending:
        pilot = Pilot('follow', args.controller, ending)
        try:
            return _follow(pilot, args, pace)
        finally:
            pilot.destroy_node()


def _follow(pilot: Pilot, options: argparse.Namespace, pace: Pace) -> int:
    pilot.connect()
    rows = _read(options, pilot)
    if isinstance(rows, TendonRows):
        flight = _tendons(pilot, rows, options, pace)
    else:
        flight = _tips(pilot, rows, options, pace)
    if flight is None:
        return 0
    said = lines(flight)
    print('\n'.join(said))
    title = f'{Path(options.path).name}: asked and reached'
    print(f'picture: {draw_flight(flight, options.picture, title)}', flush=True)
    if options.retreat:
        fly_back(pilot, pace)
        print('retreated by the way flown')
    return 0


def _tips(pilot: Pilot, rows: TipRows, options: argparse.Namespace, pace: Pace) -> Flight | None:
    directions = rows.directions
    if options.hold_direction:
        directions = np.tile(pilot.tip()[1], (len(rows.positions), 1))
    if rows.held:
        assert rows.times is not None
        path = set_points(rows.times, rows.positions, directions)
    else:
        path = tip_path(rows.times, rows.positions, directions, smooth=not options.linear)
    if options.backwards:
        path = path.backwards()
    model = pilot.model()
    start = model.shape(_tensions(pilot, model.limits))
    planned = plan(model, path, pace, start)
    print(_outlook(path, planned, rows.times is not None))
    if problem := planned.out_of_reach():
        if not (options.anyway or options.plan):
            raise InputError(f'{options.path}: {problem}; nothing moved (--anyway would)')
        print(problem)
    elif detour := planned.detour():
        print(detour)
    return None if options.plan else fly_tips(pilot, planned, RATE)


def _tendons(
    pilot: Pilot, rows: TendonRows, options: argparse.Namespace, pace: Pace
) -> Flight | None:
    times, values = rows.times, rows.values
    if options.backwards:
        times, values = times[-1] - times[::-1], values[::-1]
    print(f'{len(times)} rows of {"wire pulls" if pilot.pull else "tensions"}, {times[-1]:.1f} s')
    if options.plan:
        return None
    return fly_tendons(pilot, times, values, pace.pull if pilot.pull else pace.tension)


def _read(options: argparse.Namespace, pilot: Pilot) -> TipRows | TendonRows:
    """Read the file, or what a recording was sent: its targets, else its commands."""
    if not is_bag(options.path):
        return read_path(options.path, pilot.inputs)
    moves = read_moves(options.path)
    if len(moves.targets) and not options.commands:
        targets = moves.targets
        times = targets.times - targets.times[0]
        return TipRows(times, targets.positions, targets.directions, held=True)
    if moves.inputs and set(moves.inputs) == set(pilot.inputs) and moves.pull == pilot.pull:
        order = [moves.inputs.index(name) for name in pilot.inputs]
        kept = np.unique(np.append(np.arange(0, len(moves.commands), 20), len(moves.commands) - 1))
        times = moves.command_times[kept]
        return TendonRows(times - times[0], moves.commands[kept][:, order])
    raise InputError(
        f'{options.path}: its tendon_command holds {", ".join(moves.inputs) or "nothing"} in '
        f'{"pull" if moves.pull else "tension"} mode; the controller commands '
        f'{", ".join(pilot.inputs)} in {"pull" if pilot.pull else "tension"} mode'
    )


def _tensions(pilot: Pilot, limits: np.ndarray) -> np.ndarray:
    """Return the tensions at which the search begins; in pull mode nobody says them."""
    return limits[:, 0] if pilot.pull else pilot.commands()[1][-1]


def _outlook(path: TipPath, planned: Plan, timed: bool) -> str:
    length = np.linalg.norm(np.diff(path.positions, axis=0), axis=1).sum()
    asked = ''
    if timed and planned.duration > planned.asked + 0.01:
        asked = f' instead of {planned.asked:.1f} s, to keep the limits'
    return f'{len(path.rows)} rows, {1e3 * length:.0f} mm of path, {planned.duration:.1f} s{asked}'


def _pace(options: argparse.Namespace) -> Pace:
    given = options.speed, options.turning, options.tension_rate, options.pull_rate
    names = '--speed', '--turning', '--tension-rate', '--pull-rate'
    for name, value in zip(names, given, strict=True):
        if not 0.0 < value < 1e6:
            raise InputError(f'{name}: expected more than 0, got {value:g}')
    speed, turning, tension, pull = given
    return Pace(1e-3 * speed, math.radians(turning), tension, 1e-3 * pull)
