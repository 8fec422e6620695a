"""
Own electronics: a microcontroller with load cells (docs/serial_board.md, docs/serial_protocol.md).

driver.py        the driver, and its search for slack
readings.py      measured values, faults and facts from the telemetry
config.py        the configuration: channels, spools, limits, load cells
messages.py      frames and messages of the protocol; the words of a fault bit
link.py          the port, and the questions that the board must answer
calibration.py   counts against tension, from known weights
"""
