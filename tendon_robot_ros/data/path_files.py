"""Paths to follow, from a CSV file or a recording, and runs along them against their targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats, interpolated
from ..common.errors import DataSetError
from ..common.rotations import angle_between, from_quaternion
from .bag_reader import POSE_STAMPED, joints_of, opened, stored, topic_of
from .bag_writer import JOINT_STATE
from .csv_file import CsvFile, csv_text

PLACE, VIEW = ('x', 'y', 'z'), ('dx', 'dy', 'dz')
NO_PATH = 'name a CSV file of targets, or a recording'


@dataclass(frozen=True)
class TipRows:
    """Targets of the tip; with `held` each target holds until the next one."""

    times: Floats | None  # (n,) [s] from 0, None: as fast as the limits allow
    positions: Floats  # (n, 3) [m]
    directions: Floats  # (n, 3) unit vectors, NaN where none is asked
    held: bool = False


@dataclass(frozen=True)
class TendonRows:
    """Values of the robot's inputs over time."""

    times: Floats  # (n,) [s] from 0
    values: Floats  # (n, m) [N] or [m]


def read_path(path: str | Path, inputs: tuple[str, ...]) -> TipRows | TendonRows:
    """
    Read a CSV file of targets.

    Columns are x, y, z [m] in the base frame, and as you like dx, dy, dz (approach direction, of
    any length; empty cells: none) and time [s]; or time [s] and the robot's inputs [N] or [m].

    Parameters
    ----------
    path : str or Path
        The file.
    inputs : tuple of str
        Names of the robot's inputs.

    Raises
    ------
    DataSetError
        With row, what is wrong, and what to do.

    """
    path = Path(path)
    missing = 'write a number, or leave dx, dy and dz empty for no direction'
    line = csv_text(path, NO_PATH).partition('\n')[0]
    if set(inputs) & {cell.strip(' "') for cell in line.split(',')}:
        columns = ('time', *inputs)
        file = CsvFile(path, columns, columns, 'write a number', NO_PATH).read(())
        values = file.columns(inputs)
        return TendonRows(_times(file, values), values)
    file = CsvFile(path, PLACE, ('time', *PLACE, *VIEW), missing, NO_PATH).read(())
    positions = file.columns(PLACE)
    times = _times(file, positions)
    directions = np.full((len(positions), 3), np.nan)
    if present := [name for name in VIEW if name in file.numbers]:
        if len(present) < 3:
            raise DataSetError(str(path), 'a direction needs dx, dy and dz', 'add the columns')
        values = file.all_or_none(VIEW, 'half a direction', 'write dx, dy and dz, or none')
        sizes = np.linalg.norm(values, axis=1)
        file.refuse(sizes < 1e-6, 'the direction is zero', 'write where the tip looks')
        directions = values / sizes[:, None]
    return TipRows(times if 'time' in file.numbers else None, positions, directions)


def _times(file: CsvFile, values: Floats) -> Floats:
    """Return the times (n,) [s] of values (n, c) from 0, else their rows; refuse gaps."""
    times = file.numbers.get('time', np.arange(len(values), dtype=float))
    empty = np.isnan(np.column_stack([times, values])).any(axis=1)
    file.refuse(empty, 'a cell is empty', 'write a number')
    back = np.diff(times, prepend=-np.inf) <= 0.0
    file.refuse(back, 'time does not grow', 'write the time of every row after the last')
    return np.asarray(times - times[0])


def write_path(path: Path, rows: TipRows | TendonRows, inputs: tuple[str, ...]) -> None:
    """Write a CSV file that `read_path` gives back."""
    if isinstance(rows, TendonRows):
        names, values = list(inputs), rows.values
    else:
        names, values = [*PLACE, *VIEW], np.hstack([rows.positions, rows.directions])
    if rows.times is not None:
        names, values = ['time', *names], np.column_stack([rows.times, values])
    lines = [','.join(names)]
    values = np.round(values, 9) + 0.0  # no minus before a zero
    lines += [','.join('' if np.isnan(v) else f'{v:.9g}' for v in row) for row in values]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


