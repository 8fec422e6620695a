"""
Diagnose the twelve blind cases, add what is named, and write a table of what was said.

The measurements come from an engine that shares no code with this package; see
test/data/blind/README.md. For causes outside the catalogue nothing is added.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from machine import machine

from tendon_robot_ros.common.words import mm
from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.diagnosis.add import Addition, add_effect
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.result import Diagnosis
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.report.sentences import described_quantity, quantities

ROOT = Path(__file__).resolve().parents[1]
BLIND = ROOT / 'test' / 'data' / 'blind'
ELSEWHERE = {'case_b': ROOT / 'data/hinge_friction', 'case_f': ROOT / 'data/tendon_stiffness'}
ROBOTS = {'planar1': 'planar, one section', 'planar2': 'planar, two sections',
          'spatial3': 'spatial, three tendons'}  # fmt: skip
DESIGNS = {'rich': '12 postures', 'cycle': '20 postures, loading and unloading',
           'single': '6 postures, one tendon'}  # fmt: skip
HEAD = """\
# Twelve blind cases

What `diagnose` says of robots that do one thing more than their description knows, and what `add`
then does to the error on postures that were not used. The measurements were made by an independent
rigid-body engine (hinged cells, straight tendons between eyelets, capstan friction, real travel)
that shares no code with this package; each case has five trials per posture, 0.2 mm marker noise,
tensions set to 0.2 % and repeated to 0.4 %.

Written by `python benchmarks/blind_table.py`.

"""
COLUMNS = ('case', 'robot, measurements', 'hidden', 'verdict', 'found (95 %)',
           'check error before -> after (floor)', 'gone')  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """A case and what came of it."""

    name: str
    truth: dict[str, Any]
    found: Diagnosis
    made: Addition | None
    seconds: float


def judge(name: str, truth: dict[str, Any]) -> Outcome:
    """Diagnose a case, and add what may be added."""
    folder = ELSEWHERE.get(name, BLIND / name)
    fit, check = (load_dataset(folder / part) for part in ('fit', 'check'))
    start = time.perf_counter()
    found = diagnose(fit)
    seconds = time.perf_counter() - start
    made = add_effect(fit, found.effects, check=check) if found.adds else None
    return Outcome(name, truth, found, made, seconds)


def hidden(outcome: Outcome) -> str:
    """Say what the robot hides, in the units of the found values."""
    truth = outcome.truth
    units = {
        key.split('[')[0]: value.unit
        for effect in outcome.found.effects
        for key, value in effect.parameters.items()
    }
    shown = [described_quantity(key, units[key], [value]) if key in units
             else f'{key} {value:.3g}'
             for key, value in truth['parameters'].items() if value]  # fmt: skip
    return truth['hidden'].replace('none', 'nothing') + (f' ({", ".join(shown)})' if shown else '')


def row(outcome: Outcome) -> str:
    """Return a row of the table."""
    found, made, truth = outcome.found, outcome.made, outcome.truth
    told = found.verdict.replace('_', ' ')
    effects = (effect.name for effect in found.effects)
    names = list(dict.fromkeys((*effects, *found.cannot_tell_apart)))
    if found.adds:
        told += ': ' + ', '.join(names)
    values = '; '.join(quantities(v) for v in made.values.values()) if made else '–'
    error, gone = '–', '–'
    if made:
        check = made.check
        error = f'{mm(check.before)} -> {mm(check.after)} ({mm(check.floor)})'
        gone = f'{100.0 * min(check.gone or 0.0, 1.0):.0f} %'
    where = f'{ROBOTS[truth["robot"]]}; {DESIGNS[truth["design"]]}'
    cells = (outcome.name[-1], where, hidden(outcome), told, values, error, gone)
    return line(cells)


def line(cells: Sequence[str]) -> str:
    """Return a line of the table."""
    return '| ' + ' | '.join(cells) + ' |'


def page(outcomes: list[Outcome]) -> str:
    """Return the page."""
    said = [f'- **{o.name[-1]}**: {o.found.remainder}' for o in outcomes
            if o.found.verdict is Verdict.OUTSIDE_CATALOGUE]  # fmt: skip
    seconds = sorted(o.seconds for o in outcomes)
    known = machine()
    return (
        HEAD
        + f'{line(COLUMNS)}\n{line(["---"] * len(COLUMNS))}\n'
        + '\n'.join(row(outcome) for outcome in outcomes)
        + '\n\n`soft_cell` (cell 4 is damaged) is in no catalogue.'
        '\nWhat is said of what remains:\n\n'
        + '\n'.join(said)
        + f'\n\nOne diagnosis took {seconds[0]:.1f} to {seconds[-1]:.1f} s, the median was '
        f'{seconds[len(seconds) // 2]:.1f} s\n(two threads on {known["processor"]}, '
        f'{known["cores"]} cores).\n'
    )


def main() -> int:
    """Judge all cases and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, default=ROOT / 'results' / 'blind_cases.md')
    options = parser.parse_args()
    truths = yaml.safe_load((BLIND / 'truth.yaml').read_text(encoding='utf-8'))
    outcomes = []
    for name, truth in truths.items():
        outcomes.append(judge(name, truth))
        print(row(outcomes[-1]), file=sys.stderr)
    options.output.parent.mkdir(exist_ok=True)
    options.output.write_text(page(outcomes), encoding='utf-8')
    print(f'written: {options.output}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
