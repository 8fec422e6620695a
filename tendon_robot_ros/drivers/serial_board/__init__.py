"""
Own electronics: a microcontroller with load cells (docs/serial_board.md, docs/serial_protocol.md).

driver.py     the driver, its search for slack; measured values, faults and facts
config.py     the configuration: channels, spools, limits; the calibration of load cells
messages.py   frames and messages of the protocol; the words of a fault bit
link.py       the port, and the requests that the board must answer
"""
