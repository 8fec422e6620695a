"""The page that `compare --report` writes, and the shapes that other pages show as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.colours import FLOOR, MEASURED, WARN, line_style
from ..common.words import capital, mm
from ..comparison.result import Comparison
from ..model.shape import bending_azimuth, views_of
from . import comparison_text as say
from .error_plots import Step, angles, per_marker, per_posture, staircase, tip_boxes
from .page import (
    FLAT_FRACTION,
    HEIGHTS_PX,
    Figure,
    Page,
    Shown,
    Trace,
    coordinates,
    plain,
    symbol,
    titled,
)
from .sentences import Fault, excluded_lines, marks, of_inputs


def write_comparison(comparison: Comparison, path: str | Path) -> Path:
    """Write the page; it opens without a network."""
    return comparison_page(comparison).write(path)


def comparison_page(comparison: Comparison) -> Page:
    """Return the page: verdict and excluded readings first, then errors and shapes."""
    measured = comparison.measured
    page = Page(f'Models against measurements: {measured.data}', say.size(comparison))
    add_verdict(page, comparison)
    excluded = excluded_lines({'outliers': measured.left_out})
    page.text(*(f'{capital(line)}.' for line in excluded))
    add_errors(page, comparison)
    add_shapes(page, comparison)
    add_angles(page, comparison)
    return page


def add_verdict(page: Page, comparison: Comparison) -> None:
    """Add the verdict, the table of models and the tests between them."""
    floor = comparison.noise_floor
    good = floor is not None and comparison.best.rms < say.GOOD_WITHIN_FLOORS * floor
    worst = capital(say.where_worst(comparison))
    lines = [say.verdict(comparison), worst, say.next_step(comparison)]
    page.box(filter(None, lines), 'verdict good' if good else 'verdict')
    header = ['model', *say.error_columns(comparison)]
    rows = [[say.label(m), *say.errors(comparison, m)] for m in comparison.models]
    kinds = ['strong' if model is comparison.best else '' for model in comparison.models]
    if floor is not None:
        rows.append(['noise floor: a perfect model', mm(floor), '', ''])
        kinds.append('faint')
    page.table(header, rows, kinds)
    tests = [test for test in comparison.paired_t if test.posture is None]
    page.text(*(f'{capital(say.paired(test))}.' for test in tests))
    page.text(
        'Errors are distances between the model and the mean over the trials of a posture; rms is '
        'over postures and markers. The tip error is the distance at the last marker, trial by '
        'trial: the mean over the trials of a posture, then over the postures.'
    )


def add_errors(page: Page, comparison: Comparison) -> None:
    """Add the figures of errors along the arm, by posture and at the tip."""
    page.heading('Where the models are off')
    figures = [per_marker(comparison), per_posture(comparison), tip_boxes(comparison)]
    figures.append(staircase(steps(comparison), 'Models and noise floor'))
    page.figures(figures, 'two')


def steps(comparison: Comparison) -> list[Step]:
    """Return the errors of the models as steps, the largest first, down to the noise floor."""
    order = sorted(range(len(comparison.models)), key=lambda i: -comparison.models[i].rms)
    of_models = [
        Step(comparison.models[i].name, comparison.models[i].rms, 'before', model=i) for i in order
    ]
    floor = comparison.noise_floor
    return [*of_models, Step('noise floor', floor, 'floor')] if floor is not None else of_models


def add_shapes(page: Page, comparison: Comparison, faults: Sequence[Fault] = ()) -> None:
    """Add the measured and predicted shapes; what a diagnosis found wrong is marked."""
    page.heading('Shapes')
    drawn, measured = len(chosen_postures(comparison)), int((comparison.measured.trials > 0).sum())
    if drawn < measured:
        page.text(
            f'The {drawn} postures of {measured} that {comparison.best.name} predicts worst.'
        )
    page.key(shape_key(comparison, faults))
    for figures, across in shape_figures(comparison, faults):
        page.figures(figures, across)


def add_angles(page: Page, comparison: Comparison) -> None:
    """Add angular displacements of the worst postures, if the markers determine them."""
    page.heading('Angular displacement')
    if comparison.measured.angles is None:
        page.text(
            'The markers do not lie along the centreline of the arm, so that they do not tell '
            'how much each part of it bends.'
        )
        return
    errors = comparison.best.per_posture_rms
    worst = sorted(chosen_postures(comparison), key=lambda p: -errors[p])[: Shown.FIGURES]
    page.text(
        'The turn from each chord between markers to the next, '
        + ('in the postures that are predicted worst.' if len(worst) > 1 else 'in this posture.')
        + ' Angles are differences of positions and '
        'much less precise than these; the first one counts from the base, half a cell.'
    )
    page.figures([angles(comparison, p) for p in worst], 'two')


def shape_figures(
    comparison: Comparison, faults: Sequence[Fault] = ()
) -> list[tuple[list[Figure], str]]:
    """
    Return rows of figures of the shapes, and how many of each stand beside each other.

    `faults` of the details of a diagnosis are marked where the model is wrong.
    """
    drawn = [DrawnPosture.of(comparison, p, faults) for p in chosen_postures(comparison)]
    if is_planar(comparison):
        return [([flat_figure(one) for one in drawn], 'many')]
    sides = [side_figure(one) for one in drawn]
    return [([scene_figure(comparison, drawn)], ''), (sides, 'two')]


def shape_key(comparison: Comparison, faults: Sequence[Fault] = ()) -> list[tuple[str, str]]:
    """Return the legend that the pictures share."""
    entries = [(symbol(MEASURED, dot=True), 'measured (mean of the trials)')]
    for i, model in enumerate(comparison.models):
        entries.append((symbol(line_style(i).colour, line_style(i).stroke), model.name))
    if any(fault['along'] is not None for fault in faults):
        entries.append((symbol(WARN, dot=True), 'here the model is wrong'))
    return entries


def chosen_postures(comparison: Comparison) -> list[int]:
    """Return the postures to draw, in their order: all, or the worst of the best model."""
    errors = np.nan_to_num(comparison.best.per_posture_rms, nan=-1.0)
    valid = np.flatnonzero(errors >= 0.0)
    return sorted(valid[np.argsort(-errors[valid], kind='stable')][: Shown.POSTURES].tolist())


def is_planar(comparison: Comparison) -> bool:
    """Return whether all shapes lie in the x-z plane."""
    length = comparison.measured.arc_lengths.max()
    shapes = [comparison.measured.mean, *(model.markers for model in comparison.models)]
    return all(np.nanmax(np.abs(shape[..., 1])) < FLAT_FRACTION * length for shape in shapes)


@dataclass(frozen=True)
class DrawnPosture:
    """One posture in space: lines, points and marks, and the words around them."""

    p: int
    title: str
    caption: str
    traces: list[Trace]
    azimuth: float  # [rad] in which it bends, as measured and as predicted

    @classmethod
    def of(cls, comparison: Comparison, p: int, faults: Sequence[Fault]) -> DrawnPosture:
        """Draw a posture; faults are marked."""
        lines = [comparison.measured.mean[p], *(model.line[p] for model in comparison.models)]
        best, name = comparison.best, comparison.measured.postures[p]
        words = [f'{best.name}: rms {mm(best.per_posture_rms[p])}', *of_inputs(faults, name)]
        return cls(
            p,
            capital(say.posture_name(comparison, p)),
            '; '.join(words),
            posture_traces(comparison, p) + fault_rings(best.line[p], marks(faults, name)),
            bending_azimuth(np.concatenate(lines)),
        )


def fault_rings(line: Floats, places: Sequence[tuple[float, str]]) -> list[Trace]:
    """Return a ring around every place of an arm's line at which it is wrong."""
    if not places:
        return []
    nodes = np.concatenate([np.zeros((1, 3)), line])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    at = [distance for distance, _ in places]
    points = np.column_stack([np.interp(at, along, nodes[:, axis]) for axis in range(3)])
    ring = {'color': WARN, 'symbol': 'circle-open', 'size': 16, 'line': {'width': 3}}
    rings = {**coordinates(points), 'name': 'wrong here', 'mode': 'markers', 'marker': ring}
    return [{**rings, 'text': [escape(text) for _, text in places], 'hoverinfo': 'text'}]


