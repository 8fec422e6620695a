"""
What the controller does, without ROS: what comes in is checked, targets become tensions.

A stop only drops the target here: the ramp to pretension is drivers/supervisor.py's.

core.py         `ControllerCore`: the cycle; one object, no clock, no threads
state.py        what it is told (settings, target), hears, and gives
solver.py       where the model is evaluated: beside the commands
seeking.py      posts the search for a pose's tensions (made by model/inverse.py), with its time
checks.py       refusals of what comes in, each with a code and a sentence
jog.py          moving the tip with a velocity
keeping_out.py  whether the arm would enter a region on its way
trajectory.py   trajectories of tensions or wire pulls; the way of an arm driven by wire lengths
goals.py        targets in turn or a trajectory, with progress, outcome and cancel: for actions
tip_loop.py     the closed loop: changes of tension by which the measured tip comes nearer to its
                target; when the tracker is not believed
remainder.py    what the closed loop leaves between tip and target, and why, in words
walk.py         tensions change while the tip stays: what the model misses there is learned
mismatch.py      the model's error near the tensions that act, learned from the measured tip
model_change.py  from one model to another while the arm is controlled
friction_state.py  tensions that act; ways on which friction ends where it helps the target
rebalance.py     the freedom of the tensions while the arm stands; how stiff the tip is
release.py      after a release of the driver nothing moves until it is asked for anew
status.py       how the controller is, as level, code and sentence
loading.py      a model read and compiled in a process of its own, beside the commands
"""

from .checks import Refusal
from .core import ControllerCore
from .jog import Twist
from .state import Output, Settings, Target

__all__ = ['ControllerCore', 'Output', 'Refusal', 'Settings', 'Target', 'Twist']
