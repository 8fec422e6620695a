"""
Drivers that put commands on motors; they know neither the target nor the controller's model.

interface.py      `Driver`, `Reading`, `Fault`; the list of backends
hardware.py       what all drivers of real motors share: limits, configuration, calibration lines
serial_port.py    a port for one process alone, and the driver of motors on it
safety.py         rules, a stop that latches, the supervisor: what may reach the motors
tendon_check.py   which tendon has crept since the last time
mock.py           a driver without hardware
ros2_control.py   joints of ros2_control
dynamixel/        Dynamixel servos
serial_board/     own electronics with load cells

Silence: the driver node's `command_timeout` (ros/driver/node.py), behind it the servos'
`watchdog` (dynamixel/config.py) or the board's `command_timeout` (serial_board/config.py). How
much wire a search for slack may wind: `home_travel` (dynamixel/motions.py,
serial_board/driver.py).

A new driver is one file here, one line in interface.py, an emulator, a contract test and its page:
the five steps of docs/extending.md.
"""

from .interface import Driver, Fault, Reading, make_driver

__all__ = ['Driver', 'Fault', 'Reading', 'make_driver']
