"""
Commands that ask the model: what the arm does, and where its tip can be.

model shape, reach, workspace, sweep; export mjcf.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import InputError, choice, whole
from ..common.files import file_to_write, new_file, new_folder, refuse_other_files, write_text
from ..common.results import plain
from ..common.words import columns, other_unit, typed
from ..data.path_files import TendonRows, TipRows, write_path
from ..drivers.tendon_check import STILL_TOLERANCE_M
from ..model.model import Model
from ..model.shape import Reach, Shape
from ..model.tip_task import Preferences
from ..report.page import Page
from ..robot.description import tendon_offsets
from ..robot.keep_out import load_keep_out
from . import options
from .options import emit, load_model, progress

WEIGHTS = 'low_tension', 'stiffness', 'slack', 'limit'
Result = tuple[Any, list[str], Callable[[Any], Page]]  # what was found, lines of it, its page


class ShapeCommand:
    """
    The shape is the equilibrium of the model with all effects that ROBOT lists.

    Names are those of the tendons; a group of tendons is pulled by the name of the group. A tendon
    that is not named is slack. With --pulls the wires are pulled by a length instead: the model
    finds the tensions, and a wire that is pulled less than the geometry asks for is slack.

    JSON: positions [n][3] in m, distal ends of the cells; bend [n][2] in rad; tensions
    {tendon: [per cell, 0 beyond its end]} in N; pulls {tendon: m}; tip {position, direction}.

    example: python -m tendon_robot_ros model shape config/robots/kato_10_1.yaml
        --tensions dist_right=0.51,dist_left=0.1
    """

    HELP = 'predict the shape under tensions or wire pulls'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'robot', '--effect-file')
        inputs = parser.add_mutually_exclusive_group(required=True)
        inputs.add_argument('--tensions', metavar='NAME=N,...', help='tensions [N]')
        inputs.add_argument('--pulls', metavar='NAME=MM,...', help='wire pulls')
        what = 'show tensions above the limits of the robot as well'
        parser.add_argument('--beyond-limits', action='store_true', help=what)
        options.declare(parser, '--unit', '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Solve and print."""
        if args.tensions is not None:
            tensions = options.named_numbers('--tensions', args.tensions, 'N')
            model = load_model(args)
            high = dict(zip(model.inputs, model.limits[:, 1].tolist(), strict=True))
            for name, tension in ({} if args.beyond_limits else tensions).items():
                if tension > high.get(name, math.inf):  # no motor of this robot may pull so much
                    raise InputError(
                        f'--tensions: {name} is {tension:g} N, above the limit of '
                        f'{high[name]:g} N in the description; say --beyond-limits to see it all '
                        'the same'
                    )
            shape = model.shape(tensions)
        else:
            pulls = options.named_lengths('--pulls', args.pulls, args.unit)
            model = load_model(args)
            largest, reach = max(map(abs, pulls.values())), model.robot.length
            if largest > reach or 0.0 < largest < STILL_TOLERANCE_M:
                numbers = ','.join(part.rpartition('=')[2] for part in args.pulls.split(','))
                mend = other_unit(numbers, largest, args.unit, STILL_TOLERANCE_M, reach)
                raise InputError(
                    f'--pulls: wires are pulled by up to {1e3 * largest:.4g} mm on an arm of '
                    f'{1e3 * reach:.4g} mm{mend}'
                )
            shape = model.pull_shape(pulls)
        emit(args, shape_content(model, shape), shape_table(model, shape))


def shape_content(model: Model, shape: Shape) -> dict[str, Any]:
    """Return what the JSON holds (SI)."""
    names = [tendon.name for tendon in model.robot.tendons]
    return {
        'positions': shape.positions.tolist(),
        'bend': shape.bend.tolist(),
        **({'twist': shape.twist.tolist()} if model.arrays.twists else {}),
        'tensions': dict(zip(names, shape.tendon_tensions.T.tolist(), strict=True)),
        'pulls': dict(zip(names, shape.tendon_pulls.tolist(), strict=True)),
        'tip': tip_content(shape),
    }


def tip_content(shape: Shape) -> dict[str, list[float]]:
    """Return position [m] and approach direction of the tip."""
    return {'position': shape.tip_position.tolist(), 'direction': shape.tip_direction.tolist()}


def tip_line(shape: Shape) -> str:
    """Format the position and direction of the tip."""
    at = ', '.join(f'{1e3 * value:.2f}' for value in shape.tip_position)
    along = ', '.join(f'{value:.3f}' for value in shape.tip_direction)
    return f'tip at ({at}) mm, direction ({along})'


