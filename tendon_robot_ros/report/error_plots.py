"""Errors as figures: per cell, per posture, at the tip; the staircase; what a model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from ..common.colours import BAND, DIVERGING, FLOOR, MEASURED, line_style
from ..common.words import capital, mm
from ..comparison.result import Comparison
from ..diagnosis.missing_moment import MissingMoment
from .page import Figure, Shown, Trace, axes, curve, error_bars, mm_list, plain, titled, trace
from .sentences import interval_name, posture_name

FILLED = {'fill': 'tozeroy', 'fillcolor': BAND}
# what the missing moment may follow, and what that means
CAUSES = {
    'total tension [N]': 'A straight line through zero is friction in the hinges.',
    'tension difference [N]': 'A line through zero: tension or moment arm are not as described.',
    'bend of a cell, model [°]': 'A line through zero: the stiffness is not as described.',
    'distance to the tip [mm]': 'Larger towards the base in every posture: a load at the tip.',
}


@dataclass(frozen=True)
class Step:
    """A step of the staircase: an error [m] before or after something was added."""

    label: str
    error: float
    colour: str
    group: str = ''  # which postures


def symbols(model: int, size: int | None = None) -> Trace:
    """Return the markers of a model, by its place in a list of models."""
    style = line_style(model)
    shape = {'color': style.colour, 'symbol': style.symbol}
    return shape if size is None else {**shape, 'size': size}


def per_marker(comparison: Comparison) -> Figure:
    """Error along the arm, with the band that a perfect model would lie in."""
    measured = comparison.measured
    along, title = along_the_arm(comparison)
    data: list[Trace] = []
    if measured.floor_per_marker is not None:
        floor, name = mm_list(measured.floor_per_marker), 'repeatability (a perfect model)'
        data.append(trace(along, floor, name, line={'color': FLOOR, 'width': 1}, **FILLED))
    for i, model in enumerate(comparison.models):
        data.append(curve(along, mm_list(model.per_marker_rms), model.name, line_style(i), size=7))
    error = _error_axis(comparison, 'error, rms over postures [mm]')
    return Figure(data, axes(title, error), 'Error along the arm')


def per_posture(comparison: Comparison) -> Figure:
    """Error posture by posture."""
    measured = comparison.measured
    rows = np.flatnonzero(measured.trials).tolist()
    names = [escape(measured.postures[p]) for p in rows]
    text = [escape(posture_name(comparison, p)) for p in rows]
    data: list[Trace] = []
    for i, model in enumerate(comparison.models):
        marker = {**symbols(i, 9), 'line': {'width': 2}}
        errors = mm_list(model.per_posture_rms[rows])
        data.append(trace(names, errors, model.name, 'markers', text=text, marker=marker))
    if measured.floor is not None:
        floor = np.sqrt(np.nanmean(measured.floor[rows], axis=1))
        line = {'color': FLOOR, 'width': 1, 'shape': 'hvh'}
        data.append(trace(names, mm_list(floor), 'repeatability', line=line, **FILLED))
    error = _error_axis(comparison, 'error, rms over markers [mm]')
    layout = axes(titled('posture', type='category'), error)
    return Figure(data, layout, 'Error posture by posture')


def angles(comparison: Comparison, p: int) -> Figure:
    """Angular displacement per cell of a posture, as figures 12 to 14 of Kato et al. 2015."""
    mean, half = comparison.angle_bands()
    along, title = along_the_arm(comparison)
    data: list[Trace] = []
    for i, model in enumerate(comparison.models):
        assert model.angles is not None
        turned = plain(np.degrees(model.angles[p]))
        data.append(curve(along, turned, model.name, line_style(i), 2.5))
    marker, bars = {'color': MEASURED, 'size': 5}, error_bars(plain(np.degrees(half[p])))
    points = along, plain(np.degrees(mean[p]))
    name = f'measured, mean ± {interval_name(comparison)}'
    data.append(trace(*points, name, 'markers', error_y=bars, marker=marker))
    layout = axes(title, 'angular displacement [°]')
    return Figure(data, layout, capital(posture_name(comparison, p)))


def tip_boxes(comparison: Comparison) -> Figure:
    """Tip error over all trials, as figure 15: median, quartiles, data within 1.5 of them."""
    measured = comparison.measured
    rows = np.flatnonzero(measured.trials)
    apart = len(rows) <= Shown.OWN_BOXES and len(comparison.models) > 1
    data: list[Trace] = []
    for i, model in enumerate(comparison.models):
        values = model.tip_errors[rows]
        names = np.broadcast_to(np.array(measured.postures)[rows][:, None], values.shape)
        good = np.isfinite(values)
        where = names[good] if apart else [model.name] * int(good.sum())
        data.append(
            {
                'type': 'box',
                'x': [escape(name) for name in where],
                'y': mm_list(values[good]),
                'name': escape(model.name),
                'marker': symbols(i),
                'boxpoints': 'all' if good.sum() <= Shown.BOX_POINTS else 'outliers',
                'jitter': 0.4,
                'pointpos': 0.0,
            }
        )
    shown = {'showlegend': apart, **({'boxmode': 'group'} if apart else {})}
    x = titled('posture' if apart else 'model', type='category')
    layout = axes(x, titled('tip error [mm]', rangemode='tozero'), **shown)
    caption = 'Tip error of every trial: the distance between predicted and measured tip.'
    return Figure(data, layout, 'Tip error', caption)


def loops(comparison: Comparison) -> list[Figure]:
    """
    Show what the arm remembers: the tip over the input that moves it, while that goes and returns.

    Of a sequence, for each input the postures in a row in which it moves most beside the others;
    those inputs first whose tip is farthest from a straight line. The tip is seen along the
    direction in which it moves most meanwhile.
    """
    measured = comparison.measured
    if measured.path != 'sequence':
        return []
    count = min(Shown.LOOP, len(measured.postures))
    inputs, figures = np.nan_to_num(measured.inputs), []
    moved = np.abs(np.diff(inputs, axis=0, prepend=inputs[:1]))
    windows = [
        np.lib.stride_tricks.sliding_window_view(one, count, axis=0).sum(axis=-1)
        for one in (moved, moved.sum(axis=1))
    ]
    alone = windows[0] ** 2 / np.maximum(windows[1], np.finfo(float).tiny)[:, None]
    for j, name in enumerate(measured.input_names):
        rows = int(alone[:, j].argmax()) + np.arange(count)
        tips, own = measured.mean[rows, -1], inputs[rows, j]
        seen = np.isfinite(tips[:, 0])
        if seen.sum() < 3 or np.ptp(own) == 0.0:
            continue
        middle = tips[seen].mean(axis=0)
        along = np.linalg.svd(tips[seen] - middle)[2][0]
        along = along * np.sign(((tips[seen] - middle) @ along) @ (own[seen] - own[seen].mean()))
        unit, factor = ('N', 1.0) if measured.input == 'tension' else ('mm', 1e3)
        x, y = (factor * own).tolist(), (tips - middle) @ along
        text = [escape(measured.postures[row]) for row in rows]
        marker = {'color': MEASURED, 'size': 5}
        data = [trace(x, mm_list(y), 'measured', 'lines+markers', text=text, marker=marker,
                      line={'color': MEASURED, 'width': 1})]  # fmt: skip
        for i, model in enumerate(comparison.models):
            predicted = (model.markers[rows, -1] - middle) @ along
            data.append(curve(x, mm_list(predicted), model.name, line_style(i)))
        straight = np.polynomial.Polynomial.fit(own[seen], y[seen], 1)
        width = float(np.std(y[seen] - straight(own[seen])))
        layout = axes(f'{escape(name)} [{unit}]', 'tip, where it moves most [mm]')
        figures.append((width, Figure(data, layout, f'Tip over {escape(name)}')))
    figures.sort(key=lambda pair: -pair[0])
    return [figure for _, figure in figures[: Shown.FIGURES]]


def staircase(steps: Sequence[Step], title: str = '', height: int = Shown.NORMAL) -> Figure:
    """Errors that fall step by step towards the noise floor; groups beside each other."""
    groups = list(dict.fromkeys(step.group for step in steps))
    data: list[Trace] = []
    for label in dict.fromkeys(step.label for step in steps):
        part = [step for step in steps if step.label == label]
        data.append(
            {
                'type': 'bar',
                'x': [escape(step.group) for step in part] if len(groups) > 1 else [escape(label)],
                'y': mm_list([step.error for step in part]),
                'text': [mm(step.error).removesuffix(' mm') for step in part],
                'textposition': 'outside',
                'cliponaxis': False,
                'name': escape(label),
                'marker': {'color': part[0].colour},
            }
        )
    layout = axes(
        {'type': 'category'},
        titled('error, rms [mm]', rangemode='tozero'),
        showlegend=len(groups) > 1,
        bargap=0.35 if len(groups) == 1 else 0.12,
        margin={'l': 56, 'r': 16, 't': 30, 'b': 44},
    )
    return Figure(data, layout, title, '', height)


def _error_axis(comparison: Comparison, title: str) -> dict[str, Any]:
    """Return the axis of errors: logarithmic where the noise would else lie on the zero line."""
    floor = comparison.noise_floor
    largest = max(float(model.per_marker_rms[-1]) for model in comparison.models)
    wide = floor and largest > Shown.LOG_AXIS_FROM_FLOORS * floor
    return titled(title, **(Shown.LOG_AXIS if wide else {'rangemode': 'tozero'}))


def along_the_arm(comparison: Comparison) -> tuple[list[float | None], str]:
    """Return where the markers stand on the axis along the arm, and its title: cells, or mm."""
    measured = comparison.measured
    if measured.per_cell:
        return plain(np.arange(1, len(measured.markers) + 1)), 'cell'
    return mm_list(measured.arc_lengths), 'distance from the base along the arm [mm]'


def heat_maps(comparison: Comparison, lacks: Sequence[MissingMoment]) -> list[Figure]:
    """Return signed deviations, marker by posture, before and after, in the same colours."""
    largest = float(np.clip(np.nanmax(np.abs(lacks[0].deviation)), *Shown.COLOURS_END_SD))
    measured, figures = comparison.measured, []
    rows = np.flatnonzero(measured.trials).tolist()
    along, title = along_the_arm(comparison)
    for model, own in zip(comparison.models, lacks, strict=True):
        heat = {
            'type': 'heatmap',
            'x': along,
            'y': [escape(measured.postures[p]) for p in rows],
            'z': [plain(own.deviation[p], places=2) for p in rows],
            'zmin': -largest,
            'zmax': largest,
            'colorscale': DIVERGING,
            'colorbar': {'title': {'text': 'noise sd', 'side': 'right'}, 'thickness': 12},
            'hovertemplate': '%{x}, posture %{y}: %{z:.1f} sd<extra></extra>',
        }
        y = titled('posture', type='category', autorange='reversed')
        layout = axes(title, y, margin={'l': 56, 'r': 8, 't': 8, 'b': 44})
        # a line of text for every posture, within what a screen shows
        height = int(np.clip(150 + 18 * len(rows), Shown.LOW, Shown.SCENE))
        figures.append(Figure([heat], layout, f'Deviation, {model.name}', '', height))
    return figures


def moments(lacks: MissingMoment) -> list[Figure]:
    """Return the missing moment against four causes that it may follow."""
    bend = np.degrees(lacks.model_bend)
    causes = (lacks.total_tension, lacks.tension_difference, bend, 1e3 * lacks.lever)
    figures = []
    for cause, (title, caption) in zip(causes, CAUSES.items(), strict=True):
        data = []
        for b, name in enumerate(lacks.blocks):
            bars = error_bars(plain(1.96 * lacks.moment_sd[:, b], 1e3), width=0)
            points = plain(cause[:, b]), plain(lacks.moment[:, b], 1e3)
            data.append(trace(*points, name, 'markers', error_y=bars, marker=symbols(b, 8)))
        x, y = titled(title, rangemode='tozero'), titled('missing moment [mN·m]', zeroline=True)
        figures.append(Figure(data, axes(x, y), '', caption))
    return figures
