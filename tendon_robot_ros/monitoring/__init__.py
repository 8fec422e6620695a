"""
Watching a robot against its model, without ROS: compare, record what is still, diagnose.

monitor.py       prediction beside measurement, and the postures worth recording
measurement.py   the last readings: whether the arm stands still, and their mean while it does
built_arm.py     one arm as it was built, learned posture by posture
noise_sizes.py   how likely postures are under sizes of what is new in each of them
references.py    which reference postures are misread, and how alike the others err
tip_force.py     the force at the tip, and whether something touches elsewhere
drift.py         the drift alarm, a sequential test: is the arm still what it was; its threshold
possible_changes.py  what may happen to an arm, and how it is said
change.py        after an alarm: each possible change fitted to the postures since; the likeliest,
                 and the posture that separates those that are left
recursive.py     a recursive estimate whose memory the data choose
adaptation.py    parameters of the added effects follow the arm, within their intervals
watch.py         learns the arm, then watches drift and force; hands an alarm over as text
job.py           a diagnosis as a child process, and what came of it
"""

from .measurement import History, StillMeasurement, StillWindow
from .monitor import Monitor, MonitorSettings

__all__ = ['History', 'Monitor', 'MonitorSettings', 'StillMeasurement', 'StillWindow']
