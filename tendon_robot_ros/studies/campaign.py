"""
Ask what a set-up could see before it is built, and how often the diagnosis is right.

PLAN (YAML) lists robots, hidden effects, sizes, designs (postures, trials, markers), noise,
imperfections and how often each is repeated; every combination is simulated and diagnosed.
OUTPUT holds the table (Parquet files that grow while it runs), campaign.html and campaign.json.
Ctrl-C, a lost scheduler or a power cut lose the last seconds: the same command goes on. A plan may
grow between two runs: more seeds, effects or sizes are added to what is there.

Work is spread over --workers processes of this machine, or over the workers of a dask scheduler
(--cluster). Results do not depend on where they are computed. docs/campaigns.md has more.

example: python -m tendon_robot_ros study campaign examples/campaign.yaml --output power
"""

from __future__ import annotations

import argparse
import collections
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ..cli.main import ExitCode
from ..cli.options import add_cluster, declare, emit, progress
from ..common.colours import BAND, ERROR, PREDICTED, line_style
from ..common.words import columns, digits, grouped
from ..common.workers import Workers
from ..diagnosis.verdict import Verdict
from ..model.versions import Preparation
from ..report.page import Figure, Page, Trace, axes, curve, error_bars, titled, trace
from ..simulation.hidden import CAUSES
from . import judge
from .cases import NOTHING
from .judge import NAMING, CaseRow, Power, Rate
from .plan import earlier_rows, read_plan, run_plan, table_of

HELP = 'simulate and diagnose many robots: what would be seen, how often is it right'
PAGE = 'campaign.html'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('plan', metavar='PLAN', help='what to simulate (YAML)')
    add('--output', metavar='DIR', required=True, help='folder of the table and the page')
    add('--dry-run', action='store_true', help='count the cases, and say what is there already')
    words = 'go on in a folder that other versions have begun; what is there stays'
    add('--accept-change', action='store_true', help=words)
    add_cluster(parser)
    declare(parser, '--json', '--effect-file')


def run(args: argparse.Namespace) -> int:
    """Run the cases of a plan that are missing, print, write."""
    plan, folder = read_plan(args.plan, args.effect_file), Path(args.output)
    if args.dry_run:
        finished = len(table_of(folder).rows_of(plan.cases)) if folder.exists() else 0
        print(f'{len(plan.cases):,} cases, {finished:,} of them are there')
        return 0
    plan.setup.compile()
    prepare = Preparation.of_this_process(plan.setup.effects)
    page, stopped = folder / PAGE, False
    try:
        with Workers(args.workers, args.cluster, prepare) as workers, progress(True) as show:
            rows = run_plan(plan, folder, workers, show, args.accept_change)
    except KeyboardInterrupt:
        rows, stopped = table_of(folder).rows_of(plan.cases), True
    mixed = earlier_rows(folder) if rows else []
    if rows:
        title = f'Campaign: {Path(args.plan).stem}'
        campaign_page(rows, title, len(plan.cases), mixed).write(page)
    if stopped:
        there = f'{len(rows):,} of {len(plan.cases):,} cases are in {folder}'
        print(f'stopped: {there}; the same command goes on from there', file=sys.stderr)
        return ExitCode.INTERRUPTED
    lines = [*summary(rows), *power_lines(rows), *mixed, f'written: {folder}/table, {page}']
    emit(args, judge.to_json(rows), '\n'.join(lines))
    return 0


HIDDEN_MEANING = (
    'seen: stands out of noise and imperfections; of effects, how many of these were right, with '
    'the 95 % interval; quiet: nothing was said to be missing; class: '
    'effects named together, on average; inside: 95 % intervals that hold the truth; gone: error '
    'taken off postures not used (median); time: of the processor for a diagnosis (median).'
)


