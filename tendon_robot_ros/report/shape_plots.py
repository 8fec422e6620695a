"""Shapes, measured and predicted: pictures per posture; of spatial arms also a scene in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from ..common.colours import FLOOR, MEASURED, WARN, look
from ..common.words import capital, mm
from ..comparison.result import Comparison, Floats
from ..model.shape import bending_azimuth, views_of
from .arm_text import Fault, marks, of_inputs
from .comparison_text import posture_name
from .numbers import mm_list, plain
from .page import Figure, Trace, symbol, titled

POSTURES_DRAWN_MAX = 12  # postures that are drawn, so that the page opens at once
FLAT_WITHIN_SHARE = 0.03  # [1] of the arm's length: farther from the x-z plane is spatial
NAME_MAX = 40  # letters of a posture in the menu: what a phone shows


def shape_figures(
    comparison: Comparison, faults: Sequence[Fault] = ()
) -> list[tuple[list[Figure], str]]:
    """
    Return rows of figures of the shapes, and how many of each stand beside each other.

    `faults` of the details of a diagnosis are marked where the model is wrong.
    """
    drawn = [_drawn(comparison, p, faults) for p in chosen_postures(comparison)]
    if is_planar(comparison):
        return [([_planar(one) for one in drawn], 'many')]
    sides = [_sides(one) for one in drawn]
    return [([_spatial(comparison, drawn)], ''), (sides, 'two')]


def shape_key(comparison: Comparison, faults: Sequence[Fault] = ()) -> list[tuple[str, str]]:
    """Return the legend that the pictures share."""
    entries = [(symbol(MEASURED, dot=True), 'measured (mean of the trials)')]
    for i, model in enumerate(comparison.models):
        entries.append((symbol(look(i).colour, look(i).stroke), model.name))
    if any(fault['along'] is not None for fault in faults):
        entries.append((symbol(WARN, dot=True), 'here the model is wrong'))
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


@dataclass(frozen=True)
class _Drawn:
    """One posture in space."""

    p: int
    title: str
    caption: str
    traces: list[Trace]
    azimuth: float  # [rad] in which it bends, as measured and as predicted


def _drawn(comparison: Comparison, p: int, faults: Sequence[Fault]) -> _Drawn:
    """Return the lines, points and marks of a posture, and the words around them."""
    lines = [comparison.measured.mean[p], *(model.line[p] for model in comparison.models)]
    best, name = comparison.best, comparison.measured.postures[p]
    words = [f'{best.name}: rms {mm(best.per_posture_rms[p])}', *of_inputs(faults, name)]
    return _Drawn(
        p,
        capital(posture_name(comparison, p)),
        '; '.join(words),
        _traces(comparison, p) + _marks(best.line[p], marks(faults, name)),
        bending_azimuth(np.concatenate(lines)),
    )


def _marks(line: Floats, places: Sequence[tuple[float, str]]) -> list[Trace]:
    """Return a ring around every place of an arm's line at which it is wrong."""
    if not places:
        return []
    nodes = np.concatenate([np.zeros((1, 3)), line])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    at = [distance for distance, _ in places]
    points = np.column_stack([np.interp(at, along, nodes[:, axis]) for axis in range(3)])
    ring = {'color': WARN, 'symbol': 'circle-open', 'size': 16, 'line': {'width': 3}}
    trace = {**_xyz(points), 'name': 'wrong here', 'mode': 'markers', 'marker': ring}
    return [{**trace, 'text': [escape(text) for _, text in places], 'hoverinfo': 'text'}]


def _planar(drawn: _Drawn) -> Figure:
    data = []
    for trace in drawn.traces:  # as seen along y
        rest = {key: value for key, value in trace.items() if key != 'z'}
        data.append({**rest, 'y': trace['z']})
    layout = {
        'showlegend': False,
        'margin': {'l': 46, 'r': 8, 't': 6, 'b': 40},
        'xaxis': titled('x [mm]'),
        'yaxis': {'title': {'text': 'z [mm]'}, 'scaleanchor': 'x'},
    }
    return Figure(data, layout, drawn.title, drawn.caption, height=270)


