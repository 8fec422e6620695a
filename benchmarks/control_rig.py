"""What bench_control drives: a controller, its driver, and an arm that is not its model."""

from dataclasses import replace

import numpy as np

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.diagnosis.add import add_effect
from tendon_robot_ros.effects import Catalogue, load_catalogue
from tendon_robot_ros.model.derivatives import tip_slopes
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant

CYCLE, LAG, MOVE_S = 0.005, 0.02, 1.6  # [s] the last for a target
TENSION_NOISE, TIP_NOISE = 0.005, 2e-4  # [N], [m] 1 sd
TRACK_EVERY, PREDICT_EVERY = 4, 6  # cycles: 50 Hz, 33 Hz
LENGTH = {'friction_memory': {'presliding_length': 2e-4}}  # [m]
STILL_N = 1e-6  # [N] an arm whose tensions change by less stands still
FITTED = {}  # arm -> the description that was calibrated on it
VISITED, VISITS = 10, 6  # commands and trials that tell the law of slip
LAW = ['friction_memory', 'tendon_friction', 'backbone_stiffness']  # effects fitted for that


def elastic_slip(sign, before, change, presliding_length, exponent):
    """
    Direction of friction after a change of travel: a spring up to where it slips (Prandtl 1928).

    Unlike Dahl's law it is straight up to a sharp end; the spring is as long as Dahl's is wide.
    """
    return min(max(before + change / presliding_length, -1.0), 1.0)


def with_elastic_slip(catalogue):
    """Return the catalogue with another law for what friction remembers."""
    memory = replace(catalogue['friction_memory'], law=elastic_slip)
    effects = [memory if e.name == memory.name else e for e in catalogue]
    return Catalogue(effects, catalogue.files, catalogue.is_sized)


def robot_of(name, remembers=True):
    robot = load_robot(name)
    for effect, values in LENGTH.items() if remembers else ():
        robot = robot.with_effect(effect, values)
    return robot


def calibrated(name, plant):
    """Return the description that fits 40 postures of the plant best, of a small grid."""
    robot = robot_of(name)
    low, high = np.array([robot.tension_limits] * len(robot.inputs)).T
    postures = low + np.random.default_rng(11).random((40, len(low))) * 0.2 * (high - low)
    seen = plant.model.sequence(postures).tip_position
    best, least = robot, np.inf
    friction = robot.effects['tendon_friction']['friction_coefficient']
    for share in (0.9, 1.0, 1.1):
        for softer in (-0.03, 0.0, 0.03):
            for length in (0.5e-4, 0.7e-4, 1e-4, 1.4e-4, 2e-4, 2.8e-4):
                made = robot.with_effect('backbone_stiffness', {'relative_change': softer})
                made = made.with_effect(
                    'tendon_friction', {'friction_coefficient': share * friction}
                ).with_effect('friction_memory', {'presliding_length': length})
                try:
                    away = Model(made).sequence(postures).tip_position - seen
                except NoEquilibriumError:  # of a description that is none of this arm
                    continue
                if (off := float((away**2).sum())) < least:
                    best, least = made, off
    return best


def identified(name, plant):
    """Return the description with the law of slip that visits of the plant tell."""
    robot = robot_of(name, False)
    low, high = np.array([robot.tension_limits] * len(robot.inputs)).T
    commands = low + np.random.default_rng(11).random((VISITED, len(low))) * 0.2 * (high - low)
    seen = simulate(plant, commands, trials=VISITS, path='visits', seed=2)
    return add_effect(seen, LAW).robot


def recorded(name, plant):
    """Return the same from as many postures in a row, each seen once, as a recording has them."""
    robot = robot_of(name, False)
    low, high = np.array([robot.tension_limits] * len(robot.inputs)).T
    random = np.random.default_rng(12).random((VISITED * VISITS, len(low)))
    commands = low + random * 0.2 * (high - low)
    seen = simulate(plant, commands, trials=1, path='sequence', seed=2)
    return add_effect(seen, LAW).robot


