"""The page that `paper` writes: every number and figure of section IV beside ours."""

from __future__ import annotations

from collections import Counter

from ..analysis.paper.displacement import DisplacementExperiment, Heights
from ..analysis.paper.motion import VIEWS, Motion, Stiffening
from ..analysis.paper.tension import TensionExperiment
from ..analysis.paper.whole import Paper, Row
from ..analysis.result import Diagnosis
from . import comparison_text as say
from .error_plots import angles, tip_boxes
from .page import Page
from .paper_figures import arrangements, error_per_cell, posture
from .paper_text import ASSUMED, SOURCE
from .quantities import quantities
from .words import capital, commands, digits, listed, mm
from .workspace_figures import HEADER, rows, view_figures

TABLE = ('', 'what', 'published', 'ours', 'difference', 'range left open', 'met', 'why')


def paper_page(paper: Paper) -> Page:
    """Return the page."""
    page = Page('Kato et al. 2015, section IV, reproduced', SOURCE)
    table = paper.rows
    missed = [row for row in table if row.met == 'not met']
    met = sum(row.met == 'within 15 %' for row in table)
    page.box(
        [
            f'{met} of {len(table)} published numbers are met within 15 %; '
            f'{len(table) - met - len(missed)} more lie in the range that the paper leaves open; '
            f'{len(missed)} are not met.'
        ],
        'verdict' if missed else 'verdict good',
    )
    page.table(TABLE, [_row(row) for row in table], left=(1, 6, 7))
    page.heading('What is assumed')
    page.text('Tables I to IV of the paper are lost in the text that was used. Assumed instead:')
    page.table(('what', 'assumed', 'why'), ASSUMED, left=(1, 2))
    _motion(page, paper.motion)
    _displacement(page, paper.displacement)
    _tension(page, paper.tension)
    _small(page, paper)
    return page


def _row(row: Row) -> list[str]:
    unit = '' if row.unit == '1' else f' {row.unit}'
    number = digits(row.ours, 3)
    return [
        row.section, row.what, f'{row.published:g}{unit}', f'{number}{unit}',
        f'{round(100.0 * row.difference):+d} %',
        f'{digits(row.low, 3)} to {digits(row.high, 3)}', row.met.replace(' ', '\u00a0'), row.why,
    ]  # fmt: skip


def _motion(page: Page, found: Motion) -> None:
    page.heading('IV.B Range of motion (figures 7 and 8)')
    first, *others = found.arrangements
    near = [one for one in others if abs(one.across / first.across - 1.0) < 0.15]
    page.text(
        f'{capital(first.name)}: the tips at the 180° view span {mm(first.across)} across, '
        'published 50 mm. Other arrangements: '
        + '; '.join(f'{one.name}: {mm(one.across)}' for one in others)
        + f'. The 50 mm therefore rule out 5 N in all; {len(near)} of {len(others)} other '
        'arrangements come within 15 %.'
    )
    page.figures([arrangements(found, 0.05)])
    page.table(HEADER, rows(found.workspace), left=(1, 2))
    for view, name in zip(VIEWS, ('Figure 8', 'Figure 7'), strict=True):
        families = found.workspace.of(view)
        page.text(f'{name}: the opposite-side pair, and the same side where it reaches the view.')
        kinds = {family.pair.kind: family for family in reversed(families)}
        for kind in ('opposite sides', 'same side'):
            if kind in kinds:
                page.figures(view_figures(kinds[kind]), 'two')
    page.text(_stiffening(found.stiffening), _stiffening(found.every_tendon))


def _stiffening(one: Stiffening) -> str:
    near, far = one.bending[0], one.bending[-1]
    return (
        f'Assumption A7 with {one.tendons[0]} tendons in the proximal and {one.tendons[-1]} in '
        f'the distal section, {digits(1e3 * one.per_tendon, 2)} mN·m/rad each: bends change by '
        f'{100 * near:.1f} % in the proximal and {100 * far:.1f} % in the distal section, the tip '
        f'by {mm(one.shift)} or {100 * one.relative:.1f} % of its way (published: of the order of '
        f'10 %, most in the proximal section). A proximal backbone that is '
        f'{-100 * one.softer:.0f} % softer makes the sections alike; with equally higher tensions '
        f'the tip is then off by {1e3 * one.evened:.2f} mm.'
    )


