"""
What the compiled functions pass to each other, addresses of arrays; vectors and small equations.

Numba counts references to arrays at every call, which costs more than the physics here; an
address costs nothing. Whoever calls an entry keeps the arrays alive until it returns.

Names that mean the same in every function, and are explained only once: `chain` a Chain, `work` a
Work, `past` the Memory of the posture before, `solver` a Workspace; `i` a cell, `k` a tendon, `j`
an input; u (in shapes) the entries of a state that count. "Address" is that of the first float of
an array, row-major.
"""

import math
from collections import namedtuple
from functools import partial
from time import CLOCK_MONOTONIC
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import intrinsic, register_jitable

from tendon_robot_ros.model.compile import BEND_TOLERANCE as BEND_TOLERANCE
from tendon_robot_ros.model.compile import GAP_ACCEPTED_M as GAP_ACCEPTED_M
from tendon_robot_ros.model.compile import LEAST_TENSION_N as LEAST_TENSION_N
from tendon_robot_ros.model.compile import MODULES
from tendon_robot_ros.model.compile import PARTS as PARTS

from .linking import EntryCompiler, PartCompiler, record_type

jit: Any = partial(njit, error_model='numpy', nogil=True, no_cfunc_wrapper=True)
part: Any = partial(jit, no_cpython_wrapper=True, pipeline_class=PartCompiler)
compiled = part()
inlined = part(forceinline=True)
# with fused multiply-add: where no difference of equal products has to be exactly zero
fused = part(forceinline=True, fastmath={'contract'})
# the same, inlined only where LLVM wants to
contracted = part(fastmath={'contract'})
# sums in any order: where they only say in which direction a search goes
reordered = part(fastmath={'contract', 'reassoc'})
# comparisons of what is no NaN
numeric = part(fastmath={'nnan', 'nsz'})


def entry(signature=None):
    """
    Decorate a function that Python calls: it is compiled and cached at its first call.

    A function with a signature, its own or one of `CALLED`, is called by its address, and compiled
    when `address_of` is called.
    """

    def make(function):
        dispatcher = jit(cache=True, pipeline_class=EntryCompiler)(function)
        dispatcher.called_as = signature or CALLED.get(function.__name__)
        return dispatcher

    return make


YES, NO = np.bool_(True), np.bool_(False)
ZERO = np.int64(0)  # [1] typed, because numba compiles a function anew for every literal
NONE = ~ZERO  # no index, -1

# Chain: the robot and its effects; n cells, k tendons, m inputs; addresses of
#   cells   (n, 7)    CELL_COLUMNS, SI
#   offset  (n, k, 2) tendon offsets [m]
#   tendon  (k, 2)    int: cells that the tendon runs through, index of its input
#   values  (rows, wide) effect parameters of each cell, or of each tendon;
#   on      (effects,) uint8, which effects act
#   gravity (3,)      [m/s²], base frame
#   helix   (n, k)    angle [rad] by which a tendon winds about the axis in a cell; 0: none does
# beside: whether weight lies beside the axis (1) or none does (0).
# radius: largest distance of a tendon from the centroid [m]
# step and all behind it: addresses of these functions, 0 where nothing acts that calls them
CHAIN_DATA = 'n k m wide cells offset tendon values on gravity radius helix beside'.split()
Chain = namedtuple('Chain', [*CHAIN_DATA, 'step', *MODULES])  # type: ignore[misc]
# Length [m], bending stiffness [N·m/rad], mass profile times length [m], whether it is a hinge
# (1), number of tendons in it, where its weight lies beside the axis [m].
CELL_COLUMNS = 'LENGTH STIFFNESS MASS HINGE PRESENT MASS_X MASS_Y'.split()
COLUMNS = len(CELL_COLUMNS)
LENGTH, STIFFNESS, MASS, HINGE, PRESENT, MASS_X, MASS_Y = range(COLUMNS)

# The state of a posture: bends (n, 2) [rad], and behind them twists (n,) [rad], which count only
# where cells twist; `bend` and `bends` are addresses of states.

# Memory: what the arm remembers of the last posture: its state (3n,) [rad], of friction sign
# (n, k) and travel (n, k) [m], inputs (m,) [N], moment (n, 2) [N·m] held against the bend, held
# (n, 6): friction [N] of a surface on the ends of the cells, and how far these are [m] from those
# of the straight arm, passed (k,) [m], the pulls that passed the transmission; one array.
Memory = namedtuple('Memory', 'bend sign travel inputs moment held passed')

