"""Own electronics: a microcontroller with load cells; the bytes are in docs/serial_protocol.md."""
