"""
How often the diagnosis is right: every effect, two robots, sizes from a fifteenth to full.

Plants are of another discretisation: arcs of three finer cells, hinges, the capstan's exponential;
`--scatter 0.02` adds scatter of the cells' stiffness, which `--declare` declares as a tolerance.
"""

from __future__ import annotations

import argparse
import collections
import json
import multiprocessing
import os
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from machine import machine
from simulated_cases import (
    CAUSES,
    NAMING,
    TWINS,
    Case,
    cases_of,
    described,
    hidden_values,
    is_visible,
    measured,
)

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.comparison.noise import rms
from tendon_robot_ros.comparison.predict import Predictor, frees_of
from tendon_robot_ros.diagnosis.decide import Verdict
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.robot import Robot


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    case: Case
    verdict: str
    effects: tuple[str, ...]
    group: tuple[str, ...]
    right: bool
    wrong_name: bool
    visible: bool  # the truth stands out of the noise: a whitened change above 30
    inside: float | None  # share of the true values that lie in their intervals
    gain: float | None  # share of (before - floor) gone on the check postures
    seconds: float
    scatter_inside: float | None = None  # share of the kinds whose true size lies in its interval
    problem: str = ''


def failed(case: Case, seconds: float, error: Exception) -> Outcome:
    """Return the outcome of a case that raised an error."""
    problem = f'{type(error).__name__}: {error}'
    return Outcome(case, 'error', (), (), False, False, True, None, None, seconds, None, problem)


def inside(case: Case, found, values) -> float | None:
    """Share of the true values that lie in the 95 % intervals; None where none was fitted."""
    for effect in found.effects:
        if effect.name == case.hidden:
            truth = list(np.concatenate([np.atleast_1d(v) for v in values.values()]))
            return float(
                np.mean(
                    [
                        fitted.low <= value <= fitted.high
                        for fitted, value in zip(effect.parameters.values(), truth, strict=True)
                    ]
                )
            )
    return None


def judge(case: Case) -> Outcome:
    """Simulate, diagnose, and hold the verdict against the truth."""
    robot = described(case)
    values = hidden_values(case.hidden, case.size, case.seed, robot)
    start = time.perf_counter()
    try:
        sets, built = measured(case, robot, values)
        start = time.perf_counter()
        found = diagnose(sets[0], workers=1)
    except (TendonRobotError, ArithmeticError, np.linalg.LinAlgError) as error:
        return failed(case, time.perf_counter() - start, error)
    seconds = time.perf_counter() - start
    names = tuple(effect.name for effect in found.effects)
    listed = set(names) | set(found.cannot_tell_apart)
    named = found.verdict in NAMING
    if case.hidden == 'none':
        right = not named and found.verdict is Verdict.ADEQUATE
    elif case.hidden in CAUSES:
        right = found.verdict is Verdict.OUTSIDE_CATALOGUE
    else:
        right = named and case.hidden in listed
    wrong = named and case.hidden not in listed
    return Outcome(
        case,
        found.verdict,
        names,
        found.cannot_tell_apart,
        right,
        wrong,
        is_visible(case, sets[0], robot, values),
        inside(case, found, values) if named else None,
        error_gone(found, sets, robot) if named else None,
        seconds,
        scatter_inside(found, built)
        if case.level and right and case.hidden not in CAUSES
        else None,
    )


def scatter_inside(found, built) -> float | None:
    """Share of the kinds of imperfections whose size was right."""
    truth = {
        'cell_stiffness': built.stiffness,
        'cell_kink': built.kink[:, built.kink.any(axis=0)],
    }
    report = found.details.get('as_built')
    if report is None:
        return None
    held = []
    for kind in report['kinds']:
        if kind['kind'] in truth and kind['told']:
            size = float(np.sqrt(np.mean(np.square(truth[kind['kind']]))))
            held.append(kind['low'] <= size <= kind['high'])
    return float(np.mean(held)) if held else None


def error_gone(found, sets, robot: Robot) -> float | None:
    """Share of (before - floor) that the named effects remove on the check postures."""
    catalogue, check = load_catalogue(), sets[1]
    keys = {
        (free.effect, free.key): free
        for free in frees_of([e.name for e in found.effects], catalogue, robot)
    }
    point = {
        keys[effect.name, key]: value.value
        for effect in found.effects
        for key, value in effect.parameters.items()
    }
    errors = []
    for one in ({}, point):
        markers = Predictor(check, robot, catalogue).markers(one)
        if markers is None:
            return None
        errors.append(rms(check.mean - markers))
    before, after, floor = *errors, found.noise_floor
    return (before - after) / (before - floor) if before > 1.2 * floor else None


