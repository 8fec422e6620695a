"""What cannot be metres and newtons, or not in the base frame."""

from __future__ import annotations

import numpy as np

from ..common.errors import DataSetError
from ..robot import Robot
from .dataframes import Floats, FrameArrays

TENSION_MAX_LIMITS = 3.0  # tension limits; a larger tension is in another unit
DISTANCE_MAX_LENGTHS = 3.0  # robot lengths; a marker farther off is in another unit or frame


def check_units(
    name: str, robot: Robot, arc_lengths: Floats, command: str, arrays: FrameArrays
) -> None:
    """
    Refuse measurements in other units.

    Parameters
    ----------
    name : str
        Of the data set, for the message.
    robot : Robot
        Says how long the arm is, and which tensions it has.
    arc_lengths : (J,) [m]
        Of the markers.
    command : str
        'tension' or 'displacement'.
    arrays : FrameArrays
        Inputs and positions.

    Raises
    ------
    DataSetError
        A value is too large, or a tension pushes.

    """
    length, limit = robot.length, robot.tension_limits[1]
    far = float(np.nan_to_num(np.abs(arrays.positions)).max(initial=0.0))
    inputs = np.nan_to_num(arrays.inputs)
    if not (arc_lengths >= 0.0).all() or not (arc_lengths <= length + 1e-9).all():
        problem = f'a marker is at {np.nanmax(arc_lengths):g} m of an arm of {length:g} m'
    elif far > DISTANCE_MAX_LENGTHS * length:
        problem = f'a marker is {far:g} m away, but the robot is only {length:g} m long'
    elif command == 'displacement' and np.abs(inputs).max(initial=0.0) > length:
        problem = f'a wire is pulled by {np.abs(inputs).max():g} m on an arm of {length:g} m'
    elif command == 'tension' and inputs.max(initial=0.0) > TENSION_MAX_LIMITS * limit:
        problem = f'a tension is {inputs.max():g} N, but tension_limits end at {limit:g} N'
    elif command == 'tension' and inputs.min(initial=0.0) < 0.0:
        problem = f'a tension is {inputs.min():g} N, but a tendon cannot push'
    else:
        return
    raise DataSetError(name, problem, 'give metres and newtons, in the base frame')
