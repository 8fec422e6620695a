"""
Monitoring of a robot against its model without ROS: compare, record still postures, diagnose.

monitor.py       recent samples, still segments and their means; prediction and measurement of a
                 frame, and the postures of a recording
built_arm.py     Kalman filter of the imperfections of one arm as it was built
references.py    outliers among the reference postures; likelihood of noise sizes; widening
contact.py       what pushes the arm: force and place
change.py        possible changes of an arm, fitted to the postures since an alarm, and the next
                 posture that separates the likely ones
watch.py         learns the arm, then monitors drift (a sequential test) and contact
adaptation.py    recursive estimate of the parameters of added effects, within their intervals
job.py           a diagnosis as a child process, and the addition that it offers
"""

from .monitor import History, Monitor, MonitorSettings, StillMeasurement, StillWindow

__all__ = ['History', 'Monitor', 'MonitorSettings', 'StillMeasurement', 'StillWindow']
