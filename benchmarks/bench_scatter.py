"""
How often the interval of a printed scatter holds: the estimator alone, on columns of a real arm.

Imperfections are taken once from a simulated arm; then many arms are drawn with the same columns
and other members, a third, once and twice as badly built as usual. A minute of one core.

example: python benchmarks/bench_scatter.py --arms 60
"""

import argparse
from pathlib import Path

import numpy as np

from tendon_robot_ros.diagnosis.marginal import RandomEffects
from tendon_robot_ros.diagnosis.session import Session
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.imperfect import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = Path(__file__).parents[1] / 'config' / 'robots'
USUAL = Workmanship()
TRUE = {
    'cell_stiffness': USUAL.stiffness,
    'cell_kink': USUAL.kink,
    'cell_kink_across': USUAL.kink,
    'channel_gain': float(np.hypot(USUAL.gain, USUAL.hole)),
    'position': USUAL.position,
    'rotation': USUAL.rotation,
}


def columns_of(name):
    """Return the random effects of an arm, its whitened columns and whose they are."""
    robot = load_robot(ROBOTS / f'{name}.yaml')
    plant = make_plant(robot, work=USUAL, seed=1)
    dataset = simulate(plant, default_postures(robot, 12), seed=1)
    session = Session(dataset, robot, load_catalogue(), workers=1)
    assert session.weigh({}) and session.imperfections is not None
    columns = session.whitener.white(session.imperfections.moves).T
    owners, kinds = session.imperfections.owners, session.imperfections.kinds
    return RandomEffects(columns, owners, kinds), columns, owners


def held(arm, level, random):
    """Draw an arm; return by kind size over true rms, and whether the interval holds it."""
    effects, columns, owners = arm
    members, true = np.zeros(len(owners)), {}
    for k, kind in enumerate(effects.kinds):
        if kind.name in TRUE:
            own = owners == k
            members[own] = level * TRUE[kind.name] * random.normal(size=own.sum())
            true[kind.name] = (k, float(np.sqrt(np.mean(members[own] ** 2))))
    residual = columns @ members + random.normal(size=len(columns))
    sizes = effects.estimate(residual, np.zeros((len(columns), 0)), told=False).values
    low, high = effects.intervals(sizes)
    return {name: (sizes[k] / rms, low[k] <= rms <= high[k]) for name, (k, rms) in true.items()}


def main():
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--robot', default='kato_10_1_single')
    parser.add_argument('--arms', type=int, default=60)
    options = parser.parse_args()
    arm, random = columns_of(options.robot), np.random.default_rng(0)
    for level in (1.0 / 3.0, 1.0, 2.0):
        found = [held(arm, level, random) for _ in range(options.arms)]
        for name in found[0]:
            ratio, inside = zip(*(one[name] for one in found), strict=True)
            print(
                f'level {level:.2f}  {name:17} size over true {np.median(ratio):.2f}, '
                f'intervals that hold {100.0 * np.mean(inside):.0f} %'
            )


if __name__ == '__main__':
    main()
