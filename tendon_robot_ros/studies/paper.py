"""
Reproduce the experiments of Kato et al. 2015 (section IV) and put the published numbers beside.

OUTPUT gets paper.html (figures and table; opens without a network) and paper.json (the table).
With --robots, kato_1_1.yaml, kato_10_1.yaml, kato_10_1_single.yaml and kato_2_1.yaml are read from
a folder of your own.

example: python -m tendon_robot_ros study paper --output results/paper
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..cli.options import declare, emit, progress
from ..common.colours import line_style
from ..common.errors import InputError, Progress
from ..common.files import new_folder, refuse_other_files, write_text
from ..common.words import capital, columns, digits, listed, mm
from ..comparison.result import Comparison
from ..data import DataSet
from ..diagnosis.result import Diagnosis
from ..inference.statistics import half_width
from ..report import comparison as say
from ..report import diagnosis_text
from ..report.error_plots import angles, tip_boxes
from ..report.page import Figure, Page, axes, curve, error_bars, mm_list, plain, titled
from ..report.sentences import interval_name
from ..report.workspace_page import rows, view_figures
from ..robot import Robot, load_robot
from .friction import SlipFriction
from .paper_motion import Assumed, MotionExperiment, Published, Range
from .paper_postures import DisplacementExperiment, SmallExperiment, TensionExperiment

HELP = "the paper's experiments, published numbers beside ours, on one page"
PAPER_ROBOTS = ('kato_1_1', 'kato_10_1', 'kato_10_1_single', 'kato_2_1')
PAPER_FILES = ('paper.html', 'paper.json')
# [printed unit / SI] (Kato et al. 2015)
SCALES = {'1': 1.0, '%': 100.0, 'mm': 1e3, '°': 180.0 / np.pi}
# [1] relative difference that counts as met, because what else is assumed moves as much
AGREEMENT_TOLERANCE = 0.15


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('--output', required=True, metavar='DIR', help='folder for the page and the table')
    add('--overwrite', action='store_true', help='replace them in that folder')
    add('--robots', metavar='DIR', help="folder with robots of your own instead of the paper's")
    declare(parser, '--json')


def run(args: argparse.Namespace) -> None:
    """Run everything, print the table, write the page."""
    folder = Path(args.output)
    if folder.exists() and any(folder.iterdir()) and not args.overwrite:
        raise InputError(f'{folder}: is not empty; use --overwrite or another --output')
    refuse_other_files(folder, PAPER_FILES)
    places = [Path(args.robots, f'{one}.yaml') if args.robots else one for one in PAPER_ROBOTS]
    with progress() as show:
        paper = Paper([load_robot(place) for place in places], show)
    page = paper_page(paper)
    with new_folder(folder, PAPER_FILES) as draft:
        page.write(draft / PAPER_FILES[0])
        write_text(draft / PAPER_FILES[1], json.dumps(paper.to_json(), indent=1))
    cells = [ROW_COLUMNS, *map(number_cells, paper.rows)]
    table = columns([row[:-1] for row in cells])  # without the reasons, which are long
    written = ', '.join(str(folder / name) for name in PAPER_FILES)
    emit(args, paper.to_json(), f'{table}\nwritten: {written}')


@dataclass(frozen=True)
class Number:
    """A published number beside ours, and the range over what the paper leaves open."""

    section: str
    what: str
    unit: str
    published: float
    ours: float
    low: float
    high: float
    why: str

    @classmethod
    def of(
        cls, section: str, what: str, unit: str, published: float, ours: Range, why: str
    ) -> Number:
        """Put a published number [unit] beside ours: (ours, low, high) in SI."""
        own, low, high = (SCALES[unit] * one for one in ours)
        return cls(section, what, unit, published, own, low, high, why)

    @property
    def difference(self) -> float:
        """Ours against the published number, relative [1]."""
        return self.ours / self.published - 1.0

    @property
    def met(self) -> str:
        """How the published number is met: 'within 15 %', 'in range' or 'not met'."""
        if abs(self.difference) <= AGREEMENT_TOLERANCE:
            return 'within 15 %'
        return 'in range' if self.low <= self.published <= self.high else 'not met'


class Paper:
    """Section IV, reproduced with robots as `PAPER_ROBOTS`; every published number in its rows."""

    def __init__(self, robots: Sequence[Robot], show: Progress) -> None:
        target, prototype, single, small = robots
        show('friction', 0, 5)
        self.rows = [*friction_numbers()]
        show('motion', 1, 5)
        self.motion = MotionExperiment(target)
        self.rows += motion_numbers(self.motion)
        show('displacement', 2, 5)
        self.displacement = DisplacementExperiment(prototype)
        self.rows += displacement_numbers(self.displacement)
        show('tension', 3, 5)
        self.tension = TensionExperiment(single)
        self.rows += tension_numbers(self.tension)
        show('small', 4, 5)
        self.small = SmallExperiment(small)
        self.rows += small_numbers(self.small)

    def to_json(self) -> dict[str, Any]:
        """Return the table as plain data."""
        rows = [asdict(row) | {'difference': row.difference, 'met': row.met} for row in self.rows]
        return {'rows': rows}


def friction_numbers() -> Iterator[Number]:
    """
    Draw slip angles of the published coefficients and evaluate them, scale by scale (IV.A).

    The measured ones are not printed.
    """
    why = 'rehearsed with drawn slip angles (SD 0.03 assumed); ± is the 95 % interval of the mean'
    for scale, (coefficient, n) in Published.FRICTION.items():
        random, reading = np.random.default_rng([0, n]), Assumed.ANGLE_READING_DEG
        degrees = np.degrees(np.arctan(coefficient + Assumed.TANGENT_SD * random.normal(size=n)))
        angles = np.radians(np.round(degrees / reading) * reading)
        one = SlipFriction(tuple(map(str, range(1, n + 1))), angles)
        what, ours = f'friction coefficient, {scale}, n = {n}', (one.mean, one.low, one.high)
        yield Number.of('IV.A', what, '1', coefficient, ours, why)


def motion_numbers(experiment: MotionExperiment) -> Iterator[Number]:
    """Return the ranges and the cost of stiff tendons of section IV.B."""
    name, ours = next(one for one in experiment.arrangements.items() if one[1][0] > 0.0)
    why = f'opposite-side pair, {name}; the range is over ±1° to ±5° for "180°"'
    yield Number.of('IV.B', 'tip positions at the 180° view, across', 'mm', 50.0, ours, why)
    bends = [one.bending[0] for one in (experiment.stiffening, experiment.every_tendon)]
    what = 'cost of ignoring the tendons’ stiffness (A7), proximal bends'
    why = 'six tendons make a tenth of a cell’s stiffness; six or all twelve counted'
    yield Number.of('IV.B', what, '%', 10.0, (bends[0], min(bends), max(bends)), why)


def displacement_numbers(experiment: DisplacementExperiment) -> Iterator[Number]:
    """Return the errors of section IV.C."""
    of_error = '2° scatter per cell; mean of 200 simulated prototypes, 5 to 95 % of them'
    of_sd = (
        'SD over 15 trials (assumed to be what ± means) with cells that change by 1° from '
        'trial to trial; the range is over 0 to 2°, 5 to 95 % of prototypes'
    )
    for model, published, sd in (('FKM', 5.9, 2.9), ('PCCA', 23.7, 3.6)):
        (errors, sds), what = experiment.errors[model], 'tip error at given pulls'
        yield Number.of('IV.C', f'{what}, {model}', 'mm', published, errors, of_error)
        yield Number.of('IV.C', f'its ±, {model}', 'mm', sd, sds, of_sd)
    why = 'put in; taut wires hold the sum over each section, which takes some of it away'
    ours = (experiment.scatter,) * 3
    yield Number.of('IV.C', 'scatter of the mean angle per cell', '°', 2.0, ours, why)


def tension_numbers(experiment: TensionExperiment) -> Iterator[Number]:
    """Return the errors of section IV.D."""
    why = (
        f'one hinge lever of {1e3 * Assumed.HINGE_LEVER_M:.2f} mm for all four; trials scatter by '
        '1 mm; the range is over levers within 12.5 %'
    )
    for key, published in Published.ERRORS_M.items():
        ours = (experiment.largest[key], experiment.low[key], experiment.high[key])
        what = f'largest error, {key[0]}, {key[1]}'
        yield Number.of('IV.D', what, 'mm', 1e3 * published, ours, why)


def small_numbers(experiment: SmallExperiment) -> Iterator[Number]:
    """Return the errors of section IV.E."""
    one, low, high = experiment.as_assumed, experiment.low, experiment.high
    fraction = 0.5e-3 / one.hinge  # of the lever that makes the published error
    why = (
        'one reading. Without hinge friction the FKM is met exactly (0 mm); with the lever of '
        'the 10:1 prototype, scaled with the arm, it is off as ours. The reading asks for '
        f'about {100.0 * fraction:.0f} % of that lever; nothing else fixes it'
    )
    ours = (one.hinge, 0.0, high.hinge)
    yield Number.of('IV.E', 'tip at 90°, FKM', 'mm', 0.5, ours, why)
    why = (
        'distance of the models at equal tension; the range is over arm 1.0 to 1.6 mm, 15 to '
        '60 cells, friction 0.28 to 0.34, and equal pull instead of tension'
    )
    ours = (one.tension, low.pull, high.tension)
    yield Number.of('IV.E', 'tip at 90°, PCCA', 'mm', 7.6, ours, why)


PAPER_SOURCE = (
    'T. Kato, I. Okumura, S.-E. Song, A. J. Golby, N. Hata: Tendon-Driven Continuum Robot for '
    'Endoscopic Surgery: Preclinical Development and Validation of a Tension Propagation Model, '
    'IEEE/ASME Transactions on Mechatronics 20 (2015), doi 10.1109/TMECH.2014.2372635. "Trials" '
    'on this page are simulated.'
)
ASSUMED = (
    'what | assumed | why',
    'slip angles (IV.A, Table II) | drawn: SD 0.03, read to 0.1° | only mean and n are printed',
    'wires of a group (Table I) | three at one place, arm 0.65 mm, 5 N each | '
    'gives the published 50 mm; others are shown',
    '"180°" on a grid of 0.1 N | within ±2.5° | an exact 180° is hardly ever on the grid',
    'inputs that are not pulled (IV.B) | 0.1 N | pretension, as published',
    'arm of the 10:1 prototype (Table III) | 5.5 mm | FKM and PCCA then differ as IV.D requires',
    'cells of the 10:1 prototype | 208 mm / 30, arcs | the FKM of the paper chains arcs',
    'hinge friction | lever 0.40 mm, hidden in the simulated prototype | '
    'one number for all four errors of IV.D; the suspect of section V',
    'wires and pulls of IV.C (Table IV) | opposite sides, no other wires; from the FKM | '
    'FKM and PCCA then differ as the published errors require',
    'three tip heights | highest, median, lowest with taut wires and no S-shape | '
    'the tensions are not printed',
    'scatter of the cells | 2° of every prototype, 1° from trial to trial | '
    '2° is published; what varies between trials is not',
    'hand and camera | 0.1 mm of wire pull, 0.09 mm of position | caliper; a pixel',
    'IV.D | tensions known to 5 %, 2 % and 1 mm from trial to trial, friction to 10 %, stiffness '
    'to 5 % | weights behind pulleys; nothing is printed',
    '2:1 prototype | one section of 60 mm, 30 cells, arm 1.3 mm | twice the target scale',
)


def posture(comparison: Comparison, p: int) -> Figure:
    """Draw the mean position of every cell, and what the models predict."""
    return say.flat_figure(say.DrawnPosture(comparison, p, (), {}))


def error_per_cell(comparison: Comparison, data: DataSet, p: int) -> Figure:
    """Mean distance between trials and models, cell by cell, with its interval."""
    traces: list[dict[str, Any]] = []
    cells = plain(np.arange(1, data.positions.shape[2] + 1))
    for i, model in enumerate(comparison.models):
        errors = np.linalg.norm(data.positions[p] - model.markers[p], axis=2)
        mean, half = np.nanmean(errors, axis=0), half_width(errors, comparison.error)
        bars = error_bars(mm_list(half))
        line = curve(cells, mm_list(mean), model.name, line_style(i), 1.5, size=8, error_y=bars)
        traces.append(line)
    title = f'position error ± {interval_name(comparison)} [mm]'
    layout = axes('cell', titled(title, rangemode='tozero'))
    return Figure(traces, layout, f'{capital(comparison.measured.postures[p])}: error')


ROW_COLUMNS = (
    *('section', 'what', 'published', 'ours', 'difference', 'range left open', 'met', 'why'),
)


def paper_page(paper: Paper) -> Page:
    """Return the page."""
    page = Page('Kato et al. 2015, section IV, reproduced', PAPER_SOURCE)
    met = Counter(row.met for row in paper.rows)
    verdict = (
        f'{met["within 15 %"]} of {len(paper.rows)} published numbers are met within 15 %; '
        f'{met["in range"]} more lie in the range that the paper leaves open; '
        f'{met["not met"]} are not met.'
    )
    page.box([verdict], 'verdict' if met['not met'] else 'verdict good')
    page.table([ROW_COLUMNS, *map(number_cells, paper.rows)], left=(1, 6, 7))
    page.heading('What is assumed')
    page.text('Tables I to IV of the paper are lost in the text that was used. Assumed instead:')
    page.table([line.split(' | ') for line in ASSUMED], left=(1, 2))
    add_motion(page, paper.motion)
    add_displacement(page, paper.displacement)
    add_tension(page, paper.tension)
    add_small(page, paper.small)
    return page


def number_cells(one: Number) -> list[str]:
    """Return a row of the table; a difference above all of the published is shown in its unit."""
    unit = '' if one.unit == '1' else f' {one.unit}'
    difference = f'{round(100.0 * one.difference):+d} %'
    if abs(one.difference) > 1.0:
        difference = f'{one.ours - one.published:+.2g} {one.unit}'
    ours, low, high = (digits(number, 3) for number in (one.ours, one.low, one.high))
    numbers = [f'{one.published:g}{unit}', f'{ours}{unit}', difference, f'{low} to {high}']
    return [one.section, one.what, *numbers, one.met, one.why]


def add_motion(page: Page, experiment: MotionExperiment) -> None:
    """Add section IV.B."""
    page.heading('IV.B Range of motion (figures 7 and 8)')
    page.text('The tips at the 180° view span 50 mm across, as published; here:')
    spans = [['wires of a group', 'across', '"180°" within 1° to 5°']]
    for name, (across, low, high) in experiment.arrangements.items():
        spans.append([name, mm(across), f'{mm(low)} to {mm(high)}'])
    page.table(spans, left=[0])
    page.text('The 50 mm therefore rule out 5 N in all.')
    page.table(rows(experiment.workspace), left=(1, 2))
    for view, name in zip(Published.VIEW_ANGLES_RAD, ('Figure 8', 'Figure 7'), strict=True):
        families = experiment.workspace.of(view)
        page.text(f'{name}: the opposite-side pair, and the same side where it reaches the view.')
        kinds = {family.pair.kind: family for family in reversed(families)}
        for kind in ('opposite sides', 'same side'):
            if kind in kinds:
                page.figures(view_figures(kinds[kind]), 'two')
    for one in (experiment.stiffening, experiment.every_tendon):
        proximal, distal = 100 * one.bending[0], 100 * one.bending[-1]
        page.text(
            f'Assumption A7 with {one.tendons[0]} tendons in the proximal and {one.tendons[-1]} '
            f'in the distal section, {digits(1e3 * one.per_tendon, 2)} mN·m/rad each: bends '
            f'change by {proximal:.1f} % in the proximal and {distal:.1f} % in the distal '
            f'section, the tip by {mm(one.shift)} or {100 * one.relative:.1f} % of its way '
            '(published: of the order of 10 %, most in the proximal section). A proximal '
            f'backbone that is {-100 * one.softer:.0f} % softer makes the sections alike; with '
            f'equally higher tensions the tip is then off by {1e3 * one.evened:.2f} mm.'
        )


def add_displacement(page: Page, experiment: DisplacementExperiment) -> None:
    """Add section IV.C."""
    page.heading('IV.C Posture by wire pull (figures 12 to 15)')
    names = 'arrangement | arm | proximal / distal pull | tip z | FKM to PCCA | at all heights'
    cells = [names.split(' | ')]
    for one in experiment.others:
        two = list(one.pair.indices)
        texts = (
            ', '.join(f'{1e3 * a:.1f} / {1e3 * b:.1f}' for a, b in one.pulls[:, two]),
            ', '.join(f'{1e3 * z:.0f}' for z in one.tips[:, 2]),
            ', '.join(f'{1e3 * d:.1f}' for d in one.apart),
            ' to '.join(f'{1e3 * d:.1f}' for d in one.everywhere),
        )
        cells.append([one.pair.kind, mm(one.arm, 2), *(f'{text} mm' for text in texts)])
    page.table(cells, left=(2, 3, 4))
    low, high = experiment.heights.everywhere
    page.text(
        'The published errors (5.9 and 23.7 mm) require 17.8 to 29.6 mm between the tips of FKM '
        f'and PCCA. Wires on opposite sides give {mm(low)} to {mm(high)} over all tip heights; '
        'this is the arrangement used below.',
        'Hinge friction does not show here: at given pulls a lever of '
        f'{mm(Assumed.HINGE_LEVER_M)} moves the tip by {1e3 * experiment.hinge_shift:.2f} mm, '
        'because it scales the tensions and not the shape. The scatter of the cells alone, 2° per '
        'cell with the sum over a section held by its wires, makes a tip error of the published '
        'size.',
    )
    pairs = [test for test in experiment.comparison.paired_t if test.posture is not None]
    page.text(*(f'{capital(say.paired(test))} (published: P < 0.01).' for test in pairs))
    comparison = experiment.comparison
    page.key(say.shape_key(comparison))
    for p in range(len(comparison.measured.postures)):
        page.figures([posture(comparison, p), angles(comparison, p)], 'two')
    page.figures([tip_boxes(comparison)])


def add_tension(page: Page, experiment: TensionExperiment) -> None:
    """Add section IV.D."""
    page.heading('IV.D Posture by tension (figures 16 and 17)')
    comparison, data = experiment.comparison, experiment.data
    postures = range(len(comparison.measured.postures))
    page.key(say.shape_key(comparison))
    page.figures([posture(comparison, p) for p in postures], 'two')
    page.figures([error_per_cell(comparison, data, p) for p in postures], 'two')
    page.text(
        f'PCCA predicts the same shape for 0.51 N alone and for 0.99 against 0.48 N (apart by '
        f'{1e3 * experiment.same:.2f} mm), as published.'
    )
    title = 'What diagnose says about these two postures'
    page.box(diagnosis_lines(experiment.alone), 'warn', title)
    title = 'With as many postures as it asks for'
    page.box(diagnosis_lines(experiment.enough), '', title)
    redrawn = experiment.redrawn
    ends = Counter(f'{one.verdict} ({listed(e.name for e in one.effects)})' for one in redrawn)
    page.text(
        f'The same with {len(redrawn)} other draws of the noise ends '
        f'{listed(f"{count} times {end}" for end, count in ends.items())}. "adequate": the '
        'declared uncertainties of tension, friction and stiffness cover the error, and nothing '
        'is asked for.'
    )


def diagnosis_lines(diagnosis: Diagnosis) -> list[str]:
    """Describe a diagnosis, and the posture that it proposes."""
    error, floor = mm(diagnosis.error_before), mm(diagnosis.noise_floor)
    lines = [
        *diagnosis_text.verdict(diagnosis).split('\n'),
        f'Error {error} before, {mm(diagnosis.error_after)} with the best effect, {floor} for a '
        'perfect model.',
    ]
    return [*lines, *filter(None, [diagnosis_text.next_measurement(diagnosis)])]


def add_small(page: Page, small: SmallExperiment) -> None:
    """Add section IV.E."""
    page.heading('IV.E The 2:1 prototype at 90°')
    robot, one, low, high = small.robot, small.as_assumed, small.low, small.high
    page.text(
        f'One section of {mm(robot.length, 2)} in {robot.cells} cells, arm '
        f'{mm(abs(robot.tendons[0].base[0]), 2)}: {digits(small.tension, 3)} N bend the FKM to '
        f'90°. At equal tension PCCA is {mm(one.tension)} away (over what is left open '
        f'{mm(low.tension)} to {mm(high.tension)}), at equal pull {mm(one.pull)} '
        f'({mm(low.pull)} to {mm(high.pull)}). The published errors, 0.5 and 7.6 mm, require 7.1 '
        'to 8.1 mm: equal tension. The hinge friction of the 10:1 prototype, scaled with the arm '
        f'to a lever of {mm(small.lever)}, would move the tip by {mm(one.hinge)}; the published '
        'reading of 0.5 mm leaves room for little of it.'
    )
