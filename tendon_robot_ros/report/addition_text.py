"""What an addition says in words: the values, and the table of errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..common.words import columns, digits, listed, mm, percent
from ..diagnosis.add import Addition
from .numbers import quantities

AS_FOUND = 'with the effects and the arm as it was found beside them'
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
    table = [['error (rms)', 'before', *alone, 'after', 'noise floor', 'gone']]
    for errors in (made.fitted, made.check):
        count = f'{errors.postures} posture{"" if errors.postures == 1 else "s"}'
        numbers = [mm(errors.before), mm(errors.after), mm(errors.floor)]
        if made.beside:  # the effects alone; without the arm as found there may be no shape
            known = errors.alone is not None and math.isfinite(errors.alone)
            numbers.insert(1, mm(errors.alone) if known else 'no equilibrium')
        gone = '' if errors.gone is None else percent(errors.gone)
        table.append([f'{errors.kind}: {count} of {errors.data}', *numbers, gone])
    return columns(table)


def never_used(made: Addition) -> str:
    """Say in one line what became of the error on postures that were not fitted."""
    check = made.check
    floor = '' if check.floor is None else f'  (floor {mm(check.floor)})'
    which = 'never used' if check.kind == 'check' else 'left out in turn'
    return f'error on postures {which}: {mm(check.before)} -> {mm(check.after)}{floor}'


def also_written(made: Addition) -> list[str]:
    """Name what the file says otherwise than the description before, beside the effects added."""
    robot, before = made.robot, made.described
    if before is None:
        return []
    said = []
    stiffness = _changes(
        [k for s in before.sections for k in s.bending_stiffness],
        [k for s in robot.sections for k in s.bending_stiffness],
    )
    if stiffness:
        said.append(f'stiffness of {_count(stiffness, "cell")}')
    offsets = _changes(*([np.hypot(*t.base) for t in one.tendons] for one in (before, robot)))
    if offsets:
        said.append(f'offset of {_count(offsets, "tendon")}')
    said += [
        name
        for name, values in robot.effects.items()
        if name not in made.values and values != before.effects.get(name)
    ]
    return [*said, 'gravity'] if robot.gravity != before.gravity else said


def _changes(before: Sequence[float], after: Sequence[float]) -> list[float]:
    """Return the relative changes of those values that changed."""
    pairs = zip(before, after, strict=True)
    return [float(new / old - 1.0) for old, new in pairs if new != old and old]


def _count(changes: Sequence[float], what: str) -> str:
    """Say how many changed, and between which changes."""
    low, high = (f'{100.0 * change:+.2g}' for change in (min(changes), max(changes)))
    size = f'{low} %' if low == high else f'{low} to {high} %'
    return f'{len(changes)} {what}{"" if len(changes) == 1 else "s"} ({size})'


def warnings(made: Addition) -> list[str]:
    """Say what else is written and at work, which tolerances moved, when a check got worse."""
    sentences = []
    if made.beside:
        also = also_written(made)
        sentences.append(f'after: {AS_FOUND}; the file holds that, too: {listed(also)}')
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
