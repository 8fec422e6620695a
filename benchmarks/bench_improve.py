"""
How often the 95 % intervals of `improve` hold: two effects hidden in arms as they are built.

Every draw is an arm of its own (finer cells, imperfections of a laboratory, undeclared),
twelve postures of five trials. Values of the hidden effects count, and where it joins the
tracker's frame; what else joins is listed as beside. The search stops by its own errors on
left-out postures, as what is written does, and takes the arm as it was found by them, too; it is
not made again without each posture.

example: python benchmarks/bench_improve.py --robot spatial_3 --draws 20
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tendon_robot_ros.common.processes import one_thread
from tendon_robot_ros.data import even_markers
from tendon_robot_ros.diagnosis.improve import as_found, inner
from tendon_robot_ros.diagnosis.stepwise import Stepwise
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.crossval import last_worthwhile
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = Path(__file__).parents[1] / 'config' / 'robots'
FRAME = 'base_misalignment'
HIDDEN = ('hinge_friction', 'tip_load')


@dataclass(frozen=True)
class Draw:
    """What was said of one arm."""

    seed: int
    inside: dict[str, bool]  # effect.parameter -> whether its interval holds
    off: dict[str, float]  # error in half intervals
    half: dict[str, float]  # half intervals
    missed: tuple[str, ...]
    wrong: tuple[str, ...]


def sizes(robot, hidden, random):
    """Return hidden values: typical ones times 0.3 to 1, forces anywhere across the arm."""
    catalogue = load_catalogue().sized(natural_sizes(robot))
    flat = np.abs([end[1] for t in robot.tendons for end in (t.base, t.end)]).max() < 1e-6
    found = {}
    for name in hidden:
        values = {}
        for parameter in catalogue[name].parameters:
            size = parameter.typical * random.uniform(0.3, 1.0)
            if parameter.low < 0.0:
                size *= random.choice([-1.0, 1.0])
            if flat and parameter.name.endswith('_y'):
                size = 0.0
            fixed = parameter.has_default or parameter.only_described
            values[parameter.name] = parameter.neutral if fixed else float(size)
        found[name] = values
    return found


def frame_of(built):
    """Return the values of the effect that says where an arm's tracker is."""
    moved = zip('xyz', built.position, built.rotation, strict=True)
    own = [{f'shift_{axis}': float(x), f'rotation_{axis}': float(r)} for axis, x, r in moved]
    return {key: value for one in own for key, value in one.items()}


@one_thread()
def judge(robot_name, hidden, level, markers, seed):
    """Build an arm, improve its description, and hold the values against the truth."""
    robot = load_robot(ROBOTS / f'{robot_name}.yaml')
    for name in hidden:
        robot = robot.without_effect(name) if name in robot.effects else robot
    truth = sizes(robot, hidden, np.random.default_rng([seed, 3]))
    plant = make_plant(robot, truth, seed=seed, work=Workmanship().times(level))
    where = None if markers is None else even_markers(robot, markers)
    data = simulate(plant, default_postures(robot, 12), trials=5, seed=seed, markers=where)
    found = searched(data, robot)
    known = {**truth, FRAME: frame_of(plant.built)}
    inside, off, half = {}, {}, {}
    for name, values in found.items():
        for key, value in values.items() if name in known else ():
            label, true = f'{name}.{key}', known[name][key]
            inside[label] = value.low <= true <= value.high
            half[label] = 0.5 * (value.high - value.low)
            off[label] = (value.value - true) / half[label]
    return Draw(
        seed,
        inside,
        off,
        half,
        tuple(name for name in hidden if name not in found),
        tuple(name for name in found if name not in known),
    )


def searched(data, robot):
    """Return the values of what one search adds."""
    search = Stepwise(data, robot, load_catalogue())
    states = [*search.path()]
    final = states[last_worthwhile(inner(states))]
    found = as_found(search, final)
    return found.values if found.is_worthwhile else found.values_of_the_search


def told(draw):
    """Return a line of the table."""
    out = [f'{k} {draw.off[k]:+.1f}' for k, held in draw.inside.items() if not held]
    return (
        f'{draw.seed:3d}  {sum(draw.inside.values())} of {len(draw.inside)} hold'
        + (f'; not {", ".join(out)} half intervals' if out else '')
        + (f'; not found {", ".join(draw.missed)}' if draw.missed else '')
        + (f'; beside {", ".join(draw.wrong)}' if draw.wrong else '')
    )


def main():
    """Print every draw, and how many intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='spatial_3')
    parser.add_argument('--hidden', nargs='+', default=HIDDEN)
    parser.add_argument('--draws', type=int, default=20)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--level', type=float, default=1.0, help='1: as in a laboratory')
    parser.add_argument('--markers', type=int, help='default: one at every cell')
    parser.add_argument('--workers', type=int, default=1)
    options = parser.parse_args()
    own = (options.robot, tuple(options.hidden), options.level, options.markers)
    seeds = range(options.first, options.first + options.draws)
    draws = []
    with ProcessPoolExecutor(options.workers) as pool:
        for draw in pool.map(partial(judge, *own), seeds):
            draws.append(draw)
            print(told(draw), flush=True)
    for name in dict.fromkeys(label.split('.')[0] for d in draws for label in d.inside):
        held = [v for d in draws for label, v in d.inside.items() if label.split('.')[0] == name]
        print(f'{name}: {sum(held)} of {len(held)} values inside their 95 % intervals')
        halves = [v for d in draws for label, v in d.half.items() if label.split('.')[0] == name]
        print(f'{name}: half intervals {np.median(halves):.2g} (median, SI units)')


if __name__ == '__main__':
    main()
