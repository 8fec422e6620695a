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
from ..common.given import Progress
from ..data import DataSet
from ..diagnosis.add import Addition, add_effects
from ..diagnosis.decide import Verdict
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis
from ..effects import Catalogue
from ..report import addition_text
from ..report.diagnosis_text import lines, trust_lines
from .options import (
    REFUSED_EXIT_CODE,
    add_data,
    add_effect_files,
    add_json,
    add_overwrite,
    add_report,
    effects_of,
    emit,
    load_check,
    load_measurements,
    next_step,
    refuse_existing,
    write_description,
)
from .progress import progress

HELP = 'name the physical effect that a model lacks'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add_data(parser, 'data')
    add('--robot', metavar='ROBOT', help='description to judge (default: the one of DATA)')
    add_json(parser)
    add(
        '--add',
        type=file_to_write('--add'),
        metavar='NEW',
        help='write a description with the effect',
    )
    add_report(parser)
    add('--partial', action='store_true', help='add it even if more is at work')
    add('--check', metavar='DATA2', help='other postures, to judge the effect by')
    add(
        '--trust',
        action='store_true',
        help='simulate your postures: how often a false alarm, how small an effect is seen '
        '(about a minute more)',
    )
    add('--workers', type=int, default=2, metavar='N', help='at a time (default: 2)')
    add_overwrite(parser)
    add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Diagnose, add, print."""
    if args.partial and not args.add:
        raise InputError('--partial: expected together with --add')
    if args.workers < 1:
        raise InputError(f'--workers: expected at least 1, got {args.workers}')
    refuse_existing('--add', args.add, args.overwrite)
    with progress() as show:
        dataset = load_measurements(args.data, args.robot, show)
        check = load_check(args.check, dataset, show)
        catalogue = effects_of(args)
        diagnosis = diagnose(dataset, None, catalogue, args.workers, show)
        if args.trust:
            diagnosis = _assessed(args, diagnosis, dataset, show)
        show('fitting what was found', 0, 0)
        made = _addition(args, diagnosis, dataset, check, catalogue)
    report_lines = [*lines(diagnosis), *trust_lines(diagnosis)]
    content: dict[str, Any] = diagnosis.to_json()
    if made is not None:
        report_lines += [addition_text.never_used(made), *addition_text.warnings(made)]
        content['added'] = made.to_json()
    written = made is not None and made.helps and args.add and _may_add(args, diagnosis)
    outcome = _outcome(args, diagnosis, made) if args.add else ''
    page = ''
    if args.report:
        page = _reported(args, diagnosis, dataset, catalogue, made, outcome)
    if made is not None and written:
        write_description(made.robot, args.add)
    content['written'] = args.add if written else None
    report_lines += filter(None, (outcome, page))
    emit(args, content, '\n'.join(report_lines))
    return REFUSED_EXIT_CODE if args.add and not written and _outside(diagnosis) else 0


def _assessed(
    args: argparse.Namespace, diagnosis: Diagnosis, dataset: DataSet, show: Progress
) -> Diagnosis:
    """Put what a bootstrap says beside the verdict."""
    from ..diagnosis.trust import SECONDS, assess

    print(f'simulating your postures; that takes about {SECONDS:.0f} s', file=sys.stderr)
    trust = assess(dataset, args.effect_file, args.workers, progress=show)
    details = {**diagnosis.details, 'trust': None if trust is None else trust.to_json()}
    return replace(diagnosis, details=details)


def _outside(diagnosis: Diagnosis) -> bool:
    return diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE


def _may_add(args: argparse.Namespace, diagnosis: Diagnosis) -> bool:
    return bool(diagnosis.effects) and (diagnosis.adds or (_outside(diagnosis) and args.partial))


def _addition(
    args: argparse.Namespace,
    diagnosis: Diagnosis,
    dataset: DataSet,
    check: DataSet | None,
    catalogue: Catalogue,
) -> Addition | None:
    """Fit what the diagnosis names, where that is wanted."""
    if not diagnosis.effects or not (args.check or (args.add and _may_add(args, diagnosis))):
        return None
    names = [effect.name for effect in diagnosis.effects]
    return add_effects(
        dataset, names, None, catalogue, check, diagnosis.effects, partial=_outside(diagnosis)
    )


def _reported(
    args: argparse.Namespace,
    diagnosis: Diagnosis,
    dataset: DataSet,
    catalogue: Catalogue,
    made: Addition | None,
    outcome: str,
) -> str:
    """Write the page."""
    from ..report.diagnosis_page import pictures_of, write_diagnosis

    pictures = pictures_of(diagnosis, dataset, catalogue, None if made is None else made.robot)
    page = write_diagnosis(diagnosis, pictures, args.report, made, outcome.replace('    ', '; '))
    return f'report: {page}'


def _outcome(args: argparse.Namespace, diagnosis: Diagnosis, made: Addition | None) -> str:
    """Say what becomes of the file that --add names."""
    if made is not None and not made.helps:
        return addition_text.NOT_WRITTEN
    return next_step(args.add) if _may_add(args, diagnosis) else _refusal(diagnosis)


def _refusal(diagnosis: Diagnosis) -> str:
    """Say why nothing was written."""
    if diagnosis.effects:
        names = ' and '.join(effect.name for effect in diagnosis.effects)
        return f'Nothing was added (--partial would add {names}).'
    return 'Nothing was added: there is nothing to add.'
