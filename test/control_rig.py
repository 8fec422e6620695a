"""A controller core with a driver that follows at once."""

from functools import cache
from pathlib import Path

import numpy as np

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

ROBOTS = Path(__file__).parents[1] / 'config' / 'robots'
CYCLE = 0.005


@cache
def model(name='kato_10_1'):
    return Model(load_robot(ROBOTS / f'{name}.yaml'))


class Rig:
    """A core with a driver that follows at once."""

    def __init__(self, **settings):
        self.core = ControllerCore(model(), Settings(**settings))
        self.now, self.tensions, self.alive = 0.0, np.full(4, 0.1), True
        self.outputs = []

    def run(self, seconds, before=None):
        for _ in range(round(seconds / CYCLE)):
            self.now += CYCLE
            if before is not None:
                before(self)
            if self.alive:
                self.core.measured(self.now, self.tensions, np.zeros(4))
            output = self.core.step(self.now)
            if output is not None:
                self.tensions = output.tensions if self.alive else self.tensions
                self.outputs.append(output)
        return output

    def code(self):
        return controller_status(self.core, self.now).code


def standing(**settings):
    """Return a rig that has heard its driver."""
    rig = Rig(**settings)
    rig.run(0.1)
    return rig


def aimed(seconds, target=None, **settings):
    """Return a rig that has been on its way to a target for so long [s]."""
    rig = standing(**settings)
    rig.core.aim(target or reachable())
    rig.run(seconds)
    return rig


def reachable(tensions=(0.5, 0.1, 0.1, 0.9)):
    shape = model().shape(np.array(tensions))
    return Target(shape.tip_position, shape.tip_direction)
