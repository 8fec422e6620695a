"""Shapes, measured and predicted: pictures per posture; of spatial arms also a scene in space."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from ..common.colours import FLOOR, MEASURED, look
from ..common.words import capital, mm
from ..comparison.result import Comparison, Floats
from ..model.plot import bending_azimuth, views_of
from .comparison_text import posture_name
from .numbers import mm_list, plain
from .page import Figure, symbol

POSTURES_DRAWN_MAX = 12  # postures that are drawn
FLAT_WITHIN_SHARE = 0.03  # of the arm's length: farther from the x-z plane is spatial
Trace = dict[str, Any]


def shape_figures(comparison: Comparison) -> list[tuple[list[Figure], str]]:
    """Return rows of figures of the shapes, and how many of each stand beside each other."""
    chosen = chosen_postures(comparison)
    if is_planar(comparison):
        return [([_planar(comparison, p) for p in chosen], 'many')]
    return [([_spatial(comparison, chosen)], ''), ([_sides(comparison, p) for p in chosen], 'two')]


def shape_key(comparison: Comparison) -> list[tuple[str, str]]:
    """Return the legend that the pictures share."""
    entries = [(symbol(MEASURED, dot=True), 'measured (mean of the trials)')]
    for i, model in enumerate(comparison.models):
        entries.append((symbol(look(i).colour, look(i).stroke), model.name))
    return entries


def chosen_postures(comparison: Comparison) -> list[int]:
    """Return the postures to draw, in their order: all, or the worst of the best model."""
    errors = np.nan_to_num(comparison.best.per_posture_rms, nan=-1.0)
    seen = np.flatnonzero(errors >= 0.0)
    return sorted(seen[np.argsort(-errors[seen], kind='stable')][:POSTURES_DRAWN_MAX].tolist())


def is_planar(comparison: Comparison) -> bool:
    """Tell whether all shapes lie in the x-z plane."""
    length = comparison.measured.arc_lengths.max()
    shapes = [comparison.measured.mean, *(model.markers for model in comparison.models)]
    return all(np.nanmax(np.abs(shape[..., 1])) < FLAT_WITHIN_SHARE * length for shape in shapes)


def _planar(comparison: Comparison, p: int) -> Figure:
    data = [_flat(trace) for trace in _traces(comparison, p)]
    layout = {
        'showlegend': False,
        'margin': {'l': 46, 'r': 8, 't': 6, 'b': 40},
        'xaxis': {'title': {'text': 'x [mm]'}},
        'yaxis': {'title': {'text': 'z [mm]'}, 'scaleanchor': 'x'},
    }
    best = comparison.best.per_posture_rms[p]
    caption = f'{comparison.best.name}: rms {mm(best)}'
    return Figure(data, layout, capital(posture_name(comparison, p)), caption, height=270)


def _sides(comparison: Comparison, p: int) -> Figure:
    """One posture seen across the plane in which it bends, and along that plane."""
    azimuth = _azimuth(comparison, p)
    data = []
    for trace in _traces(comparison, p):
        seen = views_of(np.array([trace[axis] for axis in 'xyz'], dtype=float).T, azimuth)
        rest = {key: value for key, value in trace.items() if key not in 'xyz'}
        for side, name in enumerate(('x', 'x2')):
            points = {'x': plain(seen[:, side]), 'y': plain(seen[:, 2])}
            data.append({**rest, **points, 'xaxis': name})
    towards = f'plane of bending, {np.degrees(azimuth):.0f}° from x [mm]'
    layout = {
        'showlegend': False,
        'margin': {'l': 46, 'r': 8, 't': 6, 'b': 40},
        'xaxis': {'title': {'text': towards}, 'domain': [0.0, 0.64]},
        'xaxis2': {
            'title': {'text': 'across it [mm]'},
            'domain': [0.7, 1.0],
            'scaleanchor': 'x',
            'nticks': 5,
        },
        'yaxis': {'title': {'text': 'z [mm]'}, 'scaleanchor': 'x'},
    }
    best = comparison.best.per_posture_rms[p]
    caption = f'{comparison.best.name}: rms {mm(best)}'
    return Figure(data, layout, capital(posture_name(comparison, p)), caption, height=340)


def _azimuth(comparison: Comparison, p: int) -> float:
    """Direction [rad] in which a posture bends, as measured and as predicted."""
    lines = [comparison.measured.mean[p], *(model.line[p] for model in comparison.models)]
    return bending_azimuth(np.concatenate(lines))


def _spatial(comparison: Comparison, chosen: list[int]) -> Figure:
    """One scene; a menu chooses the posture, the worst first, and looks across its plane."""
    worst = comparison.worst_posture(comparison.best)
    groups = [_traces(comparison, p) for p in chosen]
    data = [
        {**_solid(trace), 'type': 'scatter3d', 'visible': p == worst}
        for p, group in zip(chosen, groups, strict=True)
        for trace in group
    ]
    owner = np.repeat(chosen, [len(group) for group in groups])
    buttons = [
        {
            'label': escape(_short(posture_name(comparison, p))),
            'method': 'update',
            'args': [
                {'visible': (owner == p).tolist()},
                {'scene.camera': _camera(_azimuth(comparison, p))},
            ],
        }
        for p in chosen
    ]
    menu = {
        'buttons': buttons,
        'active': chosen.index(worst),
        'x': 0.0,
        'xanchor': 'left',
        'y': 1.0,
        'yanchor': 'bottom',
        'pad': {'l': 4, 'b': 6},
    }
    layout = {
        'showlegend': False,
        'margin': {'l': 0, 'r': 0, 't': 48, 'b': 0},
        'scene': _scene(comparison, chosen, _camera(_azimuth(comparison, worst))),
        'updatemenus': [menu],
    }
    caption = 'Choose a posture, seen across the plane in which it bends; drag to turn.'
    return Figure(data, layout, '', caption, height=520)


def _camera(azimuth: float) -> dict[str, Any]:
    """Look across the plane of bending, without perspective, a little from above."""
    u, v = float(np.cos(azimuth)), float(np.sin(azimuth))
    return {
        'eye': {'x': 1.4 * v, 'y': -1.4 * u, 'z': 0.2},
        'center': {'x': 0, 'y': 0, 'z': -0.05},
        'projection': {'type': 'orthographic'},
    }


def _scene(comparison: Comparison, chosen: list[int], camera: Trace) -> Trace:
    """Return a box that holds all postures at one scale."""
    shapes = [comparison.measured.mean[chosen]]
    shapes += [line[chosen] for m in comparison.models for line in (m.markers, m.line)]
    points = np.concatenate([np.zeros((1, 3)), *(shape.reshape(-1, 3) for shape in shapes)])
    low, high = 1e3 * np.nanmin(points, axis=0), 1e3 * np.nanmax(points, axis=0)
    size = np.maximum(high - low, 0.15 * float((high - low).max()))
    middle = 0.5 * (low + high)
    axes = {
        f'{axis}axis': {
            'title': {'text': f'{axis} [mm]'},
            'range': [float(middle[i] - 0.53 * size[i]), float(middle[i] + 0.53 * size[i])],
            'nticks': 6,
        }
        for i, axis in enumerate('xyz')
    }
    shares = dict(zip('xyz', (1.25 * size / size.max()).tolist(), strict=True))
    return {'aspectmode': 'manual', 'aspectratio': shares, 'camera': camera, **axes}


def _traces(comparison: Comparison, p: int) -> list[Trace]:
    """Return the lines and points of one posture in space."""
    measured, traces = comparison.measured, []
    for i, model in enumerate(comparison.models):
        style = look(i)
        traces.append(
            {
                **_xyz(np.concatenate([np.zeros((1, 3)), model.line[p]])),
                'name': escape(model.name),
                'mode': 'lines',
                'line': {'color': style.colour, 'dash': style.dash, 'width': 3},
            }
        )
        if model.centreline is not None:
            traces += _offset_markers(measured.mean[p], model.markers[p], i)
    traces.append(
        {
            **_xyz(measured.mean[p]),
            'name': 'measured',
            'text': [escape(name) for name in measured.markers],
            'mode': 'markers',
            'marker': {'color': MEASURED, 'size': 5},
        }
    )
    return traces


def _offset_markers(measured: Floats, predicted: Floats, i: int) -> list[Trace]:
    """Return predicted markers beside the arm, each joined with the measured one."""
    gap = np.full_like(measured, np.nan)
    joined = np.stack([measured, predicted, gap], axis=1).reshape(-1, 3)
    marker = {'color': look(i).colour, 'symbol': 'circle-open', 'size': 7}
    error = {'color': FLOOR, 'width': 1.5}
    return [
        {**_xyz(joined), 'mode': 'lines', 'line': error, 'name': 'error', 'hoverinfo': 'skip'},
        {**_xyz(predicted), 'mode': 'markers', 'marker': marker, 'name': 'predicted marker'},
    ]


def _xyz(points: Floats) -> Trace:
    return {axis: mm_list(points[:, i]) for i, axis in enumerate('xyz')}


def _solid(trace: Trace) -> Trace:
    """Return a trace in the sizes of a scene in space."""
    made = dict(trace)
    if 'line' in made:
        made['line'] = {**made['line'], 'width': 2.0 * made['line']['width']}
    if 'marker' in made:
        made['marker'] = {**made['marker'], 'size': 0.6 * made['marker']['size']}
    return made


def _flat(trace: Trace) -> Trace:
    """Return a trace as seen along y."""
    return {**{key: value for key, value in trace.items() if key != 'z'}, 'y': trace['z']}


def _short(text: str, most: int = 40) -> str:
    return text if len(text) <= most else text[: most - 1] + '…'
