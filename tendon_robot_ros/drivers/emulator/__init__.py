"""Emulated servos that speak real bytes over a pseudo-terminal; nothing here needs hardware."""
