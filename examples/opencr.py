"""
A real arm that remembers: from two tables to a model that follows it.

Run it from the folder of the project, with the folder of the two tables (docs/opencr.md says where
they are) and, if wanted, one for what comes out.
"""

import sys
from dataclasses import replace
from pathlib import Path

from tendon_robot_ros import compare, dump_robot, import_table, load_robot
from tendon_robot_ros.diagnosis.add import add_effects

SERVOS = (4, 3, 9, 5, 2, 8, 6, 1, 7)  # that wind the wires w0 to w8
EFFECTS = ('base_misalignment', 'section_stiffness', 'pre_curvature', 'bending_hysteresis')
RECIPE = {
    'time': {},  # every row was taken after the arm had settled
    'path': 'sequence',
    'frame': {'method': 'base'},
    'positions': 'mm',
    'inputs': {f'w{k}': {'column': f'servo_{n}_mm'} for k, n in enumerate(SERVOS)},
}

tables, output = Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else 'results/opencr')
robot = load_robot('examples/opencr.yaml')
train, validation = (
    replace(import_table(tables / f'{name}.csv', robot, RECIPE).dataset, position_noise=3e-4)
    for name in ('train', 'val')
)
print(compare(validation))
better = add_effects(train, EFFECTS).robot
print(compare(validation, [('as described', robot), ('that remembers', better)]))
output.mkdir(parents=True, exist_ok=True)
(output / 'better.yaml').write_text(dump_robot(better), encoding='utf-8')
