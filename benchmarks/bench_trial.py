"""
From a laboratory's table of an arm that shares no code with the model to a verdict, timed.

The arm: a level rod of nitinol with ten disks and three wires that rub in their holes, those of
the base plate included (fine_rod.py), cells that scatter by 2 %, load cells by 0.5 %, and 15 g at
the tip that the description does not know. The table: tracker turned by 30° and 200 mm off, y up,
mm, gaps, markers in no order, a trial that slips. Then `robot new`, `import table` and `diagnose`
as typed.

usage: python benchmarks/bench_trial.py [--seed N] [--noise F] [--plate] [--folder D] [--json FILE]
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fine_rod import FineRod, G
from machine import machine

ANSWERS = ('lab_arm', 1, 10, 15, 'rod', 1.5, 60, 'arc', 3, 8, 0.3, 13, 0.15, 'horizontal', 20, 10,
           50, 'free', 90)  # fmt: skip
TURNS = np.radians([90.0, 210.0, 330.0])
REST, RATE_HZ, HELD_S = 0.5, 30.0, 2.2  # [N]
POSTURES = [(10, 0.5, 0.5), (0.5, 10, 0.5), (0.5, 0.5, 10), (5, 0.5, 0.5), (8, 8, 0.5),
            (0.5, 8, 8), (8, 0.5, 8), (12, 4, 4), (4, 12, 4), (9, 9, 9), (0.5, 5, 8),
            (0.5, 3, 0.5)]  # fmt: skip
DISKS, NAMES = np.array([2, 4, 5, 7, 9, 10]) - 1, 'CAFBED'  # that carry markers, and their names
SLIPPED = (1, 4)  # trial, posture
TIP_MASS = 0.015  # [kg]


def rod_of(rng):
    """Return the arm as it is."""
    return FineRod(
        length=0.15,
        disks=10,
        elements=12,
        rigidity=60e9 * np.pi * 0.0015**4 / 64.0,
        holes=0.008 * np.c_[np.cos(TURNS), np.sin(TURNS), np.zeros(3)],
        friction=0.12,
        arm_mass=0.02,
        tip_mass=TIP_MASS,
        softness=tuple(1.0 + 0.02 * rng.normal(size=10)),
    )


def rows_of(rod, rng, noise=1.0):
    """Return the rows of the table: time [s], tensions [N], markers [mm], sorted by name."""
    cosine, sine = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    up_is_y = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]) @ up_is_y
    gains, order = 1.0 + np.array([0.004, -0.006, 0.003]), np.argsort(list(NAMES))
    rows = []

    def frames(places, tensions, count):
        for _ in range(count):
            seen = places @ turn.T + [0.12, 0.05, -0.15]
            seen += 1e-4 * noise * rng.normal(size=places.shape)
            if rng.random() < 0.03:
                seen[rng.integers(len(seen))] = np.nan
            read = tensions * gains + 0.01 * rng.normal(size=3)
            rows.append([len(rows) / RATE_HZ, *read, *(1e3 * seen[order]).ravel()])

    def hold(places, tensions, seconds):
        # an arm never comes back exactly
        settled = places + 5e-5 * noise * rng.normal(size=places.shape)
        frames(settled, tensions, int(seconds * RATE_HZ))

    rest = np.full(3, REST)
    home = rod.disk_positions(rest)[DISKS]
    hold(home, rest, HELD_S)
    for trial in range(3):
        for p, posture in enumerate(POSTURES):
            pulled = np.array(posture) * (1.0 + 0.003 * rng.normal(size=3))
            acting = pulled * [0.8, 1.0, 1.0] if (trial, p) == SLIPPED else pulled
            there = rod.disk_positions(acting)[DISKS]
            ways = np.linspace(0.0, 1.0, 12)[1:-1]
            for way in ways:
                frames(home + way * (there - home), rest + way * (pulled - rest), 1)
            hold(there, pulled, HELD_S)
            for way in ways[::-1]:
                frames(home + way * (there - home), rest + way * (pulled - rest), 1)
            hold(home, rest, 1.2)
    return rows


def write(path, rows):
    """Write the table as a laboratory has it."""
    head = ['Time [s]', *(f'Cable {k} (N)' for k in (1, 2, 3))]
    head += [f'{name}_{axis} [mm]' for name in sorted(NAMES) for axis in 'XYZ']
    with path.open('w', newline='') as file:
        table = csv.writer(file)
        table.writerow(head)
        table.writerows([f'{v:.4f}' if np.isfinite(v) else 'NaN' for v in row] for row in rows)


def walk(folder, answers):
    """Type the commands of docs/from_mocap_to_verdict.md; return what they print and seconds."""
    program = [sys.executable, '-m', 'tendon_robot_ros']
    calls = {
        'robot new': ['--output', 'arm.yaml'],
        'import table': ['raw.csv', '--robot', 'arm.yaml', '--up', 'y', '--output', 'run'],
        'diagnose': ['run', '--add', 'better.yaml', '--json', 'verdict.json'],
    }
    seconds = {}
    for name, arguments in calls.items():
        start = time.perf_counter()
        subprocess.run([*program, *name.split(), *arguments], cwd=folder, input=answers, text=True,
                       check=True)  # fmt: skip
        seconds[name] = round(time.perf_counter() - start, 1)
    return json.loads((folder / 'verdict.json').read_text()), seconds


def main():
    """Make the table, walk, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--noise', type=float, default=1.0, help='of the tracker, times 0.1 mm')
    parser.add_argument(
        '--plate', action='store_true', help='describe the holes of the base plate'
    )
    parser.add_argument('--folder', help='keep everything there')
    parser.add_argument('--json', help='write the figures')
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(args.folder or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        write(folder / 'raw.csv', rows_of(rod_of(rng), rng, args.noise))
        answers = '\n'.join(map(str, (*ANSWERS, 'yes' if args.plate else 'no')))
        verdict, seconds = walk(folder, answers)
    named = {effect['name']: effect['parameters'] for effect in verdict['effects']}
    result = {'verdict': verdict['verdict'], 'named': named, 'true force_y [N]': -TIP_MASS * G,
              'seconds': seconds, 'machine': machine()}  # fmt: skip
    print(json.dumps(result, indent=1))
    if args.json:
        Path(args.json).write_text(json.dumps(result, indent=1) + '\n')


if __name__ == '__main__':
    main()
