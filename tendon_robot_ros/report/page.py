"""A self-contained HTML page: text, boxes, tables and figures; it opens without a network."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from itertools import zip_longest
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.colours import ERROR, INK, KINDS, LineStyle
from ..common.errors import of_extra
from ..common.files import write_text

Trace = dict[str, Any]  # what plotly draws, or a part of its layout
Along = Sequence[Any]  # along an axis: numbers, None, names or times
FOLDER = Path(__file__).parent
KEYS = 'Tab comes here, arrow keys show the next.'
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif'


def plain(values: npt.ArrayLike, scale: float = 1.0, places: int = 4) -> list[float | None]:
    """Return numbers (n,) times a scale, rounded; None for NaN."""
    array = np.round(np.asarray(values, dtype=float) * scale, places)
    return [float(value) if np.isfinite(value) else None for value in array]


def mm_list(metres: npt.ArrayLike) -> list[float | None]:
    """Return lengths in mm."""
    return plain(metres, 1e3)


def error_bars(
    up: Sequence[float | None], down: Sequence[float | None] | None = None, width: int = 2
) -> dict[str, Any]:
    """Return bars of so much above and below, else of the same size, as plotly draws them."""
    bars: dict[str, Any] = {'type': 'data', 'array': up, 'thickness': 1, 'width': width}
    return bars if down is None else bars | {'symmetric': False, 'arrayminus': down}


def titled(title: str, **more: Any) -> Trace:
    """Return an axis with a title."""
    return {'title': {'text': title}, **more}


def axes(x: str | Trace, y: str | Trace, **layout: Any) -> Trace:
    """Return a layout of two axes, each a title or as plotly takes it."""
    both = {'xaxis': x, 'yaxis': y}
    named = {key: titled(axis) if isinstance(axis, str) else axis for key, axis in both.items()}
    return {**named, **layout}


def trace(x: Along, y: Along, name: str, mode: str = 'lines', **more: Any) -> Trace:
    """Return what is drawn of x and y, as lines, markers or both; its name is escaped."""
    return {'x': x, 'y': y, 'name': escape(name), 'mode': mode, **more}


def placed(points: Floats, mode: str, name: str, **more: Any) -> Trace:
    """Return what is drawn of points (n, 3) [m], in mm; its name is escaped."""
    places = {axis: mm_list(points[:, i]) for i, axis in enumerate('xyz')}
    return {**places, 'mode': mode, 'name': escape(name), **more}


def from_the_side(drawn: Trace) -> Trace:
    """Return what is drawn of points in space as seen along y."""
    rest = {key: value for key, value in drawn.items() if key not in ('z', 'type')}
    return {**rest, 'y': drawn['z']}


def curve(
    x: Along, y: Along, name: str, style: LineStyle, width: float = 2.0, size: int = 0, **more: Any
) -> Trace:
    """Draw a curve in the line style of a model; with symbols of a size [px], if any."""
    line = {'color': style.colour, 'dash': style.dash, 'width': width}
    if size:
        more = {'marker': {'symbol': style.symbol, 'size': size}, **more}
    return trace(x, y, name, 'lines+markers' if size else 'lines', line=line, **more)


class Shown:
    """How pictures are drawn, and how many of a kind at most; others are in tables and files."""

    # [1] of the length of an arm: shapes that leave the x-z plane by less are drawn as flat,
    # because another view would show a line
    FLAT_FRACTION = 0.03
    # [1] of the arm's length, lines that show where tips look: short, so that they do not cross
    DIRECTION_FRACTION = 0.08
    # [1] noise sd between which the largest deviation must lie for colours to end there, so that
    # noise stays pale and one wild posture does not take the colour off all others
    COLOURS_END_SD = (4.0, 30.0)
    # [1] noise floors of an error above which the floor would lie on the zero line: 15 px
    LOG_AXIS_FROM_FLOORS = 25.0

    # ticks at 1, 2, 5 of a decade: plotly's own are too many on a narrow screen
    LOG_AXIS: ClassVar[Trace] = {'type': 'log', 'dtick': 'D2', 'tickformat': '~r'}
    # [px] heights, so that two rows fit on a screen and a shape keeps its proportions
    LOW, NORMAL, TALL, SCENE = 280, 360, 460, 520

    FIGURES = 4  # of a kind: two rows, so that the next heading is seen
    POSTURES = 12  # as pictures, so that the page opens at once
    LOOP = 32  # postures of a sequence in a picture, so that one loop or two are seen apart
    OWN_BOXES = 6  # postures with boxes of their own, else these are too thin
    BOX_POINTS = 200  # trials beside their box, else they cover it
    MARKERS = 4  # with a number of their own, else a row of the table does not fit
    READINGS = 6  # that are named one by one, so that the line is read
    WORST = 3  # postures that are named, so that the line is read
    NAME = 40  # letters of a posture in a menu: what a phone shows
    STEP_NAME = 22  # letters in a line below a curve, else names take half of its height
    ROWS = 30  # of a printed table: a screen
    MARKED_ROWS = 60  # of a path, else marks hide it
    ARROWS = 15  # directions along a path, so that they do not cross
    DRAWN_POINTS = 2_000  # of a flat figure: a phone still draws them
    CLOUD_POINTS = 12_000  # of a scene in space: a phone still turns them
    SLICES = 31  # places of a slider: each is a picture in the page


@dataclass(frozen=True)
class Figure:
    """A figure: plotly's data and layout as plain values, with what stands around it."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    title: str = ''
    caption: str = ''
    height: int = Shown.NORMAL

    def html(self) -> str:
        """Return the figure as a part of a page; page.js draws what it holds."""
        lines = {'gridcolor': '#e6e9ed', 'linecolor': ERROR, 'zerolinecolor': '#c3cad2'}
        layout = {
            'font': {'family': FONT, 'size': 13, 'color': INK},
            'margin': {'l': 56, 'r': 16, 't': 12, 'b': 44},
            'paper_bgcolor': 'white',
            'plot_bgcolor': 'white',
            'hovermode': 'closest',
            'height': self.height,
            'legend': {'orientation': 'h', 'y': 1.02, 'yanchor': 'bottom', 'x': 0.0},
            **self.layout,
        }
        for name in ('xaxis', 'yaxis'):
            layout[name] = {**lines, 'automargin': True, **layout.get(name, {})}
        drawn = {'data': self.data, 'layout': layout}
        content = json.dumps(drawn, allow_nan=False, separators=(',', ':'))
        content = content.replace('<', '\\u003c')
        title = f'<p class="title">{escape(self.title)}</p>' if self.title else ''
        chosen = {'sliders', 'updatemenus'} & set(self.layout)  # page.js handles the keys
        words = ' '.join(filter(None, [self.caption, KEYS if chosen else '']))
        axes = [layout[axis].get('title', {}).get('text', '') for axis in ('yaxis', 'xaxis')]
        named = self.title or ' over '.join(filter(None, axes)) or 'figure'
        alt = ' '.join([named, words]).strip()
        caption = f'<figcaption>{escape(words)}</figcaption>' if words else ''
        role = 'role="application" tabindex="0"' if chosen else 'role="img"'
        return (
            f'<figure>{title}<div class="plot" {role} aria-label="{escape(alt)}" '
            f'style="height:{self.height}px"></div>'
            f'<script type="application/json">{content}</script>{caption}</figure>'
        )


