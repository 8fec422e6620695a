"""
Monitoring of a working robot: first the arm is learned, then drift and contact are observed.

The drift alarm is a sequential test with a stated false-alarm rate.

`BuiltArm` predicts every posture at which the arm rests, with what its description is known to
lack. A change theta (an effect of the catalogue appears, a cell gets softer, a gain changes, the
tracker is bumped) since a posture shifts the innovations of its Kalman filter by G theta; the
signatures G follow from the filter's gains (Willsky and Jones 1976). With theta ~ N(0, T) each
change gives a likelihood ratio

    log E = 1/2 d' (C + T^-1)^-1 d - 1/2 log det(1 + T C),   C = sum G' S^-1 G,  d = sum G' S^-1 nu

whose mean without a change is 1: an e-process. Averaged over the changes and summed over the
possible change points, it is an e-detector (Shin, Ramdas, Rinaldo 2023): without a change, a sum
of A is reached on average after at least A change points. An alarm requires two postures: without
the one with the strongest evidence the sum still has to be `CONFIRMED`. A single posture may be an
outlier, because kinks reverse friction or the tracker fails once: when four postures as expected
follow, it is excluded from the evidence. The filter does not learn from innovations beyond its
gate, so that it keeps the arm before the change. The kind of change is then fitted to the postures
since (`change.py`), here or by an investigation, which receives the arm before the change and
these postures as text.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError
from ..common.processes import ComputingThread
from ..common.words import listed
from ..data import Marker
from ..effects import Catalogue
from ..inference.statistics import RARE, chi2_sf
from ..model.model import Model
from ..robot import dump_robot, parse_robot
from .built_arm import ODD_PROBABILITY, BuiltArm, differences
from .change import JUDGED_POSTURES, ChangeFinder, Suspect, changes_of, described
from .contact import ContactObserver

FORMAT = 'tendon_robot_ros/change@1'
SIZES = 'remainder', 'setting', 'widening'  # fields of a learned arm
# [1] postures; mean number before a false alarm, at least (docs/investigate.md)
ALARM_POSTURES = 20_000.0
# [1] evidence that is required without the strongest posture: by chance one of 50 arms exceeds it
# at a time
CONFIRMED = 50.0
# [1] change points that are tested; evidence for an older one would have raised the alarm
CHANGE_POINTS_MAX = 8


@dataclass(frozen=True)
class DriftState:
    """State of the drift alarm after a posture."""

    alarm: bool
    evidence: float  # of the e-detector; at the threshold it raises the alarm
    postures: int  # since the most likely change point
    suspects: tuple[Suspect, ...] = ()  # most likely first, after an alarm


@dataclass
class _ChangePoint:
    """A possible change point, and the evidence since."""

    at: int  # number of the posture
    mean: Floats  # of the arm before the change
    covariance: Floats
    followed: Floats  # (q, c) response of the filter to changes
    # information (c, c) and score (c,) by number of the posture
    parts: dict[int, tuple[Floats, Floats]] = field(default_factory=dict)

    def evidence(self, without: int = -1) -> tuple[Floats, Floats]:
        """Return information (c, c) and score (c,), without the posture of a number."""
        changes = self.followed.shape[1]
        information, score = np.zeros((changes, changes)), np.zeros(changes)
        for at, part in self.parts.items():
            if at != without:
                information, score = information + part[0], score + part[1]
        return information, score


@dataclass(frozen=True)
class _Posture:
    """A recent posture."""

    at: int  # number
    tensions: Floats  # (m,) [N]
    positions: Floats  # (J, 3) [m]
    frames: int
    odd: bool  # beyond the gate of the filter


class DriftAlarm:
    """Sequential test for a change of an arm, posture by posture."""

    def __init__(self, arm: BuiltArm, postures: float = ALARM_POSTURES) -> None:
        """
        Begin with an arm that is fitted to its reference postures.

        Parameters
        ----------
        arm : BuiltArm
        postures : float
            Mean number of postures before a false alarm, at least.

        """
        self.arm, self.threshold = arm, max(postures / JUDGED_POSTURES, 2.0)
        self._changes = changes_of(arm)
        self._frees = [free for change in self._changes for free in change.frees]
        # columns of each change in the signatures, and their prior 1 sd
        sizes = [len(change.spread) for change in self._changes]
        self._places = [slice(*ends) for ends in pairwise([0, *np.cumsum(sizes)])]
        self._spread = np.concatenate([change.spread for change in self._changes])
        self.restart()

    def restart(self) -> None:
        """Drop the evidence, after a change was handled."""
        self._change_points, self._count = list[_ChangePoint](), 0
        self._recent: deque[_Posture] = deque(maxlen=JUDGED_POSTURES * CHANGE_POINTS_MAX)
        self._single: int | None = None  # number of a single outlier
        self.finder: ChangeFinder | None = None  # after an alarm
        self._since_alarm, self.state = 0, DriftState(False, 0.0, 0)

    def update(self, tensions: Floats, positions: Floats, frames: int = 1) -> DriftState:
        """
        Update by a posture at which the arm rests.

        Parameters
        ----------
        tensions : (m,) [N]
        positions : (J, 3) [m], nan for a missing marker
        frames : int
            Number of frames whose mean the positions are.

        """
        arm, measured = self.arm, positions.ravel()
        rows = np.isfinite(measured)
        if not rows.any():
            return self.state
        try:
            expected = arm.expected(tensions)
            slopes = self._signatures(tensions, expected.columns)
        except NoEquilibriumError:
            return self.state
        innovation, columns, scatter = arm.observation(expected, measured, frames)
        inverse = np.linalg.inv(columns @ arm.covariance @ columns.T + scatter)
        gain, inverse = arm.covariance @ columns.T @ inverse, inverse / arm.widening
        chi2 = float(innovation @ inverse @ innovation)
        odd = chi2_sf(chi2, len(innovation)) < ODD_PROBABILITY
        if self._count % JUDGED_POSTURES == 0:
            point = _ChangePoint(
                self._count, arm.mean, arm.covariance, np.zeros((len(arm.mean), len(self._spread)))
            )
            self._change_points = [*self._change_points[1 - CHANGE_POINTS_MAX :], point]
        posture = _Posture(self._count, tensions, positions, frames, odd)
        self._recent.append(posture)
        self._count += 1
        for point in self._change_points:  # the signatures of changes in the innovation
            signature = slopes[rows] - columns @ point.followed
            weighted = inverse @ signature
            point.parts[posture.at] = signature.T @ weighted, weighted.T @ innovation
            if not odd:  # the response of the filter to every change
                point.followed += gain @ signature
        if not odd:
            arm.learn(expected, measured, frames)
        self._exclude_single(posture)
        self.state = self._assess(posture)
        return self.state

    def _exclude_single(self, posture: _Posture) -> None:
        """Exclude an outlier that the next postures do not confirm; two outliers are a change."""
        single = self._single
        if posture.odd:
            self._single = posture.at if single is None else None
        elif single is not None and posture.at - single >= JUDGED_POSTURES:
            for point in self._change_points:
                point.parts.pop(single, None)
            others = [one for one in self._recent if one.at != single]
            self._recent, self._single = deque(others, self._recent.maxlen), None

    def _assess(self, posture: _Posture) -> DriftState:
        """Return the state after the last posture."""
        logs = self._logs()
        evidence = _sum(logs)
        place, change = np.unravel_index(int(np.argmax(logs)), logs.shape)
        point = self._change_points[int(place)]
        # the alarm requires evidence beyond the strongest posture
        without = [point.evidence(at) for at in point.parts]
        left = self._log_ratios(without, self._places[int(change)])
        strongest = list(point.parts)[int(np.argmin(left))]
        enough = evidence >= self.threshold and _sum(self._logs(strongest)) >= CONFIRMED
        alarm = self.state.alarm or enough
        suspects = self._suspects(point, posture) if alarm else ()
        return DriftState(alarm, evidence, self._count - point.at, suspects)

    def _logs(self, without: int = -1) -> Floats:
        """Return the log likelihood ratios (change points, changes), without a given posture."""
        evidence = [point.evidence(without) for point in self._change_points]
        return np.stack([self._log_ratios(evidence, place) for place in self._places], axis=1)

    def _log_ratios(self, evidence: Sequence[tuple[Floats, Floats]], place: slice) -> Floats:
        """Return the log likelihood ratio (n,) of a change against none, by n evidences."""
        information, score = (np.array(part) for part in zip(*evidence, strict=True))
        return log_ratio(information[:, place, place], score[:, place], self._spread[place])

    def _suspects(self, point: _ChangePoint, posture: _Posture) -> tuple[Suspect, ...]:
        """Return the suspects, refitted when the postures after the alarm have doubled."""
        if self.finder is None:
            arm = self.arm.as_known(point.mean, point.covariance)
            self.finder = ChangeFinder(arm, self._changes)
            # postures since the change: those before the first outlier may precede it
            since = [one for one in self._recent if one.at >= point.at]
            first = next((i for i, one in enumerate(since) if one.odd), 0)
            for one in since[first if first < JUDGED_POSTURES else 0 :]:
                self.finder.take(one.tensions, one.positions, one.frames)
        elif self._since_alarm < JUDGED_POSTURES * CHANGE_POINTS_MAX:
            self._since_alarm += 1
            self.finder.take(posture.tensions, posture.positions, posture.frames)
        else:
            return self.state.suspects
        if self._since_alarm & (self._since_alarm - 1):  # a fit takes seconds
            return self.state.suspects
        return tuple(one for one in self.finder.suspects() if one.probability > RARE)

    def _signatures(self, tensions: Floats, built: Floats) -> Floats:
        """Return the motion of the markers by a unit of every change, (3 J, c) [m per unit]."""
        described = self.arm.described
        described.inputs = np.maximum(tensions, 0.0)[None]
        moves = differences(described, {}, self._frees)
        members = [change.members for change in self._changes]  # after all effects
        own = [built[:, place] / self.arm.plausible[place] for place in members]
        return np.column_stack([*moves[0, :, 0], *own])


def log_ratio(information: Floats, score: Floats, spread: Floats) -> Floats:
    """Return log E (...) of a change, from C (..., k, k), d (..., k), its prior 1 sd (k,)."""
    both, score = information * np.outer(spread, spread) + np.eye(len(spread)), score * spread
    gained = (score * np.linalg.solve(both, score[..., None])[..., 0]).sum(axis=-1)
    return np.asarray(0.5 * gained - 0.5 * np.linalg.slogdet(both)[1])


def _sum(logs: Floats) -> float:
    """Return the evidence: averaged over the changes, summed over the change points."""
    return float(np.exp(np.minimum(logs, 600.0)).mean(axis=1).sum())


def dump_change(finder: ChangeFinder) -> str:
    """Return the arm before a change and the postures since as JSON."""
    arm = finder.arm
    content: dict[str, Any] = {
        'format': FORMAT,
        'robot': dump_robot(arm.robot),
        'markers': [
            [m.name, m.arc_length, np.asarray(m.offset).tolist()]
            for m in arm.predictor.dataset.markers
        ],
        'noise': arm.noise,
        'level': arm.level,
        **{name: float(getattr(arm, name)) for name in SIZES},
        'mean': arm.mean.tolist(),
        'covariance': arm.covariance.tolist(),
        'postures': [[t.tolist(), y.tolist(), frames] for t, y, frames in finder.postures],
    }
    return json.dumps(content)


def load_change(text: str, catalogue: Catalogue) -> ChangeFinder:
    """
    Return the finder of a text of `dump_change`.

    Parameters
    ----------
    text : str
        JSON of `dump_change`.
    catalogue : Catalogue
        Effects that may have appeared.

    Raises
    ------
    InputError
        The text is no JSON of a change, or of another version.

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
    arm.expect_lacking()
    if len(content['mean']) != len(arm.mean):
        raise InputError('change: the monitor uses other effects: give both the same files')
    finder = ChangeFinder(
        arm.as_known(np.array(content['mean']), np.array(content['covariance'])), changes_of(arm)
    )
    for tensions, positions, frames in content['postures']:
        finder.take(np.array(tensions), np.array(positions), frames)
    return finder


