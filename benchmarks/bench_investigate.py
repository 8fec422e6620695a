"""
How many postures an investigation needs, against the fixed twelve and against random ones.

A hidden effect of visible size (2 to 5 % of the length at the tip) in an arm as it is built, other
than the model (finer cells, capstan's exponential). First the fixed design of twelve postures is
diagnosed: its verdict and the widest interval are the aim. Then the arm investigates itself until
it names something with an interval as narrow; then random postures are added until a diagnosis
names the same with an interval as narrow. Right means that the hidden effect is named or in the
class that is named.

example: python benchmarks/bench_investigate.py --robots kato_10_1 --cases 20
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.investigation.goal import Goal
from tendon_robot_ros.investigation.loop import Investigation
from tendon_robot_ros.investigation.simulated_arm import SimulatedArm
from tendon_robot_ros.investigation.stopping import names_of, widest
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.imperfect import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.simulation.rehearsal import draw
from tendon_robot_ros.workspace.postures import default_postures

FIXED, RANDOM, TRIALS = 12, (4, 5, 6, 7, 9, 12, 16, 20, 24), 3


def random_postures(robot, count, seed):
    """Return tensions that are uniform between nothing and what a design uses at most."""
    top = default_postures(robot, FIXED).max(axis=0)
    low = robot.tension_limits[0]
    return np.random.default_rng([seed, 8]).uniform(low, top, size=(count, len(top)))


def measured(plant, rows, seed):
    """Diagnose postures of a plant: names, the widest interval."""
    catalogue = load_catalogue().sized(natural_sizes(plant.robot))
    found = diagnose(simulate(plant, rows, trials=TRIALS, seed=seed), None, catalogue, 1)
    return names_of(found), widest(found, catalogue)


def case(robot, seed):
    """Return what became of one hidden effect."""
    hidden = draw(robot, load_catalogue(), '', seed)
    plant = make_plant(robot, hidden.plant, seed=seed, work=Workmanship())
    names, width = measured(plant, default_postures(robot, FIXED), seed)
    aim = 0.25 if width is None else width
    goal = Goal(interval=max(aim, 0.002), checks=0, trials=TRIALS, postures=24)
    made = Investigation(SimulatedArm(plant, seed=seed), goal).run()
    own = names_of(made.diagnosis)
    row = {
        'seed': seed,
        'hidden': hidden.name,
        'fixed': {'right': hidden.name in names, 'names': names, 'interval': width},
        'investigation': {
            'postures': len(made.dataset.postures),
            'right': hidden.name in own,
            'names': own,
            'why': str(made.outcome),
            'interval': made.record.rounds[-1].widest,
        },
        'random': None,
    }
    for count in RANDOM:
        try:
            found, wide = measured(plant, random_postures(robot, count, seed), seed)
        except NoEquilibriumError:
            continue
        if set(found) == set(own) and wide is not None and wide <= aim:
            row['random'] = count
            break
    return row


def summary(name, rows):
    """Return the figures of a robot."""
    own = [row['investigation'] for row in rows]
    both = [r for r in rows if r['fixed']['right'] and r['investigation']['right']]
    random = [RANDOM[-1] + 1 if r['random'] is None else r['random'] for r in both]
    return {
        'robot': name,
        'hidden effects': len(rows),
        'right, fixed twelve': sum(row['fixed']['right'] for row in rows),
        'right, investigation': sum(one['right'] for one in own),
        'postures, median': float(np.median([one['postures'] for one in own])),
        'where both are right: postures, median': float(
            np.median([r['investigation']['postures'] for r in both] or [np.nan])
        ),
        'random postures for the same, median (25: more than 24)': float(
            np.median(random or [np.nan])
        ),
    }


def main():
    """Print a line per effect and the figures; write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robots', nargs='+', default=['kato_10_1', 'spatial_3'])
    parser.add_argument('--cases', type=int, default=20)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    results = []
    for name in args.robots:
        robot, rows = load_robot(f'config/robots/{name}.yaml'), []
        for seed in range(args.first, args.first + args.cases):
            rows.append(case(robot, seed))
            print(json.dumps(rows[-1]), flush=True)
        results.append({**summary(name, rows), 'cases': rows})
        print(json.dumps(summary(name, rows), indent=1), flush=True)
    if args.json:
        args.json.write_text(json.dumps(results, indent=1))


if __name__ == '__main__':
    main()