@dataclass
class Page:
    """A page under construction; all text is escaped, `code` stands between backticks."""

    title: str
    subtitle: str = ''
    parts: list[str] = field(default_factory=list)

    def heading(self, text: str) -> None:
        """Begin a section."""
        self.parts.append(f'<h2>{escape(text)}</h2>')

    def text(self, *paragraphs: str) -> None:
        """Add paragraphs."""
        self.parts += [f'<p>{marked(paragraph)}</p>' for paragraph in paragraphs]

    def box(self, lines: Iterable[str], kind: str = '', title: str = '') -> None:
        """Add a box; kinds: verdict, those of `common.colours.KINDS`, and both together."""
        head = f'<p class="title">{escape(title)}</p>' if title else ''
        body = ''.join(f'<p>{marked(line)}</p>' for line in lines)
        self.parts.append(f'<div class="box {escape(kind)}">{head}{body}</div>')

    def table(
        self, rows: Sequence[Sequence[str]], kinds: Sequence[str] = (), left: Sequence[int] = ()
    ) -> None:
        """Add a table, head first; other rows may be 'strong' or 'faint', columns `left` words."""
        head, *below = rows
        sides = ['left' if i in left else '' for i in range(len(head))]
        # wide tables are scrolled by keyboard; roles stay where page.css folds rows to blocks
        label = escape(f'table of {head[0]}' if head[0] else 'table')
        region = f'<div class="scroll" tabindex="0" role="region" aria-label="{label}">'
        body = [
            _row('td', row, sides, kind or '', head)
            for row, kind in zip_longest(below, kinds[: len(below)])
        ]
        names = _row('th', head, sides, 'head')
        self.parts += [f'{region}<table role="table">', names, *body, '</table></div>']

    def figures(self, figures: Sequence[Figure], across: str = '') -> None:
        """Add figures; `across`: 'two' or 'many' beside each other where there is room."""
        drawn = ''.join(figure.html() for figure in figures)
        self.parts.append(f'<div class="figures {escape(across)}">{drawn}</div>')

    def key(self, entries: Sequence[tuple[str, str]]) -> None:
        """Add a legend that several figures share: (SVG of the symbol, name)."""
        spans = ''.join(f'<span>{svg}{escape(name)}</span>' for svg, name in entries)
        self.parts.append(f'<div class="key">{spans}</div>')

    def html(self) -> str:
        """
        Return the whole page.

        Raises
        ------
        MissingExtraError
            plotly is not installed.

        """
        colours = ' '.join(f'--{key}: {value};' for key, value in {'ink': INK, **KINDS}.items())
        style = f':root {{ {colours} }}\n{(FOLDER / "page.css").read_text(encoding="utf-8")}'
        script = (FOLDER / 'page.js').read_text(encoding='utf-8')
        subtitle = f'<p class="subtitle">{escape(self.subtitle)}</p>' if self.subtitle else ''
        body = '\n'.join(self.parts)
        return (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<link rel="icon" href="data:,">\n'
            f'<title>{escape(self.title)}</title>\n<style>\n{style}</style>\n'
            f'<script>{plotly_source()}</script></head>\n'
            f'<body><main><h1>{escape(self.title)}</h1>\n{subtitle}\n{body}\n'
            f'</main><script>\n{script}</script></body></html>\n'
        )

    def write(self, path: str | Path) -> Path:
        """Write the page; a file that was there is replaced at the end."""
        write_text(path, self.html())
        return Path(path)


