"""Read what a ROS 2 recording holds about a measurement, and about moving."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import DataSetError
from ...common.words import PROGRAM, listing
from ..dataset import FloatArray
from .writer import (
    DESCRIPTION,
    JOINT_STATE,
    LABEL,
    POSE_ARRAY,
    POSE_STAMPED,
    ROBOT,
    STRING,
    joints_of,
    need_rosbags,
    parse_pose_array,
    poses_of,
)

STORED = ('.mcap', '.db3')  # endings of recordings in one file
TF = 'tf2_msgs/msg/TFMessage'
Message = tuple[str, int, Any]  # topic, time [ns], message or (frame, poses)


@dataclass(frozen=True)
class Topics:
    """Where a recording holds what; names without the leading slash will do."""

    states: str = 'tendon_states'  # sensor_msgs/JointState
    shape: str = 'measured_shape'  # geometry_msgs/PoseArray
    markers: Mapping[str, str] = field(default_factory=dict)  # marker -> PoseStamped topic
    sender: str = ''  # of several that published the states, the one whose frame_id has this


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
    tracks: tuple[Track, ...]  # one of all markers, or one per marker; empty: see transforms.py
    marker_names: tuple[str, ...]  # of tracks of one marker each; empty for a PoseArray
    labels: list[tuple[float, str]]  # (time [s], text)
    description: str | None  # text of dataset.yaml
    robot: str | None  # text of robot.yaml
    frame: str = ''  # in which the markers are
    start: int = 0  # [ns] when it began

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
        types = {c.topic: c.msgtype for c in reader.connections}
        wanted = _wanted(str(path), types, topics)
        messages = list(_messages(reader, wanted))
    return _sorted(str(path), messages, wanted, topics, bool(other_sources(types)))


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
    if path.suffix == '.bag' and path.is_dir():
        problem = 'is a folder, and called as a file of ROS 1'
        raise DataSetError(str(path), problem, 'rename it, without .bag')
    if path.suffix == '.bag':
        raise DataSetError(
            str(path), 'is a ROS 1 bag', f'convert it: rosbags-convert --src {path} --dst NEW'
        )
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        is_set = (path / 'dataset.yaml').is_file()
        raise DataSetError(
            str(path),
            f'is {"a data set" if is_set else "a folder without metadata.yaml"}, and no recording',
            f'compare it: {PROGRAM} compare {path}'
            if is_set
            else 'name a rosbag2 folder, or an .mcap or .db3 file',
        )
    if path.is_file() and path.suffix not in STORED:
        raise DataSetError(
            str(path), 'is no recording', f'name a rosbag2 folder, or a file {" or ".join(STORED)}'
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
    return path.suffix in STORED or (path / 'metadata.yaml').is_file()


def topic_of(types: Mapping[str, str], name: str, kind: str) -> str | None:
    """Return the topic of a kind with this name, or the only one below a namespace."""
    exact = '/' + name.lstrip('/')
    if types.get(exact) == kind:
        return exact
    below = [t for t, k in types.items() if k == kind and t.endswith(exact)]
    return below[0] if len(below) == 1 else None


def _wanted(bag: str, types: Mapping[str, str], topics: Topics) -> dict[str, str]:
    """Map the topics to read to what they are: 'states', 'shape', a marker or a text."""
    wanted = {name: name for name in (DESCRIPTION, ROBOT, LABEL) if types.get(name) == STRING}
    shapes = [(topic, f'marker {name}', POSE_STAMPED) for name, topic in topics.markers.items()]
    shapes = shapes or [(topics.shape, 'shape', POSE_ARRAY)]
    for topic, role, kind in [(topics.states, 'states', JOINT_STATE), *shapes]:
        name = '/' + topic.lstrip('/')
        if (there := topic_of(types, topic, kind)) is None:
            sources = other_sources(types)
            told = [t for t in sources if role == 'shape' or types[t] == TF]
            if role != 'states' and name not in types and told:
                continue  # markers come otherwise: transforms.py finds them, or says so
            known = listing(sorted(t for t, k in types.items() if k == kind))
            problem = f'is a {types[name]}' if name in types else 'is not in it'
            raise DataSetError(
                bag, f'topic {name} {problem}', f'name one that is a {kind}; there: {known}'
            )
        wanted[there] = role
    return wanted


def other_sources(types: Mapping[str, str]) -> list[str]:
    """Return the topics that may tell places of markers, if no topic was named or is there."""
    return sorted(t for t, kind in types.items() if kind in (TF, POSE_STAMPED))


def stored(reader: Any, topics: Iterable[str]) -> Iterator[tuple[Any, int, bytes]]:
    """Yield connection, time [ns] and bytes of the messages of topics; of no topic, none."""
    wanted = set(topics)
    connections = [c for c in reader.connections if c.topic in wanted]
    if connections:  # without any, all messages would come
        yield from reader.messages(connections=connections)


def _messages(reader: Any, wanted: Mapping[str, str]) -> Iterator[Message]:
    for connection, time, data in stored(reader, wanted):
        if connection.msgtype == POSE_ARRAY:
            yield connection.topic, time, parse_pose_array(data)
            continue
        message = reader.deserialize(data, connection.msgtype)
        shown = poses_of(message) if connection.msgtype == POSE_STAMPED else message
        yield connection.topic, time, shown


def _sorted(
    bag: str,
    messages: list[Message],
    wanted: Mapping[str, str],
    topics: Topics,
    elsewhere: bool,
) -> Recording:
    """Sort messages by what they are; markers may be told `elsewhere`."""
    by_role: dict[str, list[tuple[float, Any]]] = {role: [] for role in wanted.values()}
    start = min((time for _, time, _ in messages), default=0)
    frames = set()
    for topic, time, message in messages:
        if isinstance(message, tuple):
            frames.add(message[0])
        elif wanted[topic] == 'states' and topics.sender not in message.header.frame_id:
            continue
        by_role[wanted[topic]].append((1e-9 * (time - start), message))
    if len(frames) > 1:
        raise DataSetError(
            bag,
            f'shapes are given in the frames {listing(sorted(map(repr, frames)))}',
            'record all markers in the frame of the base',
        )
    shapes = [f'marker {name}' for name in topics.markers] or ['shape']
    silent = shapes == ['shape'] and not by_role.get('shape') and elsewhere
    if silent or not all(role in by_role for role in shapes):
        shapes = []
    for role in ('states', *shapes):
        if not by_role[role]:
            raise DataSetError(bag, f'there is no message about {role}', 'record it again')
    texts = {key: [m.data for _, m in by_role.get(key, [])] for key in (DESCRIPTION, ROBOT)}
    return Recording(
        name=bag,
        state_times=np.array([time for time, _ in by_role['states']]),
        states=[message for _, message in by_role['states']],
        tracks=tuple(_track(bag, by_role[role]) for role in shapes),
        marker_names=tuple(topics.markers) if shapes else (),
        labels=[(time, message.data) for time, message in by_role.get(LABEL, [])],
        description=texts[DESCRIPTION][-1] if texts[DESCRIPTION] else None,
        robot=texts[ROBOT][-1] if texts[ROBOT] else None,
        frame=next(iter(frames), ''),
        start=start,
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
    values = np.stack(poses)
    missing = ~np.isfinite(values[..., :3]).all(axis=-1)
    values[missing] = np.nan
    times = np.array([time for time, _ in samples])
    return Track(times, values[..., :3], _sane(values[..., 3:]))


def _sane(values: FloatArray) -> FloatArray:
    """Return values with NaN for what is no measurement but would overflow in a sum."""
    return np.where(np.abs(values) < 1e9, values, np.nan)


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
        types = {c.topic: c.msgtype for c in reader.connections}
        wanted = _wanted_moves(types)
        for connection, time, data in stored(reader, wanted):
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


def _wanted_moves(types: dict[str, str]) -> dict[str, str]:
    names = [
        *TARGETS,
        TRAJECTORY,
        *((name, POSE_STAMPED) for name in TIPS),
        (COMMAND, JOINT_STATE),
    ]
    wanted = {}
    for name, kind in names:
        topic = topic_of(types, name, kind)
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
