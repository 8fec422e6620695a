"""
How many postures an investigation needs, against the fixed twelve and against random ones.

A hidden effect of visible size (2 to 5 % of the length at the tip) in an arm as it is built, other
than the model (finer cells, capstan's exponential). First the fixed design of twelve postures is
diagnosed: its verdict and the widest interval are the aim. Then the arm investigates itself until
it names something with an interval as narrow, a ball in the room kept out of; then random postures
are tried, the first so many of one row (halving), until a diagnosis names the same with an
interval as narrow. Right means that the hidden effect is named or in the class that is named. The
fixed and the random postures are counted by who knows the answer; an investigation does not, and
needs a diagnosis more to trust its name: both counts are printed.

Every case is a line of FILE: what each posture told, processor time, the highest tension over the
limit and how near the real arm came to the ball on any way. Begun again with the same FILE it goes
on, and cases that were run with `--no-random` get their random postures; cases alternate between
the robots. `--figures` prints what FILE has, and runs nothing.

example: python benchmarks/bench_investigate.py --output investigated.jsonl --cases 50
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.verdict import Verdict
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.investigation.goal import Goal, names_of, widest
from tendon_robot_ros.investigation.loop import Investigation
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.robot.keep_out import KeepOut, Region, Sphere
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.simulation.rehearsal import draw
from tendon_robot_ros.studies.rehearse import SimulatedArm
from tendon_robot_ros.workspace.postures import default_postures

FIXED, RANDOM, TRIALS = 12, (4, 5, 6, 7, 9, 12, 16, 20, 24), 3
BALL_SHARE = 0.08  # radius of the ball that is kept out of, in lengths of the arm
WAY_POINTS = 40  # of each way that are looked at


class WatchedArm(SimulatedArm):
    """A simulated arm that notes how far beyond a limit, and how near to a region, it ever was."""

    def __init__(self, plant, regions, seed):
        """Stand straight."""
        super().__init__(plant, seed=seed)
        self.regions, self.beyond, self.clearance = regions, -np.inf, np.inf

    def measure(self, inputs, trials):
        """Measure a posture, and look at the way to it."""
        low, high = self.robot.tension_limits
        self.beyond = max(self.beyond, float(np.max(inputs)) - high, low - float(np.min(inputs)))
        way = low + np.linspace(0.0, 1.0, WAY_POINTS)[:, None] * (inputs - low)
        points = self.plant.shapes(way).positions.reshape(-1, 3)
        self.clearance = min(self.clearance, self.regions.clearance(points).distance)
        return super().measure(inputs, trials)


def ball(robot, seed):
    """Return a ball about the tip of a random posture."""
    rows = np.clip(default_postures(robot, 12, 500 + seed), *robot.tension_limits)
    tips = Model(robot).shapes(rows).tip_position
    centre = max(tips, key=lambda tip: np.hypot(tip[0], tip[1]))  # the straight arm keeps clear
    radius = BALL_SHARE * robot.length
    return KeepOut((Region('ball', Sphere(tuple(centre.tolist()), radius)),))


def random_postures(plant, count, seed):
    """Return tensions that are uniform between nothing and what a design uses at most."""
    robot = plant.robot
    top = default_postures(robot, FIXED).max(axis=0)
    low, random, rows = robot.tension_limits[0], np.random.default_rng([seed, 8]), []
    while len(rows) < count:
        row = random.uniform(low, top)
        try:
            plant.shapes(row[None])
        except NoEquilibriumError:
            continue
        rows.append(row)
    return np.array(rows)


def measured(plant, rows, seed):
    """Diagnose postures of a plant: names, the widest interval, the verdict, processor time."""
    catalogue = load_catalogue().sized(natural_sizes(plant.robot))
    begin = time.process_time()
    found = diagnose(simulate(plant, rows, trials=TRIALS, seed=seed), None, catalogue, 1)
    spent = time.process_time() - begin
    return names_of(found), widest(found, catalogue), str(found.verdict), spent


def random_needed(plant, seed, names, aim):
    """Return how many random postures name the same as narrowly (None: not the most), and time."""
    low, high, spent = 0, len(RANDOM), 0.0
    rows = random_postures(plant, RANDOM[-1], seed)
    while low < high:
        middle = (low + high) // 2
        found, wide, _, took = measured(plant, rows[: RANDOM[middle]], seed)
        spent += took
        enough = found == names and wide is not None and wide <= aim
        low, high = (low, middle) if enough else (middle + 1, high)
    return (RANDOM[low] if low < len(RANDOM) else None), spent


def case(name, seed, with_random):
    """Return what became of one hidden effect."""
    robot = load_robot(f'config/robots/{name}.yaml')
    hidden = draw(robot, load_catalogue(), '', seed)
    plant = make_plant(robot, hidden.plant, seed=seed, work=Workmanship())
    names, width, verdict, fixed_time = measured(plant, default_postures(robot, FIXED), seed)
    aim = aim_of(width)
    regions = ball(robot, seed)
    arm = WatchedArm(plant, regions, seed)
    begin = time.process_time()
    goal = Goal(interval=aim, checks=0, trials=TRIALS, postures=24)
    made = Investigation(arm, goal, regions=regions).run()
    spent = time.process_time() - begin
    own = names_of(made.diagnosis)
    row = {
        'robot': name,
        'seed': seed,
        'hidden': hidden.name,
        'fixed': {
            'right': hidden.name in names, 'names': names, 'verdict': verdict,
            'interval': width, 's': round(fixed_time, 2),
        },
        'investigation': {
            'postures': len(made.dataset.postures), 'right': hidden.name in own, 'names': own,
            'why': str(made.outcome), 'interval': made.record.rounds[-1].widest,
            's': round(spent, 2),
            'told': [[r.postures, r.verdict, r.names, r.widest] for r in made.record.rounds],
        },
        'beyond': arm.beyond,
        'clearance': arm.clearance,
        'visits': len(arm.visited),
        'random': None,
    }  # fmt: skip
    if with_random:
        add_random(row, plant)
    return row


def both_right(row):
    """Tell whether the fixed twelve and the investigation both name what is hidden."""
    return row['fixed']['right'] and row['investigation']['right']


def add_random(row, plant=None):
    """Add to a case how many random postures tell the same, where there is something to tell."""
    if not both_right(row):
        return
    robot, seed = load_robot(f'config/robots/{row["robot"]}.yaml'), row['seed']
    if plant is None:
        hidden = draw(robot, load_catalogue(), '', seed)
        plant = make_plant(robot, hidden.plant, seed=seed, work=Workmanship())
    aim = aim_of(row['fixed']['interval'])
    names = row['investigation']['names']
    row['random'], row['random_s'] = random_needed(plant, seed, names, aim)


def first_told(row):
    """Return from which posture on the diagnosis named what it named in the end."""
    told = row['investigation']['told']
    same = [r[0] for i, r in enumerate(told) if all(t[2] == told[-1][2] for t in told[i:])]
    return same[0]


def aim_of(width):
    """Return the interval that is asked for, after that of the fixed twelve."""
    return max(0.25 if width is None else width, 0.002)


def first_enough(row):
    """Return from which posture on name and interval were as good; inf: never."""
    told, aim = row['investigation']['told'], aim_of(row['fixed']['interval'])
    good = [r[2] == told[-1][2] and r[3] is not None and r[3] <= aim for r in told]
    return next((r[0] for i, r in enumerate(told) if all(good[i:])), np.inf)


def median(values):
    """Return the median; nan of none."""
    return float(np.median(values)) if len(values) else float('nan')


def postures(both, tried):
    """Return how many postures it took where both are right, and over random ones."""
    narrow = [r for r in tried if np.isfinite(first_enough(r))]
    return {
        'where both are right: postures, median': median(
            [r['investigation']['postures'] for r in both]
        ),
        'named from posture, median': median([first_told(r) for r in both]),
        'as narrow as the twelve': sum(
            (r['investigation']['interval'] or np.inf) <= aim_of(r['fixed']['interval'])
            for r in both
        ),
        'as good from posture, median (the next one confirms it)': median(
            [first_enough(r) for r in both]
        ),
        'as narrow as the twelve, and random ones were tried': len(narrow),
        'random postures for the same, median (25: more than 24)': median(
            [r['random'] or RANDOM[-1] + 1 for r in narrow]
        ),
        'as good from posture, over random ones, median': median(
            [first_enough(r) / (r['random'] or RANDOM[-1] + 1) for r in narrow]
        ),
    }


def summary(name, rows):
    """Return the figures of a robot."""
    own = [row['investigation'] for row in rows]
    both = [row for row in rows if both_right(row)]
    tried = [r for r in both if 'random_s' in r]
    return {
        'robot': name,
        'hidden effects': len(rows),
        'right, fixed twelve': sum(row['fixed']['right'] for row in rows),
        'right, investigation': sum(one['right'] for one in own),
        'another name, fixed and investigation': [
            sum(bool(one['names']) and not one['right'] for one in kind)
            for kind in ([row['fixed'] for row in rows], own)
        ],
        'called adequate, fixed and investigation': [
            sum(row['fixed']['verdict'] == Verdict.ADEQUATE for row in rows),
            sum(one['why'] == 'model_adequate' for one in own),
        ],
        **postures(both, tried),
        'measurements': sum(row['visits'] for row in rows),
        'most beyond a tension limit [N]': max(row['beyond'] for row in rows),
        'nearest to the ball [mm]': 1e3 * min(row['clearance'] for row in rows),
        'processor time, median: fixed, investigation, random [s]': [
            median([row['fixed']['s'] for row in rows]),
            median([one['s'] for one in own]),
            median([r['random_s'] for r in tried]),
        ],
    }


def written(path):
    """Return the cases that a file has, by robot and seed; what was added later counts."""
    lines = path.read_text().splitlines() if path.exists() else []
    rows = [json.loads(line) for line in lines if line.endswith('}')]
    return {(row['robot'], row['seed']): row for row in rows}


def run(name, seed, row, with_random):
    """Return a case that a file lacks, or that has no random postures yet; None: it has all."""
    if row is None:
        return case(name, seed, with_random)
    if not with_random or 'random_s' in row or not both_right(row):
        return None
    add_random(row)
    return row


def main():
    """Run the cases that a file lacks, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, required=True, metavar='FILE')
    parser.add_argument('--robots', nargs='+', default=['kato_10_1', 'spatial_3'])
    parser.add_argument('--cases', type=int, default=50, help='of each robot')
    parser.add_argument('--first', type=int, default=100, help='seed')
    parser.add_argument('--no-random', action='store_true', help='no random postures')
    parser.add_argument('--figures', action='store_true', help='print what FILE has')
    args = parser.parse_args()
    have = written(args.output)
    wanted = [(r, s) for s in range(args.first, args.first + args.cases) for r in args.robots]
    for key in [] if args.figures else wanted:
        row = run(*key, have.get(key), not args.no_random)
        if row is None:
            continue
        with args.output.open('a') as file:
            file.write(json.dumps(row) + '\n')
        print(json.dumps(row), flush=True)
    for name in args.robots:
        rows = [row for row in written(args.output).values() if row['robot'] == name]
        if rows:
            print(json.dumps(summary(name, rows), indent=1), flush=True)


if __name__ == '__main__':
    main()
