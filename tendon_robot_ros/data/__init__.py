"""
Measurements: `DataSet`, and where it comes from.

dataset.py    measured postures as frozen arrays; a missing value is nan (SI units)
folder/       a data set as a folder of plain files, read strictly and written whole
recording/    recordings of ROS 2, read and written without ROS
"""

from .dataset import DataSet, Marker, default_markers
from .folder.folder import load_dataset, save_dataset

__all__ = ['DataSet', 'Marker', 'default_markers', 'load_dataset', 'save_dataset']