def _displacement(page: Page, found: DisplacementExperiment) -> None:
    page.heading('IV.C Posture by wire pull (figures 12 to 15)')
    page.table(('arrangement', 'arm', 'proximal / distal pull', 'tip z', 'FKM to PCCA',
                'at all heights'),
               [_heights(one) for one in found.others], left=(2, 3, 4))  # fmt: skip
    low, high = found.heights.everywhere
    page.text(
        'The published errors (5.9 and 23.7 mm) require 17.8 to 29.6 mm between the tips of FKM '
        f'and PCCA. Wires on opposite sides give {mm(low)} to {mm(high)} over all tip heights; '
        'this is the arrangement used below.',
        f'Hinge friction does not show here: at given pulls a lever of {mm(found.lever)} '
        f'moves the tip by {1e3 * found.hinge_shift:.2f} mm, because it scales the '
        'tensions and not the shape. The scatter of the cells alone, 2° per cell with the sum '
        'over a section held by its wires, makes a tip error of the published size.',
    )
    pairs = [test for test in found.comparison.paired_t if test.posture is not None]
    page.text(*(f'{capital(say.paired(test))} (published: P < 0.01).' for test in pairs))
    for p in range(len(found.comparison.measured.postures)):
        page.figures(
            [posture(found.comparison, found.data, p), angles(found.comparison, p)], 'two'
        )
    page.figures([tip_boxes(found.comparison)])


def _heights(one: Heights) -> list[str]:
    two = list(one.pair.indices)
    pulls = ', '.join(f'{1e3 * a:.1f} / {1e3 * b:.1f}' for a, b in one.pulls[:, two])
    tips = ', '.join(f'{1e3 * z:.0f}' for z in one.tips[:, 2])
    apart = ', '.join(f'{1e3 * d:.1f}' for d in one.apart)
    low, high = (1e3 * value for value in one.everywhere)
    return [
        one.pair.kind, mm(one.arm, 2), f'{pulls} mm', f'{tips} mm', f'{apart} mm',
        f'{low:.1f} to {high:.1f} mm',
    ]  # fmt: skip


def _tension(page: Page, found: TensionExperiment) -> None:
    page.heading('IV.D Posture by tension (figures 16 and 17)')
    names = found.comparison.measured.postures
    page.figures([posture(found.comparison, found.data, p) for p in range(len(names))], 'two')
    page.figures(
        [error_per_cell(found.comparison, found.data, p) for p in range(len(names))], 'two'
    )
    page.text(
        f'PCCA predicts the same shape for 0.51 N alone and for 0.99 against 0.48 N (apart by '
        f'{1e3 * found.same:.2f} mm), as published.'
    )
    page.box(
        _diagnosis(found.alone),
        'warn',
        'What diagnose says about these two postures',
    )
    for i, one in enumerate(found.more):
        title = 'With the posture that it asks for' if i == 0 else 'And with the next one'
        page.box(_diagnosis(one), '', title)
    page.text(_redrawn(found.redrawn))


def _redrawn(found: tuple[Diagnosis, ...]) -> str:
    """Say how far the outcome depends on the noise."""
    ends = Counter((one.verdict, listed(effect.name for effect in one.effects)) for one in found)
    counts = (f'{count} times {verdict} ({effects})' for (verdict, effects), count in ends.items())
    return (
        f'The same with {len(found)} other draws of the noise ends {listed(counts)}. '
        '"adequate": the declared uncertainties of tension, friction and stiffness cover '
        'the error, and nothing is asked for.'
    )


def _diagnosis(found: Diagnosis) -> list[str]:
    lines = [
        f'Verdict: {found.verdict}. Error {mm(found.error_before)} before, '
        f'{mm(found.error_after)} with the best effect, {mm(found.noise_floor)} for a perfect '
        'model.'
    ]
    for effect in found.effects:
        lines.append(f'Best: `{effect.name}`, {quantities(effect.parameters)}.')
    if found.cannot_tell_apart:
        lines.append(f'Cannot be told apart: {listed(found.cannot_tell_apart)}.')
    asked = found.next_measurement
    if asked is not None:
        lines.append(
            f'Measure next: {commands(asked.input)}; the predictions differ there by '
            f'{mm(asked.difference)}, noise {mm(asked.noise)}.'
        )
    return lines


def _small(page: Page, paper: Paper) -> None:
    found, robot = paper.small, paper.robots.small
    page.heading('IV.E The 2:1 prototype at 90°')
    one, low, high = found.as_assumed, found.low, found.high
    page.text(
        f'One section of {mm(robot.length, 2)} in {robot.cells} cells, arm '
        f'{mm(abs(robot.tendons[0].base[0]), 2)}: {digits(found.tension, 3)} N bend the FKM to '
        f'90°. At equal tension PCCA is {mm(one.tension)} away (over what is left open '
        f'{mm(low.tension)} to {mm(high.tension)}), at equal pull {mm(one.pull)} '
        f'({mm(low.pull)} to {mm(high.pull)}). The published errors, 0.5 and 7.6 mm, require 7.1 '
        'to 8.1 mm: equal tension. The hinge friction of the 10:1 prototype, scaled with the arm '
        f'to a lever of {mm(found.lever)}, would move the tip by {mm(one.hinge)}; the published '
        'reading of 0.5 mm leaves room for little of it.'
    )
