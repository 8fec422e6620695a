"""What the controller does, without ROS: checks of what comes in, and targets to tensions."""

from .checks import Refusal
from .core import ControllerCore
from .jog import Twist
from .settings import Output, Settings, Target

__all__ = ['ControllerCore', 'Output', 'Refusal', 'Settings', 'Target', 'Twist']
