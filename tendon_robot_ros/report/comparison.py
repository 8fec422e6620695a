"""A comparison as sentences, as a table, and as the page that `compare --report` writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from ..common.arrays import Floats, interpolated
from ..common.colours import BAD, FLOOR, MEASURED, WARN, line_style
from ..common.words import capital, columns, digits, mm, probability, times, typed
from ..comparison.result import Comparison, ModelErrors
from ..data.dataset import extent, names_in
from ..diagnosis.verdict import SAME_ERROR_RATIO
from ..inference.statistics import PairedT
from ..model.shape import bending_azimuth, views_of
from .error_plots import Step, angles, loops, per_marker, per_posture, staircase, tip_boxes
from .page import Figure, Page, Shown, Trace, axes, from_the_side, placed, plain, symbol, titled
from .sentences import Fault, excluded_lines, interval_name, marks, of_inputs, posture_name

# [1] of the reach of the markers, at the largest force of all postures: less would be no direction
ARROW_FRACTION = 0.3
# [1] of the motion of the markers: with a noise floor above this a model would pass that is off by
# a tenth of the motion; measurements of an arm with a tracker have a hundredth
FLOOR_FRACTION_MAX = 0.1


def model_rows(comparison: Comparison, first: str) -> list[list[str]]:
    """Return the errors of all models and the noise floor, a row each; the head has `first`."""
    rows = [[first, 'rms', 'worst', f'tip error (mean ± {interval_name(comparison)})']]
    for one in comparison.models:
        tip = one.tip_error(comparison.error)
        rows.append([label(one), mm(one.rms), mm(one.max), interval(tip.mean, tip.half)])
    if comparison.noise_floor is not None:
        rows.append(['noise floor (a perfect model)', mm(comparison.noise_floor), '', ''])
    return rows


def lines(comparison: Comparison) -> list[str]:
    """Return the table of all models, the largest errors, the better model, and the next step."""
    text = [columns(model_rows(comparison, size(comparison)))]
    text += [*excluded_lines({'outliers': comparison.measured.left_out}), where_worst(comparison)]
    text += [paired(test) for test in comparison.paired_t if test.posture is None]
    last = f'{verdict(comparison)} {next_step(comparison)}'
    return [*text, last.strip().replace('`', '')]


def size(comparison: Comparison) -> str:
    """Describe the number of postures, trials and markers."""
    measured = comparison.measured
    return extent(measured.trials, measured.inputs, len(measured.markers))


def label(model: ModelErrors) -> str:
    """Name a model and what it is."""
    what = kind(model.effects)
    return what if model.name == what else f'{model.name} ({what})'


def kind(effects: tuple[str, ...], most: int = 1) -> str:
    """Say which model a list of effects makes, in the words of the paper; `most` are named."""
    more = [name for name in effects if name != 'tendon_friction']
    base = 'PCCA' if len(more) == len(effects) else 'FKM'
    what = ', '.join(more) if len(more) <= most else f'{len(more)} effects'
    return f'{base} + {what}' if more else base


def interval(value: float, half: float) -> str:
    """Show a value [m] and half its interval, or 1 sd, in mm."""
    if not np.isfinite(half):
        return mm(value)
    shown = digits(1e3 * half, 2)
    places = len(shown.partition('.')[2])
    return f'{1e3 * value:.{places}f} ± {shown} mm'


def where_worst(comparison: Comparison) -> str:
    """Describe where the best model has its largest error, and where it exceeds the noise."""
    model = comparison.best
    of = '' if len(comparison.models) == 1 else f' of {model.name}'
    p = comparison.worst_posture(model)
    text = f'worst{of}: {posture_name(comparison, p)}, rms {mm(model.per_posture_rms[p])}'
    marker = comparison.grows_from(model)
    if marker is None or len(comparison.measured.markers) == 1:
        return f'{text}.'
    if marker == 0:
        first, last = (mm(float(model.per_marker_rms[j])) for j in (0, -1))
        return f'{text}; the first marker is off by {first} rms, the last by {last}.'
    what = 'cell' if comparison.measured.per_cell else 'marker'
    return f'{text}; the error grows from {what} {comparison.measured.markers[marker]} on.'


def verdict(comparison: Comparison) -> str:
    """Compare the best model with the repeatability."""
    best, floor = comparison.best, comparison.noise_floor
    who = 'The model'
    if len(comparison.models) > 1:  # said by what it is the best, if tip errors do not tell them
        tests = [one for one in comparison.paired_t if one.posture is None]
        alike = any(one.low <= 0.0 <= one.high and best.name in one.models for one in tests)
        who = f'The best model{" by rms" if alike else ""}, {best.name},'
    if floor is None:
        return (
            'Nothing tells how well you can measure: record every posture at least three times, '
            'or write position_noise into dataset.yaml.'
        )
    if _drowned(comparison):
        moved = comparison.measured.motion
        return (
            f'Nothing can be judged: the noise floor is {digits(100.0 * floor / moved, 2)} % of '
            f'what the markers move from posture to posture ({mm(moved)} rms), and a model that '
            'is off by as much would pass. See which trials of a posture differ, and measure '
            'again.'
        )
    ratio = best.rms / floor
    if not is_good(comparison):
        known = best.rms < SAME_ERROR_RATIO * np.hypot(floor, best.model_error)
        said = ', as far off as its description says (model_error)' if known else ''
        return f'{who} is off by {times(ratio)} your repeatability{said}.'
    size = f'{digits(ratio, 2)} times your repeatability'
    return f'{who} is as good as your measurements can tell: its error is {size}.'


def is_good(comparison: Comparison) -> bool:
    """Return whether the best model is as good as the measurements can tell."""
    floor = comparison.noise_floor
    return floor is not None and comparison.best.rms < SAME_ERROR_RATIO * floor


def _drowned(comparison: Comparison) -> bool:
    """Return whether the noise floor is a large fraction of the motion."""
    measured, floor = comparison.measured, comparison.noise_floor
    several = int((measured.trials > 0).sum()) > 1
    return several and floor is not None and floor > FLOOR_FRACTION_MAX * measured.motion


def next_step(comparison: Comparison) -> str:
    """Say what to type next; empty when nothing is to be explained."""
    if _drowned(comparison) or is_good(comparison):
        return ''
    return f'Ask why: `{typed("diagnose", *names_in(comparison.measured.data))}`'


def paired(test: PairedT) -> str:
    """Describe which of two models has the smaller tip error, and the p-value."""
    better, other = test.models if test.difference < 0.0 else test.models[::-1]
    low, high = sorted((abs(test.low), abs(test.high)))
    over = 'postures' if test.posture is None else f'trials of posture {test.posture}'
    pairs = f'paired t over {test.n} {over}, {probability(test.p)}'
    if test.low <= 0.0 <= test.high:
        return f'tip error: {better} and {other} do not differ ({pairs})'
    return (
        f'tip error: {better} {mm(abs(test.difference))} less than {other} (95 %: '
        f'{digits(1e3 * low, 3)} to {mm(high)}, {pairs})'
    )


def comparison_page(comparison: Comparison) -> Page:
    """Return the page: verdict and excluded readings first, then errors and shapes."""
    measured = comparison.measured
    page = Page(f'Models against measurements: {measured.data}', size(comparison))
    add_verdict(page, comparison)
    page.text(*(f'{capital(one)}.' for one in excluded_lines({'outliers': measured.left_out})))
    page.heading('Where the models are off')
    figures = [per_marker(comparison), per_posture(comparison), tip_boxes(comparison)]
    figures.append(staircase(steps(comparison), 'Models and noise floor'))
    page.figures(figures, 'two')
    add_loops(page, comparison)
    add_shapes(page, comparison)
    add_angles(page, comparison)
    return page


def add_verdict(page: Page, comparison: Comparison) -> None:
    """Add the verdict, the table of models and the tests between them."""
    lines = [verdict(comparison), capital(where_worst(comparison)), next_step(comparison)]
    page.box(filter(None, lines), 'verdict good' if is_good(comparison) else 'verdict')
    kinds = ['strong' if model is comparison.best else '' for model in comparison.models]
    page.table(model_rows(comparison, 'model'), [*kinds, 'faint'])
    tests = [test for test in comparison.paired_t if test.posture is None]
    page.text(*(f'{capital(paired(test))}.' for test in tests))
    page.text(
        'Errors are distances between the model and the mean over the trials of a posture; rms is '
        'over postures and markers. The tip error is the distance at the last marker, trial by '
        'trial: the mean over the trials of a posture, then over the postures.'
    )


def steps(comparison: Comparison) -> list[Step]:
    """Return the errors of the models as steps, the largest first, down to the noise floor."""
    models = enumerate(comparison.models)
    steps = [Step(one.name, one.rms, line_style(i).colour) for i, one in models]
    steps.sort(key=lambda step: -step.error)
    floor = comparison.noise_floor
    return [*steps, Step('noise floor', floor, FLOOR)] if floor is not None else steps


def add_loops(page: Page, comparison: Comparison) -> None:
    """Add the loops of a sequence, which show what the arm remembers."""
    if figures := loops(comparison):
        page.heading('What the arm remembers')
        page.text(
            'The tip while an input goes and returns, in the order of the sequence. Where the '
            'measured tip returns on another way, the arm remembers; a model that does not follow '
            'lacks a memory, or has another.'
        )
        page.figures(figures, 'two')


def add_shapes(
    page: Page, comparison: Comparison, faults: Sequence[Fault] = (), pushes: Pushes | None = None
) -> None:
    """
    Add the measured and predicted shapes.

    `faults` of the details of a diagnosis are marked where the model is wrong.
    """
    page.heading('Shapes')
    chosen, measured = chosen_postures(comparison), int((comparison.measured.trials > 0).sum())
    if len(chosen) < measured:
        page.text(
            f'The {len(chosen)} postures of {measured} that {comparison.best.name} predicts worst.'
        )
    page.key(shape_key(comparison, faults, pushes))
    drawn = [DrawnPosture(comparison, p, faults, pushes or {}) for p in chosen]
    if is_planar(comparison):
        page.figures([flat_figure(one) for one in drawn], 'many')
    else:
        page.figures([scene_figure(comparison, drawn)])
        page.figures([side_figure(one) for one in drawn], 'two')


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
    where = 'the postures that are predicted worst' if len(worst) > 1 else 'this posture'
    page.text(
        f'The turn from each chord between markers to the next, in {where}. Angles are '
        'differences of positions and much less precise than these; the first one counts from '
        'the base, half a cell.'
    )
    page.figures([angles(comparison, p) for p in worst], 'two')


def shape_key(
    comparison: Comparison, faults: Sequence[Fault] = (), pushes: Pushes | None = None
) -> list[tuple[str, str]]:
    """Return the legend that the pictures share."""
    styles = [(line_style(i), model.name) for i, model in enumerate(comparison.models)]
    entries = [(symbol(style.colour, style.stroke), name) for style, name in styles]
    if any(fault['along'] is not None for fault in faults):
        entries.append((symbol(WARN, dot=True), 'here the model is wrong'))
    if pushes:
        entries.append((symbol(BAD), 'what pushes the arm'))
    return [(symbol(MEASURED, dot=True), 'measured (mean of the trials)'), *entries]


def chosen_postures(comparison: Comparison) -> list[int]:
    """Return the postures to draw, in their order: all, or the worst of the best model."""
    errors = np.nan_to_num(comparison.best.per_posture_rms, nan=-1.0)
    valid = np.flatnonzero(errors >= 0.0)
    return sorted(valid[np.argsort(-errors[valid], kind='stable')][: Shown.POSTURES].tolist())


def is_planar(comparison: Comparison) -> bool:
    """Return whether all shapes lie in the x-z plane."""
    length = comparison.measured.arc_lengths.max()
    shapes = [comparison.measured.mean, *(model.markers for model in comparison.models)]
    return all(np.nanmax(np.abs(shape[..., 1])) < Shown.FLAT_FRACTION * length for shape in shapes)


@dataclass(frozen=True)
class Push:
    """What pushes the arm in one posture, as a diagnosis found it, to be drawn."""

    at: Floats  # (3,) [m]
    force: Floats  # (3,) [1] over the largest of all postures
    to: Floats | None = None  # (3,) [m] where the string is fixed that pulls
    is_wall: bool = False

    def traces(self, length: float, azimuth: float) -> list[Trace]:
        """Return an arrow, and the string or the wall, for an arm of a length [m] as seen."""
        along = self.force / np.linalg.norm(self.force)
        across = np.cross(along, [-np.sin(azimuth), np.cos(azimuth), 0.0])
        across /= max(float(np.linalg.norm(across)), 1e-9)
        tip = ARROW_FRACTION * length
        end = self.at + tip * self.force
        left, right = (end + 0.1 * tip * (side - 2.0 * along) for side in (across, -across))
        arrow = np.array([self.at, end, left, end, right])
        drawn = [placed(arrow, 'lines', 'force', line={'color': BAD, 'width': 3, 'dash': 'solid'})]
        if self.to is not None or self.is_wall:
            wall = self.at - tip * across, self.at + tip * across
            ends = wall if self.to is None else (self.at, self.to)
            line = {'color': BAD, 'width': 1.5, 'dash': 'solid' if self.is_wall else 'dot'}
            drawn.append(placed(np.array(ends), 'lines', 'what pushes', line=line))
        return drawn


Pushes = Mapping[str, Push]  # posture -> what pushes the arm in it


class DrawnPosture:
    """One posture in space: lines, points and marks, and the words around them."""

    def __init__(
        self, comparison: Comparison, p: int, faults: Sequence[Fault], pushes: Pushes
    ) -> None:
        """Draw a posture; faults are marked, and what pushes the arm is drawn."""
        lines = [comparison.measured.mean[p], *(model.line[p] for model in comparison.models)]
        best, name = comparison.best, comparison.measured.postures[p]
        words = [f'{best.name}: rms {mm(best.per_posture_rms[p])}', *of_inputs(faults, name)]
        self.p, self.title = p, capital(posture_name(comparison, p))
        self.caption = '; '.join(words)
        # [rad] in which it bends, as measured and as predicted
        self.azimuth = bending_azimuth(np.concatenate(lines))
        self.traces = posture_traces(comparison, p)
        self.traces += fault_rings(best.line[p], marks(faults, name))
        if name in pushes:
            across = 0.0 if is_planar(comparison) else self.azimuth
            self.traces += pushes[name].traces(comparison.measured.arc_lengths.max(), across)


def fault_rings(line: Floats, places: Sequence[tuple[float, str]]) -> list[Trace]:
    """Return a ring around every place of an arm's line at which it is wrong."""
    if not places:
        return []
    nodes = np.concatenate([np.zeros((1, 3)), line])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    points = interpolated(np.array([distance for distance, _ in places]), along, nodes)
    ring = {'color': WARN, 'symbol': 'circle-open', 'size': 16, 'line': {'width': 3}}
    more = {'text': [escape(text) for _, text in places], 'hoverinfo': 'text', 'marker': ring}
    return [placed(points, 'markers', 'wrong here', **more)]


