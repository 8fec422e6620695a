"""Derivatives of the model by central differences of the settled equilibrium."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from .model import Model

Floats = npt.NDArray[np.float64]
TENSION_STEP = 1e-5  # [N]


def tip_jacobian(model: Model, tensions: Floats) -> Floats:
    """
    Return d (tip position, tip direction) / d tensions, (6, m) [m/N], [1/N].

    Central differences, each side settled from the same equilibrium; one-sided at zero tension.
    """
    m = len(tensions)
    up, down = np.tile(tensions, (m, 1)), np.tile(tensions, (m, 1))
    up[np.arange(m), np.arange(m)] += TENSION_STEP
    down[np.arange(m), np.arange(m)] -= np.minimum(TENSION_STEP, tensions)
    here = model.shape(tensions)
    both = model.shapes(np.concatenate([up, down]), np.tile(here.bend, (2 * m, 1, 1)))
    tips = np.concatenate([both.tip_position, both.tip_direction], axis=1)
    widths = (up - down).sum(axis=1)
    slopes: Floats = (tips[:m] - tips[m:]) / widths[:, None]
    return slopes.T
