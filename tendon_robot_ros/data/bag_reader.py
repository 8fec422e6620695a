"""Read the measurements in a ROS 2 recording; refuse messages of two senders."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError, reason_of
from ..common.rotations import from_quaternion
from ..common.words import listing, typed
from ..robot.estimates import NOISE_FACTOR, TRACKER_NOISE_M
from .arrays import CHANCE_PROBABILITY, NO_ROTATION
from .bag_writer import DESCRIPTION, JOINT_STATE, LABEL, POSE_ARRAY, ROBOT, STRING, need_rosbags

STORED = ('.mcap', '.db3')  # endings of recordings in one file
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
TF = 'tf2_msgs/msg/TFMessage'


@dataclass(frozen=True)
class Topics:
    """The topics of a recording by role; the leading slash of a name may be omitted."""

    states: str = 'tendon_states'  # sensor_msgs/JointState
    shape: str = 'measured_shape'  # geometry_msgs/PoseArray
    markers: Mapping[str, str] = field(default_factory=dict)  # marker -> PoseStamped topic
    sender: str = ''  # of several publishers of states, the one with this in its frame_id


@dataclass(frozen=True)
class Track:
    """Samples of J markers that came in the same messages, S of them."""

    times: Floats  # (S,) [s] since the recording began
    positions: Floats  # (S, J, 3) [m]
    orientations: Floats  # (S, J, 4)


@dataclass(frozen=True)
class Recording:
    """The content of a bag; times in seconds since its beginning."""

    name: str
    state_times: Floats  # (T,) [s]
    tracks: tuple[Track, ...]  # one of all markers, or one per marker; empty: see `with_markers`
    states: Sequence[Any] = ()  # (T,) the JointState messages
    marker_names: tuple[str, ...] = ()  # of tracks of one marker each; empty for a PoseArray
    labels: Sequence[tuple[float, str]] = ()  # (time [s], text)
    description: str | None = None  # text of dataset.yaml
    robot: str | None = None  # text of robot.yaml
    frame: str = ''  # in which the markers are
    start: int = 0  # [ns] when it began
    # (T, m) [N] or [m] at `state_times`, once it is known which of them are those of the robot
    inputs: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def in_base(self) -> bool:
        """Whether the markers are in the frame of the base."""
        return is_base(self.frame)

    def states_of(self, names: tuple[str, ...], kind: str) -> Floats:
        """Return the named tensions or pulls, (T, m) [N] or [m], NaN where not given."""
        return _sane(np.array([joints_of(state, names, kind) for state in self.states]))


def read_bag(path: str | Path, topics: Topics) -> Recording:
    """
    Read a rosbag2 folder, or a single .mcap or .db3 file.

    Raises
    ------
    DataSetError
        It is no recording, or a topic is missing or of another type.
    MissingExtraError
        The package rosbags is not installed.

    """
    bag, start = str(path), 0
    received: dict[str, list[tuple[int, Any]]] = {}
    with opened(path) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        roles = _roles(bag, types, topics)
        for topic, time, message in stored(reader, roles):
            role, start = roles[topic], start or time
            if role != 'states' or topics.sender in message.header.frame_id:
                received.setdefault(role, []).append((time, message))
    shapes = [f'marker {name}' for name in topics.markers] or ['shape']
    frames = {frame for role in shapes for _, (frame, _) in received.get(role, ())}
    if len(frames) > 1:
        problem = f'shapes are given in the frames {listing(sorted(map(repr, frames)))}'
        raise DataSetError(bag, problem, 'record all markers in the frame of the base')
    silent = shapes == ['shape'] and 'shape' not in received and other_sources(types)
    if silent or not set(shapes) <= set(roles.values()):
        shapes = []  # `with_markers` reads them from other topics
    for role in ('states', *shapes):
        if role not in received:
            raise DataSetError(bag, f'there is no message about {role}', 'record it again')

    def last(role: str) -> str | None:
        return str(received[role][-1][1].data) if role in received else None

    def times(role: str) -> Floats:
        return 1e-9 * np.array([time - start for time, _ in received[role]])

    return Recording(
        name=bag,
        state_times=times('states'),
        states=[message for _, message in received['states']],
        tracks=tuple(_track(bag, times(role), received[role]) for role in shapes),
        marker_names=tuple(topics.markers) if shapes else (),
        labels=[(1e-9 * (time - start), m.data) for time, m in received.get(LABEL, [])],
        description=last(DESCRIPTION),
        robot=last(ROBOT),
        frame=next(iter(frames), ''),
        start=start,
    )


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
    convert = f'convert it: rosbags-convert --src {shlex.quote(str(path))} --dst NEW'
    compare = f'compare it: {typed("compare", path)}'
    name = 'name a rosbag2 folder, or an .mcap or .db3 file'
    stored = f'name a rosbag2 folder, or a file {" or ".join(STORED)}'
    bag, no_bag = path.suffix == '.bag', not (path / 'metadata.yaml').is_file()
    is_set = (path / 'dataset.yaml').is_file()
    ros_1 = 'is a folder, and called as a file of ROS 1'
    for wrong, problem, remedy in (
        (not path.exists(), 'is not there', 'name a rosbag2 folder or an .mcap file'),
        (bag and path.is_dir(), ros_1, 'rename it, without .bag'),
        (bag, 'is a ROS 1 bag', convert),
        (path.is_dir() and no_bag and is_set, 'is a data set, and no recording', compare),
        (path.is_dir() and no_bag, 'is a folder without metadata.yaml, and no recording', name),
        (path.is_file() and path.suffix not in STORED, 'is no recording', stored),
    ):
        if wrong:
            raise DataSetError(str(path), problem, remedy)
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            yield reader
    except DataSetError:
        raise
    except Exception as error:  # a damaged file can fail anywhere in the parser
        remedy = 'repair it (mcap recover) or record it again'
        raise DataSetError(str(path), f'cannot be read ({reason_of(error)})', remedy) from None


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


def _roles(bag: str, types: Mapping[str, str], topics: Topics) -> dict[str, str]:
    """Map the topics to read to their roles: 'states', 'shape', a marker or a text."""
    roles = {name: name for name in (DESCRIPTION, ROBOT, LABEL) if types.get(name) == STRING}
    shapes = [(topic, f'marker {name}', POSE_STAMPED) for name, topic in topics.markers.items()]
    shapes = shapes or [(topics.shape, 'shape', POSE_ARRAY)]
    for topic, role, kind in [(topics.states, 'states', JOINT_STATE), *shapes]:
        name = '/' + topic.lstrip('/')
        if (name_in_bag := topic_of(types, topic, kind)) is None:
            alternatives = [t for t in other_sources(types) if role == 'shape' or types[t] == TF]
            if role != 'states' and name not in types and alternatives:
                continue  # markers come otherwise: `with_markers` finds them, or says so
            known = listing(sorted(t for t, k in types.items() if k == kind))
            problem = f'is a {types[name]}' if name in types else 'is not in it'
            remedy = f'name one that is a {kind}; there: {known}'
            raise DataSetError(bag, f'topic {name} {problem}', remedy)
        if other := roles.get(name_in_bag):
            problem = f'topic {name_in_bag} is given for {other} and for {role}'
            raise DataSetError(bag, problem, 'give each a topic of its own')
        roles[name_in_bag] = role
    return roles


def other_sources(types: Mapping[str, str]) -> list[str]:
    """Return the topics that may hold markers if the requested one is missing."""
    return sorted(t for t, kind in types.items() if kind in (TF, POSE_STAMPED))


def stored(reader: Any, topics: Iterable[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time [ns] and message of topics; for poses their frame and numbers (J, 7)."""
    selected = set(topics)
    connections = [c for c in reader.connections if c.topic in selected]
    # without any connection, all messages would come
    for connection, time, data in reader.messages(connections) if connections else ():
        kind = connection.msgtype
        message = reader.deserialize(data, kind)
        are_poses = kind in (POSE_STAMPED, POSE_ARRAY)
        yield connection.topic, time, poses_of(message) if are_poses else message


