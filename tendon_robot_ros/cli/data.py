"""
Commands that make data sets of recordings and tables, and recordings of data sets.

import bag, import table, export bag; plot.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..common.files import TABLE_ENDINGS, YAML_ENDINGS, refuse_ending
from ..common.words import read_unit, typed
from ..data import DataSet, load_dataset, save_dataset
from ..data.bag_reader import Topics
from ..data.bag_writer import STORAGES, Timing, export_bag
from ..data.dataset import PATHS
from ..data.folder import read_text, refuse_dataset_in
from ..data.loading import Imported, draw_segments, import_bag, summary
from ..data.path_files import read_moves
from ..data.still_segments import Rule
from ..effects import load_catalogue
from ..report.pictures import draw_run
from ..robot import load_robot
from ..tables import import_table
from ..tables.columns import UPS
from ..tables.imported import frame_lines, labelled_lines
from ..tables.markers import CHOICES
from ..tables.recipe import INPUT_KINDS, METHODS, FrameChoice, Recipe, load_recipe
from ..tables.registration import Placed
from . import options
from .options import emit, input_size, length, pairs, progress


class ImportBag:
    """
    Make a data set from a rosbag2 recording: wherever the arm stands still, it was measured.

    The recording holds the tendon states (sensor_msgs/JointState) and the shape: one
    geometry_msgs/PoseArray with a pose per marker, or a geometry_msgs/PoseStamped topic or a frame
    of /tf per marker. Markers in another frame than the base's are taken there by the transforms
    in the recording, else their frame is found as `import table` does. Still segments with the
    same inputs are trials of one posture. Look at the picture before you trust them.

    example: python -m tendon_robot_ros import bag tentacle.mcap --output run
    """

    HELP = 'make a data set from a ROS 2 recording'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add, rule, topics = parser.add_argument, Rule(), Topics()
        add('bag', metavar='BAG', help='rosbag2 folder, or .mcap or .db3 file')
        add('--output', required=True, metavar='DIR', help='folder of the data set')
        add('--overwrite', action='store_true', help='replace a data set in DIR')
        add('--robot', help='robot description (default: the one in the recording)')
        what = (
            'a dataset.yaml that says input, path, gravity, markers (default: the one in the '
            'recording, else tensions where they were observed and one marker per cell)'
        )
        add('--description', metavar='YAML', help=what)
        options.add_file(parser, '--picture', 'draw the segments (.png, .svg, .pdf)', 'PNG')
        speed, duration = 1e3 * rule.speed, rule.duration
        what = f'slower is still (default: {speed:g})'
        add('--speed', type=float, default=speed, metavar='MM/S', help=what)
        what = f'at least so long [s] (default: {duration:g})'
        add('--duration', type=float, default=duration, help=what)
        what = (
            'inputs that differ by less belong to one posture, as 0.05N or 0.2mm '
            '(default: 1 %% of the tension limit, 0.2 %% of the length)'
        )
        add('--same', metavar='X', help=what)
        what = 'leave segments out whose inputs are all below this, as 0.15N or 0.5mm'
        add('--rest', metavar='X', help=what)
        what = f'sensor_msgs/JointState (default: {topics.states})'
        add('--states-topic', default=topics.states, metavar='TOPIC', help=what)
        what = f'geometry_msgs/PoseArray (default: {topics.shape})'
        add('--shape-topic', default=topics.shape, metavar='TOPIC', help=what)
        what = (
            'geometry_msgs/PoseStamped, or frame of /tf, of one marker, instead of the shape; '
            'may be repeated'
        )
        add('--marker', action='append', default=[], metavar='NAME=TOPIC', help=what)
        what = 'of several programs that published the states, the one with this in its frame_id'
        add('--sender', default=topics.sender, metavar='TEXT', help=what)
        add('--up', choices=UPS, help='axis of the tracker that points up')
        what = (
            "how a tracker's frame is found, as of `import table`; base: it is the base frame "
            '(default: base where the frame is called so or transforms lead there, else level or '
            'model)'
        )
        add('--frame', choices=METHODS, help=what)
        options.declare(parser, '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Import the recording."""
        change, rest = input_size('--same', args.same), input_size('--rest', args.rest)
        limits = args.speed, args.duration, 1.0 if change is None else change
        if not all(0 < value < 1e4 for value in limits):
            raise InputError('--speed [mm/s], --duration [s] and --same are above 0')
        refuse_dataset_in(args.output, args.overwrite)
        if args.picture:
            refuse_ending('--picture', args.picture)
        markers, description = pairs('--marker', args.marker, 'TOPIC'), None
        if args.description:
            description = read_text(Path(args.description), 'name a dataset.yaml')
        with progress() as show:
            show(f'reading {args.bag}', 0, 2)
            imported = import_bag(
                args.bag,
                args.robot,
                Rule(1e-3 * args.speed, args.duration, change),
                Topics(args.states_topic, args.shape_topic, markers, args.sender),
                description,
                rest,
                in_tracker_frame=True,
            )
            options.refuse_other_size(args, imported.dataset.input)
            for line in imported.left_out:
                print('left out:', line, file=sys.stderr)
            show('looking at the frame', 1, 2)
            dataset, lines = placed(imported, args.frame, args.up)
        folder = save_dataset(dataset, args.output, args.overwrite)
        lines = [summary(imported), *lines, f'written: {folder}']
        if args.picture:
            lines.append(f'picture: {draw_segments(imported, args.picture)}')
        emit(args, sizes(dataset, folder) | {'left_out': imported.left_out}, '\n'.join(lines))


