"""Where commands write a changed robot description, and the arguments they share for it."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..data import DataSet
from ..data.atomic import new_file
from ..exceptions import InputError
from ..robot import Robot, dump_robot
from .measurements import load_measurements


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Declare --overwrite."""
    parser.add_argument('--overwrite', action='store_true', help='replace a file that is there')


def add_effect_files(parser: argparse.ArgumentParser) -> None:
    """Declare --effect-file."""
    parser.add_argument(
        '--effect-file',
        action='append',
        default=[],
        metavar='FILE',
        help='Python file with an effect of your own (is executed; may be given several times)',
    )


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
