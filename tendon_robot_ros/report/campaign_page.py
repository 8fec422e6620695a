"""A campaign as text and page: power curves, confusion, intervals, false alarms, costs."""

from __future__ import annotations

import collections
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from ..campaign.cases import NOTHING
from ..campaign.figures import (
    Power,
    Rate,
    clean_rows,
    confusion,
    costs,
    coverage,
    grouped,
    powers,
    rates,
    rates_by_robot,
)
from ..campaign.judge import NAMING, CaseRow
from ..common.colours import BAND, COLOURS, DASHES, ERROR, PREDICTED
from ..common.words import columns, digits
from ..diagnosis.decide import Verdict
from ..simulation.hidden import CAUSES
from .page import Figure, Page

HIDDEN_COLUMNS = ('hidden', 'n', 'right', 'seen', 'right of these', 'wrong name', 'quiet',
                  'outside', 'some at once', 'class', 'inside', 'gone', 'time')  # fmt: skip

HIDDEN_MEANING = (
    'seen: stands out of noise and imperfections; of effects, how many of these were right, with '
    'the 95 % interval; quiet: nothing was said to be missing; class: '
    'effects named together, on average; inside: 95 % intervals that hold the truth; gone: error '
    'taken off postures not used (median); time: of the processor for a diagnosis (median).'
)

MARKERS = ('circle', 'square-open', 'diamond-open', 'circle-open')  # none hides another

FITTED_COLUMNS = ('intervals of', 'hold', 'of', 'not determined')


def hidden_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per robot and hidden effect: how often it was seen, named, and how well."""
    return [
        [f'{robot}: {hidden}', *_row(members)]
        for (robot, hidden), members in grouped(rows, lambda r: (r.robot, r.hidden)).items()
    ]


def _row(rows: Sequence[CaseRow]) -> list[str]:
    verdicts = collections.Counter(row.verdict for row in rows)
    seen = [row for row in rows if row.visible]
    is_effect = rows[0].hidden not in (NOTHING, *CAUSES)
    named = [row for row in rows if row.verdict in NAMING]
    inside = [held for row in rows for held in row.held]
    gone = [row.gone for row in rows if row.gone is not None and row.hidden != NOTHING]
    return [
        f'{len(rows)}',
        f'{np.mean([row.right for row in rows]):.0%}',
        f'{len(seen)}',
        str(Rate.of(row.right for row in seen)) if is_effect else '–',
        f'{sum(row.wrong_name for row in rows)}',
        f'{verdicts[Verdict.ADEQUATE]}',
        f'{verdicts[Verdict.OUTSIDE_CATALOGUE]}',
        f'{verdicts[Verdict.SEVERAL]}',
        f'{np.mean([max(len(row.group), 1) for row in named]):.1f}' if named else '–',
        f'{np.mean(inside):.0%}' if inside else '–',
        f'{np.median(gone):.0%}' if gone else '–',
        f'{np.median([row.seconds for row in rows]):.1f} s',
    ]


def summary(rows: Sequence[CaseRow]) -> list[str]:
    """Return the table by hidden effect and the rates."""
    told = [f'{name}: {rate}' for name, rate in rates(rows).items() if rate.runs]
    named = [max(len(row.group), 1) for row in rows if row.right and row.effects]
    if named:
        told.append(f'members of a class that is right, mean: {np.mean(named):.1f}')
    if rows:
        told.append(f'a diagnosis, median: {np.median([row.seconds for row in rows]):.2g} s of '
                    'processor time')  # fmt: skip
    problems = collections.Counter(row.problem for row in rows if row.problem)
    worst = [f'{count} x {problem}' for problem, count in problems.most_common(3)]
    fitted = [[FITTED_COLUMNS, *interval_rows(rows)]] if any(r.truth for r in rows) else []
    tables: list[list[Sequence[str]]] = [[HIDDEN_COLUMNS, *hidden_rows(rows)], *fitted]
    if by_robot := robot_rows(rows):
        tables.append([*by_robot])
    return [*map(columns, tables), *told, *worst]


def robot_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return the rates robot by robot, with a header; nothing where there is one robot."""
    found = rates_by_robot(rows)
    if len(found) < 2:
        return []
    names = [name for name, rate in rates(rows).items() if rate.runs]
    lines = [[name, *(str(each[name]) for each in found.values())] for name in names]
    return [['by robot', *found], *lines]


