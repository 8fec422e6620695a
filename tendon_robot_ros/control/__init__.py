"""
What the controller does, without ROS: what comes in is checked, targets become tensions.

core.py         `ControllerCore`: the cycle; one object, no clock, no threads
state.py        what it is told (settings, target), hears, and gives
solver.py       where the model is evaluated: beside the commands
seeking.py      posts the search for a pose's tensions (made by model/inverse.py), with its time
pull_path.py    the way of an arm that is driven by wire lengths
checks.py       refusals of what comes in, each with a code and a sentence
jog.py          moving the tip with a velocity
keeping_out.py  whether the arm would enter a region on its way
trajectory.py   trajectories of tensions or wire pulls
tip_loop.py     tensions that take off what the measured tip is away from its target; when the
                tracker is not believed
mismatch.py      the model's error near the tensions that act, learned from the measured tip
model_change.py  another model while the arm is controlled
friction_state.py  tensions that act, and ways on which friction ends where it helps
rebalance.py     the freedom of the tensions while the arm stands; how stiff the tip is
status.py       how the controller is, as level, code and sentence
loading.py      loading a model while controlling
"""

from .checks import Refusal
from .core import ControllerCore
from .jog import Twist
from .state import Output, Settings, Target

__all__ = ['ControllerCore', 'Output', 'Refusal', 'Settings', 'Target', 'Twist']
