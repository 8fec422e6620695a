"""
Draw what every effect does to a shape, and begin its section in docs/effects.md.

python tools/effects_page.py

That page, with its equations and how to tell effects apart, is written by hand. `make docs` makes
the reference of the effects of what is here. test/test_docs_effects.py holds page and pictures.
"""

import inspect
import json
import re
import sys

import numpy as np
from effect_shapes import (
    CATALOGUE,
    LOADED,
    POSTURES,
    ROBOT,
    ROOT,
    SETS,
    SIZES,
    by_pulls,
    drawn,
    look_alikes,
)
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tendon_robot_ros.report.sentences import described_quantity

PAGE = ROOT / 'docs' / 'effects.md'
PICTURES = ROOT / 'docs' / 'images' / 'effects'
HEAD = """\
# Reference of the effects

What each effect is: [the effects](../effects.md). All figures are those of the 10:1 arm of the
paper (`config/robots/kato_10_1.yaml`: two sections, 208 mm, standing upright). Bounds and typical
sizes follow the length, stiffness and limits of a robot.
"""
ALIKE = """\
How much of what an effect does one other effect alone can do, in percent of the rms over all
cells and postures, for small sizes, where it is 75 % or more. 100 % cannot be told apart. *One
tendon*: twelve postures with one tendon pulled at a time; *mixed*: the twelve postures that
`simulate` takes, squeezing included. For your own postures ask `diagnose DATA --trust`.
"""
WITHOUT, WITH = '#888888', '#d55e00'


def main():
    """Write the pictures, and the beginning of what the page by hand lacks."""
    PICTURES.mkdir(exist_ok=True)
    for effect in CATALOGUE:
        draw(effect.name)
    PAGE.write_text(with_all(PAGE.read_text(encoding='utf-8')), encoding='utf-8')
    return 0


def with_all(text):
    """Return the page with a section of every effect, in the order of the catalogue."""
    first, *sections = re.split(r'^(?=## )', text, flags=re.M)
    sections += [begun(e) for e in CATALOGUE if f'\n## {e.name}\n' not in text]
    place = {f'## {name}': i for i, name in enumerate(CATALOGUE.names)}
    sections.sort(key=lambda section: place.get(section.split('\n')[0], len(place)))
    return '\n\n'.join(part.strip() for part in (first, *sections)) + '\n'


def reference():
    """Write the whole page."""
    parts = [HEAD, '## Parameters\n', *parameters(), '\n## What looks alike\n', ALIKE, *alike()]
    return '\n'.join([*parts, '\n## Pictures\n', *gallery(), ''])


def begun(effect):
    """Write the section of a new effect; its equation and how to tell it apart are by hand."""
    physics = inspect.getdoc(inspect.getmodule(effect.law))
    return f'## {effect.name}\n\n{physics} Tell apart: \n'


def parameters():
    """Write the lines of the table of parameters."""
    head = ['| parameter | unit | bounds | off at | typical |', '|---|---|---|---|---|']
    return head + [
        row(effect, parameter) for effect in CATALOGUE for parameter in effect.parameters
    ]


def row(effect, parameter):
    """Write the line of a parameter."""
    first = f'`{effect.name}` ' if parameter is effect.parameters[0] else ''
    name = f'{first}`{parameter.name}`' + (' per section' if parameter.per_section else '')
    bounds = f'{parameter.low:.3g} to {parameter.high:.3g}'
    numbers = f'{parameter.neutral:.3g} | {parameter.typical:.3g}'
    return f'| {name} | {parameter.unit} | {bounds} | {numbers} |'


def alike():
    """Write the lines of the table of effects that can be taken for each other."""
    lines = [f'| effect | {" | ".join(("one tendon", "mixed"))} |', '|---|---|---|']
    for name in CATALOGUE.names:
        cells = [listed(look_alikes(name, tensions)) for tensions in SETS.values()]
        lines += [f'| {name} | {" | ".join(cells)} |'] if any(cells) else []
    return lines


def listed(shares):
    """Say which effects do how much of another one."""
    return ', '.join(f'{name} {100 * share:.0f}' for name, share in shares.items())


def gallery():
    """Write the lines that show the pictures."""
    return [f'![{name}](../images/effects/{name}.png)' for name in CATALOGUE.names]


def millimetres(metres):
    """Show a distance without more digits than one can see."""
    return f'{1e3 * metres:.{0 if metres >= 0.00995 else 1}f}'


def size(name):
    """Say at which size an effect is drawn."""
    parts = []
    for parameter in CATALOGUE[name].parameters:
        numbers = np.atleast_1d(SIZES[name][parameter.name])
        if np.any(numbers):
            parts.append(described_quantity(parameter.name, parameter.unit, numbers))
    return ', '.join(parts)


def chosen_of(name):
    """Return the posture that an effect changes most, and the one that it changes least."""
    found = [one for one in drawn(name) if one.posture != 'the other side']  # a mirror image
    return found[0], [one for one in found[1:] if one.posture != 'at rest'][-1]


def tips(name):
    """Return {posture: [x, z without, x, z with]} [mm] of the two postures that are drawn."""
    return {
        one.posture: [
            round(1e3 * p[c], 2) for p in (one.without[-1], one.with_it[-1]) for c in (0, 2)
        ]
        for one in chosen_of(name)
    }


def draw(name):
    """Draw the two postures; the picture carries its tips, for the test."""
    chosen = chosen_of(name)
    figure = Figure(figsize=(6.2, 3.2), layout='constrained')
    FigureCanvasAgg(figure)
    points = 1e3 * np.vstack([np.vstack([one.without, one.with_it]) for one in chosen])
    low, high = points.min(axis=0) - 15.0, points.max(axis=0) + 15.0
    for axes, one in zip(figure.subplots(1, 2, sharey=True), chosen, strict=True):
        panel(axes, one, 'the same wire pulls' if by_pulls(name) else tensions_of(one.posture))
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[2], high[2])
    figure.suptitle(f'{name}: {size(name)}', fontsize=10)
    figure.savefig(
        PICTURES / f'{name}.png', dpi=90, metadata={'Description': json.dumps(tips(name))}
    )


def panel(axes, one, given):
    """Draw one posture without and with the effect."""
    for points, colour, line, label in (
        (one.without, WITHOUT, '--', 'without'),
        (one.with_it, WITH, '-', 'with'),
    ):
        axes.plot(*(1e3 * points[:, [0, 2]]).T, line, color=colour, label=label, linewidth=1.8)
        axes.plot(*(1e3 * points[-1, [0, 2]]), 'o', color=colour, markersize=5)
    axes.set_title(f'{one.posture}: {given}\ntips {millimetres(one.tip)} mm apart', fontsize=8)
    axes.set_aspect('equal')
    axes.set_xlabel('x [mm]', fontsize=7)
    axes.set_ylabel('z [mm]', fontsize=7)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.25)
    axes.legend(fontsize=7)


def tensions_of(posture):
    """Name the tensions above the pretension."""
    before = f'{max(LOADED):g} N, then ' if posture == 'let go' else ''
    pairs = zip(ROBOT.inputs, POSTURES[posture], strict=True)
    above = [f'{name} {before}{tension:g} N' for name, tension in pairs if tension > 0.1]
    return ', '.join(above) or 'all 0.1 N'


if __name__ == '__main__':
    sys.exit(main())
