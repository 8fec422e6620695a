"""A controller whose arm remembers friction, and follows at once."""

from dataclasses import replace
from functools import cache

import numpy as np
from arms import COARSE

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.plant import make_plant

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


def standing(remembers=True, **settings):
    """Return a rig that has heard its driver; `remembers` False: nor does its arm."""
    rig = Rig(models=lambda known=True: model(known and remembers), **settings)
    rig.run(0.05)
    return rig


ARMS = {'planar': (load_robot('kato_10_1'), 0.8), 'spatial': (COARSE, 1.5)}  # tensions to [N]
SPRINGS, STIFF = {'wire_spring': {'compliance': 1e-3}}, {}
BENDS = {'bending_hysteresis': {'lag': 0.03, 'presliding': 2.0}}
MOTORS = {'backlash': {'width': 5e-4}}
EYELETS = {'friction_memory': {'presliding_length': 2e-4}}
# arm, what it remembers, its wires, whether pulls are commanded, whether it is built with scatter
SIDES = (
    ('planar', EYELETS, SPRINGS, False, True),
    ('planar', MOTORS, STIFF, True, False),
    ('planar', BENDS | MOTORS, SPRINGS, True, False),
    ('spatial', BENDS, SPRINGS, False, False),
    ('spatial', EYELETS, SPRINGS, False, True),
    ('spatial', BENDS | MOTORS, SPRINGS, True, False),
)
MORE_SIDES = (  # of the same kinds
    ('planar', BENDS, SPRINGS, False, False),
    ('planar', BENDS, SPRINGS, True, False),
    ('planar', BENDS, SPRINGS, False, True),
    ('planar', BENDS, SPRINGS, True, True),
    ('planar', EYELETS, SPRINGS, True, True),
    ('planar', MOTORS, SPRINGS, True, False),
    ('planar', MOTORS, SPRINGS, True, True),
    ('spatial', BENDS, SPRINGS, True, False),
    ('spatial', BENDS, SPRINGS, True, True),
    ('spatial', MOTORS, SPRINGS, True, False),
    ('spatial', MOTORS, SPRINGS, True, True),
    ('spatial', BENDS | MOTORS, SPRINGS, True, True),
)


class AsBuilt:
    """A plant with the interface of a model; it remembers by itself."""

    def __init__(self, robot, hidden):
        self.plant = make_plant(robot, hidden, refine=1, seed=3, work=Workmanship())
        self.bends_remember = self.transmission_remembers = True  # so that it takes pulls

    def follow(self, last, tensions):
        return self.plant.respond(tensions)

    def follow_pulls(self, last, pulls):
        return self.plant.respond_to_pulls(pulls)


def from_sides(arm, memory, wires, pull, built, seed=2, count=2):
    """
    Send the tip to targets from three sides, by a model with and by one without the memory.

    Returns how far the ends of a target differ and how far they are off, lists [m] by whether the
    model remembers.
    """
    robot, top = ARMS[arm]
    robot = replace(robot, effects=robot.effects | wires)
    random = np.random.default_rng(seed)
    targets, sides = 0.1 + top * random.uniform(0, [[[0.6]], [[1.0]]], (2, 3, len(robot.inputs)))
    spread, off = {True: [], False: []}, {True: [], False: []}

    def models(known=True):
        return Model(replace(robot, effects=robot.effects | (memory if known else {})))

    for known in (True, False):
        rig = Rig(known, pull=pull, models=models)
        rig.arm = AsBuilt(robot, memory) if built else rig.arm
        rig.run(0.1)
        for target in targets[:count]:
            ends = []
            for side in sides:
                rig.go(side)
                off[known].append(rig.go(target))
                ends.append(rig.shape.tip_position)
            away = np.linalg.norm(np.array(ends) - np.mean(ends, axis=0), axis=1).max()
            spread[known].append(float(away))
    return spread, off
