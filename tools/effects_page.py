"""
Draw what every effect does to a shape, and bring the tables of docs/effects.md up to date.

python tools/effects_page.py

Between `<!-- NAME: ... -->` and `<!-- end -->` the page is written by this command, all else by
hand; test/test_docs_effects.py compares the two.
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
WRITTEN = re.compile(
    r'(<!-- written by tools/effects_page.py: (\w+) -->\n).*?(<!-- end -->)', re.S
)
WITHOUT, WITH = '#888888', '#d55e00'


def main():
    """Write the pictures and the tables."""
    PICTURES.mkdir(exist_ok=True)
    for effect in CATALOGUE:
        draw(effect.name)
    text = PAGE.read_text(encoding='utf-8')
    PAGE.write_text(refreshed(text), encoding='utf-8')
    return 0


def refreshed(text):
    """Return the page with every written part as it is now, new effects last."""
    for effect in CATALOGUE:
        if f'\n## {effect.name}\n' not in text:
            text = f'{text.rstrip()}\n\n{begun(effect)}'
    return WRITTEN.sub(lambda m: m[1] + part(m[2]) + m[3], text)


def begun(effect):
    """Write the section of a new effect; its equation and how to tell it apart are by hand."""
    physics = inspect.getdoc(inspect.getmodule(effect.law))
    mark = f'<!-- written by tools/effects_page.py: {effect.name} -->'
    return f'## {effect.name}\n\n{physics}\n\n{mark}\n<!-- end -->\n\nTell apart: \n'


def part(name):
    """Write what stands between the marks of a name."""
    if name == 'overview':
        return overview()
    effect = CATALOGUE[name]
    lines = [
        *table(effect),
        '',
        f'![Shapes without and with {name}](images/effects/{name}.png)',
        '',
    ]
    for label, tensions in SETS.items():
        lines.append(f'- Looks like, {label}: {listed(look_alikes(name, tensions))}')
    return '\n'.join([*lines, ''])


def table(effect):
    """Write what an effect is, and its parameters."""
    lines = [f'*{effect.title[0].upper() + effect.title[1:]}.* {acts_in(effect)}', '']
    lines += ['| parameter | unit | bounds | off at | typical |', '|---|---|---|---|---|']
    return lines + [row(parameter) for parameter in effect.parameters]


def acts_in(effect):
    """Say where the law acts, and what it needs."""
    needs = f'; needs `{effect.acts_on}`' if effect.acts_on else ''
    source = f'[law](../tendon_robot_ros/effects/{effect.name}.py)'
    return f'Stage `{effect.stage}`{needs}; {source}.'


def row(parameter):
    """Write the line of a parameter."""
    name = f'`{parameter.name}`' + (' per section' if parameter.per_section else '')
    bounds = f'{parameter.low:.3g} to {parameter.high:.3g}'
    numbers = f'{parameter.neutral:.3g} | {parameter.typical:.3g}'
    return f'| {name} | {parameter.unit} | {bounds} | {numbers} |'


def listed(shares):
    """Say which effects do how much of another one."""
    return ', '.join(f'`{name}` {100 * share:.0f} %' for name, share in shares.items()) or 'none'


def overview():
    """Write how far the tip moves in every posture."""
    head = ['effect', 'drawn at', *POSTURES, 'equal pulls']
    lines = [f'| {" | ".join(head)} |', '|' + '---|' * len(head)]
    for effect in CATALOGUE:
        apart = {one.posture: millimetres(one.tip) for one in drawn(effect.name)}
        moved = [apart[posture] for posture in POSTURES]
        moved.append(millimetres(drawn(effect.name, pulled=True)[0].tip))
        link = f'[`{effect.name}`](#{effect.name})'
        lines.append(f'| {" | ".join([link, size(effect.name), *moved])} |')
    return '\n'.join([*lines, ''])


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
