"""What remains unexplained, in plain words from the patterns that fit it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .candidates import Ranked
from .noise import rms
from .patterns import Pattern, Rivals

if TYPE_CHECKING:
    from .evidence import Evidence


def remainder_text(found: Evidence, chosen: Ranked | None, verdict: str) -> str:
    """Say how much remains after the chosen effects (or none), and what it looks like."""
    session = found.session
    fit = chosen.fit if chosen else found.base
    left, floor = rms(session.dataset.mean - fit.markers), session.whitener.floor()
    text = f'What is left ({1e3 * left:.2f} mm) ' + (
        f'equals your repeatability ({1e3 * floor:.2f} mm).'
        if left < 1.25 * floor
        else f'is {left / floor:.1f} times your repeatability ({1e3 * floor:.2f} mm).'
    )
    if verdict != 'outside_catalogue':
        return text
    pattern = found.rival or best_pattern(found, chosen)
    return f'{text} {pattern_text(found, pattern)}' if pattern else f'{text} {_worst(found, fit)}'


def best_pattern(found: Evidence, chosen: Ranked | None) -> Pattern | None:
    """Return the pattern that takes a third or more of what is left, if there is one."""
    fit = chosen.fit if chosen else found.base
    patterns = Rivals(found.session.fitters[0], fit).all()
    top = min(patterns, key=lambda pattern: pattern.score, default=None)
    excess = fit.chi2 - fit.freedom
    if top is None or fit.chi2 - top.chi2 < 0.33 * excess:
        return None
    return top


def pattern_text(found: Evidence, pattern: Pattern) -> str:
    """Describe a pattern so that a person knows where to look."""
    names = found.session.dataset.postures
    if pattern.name == 'soft_cell':
        return (
            f'The remainder is the same in every posture: cell {pattern.cell} bends '
            f'{pattern.size:.1f} times as much as it should. Look at that cell.'
        )
    if pattern.name == 'taper':
        way = 'stiffer' if pattern.size > 0.0 else 'softer'
        return (
            f'The remainder is the same in every posture: the arm is {way} towards the tip, '
            f'by {100.0 * abs(pattern.size):.0f} % from base to tip.'
        )
    values = np.array(pattern.values)
    worst = names[int(np.argmax(np.abs(values)))]
    if pattern.name == 'gain_per_posture':
        return (
            f'The remainder looks like tensions that were not what was set: by '
            f'{100.0 * np.std(values):.1f} % (sd) from posture to posture, most in {worst}. '
            'Check how tensions are set, or declare tension_noise: setting.'
        )
    return (
        'The remainder looks like a base that turns from posture to posture: by '
        f'{np.degrees(np.max(np.abs(values))):.1f}° in {worst}. Check the mount.'
    )


def _worst(found: Evidence, fit: object) -> str:
    dataset = found.session.dataset
    markers = fit.markers  # type: ignore[attr-defined]
    distance = np.linalg.norm(dataset.mean - markers, axis=2)
    posture, marker = np.unravel_index(np.nanargmax(distance), distance.shape)
    return (
        f'No pattern fits it. It is largest in posture {dataset.postures[posture]} at marker '
        f'{dataset.markers[marker].name} ({1e3 * distance[posture, marker]:.1f} mm).'
    )