def interval_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per robot, effect and parameter: how many 95 % intervals hold the truth."""
    hits: dict[tuple[str, str, str], list[bool]] = {}
    for row in rows:
        for name, held in zip(row.parameter, row.held, strict=True):
            hits.setdefault((row.robot, row.hidden, name), []).append(held)
    refused = collections.Counter((r.robot, r.hidden) for r in rows if r.problem)
    return [
        [f'{robot}: {hidden} {name}', f'{np.mean(held):.1%}', f'{len(held)}',
         f'{refused[robot, hidden]}']
        for (robot, hidden, name), held in sorted(hits.items())
    ]  # fmt: skip


def smallest_text(power: Power) -> str:
    """Say from which size on an effect is named in four of five cases."""
    if power.smallest is None:
        rate = power.right[-1]
        size = digits(power.sizes[-1])
        return f'in {rate.hits} of {rate.runs} cases at {size} times the typical size'
    if power.smallest == power.sizes[0]:
        return f'from {digits(power.sizes[0])} times the typical size on, or less'
    return f'from {digits(power.smallest)} times the typical size on'


def power_lines(rows: Sequence[CaseRow]) -> list[str]:
    """Say for every effect which size is seen."""
    found = powers(rows)
    return [
        f'{power.robot}: {power.hidden}{f" ({power.way})" if power.way else ""}: '
        f'named {smallest_text(power)}'
        for power in found
    ]


NAMED = (
    'Named: the verdict names it, or a class of effects with it that cannot be told apart. The '
    'table says from which size on that happens in four of five cases.'
)
CAPTION = 'bars: 95 % intervals of the rates; a size of 1 is the typical one of the catalogue'


def campaign_page(
    rows: Sequence[CaseRow], title: str, total: int, mixed: Sequence[str] = ()
) -> Page:
    """Return the page of the rows that are there, of so many cases; `mixed` warns of others."""
    page = Page(title, f'{len(rows):,} of {total:,} cases')
    told = [f'{name}: {rate}' for name, rate in rates(rows).items() if rate.runs]
    page.box(told, 'verdict', 'In short, with 95 % intervals')
    if by_robot := robot_rows(rows):
        page.table(by_robot[0], by_robot[1:], left=[0])
    if mixed:
        page.box(mixed, 'warn', 'Rows of several versions')
    page.heading('Which size of an effect is seen')
    page.text(NAMED)
    curves = grouped_powers(powers(rows))
    page.figures([power_figure(name, members) for name, members in curves.items()], 'many')
    _smallest(page, [power for members in curves.values() for power in members])
    page.heading('What is said of what is hidden')
    page.figures([confusion_figure(rows)])
    page.table(HIDDEN_COLUMNS, hidden_rows(rows), left=[0])
    page.text(HIDDEN_MEANING)
    page.heading('Intervals and false alarms')
    page.figures([coverage_figure(rows)])
    _clean(page, rows)
    page.heading('What postures, trials and markers cost')
    header = ('measured so', 'effects seen', 'named', 'nothing hidden: said so', 'a diagnosis')
    found = [
        [
            one.way or 'all',
            str(one.alarms),
            str(one.right),
            str(one.quiet),
            f'{digits(one.seconds)} s',
        ]
        for one in costs(rows)
    ]
    page.table(header, found, left=[0])
    return page


def grouped_powers(found: Sequence[Power]) -> dict[str, list[Power]]:
    """Put the curves of one effect into one figure."""
    groups: dict[str, list[Power]] = {}
    for power in found:
        groups.setdefault(power.hidden, []).append(power)
    return groups


def power_figure(name: str, curves: Sequence[Power]) -> Figure:
    """Draw how often one effect is named, over its size; a curve per robot and way."""
    several = len({curve.robot for curve in curves}) > 1
    data: list[dict[str, Any]] = []
    for i, curve in enumerate(curves):
        label = '; '.join(filter(None, (curve.robot if several else '', curve.way)))
        data.append(
            {
                'x': list(curve.sizes),
                'y': [100.0 * (rate.share or 0.0) for rate in curve.right],
                'name': escape(label),
                'mode': 'lines+markers',
                'line': {'color': COLOURS[i % len(COLOURS)], 'dash': DASHES[i % len(DASHES)]},
                'marker': {'symbol': MARKERS[i % len(MARKERS)], 'size': 7 + 3 * min(i, 3)},
                'error_y': error_bars(curve.right),
                'showlegend': len(curves) > 1,
            }
        )
    layout = {
        'xaxis': {'type': 'log', 'title': {'text': 'size, times the typical one'}},
        'yaxis': {'title': {'text': 'named [%]'}, 'range': [-4, 104]},
        'legend': {'orientation': 'h', 'y': -0.35, 'x': 0.0, 'font': {'size': 11}},
    }
    return Figure(data, layout, name, CAPTION, 300 + 24 * len(data))


def error_bars(found: Sequence[Rate]) -> dict[str, Any]:
    """Return the 95 % intervals of rates as plotly draws them [%]."""
    shares = [rate.share or 0.0 for rate in found]
    ends = [rate.interval for rate in found]
    return {
        'type': 'data',
        'symmetric': False,
        'array': [100.0 * (high - s) for s, (_, high) in zip(shares, ends, strict=True)],
        'arrayminus': [100.0 * (s - low) for s, (low, _) in zip(shares, ends, strict=True)],
        'thickness': 1,
        'width': 3,
    }


def confusion_figure(rows: Sequence[CaseRow]) -> Figure:
    """Draw what was said of what was hidden."""
    hidden, words, counts = confusion(rows)
    shares = [[100.0 * n / max(sum(row), 1) for n in row] for row in counts]
    data = [
        {
            'type': 'heatmap',
            'x': words,
            'y': hidden,
            'z': shares,
            'text': [[str(n or '') for n in row] for row in counts],
            'texttemplate': '%{text}',
            'hovertemplate': '%{y}: said %{x}: %{text}<extra></extra>',
            'colorscale': [[0.0, '#ffffff'], [1.0, PREDICTED]],
            'zmin': 0.0,
            'zmax': 100.0,
            'showscale': False,
        }
    ]
    layout = {
        'xaxis': {'tickangle': -60, 'type': 'category'},
        'yaxis': {
            'title': {'text': 'hidden', 'standoff': 8},
            'autorange': 'reversed',
            'type': 'category',
        },
    }
    caption = 'cases; a class of effects that cannot be told apart counts as the hidden member'
    title = 'What was said (columns) of what was hidden (rows)'
    return Figure(data, layout, title, caption, 260 + 24 * len(hidden))


def coverage_figure(rows: Sequence[CaseRow]) -> Figure:
    """Draw how many intervals hold the true value against how many should."""
    found = coverage(rows)
    nominal = [100.0 * share for share, _ in found]
    held = [rate for _, rate in found]
    shares = [100.0 * (rate.share or 0.0) for rate in held]
    low = max(0.0, min([40.0, *(share - 15.0 for share in shares)]))
    data: list[dict[str, Any]] = [
        *_as_promised(low),
        {
            'x': nominal,
            'y': shares,
            'text': [f'{share:.0f} %' for share in shares],
            'textposition': 'top left',
            'name': 'found',
            'mode': 'lines+markers+text',
            'line': {'color': PREDICTED},
            'marker': {'size': 8},
            'error_y': error_bars(held),
        },
    ]
    layout = {
        'xaxis': {'title': {'text': 'intervals promise [%]'}, 'range': [low, 104.0]},
        'yaxis': {'title': {'text': 'hold the true value [%]'}, 'range': [low, 104.0]},
    }
    count = held[0].runs if held else 0
    caption = (
        'Of all intervals of 95 %, 95 in 100 should hold the true value. A point on the dotted '
        'line is as promised; below it (grey) intervals are too narrow, above it wider than '
        f'needed. {count} intervals of named effects, narrower ones scaled from those of 95 %; '
        'bars: how well the shares are known (95 %).'
    )
    return Figure(data, layout, 'Do intervals hold the true value?', caption, 400)


def _as_promised(low: float) -> list[dict[str, Any]]:
    """Draw the line of intervals that hold as often as they promise, and what is too narrow."""
    return [
        {
            'x': [low, 104.0, 104.0],
            'y': [low, 104.0, low],
            'mode': 'lines',
            'fill': 'toself',
            'fillcolor': BAND,
            'name': 'too narrow',
            'hoverinfo': 'skip',
            'line': {'width': 0},
        },
        {
            'x': [low, 104.0],
            'y': [low, 104.0],
            'mode': 'lines',
            'name': 'as promised',
            'line': {'color': ERROR, 'width': 2, 'dash': 'dot'},
        },
    ]


def _smallest(page: Page, found: Sequence[Power]) -> None:
    rows = [[one.robot, one.hidden, one.way or 'all', smallest_text(one)] for one in found]
    page.table(('robot', 'effect', 'measured so', 'named in four of five cases'), rows,
               left=[0, 1, 2, 3])  # fmt: skip


def _clean(page: Page, rows: Sequence[CaseRow]) -> None:
    found = [[robot, way or 'all', str(alarms), str(named)]
             for robot, way, alarms, named in clean_rows(rows)]  # fmt: skip
    if found:
        header = ('robot', 'measured so', 'any alarm', 'an effect named')
        page.text('With nothing hidden:')
        page.table(header, found, left=[0, 1])
