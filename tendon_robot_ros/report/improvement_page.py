"""The result of `improve` as text and page: errors, values, remaining error, shapes."""

from __future__ import annotations

import math
from html import escape
from textwrap import wrap

import numpy as np

from ..common.arrays import Floats
from ..common.colours import FLOOR
from ..common.words import capital, columns, digits, mm, probability
from ..comparison.compare import compare
from ..data import DataSet
from ..diagnosis.result import COLOURS, Improvement, total
from ..effects import Catalogue
from ..inference.crossval import set_alike
from .comparison import add_shapes, interval
from .diagnosis_text import more_lines
from .error_plots import per_marker, per_posture
from .page import Figure, Page, Shown, axes, mm_list, titled, trace
from .sentences import anew_lines, as_built, excluded_lines, of_effects, where_wrong

NOT_WRITTEN = 'Nothing was written: there is no step that lowers the error on left-out postures.'


def improvement_lines(improvement: Improvement) -> list[str]:
    """Return the table of the steps, values, and what remains."""
    lines = [columns(step_table(improvement)), *sentences(improvement)]
    lines += of_effects(improvement.values, improvement.loads)
    return [*lines, *profile(improvement), *as_built(improvement.as_built), *remains(improvement)]


def step_table(improvement: Improvement) -> list[list[str]]:
    """Return a row per step: errors by kind, and what the step took off the left-out one."""
    kinds = list(improvement.steps[0].errors)
    few = len(improvement.markers) <= Shown.MARKERS
    where = ' '.join([' all', *improvement.markers]) if few else ' all, tip'
    where = where if len(improvement.markers) > 1 else ''
    rows = [['', *(f'{kind}{where} [mm]' for kind in kinds), 'took off, left out']]
    for k, step in enumerate(improvement.steps):
        label, fall = step.label, interval(step.fall, step.scatter) if k else ''
        if k > improvement.taken:
            label = f'not taken: {label.removeprefix("+ ")}'
        rows.append([label, *(numbers(step.errors[kind]) for kind in kinds), fall])
    return rows


def numbers(errors: Floats) -> str:
    """Show rms errors (J,) [m] in mm: of all markers, and of each one or of the last one."""
    own = errors if len(errors) <= Shown.MARKERS else errors[-1:]
    shown = np.append(total(errors), own) if len(errors) > 1 else errors
    return ' '.join(digits(1e3 * error, 3) for error in shown.tolist())


def sentences(improvement: Improvement) -> list[str]:
    """Describe the reduction of the error, and why the search stopped."""
    first, last = improvement.steps[0], improvement.steps[improvement.taken]
    tip = f'at marker {improvement.markers[-1]}'
    reached, inside = (  # of all markers, and of the last one where there are more
        mm(total(one)) + (f' ({mm(float(one[-1]))} {tip})' if len(one) > 1 else '')
        for one in (last.left_out, improvement.chosen)
    )
    before, floor = mm(total(first.left_out)), mm(improvement.noise_floor)
    texts = [
        f'Postures that had no part in the search are predicted to {reached}, by the description '
        f'as it was to {before}; the noise floor is {floor}.',
        f'Where the number of steps is chosen without them as well: {inside}.',
    ]
    why = 'no other effect promises to lower the error'
    if not improvement.more_at_work:
        why = f'what remains is noise ({probability(improvement.probability)})'
    elif improvement.taken + 1 < len(improvement.steps):
        why = 'what follows takes off too little to be told from chance'
    return [*texts, f'It stops there: {why}.', *map(capital, anew_lines(improvement.anew))]


def profile(improvement: Improvement) -> list[str]:
    """Say how the stiffness along the arm and the routes of the tendons have changed."""
    texts, rotations = [], []
    for name, angles in improvement.routes.items():
        turn, helix = (f'{math.degrees(angle):.1f}°' for angle in angles)
        rotations.append(f'{name} by {turn}, winding by {helix}/m')
    if rotations:
        texts.append(f'tendon_routes, turned about the axis: {", ".join(rotations)}')
    if improvement.profile:
        places = zip(('base', 'middle', 'tip'), improvement.profile, strict=True)
        changes = ', '.join(f'{100.0 * change:+.0f} % at the {where}' for where, change in places)
        texts.append(f'bending_stiffness along the arm: {changes}')
    return texts


def remains(improvement: Improvement) -> list[str]:
    """Describe the remaining error: the worst postures and places, and unexplained causes."""
    worst = sorted(improvement.tips.items(), key=lambda item: -item[1])[: Shown.WORST]
    named = ', '.join(f'posture {posture} ({mm(error)})' for posture, error in worst)
    return [
        f'worst at marker {improvement.markers[-1]} when left out: {named}',
        *where_wrong(improvement.local_faults),
        *excluded_lines(improvement.left_out),
        *more_lines(improvement.more_at_work, improvement.robot.model_error),
    ]


def improvement_page(improvement: Improvement, dataset: DataSet, catalogue: Catalogue) -> Page:
    """Return the page: what was reached, the curve, the table, values, and the shapes."""
    page = Page(f'Improving {improvement.robot.name}', f'measurements: {improvement.data}')
    page.box(sentences(improvement), 'verdict good' if improvement.taken else 'verdict')
    page.figures([curve(improvement)])
    kinds = [*[''] * improvement.taken, 'strong', *['faint'] * len(improvement.steps)]
    page.table(step_table(improvement), kinds, left=[0])
    page.heading('Values')
    page.text(*of_effects(improvement.values, improvement.loads, '`'))
    page.text(*map(capital, [*profile(improvement), *as_built(improvement.as_built)]))
    page.heading('What remains')
    page.text(*map(capital, remains(improvement)))
    models = [('as described', dataset.robot), ('improved', improvement.robot)]
    alike = set_alike(dataset, improvement.robot, catalogue, improvement.anew)
    comparison = compare(alike, models, catalogue)
    page.figures([per_marker(comparison), per_posture(comparison)], 'two')
    add_shapes(page, comparison, improvement.local_faults)
    return page


def curve(improvement: Improvement) -> Figure:
    """Draw the errors step by step; steps that were not taken are hollow."""
    names = [
        '<br>'.join(map(escape, wrap(step.label, Shown.STEP_NAME))) for step in improvement.steps
    ]
    floor = mm_list([improvement.noise_floor] * len(names))
    line = {'color': FLOOR, 'width': 2, 'dash': 'dot'}
    data = [trace(names, floor, 'noise floor', line=line)]
    symbols = ['circle' if k <= improvement.taken else 'circle-open' for k in range(len(names))]
    for kind, errors in improvement.falling.items():
        line, marker = {'color': COLOURS[kind]}, {'symbol': symbols, 'size': 9}
        data.append(trace(names, mm_list(errors), kind, 'lines+markers', line=line, marker=marker))
    x = {'type': 'category', 'tickangle': -90}
    layout = axes(x, titled('rms error, logarithmic [mm]', **Shown.LOG_AXIS))
    title = 'The error falls step by step; hollow: not taken'
    return Figure(data, layout, title, height=Shown.TALL)
