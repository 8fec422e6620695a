"""Vectors, matrices and small linear equations."""

import math

from .layout import compiled


@compiled
def assign(target, source):
    """Copy a vector into another of its length."""
    for j in range(target.shape[0]):
        target[j] = source[j]


@compiled
def fill(target, value):
    """Set all entries of a matrix."""
    for r in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[r, j] = value


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
def dot(a, b):
    """Inner product."""
    total = 0.0
    for j in range(a.shape[0]):
        total += a[j] * b[j]
    return total


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
def solve_rows(a, b, size):
    """Solve a x = b in place, a (size, size), b (size, ...), by LU; False where singular."""
    width = b.shape[1]
    for c in range(size):
        pivot = c
        for r in range(c + 1, size):
            if abs(a[r, c]) > abs(a[pivot, c]):
                pivot = r
        if not 1e-30 < abs(a[pivot, c]) < 1e30:
            return False
        if pivot != c:
            for j in range(size):
                a[c, j], a[pivot, j] = a[pivot, j], a[c, j]
            for j in range(width):
                b[c, j], b[pivot, j] = b[pivot, j], b[c, j]
        for r in range(c + 1, size):
            share = a[r, c] / a[c, c]
            if share != 0.0:
                for j in range(c + 1, size):
                    a[r, j] -= share * a[c, j]
                for j in range(width):
                    b[r, j] -= share * b[c, j]
    for r in range(size - 1, -1, -1):
        for c in range(r + 1, size):
            for j in range(width):
                b[r, j] -= a[r, c] * b[c, j]
        scale = 1.0 / a[r, r]
        for j in range(width):
            b[r, j] *= scale
    return True
