"""
Measurements: `DataSet`, and where it comes from.

dataset.py      measured postures as frozen arrays; a missing value is nan (SI units)
joining.py      several data sets of one robot as one; one, apart by where the arm came from
loading.py      the measurements that a folder, a recording, an object or a list mean
markers.py      tracked points of the arm
seen.py         what trackers write for a marker that was not seen, and one that is numbered anew
visits.py       settled visits in any order: what differs by where the arm came from
dataframes.py   the same as a tidy table of pandas, and back; what cannot be metres and newtons
folder/         a data set as a folder of plain files, read strictly and written whole
recording/      recordings of ROS 2, read and written without ROS
"""

from .dataset import DataSet, Part
from .folder.folder import save_dataset
from .loading import DataSetLike, join, load_dataset
from .markers import Marker, default_markers, even_markers

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
