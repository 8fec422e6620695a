"""
How far loaded cells are from the rod that they stand for.

A cell bends in an arc. Under a force across it the curvature of a rod changes along the cell, and
its end gives way further: by L² F / (12 K), with the cell's length L [m], its stiffness K
[N·m/rad], and F [N] what pulls across it there. Along an arm of n cells and length A that adds up
to F A³ / (12 n² E I): of second order, but the same in every trial, and in the mean of many
readings it looks like a little weight.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..model.arrays import KernelArrays
from ..model.shape import ShapeBatch
from .predict import Point, Predictor

Floats = npt.NDArray[np.float64]


def cell_errors(predictor: Predictor, point: Point) -> Floats:
    """
    Return by how much the markers (P, J, 3) [m] of a rod are further off than those of its cells.

    Zero where no load acts, for hinges, and where a posture has no equilibrium.
    """
    dataset = predictor.dataset
    errors = np.zeros((len(predictor.inputs), len(dataset.markers), 3))
    for part, shapes in predictor.settle(point, predictor.inputs, near=predictor.settled):
        forces = _forces_beyond(predictor.model.arrays)
        if shapes is None or not forces.any():
            continue
        rows = predictor.last_visits(part)
        errors[part.rows] = _along(predictor, shapes, forces)[rows]
    return errors


def _along(predictor: Predictor, shapes: ShapeBatch, forces: Floats) -> Floats:
    """Return how much further the markers (b, J, 3) [m] of shapes lie under forces (n, 3) [N]."""
    cells = predictor.model.arrays.cells
    length, stiffness, arc = cells[:, 0], cells[:, 1], cells[:, 3] < 0.5
    ends = shapes.frames[..., 2]  # (b, n, 3), tangents
    begins = np.concatenate([np.broadcast_to([0.0, 0.0, 1.0], ends[:, :1].shape), ends[:, :-1]], 1)
    middle = begins + ends
    middle /= np.linalg.norm(middle, axis=2, keepdims=True)
    across = forces - (forces * middle).sum(axis=2, keepdims=True) * middle
    steps = (np.where(arc, length**2 / (12.0 * stiffness), 0.0))[:, None] * across
    total = np.concatenate([np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)], axis=1)
    along = np.append(0.0, np.cumsum(length))
    after = np.clip(np.searchsorted(along, predictor.dataset.arc_lengths), 1, len(length))
    share = (predictor.dataset.arc_lengths - along[after - 1]) / length[after - 1]
    return np.asarray(total[:, after - 1] + share[:, None] * steps[:, after - 1])


def _forces_beyond(arrays: KernelArrays) -> Floats:
    """Return the force (n, 3) [N] of all loads beyond the middle of every cell."""
    weights = np.array(
        [
            _through(arrays, 'load', int(cell[4]), (cell[2], *arrays.gravity))
            for cell in arrays.cells.tolist()
        ]
    )
    beyond = np.cumsum(weights[::-1], axis=0)[::-1] - 0.5 * weights
    return np.asarray(beyond + _through(arrays, 'tip_load', 0, ()))


def _through(
    arrays: KernelArrays, stage: str, column: int, context: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the force (3,) [N] that the effects of a stage make, one after the other."""
    force: tuple[float, ...] = (0.0, 0.0, 0.0)
    for effect in arrays.catalogue:
        if effect.stage == stage and arrays.on[arrays.layout.index[effect.name]]:
            own = [arrays.get(effect.name, p.name, column) for p in effect.parameters]
            force = effect.law(*force, *context, *own)
    return force
