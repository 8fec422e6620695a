"""
Sweep the tensions and show where the tip can be at a view angle.

All tensions of every pair of inputs in steps, the other inputs at the pretension: opposite sides
and the same side where the robot has them (Kato et al. 2015, section IV.B). Kept are the postures
whose tip looks at a view angle (the tip's direction against the base's), within --tolerance.

OUTPUT holds postures.csv (one row per kept posture: tensions [N], tip [m], tip angle [rad]),
workspace.npz (the same with all cells: positions [m], bends [rad]) and workspace.html.

example: python -m tendon_robot_ros workspace config/robots/kato_1_1.yaml --view 180 --view 45
    --step 0.1 --pretension 0.1 --output range_of_motion
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from ..common.errors import InputError
from ..common.files import new_folder
from ..common.words import columns
from ..report.workspace_page import FAMILY_COLUMNS, missing, rows
from ..workspace.grid import WORKSPACE_FILES, Workspace, find_workspace, save_workspace
from .options import add_json, add_robot, emit, load_model, progress

HELP = 'where the tip can be at a view angle, over all pairs of tensions'
PAGE = 'workspace.html'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_robot(parser)
    add = parser.add_argument
    add(
        '--view',
        action='append',
        type=float,
        metavar='DEGREES',
        help='view angle (may be given several times; default: 180)',
    )
    add('--step', type=float, default=0.1, metavar='N', help='of the tensions (default: 0.1 N)')
    add('--pretension', type=float, metavar='N', help="default: the robot's lower limit")
    add('--limit', type=float, metavar='N', help="highest tension (default: the robot's)")
    add(
        '--tolerance',
        type=float,
        default=2.5,
        metavar='DEGREES',
        help='the view angle may be missed by this (default: 2.5)',
    )
    add('--output', metavar='DIR', help='folder for the results: CSV, npz and a page')
    add('--overwrite', action='store_true', help='replace results in that folder')
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Sweep, print, write."""
    folder = Path(args.output) if args.output else None
    if folder and folder.exists() and any(folder.iterdir()) and not args.overwrite:
        raise InputError(f'{folder}: is not empty; use --overwrite or another --output')
    with progress() as show:
        workspace = find_workspace(
            load_model(args),
            [math.radians(view) for view in args.view or [180.0]],
            step=args.step,
            pretension=args.pretension,
            tolerance=math.radians(args.tolerance),
            limit=args.limit,
            progress=show,
        )
    lines = text(workspace)
    if folder:
        write(workspace, folder)
        lines.append(
            f'written: {", ".join(str(folder / name) for name in (*WORKSPACE_FILES, PAGE))}'
        )
    emit(args, workspace.to_json(), '\n'.join(lines))
    return 0


def text(workspace: Workspace) -> list[str]:
    """Return the table and what to know."""
    size = (
        f'{workspace.postures:,} postures, {workspace.step:g} N apart up to {workspace.limit:g} N'
    )
    lines = [f'{size}, others at {workspace.pretension:g} N', *missing(workspace)]
    if workspace.families:
        lines.append(columns([FAMILY_COLUMNS, *rows(workspace)]))
    if workspace.unsolved:
        lines.append(f'without equilibrium and left out: {workspace.unsolved:,}')
    return lines


def write(workspace: Workspace, folder: Path) -> None:
    """Write the folder, whole or not at all."""
    from ..report.workspace_page import workspace_page

    page = workspace_page(workspace)
    with new_folder(folder, (*WORKSPACE_FILES, PAGE)) as draft:
        save_workspace(workspace, draft)
        page.write(draft / PAGE)
