"""Figures 12 to 14, 16 and 17 of Kato et al. 2015: postures with error bars, error per cell."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from ..analysis.comparison import Comparison
from ..analysis.paper.motion import Motion
from ..analysis.statistics import half_width
from ..data import DataSet
from .numbers import mm_list, plain
from .page import Figure
from .palette import MEASURED, look
from .words import capital


def posture(comparison: Comparison, data: DataSet, p: int) -> Figure:
    """Measured mean position of every cell with its interval, and what the models predict."""
    traces: list[dict[str, Any]] = []
    for i, model in enumerate(comparison.models):
        points = np.concatenate([np.zeros((1, 3)), model.markers[p]])
        traces.append(
            {
                'x': mm_list(points[:, 0]),
                'y': mm_list(points[:, 2]),
                'name': escape(model.name),
                'mode': 'lines',
                'line': {'color': look(i).colour, 'dash': look(i).dash, 'width': 2.5},
            }
        )
    half = half_width(data.positions[p], comparison.error)
    mean = comparison.measured.mean[p]
    traces.append(
        {
            'x': mm_list(mean[:, 0]),
            'y': mm_list(mean[:, 2]),
            'error_x': _bars(half[:, 0]),
            'error_y': _bars(half[:, 2]),
            'name': f'trials, mean ± {_what(comparison)}',
            'mode': 'markers',
            'marker': {'color': MEASURED, 'size': 5},
        }
    )
    layout = {
        'xaxis': {'title': {'text': 'x [mm]'}},
        'yaxis': {'title': {'text': 'z [mm]'}, 'scaleanchor': 'x'},
    }
    return Figure(traces, layout, capital(comparison.measured.postures[p]), '', height=430)


def error_per_cell(comparison: Comparison, data: DataSet, p: int) -> Figure:
    """Mean distance between trials and models, cell by cell, with its interval."""
    traces: list[dict[str, Any]] = []
    cells = plain(np.arange(1, data.positions.shape[2] + 1))
    for i, model in enumerate(comparison.models):
        errors = np.linalg.norm(data.positions[p] - model.markers[p], axis=2)
        traces.append(
            {
                'x': cells,
                'y': mm_list(np.nanmean(errors, axis=0)),
                'error_y': _bars(half_width(errors, comparison.error)),
                'name': escape(model.name),
                'mode': 'lines+markers',
                'line': {'color': look(i).colour, 'dash': look(i).dash, 'width': 1.5},
                'marker': {'symbol': look(i).symbol, 'size': 8},
            }
        )
    layout = {
        'xaxis': {'title': {'text': 'cell'}},
        'yaxis': {'title': {'text': f'position error ± {_what(comparison)} [mm]'},
                  'rangemode': 'tozero'},
    }  # fmt: skip
    return Figure(traces, layout, f'{capital(comparison.measured.postures[p])}: error', '')


def arrangements(motion: Motion, published: float) -> Figure:
    """Range of the tips for every arrangement of the wires in a group, against 50 mm."""
    names = [one.name.replace(', ', '<br>') for one in motion.arrangements]
    across = np.array([one.across for one in motion.arrangements])
    low = across - [one.low for one in motion.arrangements]
    high = np.array([one.high for one in motion.arrangements]) - across
    bar = {
        'type': 'bar',
        'x': names,
        'y': mm_list(across),
        'error_y': {**_bars(high), 'symmetric': False, 'arrayminus': mm_list(low)},
        'marker': {'color': look(0).colour},
        'name': 'ours; whisker: "180°" is ±1° to ±5°',
    }
    line = {
        'x': names,
        'y': mm_list([published] * len(names)),
        'mode': 'lines',
        'line': {'color': look(1).colour, 'dash': 'dash'},
        'name': 'published: 50 mm',
    }
    layout = {
        'xaxis': {'type': 'category', 'tickangle': 0, 'tickfont': {'size': 11}},
        'yaxis': {'title': {'text': 'tip positions, across [mm]'}, 'rangemode': 'tozero'},
    }
    return Figure([bar, line], layout, 'Three wires in a group', '')


def _bars(half: Any) -> dict[str, Any]:
    return {'type': 'data', 'array': mm_list(half), 'thickness': 1, 'width': 2}


def _what(comparison: Comparison) -> str:
    return '95 %' if comparison.error == 'ci' else 'standard error'
