"""
Machine code that most tests need, made before they run: once, and on two processors.

Tests that begin side by side with an empty cache would each compile the same for themselves. What
is made here: all that a controller, a diagnosis and a search of postures call, and the plants of
simulations and of the mock arm, whose catalogue has a kernel of its own; and the bytecode of the
tests, whose assertions pytest rewrites.
"""

import os
import sys

import processes
import pytest
from source_tree import ROOT

from tendon_robot_ros.control.loading import compiled_mark, load
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.compile import is_compiled
from tendon_robot_ros.model.derivatives import path_near
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import plant_catalogue
from tendon_robot_ros.simulation.plant import make_plant

TENSIONS = [0.1, 0.6, 0.2, 0.3]  # [N]
TURNED = {'rotation_x': 0.01}  # [rad] of the base


def robot():
    return load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')


def compile_model():
    catalogue = load_catalogue()
    load(robot(), catalogue)
    turned = Model(robot().with_effect('base_misalignment', TURNED), catalogue)
    turned.jacobian(TENSIONS)
    shapes = turned.shapes([TENSIONS])
    path_near(turned, shapes.inputs, shapes.state, False)(shapes.inputs)


def compile_plant():
    plant = make_plant(robot(), {'base_misalignment': TURNED})
    plant.model.arrays.link()
    shape = plant.respond(TENSIONS)
    plant.respond_to_pulls(shape.pulls)
    plant.shapes([TENSIONS])


def compile_tests():
    assert pytest.main(['--collect-only', '-qq', str(ROOT / 'test')]) == 0


MADE = {'model': compile_model, 'plant': compile_plant, 'tests': compile_tests}


def compile_all():
    """Compile what is not yet in the cache; a process for each."""
    catalogue = load_catalogue()
    there = {
        'model': compiled_mark(catalogue).is_file(),
        'plant': is_compiled(plant_catalogue(catalogue)),
        'tests': any((ROOT / 'test' / '__pycache__').glob('test_*')),
    }
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get('PYTHONPATH'))))
    at_work = [
        processes.Process(
            [sys.executable, __file__, what],
            cwd=ROOT,
            env={**os.environ, 'PYTHONPATH': path},
            stdout=processes.DEVNULL,
        )
        for what in MADE
        if not there[what]
    ]
    assert not any(process.wait() for process in at_work)


if __name__ == '__main__':
    MADE[sys.argv[1]]()
