"""Vectors, matrices and small linear equations."""

import math

from .layout import compiled, floats, numeric, reordered


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
        if not 1e-30 < top < 1e30:
            return False
        at, side = floats(matrix + 8 * size * c), floats(sides + 8 * width * c)
        if pivot != c:
            other, other_side = (
                floats(matrix + 8 * size * pivot),
                floats(sides + 8 * width * pivot),
            )
            for j in range(size):
                at[j], other[j] = other[j], at[j]
            for j in range(width):
                side[j], other_side[j] = other_side[j], side[j]
        for r in range(c + 1, size):
            row, row_side = floats(matrix + 8 * size * r), floats(sides + 8 * width * r)
            share = row[c] / at[c]
            if share != 0.0:
                for j in range(c + 1, size):
                    row[j] -= share * at[j]
                for j in range(width):
                    row_side[j] -= share * side[j]
    for r in range(size - 1, -1, -1):
        row, row_side = floats(matrix + 8 * size * r), floats(sides + 8 * width * r)
        for c in range(r + 1, size):
            side = floats(sides + 8 * width * c)
            for j in range(width):
                row_side[j] -= row[c] * side[j]
        scale = 1.0 / row[r]
        for j in range(width):
            row_side[j] *= scale
    return True