POINT = 'geometry_msgs/msg/PointStamped'
TARGETS = (('target_pose', POSE_STAMPED), ('target_point', POINT))
TIPS = ('measured_tip', 'predicted_tip')
COMMAND = 'tendon_command'
TRAJECTORY = ('tendon_trajectory', 'trajectory_msgs/msg/JointTrajectory')


@dataclass(frozen=True)
class Places:
    """Positions (n, 3) [m] and directions (n, 3), NaN where none is given, over time (n,) [s]."""

    times: Floats
    positions: Floats
    directions: Floats

    @classmethod
    def of(cls, samples: Sequence[tuple[float, Floats, Floats]]) -> Places:
        """Return samples (time, position, direction)."""
        times, places, views = zip(*samples, strict=True) if samples else ((), (), ())
        return cls(np.array(times), *(np.reshape(one, (-1, 3)) for one in (places, views)))

    def at(self, times: Floats) -> tuple[Floats, Floats]:
        """Return positions (n, 3) [m] and unit vectors (n, 3) at times (n,) [s]."""
        along = interpolated(times, self.times, self.directions)
        sizes = np.linalg.norm(along, axis=1, keepdims=True)
        places = interpolated(times, self.times, self.positions)
        return places, along / np.where(sizes > 0.0, sizes, np.nan)

    def __len__(self) -> int:
        return len(self.times)


