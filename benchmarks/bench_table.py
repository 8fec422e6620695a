"""
Processor time to import a million rows of a laboratory's table: time, 3 tensions, 4 markers.

usage: python benchmarks/bench_table.py [--rows N] [--markers N] [--json FILE]
"""

import argparse
import json
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from machine import machine

from tendon_robot_ros.data import even_markers
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.measurements import (
    Laboratory,
    SimulatedNoise,
    raw_table,
    write_table,
)
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.tables import import_table
from tendon_robot_ros.workspace.postures import default_postures

ROBOT = Path(__file__).parents[1] / 'config/robots/spatial_3.yaml'
LIMIT_S = 5.0


def write(path, rows, markers):
    """Write a recording of so many rows at 1000 frames a second, with gaps and a slip."""
    robot = replace(load_robot(ROBOT), gravity=(0.0, 0.0, 9.81))
    plant = make_plant(robot, {'hinge_friction': {}})
    lab, postures, trials = Laboratory(rate=1000.0), 12, 3
    stands = rows / (lab.rate * (2 * postures * trials + 1)) - lab.move
    names, values = raw_table(
        plant,
        default_postures(robot, postures),
        lab=replace(lab, hold=stands, trials=trials),
        noise=SimulatedNoise(),
        markers=even_markers(robot, markers),
    )
    write_table(path, names, values)
    return len(values), robot


def main():
    """Measure, print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rows', type=int, default=1_000_000)
    parser.add_argument('--markers', type=int, default=4)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'raw.csv'
        rows, robot = write(path, options.rows, options.markers)
        size = path.stat().st_size
        times = []
        for _ in range(3):
            start = time.process_time()
            imported = import_table(path, robot, {'up': 'y'})
            times.append(time.process_time() - start)
        start = time.process_time()
        imported.save(Path(folder) / 'out')
        saving = time.process_time() - start
    postures, trials, markers = imported.dataset.positions.shape[:3]
    result = {
        'rows': rows,
        'columns': 1 + 3 + 3 * options.markers,
        'megabytes': round(size / 1e6),
        'limit_s': LIMIT_S,
        'import_s': round(sorted(times)[1], 2),
        'import_all_s': [round(t, 2) for t in times],
        'save_with_picture_s': round(saving, 2),
        'postures_trials_markers': [postures, trials, markers],
        'memory_mb': round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
        **machine(),
    }
    text = json.dumps(result, indent=2)
    print(text)
    if options.json:
        options.json.write_text(text)
    return result


if __name__ == '__main__':
    main()
