"""The reachable tips as text and as a page: cloud, hull, sections, what friction takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.colours import ERROR, INK, PREDICTED
from ..common.words import digits, listed
from ..workspace.cubes import LOOKS, Floats, Numbers, Reached
from ..workspace.volume import Volume, bends_as_one
from .numbers import mm_list
from .page import Figure, Page
from .workspace_page import degree

CLOUD_MAX = 12_000  # points that are drawn
SLICES_MAX = 31
LATE_MAX = 0.02  # share of cubes found late from which more postures are asked for
THIN_SHARE = 0.1  # of the cubes are full, at most: what they hold is thinner than they are
SCALE = 'Cividis'  # read alike by all eyes, and in grey


def summary(volume: Volume) -> list[str]:
    """Return what came out, a line each."""
    reached = volume.reached
    return [
        f'{volume.postures:,} postures over {len(volume.robot.inputs)} tendons from '
        f'{volume.limits[0]:g} to {volume.limits[1]:g} N{_left_out(volume)}',
        f'tips within {_box(reached)}',
        f'they fill {_fill(reached)}, in cubes of {digits(1e3 * reached.edge)} mm; '
        f'their convex hull has {_size(reached, reached.hull[2])}',
        *_directions(volume),
        *_friction(volume),
        *_views(volume),
        *_late(volume),
    ]


def _left_out(volume: Volume) -> str:
    parts = []
    if volume.folded:
        parts.append(f'{_share(volume.folded, volume.postures)} run into themselves')
    if volume.unsolved:
        parts.append(f'{_share(volume.unsolved, volume.postures)} have no equilibrium')
    return f'; left out: {listed(parts)}' if parts else ''


def _share(part: float, whole: float) -> str:
    return f'{digits(100.0 * part / whole)} %'


def _box(reached: Reached) -> str:
    ranges = zip('xyz', reached.lows, reached.highs, strict=True)
    return (
        ', '.join(
            f'{axis} {1e3 * low:.0f} to {1e3 * high:.0f}'
            for axis, low, high in ranges
            if high - low > 1e-9
        )
        + ' mm'
    )


def _size(reached: Reached, size: float) -> str:
    return f'{digits(1e4 * size, 3)} cm²' if reached.is_flat else f'{digits(1e6 * size, 3)} cm³'


def _fill(reached: Reached) -> str:
    """Say how much space tips fill; of a surface in space none that cubes can tell."""
    if reached.size < THIN_SHARE * len(reached) * reached.edge ** (2 if reached.is_flat else 3):
        return 'a curve' if reached.is_flat else 'a thin shell'
    return _size(reached, reached.size)


def _directions(volume: Volume) -> list[str]:
    text = f'the tip turns up to {degree(volume.largest)} away from the base'
    if volume.reached.is_flat:
        return [text]
    text += f' and looks into {_share(volume.sphere, 1.0)} of all directions'
    if bends_as_one(volume.robot):
        return [
            f'{text}. With one section the place of the tip nearly fixes where it looks: the '
            'places of one view angle are a ring around the base'
        ]
    mean = float(volume.reached.looks.mean())
    return [f'{text}; from one cube into {digits(mean)} of {LOOKS} equal parts of them (mean)']


def _friction(volume: Volume) -> list[str]:
    other = volume.frictionless
    if other is None:
        return []
    taken, given = (_share(part or 0.0, 1.0) for part in (volume.taken, volume.given))
    why = ': it bends more near the base, less farther out' if volume.given else ''
    return [
        f'friction takes {taken} of the places that the same arm without friction reaches '
        f'({_fill(other)}); {given} of the places with friction lie beyond those{why}'
    ]


def _views(volume: Volume) -> list[str]:
    return [
        f'{degree(view)} view: {_box(part)}'
        if len(part)
        else f'no posture at {degree(view)}: the largest tip angle is {degree(volume.largest)}'
        for view, part in volume.views.items()
    ]


def _late(volume: Volume) -> list[str]:
    if volume.late < LATE_MAX:
        return []
    return [
        f'NOT YET FULL: the last tenth of the postures found {_share(volume.late, 1.0)} of the '
        'cubes; ask for more --postures or larger --cubes'
    ]


# -----------------------------------------------------------------------------
# The page


def volume_page(volume: Volume) -> Page:
    """Return the page: what came out, the cloud, sections through it."""
    page = Page(f'Reachable tips: {volume.robot.name}', 'all tendons at once')
    lines = summary(volume)
    late = _late(volume)
    page.box(lines[: len(lines) - len(late)], 'found')
    if late:
        page.box(late, 'warn')
    if not volume.reached.is_flat:
        page.figures([_cloud(volume)])
    page.heading('Sections')
    values, title = _values(volume)
    if volume.reached.is_flat:
        page.figures([_sections(volume, values, title, 1)])
    else:
        page.figures([_sections(volume, values, title, axis) for axis in (1, 2)], 'two')
    for view, part in volume.views.items():
        if len(part):
            page.heading(f'{degree(view)} view')
            page.figures([_view(part, view)])
    page.text(
        'Collisions with anything but the arm itself are not known here. Every place is that of '
        'the posture with the lowest highest tension found; `workspace.npz` has all of them.'
    )
    return page


def _values(volume: Volume) -> tuple[Floats, str]:
    """Return what colours a cube (c,), and what it is."""
    if volume.reached.is_flat or bends_as_one(volume.robot):
        return volume.reached.tensions.max(axis=1), 'highest<br>tension [N]'
    return volume.reached.looks.astype(float), f'directions<br>of {LOOKS}'


def _scene() -> dict[str, Any]:
    axes = {f'{axis}axis': {'title': {'text': f'{axis} [mm]'}} for axis in 'xyz'}
    scene = {'aspectmode': 'data', 'camera': {'eye': {'x': 1.8, 'y': 1.8, 'z': 0.9}}, **axes}
    legend = {'orientation': 'h', 'itemsizing': 'constant', 'y': 1.0, 'x': 0.0}
    return {'scene': scene, 'legend': legend, 'margin': {'l': 0, 'r': 0, 't': 0, 'b': 0}}


def _coordinates(points: Floats) -> dict[str, Any]:
    return {axis: mm_list(points[:, i]) for i, axis in enumerate('xyz')}


def _cloud(volume: Volume) -> Figure:
    """Tips at the outside of what is reached, the hull, and the straight arm."""
    reached = volume.reached
    values, title = _values(volume)
    rows = _thinned(np.flatnonzero(reached.outside))
    data = [_outside(reached, rows, values, title), _hull(reached), _straight(volume.robot.length)]
    caption = (
        f'{len(rows):,} of {len(reached):,} cubes, each with the posture of least tension. '
        'Drag to turn; a point tells the tensions.'
    )
    return Figure(data, _scene(), 'Where the tip can be', caption, height=560)


def _outside(reached: Reached, rows: Numbers, values: Floats, title: str) -> dict[str, Any]:
    """Tips of some cubes, with their tensions."""
    return {
        'type': 'scatter3d',
        'mode': 'markers',
        'name': 'tips at the outside',
        **_coordinates(reached.tips[rows]),
        'text': [_pulled(reached, row) for row in rows],
        'hoverinfo': 'x+y+z+text',
        'marker': {
            'size': 2.5,
            'color': [float(f'{value:.3g}') for value in values[rows]],
            'colorscale': SCALE,
            'colorbar': {'title': {'text': title}, 'thickness': 12, 'len': 0.6},
        },
    }


def _hull(reached: Reached) -> dict[str, Any]:
    """Draw the convex hull."""
    corners, faces, _ = reached.hull
    return {
        'type': 'mesh3d',
        'name': 'convex hull',
        **_coordinates(corners),
        **{axis: faces[:, i].tolist() for i, axis in enumerate('ijk')},
        'color': PREDICTED,
        'opacity': 0.12,
        'hoverinfo': 'skip',
        'showlegend': True,
    }


def _straight(length: float) -> dict[str, Any]:
    """Draw the straight arm."""
    return {
        'type': 'scatter3d',
        'mode': 'lines',
        'name': 'the straight arm',
        **_coordinates(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, length]])),
        'line': {'color': INK, 'width': 8},
    }


def _thinned(rows: Numbers) -> Numbers:
    return rows.take(np.linspace(0, len(rows) - 1, min(len(rows), CLOUD_MAX)).astype(int), axis=0)


def _pulled(reached: Reached, row: int) -> str:
    named = zip(reached.robot.inputs, reached.tensions[row].tolist(), strict=True)
    return ', '.join(f'{name} {digits(value)} N' for name, value in named)


def _sections(volume: Volume, values: Floats, title: str, axis: int) -> Figure:
    """Cut through the cubes across y (axis 1) or z (2); a slider moves the cut."""
    reached, other = volume.reached, volume.frictionless
    across, up = (0, 2) if axis == 1 else (0, 1)
    cells = [reached.cells] + ([other.cells] if other is not None else [])
    corners = np.array([(c.min(axis=0), c.max(axis=0)) for c in cells], dtype=np.int64)
    low: Numbers = corners[:, 0].min(axis=0)
    high: Numbers = corners[:, 1].max(axis=0)
    places = np.unique(np.linspace(low[axis], high[axis], SLICES_MAX).round().astype(int))
    middle = int(np.argmin(np.abs(places - (0 if axis == 1 else (low[2] + high[2]) // 2))))
    frame = (low[[across, up]], high[[across, up]], reached.edge)
    data: list[dict[str, Any]] = []
    for i, place in enumerate(places):
        for part, shown in ((other, None), (reached, values)):
            if part is not None:
                here = part.cells[:, axis] == place
                colours = _colours(shown, title)
                heights = np.ones(len(part)) if shown is None else shown
                cut = _heat(frame, part.cells[here][:, [across, up]], heights[here], i == middle)
                data.append(cut | colours)
    name, other_name = 'xyz'[up], 'xyz'[axis]
    layout: dict[str, Any] = {
        'xaxis': {'title': {'text': 'x [mm]'}, 'constrain': 'domain'},
        'yaxis': {'title': {'text': f'{name} [mm]'}, 'scaleanchor': 'x'},
    }
    if len(places) > 1:
        layout['sliders'] = [_slider(places, middle, reached.edge, other_name, len(data))]
        layout['margin'] = {'l': 56, 'r': 16, 't': 12, 'b': 90}
    caption = 'Grey: reached without friction only.' if other is not None else ''
    plane = 'x-z' if axis == 1 else 'x-y'
    return Figure(data, layout, f'Section along the {plane} plane', caption, height=520)


def _colours(values: Floats | None, title: str) -> dict[str, Any]:
    """Return how values are coloured; grey where there are none."""
    if values is None:
        grey = [[0.0, '#d3d7dc'], [1.0, '#d3d7dc']]
        return {'colorscale': grey, 'showscale': False, 'hoverinfo': 'skip'}
    bar = {'title': {'text': title}, 'thickness': 12}
    return {'colorscale': SCALE, 'zmin': 0.0, 'zmax': float(values.max()), 'colorbar': bar}


def _heat(
    frame: tuple[Numbers, Numbers, float], cells: Numbers, values: Floats, shown: bool
) -> dict[str, Any]:
    """Return a picture of cubes (c, 2) in a plane; what none fills stays empty."""
    low, high, edge = frame
    shape = high - low + 1
    grid = np.full((shape[1], shape[0]), np.nan)
    grid[cells[:, 1] - low[1], cells[:, 0] - low[0]] = values
    rows = [
        [None if np.isnan(value) else float(f'{value:.3g}') for value in row]
        for row in grid.tolist()
    ]
    middles = [mm_list((np.arange(low[i], high[i] + 1) + 0.5) * edge) for i in range(2)]
    return {
        'type': 'heatmap', 'x': middles[0], 'y': middles[1], 'z': rows, 'visible': shown,
        'hovertemplate': 'x %{x} mm, %{y} mm: %{z}<extra></extra>',
    }  # fmt: skip


def _slider(places: Numbers, middle: int, edge: float, axis: str, traces: int) -> dict[str, Any]:
    each = traces // len(places)
    steps = [
        {
            'label': f'{1e3 * (place + 0.5) * edge:.0f}',
            'method': 'restyle',
            'args': ['visible', [k // each == i for k in range(traces)]],
        }
        for i, place in enumerate(places.tolist())
    ]
    current = {'prefix': f'{axis} = ', 'suffix': ' mm', 'font': {'size': 13}}
    return {'active': middle, 'steps': steps, 'currentvalue': current, 'pad': {'t': 36}}


def _view(part: Reached, view: float) -> Figure:
    """Tips that look at an angle, and which way."""
    rows = _thinned(np.arange(len(part)))
    length = 0.08 * part.robot.length
    tips, ends = part.tips[rows], part.tips[rows] + length * part.directions[rows]
    lines = np.stack([tips, ends, np.full_like(tips, np.nan)], axis=1).reshape(-1, 3)
    data = [
        {
            'type': 'scatter3d', 'mode': 'markers', 'name': 'tips', **_coordinates(tips),
            'marker': {'size': 2.5, 'color': PREDICTED},
        },
        {
            'type': 'scatter3d', 'mode': 'lines', 'name': 'where they look',
            **_coordinates(lines), 'line': {'color': ERROR, 'width': 2},
            'hoverinfo': 'skip',
        },
    ]  # fmt: skip
    caption = f'{len(part):,} cubes whose tips look {degree(view)} away from the base.'
    return Figure(data, _scene(), '', caption, height=460)
