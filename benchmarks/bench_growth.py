"""How the time of a diagnosis grows with the cells of an arm of one section, all effects tried."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

from machine import machine, tell

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.robot import Robot, load_robot
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.studies.paper_motion import with_cells
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'
POSTURES, TRIALS = 12, 5
HIDDEN = {'tip_load': {'force_x': 0.02, 'force_y': 0.01, 'force_z': 0.0}}  # [N]


def arm(name: str, cells: int, exact: bool) -> Robot:
    """Return a shipped robot with a number of cells, as long and as soft as it is."""
    robot = with_cells(load_robot(ROBOTS / f'{name}.yaml'), cells)
    return replace(robot, gravity=(0.0, 0.0, 0.0), exact=exact)


def diagnosed(name: str, cells: int, exact: bool) -> dict[str, object]:
    """Diagnose 12 postures of 5 trials with a marker at every cell; processor time [s]."""
    robot = arm(name, cells, exact)
    postures = default_postures(robot, POSTURES, 0, 'tension', 'from_straight')
    dataset = simulate(
        make_plant(robot, HIDDEN), postures, trials=TRIALS, noise=SimulatedNoise(), seed=1
    )
    start = time.process_time()
    found = diagnose(dataset)
    return {
        'verdict': f'{found.verdict}: {" + ".join(effect.name for effect in found.effects)}',
        'seconds': time.process_time() - start,
    }


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='spatial_3')
    parser.add_argument('--cells', type=int, nargs='+', default=[20, 50, 100, 200])
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    diagnosed(options.robot, min(options.cells), True)  # compiles
    figures = {
        kind: {f'{cells} cells': diagnosed(options.robot, cells, exact) for cells in options.cells}
        for kind, exact in (('exact', True), ('as built', False))
    }
    tell({'machine': machine(), 'diagnosis': figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
