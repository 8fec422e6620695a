"""
Measurements: `DataSet`, and where it comes from.

dataset.py            measured postures as frozen arrays; a missing value is nan (SI units)
arrays.py             markers; the arrays of a tidy table of pandas; impossible units
visits.py             postures in any order, split by the command before
loading.py            the measurements that a folder, a recording, an object or a list mean
folder.py             a data set as a folder: dataset.yaml, `read_folder`, `save_dataset`
measurement_files.py  inputs.csv and shapes.csv: what was commanded, where the markers were
csv_file.py           strict reading of CSV; every refusal names its row
bag_reader.py         what a recording of ROS 2 holds, in which frame; two senders (without ROS)
bag_writer.py         messages to a recording, and a data set to one
still_segments.py     where the arm stands still: the segments that count as measurements
tracker_faults.py     readings that are none, markers that are numbered anew or exchanged
path_files.py         paths to follow, from CSV or a recording, and to CSV
"""

from .arrays import Marker, default_markers, even_markers
from .dataset import DataSet, Part
from .folder import save_dataset
from .loading import DataSetLike, join, load_dataset

__all__ = [
    'DataSet',
    'DataSetLike',
    'Marker',
    'Part',
    'default_markers',
    'even_markers',
    'join',
    'load_dataset',
    'save_dataset',
]
