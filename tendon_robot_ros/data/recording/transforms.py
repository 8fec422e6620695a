"""Frames of a recording: markers that came as transforms, and where a tracker's frame lies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...common.errors import DataSetError
from ...common.rotations import from_quaternion
from ...common.words import listing
from ..dataset import FloatArray
from .reader import TF, Recording, Topics, Track, opened, other_sources, read_bag, stored
from .writer import POSE_STAMPED

BASES = ('', 'base', 'base_link', 'base_frame')  # and what ends with _base
STEADY_M, STEADY_RAD = 1e-3, 0.01  # a mount moves by less
Pose = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]  # rotation (3, 3), shift (3,) [m]


def is_base(frame: str) -> bool:
    """Whether a frame is called as the base of an arm is; '' says nothing, and is taken so."""
    name = frame.rpartition('/')[2]
    return name in BASES or name.endswith('_base')


class Transforms:
    """The transforms of a recording: of every frame its parent, and where it was in it."""

    def __init__(self, name: str, start: int, samples: Mapping[tuple[str, str], Any]) -> None:
        """Take rows (S, 8) of time [ns], x, y, z [m], qx, qy, qz, qw by parent and child."""
        self._name, self._start = name, start
        self.edges = {pair: np.array(rows) for pair, rows in samples.items()}

    @property
    def children(self) -> list[str]:
        """Frames that are given in another one."""
        return sorted({child for _, child in self.edges})

    def track(self, child: str) -> tuple[str, Track]:
        """Return the frame in which a marker is given, and its samples."""
        parents = [parent for parent, own in self.edges if own == child]
        if len(parents) > 1:
            raise DataSetError(
                self._name,
                f'frame {child!r} is given in {listing(parents)}',
                'record it again with one program that publishes it',
            )
        rows = self.edges[parents[0], child]
        times = 1e-9 * (rows[:, 0] - self._start)
        return parents[0], Track(times, rows[:, None, 1:4].copy(), rows[:, None, 4:].copy())

    def to_base(self, frame: str) -> Pose | None:
        """
        Return the rotation and the shift from a frame to the base, None where nothing joins them.

        Raises
        ------
        DataSetError
            The frame moves.

        """
        ways: dict[str, list[tuple[str, str]]] = {frame: []}  # transforms up to a frame
        for here in iter(waiting := [frame]):
            if here and is_base(here):
                return self._along(frame, ways[here])
            for pair in self.edges:
                if here in pair and (other := pair[pair[0] == here]) not in ways:
                    ways[other] = [*ways[here], pair]
                    waiting.append(other)
        return None

    def _along(self, frame: str, way: Sequence[tuple[str, str]]) -> Pose:
        """Return the rotation and the shift along some transforms, each from either end."""
        turn, shift = np.eye(3), np.zeros(3)
        for parent, child in way:
            step, moved = self._steady(parent, child, self.edges[parent, child])
            if frame == parent:
                step, moved = step.T, -step.T @ moved
            frame = child if frame == parent else parent
            turn, shift = step @ turn, step @ shift + moved
        return turn, shift

    def _steady(self, parent: str, child: str, rows: FloatArray) -> Pose:
        place, turned = np.median(rows[:, 1:4], axis=0), rows[len(rows) // 2, 4:]
        far = np.linalg.norm(rows[:, 1:4] - place, axis=1).max()
        along = np.clip(np.abs(rows[:, 4:] @ turned), 0.0, 1.0)
        if far > STEADY_M or 2.0 * np.arccos(along.min()) > STEADY_RAD:
            raise DataSetError(
                self._name,
                f'frame {child!r} moves in {parent!r}, by {1e3 * far:.3g} mm: markers cannot be '
                'given in it',
                'record them in a frame that is fixed to the base',
            )
        return from_quaternion((turned / np.linalg.norm(turned)).tolist()), place


def read_transforms(recording: Recording) -> Transforms:
    """Read all transforms of a recording, static ones as well."""
    samples: dict[tuple[str, str], list[list[float]]] = {}
    with opened(recording.name) as reader:
        wanted = [c.topic for c in reader.connections if c.msgtype == TF]
        for connection, time, data in stored(reader, wanted):
            for one in reader.deserialize(data, connection.msgtype).transforms:
                p, q = one.transform.translation, one.transform.rotation
                pair = one.header.frame_id.lstrip('/'), one.child_frame_id.lstrip('/')
                row = [float(time), p.x, p.y, p.z, q.x, q.y, q.z, q.w]
                samples.setdefault(pair, []).append(row)
    return Transforms(recording.name, recording.start, samples)


def with_markers(
    recording: Recording, topics: Topics, names: Sequence[str], bag: str | Path
) -> Recording:
    """
    Return a recording with its markers, where these came as poses or transforms of their own.

    Parameters
    ----------
    recording : Recording
        Without markers.
    topics : Topics
        Its `markers` may name frames instead of topics.
    names : sequence of str
        Of the markers of the description: by default a frame, or a part of a topic, is called so.
    bag : path
        Of the recording.

    Raises
    ------
    DataSetError
        No topic and no frame is called as a marker; with those that are there.

    """
    with opened(bag) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
    poses = [topic for topic in other_sources(types) if types[topic] == POSE_STAMPED]
    if not topics.markers:
        own = {n: [t for t in poses if n in t.split('/')] for n in names}
        if all(len(there) == 1 for there in own.values()):
            return read_bag(bag, replace(topics, markers={n: t[0] for n, t in own.items()}))
    transforms = read_transforms(recording)
    chosen = dict(topics.markers) or {name: name for name in names}
    chosen = {name: frame.lstrip('/') for name, frame in chosen.items()}
    there = transforms.children
    lacking = [frame for frame in chosen.values() if frame not in there]
    if lacking:
        shown = [*poses, *there]
        raise DataSetError(
            str(bag),
            f'topic /{topics.shape.lstrip("/")} is not in it, and no topic or frame of /tf is '
            f'called {listing(lacking)}',
            f'say which is which marker, --marker {next(iter(chosen))}=NAME for each; there: '
            f'{listing(shown)}',
        )
    found = [transforms.track(frame) for frame in chosen.values()]
    parents = {parent for parent, _ in found}
    tracks = []
    for parent, track in found:
        pose = transforms.to_base(parent)
        if pose is None and len(parents) > 1:
            raise DataSetError(
                str(bag),
                f'markers are given in the frames {listing(sorted(parents))}, which nothing joins',
                'record all of them in one frame, or /tf_static with them',
            )
        tracks.append(track if pose is None else _moved(track, *pose))
    joined = all(transforms.to_base(parent) is not None for parent in parents)
    frame = 'base' if joined else parents.pop()
    return replace(recording, tracks=tuple(tracks), marker_names=tuple(chosen), frame=frame)


def in_base(recording: Recording) -> Recording:
    """Return a recording in the frame of the base where its transforms say where that is."""
    if is_base(recording.frame):
        return recording
    pose = read_transforms(recording).to_base(recording.frame.lstrip('/'))
    if pose is None:
        return recording
    tracks = tuple(_moved(track, *pose) for track in recording.tracks)
    return replace(recording, tracks=tracks, frame='base')


def _moved(track: Track, turn: FloatArray, shift: FloatArray) -> Track:
    from scipy.spatial.transform import Rotation

    turned = track.orientations.copy()
    known = np.linalg.norm(np.nan_to_num(turned), axis=-1) > 0.5
    plain = (turned == [0.0, 0.0, 0.0, 1.0]).all(axis=-1)  # a tracker that gives no turn
    known &= ~plain
    if known.any():
        turned[known] = (Rotation.from_matrix(turn) * Rotation.from_quat(turned[known])).as_quat()
    return Track(track.times, track.positions @ turn.T + shift, turned)
