"""
What the controller does, without ROS: what comes in is checked, targets become tensions.

A stop only drops the target here: the ramp to pretension is drivers/supervisor.py's.

core.py          `ControllerCore`: the state machine of a cycle; no clock, no threads
modes.py         what the arm is asked to do: nothing, a target, a twist, a trajectory
state.py         what the core is told (settings, target), hears, and gives
solver.py        where the model is evaluated: beside the commands
target_search.py  the search for the tensions of a target (made by model/inverse.py), with its time
checks.py        refusals of what comes in, each with a code and a sentence
keeping_out.py   whether the arm would enter a region on its way
trajectory.py    trajectories of tensions or wire pulls; the path of an arm driven by wire lengths
goals.py         targets in turn or a trajectory, with progress, outcome and cancel: for actions
tip_estimator.py  the bias of the model's tip, estimated from the measured one
tip_loop.py      the closed loop: tensions at which the measured tip is at its target
tip_step.py      one step of these tensions
null_space.py    tensions go to preferred ones while the tip stays; how stiff the tip is
remainder.py     what the closed loop leaves between tip and target, and why, in words
friction.py      the tensions that act; approaches on which friction ends where it helps
model_change.py  from one model to another while the arm is controlled
release.py       after a release of the driver nothing moves until it is asked for anew
status.py        how the controller is, as level, code and sentence
loading.py       a model read and compiled in a process of its own, beside the commands
"""

from .checks import Refusal
from .core import ControllerCore
from .modes import Twist
from .state import Output, Settings, Target

__all__ = ['ControllerCore', 'Output', 'Refusal', 'Settings', 'Target', 'Twist']
