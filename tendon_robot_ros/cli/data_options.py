"""Measurements that a command is given, and where it writes a changed description."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..common.files import new_file
from ..data import DataSet, join, load_dataset
from ..data.recording.importing import import_bag, summary
from ..data.recording.reader import is_bag
from ..robot import Robot, dump_robot

DATA_HELP = 'data set (folder), or a recording (rosbag2 folder, .mcap or .db3 file)'


def add_data(parser: argparse.ArgumentParser, *names: str, to: str = '', **options: Any) -> None:
    """Declare one or several data sets."""
    words = f'{DATA_HELP}{to}; several of one robot count together'
    parser.add_argument(*names, nargs='+', metavar='DATA', help=words, **options)


def load_measurements(paths: str | Sequence[str], robot: Robot | str | None) -> DataSet:
    """
    Read data sets, and join several; of a recording, every segment in which the arm stood still.

    Raises
    ------
    DataSetError, RobotDescriptionError
        As `load_dataset` and `import_bag`.

    """
    if not isinstance(paths, str):
        return join([load_measurements(path, robot) for path in paths])
    path = paths
    if not is_bag(path):
        return load_dataset(path, robot)
    imported = import_bag(path, robot)
    for line in imported.left_out:
        print('left out:', line, file=sys.stderr)
    print(f'{path}: {summary(imported)}', file=sys.stderr)
    return imported.dataset


# -----------------------------------------------------------------------------
# Where commands write a changed robot description, and the arguments they share for it.


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Declare --overwrite."""
    parser.add_argument('--overwrite', action='store_true', help='replace a file that is there')


def refuse_existing(option: str, path: str | None, overwrite: bool) -> None:
    """Raise InputError before any work where a file would be replaced, or has no folder."""
    if path is None:
        return
    if Path(path).exists() and not overwrite:
        raise InputError(f'{path}: is there already; use --overwrite or another {option}')
    if not Path(path).absolute().parent.is_dir():
        raise InputError(f'{path}: its folder does not exist; make it or correct {option}')


def write_description(robot: Robot, path: str) -> None:
    """Write a description, whole or not at all."""
    with new_file(Path(path)) as draft:
        draft.write_text(dump_robot(robot), encoding='utf-8')


def load_check(path: str | None, dataset: DataSet) -> DataSet | None:
    """Read a check set with the robot of a data set."""
    return None if path is None else load_measurements(path, dataset.robot)


def next_step(path: str) -> str:
    """Say what to do with a new description."""
    return f'written: {path}    send it to the robot: controller parameter model := {path}'
