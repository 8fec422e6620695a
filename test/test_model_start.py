"""What a first shape waits for: imports, and code that is compiled once."""

import os
import sys
from collections import namedtuple

import numpy as np
import pytest
from numba import types
from processes import run
from source_tree import ROOT

from tendon_robot_ros.effects import catalogue
from tendon_robot_ros.model.kernel.layout import compiled, contracted, jit
from tendon_robot_ros.model.kernel.linking import EntryCompiler, record_type
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
times = numba.njit(lambda a, b: numpy.dot(numpy.linalg.cholesky(a), b))
assert numpy.allclose(times(numpy.diag([4.0, 9.0]), numpy.array([1.0, 3.0])), [2.0, 9.0])
"""


BESIDE = """
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.compile import compiled_beside, compose
catalogue = load_catalogue()
with compiled_beside(catalogue, ('sweep', 'residual')):
    pass
kernel = compose(catalogue)
kernel('layout').address_of(kernel('sweep').residual)
stats = kernel('sweep').residual.stats
assert sum(stats.cache_hits.values()) == 1 and not stats.cache_misses, stats
assert not kernel('sweep').step.overloads, 'what nobody asked for is not compiled'
"""


WITHOUT_LOADS = """
import numpy
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
model = Model(load_robot('config/robots/spatial_3.yaml'))
model.shape(model.limits[:, 0])
loads = {'loads.load_moments', 'linearisation.load_slopes', 'equilibrium.descend'}
leaning = {'geometry.leaning_travel', 'linearisation.leaning_slopes'}
others = {'equilibrium.march', 'shape.ramped'}
def compiled():
    made = {name: getattr(model.arrays.part(name.split('.')[0]), name.split('.')[1])
            for name in loads | leaning | others}
    return {name for name, function in made.items() if function.overloads}
assert not compiled(), compiled()
model.arrays.act('gravity')
assert compiled() == loads, compiled()
model.arrays.act('torsion')
assert compiled() == loads | leaning, compiled()
"""


def test_what_only_other_effects_call_is_not_compiled_before_they_act():
    made = run([sys.executable, '-c', WITHOUT_LOADS])
    assert made.returncode == 0, made.stderr


def test_a_law_may_hold_what_no_function_of_the_kernel_has():
    def law(x):
        def twice(y):
            return 2.0 * y

        total = 0.0
        for factor in [twice(0.5), 3.0]:
            total += factor * x
        return total

    composed = contracted(law)
    entry = jit(pipeline_class=EntryCompiler)(lambda x: composed(x) + 1.0)
    assert entry(2.0) == 9.0


def test_a_record_is_an_address_and_what_lies_apart_from_it():
    fields = namedtuple('fields', 'first second third fourth')
    kinds = dict.fromkeys(fields._fields, types.int64) | {'second': types.float64}
    _, make = record_type(fields, kinds, ('second', 'third', 'fourth'))
    _, make_plain = record_type(namedtuple('plain', 'first second'), kinds)
    there = np.array([7.0, 2.5])
    there.view(np.int64)[0] = 7

    def seen(at):
        apart, whole = make(at, 4, 5, 6), make_plain(at)
        return apart.first + apart.third, whole.second, apart.at - at

    entry = jit(pipeline_class=EntryCompiler)(seen)
    assert entry(there.ctypes.data) == (12, 2.5, 0)


@pytest.mark.long
def test_what_a_process_compiles_beside_is_taken_from_the_cache(tmp_path):
    made = run(
        [sys.executable, '-c', BESIDE], env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}
    )
    assert made.returncode == 0, made.stderr


@pytest.mark.long
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
    monkeypatch.setattr(catalogue, '_installed', lambda: read.append(True) or ())
    Model(robot, effects)
    assert not read
