"""Write ROS 2 recordings (mcap or sqlite3) without ROS."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ..exceptions import DataSetError, MissingExtraError

STORAGES = ('mcap', 'sqlite3')

# Topics that hold what messages cannot: latched std_msgs/String
DESCRIPTION = '/dataset/description'  # the text of dataset.yaml, its markers written out
ROBOT = '/dataset/robot'  # the text of robot.yaml
LABEL = (
    '/dataset/label'  # {"posture": ..., "trial": ...} when a measurement begins, '' when it ends
)


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


class BagWriter:
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
            'mcap' or 'sqlite3'.

        Raises
        ------
        DataSetError
            The folder exists or cannot be made, or the storage is unknown.
        MissingExtraError
            The package rosbags is not installed.

        """
        need_rosbags()
        from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
        from rosbags.typesys import Stores, get_typestore

        if storage not in STORAGES:
            raise DataSetError(str(folder), f'no storage {storage!r}', f'use one of {STORAGES}')
        self.types = get_typestore(Stores.ROS2_JAZZY)
        plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
        try:
            self._writer = Writer(Path(folder), version=9, storage_plugin=plugin)
            self._writer.open()
        except WriterError:
            raise DataSetError(str(folder), 'is there already', 'name a new folder') from None
        except OSError as error:
            raise DataSetError(
                str(folder), f'cannot be made ({error.strerror})', 'name another place'
            ) from None
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
        self._connections[topic] = self._writer.add_connection(
            topic, kind, typestore=self.types, offered_qos_profiles=[_quality(latched)]
        )

    def write(self, topic: str, time: int, message: object) -> None:
        """Write one message of an announced topic; `time` is in nanoseconds."""
        connection = self._connections[topic]
        if isinstance(message, bytes):
            self._writer.write(connection, time, message)
            return
        raw = self.types.serialize_cdr(message, connection.msgtype)
        self._writer.write(connection, time, raw)

    def close(self) -> None:
        """Complete the recording."""
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _quality(latched: bool) -> Any:
    """Return the quality of service of a publisher: reliable, and latched or not."""
    from rosbags import interfaces as ros

    unlimited = ros.QosTime(2147483647, 4294967295)
    return ros.Qos(
        history=ros.QosHistory.KEEP_LAST,
        depth=1 if latched else 10,
        reliability=ros.QosReliability.RELIABLE,
        durability=ros.QosDurability.TRANSIENT_LOCAL if latched else ros.QosDurability.VOLATILE,
        deadline=unlimited,
        lifespan=unlimited,
        liveliness=ros.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=unlimited,
        avoid_ros_namespace_conventions=False,
    )