def table(outcomes: list[Outcome]) -> str:
    """Return the confusion by hidden effect."""
    lines = [
        f'{"hidden":22s} {"n":>4s} {"seen":>4s} {"right":>6s} {"wrong name":>10s} {"quiet":>6s} '
        f'{"outside":>8s} {Verdict.SEVERAL:>8s} {"class":>6s} {"inside":>7s} {"gone":>6s} '
        f'{"time":>6s}'
    ]
    groups = collections.defaultdict(list)
    for outcome in outcomes:
        groups[outcome.case.robot, outcome.case.hidden].append(outcome)
    for (robot, hidden), group in groups.items():
        verdicts = collections.Counter(o.verdict for o in group)
        named = [o for o in group if o.verdict in NAMING]
        inside = [o.inside for o in group if o.inside is not None]
        gone = [o.gain for o in group if o.gain is not None]
        size = np.mean([max(len(o.group), 1) for o in named]) if named else float('nan')
        lines.append(
            f'{robot[:3]} {hidden:18s} {len(group):4d} '
            f'{sum(o.visible for o in group):4d} {np.mean([o.right for o in group]):6.0%} '
            f'{sum(o.wrong_name for o in group):10d} {verdicts[Verdict.ADEQUATE]:6d} '
            f'{verdicts[Verdict.OUTSIDE_CATALOGUE]:8d} {verdicts[Verdict.SEVERAL]:8d} {size:6.1f} '
            f'{np.mean(inside) if inside else float("nan"):7.0%} '
            f'{np.median(gone) if gone else float("nan"):6.0%} '
            f'{np.median([o.seconds for o in group]):5.1f}s'
        )
    return '\n'.join(lines)


def summary(outcomes: list[Outcome]) -> dict[str, float | int]:
    """Return the figures that the design asks for."""
    effects = [o for o in outcomes if o.case.hidden not in (*CAUSES, 'none')]
    seen = [o for o in effects if o.visible]
    inside = [o.inside for o in effects if o.inside is not None]
    gone = [o.gain for o in effects if o.right and o.gain is not None]
    named = [o for o in effects if o.right]
    causes = [o for o in outcomes if o.case.hidden in CAUSES and o.verdict != Verdict.ADEQUATE]
    clean = [o for o in outcomes if o.case.hidden == 'none']

    def share(values) -> float:
        return round(float(np.mean(values)), 4) if len(values) else float('nan')

    return {
        'effects judged': len(effects),
        'right of all': share([o.right for o in effects]),
        'right of those that stand out of the noise': share([o.right for o in seen]),
        'wrong names': sum(o.wrong_name for o in effects),
        'mean class size': share([max(len(o.group), 1) for o in named]),
        'single name': share([len(o.group) <= 1 for o in named]),
        'single name, effects without a twin': share(
            [len(o.group) <= 1 for o in named if o.case.hidden not in TWINS]
        ),
        'intervals that hold': share(inside),
        'check error gone >= 90 %': share([g >= 0.9 for g in gone]),
        'scatter inside its interval': share(
            [o.scatter_inside for o in outcomes if o.scatter_inside is not None]
        ),
        'causes outside': share([o.right for o in causes]),
        'clean sets named': sum(o.verdict in NAMING for o in clean),
        'clean sets': len(clean),
        'false alarms': share([not o.right for o in clean]),
        'errors': sum(o.verdict == 'error' for o in outcomes),
        'median seconds': share([np.median([o.seconds for o in outcomes])]),
    }


def arguments() -> argparse.Namespace:
    """Read what to judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--clean', type=int, default=300)
    parser.add_argument('--scatter', type=float, default=0.0)
    parser.add_argument('--declare', action='store_true', help='the description knows the scatter')
    parser.add_argument(
        '--as-built',
        type=float,
        default=0.0,
        metavar='LEVEL',
        help='build arms with imperfections',
    )
    parser.add_argument('--exact', action='store_true', help='descriptions say exact: true')
    parser.add_argument('--effects', nargs='*')
    parser.add_argument('--workers', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path)
    return parser.parse_args()


def main() -> int:
    """Judge all cases on all cores."""
    options = arguments()
    cases, outcomes = cases_of(options), []
    with multiprocessing.get_context('spawn').Pool(options.workers) as pool:
        for i, outcome in enumerate(pool.imap_unordered(judge, cases, chunksize=4)):
            outcomes.append(outcome)
            if i % 20 == 0:
                print(f'{i + 1}/{len(cases)}', end='\r', file=sys.stderr)
    outcomes.sort(key=lambda o: (o.case.robot, o.case.hidden, o.case.seed))
    print(table(outcomes))
    figures = summary(outcomes)
    print(json.dumps(figures, indent=1))
    if options.json:
        options.json.write_text(
            json.dumps(
                {
                    'machine': machine(),
                    'figures': figures,
                    'scatter': options.scatter,
                    'declared': options.declare,
                    'as_built': options.as_built,
                    'outcomes': [asdict(o) for o in outcomes],
                },
                indent=1,
            )
        )
    return 0


if __name__ == '__main__':
    sys.exit(main())
