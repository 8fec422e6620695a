"""The page of `improve`: the curve of the falling error, its table, values, shapes."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from ..common.colours import BAND, FLOOR
from ..comparison.compare import compare
from ..data import DataSet
from ..diagnosis.improvement import COLOURS, Improvement
from ..effects import Catalogue
from . import improvement_text as say
from .comparison_page import add_shapes
from .error_plots import per_marker, per_posture
from .numbers import mm_list, quantities
from .page import Figure, Page


def write_improvement(
    found: Improvement, dataset: DataSet, catalogue: Catalogue, path: str | Path
) -> Path:
    """Write the page; it opens without a network."""
    return improvement_page(found, dataset, catalogue).write(path)


def improvement_page(found: Improvement, dataset: DataSet, catalogue: Catalogue) -> Page:
    """Return the page: what was reached, the curve, the table, values, and the shapes."""
    page = Page(f'Improving {found.robot.name}', f'measurements: {found.data}')
    page.box(say.sentences(found), 'verdict good' if found.taken else 'verdict')
    page.figures([curve(found)])
    header, *rows = say.table(found)
    kinds = ['strong' if k == found.taken else '' for k in range(found.taken + 1)]
    page.table(header, rows, kinds + ['faint'] * (len(rows) - len(kinds)), left=[0])
    page.heading('Values')
    page.text(*(f'`{name}`: {quantities(values)}' for name, values in found.values.items()))
    page.text(*say.profile(found))
    page.heading('What remains')
    page.text(*say.remains(found))
    models = [('as described', dataset.robot), ('improved', found.robot)]
    comparison = compare(dataset, models, catalogue)
    page.figures([per_marker(comparison), per_posture(comparison)], 'two')
    add_shapes(page, comparison, found.local_faults)
    return page


def curve(found: Improvement) -> Figure:
    """Draw the errors step by step; steps that were not taken are hollow."""
    names = [escape(step.label) for step in found.steps]
    data: list[dict[str, Any]] = [
        {
            'x': names,
            'y': mm_list([found.noise_floor] * len(names)),
            'name': 'noise floor',
            'mode': 'lines',
            'line': {'color': FLOOR, 'width': 1},
            'fill': 'tozeroy',
            'fillcolor': BAND,
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
        'xaxis': {'type': 'category'},
        'yaxis': {'title': {'text': 'error, rms over postures and markers [mm]'},
                  'rangemode': 'tozero'},
    }  # fmt: skip
    title = 'The error falls step by step; hollow: not taken'
    return Figure(data, layout, title, '', 420)
