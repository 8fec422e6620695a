"""Friction coefficients (section IV.A), rehearsed: the measured slip angles are not printed."""

from __future__ import annotations

import numpy as np

from ..slip import SlipFriction, slip_friction

PUBLISHED = {'2:1': (0.31, 18), '10:1': (0.33, 30)}  # scale: coefficient, measurements
SD = 0.03  # [1] of one measurement: assumed, Table II is lost
READING = 0.1  # [°] of the rotational stage: assumed


def rehearsals(seed: int = 0) -> dict[str, SlipFriction]:
    """Draw slip angles of the published coefficients and evaluate them, scale by scale."""
    found = {}
    for scale, (coefficient, n) in PUBLISHED.items():
        random = np.random.default_rng([seed, n])
        degrees = np.degrees(np.arctan(coefficient + SD * random.normal(size=n)))
        angles = np.radians(np.round(degrees / READING) * READING)
        found[scale] = slip_friction(tuple(map(str, range(1, n + 1))), angles)
    return found
