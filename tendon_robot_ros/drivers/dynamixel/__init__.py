"""
Dynamixel servos (X series, Protocol 2.0) through the unmodified dynamixel-sdk (docs/dynamixel.md).

driver.py         the driver: fails safe, comes back from where the arm is; what it reports
config.py         the configuration: motors, wires, spools, limits
control_table.py  control tables as data; the words of an error bit
calibration.py    counts to tension and pull; the lines of current against tension
bus.py            every conversation with the servos; the port, for one process alone
motor.py          one servo as the driver knows it
settings.py       who is on the bus; every register that steers motion: set or refused, read back
torque.py         torque on and off, coming back, and what is polled beside the state
motions.py        the search for slack, and a weight wound up for a calibration
"""
