"""
Diagnose all recordings and data sets below a folder, and say what changed when, robot by robot.

Robots are told apart by the name in their descriptions. When something was measured is told by a
date in its name (2026-03-14, 20260314), else by the recording itself, else by its files.
OUTPUT holds the table (Parquet) and fleet.html; what stands in the table is not diagnosed again,
so that the same command adds what has come since.

example: python -m tendon_robot_ros fleet recordings --output history
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from .options import add_cluster, add_effect_files, add_json, emit
from .progress import progress

HELP = 'diagnose all recordings of many robots, and say what changed when'
PAGE = 'fleet.html'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('folder', metavar='DIR', help='with data sets and recordings below it')
    add('--output', metavar='DIR', required=True, help='folder of the table and the page')
    add_cluster(parser)
    add_json(parser)
    add_effect_files(parser)


def run(args: argparse.Namespace) -> int:
    """Diagnose what is new, print, write."""
    from ..campaign.fleet import changes, found_below, run_fleet
    from ..campaign.versions import Preparation, UserEffect
    from ..common.workers import Workers
    from ..report.fleet_page import fleet_page, fleet_text

    folder, output = Path(args.folder), Path(args.output)
    found_below(folder)
    effects = UserEffect.read(args.effect_file)
    prepare = Preparation.here(effects)
    with Workers(args.workers, args.cluster, prepare) as workers, progress(True) as show:
        rows = run_fleet(folder, output, workers, effects, show)
    page = fleet_page(rows, f'Fleet: {folder.resolve().name}').write(output / PAGE)
    content = {
        'recordings': [asdict(row) for row in rows],
        'changes': [asdict(change) for change in changes(rows)],
    }
    emit(args, content, '\n'.join([*fleet_text(rows), f'written: {output}/table, {page}']))
    return 0
