"""Measuring a posture: what breaks is tried again, then skipped and said; regions stay free."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import TendonRobotError
from ..common.words import commands
from .arm import BrokenMeasurementError, MeasurableArm, PostureMeasured, checked
from .choice import Room
from .record import Record

Floats = npt.NDArray[np.float64]
ATTEMPTS = 2  # at a posture, before it is skipped
SKIPPED_MAX = 5  # postures in a row, after which something is wrong with the robot


@dataclass(frozen=True)
class News:
    """Something that happened: a line to print, and plain data for a page."""

    # 'posture', 'broken', 'skipped', 'change', 'changed', 'diagnosis', 'end', 'added', 'check'
    kind: str
    text: str
    content: dict[str, Any] = field(default_factory=dict)


Tell = Callable[[News], None]


@dataclass
class Measurer:
    """Asks an arm for postures and writes down what it measures."""

    arm: MeasurableArm
    record: Record
    room: Room
    trials: int
    most: int  # postures of the whole investigation
    tell: Tell

    def next(self, inputs: Floats, why: str, content: dict[str, Any]) -> PostureMeasured | None:
        """Say where the arm goes next and why, measure and record it; None: it was skipped."""
        number = len(self.record.dataset.postures) + 1
        named = dict(zip(self.arm.robot.inputs, inputs.tolist(), strict=True))
        told = {'number': number, 'inputs': inputs.tolist(), 'most': self.most, **content}
        text = f'posture {number}: {commands(named, self.arm.input)}   {why}'
        self.tell(News('posture', text, told))
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
        for attempt in range(ATTEMPTS):
            try:
                measured = checked(self.arm.measure(inputs, self.trials))
                self._refuse_forbidden(measured)
                return measured
            except BrokenMeasurementError as error:
                reason = str(error)
                if attempt + 1 < ATTEMPTS:
                    self.tell(News('broken', f'  not measured: {reason}; once more'))
        self.record.skip(inputs, reason)
        self.tell(News('skipped', f'  skipped: {reason}'))
        if len(self.record.skipped) >= SKIPPED_MAX + len(self.record.dataset.postures):
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

    def _refuse_forbidden(self, measured: PostureMeasured) -> None:
        """Raise where a marker was seen in a region that is kept out."""
        points = measured.positions[np.isfinite(measured.positions).all(axis=2)]
        clear = self.room.regions.clearance(points)
        if clear.distance < 0.0:
            raise TendonRobotError(
                f'a marker was seen {1e3 * -clear.distance:.1f} mm inside {clear.region}, where '
                'the model says that it is not: the arm was released; look at the robot, and at '
                'where the tracker says its base is'
            )
