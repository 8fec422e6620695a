"""
How often the 95 % intervals of `add` hold: every effect on two robots, other noise every time.

The simulated robots are those of the model (same cells, same friction law), so that only the
noise can push a true value out of its interval. Prints a table, writes JSON.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from pathlib import Path

import numpy as np
from machine import machine
from simulated_cases import SHAPING, hidden_values, needs_pulls, robot_of

from tendon_robot_ros.common.errors import TendonRobotError
from tendon_robot_ros.diagnosis.add import add_effects
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = ('hinged', 'arcs')


def held(task) -> tuple[tuple[str, str], dict[str, bool] | None, float]:
    """Fit one simulated data set; per parameter, whether its interval holds the truth."""
    name, effect, seed, size = task
    robot = robot_of(name, effect)
    values = hidden_values(effect, size, seed, robot)
    if effect in SHAPING and seed % 2:
        values = {'fraction': 0.6}
    path = 'sequence' if effect == 'friction_memory' else 'from_straight'
    kind = 'displacement' if needs_pulls(effect) else 'tension'
    count = 20 if path == 'sequence' else 12
    try:
        plant = make_plant(robot, {effect: values}, refine=1, scatter=0.0, capstan=False)
        inputs = default_postures(robot, count, 0, kind, path)
        data = simulate(plant, inputs, input=kind, path=path, seed=seed)
        made = add_effects(data, [effect], check=data)
    except TendonRobotError as error:
        print(f'{task}: {error}', file=sys.stderr)
        return (name, effect), None, np.nan
    found = {}
    for key, value in made.values[effect].items():
        bare, _, section = key.partition('[')
        truth = np.atleast_1d(values[bare])
        names = [f'{s.name}]' for s in robot.sections]
        true = truth[names.index(section)] if len(truth) > 1 else truth[0]
        found[key] = bool(value.low <= true <= value.high)
    return (name, effect), found, made.fitted.after / made.fitted.floor


def tasks(options):
    """List robots, effects and seeds."""
    for effect in options.effects or load_catalogue().names:
        for name in ROBOTS:
            if name == 'arcs' and effect in ('straight_tendon', 'section_stiffness'):
                continue
            for seed in range(options.seeds):
                yield name, effect, seed, float(15.0 ** -np.random.default_rng(seed).random())


def main() -> int:
    """Fit everything and print the coverage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=200)
    parser.add_argument('--effects', nargs='*')
    parser.add_argument('--workers', type=int, default=os.cpu_count())
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    hits: dict[tuple[str, str, str], list[bool]] = {}
    refused: dict[tuple[str, str], int] = {}
    with multiprocessing.get_context('spawn').Pool(options.workers) as pool:
        for where, found, _ in pool.imap_unordered(held, tasks(options), chunksize=8):
            refused[where] = refused.get(where, 0) + (found is None)
            for key, hit in (found or {}).items():
                hits.setdefault((*where, key), []).append(hit)
    every = [hit for row in hits.values() for hit in row]
    for (name, effect, key), row in sorted(hits.items()):
        print(
            f'{name:8s} {effect:22s} {key:26s} {np.mean(row):6.1%} of {len(row)}'
            f'  not determined: {refused[name, effect]}'
        )
    print(
        f'all: {np.mean(every):.1%} of {len(every)}; the fewest: '
        f'{min(np.mean(row) for row in hits.values()):.1%}'
    )
    if options.json:
        rows = {' '.join(key): float(np.mean(row)) for key, row in hits.items()}
        options.json.write_text(
            json.dumps(
                {
                    'machine': machine(),
                    'seeds': options.seeds,
                    'coverage': rows,
                    'all': float(np.mean(every)),
                },
                indent=1,
            )
        )
    return 0


if __name__ == '__main__':
    sys.exit(main())
