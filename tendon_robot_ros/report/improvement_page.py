"""What `improve` says, as text and page: the falling error, values, what remains, shapes."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from ..common.colours import FLOOR
from ..common.words import capital, columns, digits, mm, probability
from ..comparison.compare import compare
from ..data import DataSet
from ..diagnosis.result import COLOURS, Floats, Improvement, total
from ..effects import Catalogue
from .arm_text import as_built, left_out, where_wrong
from .comparison_page import add_shapes
from .error_plots import per_marker, per_posture
from .numbers import LOG_AXIS, mm_list, quantities
from .page import Figure, Page, titled

MARKERS_SHOWN_MAX = 4  # markers up to which each has its own number, else a row does not fit
LABEL_WIDTH = 22  # letters of a step's name in a line below the curve: a quarter of its height
WORST_POSTURES = 3  # that are named, so that the line is read
NOT_WRITTEN = 'Nothing was written: there is no step that lowers the error on left-out postures.'


def improvement_lines(found: Improvement) -> list[str]:
    """Return the table of the steps, values, and what remains."""
    made = [columns(step_table(found)), *sentences(found)]
    made += [f'{name}: {said}' for name, said in _values(found)]
    return [*made, *profile(found), *as_built(found.as_built), *remains(found)]


def _values(found: Improvement) -> list[tuple[str, str]]:
    """Return effects and their values in words."""
    loads = found.loads
    return [(name, quantities(own, loads.get(name))) for name, own in found.values.items()]


def step_table(found: Improvement) -> list[list[str]]:
    """Return a row per step: errors by kind, and what the step took off the left-out one."""
    kinds = list(found.steps[0].errors)
    few = len(found.markers) <= MARKERS_SHOWN_MAX
    where = ' '.join([' all', *found.markers]) if few else ' all, tip'
    where = where if len(found.markers) > 1 else ''
    rows = [['', *(f'{kind}{where} [mm]' for kind in kinds), 'took off, left out']]
    for k, step in enumerate(found.steps):
        label, fall = step.label, ''
        if k > found.taken:
            label = f'not taken: {label.removeprefix("+ ")}'
        if k:
            scatter = digits(1e3 * step.scatter)
            places = len(scatter.partition('.')[2])
            fall = f'{1e3 * step.fall:.{places}f} ± {scatter} mm'
        rows.append([label, *(numbers(step.errors[kind]) for kind in kinds), fall])
    return rows


def numbers(errors: Floats) -> str:
    """Show rms errors (J,) [m] in mm: of all markers, and of each one or of the last one."""
    own = errors if len(errors) <= MARKERS_SHOWN_MAX else errors[-1:]
    shown = np.append(total(errors), own) if len(errors) > 1 else errors
    return ' '.join(digits(1e3 * error, 3) for error in shown.tolist())


def sentences(found: Improvement) -> list[str]:
    """Say how far the error falls, and why no further."""
    first, last = found.steps[0], found.steps[found.taken]
    inside, before = found.chosen, total(first.left_out)
    said = [
        'Postures that had no part in the search are predicted to '
        f'{_reached(found, last.left_out)}, by the description as '
        f'it was to {mm(before)}; the noise floor is {mm(found.noise_floor)}.',
        f'Where the number of steps is chosen without them as well: {_reached(found, inside)}.',
    ]
    if not found.more_at_work:
        said.append(f'It stops there: what remains is noise ({probability(found.probability)}).')
    elif found.taken + 1 < len(found.steps):
        said.append('It stops there: what follows takes off too little to be told from chance.')
    else:
        said.append('It stops there: no other effect promises to lower the error.')
    return said


def _reached(found: Improvement, errors: Floats) -> str:
    """Say rms errors (J,) [m] of all markers, and of the last one where there are more."""
    tip = f' ({mm(float(errors[-1]))} at marker {found.markers[-1]})' if len(errors) > 1 else ''
    return f'{mm(total(errors))}{tip}'


def profile(found: Improvement) -> list[str]:
    """Say how the stiffness along the arm and the routes of the tendons have changed."""
    said = []
    if found.routes:
        turns = ', '.join(
            f'{name} by {degrees(turn)}, winding by {degrees(helix)}/m'
            for name, (turn, helix) in found.routes.items()
        )
        said.append(f'tendon_routes, turned about the axis: {turns}')
    if not found.profile:
        return said
    places = zip(('base', 'middle', 'tip'), found.profile, strict=True)
    changes = ', '.join(f'{100.0 * change:+.0f} % at the {where}' for where, change in places)
    return [*said, f'bending_stiffness along the arm: {changes}']


def degrees(radians: float) -> str:
    """Show an angle."""
    return f'{math.degrees(radians):.1f}°'


def remains(found: Improvement) -> list[str]:
    """Say what is not explained: the worst postures, places, and that more is at work."""
    worst = sorted(found.tips.items(), key=lambda item: -item[1])[:WORST_POSTURES]
    named = ', '.join(f'posture {posture} ({mm(error)})' for posture, error in worst)
    said = [
        f'worst at marker {found.markers[-1]} when left out: {named}',
        *where_wrong(found.local_faults),
        *left_out(found.left_out),
    ]
    return [*said, f'note: {found.more_at_work}'] if found.more_at_work else said


def write_improvement(
    found: Improvement, dataset: DataSet, catalogue: Catalogue, path: str | Path
) -> Path:
    """Write the page; it opens without a network."""
    return improvement_page(found, dataset, catalogue).write(path)


def improvement_page(found: Improvement, dataset: DataSet, catalogue: Catalogue) -> Page:
    """Return the page: what was reached, the curve, the table, values, and the shapes."""
    page = Page(f'Improving {found.robot.name}', f'measurements: {found.data}')
    page.box(sentences(found), 'verdict good' if found.taken else 'verdict')
    page.figures([curve(found)])
    header, *rows = step_table(found)
    kinds = ['strong' if k == found.taken else '' for k in range(found.taken + 1)]
    page.table(header, rows, kinds + ['faint'] * (len(rows) - len(kinds)), left=[0])
    page.heading('Values')
    page.text(*(f'`{name}`: {said}' for name, said in _values(found)))
    page.text(*map(capital, [*profile(found), *as_built(found.as_built)]))
    page.heading('What remains')
    page.text(*map(capital, remains(found)))
    models = [('as described', dataset.robot), ('improved', found.robot)]
    comparison = compare(dataset, models, catalogue)
    page.figures([per_marker(comparison), per_posture(comparison)], 'two')
    add_shapes(page, comparison, found.local_faults)
    return page


def curve(found: Improvement) -> Figure:
    """Draw the errors step by step; steps that were not taken are hollow."""
    names = ['<br>'.join(map(escape, wrap(step.label, LABEL_WIDTH))) for step in found.steps]
    data: list[dict[str, Any]] = [
        {
            'x': names,
            'y': mm_list([found.noise_floor] * len(names)),
            'name': 'noise floor',
            'mode': 'lines',
            'line': {'color': FLOOR, 'width': 2, 'dash': 'dot'},
        }
    ]
    taken = ['circle' if k <= found.taken else 'circle-open' for k in range(len(names))]
    for kind, errors in found.falling.items():
        data.append(
            {
                'x': names,
                'y': mm_list(errors),
                'name': kind,
                'mode': 'lines+markers',
                'line': {'color': COLOURS[kind]},
                'marker': {'symbol': taken, 'size': 9},
            }
        )
    layout = {
        'xaxis': {'type': 'category', 'tickangle': -90},
        'yaxis': titled('rms error, logarithmic [mm]', **LOG_AXIS),
    }
    title = 'The error falls step by step; hollow: not taken'
    return Figure(data, layout, title, '', 460)