def _track(bag: str, times: Floats, samples: Sequence[tuple[int, tuple[str, Floats]]]) -> Track:
    counts = {len(poses) for _, (_, poses) in samples}
    if len(counts) > 1:
        problem = f'the shape has {min(counts)} poses in one message and {max(counts)} in another'
        raise DataSetError(bag, problem, 'publish every marker always, NaN where it is not seen')
    values = np.stack([poses for _, (_, poses) in samples])
    values[~np.isfinite(values[..., :3]).all(axis=-1)] = np.nan
    return Track(times, values[..., :3], _sane(values[..., 3:]))


def _sane(values: Floats) -> Floats:
    """Replace values that are no measurements, and would overflow in a sum, by NaN."""
    return np.where(np.abs(values) < 1e9, values, np.nan)


def poses_of(message: Any) -> tuple[str, Floats]:
    """Return the frame and x, y, z [m], qx, qy, qz, qw (J, 7) of a PoseStamped or PoseArray."""
    poses = message.poses if hasattr(message, 'poses') else [message.pose]
    both = ((one.position, one.orientation) for one in poses)
    rows = [[p.x, p.y, p.z, q.x, q.y, q.z, q.w] for p, q in both]
    return message.header.frame_id, np.array(rows, dtype=float).reshape(-1, 7)