def flat_figure(drawn: DrawnPosture) -> Figure:
    """Draw one posture in the x-z plane, as seen along y."""
    data = [*map(from_the_side, drawn.traces)]
    return Figure(data, small_axes('x [mm]'), drawn.title, drawn.caption, Shown.LOW)


def small_axes(x: str | Trace, **more: Trace) -> Trace:
    """Return the layout of a small picture, seen from the side; a key says which line is which."""
    margin = {'l': 46, 'r': 8, 't': 6, 'b': 40}
    return axes(x, titled('z [mm]', scaleanchor='x'), showlegend=False, margin=margin, **more)


def side_figure(drawn: DrawnPosture) -> Figure:
    """One posture seen across the plane in which it bends, and along that plane."""
    data = []
    for trace in drawn.traces:
        views = views_of(np.array([trace[axis] for axis in 'xyz'], dtype=float).T, drawn.azimuth)
        rest = {key: value for key, value in trace.items() if key not in 'xyz'}
        for side, name in enumerate(('x', 'x2')):
            points = {'x': plain(views[:, side]), 'y': plain(views[:, 2])}
            data.append({**rest, **points, 'xaxis': name})
    x = titled('in its plane [mm]', domain=[0.0, 0.64])
    x2 = titled('across [mm]', domain=[0.7, 1.0], scaleanchor='x', nticks=4, tickangle=0)
    layout = small_axes(x, xaxis2=x2)
    plane = round(np.degrees(drawn.azimuth))
    caption = f'{drawn.caption}; bends in a plane {plane}° from x'
    return Figure(data, layout, drawn.title, caption)


