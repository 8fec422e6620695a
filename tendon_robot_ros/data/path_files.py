"""Paths to follow: tip targets or inputs over time, from a CSV file or a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError
from ..common.rotations import from_quaternion
from .bag_reader import opened, stored, topic_of
from .bag_writer import JOINT_STATE, POSE_STAMPED, joints_of
from .csv_file import CsvFile, first_line

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
    try:  # errors of the file are raised when it is read below
        header = {cell.strip(' "\n') for cell in first_line(path, NO_PATH).split(',')}
    except DataSetError:
        header = set()
    if header & set(inputs):
        columns = ('time', *inputs)
        file = CsvFile(path, columns, columns, 'write a number', NO_PATH).read((), columns)
        values = file.columns(inputs)
        return TendonRows(_times(file, values), values)
    file = CsvFile(path, PLACE, ('time', *PLACE, *VIEW), missing, NO_PATH)
    file.read((), file.header)
    positions = file.columns(PLACE)
    times = _times(file, positions)
    directions = np.full((len(positions), 3), np.nan)
    if present := [name for name in VIEW if name in file.numbers]:
        if len(present) < 3:
            raise DataSetError(str(path), 'a direction needs dx, dy and dz', 'add the columns')
        values = file.columns(VIEW)
        empty = np.isnan(values)
        half = empty.any(axis=1) & ~empty.all(axis=1)
        file.refuse(half, 'half a direction', 'write dx, dy and dz, or none')
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

    def __len__(self) -> int:
        return len(self.times)


@dataclass(frozen=True)
class Moves:
    """A recording of motion; times [s] since its first message."""

    targets: Places
    trajectory_times: Floats  # when a trajectory of the tendons took over
    tips: Places
    measured: bool  # whether a tracker measured the tip; else it is the model's
    inputs: tuple[str, ...]
    command_times: Floats  # (C,)
    commands: Floats  # (C, m) [N], or [m] if pull
    pull: bool


def read_moves(path: str | Path) -> Moves:
    """
    Read targets, commands and tips.

    Raises
    ------
    DataSetError
        It is no recording, or holds neither targets nor commands.

    """
    received: dict[str, list[tuple[float, Any]]] = {}
    with opened(path) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        tips = [(name, POSE_STAMPED) for name in TIPS]
        kinds = [*TARGETS, TRAJECTORY, *tips, (COMMAND, JOINT_STATE)]
        topics = ((topic_of(types, name, kind), name) for name, kind in kinds)
        roles = {topic: name for topic, name in topics if topic is not None}
        for connection, time, data in stored(reader, roles):
            message = reader.deserialize(data, connection.msgtype)
            received.setdefault(roles[connection.topic], []).append((1e-9 * time, message))
        start = 1e-9 * reader.start_time
    if not any(received.get(name) for name in ('target_pose', 'target_point', COMMAND)):
        problem = 'holds neither target_pose, target_point nor tendon_command'
        raise DataSetError(str(path), problem, 'record them: python -m tendon_robot_ros record')
    targets = [_place(m) for name, _ in TARGETS for m in received.get(name, [])]
    tip = next((name for name in TIPS if received.get(name)), TIPS[-1])
    sent = received.get(COMMAND, [])
    names = tuple(sent[0][1].name) if sent else ()
    pull = bool(sent) and len(sent[0][1].effort) == 0
    values = np.array([joints_of(message, names)[0 if pull else 1] for _, message in sent])
    values = values.reshape(len(sent), len(names))
    good = np.isfinite(values).all(axis=1)
    return Moves(
        _places(targets, start),
        np.array([time - start for time, _ in received.get(TRAJECTORY[0], [])]),
        _places([_place(m) for m in received.get(tip, [])], start),
        tip == TIPS[0],
        names,
        np.array([time - start for time, _ in sent])[good],
        values[good],
        pull,
    )


def _place(stamped: tuple[float, Any]) -> tuple[float, Floats, Floats]:
    """Return time, position and approach direction (+z) of a pose or a point."""
    time, message = stamped
    if hasattr(message, 'point'):
        p = message.point
        return time, np.array([p.x, p.y, p.z]), np.full(3, np.nan)
    p, q = message.pose.position, message.pose.orientation
    return time, np.array([p.x, p.y, p.z]), from_quaternion((q.x, q.y, q.z, q.w))[:, 2]


def _places(samples: list[tuple[float, Floats, Floats]], start: float) -> Places:
    samples = sorted(samples, key=lambda sample: sample[0])
    samples = [s for s in samples if np.isfinite(s[1]).all()]
    return Places(
        np.array([time - start for time, _, _ in samples]),
        np.array([place for _, place, _ in samples]).reshape(-1, 3),
        np.array([view for _, _, view in samples]).reshape(-1, 3),
    )
