"""
Reproduce the experiments of Kato et al. 2015 (section IV) and put the published numbers beside.

OUTPUT gets paper.html (figures and table; opens without a network) and paper.json (the table).
With --robots, kato_1_1.yaml, kato_10_1.yaml, kato_10_1_single.yaml and kato_2_1.yaml are read from
a folder of your own.

example: python -m tendon_robot_ros paper --output results/paper
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from ..common.errors import InputError
from ..common.files import new_folder
from ..common.words import columns, digits
from ..robot import load_robot
from .progress import progress

HELP = "the paper's experiments, published numbers beside ours, on one page"
PAPER_ROBOTS = ('kato_1_1', 'kato_10_1', 'kato_10_1_single', 'kato_2_1')
PAPER_FILES = ('paper.html', 'paper.json')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('--output', required=True, metavar='DIR', help='folder for the page and the table')
    add('--overwrite', action='store_true', help='replace them in that folder')
    add('--robots', metavar='DIR', help="folder with robots of your own instead of the paper's")


def run(args: argparse.Namespace) -> int:
    """Run everything, print the table, write the page."""
    from ..paper.experiments import reproduce
    from ..paper.robots import Robots
    from ..report.paper_page import paper_page

    folder = Path(args.output)
    if folder.exists() and any(folder.iterdir()) and not args.overwrite:
        raise InputError(f'{folder}: is not empty; use --overwrite or another --output')
    own = robots_folder(args.robots)
    robots = Robots(*(load_robot(own / f'{name}.yaml') for name in PAPER_ROBOTS))
    with progress() as show:
        paper = reproduce(robots, show)
    page = paper_page(paper)
    with new_folder(folder, PAPER_FILES) as draft:
        page.write(draft / PAPER_FILES[0])
        (draft / PAPER_FILES[1]).write_text(
            json.dumps(paper.to_json(), indent=1), encoding='utf-8'
        )
    header = ('', 'what', 'published', 'ours', 'range left open', 'met')
    rows = [
        (row.section, row.what, f'{row.published:g} {row.unit}', f'{digits(row.ours, 3)}',
         f'{digits(row.low, 3)} to {digits(row.high, 3)}', row.met)
        for row in paper.rows
    ]  # fmt: skip
    print(columns([header, *rows]))
    print(f'written: {folder / PAPER_FILES[0]}, {folder / PAPER_FILES[1]}')
    return 0


def robots_folder(named: str | None) -> Path:
    """Return the folder of the robots: the one given, the source tree's, the installed one."""
    if named:
        return Path(named)
    source = Path(__file__).resolve().parents[2]
    installed = Path(sys.prefix) / 'share' / 'tendon_robot_ros'
    roots = [root / 'config' / 'robots' for root in (source, installed)]
    folder = next((root for root in roots if root.is_dir()), None)
    if folder is None:
        raise InputError('paper: config/robots is not installed; name its folder with --robots')
    return folder
