"""
Drivers that put commands on motors; they know neither the target nor the controller's model.

interface.py      `Driver`, `Reading`, `Fault`; the list of backends
hardware.py       `HardwareDriver`: what all drivers of real motors share
ports.py          serial ports, and how far motors have gone in searches for slack
safety.py         limits, rates, the stop latch, the rules of the supervisor
supervisor.py     what may reach the motors, decided every cycle; no clock, no threads
mock.py           a driver without hardware
ros2_control.py   joints of ros2_control
dynamixel/        Dynamixel servos
serial_board/     own electronics with load cells

A new driver is one file here, one line in interface.py, and its document.
"""

from .interface import Driver, Fault, Reading, make_driver

__all__ = ['Driver', 'Fault', 'Reading', 'make_driver']