def scene_figure(comparison: Comparison, drawn: Sequence[DrawnPosture]) -> Figure:
    """One scene; a menu chooses the posture, the worst first, and looks across its plane."""
    worst = comparison.worst_posture(comparison.best)
    active = next(i for i, one in enumerate(drawn) if one.p == worst)
    data = []
    for i, one in enumerate(drawn):
        for trace in one.traces:
            drawn_trace = {**trace, 'type': 'scatter3d', 'visible': i == active}
            # in the sizes of a scene in space
            for part, size, factor in (('line', 'width', 2.0), ('marker', 'size', 0.6)):
                if part in trace:
                    drawn_trace[part] = {**trace[part], size: factor * trace[part][size]}
            data.append(drawn_trace)
    owner = np.repeat(np.arange(len(drawn)), [len(one.traces) for one in drawn])
    buttons = []
    for i, one in enumerate(drawn):
        name = posture_name(comparison, one.p)
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
    return Figure(data, layout, '', caption, Shown.SCENE)


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
    named = {
        f'{axis}axis': titled(f'{axis} [mm]', range=ends[i], nticks=4)
        for i, axis in enumerate('xyz')
    }
    ratio = dict(zip('xyz', (1.25 * size / size.max()).tolist(), strict=True))
    return {'aspectmode': 'manual', 'aspectratio': ratio, 'camera': camera, **named}


def posture_traces(comparison: Comparison, p: int) -> list[Trace]:
    """Return the lines and points of one posture in space."""
    measured, traces = comparison.measured, []
    for i, model in enumerate(comparison.models):
        style, arm = line_style(i), np.concatenate([np.zeros((1, 3)), model.line[p]])
        line: Trace = {'color': style.colour, 'dash': style.dash, 'width': 3}
        traces.append(placed(arm, 'lines', model.name, line=line))
        if model.centreline is not None:  # markers beside the arm, joined with the measured ones
            gap = np.full_like(measured.mean[p], np.nan)
            joined = np.stack([measured.mean[p], model.markers[p], gap], axis=1).reshape(-1, 3)
            line = {'color': FLOOR, 'width': 1.5}
            traces.append(placed(joined, 'lines', 'error', line=line, hoverinfo='skip'))
            ring = {'color': style.colour, 'symbol': 'circle-open', 'size': 7}
            traces.append(placed(model.markers[p], 'markers', 'predicted marker', marker=ring))
    dot, names = {'color': MEASURED, 'size': 5}, [*map(escape, measured.markers)]
    return [*traces, placed(measured.mean[p], 'markers', 'measured', marker=dot, text=names)]
