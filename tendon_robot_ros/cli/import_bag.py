"""
Make a data set from a rosbag2 recording: wherever the arm stands still, it was measured.

The recording holds the tendon states (sensor_msgs/JointState) and the shape: one
geometry_msgs/PoseArray with a pose per marker, or a geometry_msgs/PoseStamped topic or a frame of
/tf per marker. Markers in another frame than the base's are taken there by the transforms in the
recording, else their frame is found as import-table does. Still segments with the same inputs are
trials of one posture. Look at the picture before you trust them.

example: python -m tendon_robot_ros import-bag run.mcap --robot robot.yaml --output data/run
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ..common.errors import InputError
from ..common.files import file_to_write, refuse_ending
from ..data import DataSet, save_dataset
from ..data.folder import read_text, refuse_dataset_in
from ..data.recording.importing import Imported, draw_segments, import_bag, summary
from ..data.recording.reader import Topics, is_base
from ..data.recording.still_segments import Rule
from ..tables.recipe import METHODS, UPS, FrameChoice, Recipe
from .options import input_size, pairs, progress

HELP = 'make a data set from a ROS 2 recording'


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    to = file_to_write('--picture')
    add('--picture', type=to, metavar='PNG', help='draw the segments (.png, .svg, .pdf)')
    speed, duration = 1e3 * rule.speed, rule.duration
    what = f'slower is still (default: {speed:g})'
    add('--speed', type=float, default=speed, metavar='MM/S', help=what)
    what = f'at least so long [s] (default: {duration:g})'
    add('--duration', type=float, default=duration, help=what)
    what = (
        'inputs that differ by more belong to different postures, as 0.05N or 0.2mm '
        '(default: 1 %% of the tension limit, 0.2 %% of the length)'
    )
    add('--change', metavar='X', help=what)
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
        "how a tracker's frame is found, as of import-table; base: it is the base frame "
        '(default: base where the frame is called so or transforms lead there, else level or '
        'model)'
    )
    add('--frame', choices=METHODS, help=what)


def run(args: argparse.Namespace) -> int:
    """Import the recording."""
    change, rest = input_size('--change', args.change), input_size('--rest', args.rest)
    limits = args.speed, args.duration, 1.0 if change is None else change
    if not all(0 < value < 1e4 for value in limits):
        raise InputError('--speed [mm/s], --duration [s] and --change are above 0')
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
        for line in imported.left_out:
            print('left out:', line, file=sys.stderr)
        print(summary(imported))
        show('looking at the frame', 1, 2)
        dataset, lines = placed(imported, args.frame, args.up)
    for line in lines:
        print(line)
    print(f'written: {save_dataset(dataset, args.output, args.overwrite)}')
    if args.picture:
        print(f'picture: {draw_segments(imported, args.picture)}')
    return 0


def placed(imported: Imported, method: str | None, up: str | None) -> tuple[DataSet, list[str]]:
    """Return the data set in the base frame, and lines about its registration."""
    from ..effects import load_catalogue
    from ..tables.imported import frame_lines, labelled_lines
    from ..tables.registration import place

    known = is_base(imported.frame)
    choice = FrameChoice(method or ('base' if known else None))
    try:
        placing = place(imported.dataset, Recipe(up=up, frame=choice), load_catalogue(()))
    except InputError as error:
        if not known or method is not None:
            raise
        return imported.dataset, [f'the frame was not checked: {error}']
    if choice.method == 'base':  # as it is; what contradicts it is said
        return imported.dataset, labelled_lines('LOOK', placing.frame_warnings)
    lines = labelled_lines(
        'frame', [f'{imported.frame!r}, which no transform joins with the base']
    )
    lines += labelled_lines('', frame_lines(placing.frame, placing.dataset.robot))
    return placing.dataset, lines + labelled_lines('dropped', placing.dropped) + labelled_lines(
        'LOOK', placing.warnings
    )
