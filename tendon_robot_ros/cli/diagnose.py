"""
Name the physical effect whose absence explains the error of a model, and how sure that is.

Verdicts: adequate, missing_effect, ambiguous (measure the proposed posture), several,
wrong_parameter, outside_catalogue (an effect may help, but something else is at work),
cannot_judge. With --add the effect goes into a new description, its parameters fitted, and the
error on postures that were not used is shown: those of --check, or postures left out in turn.

Exit code: 0 a result; 1 an error; 2 nothing added, because the cause is outside the catalogue.

example: python -m tendon_robot_ros diagnose data/hinge_friction/fit --add better.yaml \
    --check data/hinge_friction/check
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Any

from ..common.errors import InputError
from ..common.files import file_to_write
from ..diagnosis.add import Addition, add_effects
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis
from ..diagnosis.verdict import Verdict
from ..report.diagnosis_page import pictures_of, write_diagnosis
from ..report.diagnosis_text import NOT_WRITTEN, addition_warnings, lines, never_used, trust_lines
from . import options
from .main import ExitCode

HELP = 'name the physical effect that a model lacks'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    options.add_data(parser, 'data')
    add('--robot', metavar='ROBOT', help='description to judge (default: the one of DATA)')
    options.add_json(parser)
    what = 'write a description with the effect'
    add('--add', type=file_to_write('--add'), metavar='NEW', help=what)
    options.add_report(parser)
    add('--partial', action='store_true', help='add it even if more is at work')
    options.add_check(parser, 'to judge the effect by')
    what = (
        'simulate your postures: how often a false alarm, how small an effect is seen (about a '
        'minute more)'
    )
    add('--trust', action='store_true', help=what)
    options.add_workers(parser)
    options.add_overwrite(parser)
    options.add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Diagnose, add, print."""
    if args.partial and not args.add:
        raise InputError('--partial: expected together with --add')
    options.check_workers(args)
    options.refuse_existing('--add', args.add, args.overwrite)
    with options.progress() as show:
        dataset, check, catalogue = options.load_judged(args, show)
        diagnosis = diagnose(dataset, None, catalogue, args.workers, show)
        if args.trust:
            from ..diagnosis.trust import SECONDS, assess

            print(f'simulating your postures; that takes about {SECONDS:.0f} s', file=sys.stderr)
            trust = assess(dataset, args.effect_file, args.workers, progress=show)
            details = {**diagnosis.details, 'trust': None if trust is None else trust.to_json()}
            diagnosis = replace(diagnosis, details=details)
        show('fitting what was found', 0, 0)
        outside = diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE
        may_add = bool(diagnosis.effects) and (diagnosis.adds or (outside and args.partial))
        added = None
        if diagnosis.effects and (args.check or (args.add and may_add)):
            effects = diagnosis.effects
            names = [effect.name for effect in effects]
            added = add_effects(dataset, names, None, catalogue, check, effects, partial=outside)
    report_lines = [*lines(diagnosis), *trust_lines(diagnosis)]
    content: dict[str, Any] = diagnosis.to_json()
    if added is not None:
        report_lines += [never_used(added), *addition_warnings(added)]
        content['added'] = added.to_json()
    outcome = outcome_of(args.add, diagnosis, added, may_add) if args.add else ''
    report_lines += [outcome] if outcome else []
    if args.report:
        better = None if added is None else added.robot
        pictures = pictures_of(diagnosis, dataset, catalogue, better)
        outcome_line = outcome.replace('    ', '; ')
        page = write_diagnosis(diagnosis, pictures, args.report, added, outcome_line)
        report_lines.append(f'report: {page}')
    written = added is not None and added.helps and args.add and may_add
    if added is not None and written:
        options.write_description(added.robot, args.add)
    content['written'] = args.add if written else None
    options.emit(args, content, '\n'.join(report_lines))
    return ExitCode.REFUSED if args.add and not written and outside else 0


def outcome_of(new: str, diagnosis: Diagnosis, addition: Addition | None, may_add: bool) -> str:
    """Describe whether the file of --add is written."""
    if addition is not None and not addition.helps:
        return NOT_WRITTEN
    if may_add:
        return options.next_step(new)
    if diagnosis.effects:
        names = ' and '.join(effect.name for effect in diagnosis.effects)
        return f'Nothing was added (--partial would add {names}).'
    return 'Nothing was added: there is nothing to add.'