def hidden_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per robot and hidden effect: rates and accuracy; the names come first."""
    table: list[dict[str, str]] = []
    groups = grouped(rows, lambda row: (row.robot, row.hidden)).items()
    for ((robot, hidden), members), rate in zip(groups, judge.rates_by_hidden(rows), strict=True):
        verdicts = collections.Counter(row.verdict for row in members)
        is_effect = hidden not in (NOTHING, *CAUSES)
        named = [row for row in members if row.verdict in NAMING]
        removed = [row.gone for row in members if row.gone is not None and hidden != NOTHING]
        alike = [max(len(row.group), 1) for row in named]
        cells = {
            'hidden': f'{robot}: {hidden}',
            'n': f'{len(members)}',
            'right': f'{rate["right"].share:.0%}',
            'seen': f'{rate["right_if_seen"].runs}',
            'right of these': f'{rate["right_if_seen"]}' if is_effect else '–',
            'wrong name': f'{rate["wrong_names"].hits}',
            'quiet': f'{verdicts[Verdict.ADEQUATE]}',
            'outside': f'{verdicts[Verdict.OUTSIDE_CATALOGUE]}',
            'some at once': f'{verdicts[Verdict.SEVERAL]}',
            'class': f'{np.mean(alike):.1f}' if named else '–',
            'inside': f'{rate["inside"].share:.0%}' if rate['inside'].runs else '–',
            'gone': f'{np.median(removed):.0%}' if removed else '–',
            'time': f'{np.median([row.seconds for row in members]):.1f} s',
        }
        table.append(cells)
    return [[*table[0]], *([*cells.values()] for cells in table)]


def rate_lines(rows: Sequence[CaseRow]) -> list[str]:
    """Describe the rates that have cases."""
    return [f'{name}: {rate}' for name, rate in judge.rates(rows).items() if rate.runs]


def summary(rows: Sequence[CaseRow]) -> list[str]:
    """Return the table by hidden effect and the rates."""
    texts = rate_lines(rows)
    if named := [max(len(row.group), 1) for row in rows if row.right and row.effects]:
        texts.append(f'members of a class that is right, mean: {np.mean(named):.1f}')
    seconds = np.median([row.seconds for row in rows])
    texts.append(f'a diagnosis, median: {seconds:.2g} s of processor time')
    problems = collections.Counter(row.problem for row in rows if row.problem)
    worst = [f'{count} x {problem}' for problem, count in problems.most_common(3)]
    tables = [hidden_rows(rows)]
    if any(row.truth for row in rows):
        tables.append(interval_rows(rows))
    if by_robot := robot_rows(rows):
        tables.append(by_robot)
    return [*map(columns, tables), *texts, *worst]


def robot_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return the rates robot by robot, with a header; nothing where there is one robot."""
    by_robot = judge.rates_by_robot(rows)
    if len(by_robot) < 2:
        return []
    names = [name for name, rate in judge.rates(rows).items() if rate.runs]
    lines = [[name, *(str(each[name]) for each in by_robot.values())] for name in names]
    return [['by robot', *by_robot], *lines]


def interval_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per robot, effect and parameter: how many of its 95 % intervals hold it."""
    hits: dict[tuple[str, str, str], list[bool]] = {}
    for row in rows:
        for name, held in zip(row.parameter, row.held, strict=True):
            hits.setdefault((row.robot, row.hidden, name), []).append(held)
    refused = collections.Counter((row.robot, row.hidden) for row in rows if row.problem)
    table = [['intervals of', 'hold', 'of', 'not determined']]
    for (robot, hidden, name), every in sorted(hits.items()):
        counts = f'{np.mean(every):.1%}', f'{len(every)}', f'{refused[robot, hidden]}'
        table.append([f'{robot}: {hidden} {name}', *counts])
    return table


def smallest_text(power: Power) -> str:
    """Describe the size from which on an effect is named in four of five cases."""
    if power.smallest is None:
        rate = power.right[-1]
        size = digits(power.sizes[-1])
        return f'in {rate.hits} of {rate.runs} cases at {size} times the typical size'
    or_less = ', or less' if power.smallest == power.sizes[0] else ''
    return f'from {digits(power.smallest)} times the typical size on{or_less}'


def power_lines(rows: Sequence[CaseRow]) -> list[str]:
    """Describe the smallest detected size of every effect."""
    return [
        f'{power.robot}: {power.hidden}{f" ({power.way})" if power.way else ""}: '
        f'named {smallest_text(power)}'
        for power in judge.powers(rows)
    ]


NAMED = (
    'Named: the verdict names it, or a class of effects with it that cannot be told apart. The '
    'table says from which size on that happens in four of five cases.'
)


def campaign_page(rows: Sequence[CaseRow], title: str, total: int, mixed: Sequence[str]) -> Page:
    """Return the page of the finished rows out of `total` cases; `mixed` warns of versions."""
    page = Page(title, f'{len(rows):,} of {total:,} cases')
    page.box(rate_lines(rows), 'verdict', 'In short, with 95 % intervals')
    if by_robot := robot_rows(rows):
        page.table(by_robot, left=[0])
    if mixed:
        page.box(mixed, 'warn', 'Rows of several versions')

    page.heading('Which size of an effect is seen')
    page.text(NAMED)
    curves = grouped(judge.powers(rows), lambda power: power.hidden)
    page.figures([power_figure(name, members) for name, members in curves.items()], 'many')
    cells = [['robot', 'effect', 'measured so', 'named in four of five cases']]
    for one in chain.from_iterable(curves.values()):
        cells.append([one.robot, one.hidden, one.way or 'all', smallest_text(one)])
    page.table(cells, left=[0, 1, 2, 3])

    page.heading('What is said of what is hidden')
    page.figures([confusion_figure(rows)])
    page.table(hidden_rows(rows), left=[0])
    page.text(HIDDEN_MEANING)

    page.heading('Intervals')
    page.figures([coverage_figure(rows)])

    page.heading('What postures, trials and markers cost')
    page.table(cost_rows(rows), left=[0])
    return page


def cost_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per method of measurement over the same arms: rates and computing time."""
    table = [['measured so', 'effects seen', 'named', 'nothing hidden: said so', 'a diagnosis']]
    for way, members in grouped(rows, judge.methods(rows)).items():
        hidden = [row for row in members if row.hidden not in (NOTHING, *CAUSES)]
        counted = (
            Rate.of(row.alarm for row in hidden),
            Rate.of(row.right for row in hidden),
            Rate.of(row.right for row in members if row.hidden == NOTHING),
        )
        seconds = float(np.median([row.seconds for row in members]))
        table.append([way or 'all', *map(str, counted), f'{digits(seconds)} s'])
    return table


