"""What a recording holds about moving: targets of the tip, commands, and where the tip went."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import DataSetError
from .bag_messages import JOINT_STATE, POSE_STAMPED, joints_of
from .bag_reader import opened, topic_of
from .dataset import FloatArray

POINT = 'geometry_msgs/msg/PointStamped'
TARGETS = (('target_pose', POSE_STAMPED), ('target_point', POINT))
TIPS = ('measured_tip', 'predicted_tip')
COMMAND = 'tendon_command'
TRAJECTORY = ('tendon_trajectory', 'trajectory_msgs/msg/JointTrajectory')


@dataclass(frozen=True)
class Places:
    """Positions (n, 3) [m] and directions (n, 3), NaN where none is given, over time (n,) [s]."""

    times: FloatArray
    positions: FloatArray
    directions: FloatArray

    def __len__(self) -> int:
        return len(self.times)


@dataclass(frozen=True)
class Moves:
    """A recording of motion; times [s] since its first message."""

    targets: Places
    trajectory_times: FloatArray  # when a trajectory of the tendons took over
    tips: Places
    measured: bool  # whether a tracker measured the tip; else it is the model's
    inputs: tuple[str, ...]
    command_times: FloatArray  # (C,)
    commands: FloatArray  # (C, m) [N], or [m] if pull
    pull: bool


def read_moves(path: str | Path) -> Moves:
    """
    Read targets, commands and tips.

    Raises
    ------
    DataSetError
        It is no recording, or holds neither targets nor commands.

    """
    heard: dict[str, list[tuple[float, Any]]] = {}
    with opened(path) as reader:
        found = {c.topic: c.msgtype for c in reader.connections}
        wanted = _wanted(found)
        connections = [c for c in reader.connections if c.topic in wanted]
        for connection, time, data in reader.messages(connections=connections):
            message = reader.deserialize(data, connection.msgtype)
            heard.setdefault(wanted[connection.topic], []).append((1e-9 * time, message))
        start = 1e-9 * reader.start_time
    if not any(heard.get(name) for name in ('target_pose', 'target_point', COMMAND)):
        raise DataSetError(
            str(path),
            'holds neither target_pose, target_point nor tendon_command',
            'record them: python -m tendon_robot_ros record',
        )
    targets = [_place(m) for name, _ in TARGETS for m in heard.get(name, [])]
    tip = next((name for name in TIPS if heard.get(name)), TIPS[-1])
    names, times, values, pull = _commands(heard.get(COMMAND, []))
    return Moves(
        _places(targets, start),
        np.array([time - start for time, _ in heard.get(TRAJECTORY[0], [])]),
        _places([_place(m) for m in heard.get(tip, [])], start),
        tip == TIPS[0],
        names,
        times - start,
        values,
        pull,
    )


def _wanted(found: dict[str, str]) -> dict[str, str]:
    names = [
        *TARGETS,
        TRAJECTORY,
        *((name, POSE_STAMPED) for name in TIPS),
        (COMMAND, JOINT_STATE),
    ]
    wanted = {}
    for name, kind in names:
        topic = topic_of(found, name, kind)
        if topic is not None:
            wanted[topic] = name
    return wanted


def _place(heard: tuple[float, Any]) -> tuple[float, FloatArray, FloatArray]:
    """Return time, position and approach direction (+z) of a pose or a point."""
    time, message = heard
    if hasattr(message, 'point'):
        p = message.point
        return time, np.array([p.x, p.y, p.z]), np.full(3, np.nan)
    p, q = message.pose.position, message.pose.orientation
    along = np.array(
        [
            2.0 * (q.x * q.z + q.w * q.y),
            2.0 * (q.y * q.z - q.w * q.x),
            1.0 - 2.0 * (q.x**2 + q.y**2),
        ]
    )
    return time, np.array([p.x, p.y, p.z]), along


def _places(samples: list[tuple[float, FloatArray, FloatArray]], start: float) -> Places:
    samples = sorted(samples, key=lambda sample: sample[0])
    samples = [s for s in samples if np.isfinite(s[1]).all()]
    return Places(
        np.array([time - start for time, _, _ in samples]),
        np.array([place for _, place, _ in samples]).reshape(-1, 3),
        np.array([view for _, _, view in samples]).reshape(-1, 3),
    )


def _commands(
    heard: list[tuple[float, Any]],
) -> tuple[tuple[str, ...], FloatArray, FloatArray, bool]:
    if not heard:
        return (), np.zeros(0), np.zeros((0, 0)), False
    names = tuple(heard[0][1].name)
    pull = len(heard[0][1].effort) == 0
    values = np.array([joints_of(message, names)[0 if pull else 1] for _, message in heard])
    times = np.array([time for time, _ in heard])
    good = np.isfinite(values).all(axis=1)
    return names, times[good], values[good], pull
