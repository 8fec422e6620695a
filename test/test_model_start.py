"""What a first shape waits for: imports, and code that is compiled once."""

import os
import sys

import numpy as np
from processes import run
from source_tree import ROOT

from tendon_robot_ros.effects import catalogue
from tendon_robot_ros.model.kernel.layout import compiled, jit
from tendon_robot_ros.model.kernel.linking import EntryCompiler
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

WITHOUT_SCIPY = """
import sys
import numpy
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
model = Model(load_robot('config/robots/kato_10_1_single.yaml'))
model.shape(model.limits[:, 0])
assert 'scipy.linalg' not in sys.modules
import numba
solve = numba.njit(lambda a, b: numpy.linalg.solve(a, numpy.dot(a, b)))
assert numpy.allclose(solve(numpy.diag([2.0, 4.0]), numpy.array([1.0, 3.0])), [1.0, 3.0])
"""


BESIDE = """
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.compile import compiled_beside, compose
catalogue = load_catalogue()
with compiled_beside(catalogue, 'residual', 'residual'):
    pass
kernel = compose(catalogue)
kernel('layout').address_of(kernel('residual').residual)
stats = kernel('residual').residual.stats
assert sum(stats.cache_hits.values()) == 1 and not stats.cache_misses, stats
assert not kernel('sweep').step.overloads, 'what nobody asked for is not compiled'
"""


def test_what_a_process_compiles_beside_is_taken_from_the_cache(tmp_path):
    made = run(
        [sys.executable, '-c', BESIDE], env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}
    )
    assert made.returncode == 0, made.stderr


def test_a_shape_comes_without_linear_algebra_and_numba_has_it_afterwards():
    made = run([sys.executable, '-c', WITHOUT_SCIPY])
    assert made.returncode == 0, made.stderr


@compiled
def halved(x):
    return 0.5 * x


@compiled
def quartered(x):
    return halved(halved(x))


def test_parts_of_an_entry_are_linked_at_every_depth_and_have_no_machine_code():
    entry = jit(pipeline_class=EntryCompiler)(lambda x: quartered(x) + halved(x))
    assert entry(8.0) == 6.0
    assert entry(np.float32(8.0)) == 6.0
    for part in (halved, quartered):
        for made in part.overloads.values():
            engine = made.library.codegen._engine
            assert not engine.is_symbol_defined(made.fndesc.llvm_func_name)
    (first, *_) = entry.overloads.values()
    assert first.library.get_pointer_to_function(first.fndesc.llvm_func_name)


def test_a_model_is_built_without_reading_what_is_installed(monkeypatch):
    robot = load_robot(ROOT / 'config/robots/spatial_3.yaml')
    effects = catalogue.load_catalogue()
    Model(robot, effects)  # compiles where nothing is
    read = []
    monkeypatch.setattr(catalogue, 'entry_points', lambda **group: read.append(group) or [])
    Model(robot, effects)
    assert not read
