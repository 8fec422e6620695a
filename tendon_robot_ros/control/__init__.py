"""
What the controller does, without ROS: what comes in is checked, targets become tensions.

A stop only drops the target here: the ramp to pretension is drivers/safety.py's.

core.py          `ControllerCore`: the state machine of a cycle; no clock, no threads
driver_side.py   the driver: what was sent, what is heard, silence, stops and releases
modes.py         what the arm is asked to do: nothing, a target, a twist, a trajectory
state.py         what the core is told (settings, targets, trajectories), and gives
solver.py        where the model is evaluated: beside the commands
target_search.py  the search for the tensions of a target (made by model/inverse.py), with its time
approach.py      approaches on which friction forgets where it helps, and that end before a region
tip_estimator.py  the bias of the model's tip, estimated from the measured one; steps by it
tip_loop.py      the closed loop: tensions at which the measured tip is at its target
null_space.py    tensions go to preferred ones while the tip stays; how stiff the tip is
checks.py        refusals of what comes in, each with a code and a sentence
status.py        how the controller is, and how far a goal is, as code and sentence: for actions
loading.py       a model read and compiled in a process of its own, beside the commands
"""

from .checks import Refusal
from .core import ControllerCore
from .state import Output, Settings, Target, Twist

__all__ = ['ControllerCore', 'Output', 'Refusal', 'Settings', 'Target', 'Twist']