def shape_table(model: Model, shape: Shape) -> str:
    """Return what a person reads: tip, bends of the sections, tensions and wire pulls."""
    robot, lines = model.robot, [tip_line(shape)]
    ends = np.cumsum([section.cells for section in robot.sections])
    for section, cells in zip(robot.sections, np.split(np.arange(ends[-1]), ends), strict=False):
        x, y = np.degrees(shape.bend[cells].sum(axis=0))
        line = f'{section.name}: bends {x:.2f}° towards x, {y:.2f}° towards y'
        if model.arrays.twists:
            line += f', twists {np.degrees(shape.twist[cells].sum()):.2f}°'
        lines.append(line)
    rows = [['tendon', 'tension [N]', 'at its end [N]', 'wire pull [mm]']]
    for k, tendon in enumerate(robot.tendons):
        along = shape.tendon_tensions[: robot.tendon_cells[k], k]
        numbers = along[0], along[-1], 1e3 * shape.tendon_pulls[k]
        rows.append([tendon.name, *(f'{number:.3f}' for number in numbers)])
    return '\n'.join([*lines, columns(rows)])


class ReachCommand:
    """
    Find tensions within ROBOT's limits for a target of the tip: position, direction, or both.

    The direction is the approach axis; roll about it is free. A target counts as reached within
    0.1 mm and 0.2 degrees. Otherwise the nearest tip is given: `at_limit` if more tension would
    reach the target, else `nearest`.

    JSON: tensions {name: N} and pulls {name: m} of what can be commanded (tendons, or groups of
    them); tip {position, direction}; error {position in m, direction in rad}; status; region (that
    keeps the arm away); tip_stiffness {x, y, z, softest} in N/m, null where nothing gives way.

    example: python -m tendon_robot_ros model reach config/robots/kato_10_1.yaml
        --position 60,0,150 --direction 1,0,0
    """

    HELP = 'find tensions for a target of the tip'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'robot', '--effect-file')
        add = parser.add_argument
        add('--position', nargs='+', metavar='X,Y,Z', help='of the tip, base frame')
        add('--direction', nargs='+', metavar='X,Y,Z', help='of the tip; its length is ignored')
        add('--keep-out', metavar='YAML', help='regions that no part of the arm may enter')
        what = f'what freedom is left is used for: {", ".join(WEIGHTS)} (docs/control.md)'
        add('--prefer', metavar='NAME=WEIGHT,...', help=what)
        options.declare(parser, '--unit', '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Search and print."""
        position, along = (
            None if parts is None else ','.join(part.strip(',') for part in parts)
            for parts in (args.position, args.direction)
        )
        direction = options.vector('--direction', along)
        if position is None and direction is None:
            raise InputError('target: expected --position, --direction, or both, got neither')
        model = load_model(args)
        target = options.position('--position', position, args.unit, model.robot.length)
        wants = preferences(args.prefer)
        regions = load_keep_out(args.keep_out) if args.keep_out else None
        reach = model.reach(target, direction, preferences=wants, keep_out=regions)
        emit(args, reach_content(model, reach), reach_table(model, reach))


def preferences(text: str | None) -> Preferences | None:
    """Read weights of preferences, None where there are none."""
    if text is None:
        return None
    weights = options.named_numbers('--prefer', text, '1')
    for name in weights:
        choice('--prefer', name, WEIGHTS)
    return replace(Preferences(low_tension=0.0), **weights)  # type: ignore[arg-type]


def stiffness_content(model: Model, reach: Reach) -> dict[str, float]:
    """Return the stiffness of the tip [N/m] along the axes, and where it is softest."""
    tip = model.tip_stiffness(reach.shape)
    along = {axis: tip.along(row) for axis, row in zip('xyz', np.eye(3).tolist(), strict=True)}
    return {**along, 'softest': tip.softest[0]}


def reach_content(model: Model, reach: Reach) -> dict[str, Any]:
    """Return what the JSON holds (SI)."""
    return {
        'tensions': dict(zip(model.inputs, reach.tensions.tolist(), strict=True)),
        'pulls': dict(zip(model.inputs, reach.pulls.tolist(), strict=True)),
        'tip': tip_content(reach.shape),
        'error': {'position': reach.position_error, 'direction': reach.direction_error},
        'status': reach.status,
        'region': reach.region,
        'tip_stiffness': plain(stiffness_content(model, reach)),
    }


def reach_table(model: Model, reach: Reach) -> str:
    """Return what a person reads: status, tip, stiffness, tensions and wire pulls."""
    limit = f' ({", ".join(reach.at_limit)} at the limit)' if reach.at_limit else ''
    limit += f' (kept out of {reach.region})' if reach.region else ''
    stiff = stiffness_content(model, reach)
    rows = [['input', 'tension [N]', 'wire pull [mm]']]
    for name, tension, pull in zip(model.inputs, reach.tensions, reach.pulls, strict=True):
        rows.append([name, f'{tension:.3f}', f'{1e3 * pull:.3f}'])
    off = f'{1e3 * reach.position_error:.3f} mm, {np.degrees(reach.direction_error):.3f}°'
    lines = [
        f'{reach.status}{limit}: off by {off}',
        tip_line(reach.shape),
        'the tip is {x:.3g}, {y:.3g}, {z:.3g} N/m stiff along x, y, z, at least '
        '{softest:.3g}'.format(**stiff),
    ]
    return '\n'.join([*lines, columns(rows)])


class WorkspaceCommand:
    """
    Show where the tip can be, over all tendons at once; or over pairs of them, at a view angle.

    Without --view, and for arms that bend in space, all tendons pull: random postures, then more
    from those at the edge. Tips are collected in cubes: how much space they fill, their hull,
    where the tip looks, what friction takes and adds. --view collects the tips at an angle between
    the tip's direction and the base's as well.

    For arms in a plane --view goes through the tensions of every pair of inputs in steps, the
    others at the pretension (Kato et al. 2015, section IV.B). Kept are the postures whose tip
    looks at a view angle, within --tolerance.

    After Ctrl-C or a lost computer the same command goes on; memory does not grow with the
    postures.

    OUTPUT holds postures.csv (a row per cube, or per kept posture: tensions [N], tip [m]),
    workspace.npz (all arrays) and workspace.html.

    example: python -m tendon_robot_ros model workspace config/robots/spatial_6.yaml
        --postures 3000 --output range_of_motion
    """

    HELP = 'where the tip can be: over all tendons, or over pairs at a view angle'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'robot', '--effect-file')
        add = parser.add_argument
        what, angle = 'view angle (may be given several times)', options.view_angle
        add('--view', action='append', type=angle, default=[], metavar='DEGREES', help=what)
        what = 'of all tendons, to sample (default: 100000)'
        add('--postures', type=int, metavar='N', help=what)
        add('--cubes', metavar='LENGTH', help='their edge (default: for ten postures in each)')
        add('--step', type=float, metavar='N', help='of the tensions of pairs (default: 0.1 N)')
        add('--pretension', type=float, metavar='N', help="default: the robot's lower limit")
        add('--tension-max', type=float, metavar='N', help="default: the robot's upper limit")
        what = 'the view angle may be missed by this (default: 2.5)'
        add('--tolerance', type=float, default=2.5, metavar='DEGREES', help=what)
        add('--output', metavar='DIR', help='folder for the results: CSV, npz and a page')
        add('--overwrite', action='store_true', help='replace results in that folder')
        options.add_cluster(parser)
        options.declare(parser, '--unit', '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Sample or sweep, print, write."""
        from ..workspace.view_angle import WORKSPACE_FILES
        from ..workspace.volume import KEPT

        folder = Path(args.output) if args.output else None
        model = load_model(args)
        in_pairs = bool(args.view) and not tendon_offsets(model.robot)[..., 1].any()
        kept = () if in_pairs else KEPT  # to go on from
        files = (*WORKSPACE_FILES, 'workspace.html')
        if folder and folder.exists():
            if any(path.name not in kept for path in folder.iterdir()) and not args.overwrite:
                raise InputError(f'{folder}: is not empty; use --overwrite or another --output')
            refuse_other_files(folder, (*files, *kept))
        for name in ('postures', 'cubes') if in_pairs else ('step',):
            if getattr(args, name) is not None:
                raise InputError(
                    f'--{name}: --view of an arm in a plane sweeps pairs in steps (--step); all '
                    'else samples all tendons (--postures, --cubes)'
                )
        explore = sweep_pairs if in_pairs else sample_all
        found, lines, page = explore(args, model)
        if folder:
            with new_folder(folder, (*files, *kept)) as draft:
                found.save(draft)
                page(found).write(draft / files[-1])
            lines.append(f'written: {", ".join(str(folder / name) for name in files)}')
        emit(args, found.to_json(), '\n'.join(lines))


def asked(args: argparse.Namespace) -> dict[str, Any]:
    """Return what is asked of pairs and of all tendons alike, in SI units."""
    return {
        'views': [math.radians(view) for view in args.view],
        'tolerance': math.radians(args.tolerance),
        'pretension': args.pretension,
        'limit': args.tension_max,
    }


def sweep_pairs(args: argparse.Namespace, model: Model) -> Result:
    """Sweep pairs of inputs at view angles."""
    from ..report.workspace_page import missing, rows, workspace_page
    from ..workspace.view_angle import Workspace

    with progress() as show:
        step = 0.1 if args.step is None else args.step
        workspace = Workspace(model, step=step, progress=show, **asked(args))
    size = (
        f'{workspace.postures:,} postures, {workspace.step:g} N apart up to {workspace.limit:g} N'
    )
    lines = [f'{size}, others at {workspace.pretension:g} N', *missing(workspace)]
    if workspace.families:
        lines.append(columns(rows(workspace)))
    if workspace.unsolved:
        lines.append(f'without equilibrium and left out: {workspace.unsolved:,}')
    return workspace, lines, workspace_page


def sample_all(args: argparse.Namespace, model: Model) -> Result:
    """Sample all tendons."""
    from ..common.workers import Workers
    from ..model.versions import Preparation, UserEffect
    from ..report.workspace_page import summary, volume_page
    from ..workspace.volume import Sampling, Volume

    kept = Path(args.output) if args.output else None
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
    prepare = Preparation.of_this_process(UserEffect.read(args.effect_file))
    with progress(remaining=True) as show, Workers(args.workers, args.cluster, prepare) as workers:
        postures = 100_000 if args.postures is None else args.postures
        edge = None if args.cubes is None else options.length('--cubes', args.cubes, args.unit)
        sampling = Sampling.of(model, postures, edge=edge, **asked(args))
        volume = Volume(sampling, show, workers, kept)
    return volume, summary(volume), volume_page


class Sweep:
    """
    Write a path along which the view angle stays, for `follow`.

    A robot of two sections in a plane keeps its direction while the tip moves through all postures
    that have it, from the highest to the lowest (section IV.B of Kato et al. 2015); a spatial
    robot looks once around. The path is a CSV file of tip targets, or of tensions, which need no
    inverse.

    example: python -m tendon_robot_ros model sweep config/robots/kato_10_1.yaml --view 180
    """

    HELP = 'write a path that keeps the view angle: looking around'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'robot', '--effect-file', '--json')
        add = parser.add_argument
        what = 'view angle (default: 180)'
        add('--view', type=float, default=180.0, metavar='DEGREES', help=what)
        add('--steps', type=int, default=40, metavar='N', help='rows (default: 40)')
        add('--tensions', action='store_true', help='tensions instead of tip targets')
        options.add_file(parser, '--output', '(default: sweep.csv)', 'CSV', default='sweep.csv')

    def run(self, args: argparse.Namespace) -> None:
        """Find the postures and write them."""
        from ..paths.path import Pace, stretched
        from ..workspace.view_angle import look_around

        if not 0.0 < args.view <= 180.0:
            raise InputError(f'--view: expected more than 0° and at most 180°, got {args.view:g}')
        whole('--steps', args.steps, 2)
        model = load_model(args)
        with progress() as show:
            show(f'looking for {args.steps} postures', 0, 0)
            shapes = look_around(model, math.radians(args.view), args.steps)
        places = np.array([shape.tip_position for shape in shapes])
        directions = np.array([shape.tip_direction for shape in shapes])
        rows: TipRows | TendonRows = TipRows(None, places, directions)
        if args.tensions:
            tensions = np.array([shape.inputs for shape in shapes])
            slow = 0.1 * Pace().tension  # [N/s] so that a person can follow it and stop
            rows = TendonRows(stretched(np.zeros(len(tensions)), tensions, slow), tensions)
        with new_file(Path(args.output)) as draft:
            write_path(draft, rows, model.inputs)
        low, high = 1e3 * places.min(axis=0), 1e3 * places.max(axis=0)
        each = zip('xyz', low, high, strict=True)
        spans = ', '.join(f'{axis} {a:.1f} to {b:.1f}' for axis, a, b in each)
        content = {'postures': len(shapes), 'tips': places.tolist(), 'written': args.output}
        text = f'{len(shapes)} postures at the {args.view:g}° view; tip {spans} mm'
        following = f'next: {typed("follow", args.output)}'
        emit(args, content, f'{text}\nwritten: {args.output}   {following}')


class ExportMjcf:
    """
    Write a robot as MJCF, for MuJoCo: stiffness, routes, offsets, weight and loads as described.

    A body per cell with hinge joints that are springs; actuators are the tendons, their controls
    tensions [N]. The head of the file lists what MuJoCo cannot say, such as friction that
    remembers; without that the arm comes to rest where the model has it, within 2 % of its length
    where cells bend by less than 0.3 rad.

    example: python -m tendon_robot_ros export mjcf config/robots/spatial_6.yaml spatial_6.xml
    """

    HELP = 'write a robot as MJCF, for MuJoCo'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'robot')
        what = 'the file (default: printed)'
        parser.add_argument('out', nargs='?', type=file_to_write('OUT'), metavar='OUT', help=what)
        options.declare(parser, '--overwrite', '--effect-file')

    def run(self, args: argparse.Namespace) -> None:
        """Write or print."""
        from ..model.mjcf import mjcf

        options.refuse_existing('OUT', args.out, args.overwrite)
        text = mjcf(options.load_model(args))
        if args.out is None:
            print(text, end='')
        else:
            write_text(args.out, text)
            print(f'written: {args.out}')
