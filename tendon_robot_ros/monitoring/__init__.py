"""
Watching a robot against its model, without ROS: compare, record what is still, diagnose.

monitor.py       the last readings: whether the arm stands still, and their mean while it does;
                 prediction beside measurement, and the postures worth recording
built_arm.py     one arm as it was built, learned posture by posture
references.py    which reference postures are misread, how alike the others err; what is new
tip_force.py     the force at the tip, and whether something touches elsewhere
change.py        what may happen to an arm; after an alarm each fitted to the postures since,
                 the likeliest, and the posture that separates those that are left
watch.py         learns the arm, then watches drift (a sequential test) and force
adaptation.py    parameters of the added effects follow the arm, within their intervals
job.py           a diagnosis as a child process, and what came of it
"""

from .monitor import History, Monitor, MonitorSettings, StillMeasurement, StillWindow

__all__ = ['History', 'Monitor', 'MonitorSettings', 'StillMeasurement', 'StillWindow']