def sizes(dataset: DataSet, folder: Path) -> dict[str, Any]:
    """Return for JSON how much a data set holds, and where it was written."""
    return {
        'postures': len(dataset.postures),
        'trials': int(dataset.trials.sum()),
        'markers': [marker.name for marker in dataset.markers],
        'written': str(folder),
    }


def placed(imported: Imported, method: str | None, up: str | None) -> tuple[DataSet, list[str]]:
    """Return the data set in the base frame, and lines about its registration."""
    known = imported.recording.in_base
    choice = FrameChoice(method or ('base' if known else None))
    try:
        placing = Placed(imported.dataset, Recipe(up=up, frame=choice), load_catalogue(()))
    except InputError as error:
        if not known or method is not None:
            raise
        return imported.dataset, [f'the frame was not checked: {error}']
    if choice.method == 'base':  # as it is; what contradicts it is said
        return imported.dataset, labelled_lines('LOOK', placing.frame_warnings)
    apart = f'{imported.recording.frame!r}, which no transform joins with the base'
    known_by = frame_lines(placing.frame, placing.dataset.robot)
    lines = labelled_lines('frame', [apart, *known_by])
    lines += labelled_lines('dropped', placing.dropped)
    return placing.dataset, lines + labelled_lines('LOOK', placing.warnings)