def power_figure(name: str, powers_of_it: Sequence[Power]) -> Figure:
    """Draw how often one effect is named, over its size; a curve per robot and method."""
    several = len({power.robot for power in powers_of_it}) > 1
    data: list[dict[str, Any]] = []
    for i, power in enumerate(powers_of_it):
        label = '; '.join(filter(None, (power.robot if several else '', power.way)))
        (rates, bars), size = percentages(power.right), 7 + 3 * min(i, 3)  # none hides another
        line = curve(list(power.sizes), rates, label, line_style(i), size=size, error_y=bars)
        data.append({**line, 'showlegend': len(powers_of_it) > 1})
    x, y = titled('size, times the typical one', type='log'), titled('named [%]', range=[-4, 104])
    layout = axes(x, y, legend={'orientation': 'h', 'y': -0.35, 'x': 0.0, 'font': {'size': 11}})
    caption = 'bars: 95 % intervals of the rates; a size of 1 is the typical one of the catalogue'
    return Figure(data, layout, name, caption, 300 + 24 * len(data))


def percentages(counted: Sequence[Rate]) -> tuple[list[float], dict[str, Any]]:
    """Return rates [%], and their 95 % intervals as bars."""
    share, low, high = np.array([(rate.share or 0.0, *rate.interval) for rate in counted]).T
    up, down = (100.0 * (high - share)).tolist(), (100.0 * (share - low)).tolist()
    return (100.0 * share).tolist(), error_bars(up, down, width=3)


def confusion_figure(rows: Sequence[CaseRow]) -> Figure:
    """Draw the verdicts over the hidden effects (confusion matrix)."""
    hidden, words, counts = judge.confusion(rows)
    heat = {
        'type': 'heatmap',
        'x': words,
        'y': hidden,
        'z': [[100.0 * n / max(sum(row), 1) for n in row] for row in counts],
        'text': [[str(n or '') for n in row] for row in counts],
        'texttemplate': '%{text}',
        'hovertemplate': '%{y}: said %{x}: %{text}<extra></extra>',
        'colorscale': [[0.0, '#ffffff'], [1.0, PREDICTED]],
        'zmin': 0.0,
        'zmax': 100.0,
        'showscale': False,
    }
    # a little off, so that the title does not lie on long names
    y = {'title': {'text': 'hidden', 'standoff': 8}, 'autorange': 'reversed', 'type': 'category'}
    layout = axes({'tickangle': -60, 'type': 'category'}, y)
    caption = 'cases; a class of effects that cannot be told apart counts as the hidden member'
    title = 'What was said (columns) of what was hidden (rows)'
    return Figure([heat], layout, title, caption, 260 + 24 * len(hidden))


def coverage_figure(rows: Sequence[CaseRow]) -> Figure:
    """Draw the coverage of intervals over their nominal confidence."""
    counted = judge.coverage(rows)
    held = [rate for _, rate in counted]
    rates, bars = percentages(held)
    low = max(0.0, min([40.0, *(percentage - 15.0 for percentage in rates)]))
    ends, promised = [low, 104.0], [100.0 * nominal for nominal, _ in counted]
    line = {'color': ERROR, 'width': 2, 'dash': 'dot'}
    area: Trace = {'fill': 'toself', 'fillcolor': BAND, 'hoverinfo': 'skip', 'line': {'width': 0}}
    style: Trace = {'line': {'color': PREDICTED}, 'marker': {'size': 8}, 'error_y': bars}
    style |= {'text': [f'{percentage:.0f} %' for percentage in rates], 'textposition': 'top left'}
    traces = [
        trace([low, 104.0, 104.0], [low, 104.0, low], 'too narrow', **area),
        trace(ends, ends, 'as promised', line=line),
        trace(promised, rates, 'found', 'lines+markers+text', **style),
    ]
    x = titled('intervals promise [%]', range=ends)
    layout = axes(x, titled('hold the true value [%]', range=ends))
    caption = (
        'Of all intervals of 95 %, 95 in 100 should hold the true value. A point on the dotted '
        'line is as promised; below it (grey) intervals are too narrow, above it wider than '
        f'needed. {held[0].runs} intervals of named effects, narrower ones scaled from those of '
        '95 %; bars: how well the shares are known (95 %).'
    )
    return Figure(traces, layout, 'Do intervals hold the true value?', caption, 400)
