"""
What control that knows friction gains: spread by the way, loads, paths, stiffness, and its ticks.

The arms are plants as they are built (scatter, kinks, gains, holes), with friction that remembers
by another slip law than the model's, behind a driver with lag and noisy load cells; the tip is
seen at 50 Hz with noise. The controller runs with its solver in place, in simulated time; ticks
are measured in process time. Prints JSON; `--only orders` (or another part) for one.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control import ControllerCore, Settings, Target, mismatch
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.redundancy import Balance, Preferences
from tendon_robot_ros.model.tip_task import TipTask, tip_target
from tendon_robot_ros.ros.shared.files import read_robot
from tendon_robot_ros.simulation.hidden import with_elastic_slip
from tendon_robot_ros.simulation.imperfect import Workmanship
from tendon_robot_ros.simulation.plant import make_plant

CYCLE, LAG = 0.005, 0.02  # [s]
TENSION_NOISE, TIP_NOISE = 0.005, 2e-4  # [N], [m] 1 sd
TRACK_EVERY, PREDICT_EVERY = 4, 6  # cycles: 50 Hz, 33 Hz
LENGTH = {'friction_memory': {'presliding_length': 2e-4}}  # [m]
STILL_N = 1e-6  # [N] an arm whose tensions change by less stands still
MOVE_S = 1.6  # [s] for a target
FITTED = {}  # arm -> the description that was calibrated on it
LIMITS = {  # what issue 20 asks for
    'open_loop_spread_share': 0.15,
    'closed_loop_spread_noises': 1.5,
    'overshoot_share': 0.10,
    'load_error_mm': 1.2,
    'share_of_fixed': 0.5,
    'stiffness_factor': 2.0,
    'stiffness_tip_mm': 0.2,
    'tick_ms': {'kato_10_1': 0.3, 'spatial_6': 1.5},
}


def robot_of(name, remembers=True):
    robot = read_robot(name)
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


def stands(rig):
    """Nothing happens beside the controller."""


class Rig:
    """A controller core, a driver with lag and noise, and a plant that is not its model."""

    def __init__(self, name='kato_10_1', knows=True, seed=1, exact=False, **settings):
        robot = robot_of(name)
        work = Workmanship().times(0.0 if exact else 1.0)
        self.plant = make_plant(
            robot, work=work, seed=seed, catalogue=with_elastic_slip(load_catalogue())
        )
        key = (name, seed, exact) if exact else (name, seed)
        if key not in FITTED:
            FITTED[key] = calibrated(name, self.plant)
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

    def run(self, seconds, before=stands):
        for _ in range(round(seconds / CYCLE)):
            self.now, self.step = self.now + CYCLE, self.step + 1
            before(self)
            noise = TENSION_NOISE * self.random.normal(size=len(self.actual))
            self.core.measured(self.now, np.maximum(self.actual + noise, 0.0), self.arm.pulls)
            output = self.core.step(self.now)
            if output is not None:
                share = 1.0 - np.exp(-CYCLE / LAG)
                self.actual = self.actual + share * (output.tensions - self.actual)
            if before is not stands or np.abs(self.actual - self.answered).max() > STILL_N:
                self.respond()
            if self.step % PREDICT_EVERY == 0:
                self.core.predict(self.now, lambda shape: None)
            if self.core.settings.tip_gain > 0.0 and self.step % TRACK_EVERY == 0:
                seen = self.tip + TIP_NOISE * self.random.normal(size=3)
                self.core.loop.take(self.now, self.core, seen)
            self.tips.append(self.tip.copy())

    def respond(self):
        try:
            self.arm, self.answered = self.plant.respond(self.actual), self.actual
        except NoEquilibriumError:  # Prandtl's sharp end: the plant's search goes in circles
            self.skipped += 1

    def go(self, position):
        self.core.aim(Target(position))
        begin = len(self.tips)
        self.run(MOVE_S)
        return np.array(self.tips[begin:])


def targets(name, count=12):
    """Return tips (count, 3) [m] in the middle of the workspace."""
    model, random = Model(robot_of(name, False)), np.random.default_rng(7)
    low, high = model.limits.T
    found = []
    while len(found) < count:
        tensions = low + random.random(len(low)) * 0.2 * (high - low)
        tip = model.shape(tensions).tip_position
        if tip[2] > 0.6 * model.robot.length and np.hypot(*tip[:2]) > 0.1 * model.robot.length:
            found.append(tip)
    return np.array(found)


def orders(name, count, **settings):
    """Visit the targets in random orders: spread by the way, error, overshoot."""
    places, skipped = targets(name), 0
    ends = np.empty((count, len(places), 3))
    overshoots = []
    for number in range(count):
        rig = Rig(name, **settings)
        for place in np.random.default_rng(number).permutation(len(places)):
            here, tips = rig.tip.copy(), rig.go(places[place])
            ends[number, place] = tips[-20:].mean(axis=0)
            step = ends[number, place] - here
            if np.linalg.norm(step) > 0.02:
                beyond = ((tips - here) @ step).max() / (step @ step) - 1.0
                overshoots.append(beyond)
        skipped += rig.skipped
    away = np.linalg.norm(ends - ends.mean(axis=0), axis=2)
    return {
        'spread_mm': round(1e3 * float(np.sqrt((away**2).mean())), 3),
        'spread_max_mm': round(1e3 * float(away.max()), 3),
        'error_mm': round(1e3 * float(np.linalg.norm(ends - places, axis=2).mean()), 3),
        'overshoot_p95': round(float(np.quantile(overshoots, 0.95)), 3),
        'overshoot_max': round(float(np.max(overshoots)), 3),
        'cycles_without_plant': skipped,
    }


def bench_orders(count, name, exact):
    kinds = {
        'today': {'knows': False},
        'from_below': {'knows': False, 'approach': 'from_below'},
        'memory': {},
        'memory_from_below': {'approach': 'from_below'},
        'memory_model': {'approach': 'model'},
        'closed': {'tip_gain': 5.0},
    }
    made = {kind: orders(name, count, exact=exact, **made) for kind, made in kinds.items()}
    today = made['today']['spread_mm']
    for kind in ('from_below', 'memory', 'memory_from_below', 'memory_model'):
        made[f'{kind}_spread_share'] = round(made[kind]['spread_mm'] / today, 3)
    axes = 2.0 if name.startswith('kato') else 3.0  # that the arm moves in
    noise = 1e3 * TIP_NOISE * np.sqrt(axes)  # [mm]
    made['closed_loop_spread_noises'] = round(made['closed']['spread_mm'] / noise, 2)
    return made


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


def bench_load(count, gain, name, exact):
    """Load the tip within 0.1 s: how far it is off, and for how long."""
    errors, settled, moved = [], [], []
    for number, place in enumerate(targets(name)[:count]):
        rig = Rig(name, tip_gain=gain, seed=number, exact=exact, rate_limit=20.0)
        rig.go(place)
        force, began = load_of(rig, 0.02), rig.now

        def load(rig, force=force, began=began):
            loaded(rig, force * min((rig.now - began) / 0.1, 1.0))

        rig.run(1.3, load)
        away = np.linalg.norm(np.array(rig.tips[-260:]) - place, axis=1)
        moved.append(1e3 * away[:40].max())
        errors.append(1e3 * np.sqrt((away[190:210] ** 2).mean()))
        late = np.flatnonzero(away > 1.2e-3)
        settled.append(CYCLE * (late[-1] + 1) if len(late) else 0.0)
    return {
        'gain_per_s': gain,
        'largest_mm': np.round(moved, 1).tolist(),
        'error_after_1s_mm': np.round(errors, 2).tolist(),
        'within_1.2mm_after_s': np.round(settled, 2).tolist(),
    }


def circle(name):
    """Return a circle (k, 3) [m] within reach: in the plane of the arm, or about its axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    turn = np.array([np.cos(angles), np.sin(angles)]).T
    if name.startswith('kato'):
        return np.array([0.05, 0.0, 0.17]) + 0.02 * turn @ [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    model = Model(robot_of(name, False))
    height = model.reach([0.03, 0.0, 0.11]).shape.tip_position
    return np.column_stack([np.hypot(*height[:2]) * turn, np.full(len(turn), height[2])])


def bench_path(gain, lead, name, exact):
    """Follow circles at 100 mm/s under an unknown load."""
    way, speed = circle(name), 0.1
    round_s = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / speed
    made = {}
    doubts = mismatch.SLOPE_DOUBT, mismatch.SLOPE_DOUBT_LEAST
    for kind in ('open', 'fixed', 'fixed_ahead', 'learned', 'learned_ahead'):
        none = (1e-9, 1e-6) if kind.startswith('fixed') else doubts
        mismatch.SLOPE_DOUBT, mismatch.SLOPE_DOUBT_LEAST = none
        closed = 0.0 if kind == 'open' else gain
        ahead = lead if kind.endswith('ahead') else 0.0
        rig = Rig(name, tip_gain=closed, exact=exact, look_ahead=ahead)
        rig.go(way[0])
        loaded(rig, 0.5 * load_of(rig, 0.02))
        rig.run(1.0)
        began, wanted = rig.now, []

        def send(rig, began=began, wanted=wanted):
            share = (rig.now - began) / round_s % 1.0 * (len(way) - 1)
            place = way[round(share)]
            wanted.append(place)
            if rig.step % TRACK_EVERY == 0:
                rig.core.aim(Target(place))

        first = len(rig.tips)
        rig.run(3.0, send)
        away = np.linalg.norm(np.array(rig.tips[first:]) - np.array(wanted), axis=1)[200:]
        made[f'{kind}_rms_mm'] = round(1e3 * float(np.sqrt((away**2).mean())), 3)
    mismatch.SLOPE_DOUBT, mismatch.SLOPE_DOUBT_LEAST = doubts
    for fixed in ('fixed', 'fixed_ahead'):
        share = made['learned_ahead_rms_mm'] / made[f'{fixed}_rms_mm']
        made[f'share_of_{fixed}'] = round(share, 3)
    return made


def bench_stiffness(count, gain, name, exact):
    """Co-contraction while the tip is held: how much stiffer, how far the tip moves meanwhile."""
    factors, moved = [], []
    for number, place in enumerate(targets(name)[:count]):
        rig = Rig(name, seed=number, exact=exact, tip_gain=gain)
        rig.go(place)
        rig.run(2.0)
        model, last = rig.core.model, rig.core.track.last
        before, tip = model.tip_stiffness(last).along([1, 0, 0]), rig.tip.copy()
        wants = Preferences(low_tension=0.5, stiffness=0.1, stiffness_direction=(1, 0, 0))
        rig.core.settings = Settings(preferences=wants, tip_gain=gain, drive_lag=LAG)
        begin = len(rig.tips)
        rig.run(12.0)
        after = model.tip_stiffness(rig.core.track.last).along([1, 0, 0])
        factors.append(after / before)
        moved.append(1e3 * np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1).max())
    return {
        'factor': np.round(factors, 2).tolist(),
        'tip_moved_mm': np.round(moved, 3).tolist(),
    }


