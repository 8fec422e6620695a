"""Figures of a diagnosis: where the model is off, signed; and the moment that it lacks."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from ..analysis.comparison import Comparison, Floats
from ..analysis.missing_moment import MissingMoment
from .error_plots import place_title, places
from .numbers import plain
from .page import Figure
from .palette import DIVERGING, look

LARGEST = 30.0  # [noise sd] at which colours end
CAPTIONS = {
    'total tension [N]': 'A straight line through zero is friction in the hinges.',
    'tension difference [N]': 'A line through zero: tension or moment arm are not as described.',
    'bend of a cell, model [°]': 'A line through zero: the stiffness is not as described.',
    'distance to the tip [mm]': 'Larger towards the base in every posture: a load at the tip.',
}


def heat_maps(comparison: Comparison, before: MissingMoment, after: MissingMoment | None) -> (
        list[Figure]):  # fmt: skip
    """Return signed deviations, marker by posture, before and after, in the same colours."""
    largest = float(np.clip(np.nanmax(np.abs(before.deviation)), 4.0, LARGEST))
    names = [model.name for model in comparison.models]
    lacks = [one for one in (before, after) if one is not None]
    return [_heat(comparison, one.deviation, largest, name)
            for one, name in zip(lacks, names, strict=False)]  # fmt: skip


def _heat(comparison: Comparison, values: Floats, largest: float, name: str) -> Figure:
    measured = comparison.measured
    rows = [p for p in range(len(measured.postures)) if measured.trials[p]]
    data: list[dict[str, Any]] = [
        {
            'type': 'heatmap',
            'x': places(comparison),
            'y': [escape(measured.postures[p]) for p in rows],
            'z': [plain(values[p], places=2) for p in rows],
            'zmin': -largest,
            'zmax': largest,
            'colorscale': DIVERGING,
            'colorbar': {'title': {'text': 'noise sd', 'side': 'right'}, 'thickness': 12},
            'hovertemplate': '%{x}, posture %{y}: %{z:.1f} sd<extra></extra>',
        }
    ]
    layout = {
        'xaxis': {'title': {'text': place_title(comparison)}},
        'yaxis': {'title': {'text': 'posture'}, 'type': 'category', 'autorange': 'reversed'},
        'margin': {'l': 56, 'r': 8, 't': 8, 'b': 44},
    }
    height = int(np.clip(150 + 18 * len(rows), 260, 560))
    return Figure(data, layout, f'Deviation, {name}', '', height)


def moments(lacks: MissingMoment) -> list[Figure]:
    """Return the missing moment against four causes that it may follow."""
    bend = np.degrees(lacks.model_bend)
    causes = (lacks.total_tension, lacks.tension_difference, bend, 1e3 * lacks.lever)
    return [
        _moments(lacks, cause, title, caption)
        for cause, (title, caption) in zip(causes, CAPTIONS.items(), strict=True)
    ]


def _moments(lacks: MissingMoment, cause: Floats, title: str, caption: str) -> Figure:
    data: list[dict[str, Any]] = []
    for b, name in enumerate(lacks.blocks):
        style = look(b)
        data.append(
            {
                'x': plain(cause[:, b]),
                'y': plain(lacks.moment[:, b], 1e3),
                'error_y': {
                    'type': 'data',
                    'array': plain(1.96 * lacks.moment_sd[:, b], 1e3),
                    'thickness': 1,
                    'width': 0,
                },
                'name': escape(name),
                'mode': 'markers',
                'marker': {'color': style.colour, 'symbol': style.symbol, 'size': 8},
            }
        )
    layout = {
        'xaxis': {'title': {'text': title}, 'rangemode': 'tozero'},
        'yaxis': {'title': {'text': 'missing moment [mN·m]'}, 'zeroline': True},
    }
    return Figure(data, layout, '', caption)
