"""Settled visits in any order: postures of one command that differ by the command before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
STRAIGHT = -1  # [1] index of the straight arm as the command before, so that it is no command


@dataclass(frozen=True, eq=False)
class Visits:
    """
    The history of the P postures of a data set: V visits, one after the other.

    A posture is a command and the command before it. A visit that was measured is a trial of its
    posture; what a model says of the posture is the mean over these visits.
    """

    commands: tuple[str, ...]  # (P,) what was commanded, by the name that files give it
    rows: IntArray  # (V,) index of the posture that was visited
    fresh: BoolArray  # (V,) whether the arm came from straight; else from the visit before
    counts: BoolArray  # (V,) whether it was measured
    trials: IntArray  # (V,) index of the trial that it was; -1: more than one, or none

    @property
    def in_one_go(self) -> bool:
        """Whether the arm was straight before the first visit only."""
        return not self.fresh[1:].any()

    @property
    def origins(self) -> tuple[str, ...]:
        """Return the command (P,) that the arm came from; an empty name is the straight arm."""
        origins = [''] * len(self.commands)
        for v in np.argsort(self.counts, kind='stable').tolist():  # what counts has the last word
            row = self.rows[v]
            origins[row] = '' if self.fresh[v] else self.commands[self.rows[v - 1]]
        return tuple(origins)

    def among(self, postures: IntArray) -> Visits:
        """Return the visits to some postures; no other may lie between them."""
        place = np.full(len(self.commands), -1)
        place[postures] = np.arange(len(postures))
        own = place[self.rows] >= 0
        return Visits(
            tuple(self.commands[i] for i in postures.tolist()),
            place[self.rows[own]],
            self.fresh[own],
            self.counts[own],
            self.trials[own],
        )

    def masked(self, mask: BoolArray) -> Visits:
        """Return the same visits, of which only those of trials in a mask (P, Q) are measured."""
        known = self.trials >= 0
        counts = self.counts.copy()
        counts[known] &= mask[self.rows[known], self.trials[known]]
        return replace(self, counts=counts)

    def legs(self) -> list[slice]:
        """Return the visits from one straight arm to the next."""
        begins = np.flatnonzero(self.fresh).tolist()
        return [slice(a, b) for a, b in zip(begins, [*begins[1:], len(self.rows)], strict=True)]

    def mean(self, observed: NDArray[np.float64]) -> NDArray[np.float64]:
        """Average observations (V, ...) of the visits over those of each posture, (P, ...)."""
        measured = np.zeros(len(self.commands), dtype=bool)
        measured[self.rows[self.counts]] = True
        used = self.counts | ~measured[self.rows]
        total = np.zeros((len(self.commands), *observed.shape[1:]))
        np.add.at(total, self.rows[used], observed[used])
        number = np.bincount(self.rows[used], minlength=len(self.commands))
        return total / number.reshape(-1, *(1,) * (observed.ndim - 1))

    @property
    def last(self) -> IntArray:
        """Return the last visit (P,) to each posture."""
        last = np.zeros(len(self.commands), dtype=np.int64)
        last[self.rows] = np.arange(len(self.rows))
        return last


def joined(parts: Sequence[Visits]) -> Visits:
    """Return the visits of several data sets whose postures follow each other."""
    begins = np.cumsum([0, *(len(part.commands) for part in parts)])
    return Visits(
        tuple(name for part in parts for name in part.commands),
        np.concatenate([part.rows + b for part, b in zip(parts, begins[:-1], strict=True)]),
        np.concatenate([part.fresh for part in parts]),
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.trials for part in parts]),
    )


@dataclass(frozen=True, eq=False)
class Split:
    """Commands split into postures by the command before."""

    visits: Visits
    postures: tuple[str, ...]  # (P,) 'bent after rest'
    command: IntArray  # (P,) index of the command
    posture: IntArray  # (R,) index of the posture of each row that was split


def split_by_order(
    names: Sequence[str],
    commands: IntArray,
    trials: IntArray,
    measured: BoolArray,
    fresh: BoolArray | None = None,
) -> Split:
    """
    Split commands (V,) that followed each other.

    The first came from the straight arm, and every one that is `fresh` (V,).
    """
    fresh = np.arange(len(commands)) == 0 if fresh is None else fresh
    before = np.where(fresh, STRAIGHT, np.append(STRAIGHT, commands[:-1]))
    pairs, posture = _pairs(commands, before)
    return _split(names, pairs, posture, Visits((), posture, fresh, measured, trials))


def split_by_origin(
    names: Sequence[str], commands: IntArray, before: IntArray, measured: BoolArray
) -> Split:
    """Split rows (R,) by their given command before, which the arm reached from straight."""
    pairs, posture = _pairs(commands, before)
    present = np.zeros(len(pairs), dtype=bool)
    present[posture[measured]] = True
    row, fresh, counts = [], [], []
    for p, (_, origin) in enumerate(pairs.tolist()):
        if origin != STRAIGHT:
            row.append(int(np.flatnonzero(pairs[:, 0] == origin)[0]))
            fresh.append(True)
            counts.append(False)
        row.append(p)
        fresh.append(origin == STRAIGHT)
        counts.append(bool(present[p]))
    visits = Visits((), np.array(row), np.array(fresh), np.array(counts), np.full(len(row), -1))
    return _split(names, pairs, posture, visits)


def _pairs(commands: IntArray, before: IntArray) -> tuple[IntArray, IntArray]:
    pairs, posture = np.unique(np.stack([commands, before], 1), axis=0, return_inverse=True)
    return pairs, posture.reshape(-1)


def _split(names: Sequence[str], pairs: IntArray, posture: IntArray, visits: Visits) -> Split:
    commands = tuple(names[command] for command in pairs[:, 0].tolist())
    origins = ['the straight arm' if b == STRAIGHT else names[b] for b in pairs[:, 1].tolist()]
    labels = tuple(f'{c} after {b}' for c, b in zip(commands, origins, strict=True))
    return Split(replace(visits, commands=commands), labels, pairs[:, 0], posture)
