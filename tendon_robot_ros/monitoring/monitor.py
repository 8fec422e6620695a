"""The monitor: prediction beside measurement, errors, and the postures worth recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DataSetError, InputError, NoEquilibriumError
from ..data import DataSet, Marker, default_markers
from ..robot import Robot
from .measurement import History, StillMeasurement, StillWindow

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]
INPUT_AVERAGE_S = 0.1  # [s] over which inputs are averaged while they stand still


@dataclass(frozen=True)
class MonitorSettings:
    """How the monitor behaves."""

    still_time: float = 0.6  # [s]
    still_speed: float = 0.002  # [m/s]
    rolling: float = 1.0  # [s] over which the rolling error is taken
    position_noise: float = 0.0  # [m] 1 sd of a recorded mean; 0: from the still frames
    setting_noise: float = 0.002  # [1] relative 1 sd of an input as measured
    path: str = 'sequence'  # or 'from_straight': each posture by itself


@dataclass(frozen=True)
class Compared:
    """One frame of the tracker beside the model."""

    measured: Array  # (J, 3) [m]
    predicted: Array  # (J, 3) [m]
    rolling: float  # [m] rms of the last marker's error lately, while inputs stood still

    @property
    def errors(self) -> Array:
        """Measured minus predicted, (J, 3) [m]; nan where a marker was not seen."""
        return self.measured - self.predicted


@dataclass
class Monitor:
    """Compares frames with a model; times are seconds on one clock, given by the caller."""

    model: Model
    markers: tuple[Marker, ...] = ()
    settings: MonitorSettings = field(default_factory=MonitorSettings)
    recorded: list[StillMeasurement] = field(default_factory=list)
    recording: bool = False
    kept: bool = True  # what was recorded lies in a folder, or there is nothing
    problem: str = ''
    _shape: Shape | None = None
    _tips: deque[tuple[float, float]] = field(default_factory=deque)
    _last_kind: str = 'tension'
    _stood: StillMeasurement | None = None  # the last posture that was handed out

    def __post_init__(self) -> None:
        """Begin with nothing heard."""
        robot = self.model.robot
        self.markers = self.markers or default_markers(robot)
        self.states = History()
        self._arcs = np.array([marker.arc_length for marker in self.markers])
        self._offsets = np.array([marker.offset for marker in self.markers]).reshape(-1, 3)
        high, length = robot.tension_limits[1], robot.length
        changes = {'tension': 0.01 * high, 'displacement': 0.002 * length}
        self._windows = {
            kind: StillWindow(self.settings.still_time, self.settings.still_speed, change)
            for kind, change in changes.items()
        }
        self._changes = changes

    def set_model(self, model: Model) -> None:
        """Compare with another description from now on."""
        self.model, self._shape = model, None
        self._tips.clear()

    def put_states(self, time: float, tensions: Array, pulls: Array) -> None:
        """Take what the driver measures: (m,) [N] and (m,) [m], nan where not observable."""
        self.states.put(time, np.concatenate([tensions, pulls]))

    def put_frame(self, time: float, positions: Array) -> Compared | None:
        """Take a frame (J, 3) [m]; None while there is nothing to compare with."""
        if positions.shape != (len(self.markers), 3):
            raise InputError(
                f'measured shape: expected {len(self.markers)} poses, one for each of the markers '
                f'(nan where it was not seen), got {len(positions)}'
            )
        state = self.states.at(time)
        if state is None:
            self.problem = 'no tendon_states at the time of the tracker: is the driver running?'
            return None
        quiet = self._quiet(time)
        tensions, pulls = np.split(state if quiet is None else quiet, 2)
        shape = self._predict(tensions, pulls)
        if shape is None:
            return None
        self.problem = ''
        points = self.model.measured(shape.markers(self._arcs, self._offsets)[None])[0]
        self._record(time, tensions, pulls, positions)
        error = positions[-1] - points[-1] if quiet is not None else np.full(3, np.nan)
        return Compared(positions, points, self._roll(time, error))

    def stands(self) -> StillMeasurement | None:
        """Return a posture in tensions at which the arm stands, each of them once."""
        settled = self._windows['tension'].settled()
        if settled is None or not np.isfinite(settled.inputs).all():
            return None
        last, least = self._stood, 2.0 * self._changes['tension']
        if last is not None and np.abs(settled.inputs - last.inputs).max() < least:
            return None
        mean = self.states.mean(settled.begin, settled.end)
        inputs = settled.inputs if mean is None else np.split(mean, 2)[0]
        self._stood = replace(settled, inputs=inputs)
        return self._stood

    def start_recording(self) -> None:
        """Begin a recording, or go on with one that was stopped and is in no folder yet."""
        if self.kept:
            self.recorded = []
        self.recording, self.kept = True, False
        for window in self._windows.values():
            window.clear()

    def dataset(self, name: str) -> DataSet:
        """
        Return what was recorded: one trial of the postures in the order of the recording.

        Raises
        ------
        DataSetError
            Fewer than two postures.

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

    def _quiet(self, time: float) -> Array | None:
        """Return the mean state of the last moment, free of noise; None while inputs change."""
        recent = self.states.mean(time - INPUT_AVERAGE_S, time)
        earlier = self.states.mean(time - 2.0 * INPUT_AVERAGE_S, time - INPUT_AVERAGE_S)
        if recent is None or earlier is None:
            return None
        robot, m = self.model.robot, len(recent) // 2
        scale = np.repeat([0.004 * robot.tension_limits[1], 0.001 * robot.length], m)
        change = np.abs(recent - earlier) / scale
        return recent if np.max(change[np.isfinite(change)], initial=0.0) <= 1.0 else None

    def _predict(self, tensions: Array, pulls: Array) -> Shape | None:
        last = self._shape
        try:
            if np.isfinite(tensions).all():
                self._shape = self.model.follow(last, np.maximum(tensions, 0.0))
            else:
                self._shape = self.model.pull_shape(pulls, last)
        except (NoEquilibriumError, InputError) as error:
            self.problem = f'the model has no shape here: {error}'
            self._shape = None
        return self._shape

    def _record(self, time: float, tensions: Array, pulls: Array, positions: Array) -> None:
        kind = 'tension' if np.isfinite(tensions).all() else 'displacement'
        window = self._windows[kind]
        window.put(time, tensions if kind == 'tension' else pulls, positions)
        if not self.recording:
            return
        settled = window.settled()
        if settled is None or self._same(settled, kind):
            return
        if kind != self._last_kind:
            self.recorded.clear()
        self._last_kind = kind
        mean = self.states.mean(settled.begin, settled.end)  # more samples than frames
        if mean is not None:
            settled = replace(settled, inputs=np.split(mean, 2)[kind != 'tension'])
        self.recorded.append(settled)

    def _same(self, settled: StillMeasurement, kind: str) -> bool:
        """Whether the arm still stands where the last posture was recorded."""
        if not self.recorded or kind != self._last_kind:
            return False
        moved = np.abs(settled.inputs - self.recorded[-1].inputs).max()
        return bool(moved < 2.0 * self._changes[kind])

    def _roll(self, time: float, error: Array) -> float:
        size = float(np.linalg.norm(error))
        if np.isfinite(size):
            self._tips.append((time, size))
        while self._tips and self._tips[0][0] < time - self.settings.rolling:
            self._tips.popleft()
        squares = [size**2 for _, size in self._tips]
        return float(np.sqrt(np.mean(squares))) if squares else float('nan')


def read_markers(rows: Sequence[object], robot: Robot) -> tuple[Marker, ...]:
    """
    Return the markers that a parameter lists as {name, arc_length, offset}.

    Raises
    ------
    InputError
        An entry is not usable.

    """
    made = []
    for entry in rows:
        if not isinstance(entry, dict) or not {'name', 'arc_length'} <= set(entry):
            raise InputError(
                'markers: expected a list of {name: m1, arc_length: 0.1, offset: [0, 0, 0]}, '
                f'got {entry!r}'
            )
        try:
            x, y, z = map(float, entry.get('offset', (0.0, 0.0, 0.0)))
            arc = float(entry['arc_length'])
        except (TypeError, ValueError):
            raise InputError(f'markers: {entry!r}: expected numbers in metres') from None
        if not 0.0 <= arc <= robot.length + 1e-9:
            raise InputError(
                f'markers: {entry["name"]}: expected an arc_length from 0 to {robot.length:g} m, '
                f'got {arc:g}'
            )
        made.append(Marker(str(entry['name']), arc, (x, y, z)))
    return tuple(made)
