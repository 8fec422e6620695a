"""Drivers that put commands on motors; they know neither the target nor the controller's model."""

from .interface import Driver, Fault, Reading, make_driver

__all__ = ['Driver', 'Fault', 'Reading', 'make_driver']
