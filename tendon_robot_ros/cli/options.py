"""Arguments that several commands share, measurements, progress, and where results go."""

from __future__ import annotations

import argparse
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ..common.errors import InputError, Progress, TendonRobotError, listener
from ..common.files import file_to_write, write_text
from ..common.processes import UPKEEP_S
from ..common.results import JSON_OPTION
from ..common.results import emit as emit
from ..common.words import (
    TYPED_LENGTHS,
    UNITS,
    digits,
    in_unit,
    numbers,
    other_unit,
    read_quantity,
)
from ..data import DataSet, join, load_dataset
from ..data.bag_reader import is_bag
from ..data.folder import described_robot
from ..data.loading import import_bag, summary
from ..effects import Catalogue, load_catalogue
from ..model.compile import say_where_it_compiles
from ..model.model import Model
from ..model.tip_task import UNIT_LENGTHS
from ..robot import Robot, dump_robot, load_robot

FRAME_TOLERANCES = ('position', 'rotation')  # of the tracker, in a robot.yaml
DATA_HELP = 'data set (folder) or recording (folder, .mcap, .db3)'
WORKING = 'working'  # shown before something says what it does


# arguments that several commands share: name -> how argparse takes it
SHARED: dict[str, dict[str, Any]] = {
    'robot': {'metavar': 'ROBOT', 'help': 'robot description (YAML)'},
    'data': {'nargs': '+', 'metavar': 'DATA', 'help': f'{DATA_HELP}; several count together'},
    '--effect-file': {
        'action': 'append',
        'default': [],
        'metavar': 'FILE',
        'help': 'file with an effect of your own, which is executed; may be repeated',
    },
    '--json': JSON_OPTION,
    '--unit': {
        'choices': TYPED_LENGTHS,
        'default': 'mm',
        'help': 'of lengths that have no unit of their own, as 0.03m has (default: mm)',
    },
    '--overwrite': {'action': 'store_true', 'help': 'replace a file that is there'},
}


def declare(parser: argparse.ArgumentParser, *names: str) -> None:
    """Declare arguments that several commands share, by their names in `SHARED`."""
    for name in names:
        parser.add_argument(name, **SHARED[name])


def add_file(
    parser: argparse.ArgumentParser, name: str, help: str, metavar: str = 'FILE', **more: Any
) -> None:
    """Declare an option that names a file to write; where none can go is said at once."""
    parser.add_argument(name, type=file_to_write(name), metavar=metavar, help=help, **more)


def add_report(parser: argparse.ArgumentParser) -> None:
    """Declare --report."""
    add_file(parser, '--report', 'write a page that opens offline', 'HTML')


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Declare where work is spread: processes of this machine, or a cluster."""
    add, cores = parser.add_argument, len(os.sched_getaffinity(0))
    what = 'processes (default: one per core)'
    add('--workers', type=int, default=cores, metavar='N', help=what)
    what = 'of a dask scheduler instead: tcp://host:8786, or tls:// as its settings say'
    add('--cluster', default='', metavar='ADDRESS', help=what)


def effects_of(args: argparse.Namespace) -> Catalogue:
    """Read the catalogue with the user's own effects; say it where the model compiles first."""
    catalogue = load_catalogue(args.effect_file)
    say_where_it_compiles(catalogue)
    return catalogue


def load_model(args: argparse.Namespace) -> Model:
    """Read the robot and make its model; the first one ever takes a while to compile."""
    return Model(load_robot(args.robot), effects_of(args))


def named[T](option: str, text: str, form: str, read: Callable[[str], T]) -> dict[str, T]:
    """
    Read NAME=VALUE,NAME=VALUE; `form` says for messages how a value is written.

    Raises
    ------
    InputError
        It reads otherwise (`read` raises it, or ValueError), or names something twice.

    """
    values: dict[str, T] = {}
    for part in text.split(','):
        name, _, value = (word.strip() for word in part.rpartition('='))
        try:
            if not name:
                raise ValueError
            read_value = read(value)
        except ValueError:
            kind, _, unit = form.partition(' ')
            raise InputError(
                f'{option}: expected NAME={kind},NAME={kind} {unit}, got {part.strip()!r}'
            ) from None
        if name in values:
            raise InputError(f'{option}: {name!r} stands twice')
        values[name] = read_value
    return values


