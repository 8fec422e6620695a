"""Where the tendons run: their offsets in every cell, and how they wind about the axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .description import Robot, Tendon

Floats = NDArray[np.float64]


def tendon_offsets(robot: Robot) -> Floats:
    """Return the offset of every tendon at mid-cell, (n, k, 2) [m], zero beyond its end."""
    offset = np.zeros((robot.cells, len(robot.tendons), 2))
    for k, tendon in enumerate(robot.tendons):
        ends, lengths = _tendon_ends(robot, k)
        if tendon.offsets:
            offset[: len(ends), k] = tendon.offsets
        else:
            offset[: len(ends), k] = _route(tendon, ends - 0.5 * lengths, ends[-1])
    return offset


def helix_angles(robot: Robot) -> Floats:
    """Return the angle by which every tendon winds about the axis in every cell, (n, k) [rad]."""
    angles = np.zeros((robot.cells, len(robot.tendons)))
    for k, tendon in enumerate(robot.tendons):
        ends, lengths = _tendon_ends(robot, k)
        if tendon.offsets:
            angle = np.unwrap(np.arctan2(*np.transpose(tendon.offsets)[::-1]))
            rate = np.gradient(angle, ends - 0.5 * lengths) if len(ends) > 1 else 0.0
            angles[: len(ends), k] = rate * lengths
        else:
            (x0, y0), (x1, y1) = (_route(tendon, at, ends[-1]).T for at in (ends - lengths, ends))
            middle = 0.25 * ((x0 + x1) ** 2 + (y0 + y1) ** 2)
            angles[: len(ends), k] = 2.0 * np.arctan2(x0 * y1 - y0 * x1, 2.0 * middle)
    angles[np.abs(angles) < 1e-12] = 0.0  # what is left of rounding
    return angles


def _tendon_ends(robot: Robot, k: int) -> tuple[Floats, Floats]:
    """Arc lengths at the ends of the cells of a tendon, and the lengths of these cells [m]."""
    lengths = np.concatenate([[s.cell_length] * s.cells for s in robot.sections])
    lengths = lengths[: robot.tendon_cells[k]]
    return np.cumsum(lengths), lengths


def _route(tendon: Tendon, arc_length: Floats, whole: float) -> Floats:
    """Offset (j, 2) [m] of a tendon at arc lengths (j,): a line that turns by its helix."""
    base, end = np.array(tendon.base), np.array(tendon.end)
    x, y = (base + arc_length[:, None] / whole * (end - base)).T
    if tendon.helix == 0.0:
        return np.stack([x, y], axis=1)
    c, s = np.cos(tendon.helix * arc_length), np.sin(tendon.helix * arc_length)
    return np.stack([c * x - s * y, s * x + c * y], axis=1)
