"""
Dynamixel servos (X series, Protocol 2.0) through the unmodified dynamixel-sdk (docs/dynamixel.md).

driver.py         the driver: fails safe, comes back from where the arm is; what it reports
config.py         the configuration: motors, wires, spools, limits
control_table.py  control tables as data; the words of an error bit; counts to tension and pull
port.py           the serial port as the SDK wants it, for one process alone
bus.py            every conversation with the servos; who else talks there
motor.py          one servo as the driver knows it
settings.py       every register that steers motion: set or refused, and read back
torque.py         torque on and off, coming back, and what is polled beside the state
handshake.py      who is on the bus, and whether it is what the configuration says
homing.py         where the wires begin to pull
calibration.py    current against tension, from known weights
"""
