"""A workspace as a page: postures at a view angle (figures 7 and 8 of Kato et al. 2015)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.colours import FLOOR, look
from ..common.words import commands, digits
from ..workspace.grid import Family, Floats, Workspace
from .numbers import degrees_list, mm_list
from .page import Figure, Page

HEIGHT_NAMES = ('highest tip', 'median tip', 'lowest tip')
AT_LIMIT_WITHIN_N = 1e-6  # [N]
FAMILY_COLUMNS = (
    'view', 'pair', 'towards', 'postures', 'tips across', 'tips along z', 'largest tension',
)  # fmt: skip


def rows(workspace: Workspace) -> list[list[str]]:
    """Return the table of the families: how many postures, where the tips are, which tension."""
    made = []
    for family in workspace.families:
        tension = float(family.tensions.max())
        full = ' (the limit)' if tension > workspace.limit - AT_LIMIT_WITHIN_N else ''
        made.append(
            [
                degree(family.view),
                family.pair.name,
                towards(family),
                f'{len(family)}',
                f'{digits(1e3 * across(family), 3)} mm',
                f'{digits(1e3 * float(family.span[2]), 3)} mm',
                f'{digits(tension, 3)} N{full}',
            ]
        )
    return made


def missing(workspace: Workspace) -> list[str]:
    """Say which view angles no posture reaches."""
    return [
        f'no posture at {degree(view)} within ±{degree(workspace.tolerance)}: '
        f'the largest tip angle is {degree(workspace.largest)}; ask for another angle, a larger '
        '--tolerance, a smaller --step or a higher --limit'
        for view in workspace.views
        if not workspace.of(view)
    ]


def towards(family: Family) -> str:
    """Say to which side a family looks."""
    flat = np.abs(family.bend[..., 1]).max(initial=0.0) < 1e-9
    return ('+x' if family.side > 0 else '-x') if flat else 'all around'


def across(family: Family) -> float:
    """Range of the tips across the backbone [m]: along x, or the larger of x and y."""
    return float(family.span[:2].max())


def degree(angle: float) -> str:
    """Show an angle in degrees."""
    return f'{digits(round(float(np.degrees(angle)), 6), 3)}°'.replace('.0°', '°')


def view_figures(family: Family) -> list[Figure]:
    """Return the postures of a family, and the angular displacement of the three salient ones."""
    return [postures(family), displacement(family)]


def postures(family: Family) -> Figure:
    """Positions of all cells in the postures with highest, median and lowest tip; all tips."""
    planar = np.abs(family.positions[..., 1]).max(initial=0.0) < 1e-9
    title = f'{degree(family.view)} view, {family.pair.name}'
    data = [_line(family, i, planar) for i in range(3)]
    data.append(_tips(family, planar))
    caption = (
        f'{len(family)} postures; tips within {digits(1e3 * across(family), 3)} mm across and '
        f'{digits(1e3 * float(family.span[2]), 3)} mm along z.'
    )
    axes = {f'{axis}axis': {'title': {'text': f'{axis} [mm]'}} for axis in 'xyz'}
    if not planar:
        scene = {
            'scene': {'aspectmode': 'data', **axes},
            'margin': {'l': 0, 'r': 0, 't': 0, 'b': 0},
        }
        return Figure(data, scene, title, caption + ' Drag to turn.', height=460)
    layout = {
        'xaxis': {'title': {'text': 'x [mm]'}},
        'yaxis': {'title': {'text': 'z [mm]'}, 'scaleanchor': 'x'},
    }
    return Figure(data, layout, title, caption, height=460)


def displacement(family: Family) -> Figure:
    """Angular displacement per cell of the three postures."""
    cells = list(range(1, family.bend.shape[1] + 1))
    planar = np.abs(family.bend[..., 1]).max(initial=0.0) < 1e-9
    data: list[dict[str, Any]] = []
    for i, b in enumerate(family.salient):
        bend = family.bend[b]
        angle = bend[:, 0] if planar else np.linalg.norm(bend, axis=1)
        data.append(
            {
                'x': cells,
                'y': degrees_list(angle),
                'name': HEIGHT_NAMES[i],
                'mode': 'lines+markers',
                'line': {'color': look(i).colour, 'dash': look(i).dash, 'width': 2},
                'marker': {'symbol': look(i).symbol, 'size': 6},
            }
        )
    layout = {
        'xaxis': {'title': {'text': 'cell'}},
        'yaxis': {'title': {'text': 'angular displacement per cell [°]'}},
    }
    caption = '; '.join(
        f'{HEIGHT_NAMES[i]}: {_pulled(family, b)}' for i, b in enumerate(family.salient)
    )
    return Figure(data, layout, 'Angular displacement per cell', caption, height=460)


def _pulled(family: Family, b: int) -> str:
    values = family.tensions[b, list(family.pair.indices)].tolist()
    return commands(dict(zip(family.pair.inputs, values, strict=True)))


def _line(family: Family, i: int, planar: bool) -> dict[str, Any]:
    points = np.concatenate([np.zeros((1, 3)), family.positions[family.salient[i]]])
    made = {
        **_places(points, planar),
        'name': HEIGHT_NAMES[i],
        'mode': 'lines+markers',
        'line': {'color': look(i).colour, 'dash': look(i).dash, 'width': 2 if planar else 5},
        'marker': {'color': look(i).colour, 'symbol': look(i).symbol, 'size': 5 if planar else 3},
    }
    return made


def _tips(family: Family, planar: bool) -> dict[str, Any]:
    keep = np.linspace(0, len(family) - 1, min(len(family), 2000)).astype(int)
    return {
        **_places(family.tips[keep], planar),
        'name': 'all tips',
        'mode': 'markers',
        'marker': {'color': FLOOR, 'size': 5 if planar else 2, 'opacity': 0.6},
    }


def _places(points: Floats, planar: bool) -> dict[str, Any]:
    if planar:
        return {'x': mm_list(points[:, 0]), 'y': mm_list(points[:, 2])}
    return {
        'type': 'scatter3d',
        **{axis: mm_list(points[:, i]) for i, axis in enumerate('xyz')},
    }


# -----------------------------------------------------------------------------
# The page that `workspace --output` writes.

FAMILIES_DRAWN_MAX = 4  # of a view that are drawn


def workspace_page(workspace: Workspace) -> Page:
    """Return the page: the table, then the largest families of every view."""
    page = Page(
        f'Range of motion: {workspace.robot.name}',
        f'{workspace.postures:,} postures; tensions from {workspace.pretension:g} to '
        f'{workspace.limit:g} N in steps of {workspace.step:g} N',
    )
    lacking = missing(workspace)
    if lacking:
        page.box(lacking, 'warn')
    if workspace.families:
        page.table(FAMILY_COLUMNS, rows(workspace), left=(1, 2))
    for view in workspace.views:
        families = workspace.of(view)
        if not families:
            continue
        page.heading(f'{degree(view)} view')
        if len(families) > FAMILIES_DRAWN_MAX:
            page.text(f'The {FAMILIES_DRAWN_MAX} of {len(families)} families with most postures.')
        for family in families[:FAMILIES_DRAWN_MAX]:
            page.figures(view_figures(family), 'two')
    return page
