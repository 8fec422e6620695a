"""The story of `make live` in words, and whether it came true."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..report.words import digits, listed, mm
from .rehearsal import NONE, Hidden

GONE = 0.8  # share of the tip error that must be gone


@dataclass
class Story:
    """What happened: errors in metres, the verdict as published."""

    hidden: Hidden
    verdict: dict[str, Any] = field(default_factory=dict)
    before: float = float('nan')
    after: float = float('nan')
    added: bool = False

    @property
    def named(self) -> bool:
        """Whether the hidden effect is named, or in the stated class."""
        names = [effect['name'] for effect in self.verdict.get('effects', [])]
        return self.hidden.name in (*names, *self.verdict.get('cannot_tell_apart', []))

    @property
    def gone(self) -> float:
        """Share of the tip error that is gone."""
        return 1.0 - self.after / self.before if self.before > 0.0 else float('nan')

    @property
    def problem(self) -> str:
        """Why the story did not come true, '' when it did."""
        verdict = self.verdict.get('verdict', 'no verdict')
        if self.hidden.name == NONE:
            return '' if verdict == 'adequate' else f'nothing was hidden, but: {verdict}'
        if self.hidden.outside:
            called = verdict == 'outside_catalogue'
            return '' if called else f'{self.hidden.name} is outside the catalogue, but: {verdict}'
        if verdict == 'outside_catalogue' or not self.named:
            return f'{self.hidden.name} was hidden, but the verdict is {verdict}'
        if not self.added:
            return 'the controller did not take the new description'
        if not self.gone >= GONE:
            return f'only {100.0 * self.gone:.0f} % of the tip error is gone'
        return ''

    def end(self) -> str:
        """Return the last line."""
        if self.problem:
            return f'the story did not come true: {self.problem}'
        if self.added:
            return (
                f'tip error on postures never used: {mm(self.before)} -> {mm(self.after)} '
                f'({100.0 * self.gone:.0f} % gone)'
            )
        quiet = 'nothing was hidden and nothing was found'
        return quiet if self.hidden.name == NONE else 'a cause that no effect describes: called so'


def reveal(hidden: Hidden, units: dict[str, str]) -> str:
    """Say what was hidden; units by parameter."""
    values = [
        f'{key} = {listed(digits(v, 3) for v in np.atleast_1d(value))} {units.get(key, "1")}'
        for key, value in hidden.values.items()
        if np.any(value)
    ]
    return f'hidden: {hidden.name} {", ".join(values)}'.rstrip()
