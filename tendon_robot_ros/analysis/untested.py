"""Why the postures of a data set say nothing about an effect."""

from __future__ import annotations

import numpy as np

from ..data import DataSet
from ..effects import Catalogue, Effect
from ..robot import Robot


def why_untested(effect: Effect, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> str:
    """Say in a few words why an effect does not show, and so cannot be judged."""
    if effect.acts_on and effect.acts_on not in robot.effects:
        return f'acts on {effect.acts_on}, which the description lacks'
    if effect.stage == 'memory':
        return _memory(dataset)
    if effect.stage == 'stretch' and dataset.input == 'tension':
        return 'wire pulls not commanded'
    if effect.name == 'gravity':
        gravity = dataset.gravity_for(robot)
        if gravity is None:
            return 'direction of gravity unknown'
        if not np.any(gravity):
            return 'set to zero'
    return 'these postures hardly show it'


def _memory(dataset: DataSet) -> str:
    if dataset.path != 'sequence':
        return 'every posture loaded from straight'
    steps = np.diff(np.nan_to_num(dataset.inputs), axis=0)
    return 'these postures hardly show it' if (steps < 0.0).any() else 'no unloading'