# Work: scratch of one posture. half (n, 2): half angles, see `cells`; wrench (n, 6): force [N]
# and torque [N·m] at the cells' ends of the loads beyond; lag (2, n, k): by how much the travel
# [m] of the bends exceeds that of the eyelets in `solve_sliding`, here and beyond, else zeros;
# settings: SETTINGS below. axial (n, k): moment arms of the tendons about the axis [m]; torque
# (n,): of the loads [N·m]; compliance (n,): of a cell in bending [rad/(N·m)], from `work_in` on;
# passed (n,): tension behind an eyelet over that before it. push (n, 6): force [N] and
# moment [N·m] on the ends of the cells of what acts at a place; held (n, 6): that of the memory.
Work = namedtuple(
    'Work',
    'moment_arms travel beyond load lengths tensions frames origins half wrench lag settings '
    'axial torque compliance passed push held',
)
# Smoothing length of friction [m]; factor on the loads [1]; whether a sweep follows the guess (1)
# or goes as if no effect needed the shape (0); whether every method for an equilibrium is tried
# (1) or the quick ones (0); whether an unstable equilibrium is left for a stable one (1).
SETTINGS = 'SMOOTHING LOAD_SCALE SHAPED EVERY_METHOD STABLE'.split()
SETTINGS_SIZE = len(SETTINGS)
SMOOTHING, LOAD_SCALE, SHAPED, EVERY_METHOD, STABLE = range(SETTINGS_SIZE)

# Workspace of a search: scratch, memory before and after, the state kept and that of a trial
# (3n,), one more (3n,) as scratch, wire pulls of the tendons (k,) and of the inputs (m,).
Workspace = namedtuple('Workspace', 'work past now bend near before pulls means')

# numba takes types of one name for one type, but each catalogue has a kernel of its own
for _kind in (Chain, Memory, Work, Workspace):
    _kind.__name__ += '_' + __name__.partition('.')[0].rpartition('_')[2]

EPSILON = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)  # divisor instead of 0
# [m] travel over which the sign of friction is smooth, so that Newton meets no jump; docs/model.md
SMOOTHING_LENGTH = 2e-6
# [1] of a size of about one: a central difference errs by the square of its step and by EPSILON
# over it, and would be worse with any other
DIFFERENCE_STEP = math.cbrt(EPSILON)
# [rad] of a bend, over which slopes are those of a guess, because the eyelets' turning and the
# sides to which tendons slide change beyond
LINEAR_STEP_RAD = 0.2
# [1] of the smoothing length, travel of a tendon whose direction of friction no step changes: tanh
# is 1 - 2e-7, so that what it lags does not count
CLEAR_TRAVEL = 8.0
SLIPPING_FROM = math.tanh(CLEAR_TRAVEL)  # direction of friction of a tendon that slips
# [1] difference of a direction of friction that counts as none, because a tension is then off by
# less than 1 % of the friction at an eyelet
SAME_SIGN = 1e-2
# [rad] change of a bend that counts as none, because it moves the tip by less than 1 nm
SETTLED_RAD = 1e-6
# [1] of SMOOTHING_LENGTH where a search begins without a guess: 2 mm, so that every tendon slides
WIDE_SMOOTHING = 1e3
# [1] steps of Newton, because its error is squared at each, and trials of one step, each shorter,
# because the last would gain less than 1e-3 of what is to gain
STEPS_MAX = np.int64(12)

