"""Newton on bends and twists, for shapes that repeated sweeps do not settle."""

import math

import numpy as np

from .layout import (
    BEND_TOLERANCE,
    NEWTON,
    address,
    compiled,
    entry,
    floats,
    residual_at,
    respond_at,
)
from .linear import dot, largest
from .turning import unknowns


@compiled
def residual(chain, inputs, bend, work, past, f):
    """Fill f [rad], `residual.residual` at the state; return its largest entry."""
    residual_at(chain.residual)(chain, inputs, bend, work, past, address(f))
    return largest(f)


@compiled
def newton_step(chain, inputs, bend, f, move, work, past, trial, trial_f, halvings):
    """
    Step the state by `move` (u,) with a line search; return the largest residual, or -1.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    bend : address
        State [rad]; moves on where the step is taken.
    f : ndarray, shape (u,)
        Residual there [rad]; becomes that after the step.
    move : ndarray, shape (u,)
        Newton's step [rad].
    trial, trial_f : ndarray, shape (u,)
        Scratch.
    halvings : int
        How often the step is halved before it is given up.

    """
    before, x = dot(f, f), floats(bend)
    share = min(1.0, 1.0 / max(largest(move), 1e-300))
    for _ in range(halvings):
        for j in range(f.shape[0]):
            trial[j] = x[j] + share * move[j]
        change = residual(chain, inputs, address(trial), work, past, trial_f)
        if dot(trial_f, trial_f) < (1.0 - 1e-4 * share) * before or change < BEND_TOLERANCE:
            for j in range(f.shape[0]):
                x[j], f[j] = trial[j], trial_f[j]
            return change
        share *= 0.5
    return -1.0


@entry(NEWTON)
def newton(chain, inputs, bend, work, past, most):
    """
    Newton on the state with a line search; return the last residual [rad].

    Parameters
    ----------
    inputs, bend : address
        (m,) [N]; state [rad], guess and result.
    most : int
        Steps.

    """
    size = unknowns(chain)
    f, trial_f = np.empty(size), np.empty(size)
    trial, move = np.empty(size), np.empty(size)
    change = residual(chain, inputs, bend, work, past, f)
    for _ in range(most):
        if change < BEND_TOLERANCE or change == math.inf:
            return change
        respond_at(chain.respond)(chain, bend, address(f), 1, work, past, address(move), 0)
        if not largest(move) < math.inf:
            return change
        new = newton_step(chain, inputs, bend, f, move, work, past, trial, trial_f, 12)
        if new < 0.0:
            return change
        change = new
    return change
