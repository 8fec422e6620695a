"""
A real arm that remembers: from two tables to a model that follows it.

Run it from the folder of the project: python examples/opencr.py TABLES [OUTPUT]. docs/opencr.md
says where the two tables are.
"""

import sys
from dataclasses import replace
from pathlib import Path

from tendon_robot_ros import compare, dump_robot, import_table, load_robot
from tendon_robot_ros.diagnosis.add import add_effect

SERVOS = (4, 3, 9, 5, 2, 8, 6, 1, 7)  # that wind the wires w0 to w8
EFFECTS = ('base_misalignment', 'section_stiffness', 'pre_curvature')
MEMORY = 'bending_hysteresis'
RECIPE = {
    'time': {},  # every row was taken after the arm had settled
    'path': 'sequence',
    'frame': {'method': 'base'},
    'positions': 'mm',
    'inputs': {f'w{k}': {'column': f'servo_{n}_mm'} for k, n in enumerate(SERVOS)},
}

if len(sys.argv) not in (2, 3):
    raise SystemExit(__doc__)
tables, output = Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else 'results/opencr')
robot = load_robot('examples/opencr.yaml')
train, validation = (
    replace(import_table(tables / f'{name}.csv', robot, RECIPE).dataset, position_noise=3e-4)
    for name in ('train', 'val')
)
forgets = add_effect(train, EFFECTS).robot
remembers = add_effect(train, (*EFFECTS, MEMORY)).robot
models = [('as described', robot), ('that forgets', forgets), ('that remembers', remembers)]
comparison = compare(validation, models)
print(comparison.text())
output.mkdir(parents=True, exist_ok=True)
(output / 'better.yaml').write_text(dump_robot(remembers), encoding='utf-8')
