"""
What the command `workspace` says, as text and pages.

Postures of an arm in a plane at a view angle (figures 7 and 8 of Kato et al. 2015); and the tips
of all tendons: cloud, hull, sections, what friction takes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.arrays import Floats, Ints, evenly
from ..common.colours import ERROR, FLOOR, INK, PREDICTED, line_style
from ..common.words import commands, digits, listed, mm
from ..workspace.cubes import SPHERE_PART_COUNT, Reached
from ..workspace.view_angle import Family, Workspace
from ..workspace.volume import Volume, bends_as_one
from .page import Figure, Page, Shown, Trace, axes, curve, from_the_side, placed, plain, titled

HEIGHT_NAMES = ('highest tip', 'median tip', 'lowest tip')
# [1] of the cubes that the last tenth of the postures added (about one for every cube): where more
# than one in 50 was new, the cloud still grows, so that more postures would change its size
LATE_MAX = 0.02
# [1] of the cubes that are full: where fewer are, tips lie on a sheet or a line, and the volume of
# the cubes would be that of the cubes' size
THIN_FRACTION = 0.1
GREY = '#d3d7dc'  # of what only an arm without friction reaches
SCALE = 'Cividis'  # read alike by all eyes, and in grey


def rows(workspace: Workspace) -> list[list[str]]:
    """Return the table of the families: how many postures, where the tips are, which tension."""
    names = 'view', 'pair', 'towards', 'postures', 'tips across', 'tips along z', 'largest tension'
    table = [[*names]]
    for family in workspace.families:
        tension = float(family.tensions.max())
        full = ' (the limit)' if np.isclose(tension, workspace.limit) else ''
        what = [degree(family.view), family.pair.name, towards(family), f'{len(family)}']
        table.append([*what, *spans(family), f'{digits(tension, 3)} N{full}'])
    return table


def missing(workspace: Workspace) -> list[str]:
    """Say which view angles no posture reaches."""
    return [
        f'no posture at {degree(view)} within ±{degree(workspace.tolerance)}: '
        f'the largest tip angle is {degree(workspace.largest)}; ask for another angle, a larger '
        '--tolerance, a smaller --step or a higher --tension-max'
        for view in workspace.views
        if not workspace.of(view)
    ]


def towards(family: Family) -> str:
    """Say to which side a family looks."""
    return ('+x' if family.side > 0 else '-x') if family.is_flat else 'all around'


def spans(family: Family) -> list[str]:
    """Show the range of the tips across the backbone (x, or the larger of x and y) and along z."""
    return [mm(float(size)) for size in (family.span[:2].max(), family.span[2])]


def degree(angle: float) -> str:
    """Show an angle in degrees."""
    return f'{digits(round(float(np.degrees(angle)), 6), 3)}°'.replace('.0°', '°')


def view_figures(family: Family) -> list[Figure]:
    """Return the postures of a family, and the angular displacement of the three salient ones."""
    return [postures(family), displacement(family)]


def postures(family: Family) -> Figure:
    """Positions of all cells in the postures with highest, median and lowest tip; all tips."""
    planar = family.is_flat
    title = f'{degree(family.view)} view, {family.pair.name}'
    data: list[Trace] = []
    for i, row in enumerate(family.salient):
        style = line_style(i)
        points = np.concatenate([np.zeros((1, 3)), family.positions[row]])
        marker: Trace = {'color': style.colour, 'symbol': style.symbol, 'size': 5 if planar else 3}
        line = {'color': style.colour, 'dash': style.dash, 'width': 2 if planar else 5}
        data.append(in_space(points, 'lines+markers', HEIGHT_NAMES[i], line=line, marker=marker))
    kept = family.tips[evenly(len(family.tips), Shown.DRAWN_POINTS)]
    marker = {'color': FLOOR, 'size': 5 if planar else 2, 'opacity': 0.6}
    data.append(in_space(kept, 'markers', 'all tips', marker=marker))
    across, along = spans(family)
    caption = f'{len(family)} postures; tips within {across} across and {along} along z.'
    layout = axes('x [mm]', titled('z [mm]', scaleanchor='x')) if planar else scene()
    drawn = [*map(from_the_side, data)] if planar else data
    shown = caption if planar else f'{caption} Drag to turn.'
    return Figure(drawn, layout, title, shown, height=Shown.TALL)


def displacement(family: Family) -> Figure:
    """Angular displacement per cell of the three postures."""
    cells = list(range(1, family.bend.shape[1] + 1))
    data, pulled = list[Trace](), []
    for i, (name, b) in enumerate(zip(HEIGHT_NAMES, family.salient, strict=True)):
        bend = family.bend[b]
        angle = bend[:, 0] if family.is_flat else np.linalg.norm(bend, axis=1)
        data.append(curve(cells, plain(np.degrees(angle)), name, line_style(i), size=6))
        values = family.tensions[b, list(family.pair.indices)].tolist()
        pulled.append(f'{name}: {commands(dict(zip(family.pair.inputs, values, strict=True)))}')
    title, caption = 'Angular displacement per cell', '; '.join(pulled)
    layout = axes('cell', 'angular displacement per cell [°]')
    return Figure(data, layout, title, caption, height=Shown.TALL)


def workspace_page(workspace: Workspace) -> Page:
    """Return the page: the table, then the largest families of every view."""
    page = Page(
        f'Range of motion: {workspace.robot.name}',
        f'{workspace.postures:,} postures; tensions from {workspace.pretension:g} to '
        f'{workspace.limit:g} N in steps of {workspace.step:g} N',
    )
    if lacking := missing(workspace):
        page.box(lacking, 'warn')
    if workspace.families:
        page.table(rows(workspace), left=(1, 2))
    for view in workspace.views:
        families = workspace.of(view)
        if not families:
            continue
        page.heading(f'{degree(view)} view')
        if len(families) > Shown.FIGURES:
            page.text(f'The {Shown.FIGURES} of {len(families)} families with most postures.')
        for family in families[: Shown.FIGURES]:
            page.figures(view_figures(family), 'two')
    return page


def summary(volume: Volume) -> list[str]:
    """Summarise the result, a line for each finding."""
    reached, other = volume.reached, volume.frictionless
    why = ((volume.folded, 'run into themselves'), (volume.unsolved, 'have no equilibrium'))
    excluded = [f'{_percentage(n, volume.postures)} {what}' for n, what in why if n]
    low, high = volume.limits
    lines = [
        f'{volume.postures:,} postures over {len(volume.robot.inputs)} tendons from {low:g} to '
        f'{high:g} N{f"; left out: {listed(excluded)}" if excluded else ""}',
        f'tips within {_box(reached)}',
        f'they fill {_fill(reached)}, in cubes of {digits(1e3 * reached.edge)} mm; '
        f'their convex hull has {_size(reached, reached.hull[2])}',
    ]
    orientations = f'the tip turns up to {degree(volume.largest)} away from the base'
    if not reached.is_flat:
        orientations += f' and looks into {_percentage(volume.sphere, 1.0)} of all directions'
        parts = f'{digits(float(reached.looks.mean()))} of {SPHERE_PART_COUNT}'
        orientations += (
            '. With one section the place of the tip nearly fixes where it looks: the places of '
            'one view angle are a ring around the base'
            if bends_as_one(volume.robot)
            else f'; from one cube into {parts} equal parts of them (mean)'
        )
    lines.append(orientations)
    if other is not None:
        lost, given = (_percentage(part or 0.0, 1.0) for part in (volume.taken, volume.given))
        more = ': it bends more near the base, less farther out' if volume.given else ''
        lines.append(
            f'friction takes {lost} of the places that the same arm without friction reaches '
            f'({_fill(other)}); {given} of the places with friction lie beyond those{more}'
        )
    largest = f'the largest tip angle is {degree(volume.largest)}'
    for view, part in volume.views.items():
        reach = f'{degree(view)} view: {_box(part)}' if len(part) else ''
        lines.append(reach or f'no posture at {degree(view)}: {largest}')
    return [*lines, *_late(volume)]


def _percentage(part: float, whole: float) -> str:
    return f'{digits(100.0 * part / whole)} %'


def _box(reached: Reached) -> str:
    ranges = [
        f'{axis} {1e3 * low:.0f} to {1e3 * high:.0f}'
        for axis, low, high in zip('xyz', reached.lows, reached.highs, strict=True)
        if high - low > 1e-9
    ]
    return f'{", ".join(ranges)} mm'


def _size(reached: Reached, size: float) -> str:
    return f'{digits(1e4 * size, 3)} cm²' if reached.is_flat else f'{digits(1e6 * size, 3)} cm³'


def _fill(reached: Reached) -> str:
    """Describe the volume or area of the tips; for a surface in space cubes give no volume."""
    if reached.size < THIN_FRACTION * len(reached) * reached.edge ** (2 if reached.is_flat else 3):
        return 'a curve' if reached.is_flat else 'a thin shell'
    return _size(reached, reached.size)


def _late(volume: Volume) -> list[str]:
    if volume.late < LATE_MAX:
        return []
    return [
        f'NOT YET FULL: the last tenth of the postures found {_percentage(volume.late, 1.0)} of '
        'the cubes; ask for more --postures or larger --cubes'
    ]


def volume_page(volume: Volume) -> Page:
    """Return the page: what came out, the cloud, sections through it."""
    page = Page(f'Reachable tips: {volume.robot.name}', 'all tendons at once')
    lines = summary(volume)
    late = _late(volume)
    page.box(lines[: len(lines) - len(late)], 'found')
    if late:
        page.box(late, 'warn')
    if not volume.reached.is_flat:
        page.figures([cloud_figure(volume)])
    page.heading('Sections')
    values, title = _values(volume)
    across = (1,) if volume.reached.is_flat else (1, 2)
    cuts = [section_figure(volume, values, title, axis) for axis in across]
    page.figures(cuts, 'two' if len(cuts) > 1 else '')
    for view, part in volume.views.items():
        if len(part):
            page.heading(f'{degree(view)} view')
            page.figures([direction_figure(part, view)])
    page.text(
        'Collisions with anything but the arm itself are not known here. Every place is that of '
        'the posture with the lowest highest tension found; `workspace.npz` has all of them.'
    )
    return page


def _values(volume: Volume) -> tuple[Floats, str]:
    """Return the values (c,) that colour the cubes, and their title."""
    if volume.reached.is_flat or bends_as_one(volume.robot):
        return volume.reached.tensions.max(axis=1), 'highest<br>tension [N]'
    return volume.reached.looks.astype(float), f'directions<br>of {SPHERE_PART_COUNT}'


def scene() -> Trace:
    """Return the layout of a scene in space, at one scale."""
    named = {f'{axis}axis': titled(f'{axis} [mm]') for axis in 'xyz'}
    box = {'aspectmode': 'data', 'camera': {'eye': {'x': 1.8, 'y': 1.8, 'z': 0.9}}, **named}
    legend = {'orientation': 'h', 'itemsizing': 'constant', 'y': 1.0, 'x': 0.0}
    return {'scene': box, 'legend': legend, 'margin': {'l': 0, 'r': 0, 't': 0, 'b': 0}}


def in_space(points: Floats, mode: str, name: str, **more: Any) -> Trace:
    """Return what is drawn of points (n, 3) [m] in a scene."""
    return {'type': 'scatter3d', **placed(points, mode, name, **more)}


def cloud_figure(volume: Volume) -> Figure:
    """Tips at the outside of what is reached, the hull, and the straight arm."""
    reached, inputs = volume.reached, volume.robot.inputs
    values, title = _values(volume)
    outside = np.flatnonzero(reached.outside)
    rows = outside[evenly(len(outside), Shown.CLOUD_POINTS)]
    pulled = [
        ', '.join(f'{name} {digits(value)} N' for name, value in zip(inputs, row, strict=True))
        for row in reached.tensions[rows].tolist()
    ]
    marker = {
        'size': 2.5,
        'color': [float(f'{value:.3g}') for value in values[rows]],
        'colorscale': SCALE,
        'colorbar': titled(title, thickness=12, len=0.6),
    }
    tips = in_space(reached.tips[rows], 'markers', 'tips at the outside', marker=marker)
    tips |= {'text': pulled, 'hoverinfo': 'x+y+z+text'}
    corners, faces, _ = reached.hull
    hull = {
        'type': 'mesh3d',
        'name': 'convex hull',
        **{axis: plain(corners[:, i], 1e3) for i, axis in enumerate('xyz')},
        **{axis: faces[:, i].tolist() for i, axis in enumerate('ijk')},
        'color': PREDICTED,
        'opacity': 0.12,
        'hoverinfo': 'skip',
        'showlegend': True,
    }
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, volume.robot.length]])
    arm = in_space(ends, 'lines', 'the straight arm', line={'color': INK, 'width': 8})
    caption = (
        f'{len(rows):,} of {len(reached):,} cubes, each with the posture of least tension. '
        'Drag to turn; a point tells the tensions.'
    )
    return Figure([tips, hull, arm], scene(), 'Where the tip can be', caption, height=560)


def section_figure(volume: Volume, values: Floats, title: str, axis: int) -> Figure:
    """Cut through the cubes across y (axis 1) or z (2); a slider moves the cut."""
    reached, other = volume.reached, volume.frictionless
    across, up = (0, 2) if axis == 1 else (0, 1)
    cells = np.concatenate([part.cells for part in (reached, other) if part is not None])
    low, high = cells.min(axis=0), cells.max(axis=0)
    places = np.unique(np.linspace(low[axis], high[axis], Shown.SLICES).round().astype(int))
    middle = int(np.argmin(np.abs(places - (0 if axis == 1 else (low[2] + high[2]) // 2))))
    frame = (low[[across, up]], high[[across, up]], reached.edge)
    grey = {'colorscale': [[0.0, GREY], [1.0, GREY]], 'showscale': False, 'hoverinfo': 'skip'}
    bar = titled(title, thickness=12)
    shown = {'colorscale': SCALE, 'zmin': 0.0, 'zmax': float(values.max()), 'colorbar': bar}
    parts = [(reached, values, shown)]
    if other is not None:  # below it
        parts.insert(0, (other, np.ones(len(other)), grey))
    data: list[dict[str, Any]] = []
    for i, place in enumerate(places):
        for part, heights, colours in parts:
            in_slice = part.cells[:, axis] == place
            cut = heat_map(frame, part.cells[in_slice][:, [across, up]], heights[in_slice])
            data.append({**cut, 'visible': i == middle, **colours})
    name, other_name = 'xyz'[up], 'xyz'[axis]
    x, y = titled('x [mm]', constrain='domain'), titled(f'{name} [mm]', scaleanchor='x')
    layout = axes(x, y)
    if len(places) > 1:
        steps = []
        for i, place in enumerate(places.tolist()):
            shown_now = [k // len(parts) == i for k in range(len(data))]
            label = f'{1e3 * (place + 0.5) * reached.edge:.0f}'
            steps.append({'label': label, 'method': 'restyle', 'args': ['visible', shown_now]})
        current = {'prefix': f'{other_name} = ', 'suffix': ' mm', 'font': {'size': 13}}
        slider = {'active': middle, 'steps': steps, 'currentvalue': current, 'pad': {'t': 36}}
        layout['sliders'] = [slider]
        layout['margin'] = {'l': 56, 'r': 16, 't': 12, 'b': 90}
    caption = 'Grey: reached without friction only.' if other is not None else ''
    plane = 'x-z' if axis == 1 else 'x-y'
    return Figure(data, layout, f'Section along the {plane} plane', caption, height=Shown.SCENE)


def heat_map(frame: tuple[Ints, Ints, float], cells: Ints, values: Floats) -> Trace:
    """Return a picture of cubes (c, 2) in a plane; what none fills stays empty."""
    low, high, edge = frame
    shape = high - low + 1
    grid = np.full((shape[1], shape[0]), np.nan)
    grid[cells[:, 1] - low[1], cells[:, 0] - low[0]] = values
    middles = [plain((np.arange(low[i], high[i] + 1) + 0.5) * edge, 1e3) for i in range(2)]
    return {
        'type': 'heatmap',
        'x': middles[0],
        'y': middles[1],
        'z': [
            [None if np.isnan(value) else float(f'{value:.3g}') for value in row]
            for row in grid.tolist()
        ],
        'hovertemplate': 'x %{x} mm, %{y} mm: %{z}<extra></extra>',
    }


def direction_figure(part: Reached, view: float) -> Figure:
    """Tips that look at an angle, and which way."""
    rows = evenly(len(part), Shown.CLOUD_POINTS)
    length = Shown.DIRECTION_FRACTION * part.robot.length
    tips, ends = part.tips[rows], part.tips[rows] + length * part.directions[rows]
    lines = np.stack([tips, ends, np.full_like(tips, np.nan)], axis=1).reshape(-1, 3)
    marker, line = {'size': 2.5, 'color': PREDICTED}, {'color': ERROR, 'width': 2}
    data = [
        in_space(tips, 'markers', 'tips', marker=marker),
        in_space(lines, 'lines', 'where they look', line=line, hoverinfo='skip'),
    ]
    caption = f'{len(part):,} cubes whose tips look {degree(view)} away from the base.'
    return Figure(data, scene(), '', caption, height=Shown.TALL)
