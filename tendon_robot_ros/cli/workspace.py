"""
Show where the tip can be, over all tendons at once; or over pairs of them, at a view angle.

Without --view, and for arms that bend in space, all tendons pull: random postures, then more from
those at the edge. Tips are collected in cubes: how much space they fill, their hull, where the tip
looks, what friction takes and adds. --view collects the tips at an angle between the tip's
direction and the base's as well.

For arms in a plane --view goes through the tensions of every pair of inputs in steps, the others
at the pretension (Kato et al. 2015, section IV.B). Kept are the postures whose tip looks at a view
angle, within --tolerance.

After Ctrl-C or a lost computer the same command goes on; memory does not grow with the postures.

OUTPUT holds postures.csv (a row per cube, or per kept posture: tensions [N], tip [m]),
workspace.npz (all arrays) and workspace.html.

example: python -m tendon_robot_ros workspace config/robots/spatial_6.yaml --output range_of_motion
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import new_folder
from ..common.words import columns
from ..robot.description import tendon_offsets
from .options import add_cluster, add_json, add_robot, add_unit, emit, length, load_model, progress

if TYPE_CHECKING:
    from ..model.model import Model
    from ..workspace.view_angle import Workspace

HELP = 'where the tip can be: over all tendons, or over pairs at a view angle'
FILES = ('postures.csv', 'workspace.npz', 'workspace.html')
Result = tuple[dict[str, Any], list[str], Callable[[Path], None]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_robot(parser)
    add = parser.add_argument
    what = 'view angle (may be given several times)'
    add('--view', action='append', type=float, default=[], metavar='DEGREES', help=what)
    add('--postures', type=int, metavar='N', help='of all tendons, to sample (default: 100000)')
    add('--cubes', metavar='LENGTH', help='their edge (default: for ten postures in each)')
    add('--step', type=float, metavar='N', help='of the tensions of pairs (default: 0.1 N)')
    add('--pretension', type=float, metavar='N', help="default: the robot's lower limit")
    add('--limit', type=float, metavar='N', help="highest tension (default: the robot's)")
    what = 'the view angle may be missed by this (default: 2.5)'
    add('--tolerance', type=float, default=2.5, metavar='DEGREES', help=what)
    add('--output', metavar='DIR', help='folder for the results: CSV, npz and a page')
    add('--overwrite', action='store_true', help='replace results in that folder')
    add_cluster(parser)
    add_unit(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Sample or sweep, print, write."""
    folder = Path(args.output) if args.output else None
    if folder and folder.exists() and not args.overwrite:
        from ..workspace.volume import KEPT

        if any(path.name not in KEPT for path in folder.iterdir()):  # more than to go on from
            raise InputError(f'{folder}: is not empty; use --overwrite or another --output')
    model = load_model(args)
    in_pairs = bool(args.view) and not tendon_offsets(model.robot)[..., 1].any()
    unused = ('postures', 'cubes') if in_pairs else ('step',)
    for name in unused:
        if getattr(args, name) is not None:
            raise InputError(
                f'--{name}: --view of an arm in a plane sweeps pairs in steps (--step); all else '
                'samples all tendons (--postures, --cubes)'
            )
    content, lines, write = sweep_pairs(args, model) if in_pairs else sample_all(args, model)
    if folder:
        write(folder)
        lines.append(f'written: {", ".join(str(folder / name) for name in FILES)}')
    emit(args, content, '\n'.join(lines))
    return 0


def sweep_pairs(args: argparse.Namespace, model: Model) -> Result:
    """Sweep pairs of inputs at view angles."""
    from ..workspace.view_angle import find_workspace, save_workspace

    with progress() as show:
        workspace = find_workspace(
            model,
            [math.radians(view) for view in args.view],
            step=0.1 if args.step is None else args.step,
            pretension=args.pretension,
            tolerance=math.radians(args.tolerance),
            limit=args.limit,
            progress=show,
        )

    def write(folder: Path) -> None:
        from ..report.workspace_page import workspace_page

        page = workspace_page(workspace)
        with new_folder(folder, FILES) as draft:
            save_workspace(workspace, draft)
            page.write(draft / FILES[2])

    return workspace.to_json(), text(workspace), write


def text(workspace: Workspace) -> list[str]:
    """Return the table of pairs and what to know."""
    from ..report.workspace_page import FAMILY_COLUMNS, missing, rows

    size = (
        f'{workspace.postures:,} postures, {workspace.step:g} N apart up to {workspace.limit:g} N'
    )
    lines = [f'{size}, others at {workspace.pretension:g} N', *missing(workspace)]
    if workspace.families:
        lines.append(columns([FAMILY_COLUMNS, *rows(workspace)]))
    if workspace.unsolved:
        lines.append(f'without equilibrium and left out: {workspace.unsolved:,}')
    return lines


def sample_all(args: argparse.Namespace, model: Model) -> Result:
    """Sample all tendons."""
    from ..common.workers import Workers
    from ..model.versions import Preparation, UserEffect
    from ..report.workspace_page import summary, volume_page
    from ..workspace.volume import KEPT, Sampling, find_volume, save_volume

    low, high = model.robot.tension_limits
    kept = Path(args.output) if args.output else None
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
    prepare = Preparation.of_this_process(UserEffect.read(args.effect_file))
    with (
        progress(remaining=True) as show,
        Workers(args.workers, args.cluster, prepare) as workers,
    ):
        sampling = Sampling.of(
            model,
            postures=100_000 if args.postures is None else args.postures,
            views=[math.radians(view) for view in args.view],
            tolerance=math.radians(args.tolerance),
            limits=(
                low if args.pretension is None else args.pretension,
                high if args.limit is None else args.limit,
            ),
            edge=None if args.cubes is None else length('--cubes', args.cubes, args.unit),
        )
        volume = find_volume(sampling, show, workers, kept)

    def write(folder: Path) -> None:
        page = volume_page(volume)
        with new_folder(folder, (*FILES, *KEPT)) as draft:
            save_volume(volume, draft, FILES[:2])
            page.write(draft / FILES[2])

    return volume.to_json(), summary(volume), write