def named_numbers(option: str, text: str, unit: str) -> dict[str, float]:
    """Read left=0.51,right=0; of newtons a number may have its own unit: left=510mN."""

    def read(number: str) -> float:
        if unit == 'N' and number[:1].isdigit() and number[-1:].isalpha():
            return read_quantity(option, number, unit, 'force')
        return float(number)

    return named(option, text, f'NUMBER in {unit}', read)


def named_lengths(option: str, text: str, unit: str) -> dict[str, float]:
    """Read left=6,right=-2mm in metres."""
    return named(option, text, f'LENGTH in {unit}', lambda number: length(option, number, unit))


def positive(text: str) -> float:
    """Read a number above 0, for argparse."""
    value = float(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f'expected a number above 0, got {text}')
    return value


def view_angle(text: str) -> float:
    """Read an angle of 0° or more, for argparse."""
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f'expected an angle of 0° or more, got {text}')
    return value


def length(option: str, text: str, unit: str) -> float:
    """Read a length in a unit, or with its own, in metres."""
    return read_quantity(option, text, unit, 'length')


def input_size(option: str, text: str | None) -> float | None:
    """Read 0.2N or 0.5mm in newtons or metres; a bare number is newtons."""
    return None if text is None else read_quantity(option, text, 'N', 'force', 'length')


def refuse_other_size(args: argparse.Namespace, input: str) -> None:
    """Raise InputError where --same or --rest is a tension and inputs are lengths, or reverse."""
    kind = 'force' if input == 'tension' else 'length'
    for option, text in (('--same', args.same), ('--rest', args.rest)):
        if input_size(option, text):  # zero is the same in both
            read_quantity(option, text, 'N', kind)


def position(option: str, text: str | None, unit: str, reach: float) -> list[float] | None:
    """
    Read the position x,y,z of a tip, in metres.

    Parameters
    ----------
    option : str
        For messages.
    text : str or None
        Three lengths.
    unit : str
        Of numbers without one.
    reach : float
        Length of the arm [m].

    Raises
    ------
    InputError
        It is not three lengths, or none that this arm can be asked for: another unit is meant.

    """
    if text is None:
        return None
    if text.count(',') != 2:
        raise InputError(f'{option}: expected three lengths x,y,z, got {text!r}')
    values = [length(option, part, unit) for part in text.split(',')]
    distance = math.hypot(*values)
    farthest = UNIT_LENGTHS * reach
    nearest = farthest * UNITS['length']['mm']  # what is nearer is in metres
    if distance > farthest or 0.0 < distance < nearest:
        mend = other_unit(text, distance, unit, nearest, farthest)
        raise InputError(
            f'{option}: {in_unit(text, unit)} is {digits(1e3 * distance, 4)} mm from the base '
            f'of an arm of {1e3 * reach:.4g} mm{mend}'
        )
    return values


def vector(option: str, text: str | None) -> list[float] | None:
    """
    Read 'x,y,z'.

    Raises
    ------
    InputError
        It is not three numbers.

    """
    return None if text is None else list(numbers(option, text, ',', 'three numbers x,y,z', 3))


def pairs(option: str, texts: Sequence[str], what: str = 'VALUE') -> dict[str, str]:
    """
    Read NAME=VALUE of an option that may be repeated.

    Raises
    ------
    InputError
        It reads otherwise, or names something twice.

    """
    values: dict[str, str] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition('='))
        if not name or not value or name in values:
            raise InputError(f'{option} {text}: write NAME={what}, each name once')
        values[name] = value
    return values


def load_measurements(
    paths: str | Sequence[str], robot: Robot | str | None, progress: Progress | None = None
) -> DataSet:
    """
    Read data sets, and join several; of a recording, every segment in which the arm stood still.

    Raises
    ------
    DataSetError, RobotDescriptionError
        As `load_dataset` and `import_bag`.
    InputError
        Some are named twice.

    """
    given = [paths] if isinstance(paths, str) else paths
    refuse_repeated(given)
    sets, show = [], listener(progress)
    for done, path in enumerate(given):
        show(f'reading {path}', done, len(given))
        if not is_bag(path):
            sets.append(load_dataset(path, robot))
            continue
        imported = import_bag(path, robot)
        for line in imported.left_out:
            print('left out:', line, file=sys.stderr)
        print(f'{path}: {summary(imported)}', file=sys.stderr)
        sets.append(imported.dataset)
    show(WORKING, 0, 0)
    dataset = join(sets)
    return dataset if robot is None else keep_frame_tolerances(dataset, given)


