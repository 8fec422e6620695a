"""
What is watched while the robot works: first the arm is learned, then drift and tip force.

Is the arm still what it was: a sequential test with a stated false-alarm rate.

`BuiltArm` predicts every posture at which the arm stands. A change theta (an effect of the
catalogue appears, a cell gets softer, a gain moves, the tracker is bumped) that began at a posture
shifts the innovations of its Kalman filter by G theta; the signatures G follow from the filter's
gains (Willsky and Jones 1976). With theta ~ N(0, T) each change gives a likelihood ratio

    log E = 1/2 d' (C + T^-1)^-1 d - 1/2 log det(1 + T C),   C = sum G' S^-1 G,  d = sum G' S^-1 nu

whose mean without a change is 1: an e-process. Averaged over the changes and added up over the
postures at which one may have begun, it is an e-detector (Shin, Ramdas, Rinaldo 2023): an alarm at
a sum of A comes without a change on average after A beginnings at the earliest. It takes two
postures: without the one that speaks most for a change the sum still has to be `CONFIRMED`. A
single one may be off as no innovation of a linear filter is, where kinks turn friction, or the
tracker was wrong for once: where four as expected follow, it was odd, and no evidence. From what
is beyond its gate the filter does not learn, be it odd or after a change: it stays the arm that
was. What it looks like is then fitted to the postures since (`change.py`), here or by an
investigation, to which the arm as it was and these postures are handed over as text.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError
from ..common.processes import ComputingThread
from ..common.words import listed
from ..comparison.statistics import chi2_sf
from ..data import Marker
from ..effects import Catalogue
from ..model.model import Model
from ..robot import dump_robot, parse_robot
from .built_arm import ODD_PROBABILITY, BuiltArm, Expected
from .change import ChangeFinder, Suspect, changes_of, described
from .tip_force import TipForce, TipForceObserver

FORMAT = 'tendon_robot_ros/change@1'
SIZES = 'remainder', 'setting', 'widening'  # of an arm as it was learned
# [1] postures; without a change no alarm before, on average and at least (docs/investigate.md)
ALARM_POSTURES = 20_000.0
# [1] of the sum that has to be left without the posture that speaks most for it: by chance one of
# 50 arms has as much at a time
CONFIRMED = 50.0
# [1] postures between two at which a change may begin, and after an odd one that have to be as
# expected: each of them would cost as much as the filter, and a change is seen in two
BEGIN_EVERY = 4
# [1] beginnings that are followed; evidence for an older one would have been an alarm by now
BEGINNINGS_KEPT = 8
# [1] of a typical size, of a difference: less would be nothing where an effect has a kink
DIFFERENCE = 0.1
# [1] postures after an alarm, at which it is named anew, because that takes seconds
LOOKED_AFTER = 0, 1, 3, 8, 16, 24
# [1] suspects that are told, else nobody would read them
SUSPECTS_TOLD = 5


@dataclass(frozen=True)
class DriftState:
    """What is known after a posture."""

    alarm: bool
    evidence: float  # the sum; an alarm at the threshold
    postures: int  # since the change that is most likely began
    suspects: tuple[Suspect, ...] = ()  # most likely first, while there is an alarm


class _ChangeBegun:
    """A posture at which a change may have begun, and what came since."""

    def __init__(self, changes: int, mean: Floats, covariance: Floats, at: int = 0) -> None:
        self.mean, self.covariance, self.at = mean, covariance, at  # of the arm before; posture
        self.followed = np.zeros((len(mean), changes))  # what the filter took for imperfections
        self.information = np.zeros((changes, changes))
        self.score = np.zeros(changes)
        self.parts = list[tuple[Floats, Floats]]()  # the same of every posture since

    @property
    def postures(self) -> int:
        """How many came since."""
        return len(self.parts)

    def take(self, information: Floats, score: Floats) -> None:
        """Take the information (c, c) of a posture and its score (c,)."""
        self.information, self.score = self.information + information, self.score + score
        self.parts.append((information, score))

    def without(self, at: int) -> tuple[Floats, Floats]:
        """Return information and score of all postures but that of a number."""
        if not 0 <= at - self.at < len(self.parts):
            return self.information, self.score
        information, score = self.parts[at - self.at]
        return self.information - information, self.score - score

    def forget(self, at: int) -> None:
        """Let the posture of a number count for nothing."""
        if 0 <= at - self.at < len(self.parts):
            self.information, self.score = self.without(at)
            information, score = self.parts[at - self.at]
            self.parts[at - self.at] = 0.0 * information, 0.0 * score


@dataclass(frozen=True)
class _Look:
    """A posture beside what the filter expects of it."""

    expected: Expected
    measured: Floats  # (3 J,) [m]
    frames: int
    columns: Floats  # (r, q) [m per sd] of the imperfections, where markers were seen
    shown: Floats  # (r, c) [m per unit] of the changes
    innovation: Floats  # (r,) [m]
    inverse: Floats  # (r, r) [1/m²] of its covariance, widened
    gain: Floats  # (q, r) [sd per m] of the filter

    def signature(self, begun: _ChangeBegun) -> Floats:
        """Return what changes that began there do to the innovation (r, c) [m per unit]."""
        return np.asarray(self.shown - self.columns @ begun.followed)


@dataclass(frozen=True)
class _Stood:
    """A posture lately."""

    at: int  # its number
    tensions: Floats  # (m,) [N]
    positions: Floats  # (J, 3) [m]
    frames: int
    odd: bool  # it is surely not as expected


class DriftAlarm:
    """Watches an arm posture by posture."""

    def __init__(self, arm: BuiltArm, postures: float = ALARM_POSTURES) -> None:
        """
        Begin; the arm has learned its reference postures.

        Parameters
        ----------
        arm : BuiltArm
        postures : float
            Without a change no alarm before so many postures, on average and at least.

        """
        self.arm, self.threshold = arm, max(postures / BEGIN_EVERY, 2.0)
        self._changes = changes_of(arm)
        self._frees = [free for change in self._changes for free in change.frees]
        # where each change lies in the signatures, and 1 sd of all of these
        count, self._places = 0, list[slice]()
        self._spread = np.ones(len(self._frees) + len(arm.plausible))
        for change in self._changes:
            begin = count if change.is_effect else len(self._frees) + change.members.start
            count += len(change.frees)
            place = slice(begin, begin + len(change.spread))
            self._places.append(place)
            self._spread[place] = change.spread
        self.state = DriftState(False, 0.0, 0)
        self.finder: ChangeFinder | None = None  # what has changed, since an alarm
        self.restart()

    def restart(self) -> None:
        """Forget the evidence, after a change was looked after."""
        self._beginnings, self._count = list[_ChangeBegun](), 0
        self._recent: deque[_Stood] = deque(maxlen=BEGIN_EVERY * BEGINNINGS_KEPT)
        self._single: int | None = None  # number of an odd posture without another one
        self.finder, self._since_alarm = None, 0
        self.state = DriftState(False, 0.0, 0)

    def update(self, tensions: Floats, positions: Floats, frames: int = 1) -> DriftState:
        """
        Take a posture at which the arm stands.

        Parameters
        ----------
        tensions : (m,) [N]
        positions : (J, 3) [m], nan where a marker was not seen
        frames : int
            Of which the positions are the mean.

        """
        look = self._looked(tensions, positions, frames)
        if look is None:
            return self.state
        chi2 = float(look.innovation @ look.inverse @ look.innovation)
        odd = chi2_sf(chi2, len(look.innovation)) < ODD_PROBABILITY
        if self._count % BEGIN_EVERY == 0:
            known = self.arm.mean.copy(), self.arm.covariance.copy()
            self._beginnings.append(_ChangeBegun(len(self._spread), *known, self._count))
            del self._beginnings[:-BEGINNINGS_KEPT]
        stood = _Stood(self._count, tensions, positions, frames, odd)
        self._recent.append(stood)
        self._count += 1
        for begun in self._beginnings:
            signature = look.signature(begun)
            weighted = look.inverse @ signature
            begun.take(signature.T @ weighted, weighted.T @ look.innovation)
        if not odd:  # the filter learns, and what it makes of every change is noted
            for begun in self._beginnings:
                begun.followed += look.gain @ look.signature(begun)
            self.arm.learn(look.expected, look.measured, look.frames)
        self._leave_out(stood)
        self.state = self._judged(stood)
        return self.state

    def _leave_out(self, stood: _Stood) -> None:
        """Forget an odd posture that the next ones leave alone; two of them are a change."""
        single = self._single
        if stood.odd:
            self._single = stood.at if single is None else None
        elif single is not None and stood.at - single >= BEGIN_EVERY:
            for begun in self._beginnings:
                begun.forget(single)
            left = [one for one in self._recent if one.at != single]
            self._recent, self._single = deque(left, self._recent.maxlen), None

    def _looked(self, tensions: Floats, positions: Floats, frames: int) -> _Look | None:
        """Compare a posture with what is expected; None where nothing can be."""
        arm, measured = self.arm, positions.ravel()
        expected = arm.expected(tensions)
        rows = np.isfinite(measured)
        if expected is None or not rows.any():
            return None
        shown = self._signatures(tensions, expected.columns)
        if shown is None:
            return None
        innovation, columns, scatter = arm.seen(expected, measured, frames)
        inverse = np.linalg.inv(columns @ arm.covariance @ columns.T + scatter)
        return _Look(
            expected,
            measured,
            frames,
            columns,
            shown[rows],
            innovation,
            inverse / arm.widening,
            arm.covariance @ columns.T @ inverse,
        )

    def _judged(self, stood: _Stood) -> DriftState:
        """Add up the evidence, and name what it speaks for."""
        logs = self._logs()
        evidence = _sum(logs)
        place, change = np.unravel_index(int(np.argmax(logs)), logs.shape)
        begun = self._beginnings[int(place)]
        # more than the one posture speaks for a change that speaks most for it
        most = min(
            range(begun.at, begun.at + begun.postures),
            key=lambda at: self._log_ratio(begun, int(change), at),
        )
        enough = evidence >= self.threshold and _sum(self._logs(most)) >= CONFIRMED
        alarm = self.state.alarm or enough
        suspects = self._suspects(begun, stood) if alarm else ()
        return DriftState(alarm, evidence, begun.postures, suspects)

    def _logs(self, without: int = -1) -> Floats:
        """Return the log likelihood ratios (beginnings, changes), of all postures but one."""
        which = range(len(self._changes))
        return np.array(
            [[self._log_ratio(b, i, without) for i in which] for b in self._beginnings]
        )

    def _suspects(self, begun: _ChangeBegun, stood: _Stood) -> tuple[Suspect, ...]:
        """Name changes by their probability, the most likely first; not at every posture."""
        if self.finder is None:
            arm = self.arm.as_known(begun.mean, begun.covariance)
            self.finder = ChangeFinder(arm, self._changes)
            # since the change: those before the first odd one may be before it
            since = [one for one in self._recent if one.at >= begun.at]
            first = next((i for i, one in enumerate(since) if one.odd), 0)
            for one in since[first if first < BEGIN_EVERY else 0 :]:
                self.finder.take(one.tensions, one.positions, one.frames)
        elif self._since_alarm < LOOKED_AFTER[-1]:
            self._since_alarm += 1
            self.finder.take(stood.tensions, stood.positions, stood.frames)
        else:
            return self.state.suspects
        if self._since_alarm not in LOOKED_AFTER:
            return self.state.suspects
        return self.finder.suspects()[:SUSPECTS_TOLD]

    def _log_ratio(self, begun: _ChangeBegun, i: int, without: int = -1) -> float:
        """Return the log likelihood ratio of a change that began there against none."""
        place = self._places[i]
        scale, (information, score) = self._spread[place], begun.without(without)
        both = information[place, place] * np.outer(scale, scale) + np.eye(len(scale))
        score = score[place] * scale
        gained = float(score @ np.linalg.solve(both, score))
        return 0.5 * gained - 0.5 * float(np.linalg.slogdet(both)[1])

    def _signatures(self, tensions: Floats, built: Floats) -> Floats | None:
        """Return what a unit of every change does to the markers, (3 J, c) [m per unit]."""
        whole, inputs = self.arm.whole, np.maximum(tensions, 0.0)[None]
        here = whole.markers({}, inputs)
        if here is None:
            return None
        columns = []
        for free in self._frees:
            value, step = whole.value(free), DIFFERENCE * free.parameter.typical
            if value + step > free.parameter.high:
                step = -step
            moved = whole.markers({free: value + step}, inputs)
            columns.append(np.zeros(here.size) if moved is None else (moved - here).ravel() / step)
        return np.column_stack([*columns, built / self.arm.plausible])


def _sum(logs: Floats) -> float:
    """Return the evidence: averaged over the changes, added up over the beginnings."""
    return float(np.exp(np.minimum(logs, 600.0)).mean(axis=1).sum())


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
        numbers = [f'{i + 1}' for i in self._arm.left_out]  # of what is no part of what is known
        misread = f'; left out as misread: reference {listed(numbers)}' if numbers else ''
        return said + misread

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