def flat_figure(drawn: DrawnPosture) -> Figure:
    """Draw one posture in the x-z plane, as seen along y."""
    data = []
    for trace in drawn.traces:
        rest = {key: value for key, value in trace.items() if key != 'z'}
        data.append({**rest, 'y': trace['z']})
    layout = {
        'showlegend': False,
        'margin': {'l': 46, 'r': 8, 't': 6, 'b': 40},
        'xaxis': titled('x [mm]'),
        'yaxis': titled('z [mm]', scaleanchor='x'),
    }
    return Figure(data, layout, drawn.title, drawn.caption, HEIGHTS_PX['low'])


def side_figure(drawn: DrawnPosture) -> Figure:
    """One posture seen across the plane in which it bends, and along that plane."""
    data = []
    for trace in drawn.traces:
        views = views_of(np.array([trace[axis] for axis in 'xyz'], dtype=float).T, drawn.azimuth)
        rest = {key: value for key, value in trace.items() if key not in 'xyz'}
        for side, name in enumerate(('x', 'x2')):
            points = {'x': plain(views[:, side]), 'y': plain(views[:, 2])}
            data.append({**rest, **points, 'xaxis': name})
    layout = {
        'showlegend': False,
        'margin': {'l': 46, 'r': 8, 't': 6, 'b': 40},
        'xaxis': titled('in its plane [mm]', domain=[0.0, 0.64]),
        'xaxis2': titled('across [mm]', domain=[0.7, 1.0], scaleanchor='x', nticks=4, tickangle=0),
        'yaxis': titled('z [mm]', scaleanchor='x'),
    }
    plane = round(np.degrees(drawn.azimuth))
    caption = f'{drawn.caption}; bends in a plane {plane}° from x'
    return Figure(data, layout, drawn.title, caption, HEIGHTS_PX['normal'])


