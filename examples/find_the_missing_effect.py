"""
From measurements to the missing effect, cell by cell as in a notebook.

Run it from the folder of the project; pictures go to the folder given as the argument, if any.
"""

# %% A robot, and what its model says
import sys
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

from tendon_robot_ros import (
    Model,
    add_effect,
    compare,
    diagnose,
    dump_robot,
    load_dataset,
    load_robot,
)

output = Path(sys.argv[1]) if len(sys.argv) > 1 else Path('results/python')
output.mkdir(parents=True, exist_ok=True)
robot = load_robot('data/hinge_friction/fit/robot.yaml')
print(robot)
shape = Model(robot).shape({'left': 1.2, 'right': 0.3})
print(shape)
shape.plot().figure.savefig(output / 'shape.png')

# %% The measurements, and how far the model is off
dataset = load_dataset('data/hinge_friction/fit')
print(dataset)
comparison = compare(dataset)
print(comparison)
comparison.plot().figure.savefig(output / 'errors.png')

# %% Why?
found = diagnose(dataset)
print(found)

# %% Add it, and judge it by postures that were never used
addition = add_effect(
    dataset, found.effects[0].name, check=load_dataset('data/hinge_friction/check')
)
print(addition)
(output / 'better.yaml').write_text(dump_robot(addition.robot), encoding='utf-8')