def bench_ticks():
    """One program with its Jacobian and the equilibrium it leads to, in process time."""
    made = {}
    for name in ('kato_10_1', 'spatial_6'):
        for remembers in (False, True):
            model = Model(robot_of(name, remembers))
            low, high = model.limits.T
            shape = model.shape(low + 0.12 * (high - low) * np.linspace(0.5, 1.5, len(low)))
            past = shape.memory if remembers else model.arrays.fresh_memory()
            wants, took = Preferences(slack=0.1), []
            for number in range(300):
                angle = 0.1 * number
                place = shape.tip_position + 5e-4 * np.array([np.cos(angle), 0.0, np.sin(angle)])
                began = time.process_time()
                task = TipTask(model, tip_target(model, place, None, 1.0, None), past)
                balance = Balance(task, wants)
                at = balance.begin(shape)
                balance.look(at, balance.step(at, 0.02))
                took.append(1e3 * (time.process_time() - began))
            made[f'{name}{"_remembers" if remembers else ""}_ms'] = round(
                float(np.median(took[50:])), 3
            )
    return made


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--orders', type=int, default=20)
    parser.add_argument('--places', type=int, default=8)
    parser.add_argument('--gain', type=float, default=6.0)
    parser.add_argument('--lead', type=float, default=0.03)
    parser.add_argument('--robot', default='kato_10_1')
    parser.add_argument('--exact', action='store_true', help='an arm that is what is written')
    parser.add_argument('--only', choices=('orders', 'load', 'path', 'stiffness', 'ticks'))
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    arm = options.robot, options.exact
    parts = {
        'ticks': bench_ticks,
        'orders': lambda: bench_orders(options.orders, *arm),
        'load': lambda: bench_load(options.places, options.gain, *arm),
        'path': lambda: bench_path(options.gain, options.lead, *arm),
        'stiffness': lambda: bench_stiffness(options.places, options.gain, *arm),
    }
    figures = {**machine(), 'asked': LIMITS}
    for name, part in parts.items():
        if options.only in (None, name):
            figures[name] = part()
    tell(figures, options.json)
    return figures


if __name__ == '__main__':
    main()
