"""The next measurement in words."""

from __future__ import annotations

import numpy as np

from ..analysis.result import Diagnosis, NextMeasurement
from .words import commands, digits, listed, mm

TRIALS = 5


def next_measurement(found: Diagnosis) -> str:
    """Say what to measure next, and what that will show."""
    step = found.next_measurement
    if step is None:
        return ''
    names = found.cannot_tell_apart
    if step.difference < 2.0 * step.noise / np.sqrt(TRIALS):
        return (
            f'No posture within the limits separates {listed(names)}: they differ by '
            f'{_small(step.difference)} at most, your noise is {mm(step.noise, 2)}. '
            'Either describes this robot; measure the quantity itself to know which it is.'
        )
    kind = found.details.get('input', 'tension')
    where = commands(dict(step.input), kind)
    if step.gravity is not None:
        down = ', '.join(digits(g, 3) for g in step.gravity)
        where += f', with the base turned so that gravity is [{down}] m/s²'
    if step.after is not None:
        where += f', coming from {commands(dict(step.after), kind)}'
    return f'Measure this next: {where}, {TRIALS} trials. {_predicted(step)}'


def _small(metres: float) -> str:
    return mm(metres, 2) if metres >= 1e-5 else 'less than 0.01 mm'


def _predicted(step: NextMeasurement) -> str:
    """Say which prediction stands apart from the others, and by how much."""
    names, tips = list(step.predictions), np.array(list(step.predictions.values()))
    end = f'your noise there is {mm(step.noise, 2)}.'
    if len(names) < 2:
        return f'The predictions differ by {mm(step.difference, 2)} at the tip; {end}'
    apart = np.linalg.norm(tips[:, None] - tips[None, :], axis=2)
    nearest = np.where(np.eye(len(names), dtype=bool), np.inf, apart).min(axis=1)
    odd = int(np.argmax(nearest))
    if len(names) == 2:
        return f'{listed(names)} predict tips {mm(step.difference, 2)} apart; {end}'
    if nearest[odd] < step.noise:
        return f'The predictions differ by up to {mm(step.difference, 2)} at the tip; {end}'
    return (
        f'{names[odd]} predicts the tip at least {mm(float(nearest[odd]), 2)} from the '
        f'others; {end}'
    )
