"""
Dynamixel servos (X series, Protocol 2.0) through the unmodified dynamixel-sdk (docs/dynamixel.md).

driver.py         the driver: fails safe, comes back from where the arm is; what it reports
config.py         the configuration: motors, spools, limits; lines of current against tension
control_table.py  control tables as data; the words of an error bit
bus.py            every conversation with the servos
motor.py          one servo as the driver knows it
servos.py         who is on the bus; every register that affects motion: set or refused, read back;
                  torque on and off, coming back, and what is polled beside the state
motions.py        the search for slack, and a weight wound up for a calibration
"""
