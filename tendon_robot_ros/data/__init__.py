"""
Measurements: `DataSet`, and where it comes from.

dataset.py            measured postures as frozen arrays; a missing value is nan (SI units)
arrays.py             markers; the same as a tidy table of pandas, and back; impossible units
visits.py             settled visits in any order: postures that differ by the one before
loading.py            the measurements that a folder, a recording, an object or a list mean
tracker_faults.py     readings that are none, markers that are numbered anew or exchanged
folder.py             a data set as a folder: dataset.yaml, `read_folder`, `save_dataset`
measurement_files.py  inputs.csv and shapes.csv: what was commanded, where the markers were
csv_file.py           strict reading of CSV; every refusal names its row
path_files.py         paths to follow, from CSV or a recording, and to CSV
recording/            recordings of ROS 2, read and written without ROS
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
