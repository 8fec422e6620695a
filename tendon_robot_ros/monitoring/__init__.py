"""
Watching a robot against its model, without ROS: compare, record what is still, diagnose.

monitor.py       prediction beside measurement, and the postures worth recording
measurement.py   what was measured lately, and when the arm stands still
built_arm.py     one arm as it was built, learned posture by posture
tip_force.py     the force at the tip, and whether something touches elsewhere
drift.py         a sequential test: is the arm still what it was
change.py        what has changed: every change fitted, and the posture that separates them
recursive.py     a recursive estimate whose memory the data choose
adaptation.py    parameters of the added effects follow the arm, within their intervals
watch.py         learns the arm, then watches drift and force
job.py           a diagnosis as a child process, and what came of it
"""

from .measurement import History, StillMeasurement, StillWindow
from .monitor import Monitor, MonitorSettings

__all__ = ['History', 'Monitor', 'MonitorSettings', 'StillMeasurement', 'StillWindow']
