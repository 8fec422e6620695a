"""An arm as a tube around its centreline, as a mesh of triangles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
SIDES = 12  # of the tube's cross-section


def tube_faces(nodes: int) -> NDArray[np.uint32]:
    """Return the triangles (2 SIDES (nodes - 1), 3) between the rings around so many nodes."""
    ring, side = np.meshgrid(np.arange(nodes - 1), np.arange(SIDES), indexing='ij')
    a = ring * SIDES + side
    b = ring * SIDES + (side + 1) % SIDES
    quads = np.stack([a, b, b + SIDES, a, b + SIDES, a + SIDES], axis=-1)
    return quads.reshape(-1, 3).astype(np.uint32)


def tube_vertices(nodes: NDArray[np.float64], radius: float) -> Floats:
    """
    Return rings (n SIDES, 3) of a radius around nodes (n, 3), n > 1, all in the same unit.

    The rings do not turn against each other: each begins where the one before points, squared.
    """
    along = np.gradient(nodes, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    start = np.eye(3)[np.abs(along[0]).argmin()]
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    across = np.empty(nodes.shape)
    for i, axis in enumerate(along):
        start = start - axis * (start @ axis)
        start = start / max(math.sqrt(start @ start), 1e-12)
        across[i] = start
    up = np.cross(along, across)
    circles = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * up[:, None]
    return np.asarray(nodes[:, None] + radius * circles, dtype=np.float32).reshape(-1, 3)
