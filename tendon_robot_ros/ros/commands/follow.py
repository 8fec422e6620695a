"""Commands that move the tip: `go-to` one position, `follow` a path."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...common.arrays import Floats
from ...common.errors import DataSetError, InputError
from ...common.files import file_to_write, refuse_ending
from ...common.results import JSON_OPTION, emit, narrate
from ...common.rotations import angle_between
from ...common.words import TYPED_LENGTHS, UNITS, digits, in_unit, other_unit, read_quantity
from ...control.inputs import Trajectory
from ...control.target_search import keep_out_refusal
from ...data.bag_reader import is_bag, opened
from ...data.csv_file import csv_text
from ...data.path_files import NO_PATH, PathRun, Places, TendonRows, TipRows, read_moves, read_path
from ...drivers.safety import CYCLE_MAX_S
from ...model.model import Model
from ...model.shape import Shape
from ...paths.path import Pace, Plan, retreat, set_points, stretched, thinned, tip_path
from ...report.pictures import draw_run, path_lines, place
from ...robot.keep_out import KeepOut, load_keep_out, text_of
from ..controller.topics import POINTS_MAX
from ..shared.robot_client import Pilot, TipSample, add_controller
from ..shared.runtime import ros
from ..shared.timing import MOVE_TIMEOUT_S, NEWS_PERIOD_S

FLAGS = {
    'backwards': 'from the last row to the first',
    'retreat': 'at the end go back by the way flown, the whole arm, to where it was before',
    'hold-direction': 'keep looking where the tip looks now, all along the path',
    'linear': 'straight lines between rows (default: a smooth curve through them)',
    'commands': 'of a recording: play its tendon commands, not its targets',
    'plan': 'say what would be done, move nothing',
    'anyway': 'start although part of the path is out of reach: as near as it can',
}
# option -> field of `Pace`, size of its unit in SI, meaning
PACES = {
    'speed': ('speed', UNITS['length']['mm'], 'mm/s of the tip'),
    'turning': ('turning', UNITS['angle']['deg'], '°/s of its direction'),
    'tension-rate': ('tension', UNITS['force']['N'], 'N/s of every tension'),
    'pull-rate': ('pull', UNITS['length']['mm'], 'mm/s of every wire, in pull mode'),
}
NEAR_M = UNITS['length']['mm']  # no tip is within a millimetre of its base
DISTANCE_MAX_M = 20.0  # [m] because the largest continuum arms have a few metres


class GoTo:
    """
    Send the tip of the running robot to a place in the base frame (mm), and say where it went.

    example: python -m tendon_robot_ros go-to 60 0 170
    """

    HELP = 'send the tip to a place, say where it went'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add = parser.add_argument
        for axis in 'xyz':
            add(axis, help='a number in --unit, or with its own: 60, 60mm, 0.06m')
        add('--unit', choices=TYPED_LENGTHS, default=TYPED_LENGTHS[0], help='(default: mm)')
        what = 'where the tip is to look, of any length (default: as it comes)'
        add('--direction', type=float, nargs=3, metavar=('DX', 'DY', 'DZ'), help=what)
        add_controller(parser)
        add('--json', **JSON_OPTION)

    def run(self, args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
        """Send a target and wait until the arm is at rest."""
        target, along = _target((args.x, args.y, args.z), args.unit), None
        if args.direction is not None:
            along = np.array(args.direction)
            size = float(np.linalg.norm(along))
            if not 1e-9 < size < np.inf:
                raise InputError(f'--direction: expected a direction, got {args.direction}')
            along /= size
        with ros(ros_arguments) as ending, Pilot('go_to', ending, args.controller) as pilot:
            pilot.connect()
            pilot.stand_at(target, along, 'the arm to stand there')
            tip, direction = pilot.tip()
            content = {'tip': tip.tolist(), 'error': float(np.linalg.norm(tip - target))}
            miss = f'{1e3 * content["error"]:.2f} mm'
            if along is not None:
                content['turned'] = float(angle_between(direction, along))
                miss += f' and {np.degrees(content["turned"]):.2f}°'
            content |= {'measured': pilot.tips()[0], 'status': pilot.status['message']}
            seen = '' if content['measured'] else ', as the model sees it'
            text = f'tip at ({place(tip)}) mm{seen}: {miss} from the target; {content["status"]}'
            emit(args, content, text)
        return 0


def _target(texts: Sequence[str], unit: str) -> np.ndarray:
    """Parse a position (3,) [m]; InputError: no tip is at that distance (another unit?)."""
    pairs = zip('xyz', texts, strict=True)
    target = np.array([read_quantity(axis, text, unit, 'length') for axis, text in pairs])
    distance = float(np.linalg.norm(target))
    if not NEAR_M < distance < DISTANCE_MAX_M:
        text = ' '.join(texts)
        mend = other_unit(text, distance, unit, NEAR_M, DISTANCE_MAX_M)
        far = f'{digits(1e3 * distance, 4)} mm from the base'
        raise InputError(f'target: {in_unit(text, unit)} is {far}{mend}')
    return target


class Follow:
    """
    Take the running controller along a path: FILE.csv, or what a recording (BAG) was sent.

    A CSV file has the columns x,y,z [m] in the base frame; as you like dx,dy,dz (where the tip
    looks) and time [s]. Or time and the robot's tendons, in newtons; in metres where the
    controller is in pull mode. Slower than `time` where the limits ask for it. A table and a
    picture say what was reached.

    example: python -m tendon_robot_ros follow sweep.csv --retreat
    """

    HELP = 'take the tip along a path, or replay a recording; say what was reached'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add, pace = parser.add_argument, Pace()
        add('path', metavar='FILE', help='CSV file, rosbag2 folder, or .mcap or .db3 file')
        for name, text in FLAGS.items():
            add(f'--{name}', action='store_true', help=text)
        for name, (field, unit, text) in PACES.items():
            value = getattr(pace, field) / unit
            text = f'at most so many {text} (default: {value:.3g})'
            add(f'--{name}', type=float, default=value, metavar='LIMIT', help=text)
        add('--keep-out', metavar='YAML', help='regions that no part of the arm may enter')
        to, what = file_to_write('--picture'), '(default: follow.png)'
        add('--picture', type=to, default='follow.png', metavar='PNG', help=what)
        add_controller(parser)
        add('--json', **JSON_OPTION)

    def run(self, args: argparse.Namespace, ros_arguments: Sequence[str]) -> int:
        """Follow and report; Ctrl-C leaves the arm at its present target."""
        pace = _pace(args)
        refuse_ending('--picture', args.picture)
        if is_bag(args.path):  # errors of the file are reported before the controller is needed
            with opened(args.path):
                pass
        elif not csv_text(Path(args.path), NO_PATH).strip():
            raise DataSetError(args.path, 'is empty', NO_PATH)
        if args.keep_out:
            load_keep_out(args.keep_out)
        with ros(ros_arguments) as ending, Pilot('follow', ending, args.controller) as pilot:
            pilot.connect()
            rows = _read(args, pilot)
            if isinstance(rows, TendonRows):
                path_run = _tendons(pilot, rows, args, pace)
            else:
                path_run = _tips(pilot, rows, args, pace)
            if path_run is not None:
                title = f'{Path(args.path).name}: asked and reached'
                picture = draw_run(path_run, args.picture, title)
                lines = [*path_lines(path_run), f'picture: {picture}']
                emit(args, path_run.to_json() | {'picture': str(picture)}, '\n'.join(lines))
                if args.retreat:
                    run_back(pilot, pace)
                    narrate(args, 'retreated by the way flown')
        return 0


def _tips(pilot: Pilot, rows: TipRows, options: argparse.Namespace, pace: Pace) -> PathRun | None:
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
    # start of the search; in pull mode the tensions are unknown
    start = model.shape(model.limits[:, 0] if pilot.pull else pilot.commands()[1][-1])
    regions = load_keep_out(options.keep_out) if options.keep_out else None
    planned = Plan(model, path, pace, start, regions)
    length = np.linalg.norm(np.diff(path.positions, axis=0), axis=1).sum()
    requested = float(path.times[-1])
    timed = rows.times is not None and planned.duration > requested + 0.01
    note = f' instead of {requested:.1f} s, to keep the limits' if timed else ''
    size = f'{len(path.rows)} rows, {1e3 * length:.0f} mm of path'
    narrate(options, f'{size}, {planned.duration:.1f} s{note}')
    if problem := planned.out_of_reach():
        if not (options.anyway or options.plan):
            raise InputError(f'{options.path}: {problem}; nothing moved (--anyway would)')
        narrate(options, problem)
    elif detour := planned.detour():
        narrate(options, detour)
    if regions and not options.anyway:
        current = _commanded_shape(pilot, model)
        change = float(np.abs(planned.tensions[0] - current.inputs).max())
        times = planned.path.times + change / pace.tension  # after the move to its start
        played = Trajectory(times, planned.tensions)
        if problem := _entry(model, current, played, regions, False):
            if not options.plan:
                raise InputError(f'{options.path}: {problem}')
            narrate(options, problem)
    if options.plan:
        return None
    with pilot.keeping_out(text_of(options.keep_out)) if regions else nullcontext():
        return run_tips(pilot, planned)


def _tendons(
    pilot: Pilot, rows: TendonRows, options: argparse.Namespace, pace: Pace
) -> PathRun | None:
    times, values = rows.times, rows.values
    if options.backwards:
        times, values = times[-1] - times[::-1], values[::-1]
    what, rate = ('wire pulls', pace.pull) if pilot.pull else ('tensions', pace.tension)
    narrate(options, f'{len(times)} rows of {what}, {times[-1]:.1f} s')
    current = pilot.commands()[1][-1]
    # the move to the first row, which does not jump, then the rows, slower where they would exceed
    # the rate
    times = max(float(np.abs(values[0] - current).max()) / rate, CYCLE_MAX_S) + stretched(
        times, values, rate
    )
    if options.keep_out:
        model, regions = pilot.model(), load_keep_out(options.keep_out)
        shape = _commanded_shape(pilot, model)
        if problem := _entry(model, shape, Trajectory(times, values), regions, pilot.pull):
            raise InputError(f'{options.path}: {problem}')
    return None if options.plan else run_tendons(pilot, times, values)


def _commanded_shape(pilot: Pilot, model: Model) -> Shape:
    """Return the predicted shape under the present command."""
    now = pilot.commands()[1][-1]
    return model.pull_shape(now) if pilot.pull else model.shape(now)


def _entry(model: Model, now: Shape, moves: Trajectory, regions: KeepOut, pull: bool) -> str:
    """Return why a trajectory enters a region, '' where it keeps out of all."""
    refusal = keep_out_refusal(model, now, moves, regions, pull)
    return str(refusal or '').removeprefix('tendon_trajectory: ')


def _read(options: argparse.Namespace, pilot: Pilot) -> TipRows | TendonRows:
    """Read the file, or the targets of a recording, else its commands."""
    if not is_bag(options.path):
        return read_path(options.path, pilot.inputs)
    moves, targets = read_moves(options.path)
    if len(targets) and not options.commands:
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


def _pace(options: argparse.Namespace) -> Pace:
    limits = {}
    for name, (field, unit, _) in PACES.items():
        value = getattr(options, name.replace('-', '_'))
        if not 0.0 < value < 1e6:
            raise InputError(f'--{name}: expected more than 0, got {value:g}')
        limits[field] = unit * value
    return Pace(**limits)


def run_tips(pilot: Pilot, plan: Plan) -> PathRun:
    """Go to the first row of a plan, send targets by its times, wait until the arm is at rest."""
    pilot.stand_at(*plan.at(0.0), 'the arm at the first row')
    began = due = time.monotonic()
    sent: list[TipSample] = []  # the targets
    passed = 0.0
    while passed < plan.duration or not sent:
        passed = min(time.monotonic() - began, plan.duration)
        position, direction = plan.at(passed)
        stamp = pilot.send(position, direction)
        view = np.full(3, np.nan) if direction is None else direction
        sent.append((passed, position, view))
        due += NEWS_PERIOD_S
        pilot.spin(max(due - time.monotonic(), 0.001))
        pilot.require_good()
    pilot.settle(stamp, MOVE_TIMEOUT_S, 'the arm at the last row')
    pilot.stand()
    sent.append((time.monotonic() - began, *sent[-1][1:]))  # a target holds until the next one
    rows = plan.path.times[plan.path.rows].copy()
    rows[-1] = sent[-1][0]  # the last row counts when the arm is at rest there
    return _path_run(pilot, began, sent, rows)


def run_tendons(pilot: Pilot, when: Floats, values: Floats) -> PathRun:
    """Play values (n, m) [N] or [m] of the tendons at times (n,) [s]."""
    sent = thinned(when, values) if len(when) > POINTS_MAX else np.arange(len(when))
    began = time.monotonic()
    pilot.play_to_the_end(Trajectory(when[sent], values[sent]), 'the end of the trajectory')
    pilot.stand()
    rows = when.copy()
    rows[-1] = time.monotonic() - began
    return replace(_path_run(pilot, began, [], rows), target_values=values)


def run_back(pilot: Pilot, pace: Pace) -> None:
    """Play the commands since the last `clear` backwards: the arm returns by its own path."""
    times, commands = pilot.commands()
    back = retreat(times, commands, pace.pull if pilot.pull else pace.tension)
    pilot.play_to_the_end(back, 'the arm back where it came from')


def _path_run(pilot: Pilot, began: float, sent: list[TipSample], rows: Floats) -> PathRun:
    measured, tip_times, tips, views = pilot.tips()
    command_times, commands = pilot.commands()
    during, commanded = tip_times >= began, command_times >= began
    return PathRun(
        inputs=pilot.inputs,
        targets=Places.of(sent),
        row_times=rows,
        tips=Places(tip_times[during] - began, tips[during], views[during]),
        measured=measured,
        command_times=command_times[commanded] - began,
        commands=commands[commanded],
        pull=pilot.pull,
    )