class ImportTable:
    """
    Make a data set of a table as laboratories have it: time, tensions, x, y, z of every marker.

    RAW is .csv, .parquet, .c3d or an export of OptiTrack, Vicon, Qualisys, NDI or Cortex; several
    are recordings one after the other, or one of tensions and one of markers per recording. What a
    column is, is guessed from its name and shown; units are read from names ("T1 [N]", "m3_x
    (mm)", "time_s"). Where the arm stood still it was measured; the same inputs are trials of one
    posture; markers are put in order along the arm, and the tracker's frame is laid onto the
    robot's. DIR gets the data set, import.yaml with every choice (edit it, then import again with
    --recipe) and import.png: look at it before you trust it.

    example: python -m tendon_robot_ros import table data/mocap/raw.csv
        --robot data/mocap/arm.yaml --up y --output run
    """

    HELP = 'make a data set of a table of tensions and markers over time'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add = parser.add_argument
        add('raw', nargs='*', metavar='RAW', help='the tables (default: those of --recipe)')
        add('--robot', metavar='YAML', help='robot description (default: that of --recipe)')
        add('--output', metavar='DIR', required=True, help='folder of the data set')
        add('--overwrite', action='store_true', help='replace a data set in DIR')
        what = 'an import.yaml; other options go before what it says'
        add('--recipe', metavar='YAML', help=what)
        options.declare(parser, '--json', '--effect-file')
        add_arm(parser.add_argument_group('markers and frame'))
        add_columns(parser.add_argument_group('columns and units'))
        add_still(parser.add_argument_group('what is a measurement'))

    def run(self, args: argparse.Namespace) -> None:
        """Import, tell, write."""
        refuse_swapped(args)
        refuse_dataset_in(args.output, args.overwrite)
        recipe = load_recipe(args.recipe) if args.recipe else Recipe()
        if args.raw:  # another recording has other trials, and its clocks began at other times
            recipe = replace(recipe, leave_out=None, delay=None, drift=None)
        robot_path = args.robot or recipe.robot
        if robot_path is None:
            raise InputError('--robot: describe the arm with `robot new`, then name its file')
        robot = load_robot(robot_path)
        units, keys = given(args, robot.inputs)
        recipe = replace(recipe.with_keys(keys), **units)
        catalogue = load_catalogue(args.effect_file)
        with progress() as show:
            imported = import_table(args.raw, robot, recipe, catalogue, show)
        options.refuse_other_size(args, imported.dataset.input)
        text, folder = imported.text(), imported.save(args.output, args.overwrite)
        content = sizes(imported.dataset, folder) | {
            key: list(getattr(imported, key)) for key in ('assumed', 'dropped', 'look')
        }
        emit(
            args,
            content,
            f'{text}\nwritten: {folder}    every choice: {folder}/import.yaml    look: '
            f'{folder}/import.png\nnext:    {typed("compare", folder)}',
        )


def add_columns(group: argparse._ArgumentGroup) -> None:
    """Declare the roles of columns, and their units."""
    add = group.add_argument
    what = (
        'column of an input, or of time; may be repeated; time=none: every row was taken after '
        'the arm had settled'
    )
    add('--column', action='append', default=[], metavar='INPUT=COLUMN', help=what)
    what = 'where no name says it: inputs=g, positions=mm, time=ms; may be repeated'
    add('--unit', action='append', default=[], metavar='WHAT=UNIT', help=what)
    add('--spool', metavar='MM', help='radius at which the wire winds up, 10 or 0.4inch')
    add('--counts-per-turn', type=options.positive, metavar='N', help='where motors tell ticks')
    what = 'N·m/A at the spool, for currents'
    add('--torque-constant', type=options.positive, metavar='K', help=what)
    what = 'inputs count from where they are when the arm first stands still (default: of motors)'
    add('--zero', action='store_true', default=None, help=what)


def add_arm(group: argparse._ArgumentGroup) -> None:
    """Declare the places of the markers, and the method for the tracker's frame."""
    add = group.add_argument
    add('--up', choices=UPS, help='axis of the tracker that points up: gravity is known then')
    what = (
        'distances from the base along the arm [mm], base first (default: the last marker is at '
        'the tip, the others as far below as the arm between them is long)'
    )
    add('--markers', metavar='MM,MM,...', help=what)
    what = (
        'markers: each by itself; rims: markers around a disk give its centre; bodies: origins of '
        'rigid bodies (default: rims where markers are fixed around a circle, else markers)'
    )
    add('--points', choices=CHOICES, help=what)
    what = 'where markers sit beside the backbone [mm] in the frame there (default: on it)'
    add('--offset', metavar='X,Y', help=what)
    what = (
        'model: onto the postures of the model; level: the same, verticals together (default '
        "where --up and the robot's gravity are known); straight: the straight posture onto +z; "
        'base: it is the base frame'
    )
    add('--frame', choices=METHODS, help=what)


