"""
Time to read a data set of a million marker rows.

usage: python benchmarks/bench_reading.py
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.data import load_dataset

POSTURES, TRIALS, MARKERS = 1000, 20, 50
ROBOT = """\
name: long
sections: [{name: bending, cells: 50, cell_length: 0.004, bending_stiffness: 0.02}]
tendons: [{name: left, offset: [0.005, 0], section: bending}]
tension_limits: [0, 5]
"""


def write(folder, missing):
    """Write the data set; a share of the markers is missing (empty cells)."""
    rng = np.random.default_rng(0)
    (folder / 'robot.yaml').write_text(ROBOT)
    (folder / 'dataset.yaml').write_text('input: tension\n')
    inputs = ''.join(f'posture_{p},{p / POSTURES:.4f}\n' for p in range(POSTURES))
    (folder / 'inputs.csv').write_text(f'posture,left\n{inputs}')
    with (folder / 'shapes.csv').open('w') as file:
        file.write('posture,trial,marker,x,y,z\n')
        for p in range(POSTURES):
            values = rng.normal(0.0, 0.05, (TRIALS, MARKERS, 3))
            lost = rng.random((TRIALS, MARKERS)) < missing
            for q in range(TRIALS):
                for j in range(MARKERS):
                    x, y, z = values[q, j]
                    cells = ',,' if lost[q, j] else f'{x:.6f},{y:.6f},{z:.6f}'
                    file.write(f'posture_{p},{q},{j + 1},{cells}\n')


def seconds(folder, repeats=3):
    """Return the shortest wall time of reading."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        load_dataset(folder)
        times.append(time.perf_counter() - start)
    return min(times)


def main():
    """Measure, print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    result = {'rows': POSTURES * TRIALS * MARKERS, 'limit_s': 2.0, **machine()}
    for name, missing in (('complete_s', 0.0), ('one_in_ten_missing_s', 0.1)):
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder), missing)
            result[name] = round(seconds(folder), 3)
    tell(result, options.json)
    return result


if __name__ == '__main__':
    main()
