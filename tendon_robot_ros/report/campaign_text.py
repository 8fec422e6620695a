"""What a campaign found, in words: rates with their intervals, and a table by hidden effect."""

from __future__ import annotations

import collections
from collections.abc import Sequence

import numpy as np

from ..campaign.figures import Power, grouped, powers, rates
from ..campaign.judge import NAMING, CaseRow
from ..common.words import columns, digits
from ..diagnosis.decide import Verdict

HIDDEN_COLUMNS = ('hidden', 'n', 'seen', 'right', 'wrong name', 'quiet', 'outside', 'some at once',
                  'class', 'inside', 'gone', 'time')  # fmt: skip

FITTED_COLUMNS = ('intervals of', 'hold', 'of', 'not determined')


def hidden_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per robot and hidden effect: how often it was seen, named, and how well."""
    return [
        [f'{robot}: {hidden}', *_row(members)]
        for (robot, hidden), members in grouped(rows, lambda r: (r.robot, r.hidden)).items()
    ]


def _row(rows: Sequence[CaseRow]) -> list[str]:
    verdicts = collections.Counter(row.verdict for row in rows)
    named = [row for row in rows if row.verdict in NAMING]
    inside = [row.inside for row in rows if row.inside is not None]
    gone = [row.gone for row in rows if row.gone is not None]
    return [
        f'{len(rows)}',
        f'{sum(row.visible for row in rows)}',
        f'{np.mean([row.right for row in rows]):.0%}',
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
    tables = [[HIDDEN_COLUMNS, *hidden_rows(rows)], *fitted]
    return [*map(columns, tables), *told, *worst]


def interval_rows(rows: Sequence[CaseRow]) -> list[list[str]]:
    """Return a row per robot, effect and parameter: how many 95 % intervals hold the truth."""
    hits: dict[tuple[str, str, str], list[bool]] = {}
    for row in rows:
        each = zip(row.parameter, row.low, row.truth, row.high, strict=True)
        for name, low, true, high in each:
            hits.setdefault((row.robot, row.hidden, name), []).append(low <= true <= high)
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
