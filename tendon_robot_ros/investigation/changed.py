"""
What has changed since a drift alarm: the postures that separate what it may be.

The monitor has told that the arm is no longer what it was, and what it may be after the postures
that happened to come. Here the arm is driven to the posture at which the likely changes lie
farthest apart, until one of them is likely enough, nothing separates what is left, or the postures
are over. They are the first postures of the investigation that follows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from ..monitoring.change import APART_PROBABILITY, ChangeFinder, Suspect, described
from .arm import PostureMeasured
from .measuring import Measurer, News

Floats = npt.NDArray[np.float64]
ASKED_MAX = 12  # postures after an alarm, at most


def look_after(
    finder: ChangeFinder, measurer: Measurer, offered: Callable[[], Floats]
) -> list[Suspect]:
    """
    Measure the postures that tell a change most; say after each of them what it looks like.

    Parameters
    ----------
    finder : ChangeFinder
        With the postures since the alarm; those that are measured are added.
    measurer : Measurer
    offered : callable
        Returns the tensions (b, m) [N] that may be chosen now.

    Returns
    -------
    list of Suspect
        What is left: the likeliest first, together likely enough.

    """
    suspects = finder.suspects()
    _tell(measurer, suspects)
    for _ in range(min(ASKED_MAX, measurer.most)):
        rows = offered()
        best = finder.most_telling(rows) if len(rows) else None
        if best is None:
            break
        names = [suspect.name for suspect in likely(suspects)]
        why = f'separates {_either(names)}' if len(names) > 1 else f'is to confirm {names[0]}'
        measured = measurer.next(rows[best], why, {'asked': names})
        if measured is not None:
            finder.take(*_mean(rows[best], measured))
            suspects = finder.suspects()
            _tell(measurer, suspects)
    left = likely(suspects)
    if left:
        have = len(measurer.record.dataset.postures)
        content = {'names': [suspect.name for suspect in left], 'postures': have}
        measurer.tell(News('changed', f'  {have} postures: has changed: {sizes(left)}', content))
    return left


def likely(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Return the likeliest changes that are together likely enough."""
    sums = np.cumsum([suspect.probability for suspect in suspects])
    return list(suspects[: int(np.searchsorted(sums, APART_PROBABILITY)) + 1])


def no_effect(left: Sequence[Suspect]) -> bool:
    """Tell whether something has changed that no description has: a cell, a gain, the tracker."""
    return bool(left) and not any(suspect.is_effect for suspect in left)


def sizes(left: Sequence[Suspect]) -> str:
    """Say what has changed, and by how much; several look alike."""
    said = [f'{suspect.name} ({suspect.size})' for suspect in left[:3]]
    more = f' or {len(left) - 3} more' if len(left) > 3 else ''
    return ' or '.join(said) + more


def _either(names: Sequence[str]) -> str:
    more = f' and {len(names) - 3} more' if len(names) > 3 else ''
    return ', '.join(names[:3]) + more


def _mean(inputs: Floats, measured: PostureMeasured) -> tuple[Floats, Floats, int]:
    """Return tensions, markers (J, 3) [m] and frames: all trials of a posture are one."""
    taken = inputs if measured.inputs is None else np.nanmean(measured.inputs, axis=0)
    seen = np.isfinite(measured.positions)
    count = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
    return taken, np.nansum(measured.positions, axis=0) / count, measured.frames


def _tell(measurer: Measurer, suspects: Sequence[Suspect]) -> None:
    have = len(measurer.record.dataset.postures)
    content = {'suspects': [vars(suspect) for suspect in likely(suspects)], 'postures': have}
    measurer.tell(News('change', f'  looks like {described(suspects)}', content))