@dataclass(frozen=True)
class WatchSettings:
    """Settings of the monitoring."""

    reference_postures: int = 30  # to learn the arm, without external load
    alarm_postures: float = ALARM_POSTURES  # mean number before a false alarm
    tracker_noise: float = 2e-4  # [m] 1 sd of a coordinate of a marker


@dataclass
class ArmWatch:
    """Learns the arm at its first postures, then detects changes and contact."""

    model: Model
    markers: Sequence[Marker]
    settings: WatchSettings = field(default_factory=WatchSettings)

    def __post_init__(self) -> None:
        """Begin without a reference."""
        robot, catalogue = self.model.robot, self.model.catalogue
        self._arm = BuiltArm(robot, catalogue, self.markers, self.settings.tracker_noise)
        # of what pushes it; not to be asked while `learning`, since that thread uses its model
        self.observer = ContactObserver(self._arm)
        self._references: list[tuple[Floats, Floats, int]] = []  # as of `update`
        self._learning: threading.Thread | None = None
        self.alarm: DriftAlarm | None = None

    @property
    def state(self) -> DriftState | None:
        """State of the drift alarm, None while the arm is being learned."""
        return None if self.alarm is None else self.alarm.state

    @property
    def text(self) -> str:
        """The state in words."""
        state = self.state
        if state is None:
            have, of = len(self._references), self.settings.reference_postures
            return f'learning the arm: {have} of {of} postures'
        condition = 'as it was'
        if state.alarm:
            condition = f'no longer what the model says: looks like {described(state.suspects)}'
        numbers = [f'{i + 1}' for i in self._arm.excluded]
        misread = f'; left out as misread: reference {listed(numbers)}' if numbers else ''
        return condition + misread

    def change(self) -> str:
        """
        Return the arm and the postures since a change as JSON, for an investigation.

        Raises
        ------
        InputError
            There is no alarm.

        """
        if self.alarm is None or self.alarm.finder is None:
            raise InputError(f'no alarm: {self.text}')
        return dump_change(self.alarm.finder)

    def update(self, tensions: Floats, positions: Floats, frames: int = 1) -> DriftState | None:
        """Update by a posture at rest: tensions (m,) [N], the mean of frames (J, 3) [m]."""
        if self.alarm is not None:
            return self.alarm.update(tensions, positions, frames)
        if self._learning is None:
            self._references.append((tensions, positions, frames))
            if len(self._references) >= self.settings.reference_postures:
                self._learning = ComputingThread(self._learn, 'learning')
                self._learning.start()
        return None

    @property
    def learning(self) -> bool:
        """Whether a thread learns the arm, and so uses its model."""
        return self._learning is not None and self.alarm is None

    def _learn(self) -> None:
        tensions, positions, frames = zip(*self._references, strict=True)
        self._arm.fit(np.array(tensions), np.array(positions), min(frames))
        self.alarm = DriftAlarm(self._arm, self.settings.alarm_postures)