def joints_of(message: Any, names: Sequence[str], kind: str) -> list[float]:
    """Return tensions [N] or pulls [m] of the named tendons of a JointState; NaN = missing."""
    field = 'position' if kind == 'displacement' else 'effort'
    # a damaged recording may name the fields otherwise, or hold fewer values than names
    given = dict(zip(getattr(message, 'name', ()), getattr(message, field, ()), strict=False))
    return [float(given.get(name, np.nan)) for name in names]


BASES = ('', 'base', 'base_link', 'base_frame')  # and what ends with _base
# [rad] that a fixed frame may turn, because a tracker measures rotations less well
STEADY_RAD = 0.01
Pose = tuple[Floats, Floats]  # rotation (3, 3), shift (3,) [m]


def is_base(frame: str) -> bool:
    """Return whether a frame has a name of the base; the empty name counts as the base."""
    name = frame.rpartition('/')[2]
    return name in BASES or name.endswith('_base')


class Transforms:
    """
    The transforms of a recording, static ones as well.

    `edges` holds rows (S, 8) of time [s], x, y, z [m], qx, qy, qz, qw by parent and child.
    """

    def __init__(self, recording: Recording) -> None:
        """Read them."""
        samples: dict[tuple[str, str], list[list[float]]] = {}
        with opened(recording.name) as reader:
            topics = [c.topic for c in reader.connections if c.msgtype == TF]
            for _, time, message in stored(reader, topics):
                for one in message.transforms:
                    p, q = one.transform.translation, one.transform.rotation
                    pair = one.header.frame_id.lstrip('/'), one.child_frame_id.lstrip('/')
                    row = [1e-9 * (time - recording.start), p.x, p.y, p.z, q.x, q.y, q.z, q.w]
                    samples.setdefault(pair, []).append(row)
        self._name = recording.name
        self.edges = {pair: np.array(rows) for pair, rows in samples.items()}

    def track(self, child: str) -> tuple[str, Track]:
        """Return the parent frame of a marker, and its samples."""
        parents = [parent for parent, own in self.edges if own == child]
        if len(parents) > 1:
            problem = f'frame {child!r} is given in {listing(parents)}'
            remedy = 'record it again with one program that publishes it'
            raise DataSetError(self._name, problem, remedy)
        rows = self.edges[parents[0], child]
        return parents[0], Track(rows[:, 0], rows[:, None, 1:4].copy(), rows[:, None, 4:].copy())

    def to_base(self, frame: str) -> Pose | None:
        """
        Return the rotation and the shift from a frame to the base, None where nothing joins them.

        Raises
        ------
        DataSetError
            The frame moves.

        """
        routes: dict[str, list[tuple[str, str]]] = {frame: []}  # transforms up to a frame
        for current in iter(waiting := [frame]):
            if current and is_base(current):
                break
            for pair in self.edges:
                if current in pair and (other := pair[pair[0] == current]) not in routes:
                    routes[other] = [*routes[current], pair]
                    waiting.append(other)
        else:
            return None
        rotation, shift = np.eye(3), np.zeros(3)
        for parent, child in routes[current]:
            rows = self.edges[parent, child]
            moved, quaternion = np.median(rows[:, 1:4], axis=0), rows[len(rows) // 2, 4:]
            far = np.linalg.norm(rows[:, 1:4] - moved, axis=1).max()
            along = np.clip(np.abs(rows[:, 4:] @ quaternion), 0.0, 1.0)
            if far > NOISE_FACTOR * TRACKER_NOISE_M or 2.0 * np.arccos(along.min()) > STEADY_RAD:
                moves = f'frame {child!r} moves in {parent!r}, by {1e3 * far:.3g} mm'
                remedy = 'record them in a frame that is fixed to the base'
                raise DataSetError(self._name, f'{moves}: markers cannot be given in it', remedy)
            step = from_quaternion((quaternion / np.linalg.norm(quaternion)).tolist())
            if frame == parent:  # from either end
                step, moved = step.T, -step.T @ moved
            frame = child if frame == parent else parent
            rotation, shift = step @ rotation, step @ shift + moved
        return rotation, shift


def with_markers(recording: Recording, topics: Topics, names: Sequence[str]) -> Recording:
    """
    Return a recording with its markers, in the frame of the base if its transforms lead there.

    Where it has none yet, they came as poses or transforms of their own.

    Parameters
    ----------
    recording : Recording
    topics : Topics
        Its `markers` may name frames instead of topics.
    names : sequence of str
        Of the markers of the description: by default a frame, or a part of a topic, is called so.

    Raises
    ------
    DataSetError
        No topic and no frame has the name of a marker; the message lists the existing ones.

    """
    if recording.tracks:
        return _to_base(recording)
    bag = recording.name
    with opened(bag) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
    stamped = [topic for topic in other_sources(types) if types[topic] == POSE_STAMPED]
    if not topics.markers:
        own = {n: [t for t in stamped if n in t.split('/')] for n in names}
        if all(len(matches) == 1 for matches in own.values()):
            found = {n: matches[0] for n, matches in own.items()}
            return _to_base(read_bag(bag, replace(topics, markers=found)))
    transforms = Transforms(recording)
    chosen = dict(topics.markers) or {name: name for name in names}
    chosen = {name: frame.lstrip('/') for name, frame in chosen.items()}
    frames = sorted({child for _, child in transforms.edges})
    lacking = [frame for frame in chosen.values() if frame not in frames]
    if lacking:
        none = f'no topic or frame of /tf is called {listing(lacking)}'
        problem = f'topic /{topics.shape.lstrip("/")} is not in it, and {none}'
        option, known = f'--marker {next(iter(chosen))}=NAME', listing([*stamped, *frames])
        remedy = f'say which is which marker, {option} for each; there: {known}'
        raise DataSetError(bag, problem, remedy)
    placed = [transforms.track(frame) for frame in chosen.values()]
    poses = {parent: transforms.to_base(parent) for parent, _ in placed}
    if None in poses.values() and len(poses) > 1:
        problem = f'markers are given in the frames {listing(sorted(poses))}, which nothing joins'
        remedy = 'record all of them in one frame, or /tf_static with them'
        raise DataSetError(bag, problem, remedy)
    tracks = tuple(_moved(track, poses[parent]) for parent, track in placed)
    frame = next((parent for parent, pose in poses.items() if pose is None), 'base')
    return replace(recording, tracks=tracks, marker_names=tuple(chosen), frame=frame)


def _to_base(recording: Recording) -> Recording:
    """Transform a recording to the frame of the base if its transforms allow it."""
    if recording.in_base:
        return recording
    pose = Transforms(recording).to_base(recording.frame.lstrip('/'))
    tracks = tuple(_moved(track, pose) for track in recording.tracks)
    return replace(recording, tracks=tracks, frame=recording.frame if pose is None else 'base')


def _moved(track: Track, pose: Pose | None) -> Track:
    """Transform a track; None: as it is."""
    if pose is None:
        return track
    from scipy.spatial.transform import Rotation

    matrix, shift = pose
    quats = track.orientations.copy()
    known = np.linalg.norm(np.nan_to_num(quats), axis=-1) > 0.5
    known &= (quats != NO_ROTATION).any(axis=-1)
    if known.any():
        quats[known] = (Rotation.from_matrix(matrix) * Rotation.from_quat(quats[known])).as_quat()
    return Track(track.times, track.positions @ matrix.T + shift, quats)


# Messages are looked at in groups. In a group of two senders values are of two kinds, apart by
# more than they vary within a kind, and the kinds alternate; values of one sender step once.
GROUP = 12  # [1] messages in a group, because few of noise alone then look so, see CHANCE
# [1] of what a value goes through in the recording, because less is noise and resolution
APART_FRACTION = 0.1
# [1] of the groups of values that are noise alone look so by chance: of values that are drawn
# evenly 0.006, of normal ones 0.0008 (counted in 400,000 groups)
CHANCE = 0.006


def refuse_two_senders(recording: Recording) -> None:
    """
    Refuse a recording in which messages about two different states take turns.

    Raises
    ------
    DataSetError
        Two programs publish one topic, or a clock was set back: what, from when to when.

    """
    states = alternating(recording.state_times, recording.inputs)
    places = [(t.times, t.positions.reshape(len(t.times), -1)) for t in recording.tracks]
    shape = next(filter(None, (alternating(*one) for one in places)), None)
    if (first := states or shape) is None:
        return
    during, apart = f'from {first[0]:.1f} to {first[1]:.1f} s', first[2]
    if states is not None and shape is not None:
        why = 'the clock was set back while it was recorded, or two arms publish'
        problem = f'{during} inputs and markers of two different times take turns: {why}'
        remedy = 'record it again with a clock that runs on, or cut it there'
    elif states is not None:
        names = sorted({state.header.frame_id for state in recording.states} - {''})
        named = len(names) > 1  # programs that write a name of their own there
        who = f' ({listing(names)})' if named else ''
        differ = f'{during} they differ by up to {apart:.3g}'
        problem = f'two programs publish the tendon states{who}: {differ}'
        which = '' if named else ' (ros2 topic info --verbose names them while they run)'
        remedy = f'end one of them{which} and record again'
        remedy += f', or keep one: --sender {names[0]!r}' if named else ''
    else:
        differ = f'{during} places differ by up to {1e3 * apart:.3g} mm'
        problem = f'two programs publish markers on one topic: {differ}'
        remedy = 'end one of them and record again, or give each a topic of its own'
    raise DataSetError(recording.name, problem, remedy)


def alternating(times: Floats, values: Floats) -> tuple[float, float, float] | None:
    """Return begin, end [s] and difference where values (S, n) of two kinds alternate."""
    count = len(times) // GROUP
    values = values[:, np.isfinite(values).any(axis=0)]
    if not values.shape[1]:
        return None
    low, high = np.nanquantile(values, [0.01, 0.99], axis=0)
    spread = high - low
    groups = values[: count * GROUP].reshape(count, GROUP, values.shape[1])
    order = np.sort(groups, axis=1)
    gaps = np.nan_to_num(np.diff(order, axis=1))  # (count, GROUP - 1, n)
    at = gaps.argmax(axis=1)[:, None]
    gap = np.take_along_axis(gaps, at, axis=1)
    above = groups > np.take_along_axis(order, at, axis=1)
    flips = (above[:, 1:] != above[:, :-1]).sum(axis=1)  # (count, n)
    within = np.ptp(np.where(np.isfinite(groups), groups, order[:, :1]), axis=1) - gap[:, 0]
    many = above.sum(axis=1)
    mixed = (flips >= GROUP // 3) & (gap[:, 0] > within)  # a step flips once
    mixed &= gap[:, 0] > APART_FRACTION * spread
    few = GROUP // 4  # one or two are failed readings
    mixed &= (many >= few) & (many <= GROUP - few) & (spread > 0.0)
    chance = CHANCE * count
    never = NormalDist().inv_cdf(1.0 - CHANCE_PROBABILITY)  # [1] standard deviations
    mixed &= mixed.sum(axis=0) >= max(few, chance + never * np.sqrt(chance))
    where = np.flatnonzero(mixed.any(axis=1))
    if not len(where):
        return None
    largest = np.where(mixed, gap[:, 0], 0.0).max(axis=1)
    begin, end = times[where[0] * GROUP], times[min((where[-1] + 1) * GROUP, len(times) - 1)]
    return float(begin), float(end), float(largest.max())
