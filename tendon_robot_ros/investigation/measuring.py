"""
Measure postures: a failed one is repeated once, then skipped; regions are kept out.

After a drift alarm, measure the postures that separate the suspected changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import TendonRobotError
from ..common.words import commands
from ..monitoring.change import APART_PROBABILITY, ChangeFinder, Suspect, described
from .choice import Room
from .goal import Goal
from .record import BrokenMeasurementError, MeasurableArm, PostureMeasured, Record


@dataclass(frozen=True)
class News:
    """An event: a line to print, and plain data for a page."""

    # 'posture', 'broken', 'skipped', 'change', 'changed', 'diagnosis', 'end', 'added', 'check'
    kind: str
    text: str
    content: dict[str, Any] = field(default_factory=dict)


Report = Callable[[News], None]


@dataclass
class Measurer:
    """Commands postures to an arm, and records the measurements."""

    arm: MeasurableArm
    record: Record
    room: Room
    trials: int
    goal: Goal
    report: Report

    def next(self, inputs: Floats, why: str, content: dict[str, Any]) -> PostureMeasured | None:
        """Announce, measure and record a posture; None if it was skipped."""
        number = len(self.record.dataset.postures) + 1
        named = dict(zip(self.arm.robot.inputs, inputs.tolist(), strict=True))
        data = {'number': number, 'inputs': inputs.tolist(), 'most': self.goal.postures, **content}
        text = f'posture {number}: {commands(named, self.arm.input)}   {why}'
        self.report(News('posture', text, data))
        measured = self.attempted(inputs)
        if measured is not None:
            self.record.take(inputs, measured, self.arm.position_noise)
        return measured

    def attempted(self, inputs: Floats) -> PostureMeasured | None:
        """
        Return what was measured; None after the last attempt.

        Raises
        ------
        TendonRobotError
            Too many postures could not be measured, or a marker was seen in a region.

        """
        reason = ''
        for is_last in (False, True):
            try:
                measured = checked(self.arm.measure(inputs, self.trials))
                self.room.refuse_inside(measured.positions)
                return measured
            except BrokenMeasurementError as error:
                reason = str(error)
                if not is_last:
                    self.report(News('broken', f'  not measured: {reason}; once more'))
        self.record.skip(inputs, reason)
        self.report(News('skipped', f'  skipped: {reason}'))
        if len(self.record.skipped) >= self.goal.skipped + len(self.record.dataset.postures):
            raise TendonRobotError(
                f'{len(self.record.skipped)} postures could not be measured, the last one: '
                f'{reason}; look at the robot, then go on with --resume'
            )
        return None

    def untried(self, offered: Floats) -> Floats:
        """Return the postures (b, m) that were neither measured nor skipped; all of a sequence."""
        if self.arm.path != 'from_straight':
            return offered
        skipped = (np.array(one.inputs) for one in self.record.skipped)
        for row in (*self.record.dataset.inputs, *skipped):
            same = np.isclose(np.nan_to_num(offered), np.nan_to_num(row), atol=1e-9).all(axis=1)
            offered = offered[~same]
        return offered


def checked(measured: PostureMeasured) -> PostureMeasured:
    """
    Refuse a measurement that lacks most of its markers.

    Raises
    ------
    BrokenMeasurementError

    """
    visible = np.isfinite(measured.positions).all(axis=2)  # (Q, J)
    good = visible.mean(axis=1) >= 0.5
    if not good.any():
        lost = 100.0 * (1.0 - visible.mean())
        raise BrokenMeasurementError(f'the tracker lost {lost:.0f} % of the markers')
    positions = np.where(good[:, None, None], measured.positions, np.nan)
    return replace(measured, positions=positions)


def separate_changes(
    finder: ChangeFinder, measurer: Measurer, offered: Callable[[], Floats]
) -> list[Suspect]:
    """
    Measure the postures that separate what may have changed since a drift alarm.

    The monitor knows what it may be after the postures that happened to come. Here the arm is
    driven to the posture at which the likely changes lie farthest apart, until one of them is
    likely enough, nothing separates the rest, or the postures are used up. They are the first
    postures of the investigation that follows; after each it is said what the change looks like.

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
        The remaining changes, the likeliest first; see `likely`.

    """
    suspects = finder.suspects()
    report_suspects(measurer, suspects)
    for _ in range(min(measurer.goal.after_alarm, measurer.goal.postures)):
        rows = offered()
        best = finder.most_informative(rows) if len(rows) else None
        if best is None:
            break
        names = [suspect.name for suspect in likely(suspects)]
        more = f' and {len(names) - 3} more' if len(names) > 3 else ''
        first = ', '.join(names[:3])
        why = f'separates {first}{more}' if len(names) > 1 else f'is to confirm {first}'
        measured = measurer.next(rows[best], why, {'asked': names})
        if measured is not None:
            inputs, visible = rows[best], np.isfinite(measured.positions)
            if measured.inputs is not None:
                inputs = np.nanmean(measured.inputs, axis=0)
            count = np.where(visible.any(axis=0), visible.sum(axis=0), np.nan)
            # all trials of a posture are one measurement
            finder.take(inputs, np.nansum(measured.positions, axis=0) / count, measured.frames)
            suspects = finder.suspects()
            report_suspects(measurer, suspects)
    rest = likely(suspects)
    if rest:
        have = len(measurer.record.dataset.postures)
        content = {'names': [suspect.name for suspect in rest], 'postures': have}
        measurer.report(News('changed', f'  {have} postures: has changed: {sizes(rest)}', content))
    return rest


def likely(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Return the fewest likeliest changes whose total probability is large enough."""
    sums = np.cumsum([suspect.probability for suspect in suspects])
    return list(suspects[: int(np.searchsorted(sums, APART_PROBABILITY)) + 1])


def no_effect(suspects: Sequence[Suspect]) -> bool:
    """Return whether all suspects are no effects: a cell, a gain, the tracker."""
    return bool(suspects) and not any(suspect.is_effect for suspect in suspects)


def sizes(suspects: Sequence[Suspect]) -> str:
    """Describe up to three alternative changes with their sizes."""
    texts = [f'{suspect.name} ({suspect.size})' for suspect in suspects[:3]]
    more = f' or {len(suspects) - 3} more' if len(suspects) > 3 else ''
    return ' or '.join(texts) + more


def report_suspects(measurer: Measurer, suspects: Sequence[Suspect]) -> None:
    """Report the likeliest changes after the postures so far."""
    have = len(measurer.record.dataset.postures)
    content = {'suspects': [vars(suspect) for suspect in likely(suspects)], 'postures': have}
    measurer.report(News('change', f'  looks like {described(suspects)}', content))
