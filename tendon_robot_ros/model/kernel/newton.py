"""Newton on the bends, for shapes that repeated sweeps do not settle."""

import math

import numpy as np

from .layout import address, compiled, step_at

TOLERANCE = 1e-10  # [rad] largest change of a bend at which a shape counts as settled
DIFFERENCE = 3e-10  # [rad] step of the Jacobian


@compiled
def largest(values):
    """Largest absolute entry; NaN counts as infinite."""
    top = 0.0
    for value in values:
        if not abs(value) <= 1e6:
            return math.inf
        top = max(top, abs(value))
    return top


@compiled
def solve_small(a, b, size):
    """Solve a x = b in place for a small positive definite a (size, size) by Cholesky."""
    for j in range(size):
        for i in range(j):
            a[j, j] -= a[j, i] * a[j, i]
        a[j, j] = math.sqrt(max(a[j, j], 1e-300))
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


@compiled
def dot(a, b):
    """Inner product."""
    total = 0.0
    for j in range(a.shape[0]):
        total += a[j] * b[j]
    return total


@compiled
def residual(chain, inputs, x, work, past, f):
    """f (2n,) = x - sweep(x) [rad]; return its largest entry."""
    step_at(chain.step)(chain, inputs, address(x), work, past, address(f))
    for j in range(x.shape[0]):
        f[j] = x[j] - f[j]
    return largest(f)


@compiled
def is_planar(chain, x):
    """Tell whether nothing bends the arm across x: half the unknowns are then zero."""
    for j in range(1, x.shape[0], 2):
        if x[j] != 0.0:
            return False
    return True


@compiled
def slopes(chain, inputs, x, f, work, past, stride, moved):
    """
    Jacobian (q, q) of the residual at x over the unknowns 0, stride, ...

    By differences so small that a tendon about to slip (2e-6 m) still counts as smooth.
    """
    count = x.shape[0] // stride
    jacobian = np.empty((count, count))
    for c in range(count):
        keep = x[c * stride]
        x[c * stride] = keep + DIFFERENCE
        h = x[c * stride] - keep
        residual(chain, inputs, x, work, past, moved)
        x[c * stride] = keep
        for r in range(count):
            jacobian[r, c] = (moved[r * stride] - f[r * stride]) / h
    return jacobian


@compiled
def invert(a):
    """Inverse (q, q) by Gauss-Jordan with row pivots; NaN in [0, 0] where there is none."""
    count = a.shape[0]
    b = np.eye(count)
    for c in range(count):
        pivot = c
        for r in range(c + 1, count):
            if abs(a[r, c]) > abs(a[pivot, c]):
                pivot = r
        if not 1e-30 < abs(a[pivot, c]) < 1e30:
            b[0, 0] = math.nan
            return b
        for k in range(count):
            a[c, k], a[pivot, k] = a[pivot, k], a[c, k]
            b[c, k], b[pivot, k] = b[pivot, k], b[c, k]
        scale = 1.0 / a[c, c]
        for k in range(count):
            a[c, k] *= scale
            b[c, k] *= scale
        for r in range(count):
            share = a[r, c]
            if r != c and share != 0.0:
                for k in range(count):
                    a[r, k] -= share * a[c, k]
                    b[r, k] -= share * b[c, k]
    return b


@compiled
def newton_step(chain, inputs, x, f, inverse, stride, work, past, trial, trial_f, halvings):
    """Step x along -inverse f with a line search; return the largest residual, or -1."""
    count = inverse.shape[0]
    move = np.zeros(count)
    for r in range(count):
        for c in range(count):
            move[r] += inverse[r, c] * f[c * stride]
    before = dot(f, f)
    share = min(1.0, 1.0 / max(largest(move), 1e-300))
    for _ in range(halvings):
        trial[:] = x
        for j in range(count):
            trial[j * stride] -= share * move[j]
        change = residual(chain, inputs, trial, work, past, trial_f)
        if dot(trial_f, trial_f) < (1.0 - 1e-4 * share) * before or change < TOLERANCE:
            x[:] = trial
            f[:] = trial_f
            return change
        share *= 0.5
    return -1.0


@compiled
def newton(chain, inputs, x, work, past, most):
    """
    Newton on the bends x (2n,) with a line search; return the last residual [rad].

    A Jacobian serves as long as its steps shrink the residual fivefold.
    """
    size = x.shape[0]
    f, trial_f, trial = np.empty(size), np.empty(size), np.empty(size)
    change = residual(chain, inputs, x, work, past, f)
    stride = 2 if is_planar(chain, x) and is_planar(chain, f) else 1
    inverse = np.empty((0, 0))
    fresh, old = False, False
    for _ in range(most):
        if change < TOLERANCE or change == math.inf:
            return change
        if not old:
            inverse = invert(slopes(chain, inputs, x, f, work, past, stride, trial_f))
            if math.isnan(inverse[0, 0]):
                return change
        fresh = not old
        new = newton_step(
            chain, inputs, x, f, inverse, stride, work, past, trial, trial_f, 12 if fresh else 1
        )
        if new < 0.0:
            if fresh:
                return change
            old = False
            continue
        old = new < 0.2 * change
        change = new
    return change
