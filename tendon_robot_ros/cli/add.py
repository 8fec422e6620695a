"""
Fit effects on measurements and write them into a robot description.

All parameters of the effects are fitted, with the declared tolerances; the new description holds
their values, and under `fitted` their 95 % intervals, the data set, the date, and the errors. The
table shows the error before, after, and of a perfect model (noise floor), on the fitted postures
and on others: those of --check, or postures left out in turn. An effect that ROBOT lists already
gets new values. `remove` undoes it. Nothing is written, and the exit code is 2, where the error on
others would rise.

example: python -m tendon_robot_ros add hinge_friction --data data/hinge_friction/fit \
    --output better.yaml --check data/hinge_friction/check
"""

from __future__ import annotations

import argparse

from ..common.files import file_to_write
from ..diagnosis.add import add_effects
from ..report.diagnosis_text import NOT_WRITTEN, addition_lines
from . import options
from .main import ExitCode

HELP = 'add a physical effect to a robot description, fitted on measurements'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('effects', nargs='+', metavar='EFFECT', help='effects of the catalogue, fitted together')
    options.add_data(parser, '--data', to=' to fit on', required=True)
    add('--robot', metavar='ROBOT', help='description to add to (default: the one of DATA)')
    to = file_to_write('--output')
    add('--output', type=to, required=True, metavar='NEW', help='the new description')
    options.add_check(parser, 'to judge the effect by')
    options.add_json(parser)
    options.add_overwrite(parser)
    options.add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Fit, write, print."""
    options.refuse_existing('--output', args.output, args.overwrite)
    with options.progress() as show:
        dataset, check, catalogue = options.load_judged(args, show)
        show(f'fitting {" and ".join(args.effects)}', 0, 0)
        addition = add_effects(dataset, args.effects, None, catalogue, check)
    content = {**addition.to_json(), 'written': args.output if addition.helps else None}
    if addition.helps:
        options.write_description(addition.robot, args.output)
    last = options.next_step(args.output) if addition.helps else NOT_WRITTEN
    options.emit(args, content, '\n'.join([*addition_lines(addition), last]))
    return 0 if addition.helps else ExitCode.REFUSED
