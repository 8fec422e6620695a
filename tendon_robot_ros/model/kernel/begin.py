"""The beginning of everything that Python asks for: scratch laid out, with what stays the same."""

from .bending import cell_stiffness
from .layout import (
    LENGTH,
    SLIP_LENGTH,
    Workspace,
    address,
    cell,
    compiled,
    floats,
    memory_in,
    memory_size,
    section_of,
    words,
    work_from,
    work_size,
)
from .loads import force_at_tip, weight
from .turning import is_general


@compiled
def work_in(chain, start):
    """Scratch of a posture at an address, laid out by `lay_out_work`; ready for a new search."""
    at = words(start)
    work = work_from(start, at[5], at[6], at[7])
    slip = floats(work.slip)
    slip[0], slip[1], slip[2], slip[3] = SLIP_LENGTH, 1.0, 1.0, 1.0
    for r in range(3):
        floats(work.frames)[4 * r] = 1.0
    note_cells(chain, work)
    return work


@compiled
def note_cells(chain, work):
    """Fill work with what it holds of cells and loads that no search changes."""
    slip, flat = floats(work.slip), not is_general(chain) and force_at_tip(chain)[1] == 0.0
    for i in range(chain.n):
        floats(work.lengths)[i] = cell(chain, i, LENGTH)
        floats(work.compliance)[i] = 1.0 / cell_stiffness(chain, i, section_of(chain, i))
        flat = flat and weight(chain, i)[1] == 0.0
    slip[4] = 1.0 if flat else 0.0


@compiled
def workspace(chain, bends, past, scratch):
    """Lay out what a search needs; `bends` (2, 3n) and `past` are kept alive outside."""
    n, k = chain.n, chain.k
    now = memory_in(chain, scratch + 8 * work_size(n, k))
    before = now.bend + 8 * memory_size(n, k, chain.m)
    pulls, bend = before + 24 * n, address(bends)
    then = memory_in(chain, address(past))
    work = work_in(chain, scratch)
    return Workspace(work, then, now, bend, bend + 24 * n, before, pulls, pulls + 8 * k)