def _sides(drawn: _Drawn) -> Figure:
    """One posture seen across the plane in which it bends, and along that plane."""
    data = []
    for trace in drawn.traces:
        seen = views_of(np.array([trace[axis] for axis in 'xyz'], dtype=float).T, drawn.azimuth)
        rest = {key: value for key, value in trace.items() if key not in 'xyz'}
        for side, name in enumerate(('x', 'x2')):
            points = {'x': plain(seen[:, side]), 'y': plain(seen[:, 2])}
            data.append({**rest, **points, 'xaxis': name})
    layout = {
        'showlegend': False,
        'margin': {'l': 46, 'r': 8, 't': 6, 'b': 40},
        'xaxis': {'title': {'text': 'in its plane [mm]'}, 'domain': [0.0, 0.64]},
        'xaxis2': {
            'title': {'text': 'across [mm]'},
            'domain': [0.7, 1.0],
            'scaleanchor': 'x',
            'nticks': 4,
            'tickangle': 0,
        },
        'yaxis': {'title': {'text': 'z [mm]'}, 'scaleanchor': 'x'},
    }
    plane = round(np.degrees(drawn.azimuth))
    caption = f'{drawn.caption}; bends in a plane {plane}° from x'
    return Figure(data, layout, drawn.title, caption, height=340)


def _spatial(comparison: Comparison, drawn: Sequence[_Drawn]) -> Figure:
    """One scene; a menu chooses the posture, the worst first, and looks across its plane."""
    worst = comparison.worst_posture(comparison.best)
    active = next(i for i, one in enumerate(drawn) if one.p == worst)
    data = []
    for i, one in enumerate(drawn):
        for trace in one.traces:
            made = {**trace, 'type': 'scatter3d', 'visible': i == active}
            if 'line' in trace:  # in the sizes of a scene in space
                made['line'] = {**trace['line'], 'width': 2.0 * trace['line']['width']}
            if 'marker' in trace:
                made['marker'] = {**trace['marker'], 'size': 0.6 * trace['marker']['size']}
            data.append(made)
    owner = np.repeat(np.arange(len(drawn)), [len(one.traces) for one in drawn])
    buttons = []
    for i, one in enumerate(drawn):
        name = posture_name(comparison, one.p)
        short = name if len(name) <= NAME_MAX else name[: NAME_MAX - 1] + '…'
        camera = {'scene.camera': _camera(one.azimuth)}
        shown = {'visible': (owner == i).tolist()}
        buttons.append({'label': escape(short), 'method': 'update', 'args': [shown, camera]})
    menu = {
        'buttons': buttons,
        'active': active,
        'x': 0.0,
        'xanchor': 'left',
        'y': 1.0,
        'yanchor': 'bottom',
        'pad': {'l': 4, 'b': 6},
    }
    chosen = [one.p for one in drawn]
    layout = {
        'showlegend': False,
        'margin': {'l': 0, 'r': 0, 't': 48, 'b': 0},
        'scene': _scene(comparison, chosen, _camera(drawn[active].azimuth)),
        'updatemenus': [menu],
    }
    caption = 'Choose a posture, seen across the plane in which it bends; drag to turn.'
    return Figure(data, layout, '', caption, height=520)


def _camera(azimuth: float) -> dict[str, Any]:
    """Look across the plane of bending, without perspective, a little from above."""
    u, v = float(np.cos(azimuth)), float(np.sin(azimuth))
    return {
        'eye': {'x': 1.4 * v, 'y': -1.4 * u, 'z': 0.7},
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
            'nticks': 4,
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
        if model.centreline is not None:  # markers beside the arm, joined with the measured ones
            gap = np.full_like(measured.mean[p], np.nan)
            joined = np.stack([measured.mean[p], model.markers[p], gap], axis=1).reshape(-1, 3)
            line = {'color': FLOOR, 'width': 1.5}
            error = {**_xyz(joined), 'mode': 'lines', 'line': line, 'name': 'error'}
            traces.append({**error, 'hoverinfo': 'skip'})
            marker = {'color': style.colour, 'symbol': 'circle-open', 'size': 7}
            ring = {**_xyz(model.markers[p]), 'mode': 'markers', 'marker': marker}
            traces.append({**ring, 'name': 'predicted marker'})
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


def _xyz(points: Floats) -> Trace:
    return {axis: mm_list(points[:, i]) for i, axis in enumerate('xyz')}
