"""Shapes all over the workspace: where a cold inverse search starts from."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .model import TOLERANCE
from .shape import FIELDS

if TYPE_CHECKING:
    from .model import Model
    from .shape import ShapeBatch

FULL_BEND = 1.5 * np.pi  # [rad] of one section: bends beyond it are rarely wanted


def workspace_library(model: Model) -> ShapeBatch:
    """
    Return shapes under random tensions within the limits; seeded, so always the same.

    Tensions concentrate where a section bends by less than three quarters of a turn, and half of
    the postures leave one of two opposing tendons at its lower limit.
    """
    count = 1024 if model.implicit else 4096
    random = np.random.default_rng(1)
    low, high = model.limits.T
    scale = np.minimum(high, low + _useful(model))
    spread = random.random((count, len(low)))
    spread *= random.random((count, len(low))) < 0.6
    top = np.where(random.random((count, 1)) < 0.25, high, scale)
    inputs = low + spread * (top - low)
    batch, changes = model.solve(inputs)
    good = changes < TOLERANCE
    return replace(batch, **{name: getattr(batch, name)[good] for name in FIELDS})


def _useful(model: Model) -> np.ndarray:
    """Tension (m,) [N] at which an input alone bends its section by `FULL_BEND` (PCCA)."""
    cells, offset = model.arrays.cells, model.arrays.offset
    per_newton = np.linalg.norm(offset, axis=2) / cells[:, 1:2]  # (n, k) [rad/N]
    sections = cells[:, 4].astype(int)
    useful = []
    for members in model.robot.input_tendons:
        rate = max(
            sum(per_newton[sections == s, k].sum() for k in members)
            for s in range(len(model.robot.sections))
        )
        useful.append(FULL_BEND / rate)
    return np.array(useful)
