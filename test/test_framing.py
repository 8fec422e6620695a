"""The live page's camera: whatever the arm does, it is in sight beside the panel."""

import numpy as np
import pytest

from tendon_robot_ros.ros.viewer.page import framed

FOV = np.deg2rad(75.0)
# of the scene beside the panel, width and height [px], and what the panel leaves free of it:
# left, right, upper, lower [px]
WINDOWS = {1200: (812, 900, (0, 812, 0, 900)), 400: (400, 900, (0, 400, 0, 360))}


def seen(view, points, width, height):
    """Return where points (n, 3) are in a picture [px], from the left and from above."""
    along = view.look_at - view.position
    along /= np.linalg.norm(along)
    right = np.cross(along, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    off = points - view.position
    scale = 0.5 * height / np.tan(0.5 * FOV) / (off @ along)
    return np.stack(
        [
            0.5 * width + scale * (off @ right),
            0.5 * height - scale * (off @ np.cross(right, along)),
        ],
        axis=1,
    )


def inside(places, free):
    x, y = places.T
    return bool(np.all((x >= free[0]) & (x <= free[1]) & (y >= free[2]) & (y <= free[3])))


@pytest.mark.parametrize('width', WINDOWS)
@pytest.mark.parametrize('length', [0.06, 2.0])
def test_the_ball_in_which_an_arm_moves_fills_what_the_panel_leaves_free(width, length):
    width, height, free = WINDOWS[width]
    points = np.random.default_rng(0).normal(size=(20000, 3))
    points *= length / np.linalg.norm(points, axis=1)[:, None]
    places = seen(framed(length, FOV, width / height), points, width, height)
    assert inside(places, free)
    share = np.ptp(places, axis=0) / [free[1] - free[0], free[3] - free[2]]
    assert share.max() > 0.97, 'no nearer view holds it'