def add_still(group: argparse._ArgumentGroup) -> None:
    """Declare the thresholds of still segments and of equal postures."""
    add = group.add_argument
    what = 'slower is still (default: 2, or the noise)'
    add('--speed', type=options.positive, metavar='MM/S', help=what)
    add('--duration', type=options.positive, metavar='S', help='at least so long (default: 1)')
    what = 'inputs that differ by less belong to one posture, as 0.05N, or 0.2mm of pull'
    add('--same', metavar='X', help=what)
    what = 'where all inputs are below this the arm rests, as 0.2N or 0.5mm; 0: it never does'
    add('--rest', metavar='X', help=what)
    what = (
        'sequence: every posture was reached from the one before, in rounds of the same order; '
        'visits: the same in any order (default: from_straight, each loaded from the straight arm)'
    )
    add('--path', choices=PATHS, help=what)
    what = "the tracker's file begins so much after that of the inputs (default: found)"
    add('--delay', type=float, metavar='S', help=what)


def refuse_swapped(args: argparse.Namespace) -> None:
    """Raise InputError, before any work, if a path is another kind of file or a folder."""
    for path in args.raw:
        place, folder = Path(path), Path(path).parent
        if path.lower().endswith(YAML_ENDINGS):
            raise InputError(
                f'{path}: is no table; a robot description goes behind --robot, an import.yaml '
                'behind --recipe'
            )
        if place.is_dir():
            remedy = 'name the tables in it; the folder to write goes behind --output'
            if (place / 'dataset.yaml').is_file():
                remedy = f'compare it: {typed("compare", path)}'
            raise InputError(f'{path}: is a folder, and no table; {remedy}')
        if (folder / 'dataset.yaml').is_file():
            raise InputError(
                f'{path}: belongs to the data set {folder}, which needs no import; compare it: '
                f'{typed("compare", folder)}'
            )
        if not place.suffix and not place.exists():
            raise InputError(
                f'{path}: is not there; tables stand first, the folder to write behind --output'
            )
    for option, path in (('--robot', args.robot), ('--recipe', args.recipe)):
        if path and path.lower().endswith(TABLE_ENDINGS):
            raise InputError(f'{option} {path}: is a table; tables stand alone, without an option')
    if Path(args.output).is_file() or args.output.lower().endswith(TABLE_ENDINGS):
        raise InputError(
            f'--output {args.output}: expected the folder to write; tables stand alone, without '
            'an option'
        )


