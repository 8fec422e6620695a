"""
Emulated motors that speak real bytes over a pseudo-terminal; nothing here needs hardware.

bus.py        servos on an emulated bus, and the words that do something to them
board.py      an emulated board with the real firmware, and its words
motion.py     motor and gear of a servo, with dry friction
servo.py      one servo: control table, answers, protection
protocol.py   bytes of Protocol 2.0, and what servos answer to them
firmware.py   the reference firmware, compiled for this computer
rig.py        what the motors pull on
port.py       a pseudo-terminal that can be unplugged, and faults on it
process.py    the command `emulate` in a process of its own
"""
