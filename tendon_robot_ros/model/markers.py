"""Markers anywhere along the arm, with offsets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..exceptions import InputError

if TYPE_CHECKING:
    from .shape import ShapeBatch

Floats = npt.NDArray[np.float64]


def place_markers(shapes: ShapeBatch, arc_length: Floats, offset: Floats) -> Floats:
    """Positions (b, j, 3) [m] of markers; see `ShapeBatch.markers`."""
    ends = np.cumsum(shapes.cell_length)
    if np.any(arc_length > ends[-1] + 1e-9) or np.any(arc_length < 0.0):
        raise InputError(
            f'markers: expected arc lengths from 0 to {ends[-1]:g} m (the tip), '
            f'got {arc_length.max():g} m'
        )
    cells = np.minimum(np.searchsorted(ends + 1e-9, arc_length), len(ends) - 1)
    into = arc_length - (ends - shapes.cell_length)[cells]
    share = np.clip(into / shapes.cell_length[cells], 0.0, 1.0)
    at_end = np.abs(share - 1.0) * shapes.cell_length[cells] < 1e-9
    if at_end.all():
        frames, points = shapes.frames[:, cells], shapes.positions[:, cells]
    else:
        frames, points = _inside(shapes, cells, share)
    placed: Floats = points + np.einsum('bjrc,jc->bjr', frames, offset)
    return placed


def _inside(
    shapes: ShapeBatch, cells: npt.NDArray[np.intp], share: Floats
) -> tuple[Floats, Floats]:
    """Frames (b, j, 3, 3) and points (b, j, 3) at a share of the way through cells."""
    base = np.broadcast_to(np.eye(3), (len(shapes), 1, 3, 3))
    frames = np.concatenate([base, shapes.frames], axis=1)[:, cells]
    points = np.concatenate([np.zeros((len(shapes), 1, 3)), shapes.positions], axis=1)
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)[:, cells]
    points = points[:, cells]
    bend = shapes.bend[:, cells]
    angle = np.linalg.norm(bend, axis=2)
    toward = np.where(
        angle[..., None] > 1e-300, bend / np.maximum(angle, 1e-300)[..., None], [1.0, 0.0]
    )
    hinge = shapes.hinge[cells]
    after = share > 0.5
    turned = angle * np.where(hinge, after, share)
    # the cell's own length now (it may be compressed): chord / chord of a unit cell
    unit = np.where(hinge, np.cos(0.5 * angle), np.sinc(0.5 * angle / np.pi))
    length = step / np.maximum(unit, 1e-12)
    across, along = _point(turned, angle, share, hinge, length)
    local = np.concatenate([toward * across[..., None], along[..., None]], axis=2)
    return (frames @ rotation(toward, turned), points + np.einsum('bjrc,bjc->bjr', frames, local))


def _point(
    turned: Floats, angle: Floats, share: Floats, hinge: npt.NDArray[np.bool_], length: Floats
) -> tuple[Floats, Floats]:
    """Point inside a cell: (towards the bend, along z) [m]."""
    half = np.sinc(0.5 * turned / np.pi)
    arc_across = length * share * half * np.sin(0.5 * turned)
    arc_along = length * share * half * np.cos(0.5 * turned)
    beyond = length * np.maximum(share - 0.5, 0.0)
    hinge_along = length * np.minimum(share, 0.5) + beyond * np.cos(angle)
    return (
        np.where(hinge, beyond * np.sin(angle), arc_across),
        np.where(hinge, hinge_along, arc_along),
    )


def rotation(toward: Floats, angle: Floats) -> Floats:
    """Rotation (..., 3, 3) by an angle [rad] towards a unit vector (..., 2), without twist."""
    x, y = toward[..., 0], toward[..., 1]
    s, v = np.sin(angle), 1.0 - np.cos(angle)
    rows = [
        [1.0 - v * x * x, -v * x * y, s * x],
        [-v * x * y, 1.0 - v * y * y, s * y],
        [-s * x, -s * y, 1.0 - v],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
