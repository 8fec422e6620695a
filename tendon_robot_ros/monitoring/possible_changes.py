"""What may happen to an arm: effects appear, cells get softer, gains move, trackers are bumped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..common.words import digits, mm, spoken, with_unit
from ..comparison.predict import CELLS, FreeParameter, free_parameters
from ..diagnosis.imperfections import GAIN
from ..diagnosis.intervals import load_of, vector_rows
from ..report.numbers import load_words
from .built_arm import BuiltArm

Floats = npt.NDArray[np.float64]
USUAL_CHANGES = {CELLS: 0.1, GAIN: 0.03}  # 1 sd, relative
TRACKER, FRAME = 'the tracker', 'base_misalignment'  # a tracker that was bumped does what it does
SHIFT = 'shift'  # of the frame; the other keys of the effect are a rotation
USUAL_SHIFT, USUAL_ROTATION = 2e-3, 0.01  # [m], [rad] 1 sd of a bumped tracker
SAID_PROBABILITY = 0.05  # of a change, from which it is named
SIZES_TOLD = 2  # parameters of an effect, the largest ones


@dataclass(frozen=True)
class PossibleChange:
    """Something that may have happened: an effect, or imperfections that moved."""

    name: str
    keys: tuple[str, ...]
    spread: Floats  # (k,) 1 sd of its values, as they usually are [their units]
    frees: tuple[FreeParameter, ...] = ()  # of an effect
    members: slice = slice(0)  # among the imperfections of the arm
    gravity: tuple[float, float, float] | None = None  # [m/s²]

    @property
    def is_effect(self) -> bool:
        """Whether the model has parameters for it."""
        return bool(self.frees)

    def suspect(self, probability: float, values: Floats) -> Suspect:
        """Return it with a probability and a size (k,) [its units]."""
        named = dict(zip(self.keys, values.tolist(), strict=True))
        of_catalogue = self.is_effect and self.name != TRACKER
        return Suspect(self.name, probability, named, self._size(values), of_catalogue)

    def _size(self, values: Floats) -> str:
        if self.name == TRACKER:
            moves = np.array([key.startswith(SHIFT) for key in self.keys])
            moved, turned = np.linalg.norm(values[moves]), np.linalg.norm(values[~moves])
            return f'{mm(float(moved), 2)}, {digits(float(np.degrees(turned)))}°'
        if not self.is_effect:
            return f'{100.0 * values[0]:+.1f} %'
        if rows := vector_rows(self.frees, self.name):
            return load_words(load_of(values[rows], None, self.gravity))
        shares = [abs(v) / f.parameter.typical for v, f in zip(values, self.frees, strict=True)]
        parts = []
        for i in np.argsort(shares)[::-1][:SIZES_TOLD]:
            size = f'{spoken(self.keys[i])} {digits(float(values[i]))}'
            parts.append(with_unit(size, self.frees[i].parameter.unit))
        return ', '.join(parts)


@dataclass(frozen=True)
class Suspect:
    """A change that may have happened."""

    name: str
    probability: float  # among all changes, given that there was one
    values: dict[str, float]  # most likely size, by parameter [its unit]
    size: str = ''  # the same in words
    is_effect: bool = True  # of the catalogue; else an imperfection of the arm moved


def changes_of(arm: BuiltArm) -> tuple[PossibleChange, ...]:
    """List what may happen to an arm: effects, single cells, gains, the tracker's frame."""
    made = list[PossibleChange]()
    for effect in arm.catalogue:
        if effect.needs in ('history', 'pulls'):
            continue
        if effect.acts_on and effect.acts_on not in arm.robot.effects:
            continue
        frees = free_parameters(effect, arm.robot)
        usual = np.array([free.parameter.typical for free in frees])
        keys = tuple(free.key for free in frees)
        down = arm.robot.gravity
        name = effect.name
        if name == FRAME:
            name = TRACKER
            usual = np.array(
                [USUAL_SHIFT if k.startswith(SHIFT) else USUAL_ROTATION for k in keys]
            )
        made.append(PossibleChange(name, keys, usual, frees, gravity=down))
    count = 0
    for kind in arm.kinds:
        here, count = range(count, count + len(kind)), count + len(kind)
        usual = np.full(1, USUAL_CHANGES.get(kind.name, 1.0))
        if kind.name in USUAL_CHANGES:
            what = 'stiffness of' if kind.name == CELLS else 'gain of'
            made += [
                PossibleChange(f'{what} {name}', ('relative_change',), usual, (), slice(i, i + 1))
                for i, name in zip(here, kind.members, strict=True)
            ]
    return tuple(made)


def described(suspects: Sequence[Suspect]) -> str:
    """Say what it looks like."""
    named = [
        f'{s.name} ({100.0 * s.probability:.0f} %)'
        for s in suspects
        if s.probability > SAID_PROBABILITY
    ]
    return ', '.join(named) or 'nothing of the catalogue'
