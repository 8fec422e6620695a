"""
Write a data set of a robot that does more than its description says.

The description beside the measurements is ROBOT as it stands; the robot that is measured also has
the hidden effects: names of the catalogue, or causes outside it (soft_cell,
stiffness_gradient, posture_gain, posture_rotation). Without parameters an effect has its typical
size; a value per section is written a/b. The measured robot differs from every model: finer cells,
the capstan's exponential, and, unless --exact, the ordinary imperfections of a robot as it is
built, which are printed: cells that scatter and are kinked, inputs, holes and a tracker that are
a little off. --level 2 builds it twice as badly.

example: python -m tendon_robot_ros simulate kato_10_1_single --output rehearsal
    --hidden hinge_friction soft_cell:cell=7,factor=0.5 --noise position=0.1
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

from ..common.arrays import Floats
from ..common.errors import InputError, whole
from ..common.words import UNITS, numbers, typed
from ..data import DataSet, Marker, even_markers, save_dataset
from ..data.dataset import INPUTS, PATHS, extent
from ..data.folder import refuse_dataset_in
from ..data.measurement_files import Commands
from ..effects import load_catalogue
from ..robot import Robot, load_robot
from ..simulation.hidden import Workmanship
from ..simulation.measurements import Laboratory, SimulatedNoise, raw_table, simulate, write_table
from ..simulation.plant import Plant, make_plant
from ..workspace.postures import SEQUENCE_FACTOR, default_postures
from . import options
from .options import emit, progress

HELP = 'write measurements of a robot with hidden effects, to rehearse with'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('robot', metavar='ROBOT', help='robot description, as its owner believes it')
    add('--hidden', nargs='+', action='extend', default=[], metavar='EFFECT[:NAME=VALUE,...]')
    add('--exact', action='store_true', help='build the robot just as it is described')
    level = 'how badly it is built (default: 1, as in an ordinary laboratory)'
    add('--level', type=float, default=1.0, metavar='X', help=level)
    scatter = "relative sd of the cells' stiffness (default: 0.03 times the level)"
    add('--scatter', type=float, metavar='SD', help=scatter)
    what = 'another seed: another robot, other noise'
    add('--seed', type=int, default=0, metavar='N', help=what)
    add('--gravity', metavar='X,Y,Z', help='[m/s²] in the base frame (default: as in ROBOT)')
    add('--output', metavar='DIR', help='folder of the data set')
    add('--check', metavar='DIR', help='a second data set: other postures of the same robot')
    what = 'instead: a table over time as laboratories have them'
    options.add_file(parser, '--table', what, 'CSV')
    add('--overwrite', action='store_true', help='replace data sets')
    usual = SimulatedNoise()
    what = 'a file like inputs.csv, or so many (default: 12, 20 in a sequence; a check has half)'
    add('--postures', metavar='N|CSV', default='', help=what)
    add('--trials', type=int, default=5, metavar='N', help='trials of a posture (default: 5)')
    default = f'position={1e3 * usual.position:g},setting={usual.setting:g},trial={usual.trial:g}'
    noise = (
        '1 sd of position [mm] and of the inputs, setting (shared by the trials of a posture) and '
        'trial: relative to a tension, or of a wire length to the distance of the outermost '
        f'tendon from the backbone; default: {default}'
    )
    add('--noise', default='', metavar='NAME=VALUE,...', help=noise)
    add('--undeclared', action='store_true', help='do not write the noise into dataset.yaml')
    add('--input', choices=INPUTS, default='tension', help='what the motors set')
    reached = 'how postures are reached (visits: trials in a random order, none from straight)'
    add('--path', choices=PATHS, default='from_straight', help=reached)
    markers = 'so many, evenly spaced, or at these arc lengths [mm] (default: one per cell)'
    add('--markers', metavar='N|S,S,...', help=markers)
    options.declare(parser, '--json', '--effect-file')


def run(args: argparse.Namespace) -> None:
    """Write the data sets."""
    robot = load_robot(args.robot)
    if gravity := options.vector('--gravity', args.gravity or None):
        robot = replace(robot, gravity=(gravity[0], gravity[1], gravity[2]))
    hidden = hidden_effects(args.hidden)
    if 'gravity' in hidden and not any(robot.gravity or ()):
        raise InputError(
            'hidden gravity: ROBOT does not say where down is; give --gravity 0,0,9.81'
        )
    if bool(args.output) == bool(args.table):
        raise InputError('--output DIR or --table CSV: expected one of them')
    paths = [*filter(None, (args.output or args.table, args.check))]
    for option, path in zip(('--table', '--check'), paths, strict=False):
        if args.table:
            options.refuse_existing(option, path, args.overwrite)
        else:
            refuse_dataset_in(path, args.overwrite)
    catalogue = load_catalogue(args.effect_file)
    work = Workmanship().times(0.0 if args.exact else args.level)
    work = work if args.scatter is None else replace(work, stiffness=args.scatter)
    plant = make_plant(robot, hidden, seed=args.seed, catalogue=catalogue, work=work)
    write = write_tables if args.table else write_datasets
    written = dict(zip(paths, write(args, plant, paths), strict=True))
    table = ('import', 'table', args.table, '--robot', args.robot)
    following = typed(*(('compare', args.output) if args.output else table))
    built = [] if args.exact else list(plant.built.text(plant.robot))
    lines = [f'written: {path}: {what}' for path, what in written.items()]
    lines.append(f'hidden:  {", ".join(args.hidden) or "nothing"}')
    lines += [*(f'built:   {line}' for line in built), f'next:    {following}']
    emit(args, {'written': written, 'hidden': args.hidden, 'built': built}, '\n'.join(lines))


def write_datasets(args: argparse.Namespace, plant: Plant, folders: list[str]) -> Iterator[str]:
    """Write a data set, and that of a check; yield the size of each."""
    datasets = [_measured(args, plant, which) for which in range(len(folders))]
    for folder, dataset in zip(folders, datasets, strict=True):
        save_dataset(dataset, folder, args.overwrite)
        yield extent(dataset.trials, dataset.inputs, len(dataset.markers))


def write_tables(args: argparse.Namespace, plant: Plant, paths: list[str]) -> Iterator[str]:
    """Write a table over time, and that of a check; yield the size of each."""
    if args.input != 'tension' or args.path != 'from_straight':
        raise InputError('--table: of tensions and from straight only')
    for which, path in enumerate(paths):
        with progress() as show:
            names, values = raw_table(
                plant,
                _default_postures(args, plant.robot, which),
                noise=simulated_noise(args.noise),
                lab=Laboratory(trials=args.trials),
                seed=args.seed,
                which=which,
                markers=_markers(args.markers, plant.robot),
                progress=show,
            )
        write_table(path, names, values)
        rows, columns = values.shape
        yield f'{rows:,} rows of {columns} columns, {values[-1, 0]:.0f} s'


def _measured(args: argparse.Namespace, plant: Plant, which: int) -> DataSet:
    """Measure the postures (0), or those of the check (1)."""
    robot, names = plant.robot, tuple[str, ...]()
    if args.postures and not is_number(args.postures) and which == 0:
        commands = Commands(
            Path(args.postures), robot, args.input, remedy='name a CSV file like inputs.csv'
        )
        (inputs, _), names = commands.by_posture(commands.trials or ()), commands.postures
    else:
        inputs = _default_postures(args, robot, which)
    with progress() as show:
        return simulate(
            plant,
            inputs,
            noise=simulated_noise(args.noise),
            trials=args.trials,
            seed=2 * args.seed + which,
            markers=_markers(args.markers, robot),
            postures=names,
            input=args.input,
            path=args.path,
            declare=not args.undeclared,
            progress=show,
        )


def is_number(text: str) -> bool:
    """Tell whether postures or markers are given by their number."""
    return text.removeprefix('-').isdecimal()


def _default_postures(args: argparse.Namespace, robot: Robot, which: int) -> Floats:
    """Return as many default postures as are wanted, for a check half of them."""
    count = round(12 * SEQUENCE_FACTOR) if args.path == 'sequence' else 12
    if is_number(args.postures):
        count = whole('--postures', int(args.postures), 1)
    return default_postures(robot, max(count // (1 + which), 1), which, args.input, args.path)


def hidden_effects(texts: Sequence[str]) -> dict[str, dict[str, float | tuple[float, ...]]]:
    """Read what is hidden, each once."""
    hidden = dict(map(hidden_effect, texts))
    if len(hidden) < len(texts):
        raise InputError(f'--hidden: expected each effect once, got {", ".join(texts)}')
    return hidden


def hidden_effect(text: str) -> tuple[str, dict[str, float | tuple[float, ...]]]:
    """Read EFFECT[:NAME=VALUE,...]."""
    name, _, rest = text.partition(':')
    values: dict[str, float | tuple[float, ...]] = {}
    for part in filter(None, rest.split(',')):
        key, equals, value = part.partition('=')
        if not equals:
            comma = ' (a decimal comma? write a point)' if part[:1].isdigit() else ''
            raise InputError(f'hidden {name}: expected NAME=VALUE, got {part!r}{comma}')
        read = numbers(f'{name}: {key}', value, '/')
        values[key] = read if len(read) > 1 else read[0]
    return name, values


def simulated_noise(text: str) -> SimulatedNoise:
    """Read position=MM,setting=SD,trial=SD."""
    known = [field.name for field in fields(SimulatedNoise)]
    values = options.named_numbers('--noise', text, 'mm, or relative') if text else {}
    for key in values:
        if key not in known:
            raise InputError(f'--noise: expected {", ".join(known)}, got {key!r}')
    if 0.0 < values.get('position', 1.0) < UNITS['length']['µm'] / UNITS['length']['mm']:
        raise InputError(
            f'--noise: position={values["position"]:g} mm is no noise of a tracker; write mm'
        )
    return SimulatedNoise(**{k: 1e-3 * v if k == 'position' else v for k, v in values.items()})


def _markers(text: str | None, robot: Robot) -> tuple[Marker, ...] | None:
    if not text:
        return None
    if is_number(text):
        return even_markers(robot, whole('--markers', int(text), 1))
    places = numbers('--markers', text, ',')
    return tuple(Marker(str(i + 1), 1e-3 * place) for i, place in enumerate(places))
