"""Pieces of the live page: bars, curves and tables as HTML and SVG; an arm as a tube."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Floats
from ...common.colours import BAD, ERROR, GOOD, INK, KINDS, MEASURED, PREDICTED, WARN, rgb
from ...common.words import digits, mm
from ...report.page import marked
from .state import CURVE_SPAN_S, ViewState

Floats32 = NDArray[np.float32]
# [1] so that the predicted arm, which is thinner, is visible inside the measured one
MEASURED_OPACITY = 0.4
SIDES = 12  # [1] of the cross-section of a tube: with fewer it would have visible edges
FITTING = 'fitting '  # its duration is unknown: the bar is indeterminate
STOP_MARK = 'stop-mark'  # id of the element before the button that is always visible
HIDDEN = 'position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)'
STYLE = f'font-family:system-ui,sans-serif;font-size:13px;color:{INK};padding:2px 12px'


# On a narrow screen viser places its panel as a strip over the lower right of the scene; here it
# is below the arm, over the whole width, and STOP (the button after its mark) stays at the upper
# edge. Notifications of viser disappear by themselves.
NARROW = f"""<style>
@keyframes gone {{ to {{ visibility: hidden }} }}
.mantine-Notification-root {{ animation: gone 0s 12s forwards }}
@media (max-width: 36em) {{
  div[style*="max-height: 60%"] {{ left: 0; width: 100% !important }}
  div[style*="max-height: 60%"] div[style*="width: 20em"] {{ width: 100% !important }}
  div:has(> #{STOP_MARK}) + div {{ position: fixed; top: 8px; right: 8px; width: 96px;
    z-index: 20 }}
}}
</style>"""


def legend(square: float) -> str:
    """Return the legend of the colours and of the grid, whose squares have a side [m]."""
    line = '<span style="display:inline-block;width:22px;border-top:{} {}"></span> {}'
    translucent = f'rgba{(*rgb(MEASURED), MEASURED_OPACITY)}'
    return (
        f'{NARROW}<div style="{STYLE}">'
        + line.format('10px solid', translucent, 'measured &nbsp; ')
        + line.format('4px solid', PREDICTED, 'predicted &nbsp; ')
        + line.format('2px dashed', ERROR, 'error')
        + f'<br><span id="scale">a square of the grid: {1e3 * square:g} mm</span>'
        + '</div>'
    )


def scene(measured: Floats, predicted: Floats) -> str:
    """Return a description of the arms (J, 3) [m] in the scene, for screen readers."""
    tips, text = [], 'Scene in space: the arm stands on a grid, its base at the origin, z up'
    for who, arm in (('measured', measured), ('predicted', predicted)):
        visible = arm[np.isfinite(arm).all(axis=1)]
        where = 'not there yet'
        for x, y, z in 1e3 * visible[-1:]:
            where = f'tip at x {x:.0f}, y {y:.0f}, z {z:.0f} mm'
        tips += list(visible[-1:])
        text += f'; {who} arm: {where}'
    if len(tips) == 2:
        text += f'; {mm(float(np.linalg.norm(tips[0] - tips[1])), 2)} apart'
    return f'<div role="img" aria-label="{escape(text)}" style="{HIDDEN}"></div>'


def guide(next_step: str, progress: str) -> str:
    """Return the next step, and below it the last progress."""
    percentage = re.search(r'\((\d+) %', progress)
    how_far = f'value="{percentage[1]}" max="100" ' if percentage else ''
    bar = (
        f'<progress {how_far}aria-label="{escape(progress)}" '
        f'style="width:100%;accent-color:{PREDICTED}"></progress>'
        if percentage or progress.startswith(FITTING)
        else ''
    )
    return (
        f'<div style="{STYLE}"><p id="guide" role="status" style="margin:2px 0;font-size:14px">'
        f'<b>{escape(next_step)}</b></p>'
        f'<p id="progress" style="margin:2px 0;color:{ERROR}">{escape(progress)}</p>{bar}</div>'
    )


def big_error(rolling: float, tip: str) -> str:
    """Return the tip error [m] in large type, and a line about the markers."""
    shown = mm(rolling, 2) if np.isfinite(rolling) else '–'
    return (
        f'<div style="{STYLE}">off by <b id="tip-error" style="font-size:24px">{shown}</b> '
        f'at the tip <br><span style="color:{ERROR}">{escape(tip)}</span></div>'
    )


def curve(state: ViewState, now: float) -> str:
    """Return a plot of the rolling error over the last two minutes, up to now [s]."""
    recent = [(now - at, 1e3 * error) for at, error in state.curve if np.isfinite(error)]
    shown = [(age, error) for age, error in recent if age <= CURVE_SPAN_S]
    sizes = [e for _, e in shown] or [0.0]
    # twice the upper quartile: larger peaks come from moves, and the error at rest would else be a
    # flat line
    usual = 2.0 * float(np.quantile(sizes, 0.75))
    axes = _Axes(max(1.15 * min(max(sizes), usual), 0.6))
    points = ' '.join(f'{axes.x(age):.1f},{axes.y(min(e, axes.top)):.1f}' for age, e in shown)
    cut = f', peaks up to {digits(max(sizes), 2)} are cut off' if max(sizes) > axes.top else ''
    parts = [*axes.grid(state.verdict.get('noise_floor'))]
    parts.append(f'<polyline points="{points}" fill="none" stroke="{MEASURED}" stroke-width="2"/>')
    for at, text in state.marks:  # when an effect was added
        if (age := now - at) <= CURVE_SPAN_S:
            parts.append(
                f'<path d="M{axes.x(age):.1f} 4V{axes.base + 4}" stroke="{PREDICTED}" '
                f'stroke-width="2" stroke-dasharray="5 3"/><text x="{axes.x(age) - 4:.1f}" y="16" '
                f'text-anchor="end" fill="{PREDICTED}">added {escape(text)}</text>'
            )
    return (
        f'<div style="{STYLE}">tip error [mm]{cut}<svg viewBox="0 0 {axes.width} {axes.height}" '
        f'role="img" aria-label="tip error of the last two minutes, now {digits(sizes[-1])} mm" '
        f'style="width:100%;font-size:12px;overflow:visible">'
        f'{"".join(parts)}</svg></div>'
    )


@dataclass(frozen=True)
class _Axes:
    """The axes of the curve: its place on the page [px]; `top` is the largest error [mm]."""

    top: float
    width: int = 360
    height: int = 140
    left: int = 40  # width of the numbers
    base: int = 118  # height above the labels of time

    def x(self, age: float) -> float:
        """Return the abscissa [px] of an age [s]."""
        return self.left + (self.width - self.left) * max(1.0 - age / CURVE_SPAN_S, 0.0)

    def y(self, error: float) -> float:
        """Return the ordinate [px] of an error [mm]."""
        return self.base * (1.0 - error / self.top) + 4

    def grid(self, floor: float | None) -> Iterator[str]:
        """Yield the grid, and the noise floor [m] as a band."""
        zero = self.y(0.0)
        if floor is not None and np.isfinite(floor):
            band = zero - self.y(min(1e3 * floor, self.top))
            yield (
                f'<rect x="{self.left}" y="{zero - band:.1f}" width="{self.width - self.left}" '
                f'height="{band:.1f}" fill="{ERROR}" opacity="0.25"/>'
                f'<text x="{self.left + 4}" y="{zero - 4:.1f}" fill="{INK}" '
                'stroke="#fff" stroke-width="3" paint-order="stroke">repeatability</text>'
            )
        step = round_length(self.top / 2.0)
        for i in range(int(self.top / step) + 1):
            tick = self.y(i * step)
            yield (
                f'<path d="M{self.left} {tick:.1f}H{self.width}" stroke="#e0e4e8"/><text '
                f'x="{self.left - 5}" y="{tick + 4:.1f}" text-anchor="end">'
                f'{round(i * step, 6):g}</text>'
            )
        below = f'y="{self.height - 4}"'
        yield f'<text x="{self.width}" {below} text-anchor="end">now</text>'
        yield f'<text x="{self.left}" {below}>2 minutes ago</text>'


def bars(names: Sequence[str], tensions: Sequence[float], low: float, high: float) -> str:
    """Return bars of the tensions [N] between their limits."""
    rows = []
    for name, value in zip(names, tensions, strict=True):
        known = bool(np.isfinite(value))
        fraction = min(max(value / high, 0.0), 1.0) if known else 0.0
        at_limit = known and (value >= 0.99 * high)
        colour, note = (MEASURED, ' at its limit') if at_limit else (PREDICTED, '')
        reading = f'{value:.2f} N{note}' if known else 'not observable'
        rows.append(
            f'<tr><td>{escape(name)}</td><td style="width:55%"><div style="position:relative;'
            'background:#e6e9ed;height:12px;border-radius:3px">'
            f'<div style="background:{colour};width:{100 * fraction:.1f}%;height:12px;'
            'border-radius:3px"></div>'
            f'<div title="lower limit" style="position:absolute;left:{100 * low / high:.1f}%;'
            f'top:-2px;width:2px;height:16px;background:{INK}"></div></div></td>'
            f'<td style="text-align:right;white-space:nowrap">{reading}</td></tr>'
        )
    return (
        f'<div style="{STYLE}">tensions, limits {low:g} to {high:g} N'
        f'<table style="width:100%">{"".join(rows)}</table></div>'
    )


def verdict(diagnosis: Mapping[str, Any], count: int = 6) -> str:
    """Return verdict, remainder and the best candidates of a diagnosis."""
    if not diagnosis:
        return ''
    sentences = '\n'.join(str(diagnosis.get(key) or '') for key in ('sentence', 'remainder'))
    rows = [
        f'<tr><td>{escape(name)}</td><td>{escape(values)}</td><td style="text-align:right">'
        f'{escape(explains)}<br><small>{escape(status)}</small></td></tr>'
        for name, explains, *_, status, values in diagnosis.get('rows', [])[:count]
    ]
    head = '<tr><th>effect</th><th>value</th><th>explains</th></tr>' if rows else ''
    colour = KINDS.get(str(diagnosis.get('colour')), PREDICTED)
    lines = filter(None, sentences.split('\n'))
    paragraphs = ''.join(f'<p style="margin:4px 0">{marked(line)}</p>' for line in lines)
    return (
        f'<div id="verdict" style="{STYLE};overflow-x:auto"><div style="border-left:4px solid '
        f'{colour};padding-left:8px">{paragraphs}</div><table id="candidates" '
        'style="font-size:12px;text-align:left;border-spacing:6px 1px">'
        f'{head}{"".join(rows)}</table></div>'
    )


def investigation(news: Sequence[Mapping[str, Any]]) -> str:
    """Return the diagnoses and the present step of an investigation."""
    if not news:
        return ''
    rows = ''.join(
        f'<tr><td style="text-align:right">{one["postures"]}</td>'
        f'<td>{escape(str(one["text"]).split(": ", 1)[-1])}</td></tr>'
        for one in news
        if one.get('kind') in ('changed', 'diagnosis')
    )
    head = '<tr><th>postures</th><th>diagnosis</th></tr>' if rows else ''
    return (
        f'<div id="investigation" style="{STYLE}"><b>the arm finds out by itself</b>'
        f'<p style="margin:2px 0">{escape(str(news[-1]["text"]))}</p>'
        f'<table style="font-size:12px;text-align:left;border-spacing:6px 1px">{head}{rows}'
        '</table></div>'
    )


def statuses(nodes: Mapping[str, tuple[str, str]]) -> str:
    """Return the statuses of the nodes: name -> (level, sentence)."""
    colours = {'ok': GOOD, 'warn': WARN, 'error': BAD, 'silent': ERROR}
    signs = {'ok': '●', 'warn': '▲', 'error': '■', 'silent': '○'}
    rows = ''.join(
        f'<div><span style="color:{colours[level]}">{signs[level]}</span> <b>{escape(name)}</b> '
        f'{escape(text)}</div>'
        for name, (level, text) in nodes.items()
    )
    return f'<div style="{STYLE}">{rows}</div>'


def round_length(length: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... up to a length [m], or [mm]."""
    power = 10.0 ** math.floor(math.log10(length))
    return power * next(step for step in (5.0, 2.0, 1.0) if step * power <= 1.0001 * length)


