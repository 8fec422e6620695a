"""What `improve` says: the table of the falling error, the values, what remains."""

from __future__ import annotations

import math

import numpy as np

from ..common.words import columns, digits, mm, probability
from ..diagnosis.improvement import Floats, Improvement, ImprovementStep, total
from .local_text import where_wrong
from .numbers import quantities

MARKERS_SHOWN_MAX = 4  # markers up to which each has its own number
WORST_POSTURES = 3  # that are named
NOT_WRITTEN = 'Nothing was written: there is no step that lowers the error on left-out postures.'


def lines(found: Improvement) -> list[str]:
    """Return the table of the steps, values, and what remains."""
    made = [columns(table(found)), *sentences(found)]
    made += [f'{name}: {quantities(values)}' for name, values in found.values.items()]
    return [*made, *profile(found), *remains(found)]


def table(found: Improvement) -> list[list[str]]:
    """Return a row per step: errors by kind, and what the step took off the left-out one."""
    kinds = list(found.steps[0].errors)
    where = ' '.join(found.markers) if len(found.markers) <= MARKERS_SHOWN_MAX else 'all, tip'
    rows = [['', *(f'{kind} {where} [mm]' for kind in kinds), 'took off, left out']]
    for k, step in enumerate(found.steps):
        errors = [numbers(step.errors[kind]) for kind in kinds]
        rows.append([_named(found, k), *errors, _fall(step) if k else ''])
    return rows


def numbers(errors: Floats) -> str:
    """Show rms errors (J,) [m] in mm: of every marker, or of all and of the last one."""
    shown = errors if len(errors) <= MARKERS_SHOWN_MAX else np.array([total(errors), errors[-1]])
    return ' '.join(digits(1e3 * error, 3) for error in shown.tolist())


def _named(found: Improvement, k: int) -> str:
    label = found.steps[k].label
    return label if k <= found.taken else f'not taken: {label.removeprefix("+ ")}'


def _fall(step: ImprovementStep) -> str:
    scatter = digits(1e3 * step.scatter)
    places = len(scatter.partition('.')[2])
    return f'{1e3 * step.fall:.{places}f} ± {scatter} mm'


def sentences(found: Improvement) -> list[str]:
    """Say how far the error falls, and why no further."""
    first, last = found.steps[0], found.steps[found.taken]
    inside, before = found.chosen, total(first.left_out)
    said = [
        f'Postures that had no part in the search are predicted to {mm(total(last.left_out))} '
        f'({mm(float(last.left_out[-1]))} at marker {found.markers[-1]}), by the description as '
        f'it was to {mm(before)}; the noise floor is {mm(found.noise_floor)}.',
        'Where the number of steps is chosen without them as well: '
        f'{mm(total(inside))} ({mm(float(inside[-1]))} at marker {found.markers[-1]}).',
    ]
    if found.taken + 1 < len(found.steps):
        said.append('It stops there: what follows takes off no more than its scatter.')
    elif not found.more_at_work:
        said.append(f'It stops there: what remains is noise ({probability(found.probability)}).')
    else:
        said.append('It stops there: no other effect promises to lower the error.')
    return said


def profile(found: Improvement) -> list[str]:
    """Say how the stiffness along the arm and the routes of the tendons have changed."""
    said = []
    if found.routes:
        turns = ', '.join(
            f'{name} by {degrees(turn)}, winding by {degrees(helix)}/m'
            for name, (turn, helix) in found.routes.items()
        )
        said.append(f'tendon_routes, turned about the axis: {turns}')
    if not found.profile:
        return said
    places = zip(('base', 'middle', 'tip'), found.profile, strict=True)
    changes = ', '.join(f'{100.0 * change:+.0f} % at the {where}' for where, change in places)
    return [*said, f'bending_stiffness along the arm: {changes}']


def degrees(radians: float) -> str:
    """Show an angle."""
    return f'{math.degrees(radians):.1f}°'


def remains(found: Improvement) -> list[str]:
    """Say what is not explained: the worst postures, places, and that more is at work."""
    worst = sorted(found.tips.items(), key=lambda item: -item[1])[:WORST_POSTURES]
    named = ', '.join(f'posture {posture} ({mm(error)})' for posture, error in worst)
    said = [
        f'worst at marker {found.markers[-1]} when left out: {named}',
        *where_wrong(found.local_faults),
    ]
    return [*said, f'note: {found.more_at_work}'] if found.more_at_work else said
