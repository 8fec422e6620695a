"""
The palette: colours that colour-blind readers tell apart, with lines and symbols.

After Okabe and Ito 2008 and Tol 2021, darkened until they stand out: all by 3 : 1 on white, those
of words by 4.5 : 1 (WCAG 2.2; test_common.py computes it).
"""

from __future__ import annotations

from typing import NamedTuple

MEASURED, PREDICTED, ERROR = '#d55e00', '#0072b2', '#5f6974'  # on every page, picture and in RViz
BEFORE, HELD_OUT = MEASURED, MEASURED  # errors: of the model as described, of left-out postures
INK = '#1b1f24'
BAND = 'rgba(120, 130, 140, 0.25)'
FLOOR = ERROR
GOOD, WARN, BAD = '#00805c', '#a05f00', '#b3261e'
ORANGE = '#b34700'  # dark enough for what was measured in words, and under white words
KINDS = {'found': PREDICTED, 'good': GOOD, 'warn': WARN, 'bad': BAD}  # of boxes and verdicts
REST, LEFT_OUT = '#7f8a95', '#aa0066'  # of a recording: still, but not a measurement; cut out
# of models, one after the other; the colour of what was measured is not among them
COLOURS = (PREDICTED, GOOD, '#aa4499', '#767618', '#332288', INK)
DASHES = ('solid', 'dash', 'dot', 'dashdot', 'longdash', 'longdashdot')
STROKES = ('', '9 4', '3 3', '9 3 3 3', '14 4', '14 4 3 4')  # the same in SVG
SYMBOLS = ('circle-open', 'triangle-up-open', 'square-open', 'diamond-open', 'cross', 'x')
# of signed values: blue below, white at zero, orange above
_BELOW_TO_ABOVE = ('#0b5394', '#6fa8dc', '#ffffff', '#f0a75a', ORANGE)
# [1] places of these colours, even, so that zero is white
DIVERGING = [[i / (len(_BELOW_TO_ABOVE) - 1), c] for i, c in enumerate(_BELOW_TO_ABOVE)]


class LineStyle(NamedTuple):
    """How one model is drawn everywhere."""

    colour: str
    dash: str
    stroke: str
    symbol: str


def line_style(index: int) -> LineStyle:
    """Return how the model at an index of the list is drawn."""
    i = index % len(COLOURS)
    return LineStyle(COLOURS[i], DASHES[i], STROKES[i], SYMBOLS[i])


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue (0 to 255) of a colour `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour.removeprefix('#'))
    return red, green, blue