WORD, FLOAT = types.int64, types.float64
CHAIN_KINDS: dict[str, Any] = dict.fromkeys(Chain._fields, WORD) | {'radius': FLOAT}
CHAIN, chain_at = record_type(Chain, CHAIN_KINDS)
WORK_FIELDS = len(Work._fields)
APART = ('tensions', 'frames', 'origins')  # of Work, may lie elsewhere
WORK, work_from = record_type(Work, dict.fromkeys(Work._fields, WORD), APART)
MEMORY = types.NamedUniTuple(WORD, len(Memory._fields), Memory)
# Functions that are called by their address, a field of Chain. Numba optimises a function together
# with all that it calls, again at every level: with these calls the kernel compiles several times
# faster and runs as fast.
CALLED = {
    **dict.fromkeys(
        ('step', 'prepare', 'balance', 'residual'),
        types.void(CHAIN, WORD, WORD, WORK, MEMORY, WORD),
    ),
    **dict.fromkeys(
        ('place_travel', 'load_moments', 'bow_cells', 'pushes'),
        types.void(CHAIN, WORD, WORK),
    ),
    'respond': WORD(CHAIN, WORD, WORD, WORD, WORK, MEMORY, WORD, WORD),
    'solve_equilibrium': FLOAT(CHAIN, WORD, WORK, MEMORY, WORD),
    **dict.fromkeys(('newton', 'march'), FLOAT(CHAIN, WORD, WORD, WORK, MEMORY)),
    'load_slopes': types.void(CHAIN, WORD, WORK, WORD, WORD, FLOAT),
    'descend': types.void(CHAIN, WORD, WORD, WORK, MEMORY, FLOAT),
    'push_slopes': types.void(CHAIN, WORD, WORK, WORD, WORD),
    'leaning_travel': types.void(CHAIN, WORD, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, WORK),
    'leaning_slopes': types.void(CHAIN, WORK, WORD, FLOAT, FLOAT, FLOAT, FLOAT, WORD),
    'remembered': FLOAT(CHAIN, FLOAT, FLOAT, WORD),
    'ramped': FLOAT(CHAIN, WORD, WORK, MEMORY, MEMORY, WORD, WORD, WORD),
}
CHAIN_KINDS |= {name: types.FunctionType(signature) for name, signature in CALLED.items()}


def _pointer_to(item):
    kind = types.CPointer(item)

    @intrinsic
    def pointer(typing_context, address):
        def generate(context, builder, _, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(kind))

        return kind(address), generate

    return pointer


floats = _pointer_to(types.float64)
words = _pointer_to(types.int64)
flags = _pointer_to(types.uint8)
clock_gettime: Any = types.ExternalFunction('clock_gettime', types.int32(types.int32, WORD))


def address_of(function):
    """Compile an entry that has a signature, if that is not yet done; return its address."""
    if not function.overloads:
        function.compile(function.called_as)
    (compiled_entry,) = function.overloads.values()
    return compiled_entry.library.get_pointer_to_function(compiled_entry.fndesc.llvm_func_name)


@register_jitable
def memory_size(n, k, m):
    """Floats that the memory of a posture takes."""
    return 11 * n + 2 * n * k + m + k


@register_jitable
def work_sizes(n, k):
    """Floats that the arrays of Work take, in their order."""
    wires, joints = n * k, n + 1
    before = (2 * wires, wires, wires, 2 * n, n, wires, 9 * joints, 3 * joints, 2 * n)
    return before + (6 * n, 2 * wires, SETTINGS_SIZE, wires, n, n, n, 6 * n, 6 * n)


@register_jitable
def work_size(n, k):
    """Floats that the scratch of one posture takes: addresses, and what lies there."""
    total = WORK_FIELDS
    for size in work_sizes(n, k):
        total += size
    return total


def lay_out_work(n, k, scratch):
    """Write into a scratch of zeros, at its beginning, where the arrays of Work are."""
    at = scratch.ctypes.data + 8 * WORK_FIELDS
    for place, size in enumerate(work_sizes(n, k)):
        scratch.view(np.int64)[place] = at
        at += 8 * size


@compiled
def address(array):
    """Address of an array; the caller keeps the array alive."""
    return np.int64(array.ctypes.data)


@compiled
def copy(source, target, count):
    """Copy floats between addresses (numba's own slices bring the text of their errors along)."""
    old, new = floats(source), floats(target)
    for j in range(count):
        new[j] = old[j]


@compiled
def monotonic():
    """Time [s] of Python's `time.monotonic`, for searches that end by a time."""
    now = np.empty(2, np.int64)
    clock_gettime(CLOCK_MONOTONIC, address(now))
    seconds = now[0] + 1e-9 * now[1]
    keep(now)
    return seconds


@compiled
def keep(*arrays):
    """Hold arrays up to here whose addresses are in use: numba drops what is mentioned no more."""


