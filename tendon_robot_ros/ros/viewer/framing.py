"""Where the scene is looked at from, so that all that the arm can reach is in sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ALONG = np.array([0.0, 0.99, -0.14])  # [1] direction of sight: from the side and a little above
# [1] of the height of a phone that viser's panel may cover, at the lower edge: its `max-height`;
# on a desktop the panel is docked beside the scene
PANEL_OF_PHONES = 0.6
PHONE_ASPECT = 0.8  # width over height of a scene, below which it is a phone's


@dataclass(frozen=True)
class View:
    """A camera: where it is, and what is in the middle of its picture, (3,) [m] each."""

    position: Array
    look_at: Array


def framed(radius: float, fov: float, width: float, height: float) -> View:
    """
    Return the nearest view of a ball about the base that the panel does not cover.

    No part of an arm is further from its base than it is long, however it bends: that is the
    radius. The ball touches a side of what is free of the picture from within where its distance
    to the plane through the camera and that side is the radius; two sides that face each other
    say how far away the camera is, and where the ball is between them.

    Parameters
    ----------
    radius : float [m]
    fov : float [rad]
        Between the upper and the lower edge of the picture.
    width, height : float [px]
        Of the picture.

    """
    half = np.tan(0.5 * fov)
    aspect = width / height
    lowest = 2.0 * PANEL_OF_PHONES - 1.0 if aspect < PHONE_ASPECT else -1.0
    sides = half * np.array([[-aspect, aspect], [lowest, 1.0]])  # at depth 1
    margins = radius * np.sqrt(1.0 + sides**2)
    depth = float((margins.sum(axis=1) / (sides[:, 1] - sides[:, 0])).max())
    across = 0.5 * (sides.sum(axis=1) * depth + margins[:, 0] - margins[:, 1])
    along = ALONG / np.linalg.norm(ALONG)
    right = np.cross(along, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, along)
    position = -across[0] * right - across[1] * up - depth * along
    return View(position, position + depth * along)
