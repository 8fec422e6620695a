"""
Ask what a set-up could see before it is built, and how often the diagnosis is right.

PLAN (YAML) lists robots, hidden effects, sizes, designs (postures, trials, markers), noise,
imperfections and how often each is repeated; every combination is simulated and diagnosed.
OUTPUT holds the table (Parquet files that grow while it runs), campaign.html and campaign.json.
Ctrl-C, a lost scheduler or a power cut lose the last seconds: the same command goes on. A plan may
grow between two runs: more seeds, effects or sizes are added to what is there.

Work is spread over --workers processes of this machine, or over the workers of a dask scheduler
(--cluster). Results do not depend on where they are computed. docs/campaigns.md has more.

example: python -m tendon_robot_ros campaign examples/campaign.yaml --output power
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .options import add_cluster, add_effect_files, add_json, emit
from .progress import progress

HELP = 'simulate and diagnose many robots: what would be seen, how often is it right'
PAGE = 'campaign.html'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('plan', metavar='PLAN', help='what to simulate (YAML)')
    add('--output', metavar='DIR', required=True, help='folder of the table and the page')
    add('--dry-run', action='store_true', help='count the cases, and say what is there already')
    add('--accept-change', action='store_true',
        help='go on in a folder that other versions have begun; what is there stays')  # fmt: skip
    add_cluster(parser)
    add_json(parser)
    add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Run what is left of a plan, print, write."""
    from ..campaign.figures import to_json
    from ..campaign.judge import compile_for
    from ..campaign.plan import read_plan
    from ..campaign.running import earlier_rows, rows_of, run_plan
    from ..campaign.versions import Preparation
    from ..common.workers import Workers
    from ..report.campaign_page import campaign_page, power_lines, summary

    plan, folder = read_plan(args.plan, args.effect_file), Path(args.output)
    if args.dry_run:
        there = len(rows_of(plan, folder)) if folder.exists() else 0
        print(f'{len(plan.cases):,} cases, {there:,} of them are there')
        return 0
    compile_for(plan.setup)
    prepare = Preparation.here(plan.setup.effects)
    page = folder / PAGE
    stopped = False
    try:
        with Workers(args.workers, args.cluster, prepare) as workers, progress(True) as show:
            rows = run_plan(plan, folder, workers, show, args.accept_change)
    except KeyboardInterrupt:
        rows, stopped = rows_of(plan, folder), True
    mixed = earlier_rows(folder) if rows else []
    if rows:
        title = f'Campaign: {Path(args.plan).stem}'
        campaign_page(rows, title, len(plan.cases), mixed).write(page)
    if stopped:
        print(
            f'stopped: {len(rows):,} of {len(plan.cases):,} cases are in {folder}; '
            'the same command goes on from there',
            file=sys.stderr,
        )
        return 130
    lines = [*summary(rows), *power_lines(rows), *mixed, f'written: {folder}/table, {page}']
    emit(args, to_json(rows), '\n'.join(lines))
    return 0