def refuse_repeated(paths: Sequence[str]) -> None:
    """Raise InputError where measurements are named twice."""
    places = [Path(path).resolve() for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise InputError(
                f'{path}: is named twice; measurements count once, and check no fit to themselves'
            )


def keep_frame_tolerances(dataset: DataSet, paths: Sequence[str]) -> DataSet:
    """
    Let the frame of the tracker move as far as the data sets say, whatever description is judged.

    How well it is known belongs to the measurements: an import writes it into their robot.yaml.
    """
    from ..report.diagnosis_text import tolerance

    kept: dict[str, float] = {}
    for path in paths:
        with suppress(TendonRobotError):  # a data set without a description of its own
            own = described_robot(path).tolerances
            for key in {*FRAME_TOLERANCES} & {*own} - {*dataset.robot.tolerances}:
                kept[key] = max(kept.get(key, 0.0), own[key])
    if not kept:
        return dataset
    words = ', '.join(tolerance(key, kept[key]) for key in FRAME_TOLERANCES if key in kept)
    print(f'kept from {" ".join(paths)} beside --robot: {words} (1 sd)', file=sys.stderr)
    robot = replace(dataset.robot, tolerances={**dataset.robot.tolerances, **kept})
    return replace(dataset, robot=robot)


def load_judged(
    args: argparse.Namespace, show: Progress
) -> tuple[DataSet, DataSet | None, Catalogue]:
    """Read the measurements, those of --check with the same robot, and the catalogue."""
    others = vars(args).get('reference') or []
    refuse_repeated([*args.data, *filter(None, [args.check]), *others])
    dataset = load_measurements(args.data, args.robot, show)
    check = None if args.check is None else load_measurements(args.check, dataset.robot, show)
    return dataset, check, effects_of(args)


def refuse_existing(option: str, path: str | None, overwrite: bool) -> None:
    """Raise InputError before any work where a file would be replaced."""
    if path is not None and Path(path).exists() and not overwrite:
        raise InputError(f'{path}: is there already; use --overwrite or another {option}')


def write_description(robot: Robot, path: str) -> None:
    """Write a description, whole or not at all."""
    write_text(path, dump_robot(robot))


def next_step(path: str) -> str:
    """Describe the use of a new description."""
    return f'written: {path}    send it to the robot: controller parameter model := {path}'


@contextmanager
def progress(remaining: bool = False) -> Iterator[Progress]:
    """
    Give a function that shows (what, done, total) on stderr: a bar, or lines in a pipe.

    A thread shows how long a step has taken so far. `remaining` shows the time left as well, where
    all of the work is counted as one.
    """
    form = '{desc} {n_fmt}/{total_fmt} |{bar}| {elapsed}'
    form += ', {remaining} left' if remaining else ''
    start, ended = time.monotonic(), threading.Event()
    now = (WORKING, 0, 0)  # what was told last

    def show(what: str, done: int, total: int) -> None:
        nonlocal now
        now = (what, done, total)

    with tqdm(disable=None, leave=False, bar_format=form) as bar:

        def show_regularly() -> None:
            pause = UPKEEP_S if bar.disable else 0.2 * UPKEEP_S  # its seconds pass
            while not ended.wait(pause):
                what, done, total = now
                if not bar.disable:
                    bar.n, bar.total = done, total
                    bar.set_description_str(what)
                    continue
                elapsed = time.monotonic() - start
                left = elapsed / max(done, 1) * (total - done) / 60.0
                end = f', {left:.1f} min left' if remaining and done else ''
                count = f' {done:,}/{total:,}' if total else ''
                print(f'{what}{count}, {elapsed:.0f} s so far{end}', file=sys.stderr, flush=True)
                pause = max(UPKEEP_S, 0.1 * elapsed)  # larger steps, so that a log stays short

        teller = threading.Thread(target=show_regularly, name='progress', daemon=True)
        teller.start()
        try:
            yield show
        finally:
            ended.set()
            teller.join()
