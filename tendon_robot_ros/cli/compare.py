"""
Show how far a model is off, where, and how much of that is noise.

Errors are distances between the model and the mean over the trials of a posture; the tip error is
that of the last marker, trial by trial: the mean over the trials, then postures. The noise
floor is the rms that a perfect model would show, setting noise included. Readings and trials that
the other trials of their posture contradict are named and left out. Without --model the
description that the data set names is compared.

JSON: models [{name, rms, max, tip_error, per_marker_rms, per_posture}], noise_floor, paired_t, and
all shapes; in m and rad.

example: python -m tendon_robot_ros compare data/hinge_friction/fit --pcca --report compare.html
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from ..common.errors import InputError
from ..comparison.compare import compare
from ..comparison.result import to_json
from ..comparison.statistics import ERRORS
from ..data import DataSet
from ..report.comparison_text import sentences, table
from ..robot import Robot, load_robot
from .options import (
    add_data,
    add_effect_files,
    add_json,
    add_report,
    effects_of,
    emit,
    load_measurements,
    progress,
)

HELP = 'compare models with measurements'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_data(parser, 'data')
    add = parser.add_argument
    what = 'robot descriptions to compare (default: the one of the data set)'
    add('--model', nargs='+', action='extend', default=[], metavar='ROBOT', help=what)
    add('--pcca', action='store_true', help='also the model without any effect')
    what = 'what ± means: 95 %% t-interval of the mean (default), or its standard error'
    add('--error', choices=ERRORS, default='ci', help=what)
    add_json(parser)
    add_report(parser)
    add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Compare and print."""
    with progress() as show:
        dataset = load_measurements(args.data, args.model[0] if args.model else None, show)
        catalogue = effects_of(args)
        models = named_models(args, dataset)
        comparison = compare(dataset, models, catalogue, args.error, progress=show)
    lines = [table(comparison), *sentences(comparison)]
    if args.report:
        from ..report.comparison_page import write_comparison

        lines.append(f'report: {write_comparison(comparison, args.report)}')
    emit(args, to_json(comparison), '\n'.join(lines))
    return 0


def named_models(args: argparse.Namespace, dataset: DataSet) -> list[tuple[str, Robot]]:
    """Name the models: by the robot, or by their files where robots have the same name."""
    robots = [load_robot(path) for path in args.model] or [dataset.robot]
    names = [robot.name for robot in robots]
    if len(set(names)) < len(names):
        names = [Path(path).stem for path in args.model]
    if len(set(names)) < len(names):
        names = list(args.model)
    if len(set(names)) < len(names):
        raise InputError(f'--model: expected different files, got {", ".join(names)}')
    models = list(zip(names, robots, strict=True))
    if args.pcca:
        models.append(('PCCA', replace(dataset.robot, name='PCCA', effects={}, fitted={})))
    return models
