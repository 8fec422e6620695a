"""Measurements: folders of plain files, and recordings of ROS 2."""

from .dataset import DataSet, Marker, default_markers
from .reading import load_dataset
from .writing import save_dataset

__all__ = ['DataSet', 'Marker', 'default_markers', 'load_dataset', 'save_dataset']
