"""What a drift alarm knows, as text: the arm as it was before, and the postures since."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ..common.errors import InputError
from ..data import Marker
from ..effects import Catalogue
from ..robot import dump_robot, parse_robot
from .built_arm import BuiltArm
from .change import ChangeFinder
from .possible_changes import changes_of

FORMAT = 'tendon_robot_ros/change@1'
SIZES = 'remainder', 'setting', 'widening'  # of an arm as it was learned


def dump_change(finder: ChangeFinder) -> str:
    """Return what is known of a change as JSON."""
    arm = finder.arm
    content: dict[str, Any] = {
        'format': FORMAT,
        'robot': dump_robot(arm.robot),
        'markers': [
            [m.name, m.arc_length, np.asarray(m.offset).tolist()]
            for m in arm.split.dataset.markers
        ],
        'noise': arm.noise,
        'level': arm.level,
        **{name: float(getattr(arm, name)) for name in SIZES},
        'mean': arm.mean.tolist(),
        'covariance': arm.covariance.tolist(),
        'postures': [[t.tolist(), y.tolist(), frames] for t, y, frames in finder.taken],
    }
    return json.dumps(content)


def load_change(text: str, catalogue: Catalogue) -> ChangeFinder:
    """
    Return a finder that knows as much.

    Parameters
    ----------
    text : str
        As of `dump_change`.
    catalogue : Catalogue
        Of the effects that may have appeared.

    Raises
    ------
    InputError
        It is none, or of another version.

    """
    try:
        content = json.loads(text)
        known = content['format']
    except (ValueError, KeyError, TypeError):
        known = 'no JSON of a change'
    if known != FORMAT:
        raise InputError(f'change: expected {FORMAT}, got {known}: restart the monitor')
    markers = [Marker(name, arc, tuple(offset)) for name, arc, offset in content['markers']]
    robot = parse_robot(content['robot'], 'robot of the monitor')
    arm = BuiltArm(robot, catalogue, markers, content['noise'], content['level'])
    for name in SIZES:
        setattr(arm, name, content[name])
    finder = ChangeFinder(
        arm.as_known(np.array(content['mean']), np.array(content['covariance'])), changes_of(arm)
    )
    for tensions, positions, frames in content['postures']:
        finder.take(np.array(tensions), np.array(positions), frames)
    return finder
