"""
The description of a robot: sections, tendons, limits, and the effects of its model.

description.py   YAML to frozen, validated dataclasses (docs/robot_file.md); the offsets of the
                 tendons in every cell
loading.py       the robot that a name, a path, text, keys or an object mean, and back to YAML
inputs.py        what a caller commands, by name or in order, checked; noise of inputs
estimates.py     what it means in the hand: bend per newton, sag, stiffness from a rod or a sag;
                 what is large and what is small for a robot
keep_out.py      regions that no part of the arm may enter: planes, spheres, boxes
urdf.py          the same robot as a URDF with its joints, for RViz and TF

A new key of the description is read in description.py and written in loading.py.
"""

from .description import Robot, Section, Tendon, parse_robot
from .loading import RobotLike, dump_robot, load_robot

__all__ = ['Robot', 'RobotLike', 'Section', 'Tendon', 'dump_robot', 'load_robot', 'parse_robot']
