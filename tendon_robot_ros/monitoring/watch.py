"""
What is watched while the robot works: first its ways are learned, then drift and tip force.

What a drift alarm knows is handed over as text: the arm as it was before, and the postures since.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..common.processes import ComputingThread
from ..common.words import listed
from ..data import Marker
from ..effects import Catalogue
from ..model.model import Model
from ..robot import dump_robot, parse_robot
from .built_arm import BuiltArm
from .change import ChangeFinder
from .drift import ALARM_POSTURES, DriftAlarm, DriftState
from .possible_changes import changes_of, described
from .tip_force import TipForce, TipForceObserver

Floats = npt.NDArray[np.float64]
FORMAT = 'tendon_robot_ros/change@1'
SIZES = 'remainder', 'setting', 'widening'  # of an arm as it was learned


def dump_change(finder: ChangeFinder) -> str:
    """Return what is known of a change as JSON."""
    arm = finder.arm
    content: dict[str, Any] = {
        'format': FORMAT,
        'robot': dump_robot(arm.robot),
        'markers': [
            [m.name, m.arc_length, np.asarray(m.offset).tolist()]
            for m in arm.split.dataset.markers
        ],
        'noise': arm.noise,
        'level': arm.level,
        **{name: float(getattr(arm, name)) for name in SIZES},
        'mean': arm.mean.tolist(),
        'covariance': arm.covariance.tolist(),
        'postures': [[t.tolist(), y.tolist(), frames] for t, y, frames in finder.taken],
    }
    return json.dumps(content)


def load_change(text: str, catalogue: Catalogue) -> ChangeFinder:
    """
    Return a finder that knows as much.

    Parameters
    ----------
    text : str
        As of `dump_change`.
    catalogue : Catalogue
        Of the effects that may have appeared.

    Raises
    ------
    InputError
        It is none, or of another version.

    """
    try:
        content = json.loads(text)
        known = content['format']
    except (ValueError, KeyError, TypeError):
        known = 'no JSON of a change'
    if known != FORMAT:
        raise InputError(f'change: expected {FORMAT}, got {known}: restart the monitor')
    markers = [Marker(name, arc, tuple(offset)) for name, arc, offset in content['markers']]
    robot = parse_robot(content['robot'], 'robot of the monitor')
    arm = BuiltArm(robot, catalogue, markers, content['noise'], content['level'])
    for name in SIZES:
        setattr(arm, name, content[name])
    finder = ChangeFinder(
        arm.as_known(np.array(content['mean']), np.array(content['covariance'])), changes_of(arm)
    )
    for tensions, positions, frames in content['postures']:
        finder.take(np.array(tensions), np.array(positions), frames)
    return finder


@dataclass(frozen=True)
class WatchSettings:
    """How it watches."""

    reference_postures: int = 30  # that the arm is learned from, while nothing touches it
    alarm_postures: float = ALARM_POSTURES  # without a change no alarm before, on average
    tracker_noise: float = 2e-4  # [m] 1 sd of a coordinate of a marker


@dataclass
class ArmWatch:
    """Learns the arm at its first postures, then tells when it is no longer that."""

    model: Model
    markers: Sequence[Marker]
    settings: WatchSettings = field(default_factory=WatchSettings)

    def __post_init__(self) -> None:
        """Begin to learn."""
        self.learn_anew()

    def learn_anew(self) -> None:
        """Take the next postures as the reference."""
        robot, catalogue = self.model.robot, self.model.catalogue
        self._arm = BuiltArm(robot, catalogue, self.markers, self.settings.tracker_noise)
        self._observer = TipForceObserver(self._arm)
        self._references: list[tuple[Floats, Floats]] = []
        self._frames = 1  # of which a reference is the mean, at least
        self._learning: threading.Thread | None = None
        self.alarm: DriftAlarm | None = None

    @property
    def state(self) -> DriftState | None:
        """What the alarm knows; None while the arm is being learned."""
        return None if self.alarm is None else self.alarm.state

    @property
    def text(self) -> str:
        """How it is, in words."""
        state = self.state
        if state is None:
            have, of = len(self._references), self.settings.reference_postures
            return f'learning the arm: {have} of {of} postures'
        said = 'as it was'
        if state.alarm:
            said = f'no longer what the model says: looks like {described(state.suspects)}'
        return said + self._misread

    @property
    def _misread(self) -> str:
        """Name the references that are no part of what is known."""
        numbers = [f'{i + 1}' for i in self._arm.left_out]
        return f'; left out as misread: reference {listed(numbers)}' if numbers else ''

    def change(self) -> str:
        """
        Return what is known of a change, for an investigation to go on with.

        Raises
        ------
        InputError
            There is no alarm.

        """
        if self.alarm is None or self.alarm.finder is None:
            raise InputError(f'no alarm: {self.text}')
        return dump_change(self.alarm.finder)

    def stands(self, tensions: Floats, positions: Floats, frames: int = 1) -> DriftState | None:
        """Take a posture at which the arm stands: (m,) [N], the mean of frames (J, 3) [m]."""
        if self.alarm is not None:
            return self.alarm.update(tensions, positions, frames)
        self._frames = frames if not self._references else min(frames, self._frames)
        if self._learning is None:
            self._references.append((tensions, positions))
            if len(self._references) >= self.settings.reference_postures:
                self._learning = ComputingThread(self._learn, 'learning')
                self._learning.start()
        return None

    def wait(self) -> None:
        """Wait until what is being learned is learned."""
        if self._learning is not None:
            self._learning.join()

    @property
    def slopes(self) -> Floats | None:
        """How a force at the tip moved the markers lately (3 J, 3) [m/N]; None before."""
        return self._observer.slopes

    def force(
        self,
        tensions: Floats,
        positions: Floats | None,
        pulls: Floats | None = None,
        frames: int = 1,
    ) -> TipForce | None:
        """Return what acts at the tip now; see `TipForceObserver.update`."""
        if self._learning is not None and self.alarm is None:
            return None  # the thread that learns uses the model
        return self._observer.update(tensions, positions, pulls, frames)

    def _learn(self) -> None:
        tensions, positions = (np.array(part) for part in zip(*self._references, strict=True))
        self._arm.fit(tensions, positions, self._frames)
        self.alarm = DriftAlarm(self._arm, self.settings.alarm_postures)
