"""Write ROS 2 recordings (mcap or sqlite3) without ROS: message by message, or a data set."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError, MissingExtraError
from ..common.files import new_file, new_folder
from ..common.words import UNITS
from ..robot import dump_robot
from .arrays import NO_ROTATION
from .dataset import DataSet
from .folder import dump_description

STORAGES = ('mcap', 'sqlite3')

# Topics that hold what messages cannot: latched std_msgs/String
DESCRIPTION = '/dataset/description'  # the text of dataset.yaml, its markers written out
ROBOT = '/dataset/robot'  # the text of robot.yaml
# {"posture": ..., "trial": ...} when a measurement begins, '' when it ends
LABEL = '/dataset/label'


def need_rosbags() -> None:
    """
    Check that recordings can be read and written.

    Raises
    ------
    MissingExtraError
        The package rosbags is not installed.

    """
    if find_spec('rosbags') is None:
        raise MissingExtraError('rosbags', 'bags')


class BagWriter(AbstractContextManager['BagWriter']):
    """
    Write messages to a new rosbag2 folder; closing it completes the recording.

    Messages are given as they come from a raw subscription (bytes), or as fields.
    """

    def __init__(self, folder: str | Path, storage: str = 'mcap') -> None:
        """
        Create the folder.

        Parameters
        ----------
        folder : str or Path
            Must not exist.
        storage : str
            One of `STORAGES`.

        Raises
        ------
        DataSetError
            The folder exists or cannot be made.
        MissingExtraError
            The package rosbags is not installed.

        """
        need_rosbags()
        from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
        from rosbags.typesys import Stores, get_typestore

        self.types = get_typestore(Stores.ROS2_JAZZY)
        plugin = StoragePlugin[storage.upper()]
        try:
            self._writer = Writer(Path(folder), version=9, storage_plugin=plugin)
            self._writer.open()
        except WriterError:
            raise DataSetError(str(folder), 'is there already', 'name a new folder') from None
        except OSError as error:
            problem = f'cannot be made ({error.strerror})'
            raise DataSetError(str(folder), problem, 'name another place') from None
        self._connections: dict[str, Any] = {}

    def add_topic(self, topic: str, kind: str, latched: bool = False) -> None:
        """
        Announce a topic before its first message.

        Parameters
        ----------
        topic : str
            Its name, such as '/tendon_states'.
        kind : str
            Its type, such as 'sensor_msgs/msg/JointState'.
        latched : bool
            Whoever subscribes later gets the last message (transient local).

        """
        from rosbags import interfaces as ros

        unlimited = ros.QosTime(2147483647, 4294967295)
        durability = ros.QosDurability.TRANSIENT_LOCAL if latched else ros.QosDurability.VOLATILE
        quality = ros.Qos(
            history=ros.QosHistory.KEEP_LAST,
            depth=1 if latched else 10,
            reliability=ros.QosReliability.RELIABLE,
            durability=durability,
            deadline=unlimited,
            lifespan=unlimited,
            liveliness=ros.QosLiveliness.AUTOMATIC,
            liveliness_lease_duration=unlimited,
            avoid_ros_namespace_conventions=False,
        )
        self._connections[topic] = self._writer.add_connection(
            topic, kind, typestore=self.types, offered_qos_profiles=[quality]
        )

    def write(self, topic: str, time: int, message: object) -> None:
        """Write one message of an announced topic; `time` is in nanoseconds."""
        connection = self._connections[topic]
        if not isinstance(message, bytes):
            message = self.types.serialize_cdr(message, connection.msgtype)
        self._writer.write(connection, time, message)

    def close(self) -> None:
        """Complete the recording."""
        self._writer.close()

    def __exit__(self, *_: object) -> None:
        self.close()


STRING = 'std_msgs/msg/String'
JOINT_STATE = 'sensor_msgs/msg/JointState'
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'


class Builder:
    """Build messages of the types that a `BagWriter` knows."""

    def __init__(self, types: Any, frame: str = 'base') -> None:
        """Take the writer's types and the frame in which shapes are measured."""
        self._types, self._frame = types.types, frame

    def string(self, text: str) -> object:
        """Build a std_msgs/String."""
        return self._types[STRING](data=text)

    def joint_state(
        self, time: int, names: Sequence[str], pull: Floats, tension: Floats
    ) -> object:
        """Build a JointState: wire pulls [m] as positions, tensions [N] as efforts; time [ns]."""
        return self._types[JOINT_STATE](
            header=self._header(time),
            name=list(names),
            position=np.asarray(pull, dtype=float),
            velocity=np.zeros(0),
            effort=np.asarray(tension, dtype=float),
        )

    def pose_array(self, time: int, positions: Floats, quaternions: Floats) -> object:
        """Build a PoseArray from positions (J, 3) [m] and quaternions (J, 4); time [ns]."""
        pose, point = (self._types[f'geometry_msgs/msg/{name}'] for name in ('Pose', 'Point'))
        quaternion = self._types['geometry_msgs/msg/Quaternion']
        poses = [
            pose(position=point(*map(float, place)), orientation=quaternion(*map(float, rotation)))
            for place, rotation in zip(positions, quaternions, strict=True)
        ]
        return self._types[POSE_ARRAY](header=self._header(time), poses=poses)

    def _header(self, time: int) -> object:
        stamp = self._types['builtin_interfaces/msg/Time'](sec=time // 10**9, nanosec=time % 10**9)
        return self._types['std_msgs/msg/Header'](stamp=stamp, frame_id=self._frame)


STATES, SHAPE = '/tendon_states', '/measured_shape'
NANOSECONDS = round(UNITS['time']['s'] / UNITS['time']['ns'])  # of a second
START = NANOSECONDS  # of the first message, because 0 means that there is no time
OTHER_FILES = ('.bag', '.db3')  # endings that no folder may have: readers go by them


@dataclass(frozen=True)
class Timing:
    """Durations of the phases of an exported recording."""

    hold: float = 2.0  # [s] each measurement
    move: float = 1.0  # [s] from one measurement to the next
    rate: float = 20.0  # [1/s] messages


def export_bag(
    dataset: DataSet, path: str | Path, storage: str = 'mcap', timing: Timing = Timing()
) -> Path:
    """
    Write a data set as a recording; `import_bag` gives it back.

    The arm holds still at every measurement and moves in straight lines between them, through
    the straight arm where every trial was loaded `from_straight`.

    Parameters
    ----------
    dataset : DataSet
        What to write.
    path : str or Path
        A new folder, or a new file that ends in .mcap.
    storage : str
        'mcap' or 'sqlite3', for a folder.
    timing : Timing
        Seconds per measurement and move, messages per second.

    Raises
    ------
    DataSetError
        There is something at `path` already, or nothing can be written there.
    MissingExtraError
        The package rosbags is not installed.

    """
    need_rosbags()
    if dataset.visits is not None:
        problem = 'a recording does not hold in which order postures were visited'
        raise DataSetError(dataset.name, problem, 'keep it as a folder')
    path = Path(path)
    if path.suffix in OTHER_FILES:
        problem = f'ends with {path.suffix}, and a folder or an .mcap file is written'
        raise DataSetError(str(path), problem, f'leave out {path.suffix}')
    if path.suffix != '.mcap':
        with new_folder(path) as new:
            new.rmdir()  # the writer makes it
            _write(dataset, BagWriter(new, storage), timing)
        return path
    if path.exists():
        raise DataSetError(str(path), 'is there already', 'name a new file')
    with new_file(path) as draft:
        _write(dataset, BagWriter(draft.parent / 'bag', 'mcap'), timing)
        next((draft.parent / 'bag').glob('*.mcap')).rename(draft)
    return path


def _write(dataset: DataSet, writer: BagWriter, timing: Timing) -> None:
    build = Builder(writer.types)
    with writer:
        for topic in (DESCRIPTION, ROBOT, LABEL):
            writer.add_topic(topic, STRING, latched=True)
        writer.add_topic(STATES, JOINT_STATE)
        writer.add_topic(SHAPE, POSE_ARRAY)
        writer.write(DESCRIPTION, START, build.string(dump_description(dataset)))
        writer.write(ROBOT, START, build.string(dump_robot(dataset.robot)))
        time, step = START, round(NANOSECONDS / timing.rate)
        m, J = len(dataset.input_names), len(dataset.markers)
        unknown = np.full(m, np.nan)
        for label, states in _stages(dataset, timing):
            writer.write(LABEL, time, build.string(label))
            for inputs, places, turned in (np.split(one, [m, m + 3 * J]) for one in states):
                tension = dataset.input == 'tension'
                pull, pulled = (unknown, inputs) if tension else (inputs, unknown)
                joints = build.joint_state(time, dataset.input_names, pull, pulled)
                writer.write(STATES, time, joints)
                shape = build.pose_array(time, places.reshape(J, 3), turned.reshape(J, 4))
                writer.write(SHAPE, time, shape)
                time += step


def _stages(dataset: DataSet, timing: Timing) -> Iterator[tuple[str, Floats]]:
    """
    Yield every hold and every move between two: its label, and its instants.

    An instant is a row of inputs (m,), positions (J, 3) and quaternions (J, 4), one after the
    other.
    """
    hold = max(round(timing.hold * timing.rate), 2)
    move = max(round(timing.move * timing.rate), 2)
    P, Q, J = dataset.positions.shape[:3]
    lying = dataset.offsets + np.outer(dataset.arc_lengths, [0.0, 0.0, 1.0])
    inputs, turned = dataset.inputs_by_trial, np.tile(NO_ROTATION, (J, 1))
    straight = np.concatenate([np.zeros(inputs.shape[2]), lying.ravel(), turned.ravel()])
    order = [(p, q) for p in range(P) for q in range(Q) if dataset.trial_mask[p, q]]
    if dataset.path == 'sequence':
        order = [(p, q) for q in range(Q) for p in range(P)]
    last = straight
    for p, q in order:
        known = dataset.orientations
        turned = np.full((J, 4), np.nan) if known is None else known[p, q]
        state = np.concatenate([inputs[p, q], dataset.positions[p, q].ravel(), turned.ravel()])
        between = [straight] if dataset.path == 'from_straight' else []
        waypoints = np.array([last, *between, state])
        progress = np.linspace(0.0, len(waypoints) - 1, move + 2)[1:-1]
        leg = np.minimum(progress.astype(int), len(waypoints) - 2)
        part = (progress - leg)[:, None]
        yield '', (1.0 - part) * waypoints[leg] + part * waypoints[leg + 1]
        label = {'posture': dataset.postures[p], 'trial': dataset.trial_names[q]}
        yield json.dumps(label, ensure_ascii=False), np.tile(state, (hold, 1))
        last = state
    yield '', last[None]
