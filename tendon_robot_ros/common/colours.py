"""Colours that colour-blind readers tell apart (Okabe and Ito 2008), with lines and symbols."""

from __future__ import annotations

from dataclasses import dataclass

MEASURED, PREDICTED, ERROR = '#d55e00', '#0072b2', '#6b7580'  # on every page, picture and in RViz
INK = '#1b1f24'
BAND = 'rgba(120, 130, 140, 0.25)'
FLOOR = ERROR
GOOD, WARN, BAD = '#009e73', '#e69f00', '#d55e00'
KINDS = {'found': PREDICTED, 'good': GOOD, 'warn': WARN, 'bad': BAD}  # of boxes and verdicts
# of models, one after the other; the colour of what was measured is not among them
COLOURS = (PREDICTED, GOOD, '#cc79a7', WARN, '#56b4e9', INK)
DASHES = ('solid', 'dash', 'dot', 'dashdot', 'longdash', 'longdashdot')
STROKES = ('', '9 4', '3 3', '9 3 3 3', '14 4', '14 4 3 4')  # the same in SVG
SYMBOLS = ('circle-open', 'triangle-up-open', 'square-open', 'diamond-open', 'cross', 'x')
# signed values: blue below, white at zero, orange above
DIVERGING = [[0.0, '#0b5394'], [0.25, '#6fa8dc'], [0.5, '#ffffff'], [0.75, '#f0a75a'],
             [1.0, '#b34700']]  # fmt: skip


@dataclass(frozen=True)
class Look:
    """How one model is drawn everywhere."""

    colour: str
    dash: str
    stroke: str
    symbol: str


def look(index: int) -> Look:
    """Return the look of the model at a place in the list."""
    i = index % len(COLOURS)
    return Look(COLOURS[i], DASHES[i], STROKES[i], SYMBOLS[i])


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue (0 to 255) of a colour `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour.removeprefix('#'))
    return red, green, blue