DESCRIBED = {'memory': calibrated, 'law': identified, 'recorded': recorded}


class Rig:
    """A controller core, a driver with lag and noise, and a plant that is not its model."""

    def __init__(self, name='kato_10_1', knows='memory', seed=1, exact=False, **settings):
        robot = robot_of(name)
        work = Workmanship().times(0.0 if exact else 1.0)
        self.plant = make_plant(
            robot, work=work, seed=seed, catalogue=with_elastic_slip(load_catalogue())
        )
        key = name, seed, exact, knows or 'memory'
        if key not in FITTED:
            FITTED[key] = DESCRIBED[knows or 'memory'](name, self.plant)
        described = FITTED[key] if knows else FITTED[key].without_effect('friction_memory')
        self.core = ControllerCore(Model(described), Settings(drive_lag=LAG, **settings))
        self.random, self.now, self.step = np.random.default_rng(seed), 0.0, 0
        self.actual = self.core.model.limits[:, 0].copy()
        self.respond()
        self.tips, self.skipped = [], 0
        self.run(0.1)

    @property
    def tip(self):
        return self.arm.tip_position

    def run(self, seconds, before=None):
        for _ in range(round(seconds / CYCLE)):
            self.now, self.step = self.now + CYCLE, self.step + 1
            if before:
                before(self)
            noise = TENSION_NOISE * self.random.normal(size=len(self.actual))
            self.core.measured(self.now, np.maximum(self.actual + noise, 0.0), self.arm.pulls)
            output = self.core.step(self.now)
            if output is not None:
                share = 1.0 - np.exp(-CYCLE / LAG)
                self.actual = self.actual + share * (output.tensions - self.actual)
            if before or np.abs(self.actual - self.answered).max() > STILL_N:
                self.respond()
            if self.step % PREDICT_EVERY == 0:
                self.core.predict(self.now, lambda shape: None)
            if self.core.settings.tip_gain > 0.0 and self.step % TRACK_EVERY == 0:
                seen = self.tip + TIP_NOISE * self.random.normal(size=3)
                self.core.tip_measured(self.now, seen)
            self.tips.append(self.tip.copy())

    def respond(self):
        try:
            self.arm, self.answered = self.plant.respond(self.actual), self.actual
        except NoEquilibriumError:  # Prandtl's sharp end: the plant's search goes in circles
            self.skipped += 1

    def stiffness(self):
        """Return that of the arm's tip along x [N/m]."""
        shape = self.plant.model.follow(self.plant._state, self.plant._state.inputs)
        return self.plant.model.tip_stiffness(shape).along([1, 0, 0])

    def hardly_led(self):
        """Return the direction (3,) in which the arm's tendons lead its tip least."""
        model, state = self.plant.model, self.plant._state
        slopes = tip_slopes(model, state, state.memory)[0][:3]
        return np.linalg.svd(slopes * (model.limits[:, 1] - model.limits[:, 0]))[0][:, 2]

    def go(self, position):
        self.core.aim(Target(position))
        begin = len(self.tips)
        self.run(MOVE_S)
        return np.array(self.tips[begin:])


def loaded(rig, force):
    rig.plant.model.arrays.set('tip_load', 'force_x', None, force)
    rig.answered = np.inf


def load_of(rig, distance):
    """Return the force [N] along x that moves the standing tip by a distance [m]."""
    low, high, last = 0.0, 1.0, rig.plant._state
    for _ in range(30):
        middle = 0.5 * (low + high)
        loaded(rig, middle)
        try:
            tip = rig.plant.model.follow(last, last.inputs).tip_position
        except NoEquilibriumError:  # far more than the arm holds
            high = middle
            continue
        low, high = (middle, high) if np.linalg.norm(tip - rig.tip) < distance else (low, middle)
    loaded(rig, 0.0)
    return low
