"""Read what a ROS 2 recording holds about a measurement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import DataSetError
from .bag_messages import (
    JOINT_STATE,
    POSE_ARRAY,
    POSE_STAMPED,
    STRING,
    joints_of,
    parse_pose_array,
    poses_of,
)
from .bag_writer import DESCRIPTION, LABEL, ROBOT, need_rosbags
from .dataset import FloatArray, listing

Message = tuple[str, int, Any]  # topic, time [ns], message or (frame, poses)


@dataclass(frozen=True)
class Topics:
    """Where a recording holds what; names without the leading slash will do."""

    states: str = 'tendon_states'  # sensor_msgs/JointState
    shape: str = 'measured_shape'  # geometry_msgs/PoseArray
    markers: Mapping[str, str] = field(default_factory=dict)  # marker -> PoseStamped topic


@dataclass(frozen=True)
class Track:
    """Samples of J markers that came in the same messages, S of them."""

    times: FloatArray  # (S,) [s] since the recording began
    positions: FloatArray  # (S, J, 3) [m]
    orientations: FloatArray  # (S, J, 4)


@dataclass(frozen=True)
class Recording:
    """What a bag holds; times in seconds since it began."""

    name: str
    state_times: FloatArray  # (T,) [s]
    states: list[Any]  # (T,) the JointState messages
    tracks: tuple[Track, ...]  # one of all markers, or one per marker
    marker_names: tuple[str, ...]  # of tracks of one marker each; empty for a PoseArray
    labels: list[tuple[float, str]]  # (time [s], text)
    description: str | None  # text of dataset.yaml
    robot: str | None  # text of robot.yaml

    def inputs(self, names: tuple[str, ...], kind: str) -> FloatArray:
        """Return the inputs at `state_times`, (T, m) [N] or [m], NaN where not given."""
        column = 0 if kind == 'displacement' else 1
        return _sane(np.array([joints_of(state, names)[column] for state in self.states]))


def read_bag(path: str | Path, topics: Topics | None = None) -> Recording:
    """
    Read a rosbag2 folder, or a single .mcap or .db3 file.

    Raises
    ------
    DataSetError
        It is no recording, or a topic is missing or of another type.
    MissingExtraError
        The package rosbags is not installed.

    """
    topics = topics or Topics()
    with opened(path) as reader:
        found = {c.topic: c.msgtype for c in reader.connections}
        wanted = _wanted(str(path), found, topics)
        messages = list(_messages(reader, wanted))
    return _sorted(str(path), messages, wanted, topics)


@contextmanager
def opened(path: str | Path) -> Iterator[Any]:
    """
    Open a recording for reading; what fails while it is read is one line, too.

    Raises
    ------
    DataSetError
        It is no recording, or damaged.
    MissingExtraError
        The package rosbags is not installed.

    """
    need_rosbags()
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    path = Path(path)
    if not path.exists():
        raise DataSetError(str(path), 'is not there', 'name a rosbag2 folder or an .mcap file')
    if path.suffix == '.bag':
        raise DataSetError(
            str(path), 'is a ROS 1 bag', f'convert it: rosbags-convert --src {path} --dst NEW'
        )
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            yield reader
    except DataSetError:
        raise
    except Exception as error:  # a damaged file can fail anywhere in the parser
        reason = ' '.join(str(error).split())[:200] or type(error).__name__
        raise DataSetError(
            str(path), f'cannot be read ({reason})', 'repair it (mcap recover) or record it again'
        ) from None


def is_bag(path: str | Path) -> bool:
    """Whether a path looks like a recording: a rosbag2 folder, or an .mcap or .db3 file."""
    path = Path(path)
    return path.suffix in ('.mcap', '.db3') or (path / 'metadata.yaml').is_file()


def topic_of(found: Mapping[str, str], name: str, kind: str) -> str | None:
    """Return the topic of a kind with this name, or the only one below a namespace."""
    exact = '/' + name.lstrip('/')
    if found.get(exact) == kind:
        return exact
    below = [t for t, k in found.items() if k == kind and t.endswith(exact)]
    return below[0] if len(below) == 1 else None


def _wanted(bag: str, found: Mapping[str, str], topics: Topics) -> dict[str, str]:
    """Map the topics to read to what they are: 'states', 'shape', a marker or a text."""
    wanted = {name: name for name in (DESCRIPTION, ROBOT, LABEL) if found.get(name) == STRING}
    shapes = [(topic, f'marker {name}', POSE_STAMPED) for name, topic in topics.markers.items()]
    shapes = shapes or [(topics.shape, 'shape', POSE_ARRAY)]
    for topic, role, kind in [(topics.states, 'states', JOINT_STATE), *shapes]:
        name = '/' + topic.lstrip('/')
        if (there := topic_of(found, topic, kind)) is None:
            known = listing(sorted(t for t, k in found.items() if k == kind))
            problem = f'is a {found[name]}' if name in found else 'is not in it'
            raise DataSetError(
                bag, f'topic {name} {problem}', f'name one that is a {kind}; there: {known}'
            )
        wanted[there] = role
    return wanted


def _messages(reader: Any, wanted: Mapping[str, str]) -> Iterator[Message]:
    connections = [c for c in reader.connections if c.topic in wanted]
    for connection, time, data in reader.messages(connections=connections):
        if connection.msgtype == POSE_ARRAY:
            yield connection.topic, time, parse_pose_array(data)
            continue
        message = reader.deserialize(data, connection.msgtype)
        shown = poses_of(message) if connection.msgtype == POSE_STAMPED else message
        yield connection.topic, time, shown


def _sorted(
    bag: str, messages: list[Message], wanted: Mapping[str, str], topics: Topics
) -> Recording:
    """Sort messages by what they are."""
    by_role: dict[str, list[tuple[float, Any]]] = {role: [] for role in wanted.values()}
    start = min((time for _, time, _ in messages), default=0)
    frames = set()
    for topic, time, message in messages:
        by_role[wanted[topic]].append((1e-9 * (time - start), message))
        if isinstance(message, tuple):
            frames.add(message[0])
    if len(frames) > 1:
        raise DataSetError(
            bag,
            f'shapes are given in the frames {listing(sorted(map(repr, frames)))}',
            'record all markers in the frame of the base',
        )
    shapes = [f'marker {name}' for name in topics.markers] or ['shape']
    for role in ('states', *shapes):
        if not by_role[role]:
            raise DataSetError(bag, f'there is no message about {role}', 'record it again')
    texts = {key: [m.data for _, m in by_role.get(key, [])] for key in (DESCRIPTION, ROBOT)}
    return Recording(
        name=bag,
        state_times=np.array([time for time, _ in by_role['states']]),
        states=[message for _, message in by_role['states']],
        tracks=tuple(_track(bag, by_role[role]) for role in shapes),
        marker_names=tuple(topics.markers),
        labels=[(time, message.data) for time, message in by_role.get(LABEL, [])],
        description=texts[DESCRIPTION][-1] if texts[DESCRIPTION] else None,
        robot=texts[ROBOT][-1] if texts[ROBOT] else None,
    )


def _track(bag: str, samples: list[tuple[float, Any]]) -> Track:
    poses = [values for _, (_, values) in samples]
    counts = {len(row) for row in poses}
    if len(counts) > 1:
        raise DataSetError(
            bag,
            f'the shape has {min(counts)} poses in one message and {max(counts)} in another',
            'publish every marker always, NaN where it is not seen',
        )
    values = _sane(np.stack(poses))
    missing = ~np.isfinite(values[..., :3]).all(axis=-1)
    values[missing] = np.nan
    return Track(np.array([time for time, _ in samples]), values[..., :3], values[..., 3:])


def _sane(values: FloatArray) -> FloatArray:
    """Return values with NaN for what is no measurement but would overflow in a sum."""
    return np.where(np.abs(values) < 1e9, values, np.nan)
