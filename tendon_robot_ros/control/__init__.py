"""
The controller without ROS: incoming messages are checked, targets become tensions.

A stop drops the target; drivers/safety.py ramps the tensions down to pretension.

core.py           `ControllerCore`: the state machine that runs once per cycle, without threads
inputs.py         settings, targets, twists and trajectories; checks and refusals of messages
state.py          state of the controller; of the driver: measurements, lag, silence, stops and
                  releases
modes.py          modes of motion: follow a target or a twist, play a trajectory; motion to
                  preferred tensions at a constant tip
solver.py         evaluates the model in a thread beside the control loop
target_search.py  searches the tensions of a target (model/inverse.py) within a time budget; paths
                  there that erase friction's memory and stop before keep-out regions
tip_estimator.py  estimates the bias of the model's tip from the tracked tip; corrected steps
tip_loop.py       the closed loop: tensions at which the measured tip is at its target
status.py         status of the controller; progress and outcome of motion goals
loading.py        loads a model while another one controls; a child process compiles it
"""

from .core import ControllerCore
from .inputs import Refusal, Settings, Target, Twist

__all__ = ['ControllerCore', 'Refusal', 'Settings', 'Target', 'Twist']
