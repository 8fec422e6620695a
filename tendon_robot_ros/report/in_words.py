"""What a script prints of a result, and what a notebook shows: `text()` and `_repr_html_`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import singledispatch
from html import escape

from ..common.results import TextResult
from ..common.words import columns, digits
from ..comparison.result import Comparison
from ..data import DataSet
from ..diagnosis.add import Addition
from ..diagnosis.result import Diagnosis, Improvement
from ..model.shape import Reach, Shape
from ..robot import Robot
from ..robot.description import XY
from . import comparison, diagnosis_text
from .diagnosis_page import CANDIDATE_HEAD, candidate_row
from .improvement_page import improvement_lines
from .page import Shown

Rows = list[list[str]]


def text(result: TextResult) -> str:
    """Return a result in words."""
    return '\n'.join(lines(result))


@singledispatch
def lines(result: TextResult) -> list[str]:
    """Return the lines of a result; without words of its own its `repr`, and its table."""
    table = rows(result)
    return [repr(result).strip('<>'), *([columns(table)] if table else [])]


@singledispatch
def rows(result: object) -> Rows:
    """Return the rows of a table that goes with the words, its head first; none: no table."""
    return []


def html(result: TextResult) -> str:
    """Return a result for a notebook: the words, and the table below."""
    table = rows(result)
    words = result.text()
    if table:
        words = words.removesuffix(columns(table)).rstrip()
    shown = [f'<pre style="white-space: pre-wrap">{escape(words)}</pre>']
    if table:
        shown += ['<table>', _row('th', table[0]), *(_row('td', row) for row in table[1:])]
        shown.append('</table>')
    return '\n'.join(shown)


def _row(tag: str, cells: list[str]) -> str:
    return f'<tr>{"".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells)}</tr>'


lines.register(Comparison, comparison.lines)
lines.register(Diagnosis, diagnosis_text.lines)
lines.register(Addition, diagnosis_text.addition_lines)
lines.register(Improvement, improvement_lines)


@rows.register
def _(result: Diagnosis) -> Rows:
    if not result.candidates:
        return []
    return [CANDIDATE_HEAD, *map(candidate_row, result.candidates)]


@rows.register
def _(result: DataSet) -> Rows:
    unit, scale = ('N', 1.0) if result.input == 'tension' else ('mm', 1e3)
    inputs = [f'{name} [{unit}]' for name in result.input_names]
    table = [['posture', *inputs, 'trials', 'markers seen', 'last marker at [mm]']]
    for p, posture in enumerate(result.postures[: Shown.ROWS]):
        values = [digits(scale * value, 3) for value in result.inputs[p].tolist()]
        visible = f'{int((result.counts[p] > 0).sum())} of {len(result.markers)}'
        tip = ', '.join(f'{1e3 * x:.1f}' for x in result.mean[p, -1].tolist())
        table.append([posture, *values, str(result.trials[p]), visible, tip])
    more = len(result.postures) - Shown.ROWS
    return [*table, [f'and {more} more']] if more > 0 else table


@rows.register
def _(result: Robot) -> Rows:
    table = [['tendon', 'offset x, y [mm]', 'ends in', 'pulled by']]
    for tendon in result.tendons:
        offset = route((tendon.base, tendon.end))
        if tendon.helix:
            offset += f', winds {1e-3 * math.degrees(tendon.helix):.4g}°/mm'
        elif tendon.offsets:
            offset += f' in {len(tendon.offsets)} steps'
        table.append([tendon.name, offset, tendon.section, tendon.group or tendon.name])
    return table


def route(offsets: Sequence[XY]) -> str:
    """Format where something lies in the first and the last cell [m], in millimetres."""
    first, last = ('{:g}, {:g}'.format(*(1e3 * v for v in at)) for at in (offsets[0], offsets[-1]))
    return first if first == last else f'{first} to {last}'


@rows.register
def _(result: Shape) -> Rows:
    pulled = enumerate(zip(result.inputs, result.pulls, strict=True))
    body = [[str(i + 1), f'{tension:.4g}', f'{1e3 * pull:.4g}'] for i, (tension, pull) in pulled]
    return [['input', 'tension [N]', 'wire pull [mm]'], *body]


rows.register(Reach, lambda result: rows(result.shape))
