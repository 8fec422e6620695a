"""A fleet as text and page: what was said of every robot over time, and what changed when."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from ..campaign.fleet import FleetRow, changes, histories, tracked, words_of
from ..campaign.judge import ERROR
from ..common.colours import BEFORE, FLOOR, PREDICTED
from ..common.words import columns, mm, scale_of
from .page import Figure, Page

COLUMNS = ('robot', 'when', 'measurements', 'verdict', 'error', 'with it', 'noise floor')
NO_CHANGE = 'Nothing changed from one recording to the next.'


def fleet_rows(rows: Sequence[FleetRow]) -> list[list[str]]:
    """Return a row per recording that could be read."""
    return [
        [row.robot, when_text(row), row.place, words_of(row), mm(row.before), mm(row.after),
         mm(row.floor)]
        for row in rows
        if row.verdict != ERROR
    ]  # fmt: skip


def when_text(row: FleetRow) -> str:
    """Say when something was measured, and how that is known where nobody wrote it down."""
    when = _readable(row.when)
    return f'{when} (its files)' if row.dated_by == 'file' else when


def _readable(when: str) -> str:
    """Show a time (ISO 8601, UTC) without its marks."""
    return when.removesuffix('+00:00').replace('T', ' ')


def change_lines(rows: Sequence[FleetRow]) -> list[str]:
    """Say what changed when."""
    return [
        f'{c.robot}, {_readable(c.when)} (since {_readable(c.since)}): {c.text}'
        for c in changes(rows)
    ]


def problems(rows: Sequence[FleetRow]) -> list[str]:
    """Say what could not be read or judged."""
    return [f'{row.place}: {row.problem}' for row in rows if row.verdict == ERROR]


def fleet_text(rows: Sequence[FleetRow]) -> list[str]:
    """Return table, changes and problems."""
    lines = [columns([COLUMNS, *fleet_rows(rows)])]
    lines += change_lines(rows) or [NO_CHANGE]
    return lines + [f'left out: {line}' for line in problems(rows)]


def fleet_page(rows: Sequence[FleetRow], title: str) -> Page:
    """Return the page: what changed, and a history per robot."""
    own = histories(rows)
    page = Page(
        title, f'{_count(sum(map(len, own.values())), "recording")} of {_count(len(own), "robot")}'
    )
    page.box(change_lines(rows) or [NO_CHANGE], 'verdict', 'What changed when')
    if problems(rows):
        page.box(problems(rows), 'warn', 'Left out')
    for robot, history in own.items():
        page.heading(robot)
        page.figures([error_figure(history), *map_parameters(history)], 'two')
        page.table(COLUMNS[1:], [row[1:] for row in fleet_rows(history)], left=[0, 1, 2])
    return page


def _count(number: int, what: str) -> str:
    return f'{number} {what}{"" if number == 1 else "s"}'


def error_figure(history: Sequence[FleetRow]) -> Figure:
    """Draw the errors of a robot's description over time."""
    when = [row.when for row in history]
    kinds = (
        ('as described', BEFORE, [row.before for row in history]),
        ('with what was named', PREDICTED, [row.after for row in history]),
        ('noise floor', FLOOR, [row.floor for row in history]),
    )
    data: list[dict[str, Any]] = [
        {
            'x': when,
            'y': [None if error is None else 1e3 * error for error in errors],
            'text': [escape(words_of(row)) for row in history],
            'name': name,
            'mode': 'lines+markers',
            'line': {'color': colour},
        }
        for name, colour, errors in kinds
    ]
    layout = {
        'xaxis': {'type': 'date'},
        'yaxis': {'title': {'text': 'error, rms [mm]'}, 'rangemode': 'tozero'},
    }
    return Figure(data, layout, 'Errors over time', '', 320)


def map_parameters(history: Sequence[FleetRow]) -> list[Figure]:
    """Draw every parameter of what was ever named of a robot, over time."""
    figures = []
    for name in tracked(history):
        found = [(row, row.fitted(name)) for row in history]
        told = [(row, values) for row, values in found if values is not None]
        unit = next(row.unit[row.parameter.index(name)] for row, _ in told)
        largest = max(max(map(abs, values)) for _, values in told)
        factor, unit = scale_of(unit, largest, name.rpartition(' ')[2])
        data = [
            {
                'x': [row.when for row, _ in told],
                'y': [factor * value for _, (value, _, _) in told],
                'mode': 'lines+markers',
                'line': {'color': PREDICTED},
                'error_y': {
                    'type': 'data',
                    'symmetric': False,
                    'array': [factor * max(high - value, 0.0) for _, (value, _, high) in told],
                    'arrayminus': [factor * max(value - low, 0.0) for _, (value, low, _) in told],
                    'thickness': 1,
                },
            }
        ]
        layout = {'xaxis': {'type': 'date'}, 'yaxis': {'title': {'text': f'[{unit or 1}]'}}}
        caption = '95 % intervals, fitted alone or with what was named beside it'
        figures.append(Figure(data, layout, name, caption, 320))
    return figures
