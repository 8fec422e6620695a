"""What an addition says in words: the values, and the table of errors."""

from __future__ import annotations

from ..common.words import columns, digits, mm
from ..diagnosis.add import Addition
from ..diagnosis.prediction_errors import Errors
from .numbers import quantities

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
    rows = [['error (rms)', 'before', 'after', 'noise floor', 'gone']]
    return columns(rows + [_row(errors) for errors in (made.fitted, made.check)])


def _row(errors: Errors) -> list[str]:
    count = f'{errors.postures} posture{"" if errors.postures == 1 else "s"}'
    share = errors.gone
    gone = '' if share is None else f'{100.0 * min(share, 1.0):.0f} %'
    where = f'{errors.kind}: {count} of {errors.data}'
    return [where, mm(errors.before), mm(errors.after), mm(errors.floor), gone]


def never_used(made: Addition) -> str:
    """Say in one line what became of the error on postures that were not fitted."""
    check = made.check
    floor = '' if check.floor is None else f'  (floor {mm(check.floor)})'
    which = 'never used' if check.kind == 'check' else 'left out in turn'
    return f'error on postures {which}: {mm(check.before)} -> {mm(check.after)}{floor}'


def warnings(made: Addition) -> list[str]:
    """Say which tolerances moved, what else is at work, and when a check got worse."""
    sentences = []
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