@cache
def plotly_source() -> str:
    """Return plotly's JavaScript, which every page carries inside."""
    return str(of_extra('report', 'plotly.offline').get_plotlyjs())


def symbol(colour: str, dash: str = '', dot: bool = False) -> str:
    """Draw the symbol of a legend: a line, or a dot."""
    pattern = f' stroke-dasharray="{dash}"' if dash else ''
    inside = f'<path d="M1 6H27" stroke="{colour}" stroke-width="3"{pattern}/>'
    if dot:
        inside = f'<circle cx="14" cy="6" r="4" fill="{colour}"/>'
    return f'<svg width="28" height="12" aria-hidden="true">{inside}</svg>'


def marked(text: str) -> str:
    """Escape a text; what stands between backticks becomes code."""
    return re.sub('`([^`]*)`', r'<code>\1</code>', escape(text))


def _row(
    tag: str, cells: Sequence[str], sides: Sequence[str], kind: str, names: Sequence[str] = ()
) -> str:
    """Return a row; on a narrow screen every cell stands below its name."""
    labels = [f' data-name="{escape(name)}"' for name in names] or [''] * len(cells)
    role = 'role="columnheader" scope="col"' if tag == 'th' else 'role="cell"'
    content = ''.join(
        f'<{tag} {role} class="{side}"{label}>{escape(cell)}</{tag}>'
        for cell, side, label in zip(cells, sides, labels, strict=True)
    )
    return f'<tr role="row" class="{escape(kind)}">{content}</tr>'
