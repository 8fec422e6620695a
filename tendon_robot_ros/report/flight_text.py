"""What was reached against what was asked, as a table."""

from __future__ import annotations

import numpy as np

from ..analysis.flight import Flight
from .words import columns

MOST = 30  # rows of a table for a person


def lines(flight: Flight) -> list[str]:
    """Return the table, and what was between the rows."""
    rows = _tendon_rows(flight) if flight.wanted is not None else _tip_rows(flight)
    head, *body = rows
    shown = np.arange(len(body))
    if len(body) > MOST:
        shown = np.unique(np.linspace(0, len(body) - 1, MOST).round().astype(int))
    said = [columns([head, *(body[i] for i in shown)])]
    if len(shown) < len(body):
        said.append(f'{len(shown)} of {len(body)} rows')
    if flight.wanted is not None:
        said.insert(0, f'tendons: {", ".join(flight.inputs)}')
    else:
        rms, worst, across = flight.on_the_way()
        said.append(
            f'on the way: {_mm(rms)} rms and {_mm(worst)} at most from the target of the moment, '
            f'{_mm(across)} at most from the path'
        )
    if not flight.measured:
        said.append('no tracker: the tip is where the model sees it')
    return said


def _tip_rows(flight: Flight) -> list[list[str]]:
    errors, turns = flight.errors(flight.row_times)
    asked, views = flight.asked_at(flight.row_times)
    reached, _ = flight.tip_at(flight.row_times)
    rows = [['row', 'time [s]', 'asked x, y, z [mm]', 'reached [mm]', 'error', 'turned by']]
    for i, time in enumerate(flight.row_times):
        turn = '' if np.isnan(views[i]).any() else f'{np.degrees(turns[i]):.2f}°'
        rows.append(
            [str(i + 1), f'{time:.2f}', place(asked[i]), place(reached[i]), _mm(errors[i]), turn]
        )
    return rows


def _tendon_rows(flight: Flight) -> list[list[str]]:
    assert flight.wanted is not None
    scale, unit = (1e3, 'mm') if flight.pull else (1.0, 'N')
    reached, _ = flight.tip_at(flight.row_times)
    given = flight.commanded_at(flight.row_times)
    rows = [['row', 'time [s]', f'asked [{unit}]', f'commanded [{unit}]', 'tip [mm]']]
    for i, time in enumerate(flight.row_times):
        asked, came = (
            ', '.join(f'{scale * v:.2f}' for v in values)
            for values in (flight.wanted[i], given[i])
        )
        rows.append([str(i + 1), f'{time:.2f}', asked, came, place(reached[i])])
    return rows


def place(position: np.ndarray) -> str:
    """Show a position in mm, without a minus before a zero."""
    return ', '.join(f'{round(1e3 * value, 1) + 0.0:.1f}' for value in position)


def _mm(metres: float) -> str:
    return f'{1e3 * metres:.2f} mm'
