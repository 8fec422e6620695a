"""Derivatives of the equilibrium, by differences of settled equilibria."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from .model import Model

Floats = npt.NDArray[np.float64]
TENSION_STEP = 3e-6  # [N]
PARAMETER_STEP = 1e-4  # [1], of the parameter or of its typical size


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


def parameter_derivative(
    model: Model, tensions: Floats, effect: str, parameter: str, section: int | None = None
) -> Floats:
    """
    Return d measured positions / d parameter, (b, n, 3) [m per unit], at tensions (b, m) [N].

    Central differences, one-sided where a bound is near; an effect that is off counts as on at its
    neutral value. `section` None moves the parameter of all sections together.
    """
    arrays = model.arrays
    (told,) = (p for p in model.catalogue[effect].parameters if p.name == parameter)
    values, on = arrays.values.copy(), arrays.on.copy()
    here = arrays.get(effect, parameter, section)
    step = PARAMETER_STEP * max(abs(here), told.typical)
    up, down = min(here + step, told.high), max(here - step, told.low)
    guesses = model.shapes(tensions).bend
    try:
        sides = []
        for value in (up, down):
            arrays.set(effect, parameter, section, value)
            sides.append(model.measured(model.shapes(tensions, guesses).positions))
    finally:
        arrays.values[:], arrays.on[:] = values, on
    slopes: Floats = (sides[0] - sides[1]) / (up - down)
    return slopes
