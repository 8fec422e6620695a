"""A controller whose arm remembers friction, and follows at once."""

from functools import cache

import numpy as np

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

CYCLE = 0.005  # [s]
TARGETS = ((0.9, 0.1, 0.1, 0.5), (0.1, 0.7, 0.4, 0.1), (0.3, 0.1, 0.1, 0.9), (0.1, 0.2, 0.8, 0.1))


@cache
def model(remembers=True):
    robot = load_robot('kato_10_1')
    if remembers:
        robot = robot.with_effect('friction_memory', {'presliding_length': 2e-4})
    return Model(robot)


class Rig:
    """
    A controller whose arm follows at once and remembers, with load cells that are noisy.

    `models` returns the model of the arm, or the one that remembers nothing.
    """

    def __init__(self, known=True, noise=0.0, pull=False, models=model, **settings):
        self.core = ControllerCore(models(known), Settings(pull_mode=pull, **settings))
        self.models, self.arm, self.pull = models, models(), pull
        self.noise, self.random = noise, np.random.default_rng(1)
        self.now, self.worst = 0.0, np.inf
        self.shape = self.arm.shape(np.full(len(self.arm.inputs), 0.1))

    def run(self, seconds):
        for step in range(round(seconds / CYCLE)):
            self.now += CYCLE
            nothing = np.full_like(self.shape.inputs, np.nan)
            seen = self.shape.inputs + self.noise * self.random.normal(size=len(nothing))
            self.core.measured(self.now, nothing if self.pull else seen, self.shape.pulls)
            output = self.core.step(self.now)
            if output is not None:
                self.shape = self.moved(output)
            if step % 6 == 0:
                self.core.predict(self.now, lambda shape: None)

    def moved(self, output):
        arm = self.arm
        if not (self.pull and (arm.bends_remember or arm.transmission_remembers)):
            return arm.follow(self.shape, output.tensions)
        if np.allclose(output.pulls, self.shape.pulls, rtol=0.0, atol=1e-9):
            return self.shape
        return arm.follow_pulls(self.shape, output.pulls)

    def go(self, tensions):
        target = Target(self.models(False).shape(np.array(tensions)).tip_position)
        self.core.aim(target)
        self.run(1.2)
        return float(np.linalg.norm(self.shape.tip_position - target.position))

    def code(self):
        return controller_status(self.core, self.now).code
