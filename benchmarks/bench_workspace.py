"""
How the time of a workspace grows with its postures, on processes of this machine.

Seconds are those of the processors, of all workers together: on an idle machine it is done in
that time over their number. Memory is the most that the largest process had.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path

from machine import machine, tell

from tendon_robot_ros.cli.options import progress
from tendon_robot_ros.common.workers import Workers
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.versions import Preparation
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.workspace.volume import Sampling, Volume

ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'


def spent() -> float:
    """Processor time [s] of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def measured(model: Model, postures: int, count: int) -> dict[str, float]:
    """Sample a workspace; what it took."""
    start, begun = spent(), time.monotonic()
    with Workers(count, prepare=Preparation.of_this_process()) as workers, progress(True) as show:
        volume = Volume(Sampling.of(model, postures), show, workers)
    memory = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    solved = postures * (2 if volume.frictionless else 1)
    return {
        'postures': solved,
        'processor seconds': spent() - start,
        'microseconds per posture': 1e6 * (spent() - start) / solved,
        'seconds': time.monotonic() - begun,
        'megabytes': max(one.ru_maxrss for one in memory) / 1024.0,
        'cubes': len(volume.reached),
        'size': volume.reached.size,
    }


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='kato_10_1')
    parser.add_argument('--postures', type=int, nargs='+', default=[10**5, 10**6, 10**7])
    parser.add_argument('--workers', type=int, default=2)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    model = Model(load_robot(ROBOTS / f'{options.robot}.yaml'))
    Volume(Sampling.of(model, 4_000))  # compiles
    figures = {f'{n:,}': measured(model, n, options.workers) for n in options.postures}
    tell({'machine': machine(), options.robot: figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
