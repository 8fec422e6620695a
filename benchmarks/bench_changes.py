"""
What is said to have changed between two recordings of one arm, of which the description is wrong.

Arms of ten cells as built, planar and spatial, that stiffen as they bend, which their description
lacks: nothing changes, a load is hung to the tip, the backbone gets stiffer, or a load is hung to
the tip and the tracker is moved. With `--days` both are recorded on several days, on each of
which zeros of wire pulls are found, and the tracker is placed, anew.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_pushes import arm
from machine import machine, tell

from tendon_robot_ros.data import DataSet
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.robot import Robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import INPUTS, default_postures

LACKS = {'nonlinear_stiffness': {'cubic': 3.0}}  # in both recordings
POSTURES = 12
FORCE = 0.3  # [1] of the force that bends the arm by a radian


def changes(robot: Robot) -> dict[str, dict[str, dict[str, float]]]:
    """Return what has changed, by name."""
    load = {'tip_load': {'force_x': FORCE * natural_sizes(robot)['force']}}
    moved = {'base_misalignment': {'shift_x': 0.02 * robot.length}}
    stiff = {'backbone_stiffness': {'relative_change': 0.15}}
    return {'nothing': {}, 'load': load, 'stiffer': stiff, 'load and tracker': load | moved}


def anew(dataset: DataSet, random: np.random.Generator) -> DataSet:
    """Return a recording with other zeros of pulls, and another frame of the tracker."""
    turn = np.eye(3) + np.cross(np.eye(3), random.normal(0.0, np.radians(0.3), 3))
    shift, zeros = random.normal(0.0, 5e-4, 3), random.normal(0.0, 2e-4, dataset.inputs.shape[1])
    zeros = zeros if dataset.input == 'displacement' else 0.0
    return replace(
        dataset,
        positions=dataset.positions @ turn + shift,
        inputs=dataset.inputs + zeros,
        trial_inputs=None,
    )


def said(
    robot: Robot, change: dict[str, dict[str, float]], seed: int, options: argparse.Namespace
) -> str:
    """Return the verdict on a drawn arm, and whether the interval of a load holds."""
    kind, markers, days = options.input, options.markers, range(options.days)
    places = robot.length * (np.arange(markers) + 1) / markers if markers else None
    random = np.random.default_rng(seed)
    old, new = (
        [
            simulate(
                make_plant(robot, LACKS | hidden, seed=seed, work=Workmanship()),
                default_postures(robot, POSTURES, seed + 1000 * day, kind, 'from_straight'),
                input=kind,
                seed=2 * seed + trial + 1000 * day,
                markers=places,
            )
            for day in days
        ]
        for trial, hidden in enumerate(({}, change))
    )
    if len(days) > 1:
        old, new = ([anew(one, random) for one in recorded] for recorded in (old, new))
    found = diagnose(new, reference=old)
    effects = (effect.name for effect in found.effects)
    names = list(dict.fromkeys((*effects, *found.cannot_tell_apart)))
    text = ' + '.join((found.verdict.value, *names))
    if 'tip_load' in change and 'tip_load' in names:
        told = (*found.effects, *found.candidates)  # of a candidate alone where a class is named
        force = next(one for one in told if one.name == 'tip_load').parameters['force_x']
        holds = force.low <= change['tip_load']['force_x'] <= force.high
        text += ', interval ' + ('holds' if holds else 'does not hold')
    return text


def main() -> int:
    """Count what is said of drawn arms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=int, default=6, help='of each change and arm; default 6')
    parser.add_argument('--robots', nargs='+', default=['kato_10_1_single', 'spatial_3'])
    parser.add_argument('--input', choices=INPUTS, default='tension')
    parser.add_argument('--first', type=int, default=0, help='seed')
    parser.add_argument('--markers', type=int, default=0, help='evenly spaced; default: all')
    parser.add_argument('--days', type=int, default=1, help='of each recording; default 1')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    figures: dict[str, object] = {}
    for name in options.robots:
        robot = replace(arm(name), gravity=(0.0, 0.0, 0.0))
        for key, change in changes(robot).items():
            seeds = range(options.first, options.first + options.cases)
            verdicts = [said(robot, change, seed, options) for seed in seeds]
            figures[f'{name}, {key}'] = dict(Counter(verdicts))
            print(f'{name}, {key}: {figures[f"{name}, {key}"]}', file=sys.stderr, flush=True)
    tell(figures | {'machine': machine()}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
