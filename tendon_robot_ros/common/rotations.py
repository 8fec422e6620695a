"""Rotations: matrices, rotation vectors, quaternions (x, y, z, w)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .arrays import Floats


def bent(toward: Floats, angle: Floats) -> Floats:
    """Rotation (..., 3, 3) by an angle [rad] towards a unit vector (..., 2), without twist."""
    x, y = toward[..., 0], toward[..., 1]
    s, v = np.sin(angle), 1.0 - np.cos(angle)
    rows = [
        [1.0 - v * x * x, -v * x * y, s * x],
        [-v * x * y, 1.0 - v * y * y, s * y],
        [-s * x, -s * y, 1.0 - v],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def about(axis: int, angle: float) -> Floats:
    """Return the rotation about the x (0), y (1) or z (2) axis."""
    rotation, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    rotation[i, i] = rotation[j, j] = math.cos(angle)
    rotation[j, i] = math.sin(angle)
    rotation[i, j] = -rotation[j, i]
    return rotation


def turned_in_plane(vector: Floats, angle: Floats) -> Floats:
    """Turn vectors (..., 2) by angles (...) [rad] from x to y."""
    x, y, c, s = vector[..., 0], vector[..., 1], np.cos(angle), np.sin(angle)
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def from_rotation_vector(vector: Sequence[float] | Floats) -> Floats:
    """Return the rotation matrix (3, 3) of a rotation vector [rad]; NaN if too large to square."""
    half = 0.5 * np.asarray(vector, dtype=float)
    angle = float(np.linalg.norm(half))
    return from_quaternion((*(np.sinc(angle / np.pi) * half), float(np.cos(angle))))


def towards(direction: Floats) -> Floats:
    """Return the smallest rotation (3, 3) that maps +z to a unit vector."""
    x, y, z = direction
    across = x * x + y * y
    if z < 0.0 and across < 1e-24:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + z) if z >= 0.0 else (1.0 - z) / across  # the same, without cancellation
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])


def rotation_between(direction: Floats, other: Floats) -> Floats:
    """Return a rotation (3, 3) that maps the direction of one vector (3,) to that of another."""
    one, two = (towards(v / np.linalg.norm(v)) for v in (direction, other))
    return np.asarray(two @ one.T)


def angle_between(direction: Floats, other: Floats) -> Floats:
    """Return the angles (...) [rad] between unit vectors (..., 3)."""
    return np.asarray(np.arccos(np.clip((direction * other).sum(axis=-1), -1.0, 1.0)))


def quaternions(rotations: Floats) -> Floats:
    """Return quaternions (n, 4) x, y, z, w of rotation matrices (n, 3, 3)."""
    trace = np.trace(rotations, axis1=1, axis2=2)
    # four times the products of every two components; the largest square is safe to divide by
    products = np.empty((len(rotations), 4, 4))
    products[:, :3, :3] = rotations + rotations.transpose(0, 2, 1)
    products[:, :3, :3] += (1.0 - trace)[:, None, None] * np.eye(3)
    skew = (rotations - rotations.transpose(0, 2, 1))[:, [2, 0, 1], [1, 2, 0]]
    products[:, :3, 3] = products[:, 3, :3] = skew
    products[:, 3, 3] = 1.0 + trace
    largest = np.diagonal(products, axis1=1, axis2=2).argmax(axis=1)
    best = products[np.arange(len(rotations)), largest]
    return best / np.linalg.norm(best, axis=1, keepdims=True)


def from_quaternion(quaternion: Sequence[float] | Floats) -> Floats:
    """Return the rotation matrix (3, 3) of a unit quaternion x, y, z, w."""
    *axis, w = quaternion
    v = np.array(axis)
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)


def rigid_fit(
    points: Floats, onto: Floats, weights: Floats | None = None, axis: Floats | None = None
) -> tuple[Floats, Floats]:
    """
    Return the rotation (3, 3) and the translation (3,) [m] that fit points to others.

    Least squares over weighted (n, 3) [m] pairs: `rotation @ point + shift` (Kabsch 1976). With a
    unit vector `axis` (3,) the rotation is about it.
    """
    middle = np.average(points, axis=0, weights=weights)
    target_middle = np.average(onto, axis=0, weights=weights)
    scaled = points - middle if weights is None else weights[:, None] * (points - middle)
    if axis is not None:
        rotation = rotation_about(axis, scaled, onto - target_middle)
    else:
        u, _, vt = np.linalg.svd(scaled.T @ (onto - target_middle))
        flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
        rotation = vt.T @ flip @ u.T
    return rotation, target_middle - rotation @ middle


def rotation_about(axis: Floats, vectors: Floats, onto: Floats) -> Floats:
    """Return the rotation (3, 3) about a unit vector that fits vectors (n, 3) to others."""
    along = (vectors @ axis) @ (onto @ axis)
    across = float(axis @ np.cross(vectors, onto).sum(axis=0))
    return from_rotation_vector(math.atan2(across, float((vectors * onto).sum() - along)) * axis)


def rotation_angle(rotation: Floats) -> float:
    """Return the angle [rad] of a rotation matrix (3, 3)."""
    return math.acos(min(max((float(np.trace(rotation)) - 1.0) / 2.0, -1.0), 1.0))
