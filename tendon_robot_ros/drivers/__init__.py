"""
Drivers that put commands on motors; they know neither the target nor the controller's model.

interface.py      `Driver`, `Reading`, `Fault`; the list of backends
hardware.py       `HardwareDriver`: what all drivers of real motors share
ports.py          serial ports, and an odometer: how far motors have gone in searches for slack
safety.py         the rules: limits, rates, the stop latch
supervisor.py     keeps them, every cycle: what may reach the motors, the ramp to pretension
tendon_check.py   which tendon has crept since the last time
mock.py           a driver without hardware
ros2_control.py   joints of ros2_control
dynamixel/        Dynamixel servos
serial_board/     own electronics with load cells

Silence: the driver node's `command_timeout` (ros/driver/parameters.py), behind it the servos'
`watchdog` (dynamixel/config.py) or the board's `command_timeout` (serial_board/config.py). How
much wire a search for slack may wind: `home_travel` (dynamixel/homing.py, serial_board/driver.py).

A new driver is one file here, one line in interface.py, an emulator, a contract test and its page:
the five steps of docs/extending.md.
"""

from .interface import Driver, Fault, Reading, make_driver

__all__ = ['Driver', 'Fault', 'Reading', 'make_driver']
