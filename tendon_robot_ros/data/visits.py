"""Visits: settled postures in any order, which the command before tells apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..common.arrays import RESOLUTION, Bools, Floats, Ints, simplified
from ..robot.estimates import INPUT_TOLERANCE

OF_A_VISIT = ('fresh', 'counts', 'trials')  # arrays (V,) of `Visits`
STRAIGHT = -1  # [1] index of the straight arm as the command before, so that it is no command


@dataclass(frozen=True, eq=False)
class Visits:
    """
    The history of the P postures of a data set: V visits, one after the other.

    A posture is a command and the command before it. A visit that was measured is a trial of its
    posture; what a model says of the posture is the mean over these visits.
    """

    commands: tuple[str, ...]  # (P,) what was commanded, by the name that files give it
    rows: Ints  # (V,) index of the posture that was visited
    fresh: Bools  # (V,) whether the arm came from straight; else from the visit before
    counts: Bools  # (V,) whether it was measured
    trials: Ints  # (V,) index of the trial that it was; -1: more than one, or none

    @property
    def origins(self) -> tuple[str, ...]:
        """Return the command (P,) that the arm came from; an empty name is the straight arm."""
        origins = [''] * len(self.commands)
        for v in np.argsort(self.counts, kind='stable').tolist():  # what counts has the last word
            origins[self.rows[v]] = '' if self.fresh[v] else self.commands[self.rows[v - 1]]
        return tuple(origins)

    def among(self, postures: Ints) -> Visits:
        """Return the visits to some postures; no other may lie between them."""
        place = np.full(len(self.commands), -1)
        place[postures] = np.arange(len(postures))
        own, commands = place[self.rows] >= 0, tuple(self.commands[i] for i in postures.tolist())
        each = {key: getattr(self, key)[own] for key in OF_A_VISIT}
        return Visits(commands, place[self.rows[own]], **each)

    def masked(self, mask: Bools) -> Visits:
        """Return the same visits, of which only those of trials in a mask (P, Q) are measured."""
        known = self.trials >= 0
        counts = self.counts.copy()
        counts[known] &= mask[self.rows[known], self.trials[known]]
        return replace(self, counts=counts)

    def legs(self) -> list[slice]:
        """Return the visits from one straight arm to the next."""
        begins = np.flatnonzero(self.fresh).tolist()
        return [slice(a, b) for a, b in zip(begins, [*begins[1:], len(self.rows)], strict=True)]

    def mean(self, observed: Floats) -> Floats:
        """Average observations (V, ...) of the visits over those of each posture, (P, ...)."""
        measured = np.zeros(len(self.commands), dtype=bool)
        measured[self.rows[self.counts]] = True
        used = self.counts | ~measured[self.rows]
        total = np.zeros((len(self.commands), *observed.shape[1:]))
        np.add.at(total, self.rows[used], observed[used])
        number = np.bincount(self.rows[used], minlength=len(self.commands))
        return total / number.reshape(-1, *(1,) * (observed.ndim - 1))

    @property
    def last(self) -> Ints:
        """Return the last visit (P,) to each posture."""
        last = np.zeros(len(self.commands), dtype=np.int64)
        last[self.rows] = np.arange(len(self.rows))
        return last


def corners(path: Floats, kept: Ints) -> Ints:
    """
    Return the rows between which a path (P, m) is straight, the rows in `kept` among them.

    Every other row lies no further beside the straight line than twice `INPUT_TOLERANCE` of the
    largest value (Ramer 1972, Douglas and Peucker 1973).
    """

    def beside(a: int, b: int) -> Floats:
        way, between = path[b] - path[a], path[a + 1 : b] - path[a]
        along = np.clip(between @ way / max(float(way @ way), RESOLUTION**2), 0.0, 1.0)
        return np.asarray(np.abs(between - along[:, None] * way).max(axis=1, initial=0.0))

    limit = 2.0 * INPUT_TOLERANCE * float(np.abs(path).max())
    return np.array(simplified({0, *kept.tolist()}, limit, beside))


# [1] times through its range that what an input did before is remembered, because plays and bends
# that lag have then followed it once up and once down
RANGES_REMEMBERED = 2.0


def remembered(path: Floats, kept: Ints) -> Ints:
    """
    Return the rows of a path (P, m) that an arm may remember at the rows in `kept`.

    It has forgotten a row after which every input has travelled `RANGES_REMEMBERED` before the
    next kept one.
    """
    travel = np.abs(np.diff(path, axis=0, prepend=path[:1])).cumsum(axis=0)
    ahead = kept[np.searchsorted(kept, np.arange(len(path)))]
    far = travel[ahead] - travel >= RANGES_REMEMBERED * np.ptp(path, axis=0)
    return np.flatnonzero(~far.all(axis=1) | (ahead == np.arange(len(path))))


def join_visits(parts: Sequence[Visits]) -> Visits:
    """Return the visits of several data sets whose postures follow each other."""
    begins = np.cumsum([0, *(len(part.commands) for part in parts)])
    rows = [part.rows + begin for part, begin in zip(parts, begins[:-1], strict=True)]
    each = {key: np.concatenate([getattr(part, key) for part in parts]) for key in OF_A_VISIT}
    commands = tuple(name for part in parts for name in part.commands)
    return Visits(commands, np.concatenate(rows), **each)


@dataclass(frozen=True, eq=False)
class Split:
    """Commands split into postures by the command before."""

    visits: Visits
    postures: tuple[str, ...]  # (P,) 'bent after rest'
    command: Ints  # (P,) index of the command
    posture: Ints  # (R,) index of the posture of each row that was split


def split_by_order(
    names: Sequence[str], commands: Ints, trials: Ints, measured: Bools, fresh: Bools | None = None
) -> Split:
    """
    Split commands (V,) that followed each other.

    The first came from the straight arm, and every one that is `fresh` (V,).
    """
    fresh = np.arange(len(commands)) == 0 if fresh is None else fresh
    before = np.where(fresh, STRAIGHT, np.append(STRAIGHT, commands[:-1]))
    pairs, posture = _pairs(commands, before)
    return _split(names, pairs, posture, Visits((), posture, fresh, measured, trials))


def split_by_origin(names: Sequence[str], commands: Ints, before: Ints, measured: Bools) -> Split:
    """Split rows (R,) by their given command before, which the arm reached from straight."""
    pairs, posture = _pairs(commands, before)
    present = np.isin(np.arange(len(pairs)), posture[measured])
    each: list[tuple[int, bool, bool]] = []  # row, fresh, counts
    for p, (_, origin) in enumerate(pairs.tolist()):
        if origin != STRAIGHT:
            each.append((int(np.flatnonzero(pairs[:, 0] == origin)[0]), True, False))
        each.append((p, origin == STRAIGHT, bool(present[p])))
    rows, fresh, counts = (np.array(column) for column in zip(*each, strict=True))
    visits = Visits((), rows, fresh, counts, np.full(len(rows), -1))
    return _split(names, pairs, posture, visits)


def _pairs(commands: Ints, before: Ints) -> tuple[Ints, Ints]:
    pairs, posture = np.unique(np.stack([commands, before], 1), axis=0, return_inverse=True)
    return pairs, posture.reshape(-1)


def _split(names: Sequence[str], pairs: Ints, posture: Ints, visits: Visits) -> Split:
    commands = tuple(names[command] for command in pairs[:, 0].tolist())
    origins = ['the straight arm' if b == STRAIGHT else names[b] for b in pairs[:, 1].tolist()]
    labels = tuple(f'{c} after {b}' for c, b in zip(commands, origins, strict=True))
    return Split(replace(visits, commands=commands), labels, pairs[:, 0], posture)
