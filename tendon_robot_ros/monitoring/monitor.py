"""
The monitor: prediction and measurement of each frame, errors, and the postures of a recording.

Recent samples are interpolated in time, checked for still segments, and averaged over them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError, InputError, NoEquilibriumError
from ..data import DataSet, Marker, default_markers
from ..inference.statistics import RARE, chi2_isf, mean_over, rms
from ..robot import Robot
from ..robot.estimates import same_input

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

# [1] frames of the tracker in each half of a window, else their mean would hardly reduce noise
FRAMES_PER_HALF_MIN = 4


class History:
    """
    Samples of the last seconds by their time.

    Parameters
    ----------
    span : float
        Older samples are dropped [s].
    patience : float
        Time after the newest sample during which its value holds [s].

    """

    def __init__(self, span: float = 4.0, patience: float = 0.1) -> None:
        """Begin empty."""
        self.span, self.patience = span, patience
        self._samples: deque[tuple[float, Floats]] = deque()

    def put(self, time: float, values: Floats) -> None:
        """Add a sample; one that is older than the newest is dropped."""
        if self._samples and time <= self._samples[-1][0]:
            if time > self._samples[-1][0] - self.span:
                return
            self._samples.clear()  # the clock was set back
        self._samples.append((time, values))
        while self._samples[0][0] < time - self.span:
            self._samples.popleft()

    @property
    def newest(self) -> float:
        """Time of the newest sample [s], minus infinity without any."""
        return self._samples[-1][0] if self._samples else -np.inf

    def at(self, time: float) -> Floats | None:
        """Return the linearly interpolated values at a time [s], None outside of the samples."""
        after = bisect_right(self._samples, time, key=itemgetter(0))
        if after == 0:
            return None
        begin, values = self._samples[after - 1]
        if after == len(self._samples):
            return values if time - begin <= self.patience else None
        end, later = self._samples[after]
        if end - begin > 2.0 * self.patience:  # a gap
            return None
        return values + (time - begin) / (end - begin) * (later - values)

    def mean(self, begin: float, end: float) -> Floats | None:
        """Return the mean over a closed interval [s], None without a sample in it."""
        samples = [values for at, values in self._samples if begin <= at <= end]
        return np.array(np.mean(samples, axis=0)) if samples else None

    def averaged(self, still: StillMeasurement, kind: str) -> StillMeasurement:
        """Return a measurement with the mean inputs of all states in its window, not frames."""
        mean = self.mean(still.begin, still.end)
        return still if mean is None else replace(still, inputs=self.inputs(mean, kind))

    @staticmethod
    def inputs(state: Floats, kind: str) -> Floats:
        """Return the tensions (m,) [N], or the displacements (m,) [m], of a state, (2 m,)."""
        return np.split(state, 2)[kind != 'tension']


@dataclass(frozen=True)
class StillMeasurement:
    """Measurement of an arm at rest: means over the window."""

    inputs: Floats  # (m,) [N] or [m]
    positions: Floats  # (J, 3) [m], nan for a missing marker
    spread: float  # [m] 1 sd of one coordinate in one frame
    frames: int
    begin: float  # [s]
    end: float  # [s]


class StillWindow:
    """
    The last frames, and whether the arm was at rest in them.

    As in `import bag`, the arm is at rest when the means of the two halves of the window differ
    by less than the speed allows, which averages the noise of the tracker, and no input changed.

    Parameters
    ----------
    duration : float
        Length of the window [s].
    speed : float
        Largest speed, rms over the markers [m/s].
    change : float
        Largest change of an input between the halves [N] or [m].

    """

    def __init__(self, duration: float, speed: float, change: float) -> None:
        """Begin empty."""
        self.duration, self.speed, self.change = duration, speed, change
        self._frames: deque[tuple[float, Floats, Floats]] = deque()

    def put(self, time: float, inputs: Floats, positions: Floats) -> None:
        """Add a frame: inputs (m,), markers (J, 3) [m]; a gap in time clears the window."""
        if self._frames and not 0.0 < time - self._frames[-1][0] < self.duration:
            self._frames.clear()
        self._frames.append((time, inputs, positions))
        while self._frames[0][0] < time - self.duration:
            self._frames.popleft()

    def clear(self) -> None:
        """Drop all frames."""
        self._frames.clear()

    def settled(self) -> StillMeasurement | None:
        """Return the means over the window if it is full and the arm was at rest, else None."""
        if not self._frames or self._frames[-1][0] - self._frames[0][0] < 0.8 * self.duration:
            return None
        times, inputs, positions = (np.array(part) for part in zip(*self._frames, strict=True))
        early = times < times[-1] - self.duration / 2
        if min(early.sum(), (~early).sum()) < FRAMES_PER_HALF_MIN:
            return None
        changes = np.abs(inputs[early].mean(axis=0) - inputs[~early].mean(axis=0))
        if np.nan_to_num(changes).max() > self.change:  # nan: not observable
            return None
        moved = rms(mean_over(positions[early], 0) - mean_over(positions[~early], 0))
        if not moved <= self.speed * self.duration / 2:  # nan: no marker was seen
            return None
        middle = mean_over(positions, 0)
        deviations = positions - middle
        freedom = max(int(np.isfinite(deviations).sum() - np.isfinite(middle).sum()), 1)
        return StillMeasurement(
            inputs=inputs.mean(axis=0),
            positions=middle,
            spread=float(np.sqrt(np.nansum(deviations**2) / freedom)),
            frames=len(times),
            begin=float(times[0]),
            end=float(times[-1]),
        )


# time [s], tensions (m,) [N], markers (J, 3) [m], nan for a missing one
_Frame = tuple[float, Floats, Floats]


def _means(frames: Iterable[_Frame]) -> tuple[Floats, Floats]:
    """Return mean tensions (m,) [N] and positions (J, 3) [m], nan for a marker never seen."""
    _, tensions, positions = zip(*frames, strict=True)
    return np.asarray(np.mean(tensions, axis=0)), mean_over(np.array(positions), 0)


class FrameMean:
    """
    Averages frames while the arm rests under constant tensions, and restarts after a change.

    New frames are tested against the earlier ones: all coordinates together, and along the
    directions in which a force at the tip moves them, where the test is most sensitive.

    Parameters
    ----------
    noise : float
        1 sd of a coordinate of a marker in one frame [m].
    tension_change : float
        Tensions that differ by less are equal [N].
    longest : float
        Older frames are dropped [s].

    """

    def __init__(self, noise: float, tension_change: float, longest: float) -> None:
        """Begin without frames."""
        self.noise, self.tension_change, self.longest = noise, tension_change, longest
        self._new: list[_Frame] = []
        self._kept = deque[_Frame]()

    def put(self, at: float, tensions: Floats, positions: Floats) -> None:
        """Add a frame: its time [s], tensions (m,) [N], markers (J, 3) [m] or nan."""
        self._new.append((at, tensions, positions))

    def take(self, slopes: Floats | None = None) -> tuple[Floats, Floats, int]:
        """
        Return the mean tensions (m,) [N] and positions (J, 3) [m], and the number of frames.

        Parameters
        ----------
        slopes : (3 J, 3), optional
            Last Jacobian of the coordinates by the force [m/N].

        """
        at, now, _ = self._new[-1]
        new = [frame for frame in self._new if self._same(frame[1], now)]
        self._new.clear()
        while self._kept and self._kept[0][0] < at - self.longest:
            self._kept.popleft()
        if self._kept and self._changed(new, slopes):
            self._kept.clear()
        self._kept.extend(new)
        return *_means(self._kept), len(self._kept)

    def _same(self, tensions: Floats, now: Floats) -> bool:
        return not np.abs(tensions - now).max() > self.tension_change

    def _changed(self, new: list[_Frame], slopes: Floats | None) -> bool:
        """Whether new frames differ significantly from the earlier ones."""
        (before, places), (tensions, positions) = _means(self._kept), _means(new)
        if not self._same(before, tensions):
            return True
        off = (positions - places).ravel()
        visible = np.isfinite(off)
        off = off[visible] / (self.noise * np.sqrt(1.0 / len(new) + 1.0 / len(self._kept)))
        parts = [off]
        if slopes is not None and len(off) > slopes.shape[1]:
            parts.append(np.linalg.qr(slopes[visible])[0].T @ off)
        return any(p @ p > chi2_isf(RARE, len(p)) for p in parts if len(p))


@dataclass(frozen=True)
class MonitorSettings:
    """Settings of the monitor."""

    still_time: float = 0.6  # [s]
    still_speed: float = 0.002  # [m/s]
    rolling: float = 1.0  # [s] window of the rolling error
    position_noise: float = 0.0  # [m] 1 sd of a recorded mean; 0: from the still frames
    setting_noise: float = 0.002  # [1] relative 1 sd of an input as measured
    path: str = 'sequence'  # or 'from_straight': each posture by itself


def still_window(robot: Robot, kind: str, settings: MonitorSettings) -> StillWindow:
    """Return a window for an arm that is moved by inputs of a kind: tension or displacement."""
    return StillWindow(settings.still_time, settings.still_speed, same_input(robot, kind))


@dataclass(frozen=True)
class Compared:
    """One frame of the tracker and its prediction."""

    measured: Floats  # (J, 3) [m]
    predicted: Floats  # (J, 3) [m]
    rolling: float  # [m] rms error of the last marker over the window, while inputs were constant

    @property
    def errors(self) -> Floats:
        """Measured minus predicted, (J, 3) [m], nan for a missing marker."""
        return self.measured - self.predicted


@dataclass
class Monitor:
    """Compares frames with a model; times are seconds on one clock, given by the caller."""

    model: Model
    markers: tuple[Marker, ...] = ()
    settings: MonitorSettings = field(default_factory=MonitorSettings)
    recorded: list[StillMeasurement] = field(default_factory=list)
    recording: bool = False
    kept: bool = True  # whether the recording is saved, or empty
    problem: str = ''
    _shape: Shape | None = None
    _tips: deque[tuple[float, Floats]] = field(default_factory=deque)  # [s], (3,) [m] errors
    _last_kind: str = 'tension'
    _last_posture: StillMeasurement | None = None  # the last result of `new_posture`

    def __post_init__(self) -> None:
        """Begin without samples."""
        robot = self.model.robot
        self.markers = self.markers or default_markers(robot)
        self.states = History()
        self._arcs = np.array([marker.arc_length for marker in self.markers])
        self._offsets = np.array([marker.offset for marker in self.markers]).reshape(-1, 3)
        self._windows = {
            kind: still_window(robot, kind, self.settings) for kind in ('tension', 'displacement')
        }

    def set_model(self, model: Model) -> None:
        """Compare with another model from now on."""
        self.model, self._shape = model, None
        self._tips.clear()

    def put_states(self, time: float, tensions: Floats, pulls: Floats) -> None:
        """Add measured tensions (m,) [N] and wire pulls (m,) [m], nan where not observable."""
        self.states.put(time, np.concatenate([tensions, pulls]))

    def put_frame(self, time: float, positions: Floats) -> Compared | None:
        """Add a frame (J, 3) [m] and return it with its prediction, None without one."""
        if (state := self.states.at(time)) is None:
            self.problem = 'no tendon_states at the time of the tracker: is the driver running?'
            return None
        quiet = self._quiet(time)
        tensions, pulls = np.split(state if quiet is None else quiet, 2)
        if (shape := self._predict(tensions, pulls)) is None:
            return None
        self.problem = ''
        points = self.model.measured(shape.markers(self._arcs, self._offsets)[None])[0]
        self._record(time, tensions, pulls, positions)
        if quiet is not None:
            self._tips.append((time, positions[-1] - points[-1]))
        # also what came before the clock was set back
        while self._tips and not time - self.settings.rolling <= self._tips[0][0] <= time:
            self._tips.popleft()
        rolling = rms(np.array([error for _, error in self._tips]).reshape(-1, 3))
        return Compared(positions, points, rolling)

    def new_posture(self) -> StillMeasurement | None:
        """Return the measurement of a new posture at rest, in tensions; None without one."""
        new = self._new('tension', self._last_posture)
        self._last_posture = new or self._last_posture
        return new

    def start_recording(self) -> None:
        """Start a recording, or continue one that is not saved yet."""
        if self.kept:
            self.recorded = []
        self.recording, self.kept = True, False
        for window in self._windows.values():
            window.clear()

    def dataset(self, name: str) -> DataSet:
        """
        Return the recording: one trial of the postures in their order.

        Raises
        ------
        DataSetError
            The recording has fewer than two postures.

        """
        if len(self.recorded) < 2:
            raise DataSetError(
                name, f'{len(self.recorded)} posture(s) were recorded', 'record two or more'
            )
        robot, settings = self.model.robot, self.settings
        noise = settings.position_noise or max(
            float(np.sqrt(np.mean([s.spread**2 / s.frames for s in self.recorded]))), 1e-7
        )
        return DataSet(
            name=name,
            robot=robot,
            markers=self.markers,
            postures=tuple(map(str, range(1, len(self.recorded) + 1))),
            inputs=np.array([s.inputs for s in self.recorded]),
            positions=np.array([s.positions for s in self.recorded])[:, None],
            input=self._last_kind,
            path=settings.path,
            gravity=robot.gravity,
            position_noise=noise,
            setting_noise=settings.setting_noise,
        )

    def _quiet(self, time: float) -> Floats | None:
        """Return the mean of the last states, None while inputs change."""
        span = self.states.patience  # over less, there may be no sample
        recent = self.states.mean(time - span, time)
        earlier = self.states.mean(time - 2.0 * span, time - span)
        if recent is None or earlier is None:
            return None
        robot = self.model.robot
        scale = 0.4 * same_input(robot, 'tension'), 0.5 * same_input(robot, 'displacement')
        change = np.abs(recent - earlier) / np.repeat(scale, len(recent) // 2)
        return recent if np.max(change[np.isfinite(change)], initial=0.0) <= 1.0 else None

    def _predict(self, tensions: Floats, pulls: Floats) -> Shape | None:
        last = self._shape
        try:
            if np.isfinite(tensions).all():
                self._shape = self.model.follow(last, np.maximum(tensions, 0.0))
            else:
                self._shape = self.model.follow_pulls(last, pulls)
        except (NoEquilibriumError, InputError) as error:
            self.problem = f'the model has no shape here: {error}'
            self._shape = None
        return self._shape

    def _record(self, time: float, tensions: Floats, pulls: Floats, positions: Floats) -> None:
        kind = 'tension' if np.isfinite(tensions).all() else 'displacement'
        window = self._windows[kind]
        window.put(time, tensions if kind == 'tension' else pulls, positions)
        if not self.recording:
            return
        last = self.recorded[-1] if self.recorded and kind == self._last_kind else None
        if (new := self._new(kind, last)) is None:
            return
        if kind != self._last_kind:
            self.recorded.clear()
        self._last_kind = kind
        self.recorded.append(new)

    def _new(self, kind: str, last: StillMeasurement | None) -> StillMeasurement | None:
        """Return a new measurement of an arm at rest; None without one, or at the last posture."""
        window = self._windows[kind]
        if (settled := window.settled()) is None:
            return None
        if last is not None:
            moved = np.nan_to_num(np.abs(settled.inputs - last.inputs)).max()
            if moved < 2.0 * window.change:
                return None
        return self.states.averaged(settled, kind)
