"""
From a motion capture's table to the missing effect, cell by cell as in a notebook.

The arm is a nitinol tube with three tendons, lying level; somebody has left a weight at its tip.
Run it from the folder of the project; pictures go to the folder given as the argument, if any.
"""

# %% The arm as it was described with `robot new`, and what its model says
import sys
from pathlib import Path

from tendon_robot_ros import (
    Model,
    add_effect,
    compare,
    diagnose,
    dump_robot,
    import_table,
    load_robot,
    save_dataset,
)

output = Path(sys.argv[1]) if len(sys.argv) > 1 else Path('results/python')
output.mkdir(parents=True, exist_ok=True)
robot = load_robot('data/mocap/arm.yaml')
print(robot)
shape = Model(robot).shape({'tendon_1': 6.0})
print(shape)
shape.plot().figure.savefig(output / 'shape.png')

# %% The table: a turned tracker, y up, mm, gaps, markers in no order, a tendon that slipped once
imported = import_table('data/mocap/raw.csv', robot, {'up': 'y'})
print(imported)
print(imported.text())
imported.plot().savefig(output / 'import.png')
dataset = imported.dataset
print(dataset)

# %% How far is the model off?
comparison = compare(dataset)
print(comparison)
comparison.plot().figure.savefig(output / 'errors.png')
errors = comparison.frame()
print(errors.groupby('marker', sort=False)['error'].mean().round(4).to_dict())

# %% Why?
diagnosis = diagnose(dataset)
print(diagnosis)
diagnosis.plot().figure.savefig(output / 'diagnosis.png')
if not diagnosis.effects:  # nothing is missing, or it cannot be told what: see what it prints
    raise SystemExit('nothing to add')
best = diagnosis.frame().iloc[0]
print(f'{best.effect}: {best.parameter} = {1e3 * best.value / 9.81:.1f} g')

# %% Add it. The frame was found with the wrong model: find it again with the better one
better = add_effect(dataset, diagnosis.effects).robot
again = import_table('data/mocap/raw.csv', better, {'up': 'y'})
print(again)

# %% Judge it by another recording, whose postures were never used
frame = {'rotation': list(again.recipe.frame.rotation), 'shift': list(again.recipe.frame.shift)}
check = import_table('data/mocap/check.csv', better, {'up': 'y', 'frame': frame}).dataset
print(compare(check))

# %% Keep what came out
(output / 'better.yaml').write_text(dump_robot(better), encoding='utf-8')
save_dataset(again.dataset, output / 'data', overwrite=True)
again.dataset.frame().to_csv(output / 'measurements.csv', index=False)