def tube_faces(nodes: int) -> NDArray[np.uint32]:
    """Return the triangles (2 SIDES (nodes - 1), 3) between the rings around so many nodes."""
    ring, side = np.meshgrid(np.arange(nodes - 1), np.arange(SIDES), indexing='ij')
    a = ring * SIDES + side
    b = ring * SIDES + (side + 1) % SIDES
    quads = np.stack([a, b, b + SIDES, a, b + SIDES, a + SIDES], axis=-1)
    return quads.reshape(-1, 3).astype(np.uint32)


def tube_vertices(nodes: Floats, radius: float) -> Floats32:
    """
    Return rings (n SIDES, 3) of a radius around nodes (n, 3), n > 1, all in the same unit.

    The tube has no twist: the first point of a ring is that of the ring before, projected into the
    plane of the ring.
    """
    along = np.gradient(nodes, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    start = np.eye(3)[np.abs(along[0]).argmin()]
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    across = np.empty(nodes.shape)
    for i, axis in enumerate(along):
        start = start - axis * (start @ axis)
        start = start / max(math.sqrt(start @ start), 1e-12)
        across[i] = start
    up = np.cross(along, across)
    circles = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * up[:, None]
    return np.asarray(nodes[:, None] + radius * circles, dtype=np.float32).reshape(-1, 3)
