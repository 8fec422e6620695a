"""What an addition says in words: the values, and the table of errors."""

from __future__ import annotations

import math

from ..common.words import columns, digits, mm, percent
from ..diagnosis.add import Addition
from ..diagnosis.prediction_errors import Errors
from .numbers import quantities

AS_FOUND = (
    'with the effects and the arm as it was found beside them (tolerances that moved, cells, '
    'tendons, tracker), which the file holds, too'
)
NOT_WRITTEN = 'Nothing was written: the error on postures that were not used would rise.'


def addition_lines(made: Addition) -> list[str]:
    """Return values, errors, tolerances and warnings."""
    lines = [
        f'{name}: {quantities(values, made.loads.get(name))}'
        for name, values in made.values.items()
    ]
    lines.append(error_table(made))
    lines += warnings(made)
    return lines


def error_table(made: Addition) -> str:
    """Return the table of errors before, after, and of a perfect model."""
    alone = ['effects alone'] if made.beside else []
    rows = [['error (rms)', 'before', *alone, 'after', 'noise floor', 'gone']]
    return columns(rows + [_row(errors, made.beside) for errors in (made.fitted, made.check)])


def _row(errors: Errors, beside: bool) -> list[str]:
    count = f'{errors.postures} posture{"" if errors.postures == 1 else "s"}'
    share = errors.gone
    gone = '' if share is None else percent(share)
    where = f'{errors.kind}: {count} of {errors.data}'
    alone = [_alone(errors)] if beside else []
    return [where, mm(errors.before), *alone, mm(errors.after), mm(errors.floor), gone]


def _alone(errors: Errors) -> str:
    """Show the error of the effects alone; without the arm as found there may be no shape."""
    known = errors.alone is not None and math.isfinite(errors.alone)
    return mm(errors.alone) if known else 'no equilibrium'


def never_used(made: Addition) -> str:
    """Say in one line what became of the error on postures that were not fitted."""
    check = made.check
    floor = '' if check.floor is None else f'  (floor {mm(check.floor)})'
    which = 'never used' if check.kind == 'check' else 'left out in turn'
    return f'error on postures {which}: {mm(check.before)} -> {mm(check.after)}{floor}'


def warnings(made: Addition) -> list[str]:
    """Say what else is written and at work, which tolerances moved, when a check got worse."""
    sentences = []
    if made.beside:
        sentences.append(f'after: {AS_FOUND}')
    if made.moved:
        moves = ', '.join(f'{name} by {digits(z)} sd' for name, z in made.moved.items())
        where = 'in the file, too' if made.beside else 'not in the file'
        sentences.append(f'declared tolerances moved in the fit: {moves} ({where})')
    if made.accuracy:
        sentences.append(f'weighed by the declared accuracy of {mm(made.accuracy, 2)}')
    if made.more_at_work:
        sentences.append(f'note: {made.more_at_work}')
    if made.check.after > made.check.before:
        sentences.append(
            'note: the error on postures that were not fitted grew; do not use these values'
        )
    return sentences
