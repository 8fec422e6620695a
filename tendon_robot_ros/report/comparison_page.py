"""The page that `compare --report` writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..common.words import capital, mm
from ..comparison.result import Comparison
from . import comparison_text as say
from .arm_text import Fault, left_out
from .error_plots import Step, angles, per_marker, per_posture, staircase, tip_boxes
from .page import Page
from .shape_plots import chosen_postures, shape_figures, shape_key

POSTURES_WITH_ANGLES = 4  # postures whose angular displacements are drawn: two rows


def write_comparison(comparison: Comparison, path: str | Path) -> Path:
    """Write the page; it opens without a network."""
    return comparison_page(comparison).write(path)


def comparison_page(comparison: Comparison) -> Page:
    """Return the page: what to know first, with what was left out, then errors, shapes."""
    measured = comparison.measured
    page = Page(f'Models against measurements: {measured.data}', say.size(comparison))
    add_verdict(page, comparison)
    said = left_out({'outliers': measured.left_out})
    page.text(*(f'{capital(line)}.' for line in said))
    add_errors(page, comparison)
    add_shapes(page, comparison)
    add_angles(page, comparison)
    return page


def add_verdict(page: Page, comparison: Comparison) -> None:
    """Add the verdict, the table of models and the tests between them."""
    floor = comparison.noise_floor
    good = floor is not None and comparison.best.rms < say.GOOD_WITHIN_FLOORS * floor
    worst = capital(say.where_worst(comparison))
    lines = [say.verdict(comparison), worst, say.next_step(comparison)]
    page.box(filter(None, lines), 'verdict good' if good else 'verdict')
    header = ['model', *say.error_columns(comparison)]
    rows = [[say.label(m), *say.errors(comparison, m)] for m in comparison.models]
    kinds = ['strong' if model is comparison.best else '' for model in comparison.models]
    if floor is not None:
        rows.append(['noise floor: a perfect model', mm(floor), '', ''])
        kinds.append('faint')
    page.table(header, rows, kinds)
    tests = [test for test in comparison.paired_t if test.posture is None]
    page.text(*(f'{capital(say.paired(test))}.' for test in tests))
    page.text(
        'Errors are distances between the model and the mean over the trials of a posture; rms is '
        'over postures and markers. The tip error is the distance at the last marker, trial by '
        'trial: the mean over the trials of a posture, then over the postures.'
    )


def add_errors(page: Page, comparison: Comparison) -> None:
    """Add where the models are off."""
    page.heading('Where the models are off')
    figures = [per_marker(comparison), per_posture(comparison), tip_boxes(comparison)]
    figures.append(staircase(steps(comparison), 'Models and noise floor'))
    page.figures(figures, 'two')


def steps(comparison: Comparison) -> list[Step]:
    """Return the staircase of the models, the worst first, down to the noise floor."""
    order = sorted(range(len(comparison.models)), key=lambda i: -comparison.models[i].rms)
    made = [
        Step(comparison.models[i].name, comparison.models[i].rms, 'before', model=i) for i in order
    ]
    floor = comparison.noise_floor
    return [*made, Step('noise floor', floor, 'floor')] if floor is not None else made


def add_shapes(page: Page, comparison: Comparison, faults: Sequence[Fault] = ()) -> None:
    """Add the measured and predicted shapes; what a diagnosis found wrong is marked."""
    page.heading('Shapes')
    drawn, measured = len(chosen_postures(comparison)), int((comparison.measured.trials > 0).sum())
    if drawn < measured:
        page.text(
            f'The {drawn} postures of {measured} that {comparison.best.name} predicts worst.'
        )
    page.key(shape_key(comparison, faults))
    for figures, across in shape_figures(comparison, faults):
        page.figures(figures, across)


def add_angles(page: Page, comparison: Comparison) -> None:
    """Add angular displacements of the worst postures, where the markers tell them."""
    page.heading('Angular displacement')
    if comparison.measured.angles is None:
        page.text(
            'The markers do not lie along the centreline of the arm, so that they do not tell '
            'how much each part of it bends.'
        )
        return
    errors = comparison.best.per_posture_rms
    worst = sorted(chosen_postures(comparison), key=lambda p: -errors[p])[:POSTURES_WITH_ANGLES]
    page.text(
        'The turn from each chord between markers to the next, '
        + ('in the postures that are predicted worst.' if len(worst) > 1 else 'in this posture.')
        + ' Angles are differences of positions and '
        'much less precise than these; the first one counts from the base, half a cell.'
    )
    page.figures([angles(comparison, p) for p in worst], 'two')