def scene_figure(comparison: Comparison, drawn: Sequence[DrawnPosture]) -> Figure:
    """One scene; a menu chooses the posture, the worst first, and looks across its plane."""
    worst = comparison.worst_posture(comparison.best)
    active = next(i for i, one in enumerate(drawn) if one.p == worst)
    data = []
    for i, one in enumerate(drawn):
        for trace in one.traces:
            drawn_trace = {**trace, 'type': 'scatter3d', 'visible': i == active}
            if 'line' in trace:  # in the sizes of a scene in space
                drawn_trace['line'] = {**trace['line'], 'width': 2.0 * trace['line']['width']}
            if 'marker' in trace:
                drawn_trace['marker'] = {**trace['marker'], 'size': 0.6 * trace['marker']['size']}
            data.append(drawn_trace)
    owner = np.repeat(np.arange(len(drawn)), [len(one.traces) for one in drawn])
    buttons = []
    for i, one in enumerate(drawn):
        name = say.posture_name(comparison, one.p)
        short = name if len(name) <= Shown.NAME else name[: Shown.NAME - 1] + '…'
        camera = {'scene.camera': _camera(one.azimuth)}
        shown = {'visible': (owner == i).tolist()}
        buttons.append({'label': escape(short), 'method': 'update', 'args': [shown, camera]})
    menu = {'buttons': buttons, 'active': active, 'x': 0.0, 'xanchor': 'left', 'y': 1.0}
    menu |= {'yanchor': 'bottom', 'pad': {'l': 4, 'b': 6}}
    chosen = [one.p for one in drawn]
    layout = {
        'showlegend': False,
        'margin': {'l': 0, 'r': 0, 't': 48, 'b': 0},
        'scene': scene_box(comparison, chosen, _camera(drawn[active].azimuth)),
        'updatemenus': [menu],
    }
    caption = 'Choose a posture, seen across the plane in which it bends; drag to turn.'
    return Figure(data, layout, '', caption, HEIGHTS_PX['scene'])


def _camera(azimuth: float) -> dict[str, Any]:
    """Look across the plane of bending, without perspective, a little from above."""
    u, v = float(np.cos(azimuth)), float(np.sin(azimuth))
    return {
        'eye': {'x': 1.4 * v, 'y': -1.4 * u, 'z': 0.7},
        'center': {'x': 0, 'y': 0, 'z': -0.05},
        'projection': {'type': 'orthographic'},
    }


def scene_box(comparison: Comparison, chosen: list[int], camera: Trace) -> Trace:
    """Return a box that holds all postures at one scale."""
    shapes = [comparison.measured.mean[chosen]]
    shapes += [line[chosen] for m in comparison.models for line in (m.markers, m.line)]
    points = np.concatenate([np.zeros((1, 3)), *(shape.reshape(-1, 3) for shape in shapes)])
    low, high = 1e3 * np.nanmin(points, axis=0), 1e3 * np.nanmax(points, axis=0)
    size = np.maximum(high - low, 0.15 * float((high - low).max()))
    middle = 0.5 * (low + high)
    ends = np.stack([middle - 0.53 * size, middle + 0.53 * size], axis=1).tolist()
    axes = {
        f'{axis}axis': titled(f'{axis} [mm]', range=ends[i], nticks=4)
        for i, axis in enumerate('xyz')
    }
    ratio = dict(zip('xyz', (1.25 * size / size.max()).tolist(), strict=True))
    return {'aspectmode': 'manual', 'aspectratio': ratio, 'camera': camera, **axes}


def posture_traces(comparison: Comparison, p: int) -> list[Trace]:
    """Return the lines and points of one posture in space."""
    measured, traces = comparison.measured, []
    for i, model in enumerate(comparison.models):
        style = line_style(i)
        line = {'color': style.colour, 'dash': style.dash, 'width': 3}
        arm = coordinates(np.concatenate([np.zeros((1, 3)), model.line[p]]))
        traces.append({**arm, 'name': escape(model.name), 'mode': 'lines', 'line': line})
        if model.centreline is not None:  # markers beside the arm, joined with the measured ones
            gap = np.full_like(measured.mean[p], np.nan)
            joined = np.stack([measured.mean[p], model.markers[p], gap], axis=1).reshape(-1, 3)
            line = {'color': FLOOR, 'width': 1.5}
            error = {**coordinates(joined), 'mode': 'lines', 'line': line, 'name': 'error'}
            traces.append({**error, 'hoverinfo': 'skip'})
            marker = {'color': style.colour, 'symbol': 'circle-open', 'size': 7}
            ring = {**coordinates(model.markers[p]), 'mode': 'markers', 'marker': marker}
            traces.append({**ring, 'name': 'predicted marker'})
    points = {**coordinates(measured.mean[p]), 'text': [*map(escape, measured.markers)]}
    marker = {'color': MEASURED, 'size': 5}
    return [*traces, {**points, 'name': 'measured', 'mode': 'markers', 'marker': marker}]
