"""
Commands that hold a model against measurements, and change its description by them.

compare; diagnose, add, remove; improve.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..comparison.compare import compare
from ..comparison.result import to_json
from ..data import DataSet
from ..diagnosis.add import Addition, add_effect, restore
from ..diagnosis.diagnose import changed_since, diagnose
from ..diagnosis.improve import improve
from ..diagnosis.result import Diagnosis
from ..diagnosis.verdict import Verdict
from ..inference.statistics import ERRORS
from ..report import diagnosis_text, improvement_page
from ..report.comparison import comparison_page
from ..report.diagnosis_page import diagnosis_page
from ..robot import Robot, load_robot
from . import options
from .main import ExitCode


class Compare:
    """
    Show how far a model is off, where, and how much of that is noise.

    Errors are distances between the model and the mean over the trials of a posture; the tip error
    is that of the last marker, trial by trial: the mean over the trials, then postures. The noise
    floor is the rms that a perfect model would show, setting noise included. Readings and trials
    that the other trials of their posture contradict are named and left out. Without --model the
    description that the data set names is compared.

    JSON: models [{name, rms, max, tip_error, per_marker_rms, per_posture}], noise_floor, paired_t,
    and all shapes; in m and rad.

    example: python -m tendon_robot_ros compare data/hinge_friction/fit --pcca
        --report compare.html
    """

    HELP = 'compare models with measurements'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'data')
        add = parser.add_argument
        what = 'robot descriptions to compare (default: the one of the data set)'
        add('--model', nargs='+', action='extend', default=[], metavar='ROBOT', help=what)
        add('--pcca', action='store_true', help='also the model without any effect')
        what = 'what ± means: 95 %% t-interval of the mean (default), or its standard error'
        add('--error', choices=ERRORS, default='ci', help=what)
        options.add_report(parser)
        options.declare(parser, '--json', '--effect-file')

    def run(self, args: argparse.Namespace) -> None:
        """Compare and print."""
        robot = args.model[0] if args.model else None
        with options.progress() as show:
            dataset = options.load_measurements(args.data, robot, show)
            catalogue = options.effects_of(args)
            models = named_models(args, dataset)
            comparison = compare(dataset, models, catalogue, args.error, progress=show)
        text = comparison.text()
        if args.report:
            text += f'\nreport: {comparison_page(comparison).write(args.report)}'
        options.emit(args, to_json(comparison), text)


def named_models(args: argparse.Namespace, dataset: DataSet) -> list[tuple[str, Robot]]:
    """Name the models: by the robot, or by their files where robots have the same name."""
    robots = [load_robot(path) for path in args.model] or [dataset.robot]
    own, files = [robot.name for robot in robots], [Path(path).stem for path in args.model]
    different = (names for names in (own, files, args.model) if len({*names}) == len(robots))
    names = next(different, None)
    if names is None:
        raise InputError(f'--model: expected different files, got {", ".join(args.model)}')
    models = list(zip(names, robots, strict=True))
    if args.pcca:
        models.append(('PCCA', replace(dataset.robot, name='PCCA', effects={}, fitted={})))
    return models


class Diagnose:
    """
    Name the physical effect whose absence explains the error of a model, and how sure that is.

    Verdicts: adequate, missing_effect, ambiguous (measure the proposed posture), several,
    wrong_parameter, outside_catalogue (an effect may help, but something else is at work),
    cannot_judge. With --add the effect goes into a new description, its parameters fitted, and the
    error on postures that were not used is shown: those of --check, or postures left out in turn.

    Exit code: 0 a result; 1 an error; 2 nothing added, because the cause is outside the catalogue.

    example: python -m tendon_robot_ros diagnose data/hinge_friction/fit --add better.yaml
        --check data/hinge_friction/check
    """

    HELP = 'name the physical effect that a model lacks'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add = parser.add_argument
        options.declare(parser, 'data')
        add('--robot', metavar='ROBOT', help='description to judge (default: the one of DATA)')
        what = 'earlier recordings of the same arm: judge only what has changed since'
        add('--reference', nargs='+', metavar='OLD', help=what)
        options.declare(parser, '--json')
        options.add_file(parser, '--add', 'write a description with the effect', 'NEW')
        options.add_report(parser)
        add('--partial', action='store_true', help='add it even if more is at work')
        add('--check', metavar='DATA2', help='other postures, to judge the effect by')
        what = (
            'simulate your postures: how often a false alarm, how small an effect is seen (about '
            'a minute more)'
        )
        add('--trust', action='store_true', help=what)
        what = 'simulations of --trust at a time (default: 2)'
        add('--workers', type=int, default=2, metavar='N', help=what)
        options.declare(parser, '--overwrite', '--effect-file')

    def run(self, args: argparse.Namespace) -> int:
        """Diagnose, add, print."""
        if args.partial and not args.add:
            raise InputError('--partial: expected together with --add')
        if args.workers < 1:
            raise InputError(f'--workers: expected at least 1, got {args.workers}')
        options.refuse_existing('--add', args.add, args.overwrite)
        with options.progress() as show:
            dataset, check, catalogue = options.load_judged(args, show)
            if args.reference:
                old = options.load_measurements(args.reference, dataset.robot, show)
                both = [dataset] if check is None else [dataset, check]
                dataset, *rest = changed_since(both, old, catalogue, show)
                check = rest[0] if rest else None
            diagnosis = diagnose(dataset, None, catalogue, progress=show)
            if args.trust:
                from ..diagnosis.trust import SECONDS, assess

                takes = f'that takes about {SECONDS:.0f} s'
                print(f'simulating your postures; {takes}', file=sys.stderr)
                trust = assess(dataset, args.effect_file, args.workers, progress=show)
                diagnosis = replace(diagnosis, details={**diagnosis.details, 'trust': trust})
            show('fitting what was found', 0, 0)
            outside = diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE
            effects = diagnosis.effects
            may_add = bool(effects) and (diagnosis.adds or (outside and args.partial))
            added = None
            if effects and (args.check or (args.add and may_add)):
                added = add_effect(dataset, effects, None, catalogue, check, outside)
        lines, content, robot = [diagnosis.text()], diagnosis.to_json(), None
        if added is not None:
            lines += [diagnosis_text.never_used(added), *diagnosis_text.addition_warnings(added)]
            content['added'] = added.to_json()
            robot = added.robot if added.helps and args.add and may_add else None
        outcome = outcome_of(args.add, diagnosis, added, may_add) if args.add else ''
        lines.append(outcome)
        if args.report:
            said = outcome.replace('    ', '; ')
            page = diagnosis_page(diagnosis, dataset, catalogue, added, said)
            lines.append(f'report: {page.write(args.report)}')
        code = conclude(args, args.add, content, lines, robot)
        return code if args.add and outside else 0


def outcome_of(new: str, diagnosis: Diagnosis, addition: Addition | None, may_add: bool) -> str:
    """Describe whether the file of --add is written."""
    if addition is not None and not addition.helps:
        return diagnosis_text.NOT_WRITTEN
    if may_add:
        return options.next_step(new)
    if diagnosis.effects:
        names = ' and '.join(effect.name for effect in diagnosis.effects)
        return f'Nothing was added (--partial would add {names}).'
    return 'Nothing was added: there is nothing to add.'


class Add:
    """
    Fit effects on measurements and write them into a robot description.

    All parameters of the effects are fitted, with the declared tolerances; the new description
    holds their values, and under `fitted` their 95 % intervals, the data set, the date, and the
    errors. The table shows the error before, after, and of a perfect model (noise floor), on the
    fitted postures and on others: those of --check, or postures left out in turn. An effect that
    ROBOT lists already gets new values. `effect remove` undoes it. Nothing is written, and the
    exit code is 2, where the error on others would rise.

    example: python -m tendon_robot_ros effect add hinge_friction --data data/hinge_friction/fit
        --output hinged.yaml --check data/hinge_friction/check
    """

    HELP = 'add a physical effect to a robot description, fitted on measurements'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add, what = parser.add_argument, 'effects of the catalogue, fitted together'
        add('effects', nargs='+', metavar='EFFECT', help=what)
        what = f'{options.DATA_HELP} to fit on; several of one robot count together'
        add('--data', nargs='+', metavar='DATA', required=True, help=what)
        add('--robot', metavar='ROBOT', help='description to add to (default: the one of DATA)')
        options.add_file(parser, '--output', 'the new description', 'NEW', required=True)
        add('--check', metavar='DATA2', help='other postures, to judge the effect by')
        options.declare(parser, '--json', '--overwrite', '--effect-file')

    def run(self, args: argparse.Namespace) -> int:
        """Fit, write, print."""
        options.refuse_existing('--output', args.output, args.overwrite)
        with options.progress() as show:
            dataset, check, catalogue = options.load_judged(args, show)
            show(f'fitting {" and ".join(args.effects)}', 0, 0)
            addition = add_effect(dataset, args.effects, None, catalogue, check)
        robot = addition.robot if addition.helps else None
        outcome = options.next_step(args.output) if robot else diagnosis_text.NOT_WRITTEN
        lines = [addition.text(), outcome]
        return conclude(args, args.output, addition.to_json(), lines, robot)


def conclude(
    args: argparse.Namespace, new: str, content: Any, lines: list[str], robot: Robot | None
) -> int:
    """Write a better description, if there is one, and print; return the exit code."""
    if robot is not None:
        options.write_description(robot, new)
    written = None if robot is None else new
    options.emit(args, {**content, 'written': written}, '\n'.join(filter(None, lines)))
    return ExitCode.REFUSED if robot is None else 0


class Remove:
    """
    Take an effect out of a robot description.

    Where `effect add` had replaced the values of an effect that was there before, these come back;
    remove once more to take it out.

    example: python -m tendon_robot_ros effect remove hinge_friction --robot hinged.yaml
        --output plain.yaml
    """

    HELP = 'take an effect out of a robot description'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        parser.add_argument('effect', metavar='EFFECT', help='an effect that ROBOT lists')
        parser.add_argument('--robot', required=True, metavar='ROBOT', help='description (YAML)')
        options.add_file(parser, '--output', 'the new description', 'NEW', required=True)
        options.declare(parser, '--json', '--overwrite')

    def run(self, args: argparse.Namespace) -> None:
        """Remove and write."""
        options.refuse_existing('--output', args.output, args.overwrite)
        robot, back = restore(load_robot(args.robot), args.effect)
        options.write_description(robot, args.output)
        text = f'removed: {args.effect}'
        if back is not None:
            shown = ', '.join(f'{key} = {value}' for key, value in back.items())
            text = (
                f'{args.effect}: as before the fit again ({shown}); remove it once more to drop it'
            )
        content = {'effect': args.effect, 'restored': back, 'written': args.output}
        options.emit(args, content, f'{text}\nwritten: {args.output}')


class Improve:
    """
    Improve a robot description effect by effect, while the error on postures left out falls.

    On a real arm several effects are at work and none explains all. At every step the effect joins
    (or the stiffness along the arm changes) that lowers the error on left-out postures most; all
    parameters are fitted together again, and effects that are no longer needed leave. The whole
    search is then made again without each posture, or group of postures, and predicts it: that
    error is printed for every step, and the last step that lowers it by more than its scatter is
    the last one that NEW takes. Nothing is written, and the exit code is 2, where no step does.
    `effect remove` undoes an effect.

    example: python -m tendon_robot_ros improve data/hinge_friction/fit --output better.yaml
        --report better.html
    """

    HELP = 'add effects one by one while the error on left-out postures falls'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        options.declare(parser, 'data')
        add, what = parser.add_argument, 'description to improve (default: the one of DATA)'
        add('--robot', metavar='ROBOT', help=what)
        options.add_file(parser, '--output', 'the improved description', 'NEW', required=True)
        add('--check', metavar='DATA2', help='other postures, whose error is shown at every step')
        options.add_report(parser)
        add('--workers', type=int, metavar='N', help='no effect: fits run one after the other')
        options.declare(parser, '--json', '--overwrite', '--effect-file')

    def run(self, args: argparse.Namespace) -> int:
        """Search, write, print."""
        options.refuse_existing('--output', args.output, args.overwrite)
        with options.progress(remaining=True) as show:
            dataset, check, catalogue = options.load_judged(args, show)
            improvement = improve(dataset, None, catalogue, check, progress=show)
        robot = improvement.robot if improvement.taken else None
        outcome = options.next_step(args.output) if robot else improvement_page.NOT_WRITTEN
        lines = [improvement.text(), outcome]
        if args.report:
            page = improvement_page.improvement_page(improvement, dataset, catalogue)
            lines.append(f'report: {page.write(args.report)}')
        return conclude(args, args.output, improvement.to_json(), lines, robot)
