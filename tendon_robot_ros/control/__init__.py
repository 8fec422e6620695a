"""
The controller without ROS: incoming messages are checked, targets become tensions.

A stop drops the target; drivers/safety.py ramps the tensions down to pretension.

core.py          `ControllerCore`: the state machine that runs once per cycle; no clock, no threads
driver_side.py   state of the driver: measurements, lag, silence, stops and releases
modes.py         modes of motion: idle, follow a target or a twist, play a trajectory
state.py         settings, targets, twists and trajectories; the command
solver.py        evaluates the model in a thread beside the control loop
target_search.py  searches the tensions of a target (model/inverse.py) within a time budget
approach.py      paths to a target that erase friction's memory and stop before keep-out regions
tip_estimator.py  estimates the bias of the model's tip from the tracked tip; corrected steps
tip_loop.py      the closed loop: tensions at which the measured tip is at its target
null_space.py    motion to preferred tensions at a constant tip; stiffness of the tip
checks.py        checks of incoming messages; a refusal has a code and a sentence
status.py        status of the controller; progress and outcome of motion goals
loading.py       loads a model while another one controls; a child process compiles it
"""

from .checks import Refusal
from .core import ControllerCore
from .state import Output, Settings, Target, Twist

__all__ = ['ControllerCore', 'Output', 'Refusal', 'Settings', 'Target', 'Twist']
