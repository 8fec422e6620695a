"""
Emulated motors that speak real bytes over a pseudo-terminal; nothing here needs hardware.

bus.py        servos on an emulated bus: bytes of Protocol 2.0, answers, commands
servo.py      one servo: control table, protection, motor and gear with dry friction
board.py      an emulated board with the real firmware, compiled for this computer
rig.py        what the motors pull on
port.py       a pseudo-terminal that can be unplugged, faults on it; `emulate` in its own process
"""