@dataclass(frozen=True)
class PathRun:
    """
    A path that was followed; all times [s] since it began.

    Attributes
    ----------
    inputs : tuple of str, length m
    targets : Places
        Of the tip as they were sent. Empty for trajectories of the tendons.
    row_times : ndarray, shape (n,)
        When every given row was due.
    tips : Places
        The tip, measured or as the model predicts it.
    measured : bool
        Whether a tracker measured it.
    command_times, commands : ndarray, shapes (C,), (C, m) [N], or [m] in pull mode
        Commands as they were sent.
    pull : bool
        Whether the commands are wire pulls.
    target_values : ndarray, shape (n, m), optional
        Targets of the tendons, for trajectories of the tendons.

    """

    inputs: tuple[str, ...]
    targets: Places
    row_times: Floats
    tips: Places
    measured: bool
    command_times: Floats
    commands: Floats
    pull: bool
    target_values: Floats | None = None

    def errors(self, times: Floats) -> tuple[Floats, Floats]:
        """Return distances (n,) [m] and angles (n,) [rad] between tip and target at times."""
        targets, views = self.targets.at(times)
        places, along = self.tips.at(times)
        return np.linalg.norm(places - targets, axis=1), angle_between(views, along)

    def across(self) -> Floats:
        """Return distances (T,) [m] of the tip from the nearest point of the path."""
        tips, targets = self.tips.positions, self.targets.positions
        if not len(targets):
            return np.full(len(tips), np.nan)
        step = np.diff(targets, axis=0, append=targets[-1:])  # the last piece is a point
        length = (step**2).sum(axis=1)
        distances = []
        for tip in tips:  # nearest point of every straight piece
            fraction = ((tip - targets) * step).sum(axis=1) / np.where(length > 0.0, length, 1.0)
            nearest = targets + np.clip(fraction, 0.0, 1.0)[:, None] * step
            distances.append(np.nanmin(np.linalg.norm(nearest - tip, axis=1)))
        return np.array(distances)

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON: the tip at every row [m], and its distances from targets."""
        tips = self.tips.at(self.row_times)[0].tolist()
        content = {'times': self.row_times.tolist(), 'tips': tips, 'measured': self.measured}
        if self.target_values is None:
            content |= zip(('rms', 'largest', 'from_path'), self.distances(), strict=True)
        return content

    def distances(self) -> tuple[float, float, float]:
        """Return rms and maximum distance [m] from the present target, maximum from the path."""
        errors, _ = self.errors(self.tips.times)
        return float(np.sqrt(np.mean(errors**2))), float(errors.max()), float(self.across().max())


def read_moves(path: str | Path) -> tuple[PathRun, Places]:
    """
    Read targets, commands and tips: as a run whose targets stand until the next, and as rows.

    Raises
    ------
    DataSetError
        It is no recording, or holds neither targets nor commands.

    """
    received: dict[str, list[tuple[float, Any]]] = {}
    with opened(path) as reader:
        start = 1e-9 * reader.start_time
        types = {c.topic: c.msgtype for c in reader.connections}
        poses = [(name, POSE_STAMPED) for name in TIPS]
        kinds = [*TARGETS, TRAJECTORY, *poses, (COMMAND, JOINT_STATE)]
        topics = ((topic_of(types, name, kind), name) for name, kind in kinds)
        roles = {topic: name for topic, name in topics if topic is not None}
        for topic, time, message in stored(reader, roles):
            received.setdefault(roles[topic], []).append((1e-9 * time - start, message))
    if not any(received.get(name) for name in ('target_pose', 'target_point', COMMAND)):
        problem = 'holds neither target_pose, target_point nor tendon_command'
        raise DataSetError(str(path), problem, 'record them: python -m tendon_robot_ros record')
    targets = _places([m for name, _ in TARGETS for m in received.get(name, [])])
    tip = next((name for name in TIPS if received.get(name)), TIPS[-1])
    tips = _places(received.get(tip, []))
    trajectories = np.array([time for time, _ in received.get(TRAJECTORY[0], [])])
    sent = received.get(COMMAND, [])
    names = tuple(sent[0][1].name) if sent else ()
    pull = bool(sent) and len(sent[0][1].effort) == 0
    kind = 'displacement' if pull else 'tension'
    values = np.array([joints_of(m, names, kind) for _, m in sent]).reshape(len(sent), len(names))
    good = np.isfinite(values).all(axis=1)
    run = PathRun(
        inputs=names,
        targets=_standing(targets, trajectories, float(tips.times.max(initial=0.0))),
        row_times=targets.times,
        tips=tips,
        measured=tip == TIPS[0],
        command_times=np.array([time for time, _ in sent])[good],
        commands=values[good],
        pull=pull,
    )
    return run, targets


def _standing(targets: Places, trajectories: Floats, end: float) -> Places:
    """
    Return targets as a curve: each from its time to its end, then NaN until the next one.

    It ends with the next target, when a trajectory of the tendons takes over (t,) [s], or at the
    end [s].
    """
    if not len(targets):
        return targets
    until = np.append(targets.times[1:], max(end, targets.times[-1]))
    for i, time in enumerate(targets.times):
        until[i] = min([until[i], *trajectories[trajectories > time][:1]])
    times = np.column_stack([targets.times, until - 2e-6, until - 1e-6]).reshape(-1)
    positions = np.repeat(targets.positions, 3, axis=0)
    ended = until < np.append(targets.times[1:], np.inf)
    positions[2::3][ended] = np.nan
    return Places(times, positions, np.repeat(targets.directions, 3, axis=0))


def _places(stamped: list[tuple[float, Any]]) -> Places:
    """Return the places of poses and points with their times [s], in the order of time."""
    samples = sorted(map(_place, stamped), key=lambda sample: sample[0])
    return Places.of([sample for sample in samples if np.isfinite(sample[1]).all()])


def _place(stamped: tuple[float, Any]) -> tuple[float, Floats, Floats]:
    """Return time, position and approach direction (+z) of a pose or a point."""
    time, message = stamped
    if hasattr(message, 'point'):
        p = message.point
        return time, np.array([p.x, p.y, p.z]), np.full(3, np.nan)
    _, (pose,) = message
    return time, pose[:3], from_quaternion(pose[3:])[:, 2]
