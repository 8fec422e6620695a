"""Two senders of one topic, or two times in one recording: messages of two states in turn."""

from __future__ import annotations

import numpy as np

from ...common.errors import DataSetError
from ...common.words import listing
from ..dataset import FloatArray
from .reader import Recording

# Messages are looked at in groups. In a group of two senders values are of two kinds, apart by
# more than what they vary within a kind, and the kinds take turns; one sender's values step once.
GROUP = 12  # messages
TURNS_MIN = 4  # from one kind to the other in a group
FEWEST = 3  # messages of a kind in a group
APART_SHARE = 0.1  # of what a value goes through in the recording: less is noise and resolution
GROUPS_MIN = 3  # of a recording: fewer are readings that fail
# What does not move is nothing but noise, and some groups of that look so: of values that are
# drawn evenly 0.006 of the groups, of normal ones 0.0008 (counted in 400,000 groups).
CHANCE = 0.006
DEVIATIONS = 6.0  # standard deviations above that number of groups are no chance


def refuse_two_senders(recording: Recording, inputs: FloatArray) -> None:
    """
    Refuse a recording in which messages about two different states take turns.

    Parameters
    ----------
    recording : Recording
    inputs : (T, m) [N] or [m]
        At its `state_times`.

    Raises
    ------
    DataSetError
        Two programs publish one topic, or a clock was set back: what, from when to when.

    """
    states = _taking_turns(recording.state_times, inputs)
    shapes = [
        _taking_turns(track.times, track.positions.reshape(len(track.times), -1))
        for track in recording.tracks
    ]
    shape = next((one for one in shapes if one is not None), None)
    if states is not None and shape is not None:
        raise DataSetError(
            recording.name,
            f'from {states[0]:.1f} to {states[1]:.1f} s inputs and markers of two different times '
            'take turns: the clock was set back while it was recorded, or two arms publish',
            'record it again with a clock that runs on, or cut it there',
        )
    if states is not None:
        names = sorted({state.header.frame_id for state in recording.states} - {''})
        named = len(names) > 1  # programs that write a name of their own there
        who = f' ({listing(names)})' if named else ''
        which = '' if named else ' (ros2 topic info --verbose names them while they run)'
        remedy = f', or keep one: --sender {names[0]!r}' if named else ''
        raise DataSetError(
            recording.name,
            f'two programs publish the tendon states{who}: from {states[0]:.1f} to '
            f'{states[1]:.1f} s they differ by up to {states[2]:.3g}',
            f'end one of them{which} and record again{remedy}',
        )
    if shape is not None:
        raise DataSetError(
            recording.name,
            f'two programs publish markers on one topic: from {shape[0]:.1f} to {shape[1]:.1f} s '
            f'places differ by up to {1e3 * shape[2]:.3g} mm',
            'end one of them and record again, or give each a topic of its own',
        )


def _taking_turns(times: FloatArray, values: FloatArray) -> tuple[float, float, float] | None:
    """Return begin, end [s] and difference where values (S, n) of two kinds take turns."""
    count = len(times) // GROUP
    if not count:
        return None
    values = values[:, np.isfinite(values).any(axis=0)]
    if not values.shape[1]:
        return None
    low, high = np.nanquantile(values, [0.01, 0.99], axis=0)
    spread = high - low
    groups = values[: count * GROUP].reshape(count, GROUP, -1)
    order = np.sort(groups, axis=1)
    gaps = np.nan_to_num(np.diff(order, axis=1))  # (count, GROUP - 1, n)
    at = gaps.argmax(axis=1)[:, None]
    gap = np.take_along_axis(gaps, at, axis=1)
    above = groups > np.take_along_axis(order, at, axis=1)
    turns = (above[:, 1:] != above[:, :-1]).sum(axis=1)  # (count, n)
    within = np.ptp(np.where(np.isfinite(groups), groups, order[:, :1]), axis=1) - gap[:, 0]
    many = above.sum(axis=1)
    found = (turns >= TURNS_MIN) & (gap[:, 0] > within) & (gap[:, 0] > APART_SHARE * spread)
    found &= (many >= FEWEST) & (many <= GROUP - FEWEST) & (spread > 0.0)
    chance = CHANCE * count
    found &= found.sum(axis=0) >= max(GROUPS_MIN, chance + DEVIATIONS * np.sqrt(chance))
    where = np.flatnonzero(found.any(axis=1))
    if not len(where):
        return None
    largest = np.where(found, gap[:, 0], 0.0).max(axis=1)
    begin, end = times[where[0] * GROUP], times[min((where[-1] + 1) * GROUP, len(times) - 1)]
    return float(begin), float(end), float(largest.max())
