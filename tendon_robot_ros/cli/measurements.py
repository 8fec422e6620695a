"""Measurements that a command is given: a data set, or a recording as it is."""

from __future__ import annotations

import sys

from ..data import DataSet, load_dataset
from ..data.bag_import import import_bag
from ..data.bag_picture import summary
from ..data.bag_reader import is_bag
from ..robot import Robot

DATA_HELP = 'data set (folder), or a recording (rosbag2 folder, .mcap or .db3 file)'


def load_measurements(path: str, robot: Robot | str | None) -> DataSet:
    """
    Read a data set; of a recording, every segment in which the arm stood still.

    Raises
    ------
    DataSetError, RobotDescriptionError
        As `load_dataset` and `import_bag`.

    """
    if not is_bag(path):
        return load_dataset(path, robot)
    imported = import_bag(path, robot)
    for line in imported.left_out:
        print('left out:', line, file=sys.stderr)
    print(f'{path}: {summary(imported)}', file=sys.stderr)
    return imported.dataset