@compiled
def memory_in(chain, start):
    """Memory in an array of `memory_size` floats; all zero is straight and slack."""
    n, k = chain.n, chain.k
    sign = start + 8 * 3 * n
    travel = sign + 8 * n * k
    inputs = travel + 8 * n * k
    moment = inputs + 8 * chain.m
    held = moment + 16 * n
    return Memory(start, sign, travel, inputs, moment, held, held + 48 * n)


@compiled
def exchange(chain, acting, starts, places, values, v):
    """
    Exchange which effects act, and entries of a chain's arrays, with those of variant v of it.

    Done twice, all is as before. `acting` (variants, effects) uint8; the entries of v are those
    from starts[v] to starts[v + 1] of `places` (addresses) and `values`.
    """
    on = flags(chain.on)
    for e in range(acting.shape[1]):
        on[e], acting[v, e] = acting[v, e], on[e]
    for r in range(starts[v], starts[v + 1]):
        entry_at = floats(places[r])
        entry_at[0], values[r] = values[r], entry_at[0]


@compiled
def cell(chain, i, column):
    """One column of cell i."""
    return floats(chain.cells)[COLUMNS * i + column]


@compiled
def assign(target, source):
    """Copy a vector into another of its length."""
    for j in range(target.shape[0]):
        target[j] = source[j]


@reordered
def dot(a, b):
    """Inner product."""
    total = 0.0
    for j in range(a.shape[0]):
        total += a[j] * b[j]
    return total


@numeric
def peak(values):
    """Largest absolute entry, none of which is NaN."""
    top = 0.0
    for j in range(values.shape[0]):
        size = abs(values[j])
        top = size if size > top else top
    return top


@compiled
def largest(values):
    """Largest absolute entry; infinite where they are, or NaN, or beyond all use."""
    if not dot(values, values) <= 1e12:
        return math.inf
    return peak(values)


@compiled
def solve_small(a, b, size):
    """Solve a x = b in place for a small positive definite a (size, size) by Cholesky."""
    for j in range(size):
        for i in range(j):
            a[j, j] -= a[j, i] * a[j, i]
        a[j, j] = math.sqrt(max(a[j, j], TINY))
        for r in range(j + 1, size):
            for i in range(j):
                a[r, j] -= a[r, i] * a[j, i]
            a[r, j] /= a[j, j]
    for j in range(size):
        for i in range(j):
            b[j] -= a[j, i] * b[i]
        b[j] /= a[j, j]
    for j in range(size - 1, -1, -1):
        for i in range(j + 1, size):
            b[j] -= a[i, j] * b[i]
        b[j] /= a[j, j]


@inlined
def add_row(target, factor, source, begin, width):
    """Add a multiple of one row to another, from a column on."""
    into, row = floats(target), floats(source)
    for j in range(begin, width):
        into[j] += factor * row[j]


@compiled
def swap(first, second, count):
    """Exchange floats at two addresses."""
    a, b = floats(first), floats(second)
    for j in range(count):
        a[j], b[j] = b[j], a[j]


@compiled
def solve_rows(matrix, sides, size, width):
    """
    Solve a x = b in place by LU; False where singular.

    Addresses: `matrix` of a (size, size), `sides` of b (size, width).
    """
    for c in range(size):
        top, pivot = abs(floats(matrix)[size * c + c]), c
        for r in range(c + 1, size):
            if abs(floats(matrix)[size * r + c]) > top:
                top, pivot = abs(floats(matrix)[size * r + c]), r
        if not TINY < top < math.inf:
            return False
        row, side = matrix + 8 * size * c, sides + 8 * width * c
        if pivot != c:
            swap(row, matrix + 8 * size * pivot, size)
            swap(side, sides + 8 * width * pivot, width)
        for r in range(c + 1, size):
            factor = -floats(matrix)[size * r + c] / floats(row)[c]
            add_row(matrix + 8 * size * r, factor, row, c + 1, size)
            add_row(sides + 8 * width * r, factor, side, ZERO, width)
    for r in range(size - 1, -1, -1):
        row, side = floats(matrix + 8 * size * r), sides + 8 * width * r
        for c in range(r + 1, size):
            add_row(side, -row[c], sides + 8 * width * c, ZERO, width)
        for j in range(width):
            floats(side)[j] /= row[r]
    return True
