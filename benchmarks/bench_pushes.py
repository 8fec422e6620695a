"""
Whether a load within the arm, a string, a wall, and a load at the tip are told from each other.

Arms of ten cells as built, planar and spatial, twelve postures each; the place, size and direction
of what pushes are drawn, and clean arms are drawn beside them. What pushes can be seen where the
gain in likelihood by the truth itself, fitted from its true values, is beyond what chance reaches
at the level of the alarm.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.common.errors import InputError, NoEquilibriumError
from tendon_robot_ros.data import DataSet
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.placed import acting
from tendon_robot_ros.diagnosis.result import Diagnosis
from tendon_robot_ros.diagnosis.select import reweighed
from tendon_robot_ros.diagnosis.verdict import gains
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.candidates import Candidate, gain_p_value
from tendon_robot_ros.inference.predict import Predictor, free_parameters
from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Robot, load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import INPUTS, default_postures

CELLS = 10
PLACES = 0.35, 0.9  # [1] of the length, least and greatest
FORCES = 0.2, 0.6  # [1] of the force that bends the arm by a radian
DISTANCES = 0.4, 1.2  # [1] of the length, from the place to where a string is fixed
PLACED = 'point_load', 'tether', 'contact'
KINDS = *PLACED, 'tip_load', 'none'


def arm(name: str) -> Robot:
    """Return a robot with its cells joined to `CELLS`, as long and as soft as it is."""
    robot = load_robot(name)
    (section,) = robot.sections
    stiffness = CELLS / float(np.sum(np.reciprocal(section.bending_stiffness)))
    cells = replace(
        section,
        cells=CELLS,
        cell_length=section.cells * section.cell_length / CELLS,
        bending_stiffness=(stiffness,) * CELLS,
        mass_profile=(1.0,) * CELLS,
    )
    shaping = {
        name: {'fraction': 1.0} for name in ('eyelet_wrap', 'straight_tendon', 'tendon_travel')
    }
    return replace(robot, sections=(cells,), effects={**robot.effects, **shaping})


def drawn(
    robot: Robot, kind: str, random: np.random.Generator, rows: np.ndarray
) -> dict[str, dict[str, float]]:
    """Return what is hidden; a wall is where half of the postures (P, m) would reach beyond it."""
    planar = not any(tendon.base[1] for tendon in robot.tendons)
    toward = random.normal(size=3) * [1.0, not planar, 1.0]
    toward /= np.linalg.norm(toward)
    place = robot.length * random.uniform(*PLACES)
    force = natural_sizes(robot)['force'] * random.uniform(*FORCES)
    point = [0.0, 0.0, place] + robot.length * random.uniform(*DISTANCES) * toward
    axes = 'xyz'
    if kind in ('point_load', 'tip_load'):
        parts = {f'force_{a}': float(v) for a, v in zip(axes, force * toward, strict=True)}
        return {kind: parts if kind == 'tip_load' else {'arc_length': place, **parts}}
    if kind == 'contact':
        toward[2] = abs(toward[2])
        reach = (Model(robot).shapes(rows).positions @ toward).max(axis=1)
        stiffness = 100.0 * natural_sizes(robot)['tip_stiffness']
        azimuth, elevation = np.arctan2(-toward[1], -toward[0]), np.arcsin(-toward[2])
        values = stiffness, np.median(reach), azimuth, elevation
        names = 'stiffness', 'distance', 'azimuth', 'elevation'
        return {kind: dict(zip(names, map(float, values), strict=True))}
    parts = {f'point_{a}': float(v) for a, v in zip(axes, point, strict=True)}
    return {} if kind == 'none' else {kind: {'arc_length': place, 'tension': force, **parts}}


def tried(robot: Robot, kind: str, seed: int, input: str = 'tension') -> dict[str, object] | None:
    """Return what a diagnosis says of an arm; None where it has no equilibrium."""
    rows = default_postures(robot, 12, seed, 'tension', 'from_straight')
    hidden = drawn(robot, kind, np.random.default_rng([seed, 37]), rows)
    rows = default_postures(robot, 12, seed, input, 'from_straight')
    try:
        plant = make_plant(robot, hidden, seed=seed, work=Workmanship())
        measured = simulate(plant, rows, seed=seed, input=input)
    except (NoEquilibriumError, InputError):  # also of pulls that a wall does not let it reach
        return None
    start = time.process_time()
    found = diagnose(measured, robot)
    names = [effect.name for effect in found.effects]
    alike = found.cannot_tell_apart
    row: dict[str, object] = {
        'said': ' + '.join((found.verdict.value, *dict.fromkeys((*names, *alike)))),
        'alike': kind in alike,
        'wrong': bool(names) and kind not in (*names, *alike),
        'seconds': time.process_time() - start,
    }
    if kind in hidden:
        row['seen'] = is_seen(measured, robot, kind, hidden[kind])
    if kind in hidden and names == [kind]:
        told, true = found.effects[0].parameters, hidden[kind]
        if 'azimuth' in true:  # the same direction after a turn
            turns = round((told['azimuth'].value - true['azimuth']) / (2.0 * np.pi))
            true['azimuth'] += 2.0 * np.pi * turns
        row['right'] = True
        if kind in PLACED:
            row['off'] = off(measured, robot, kind, true, found) / robot.length
        row['inside'] = [
            key in told and told[key].low <= true[key] <= told[key].high for key in true
        ]
    return row


def is_seen(measured: DataSet, robot: Robot, kind: str, true: dict[str, float]) -> bool:
    """Return whether the truth gains more than the best of all kinds does by chance."""
    session = Question.of(measured, robot, load_catalogue()).prepared()
    every = free_parameters(session.catalogue[kind], robot)
    start = {free: true[free.key] for free in every if free.key in true}
    candidate = Candidate((kind,), tuple(start), present=False)
    session, fitted = reweighed(session, session.fit_all([candidate], {kind: start})[0])
    base, fit = session.base_fit(), fitted.fit
    p_value = gain_p_value(base, session.whitener, fit.deviance, fit.markers, fit.rank)
    return gains(p_value, len(PLACED))


def off(
    measured: DataSet, robot: Robot, kind: str, true: dict[str, float], found: Diagnosis
) -> float:
    """Return by how much [m] the place is off, in the median posture that is pushed."""
    arm = Predictor(measured, robot.with_effect(kind, true), load_catalogue())
    places = dict(zip(measured.postures, acting(arm, {}, kind)[:, 0], strict=True))
    away = [
        abs(one['arc_length'] - places[one['posture']]) for one in found.details['pushes'][kind]
    ]
    return float(np.nanmedian(away))


def main() -> int:
    """Count what is said of drawn arms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=int, default=10, help='of each kind and arm; default 10')
    parser.add_argument('--robots', nargs='+', default=['kato_10_1_single', 'spatial_3'])
    parser.add_argument('--kinds', nargs='+', default=KINDS, choices=KINDS)
    parser.add_argument('--input', choices=INPUTS, default='tension')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    figures: dict[str, object] = {}
    for name in options.robots:
        robot = arm(name)
        for kind in options.kinds:
            rows = [tried(robot, kind, seed, options.input) for seed in range(options.cases)]
            made = [row for row in rows if row is not None]
            right = [row for row in made if row.get('right')]
            inside = [one for row in right for one in row['inside']]
            figures[f'{name}, {kind}'] = {
                'arms': len(made),
                'said': dict(Counter(row['said'] for row in made)),
                'can be seen': sum(row.get('seen', False) for row in made),
                'of these named, or in the named class': sum(
                    (row['alike'] or 'right' in row) for row in made if row.get('seen')
                ),
                'named right': len(right),
                'of these with another that explains as much': sum(row['alike'] for row in right),
                'second of those that explain as much': sum(row['alike'] for row in made)
                - sum(row['alike'] for row in right),
                'named wrong': sum(row['wrong'] for row in made),
                'within 10 % of the length': sum(row['off'] < 0.1 for row in right)
                if kind in PLACED
                else None,
                'in their intervals': f'{sum(inside)} of {len(inside)}',
                'process time [s]': float(np.median([row['seconds'] for row in made])),
            }
            print(f'{name}, {kind}: {figures[f"{name}, {kind}"]}', file=sys.stderr, flush=True)
    tell(figures | {'machine': machine()}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
