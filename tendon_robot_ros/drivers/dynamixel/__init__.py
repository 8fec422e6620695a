"""Dynamixel servos (X series, Protocol 2.0) through the unmodified dynamixel-sdk."""