def given(
    args: argparse.Namespace, inputs: tuple[str, ...]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the units of columns that are guessed, and the keys of an import.yaml."""
    columns, units = pairs('--column', args.column), pairs('--unit', args.unit)
    for name in columns:
        if name != 'time' and name not in inputs:
            raise InputError(f'--column {name}=...: expected time or one of {", ".join(inputs)}')
    for name in units:
        if name not in ('inputs', 'positions', 'time'):
            raise InputError(f'--unit {name}=...: expected inputs, positions or time')
    kinds = {'inputs': INPUT_KINDS, 'positions': ('length',), 'time': ('time',)}
    units = {n: read_unit(f'--unit {n}', text, *kinds[n]).text for n, text in units.items()}
    time, unit = columns.pop('time', None), units.get('inputs', '')
    places = _lengths('--markers', args.markers)
    if places and any(b <= a for a, b in pairwise(places)):
        raise InputError('--markers: expected distances that grow, from base to tip [mm]')
    aside = _lengths('--offset', args.offset)
    if aside and len(aside) != 2:
        raise InputError(f'--offset: expected X,Y in mm, got {args.offset!r}')
    spool = None if args.spool is None else length('--spool', args.spool, 'mm')
    speed = None if args.speed is None else 1e-3 * args.speed
    keys = {
        'inputs': {n: {'column': c, 'unit': unit or None} for n, c in columns.items()},
        'zero': args.zero,
        'spool': {
            'radius': spool,
            'counts_per_turn': args.counts_per_turn,
            'torque_constant': args.torque_constant,
        },
        'positions': units.get('positions'),
        'points': args.points,
        'offset': [*aside, 0.0] if aside else None,
        'places': places,
        'up': args.up,
        'delay': args.delay,
        'still': {'speed': speed, 'duration': args.duration},
        'same': input_size('--same', args.same),
        'rest': input_size('--rest', args.rest),
        'path': args.path,
        'frame': args.frame and {'method': args.frame},
    }
    if time is not None:
        keys['time'] = {} if time == 'none' else {time: units.get('time', 's')}
    known = {key: value for key, value in keys.items() if value is not None}
    return {'input_unit': units.get('inputs'), 'time_unit': units.get('time')}, known


def _lengths(option: str, text: str | None) -> list[float] | None:
    """Read lengths with commas between them, mm unless they say otherwise, in metres."""
    return [length(option, part, 'mm') for part in text.split(',')] if text else None


class ExportBag:
    """
    Write a data set as a rosbag2 recording that Foxglove, PlotJuggler and `ros2 bag play` open.

    The arm holds still at every measurement and moves in straight lines between them. `import bag`
    gives the same data set back.

    example: python -m tendon_robot_ros export bag data/tentacle tentacle.mcap
    """

    HELP = 'write a data set as a ROS 2 recording'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add, default = parser.add_argument, Timing()
        add('data', metavar='DATA', help='folder of the data set')
        add('output', metavar='OUT', help='new folder, or new file that ends in .mcap')
        add('--robot', help='robot description instead of the one the data set names')
        add('--storage', choices=STORAGES, default='mcap', help='of a folder (default: mcap)')
        for name, value, text in (
            ('hold', default.hold, 'seconds that every measurement lasts'),
            ('move', default.move, 'seconds from one to the next'),
            ('rate', default.rate, 'messages per second'),
        ):
            add(f'--{name}', type=float, default=value, help=f'{text} (default: {value:g})')
        options.declare(parser, '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Write the recording."""
        timing = Timing(args.hold, args.move, args.rate)
        if not (0 < timing.hold < 1e4 and 0 < timing.move < 1e4 and 4 <= timing.rate <= 1e4):
            raise InputError(
                '--hold and --move are seconds above 0, --rate is from 4 (fewer messages show no '
                'arm at rest) to 10000'
            )
        dataset = load_dataset(args.data, args.robot)
        with progress() as show:
            show(f'writing {dataset.trials.sum()} measurements', 0, 0)
            path = export_bag(dataset, args.output, args.storage, timing)
        text = f'{dataset.trials.sum()} measurements, {len(dataset.postures)} postures'
        emit(args, sizes(dataset, path), f'{text}\nwritten: {path}')


class Plot:
    """
    Draw a recording: the path of the tip, how far it was from its targets, and the commands.

    example: python -m tendon_robot_ros plot run1
    """

    HELP = 'draw a recording: tip, targets, commands'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        parser.add_argument('bag', metavar='BAG', help='rosbag2 folder, or .mcap or .db3 file')
        options.add_file(parser, '--output', '(default: BAG.png)', 'PNG')
        options.declare(parser, '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Read and draw."""
        bag = Path(args.bag)
        output = Path(args.output or f'{bag.parent / bag.stem}.png')
        refuse_ending('--output', output)
        with progress() as show:
            show(f'reading {bag}', 0, 0)
            path_run, targets = read_moves(bag)
        tips = path_run.tips
        if not len(tips):
            raise InputError(f'{bag}: no measured_tip and no predicted_tip in it: nothing to draw')
        seconds = float(tips.times[-1])
        counts = {'targets': len(targets), 'tips': len(tips), 'commands': len(path_run.commands)}
        text = (
            f'{seconds:.1f} s, {len(targets)} targets, {len(tips)} tips'
            f'{"" if path_run.measured else " as the model sees them"}, '
            f'{len(path_run.commands)} commands'
        )
        picture = draw_run(path_run, output, f'{bag.name}, {seconds:.1f} s')
        content = {'seconds': seconds, **counts, 'measured': path_run.measured}
        emit(args, content | {'picture': str(picture)}, f'{text}\npicture: {picture}')
