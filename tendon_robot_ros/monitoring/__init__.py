"""
Watching a robot against its model, without ROS: compare, record what is still, diagnose.

monitor.py       prediction beside measurement, and the postures worth recording
measurement.py   what was measured lately, and when the arm stands still
job.py           a diagnosis as a child process, and what came of it
"""

from .measurement import History, StillMeasurement, StillWindow
from .monitor import Monitor, MonitorSettings

__all__ = ['History', 'Monitor', 'MonitorSettings', 'StillMeasurement', 'StillWindow']
