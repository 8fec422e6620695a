"""A benchmark that is a plan: read it, change it as the options say, run it, tell its figures."""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import yaml
from machine import machine, tell

from tendon_robot_ros.cli.options import progress
from tendon_robot_ros.common.workers import Workers
from tendon_robot_ros.model.versions import Preparation
from tendon_robot_ros.studies.campaign import summary
from tendon_robot_ros.studies.judge import to_json
from tendon_robot_ros.studies.plan import plan_of, run_plan

PLANS = Path(__file__).parent / 'plans'


def parser_of(about: str, seeds: int) -> argparse.ArgumentParser:
    """Return a parser with what all plans can be told."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument('--seeds', type=int, default=seeds)
    parser.add_argument('--effects', nargs='*')
    parser.add_argument('--workers', type=int, default=os.cpu_count())
    parser.add_argument('--cluster', default='', help='address of a dask scheduler')
    parser.add_argument('--output', type=Path, help='folder of the table: goes on where it was')
    parser.add_argument('--json', type=Path)
    return parser


def run(name: str, options: argparse.Namespace, **changes: object) -> int:
    """Run a plan of this folder, with changes, and print what came of it."""
    content = yaml.safe_load((PLANS / f'{name}.yaml').read_text(encoding='utf-8'))
    content |= {'seeds': options.seeds, **changes}
    if options.effects:
        content['hidden'] = options.effects
    plan = plan_of(content, f'{name}.yaml', PLANS)
    plan.setup.compile()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.output or Path(scratch) / name
        with (
            Workers(options.workers, options.cluster, Preparation.of_this_process()) as workers,
            progress(True) as show,
        ):
            rows = run_plan(plan, folder, workers, show)
    print('\n'.join(summary(rows)))
    if options.json:
        tell({'machine': machine(), 'plan': content, **to_json(rows)}, options.json)
    return 0
