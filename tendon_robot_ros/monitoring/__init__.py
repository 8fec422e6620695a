"""Watching a robot against its model, without ROS: compare, record what is still, diagnose."""

from .core import Monitor, MonitorSettings
from .history import History
from .stillness import Settled, StillWindow

__all__ = ['History', 'Monitor', 'MonitorSettings', 'Settled', 'StillWindow']
