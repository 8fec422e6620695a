"""
Improve a robot description effect by effect, while the error on postures left out keeps falling.

On a real arm several effects are at work and none explains all. At every step the effect joins
(or the stiffness along the arm changes) that lowers the error on left-out postures most; all
parameters are fitted together again, and effects that are no longer needed leave. The whole search
is then made again without each posture, or group of postures, and predicts it: that error is
printed for every step, and the last step that lowers it by more than its scatter is the last one
that NEW takes. Nothing is written, and the exit code is 2, where no step does. `remove` undoes an
effect.

example: python -m tendon_robot_ros improve data/tentacle --output better.yaml --report better.html
"""

from __future__ import annotations

import argparse

from ..common.files import file_to_write
from ..diagnosis.improve import improve
from ..report.improvement_page import NOT_WRITTEN, improvement_lines
from . import options
from .main import ExitCode

HELP = 'add effects one by one while the error on left-out postures falls'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    options.add_data(parser, 'data')
    add('--robot', metavar='ROBOT', help='description to improve (default: the one of DATA)')
    to = file_to_write('--output')
    add('--output', type=to, required=True, metavar='NEW', help='the improved description')
    options.add_check(parser, 'whose error is shown at every step')
    options.add_report(parser)
    options.add_workers(parser)
    options.add_json(parser)
    options.add_overwrite(parser)
    options.add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Search, write, print."""
    options.check_workers(args)
    options.refuse_existing('--output', args.output, args.overwrite)
    with options.progress(remaining=True) as show:
        dataset, check, catalogue = options.load_judged(args, show)
        improvement = improve(dataset, None, catalogue, check, args.workers, show)
    report_lines = improvement_lines(improvement)
    if improvement.taken:
        options.write_description(improvement.robot, args.output)
        report_lines.append(options.next_step(args.output))
    else:
        report_lines.append(NOT_WRITTEN)
    if args.report:
        from ..report.improvement_page import write_improvement

        page = write_improvement(improvement, dataset, catalogue, args.report)
        report_lines.append(f'report: {page}')
    content = {**improvement.to_json(), 'written': args.output if improvement.taken else None}
    options.emit(args, content, '\n'.join(report_lines))
    return 0 if improvement.taken else ExitCode.REFUSED
