"""The page of a diagnosis: verdict first, then what to do, then evidence and pictures."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..common.colours import FLOOR, line_style
from ..common.errors import NoEquilibriumError
from ..common.words import capital, listed, mm, percent, probability, typed
from ..comparison.compare import compare
from ..comparison.result import Comparison
from ..data import DataSet
from ..data.dataset import names_in
from ..diagnosis.add import Addition
from ..diagnosis.missing_moment import MissingMoment, missing_moment
from ..diagnosis.result import NOT_NEEDED, CandidateRow, Diagnosis, found_values
from ..diagnosis.verdict import P_SINGLE_MIN, Verdict
from ..effects import Catalogue, load_catalogue
from ..inference.crossval import set_alike
from ..inference.description import with_values
from ..robot import Robot
from . import diagnosis_text
from .comparison import Push, add_loops, add_shapes
from .diagnosis_text import next_measurement, trust_lines
from .error_plots import Step, heat_maps, moments, per_marker, per_posture, staircase
from .page import Page, Shown
from .sentences import quantities, where_wrong

BEFORE = 'as described'
GROUPS = {
    'fitted': 'postures that were fitted',
    'left out': 'postures left out in turn',
    'check': 'postures never used',
}
# the columns of a table of candidates; the live page shows the first two and the last two
CANDIDATE_COLUMNS: dict[str, Callable[[CandidateRow], str]] = {
    'effect': lambda row: f'{row.name} (another value)' if row.present else row.name,
    'explains': lambda row: '–' if row.status == NOT_NEEDED else percent(row.explained),
    'error left': lambda row: mm(row.error),
    'left-out postures': lambda row: mm(row.held_out),
    'chance': lambda row: probability(row.probability).removeprefix('p ').removeprefix('= '),
    'status': lambda row: row.status,
    'value': lambda row: quantities(row.parameters, row.load),
}
CANDIDATE_HEAD = list(CANDIDATE_COLUMNS)


# measurements against the description before and, where something is to add, after; the moments
# that each lacks, none where the noise is not known
Pictures = tuple[Comparison, list[MissingMoment]]


def pictures_of(
    diagnosis: Diagnosis,
    dataset: DataSet,
    catalogue: Catalogue | None = None,
    addition: Addition | None = None,
) -> Pictures | None:
    """
    Compute the pictures of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    dataset : DataSet
        With the description that was judged.
    catalogue : Catalogue, optional
    addition : Addition, optional
        What was added; default: the values that were found are.

    Returns
    -------
    Pictures, or None where the description has no equilibrium in a posture.

    """
    catalogue = catalogue or load_catalogue()
    robot = dataset.robot
    models = [(BEFORE, robot)]
    if diagnosis.effects:
        after = addition.robot if addition else with_effects(diagnosis, robot, catalogue)
        name = f'with {" and ".join(effect.name for effect in diagnosis.effects)}'
        if diagnosis_text.with_arm(diagnosis):
            name += ' and the arm as found' if addition else ' alone'
        models.append((name, after))
    if unsettled := set(diagnosis.details.get('unsettled') or ()):
        dataset = dataset.select(set(dataset.postures) - unsettled)
    dataset = set_alike(dataset, robot, catalogue, diagnosis.details.get('anew', {}))
    try:
        comparison = compare(dataset, models, catalogue)
    except NoEquilibriumError:
        return None
    lacks = [missing_moment(dataset, one, comparison.measured, catalogue) for _, one in models]
    return comparison, [one for one in lacks if one is not None]


def with_effects(diagnosis: Diagnosis, robot: Robot, catalogue: Catalogue) -> Robot:
    """Return a description with the effects at the values that were found."""
    return with_values(robot, catalogue, found_values(diagnosis.effects, catalogue, robot).items())


def diagnosis_page(
    diagnosis: Diagnosis,
    dataset: DataSet | None = None,
    catalogue: Catalogue | None = None,
    addition: Addition | None = None,
    outcome: str = '',
) -> Page:
    """
    Return the page of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    dataset : DataSet, optional
        With the description that was judged; without it the page has words and tables only.
    catalogue : Catalogue, optional
    addition : Addition, optional
        What was added, with the errors on postures that were not used.
    outcome : str
        Where a file was asked for: what became of it; else what to type is said.

    """
    page = Page('Diagnosis', diagnosis_text.size(diagnosis))
    add_verdict(page, diagnosis, outcome)
    if diagnosis.verdict.judged:
        add_staircase(page, diagnosis, addition)
        add_alternatives(page, diagnosis)
    if dataset is not None and (seen := pictures_of(diagnosis, dataset, catalogue, addition)):
        add_pictures(page, seen, diagnosis)
    if sentences := [*diagnosis_text.declared(diagnosis), *trust_lines(diagnosis)]:
        page.heading('What this rests on')
        page.text(*map(capital, sentences))
    return page


def add_verdict(page: Page, diagnosis: Diagnosis, outcome: str = '') -> None:
    """Add the verdict, and what to do now, or what was done."""
    lines = diagnosis_text.verdict(diagnosis).split('\n')
    if diagnosis.verdict.judged:
        error_lines = [line.replace('->', '→') for line in diagnosis_text.errors(diagnosis)]
        lines += [*map(capital, error_lines), diagnosis.remainder]
    page.box(lines, f'verdict {diagnosis.verdict.colour}')
    if caveats := [f'{capital(caveat)}.' for caveat in diagnosis.details.get('caveats', ())]:
        page.box(caveats, 'warn', 'Mind')
    if following := next_measurement(diagnosis):
        page.box([following], 'warn', 'Next measurement')
    page.text(*filter(None, [outcome or to_do(diagnosis)]))


def to_do(diagnosis: Diagnosis) -> str:
    """Say what to type now."""
    if not diagnosis.effects:
        return ''
    words = ['diagnose', *names_in(diagnosis.details.get('data', 'DATA'))]
    if taken := diagnosis.details.get('reference'):
        words += ['--reference', *names_in(taken['data'])]
    return diagnosis.verdict.advice.format(command=typed(*words))


def add_staircase(page: Page, diagnosis: Diagnosis, addition: Addition | None) -> None:
    """Add the errors before and after, and those of a perfect model."""
    if not diagnosis.effects:
        return
    page.heading('The error falls' if diagnosis.adds else 'A part of the error falls')
    if addition is None:
        alone = diagnosis.error_alone if diagnosis_text.with_arm(diagnosis) else None
        steps = falling(
            diagnosis.error_before, alone, diagnosis.error_after, diagnosis.noise_floor
        )
    else:
        never_used = diagnosis_text.never_used(addition).replace('->', '→').replace('  ', ' ')
        page.text(f'{capital(never_used)}.')
        steps = [
            step
            for one in (addition.fitted, addition.check)
            for step in falling(one.before, one.alone, one.after, one.floor, GROUPS[one.kind])
        ]
        page.text(*map(capital, diagnosis_text.addition_warnings(addition)))
    page.figures([staircase(steps, height=Shown.LOW)])


def falling(
    before: float, alone: float | None, after: float, floor: float | None, group: str = ''
) -> list[Step]:
    """Return the steps from an error [m] to that of a perfect model, of one group of postures."""
    first, last, middle = (line_style(i).colour for i in range(3))
    steps = [Step('before', before, first, group)]
    if alone is not None and math.isfinite(alone):
        steps.append(Step('effects alone', alone, middle, group))
    steps.append(Step('after', after, last, group))
    return steps if floor is None else [*steps, Step('noise floor', floor, FLOOR, group)]


def add_alternatives(page: Page, diagnosis: Diagnosis) -> None:
    """Add the table of candidates, indistinguishable effects, and untested ones."""
    page.heading('What else it could be')
    alike = diagnosis_text.alike(diagnosis)
    if len(diagnosis.cannot_tell_apart) > 1:
        names = listed(diagnosis.cannot_tell_apart, 'or')
        lines = [f'These postures cannot tell {names} apart.']
        lines += [f'{alike}.'] if alike and diagnosis.verdict is Verdict.AMBIGUOUS else []
        page.box(map(capital, lines), 'warn', 'Cannot be told apart')
    elif alike:
        page.text(f'{capital(alike)}.')
    if candidates := sorted(diagnosis.candidates, key=lambda row: row.status != 'best'):
        kinds = [{'best': 'strong', 'rejected': 'faint'}.get(one.status, '') for one in candidates]
        with_arm = diagnosis_text.with_arm(diagnosis)
        with_what = 'the effect and the arm as it was found' if with_arm else 'the effect'
        left = [CANDIDATE_HEAD.index(words) for words in ('status', 'value')]
        page.table([CANDIDATE_HEAD, *map(candidate_row, candidates)], kinds, left)
        page.text(
            '“Explains” is the share of the error above the noise floor that goes away; “error '
            f'left” is that of the description with {with_what}; “left-out postures” is the error '
            'on postures left out in turn (of rejected effects by slopes alone); “chance” is that '
            'of so large a remainder if this effect is the whole truth: above '
            f'{P_SINGLE_MIN:g} it may be; “best” is the likeliest of those, or of all where none '
            'may be.'
        )
    texts = diagnosis_text.untested(diagnosis), diagnosis_text.detectable(diagnosis)
    page.text(*(f'{capital(text)}.' for text in texts if text))


def candidate_row(row: CandidateRow) -> list[str]:
    """Return the row of a candidate, with the columns of `CANDIDATE_COLUMNS`."""
    return [cell(row) for cell in CANDIDATE_COLUMNS.values()]


def pushes_of(diagnosis: Diagnosis) -> dict[str, Push]:
    """Return what pushes the arm in each posture, of the first effect that is a force."""
    for effect in diagnosis.effects:
        rows = diagnosis.details.get('pushes', {}).get(effect.name)
        if not rows:
            continue
        largest = max(float(np.linalg.norm(row['force'])) for row in rows)
        fixed = [effect.parameters.get(f'point_{axis}') for axis in 'xyz']
        to = None if None in fixed else np.array([one.value for one in fixed if one])
        wall = 'arc_length' not in effect.parameters
        return {
            row['posture']: Push(np.array(row['at']), np.array(row['force']) / largest, to, wall)
            for row in rows
        }
    return {}


def add_pictures(page: Page, pictures: Pictures, diagnosis: Diagnosis) -> None:
    """Add shapes, errors, heat maps and missing moments, and mark where the model is wrong."""
    (comparison, lacks), details = pictures, diagnosis.details
    faults = details.get('local_faults', ())
    page.heading('Where the model is off')
    if (reference := details.get('reference')) is not None:
        page.text(
            'Measured places are shown without what the arm deviated from its description in '
            f'{reference["data"]}: what is off was not off there.'
        )
    page.text(*(f'{capital(line)}.' for line in where_wrong(faults)))
    page.figures([per_marker(comparison), per_posture(comparison)], 'two')
    if lacks:
        page.text(
            'Deviation to the side, measured minus model, in standard deviations of the noise: '
            'orange bends more than the model, blue less.'
        )
        page.figures(heat_maps(comparison, lacks), 'two')
        page.heading('The moment that the model lacks')
        page.text(
            'Estimated in blocks of cells, with 95 % intervals; positive would bend the arm more. '
            'What it follows hints at its cause; the verdict does not rest on these pictures.'
        )
        page.figures(moments(lacks[0]), 'two')
    add_loops(page, comparison)
    add_shapes(page, comparison, faults, pushes_of(diagnosis))
