"""Laws that a plant has and the catalogue has not; each may differ from cell to cell."""

from __future__ import annotations

import math
from dataclasses import replace

from ..effects import Catalogue, Effect, Parameter


def capstan(passed, turning, friction_coefficient, wraps, exponential):  # type: ignore[no-untyped-def]
    """
    Tension behind an eyelet over tension before it, exp(-mu wrap) (Euler, Eytelwein).

    The wrap is `wraps` times the angle that this cell turns the tendon; `exponential` 0: the
    paper's (1 - b) / (1 + b) at that angle.
    """
    half = wraps * math.asin(min(turning, 1.0))
    if exponential != 0.0:
        return passed * math.exp(-2.0 * friction_coefficient * half)
    b = friction_coefficient * math.sin(half)
    return passed * (1.0 - b) / (1.0 + b)


def side_force(  # type: ignore[no-untyped-def]
    x, y, z, mass_length, gravity_x, gravity_y, gravity_z, side_x, side_y, side_z
):
    """Add a force to the middle of the cell, base frame."""
    return x + side_x, y + side_y, z + side_z


def _unbounded(effect: Effect) -> Effect:
    """Finer cells have other values, each its own: a third of a bend, nine times a cube."""
    wide = tuple(
        replace(p, low=-math.inf, high=math.inf, per_section=True) for p in effect.parameters
    )
    return replace(effect, parameters=wide)


def plant_catalogue(catalogue: Catalogue) -> Catalogue:
    """Return the catalogue with the capstan for tendon friction, and with a force per cell."""
    friction = replace(
        catalogue['tendon_friction'],
        law=capstan,
        parameters=(
            *catalogue['tendon_friction'].parameters,
            Parameter('wraps', '1', 0.0, math.inf, 1.0, typical=1.0, per_section=True),
            Parameter('exponential', '1', 0.0, 1.0, 0.0, typical=1.0),
        ),
    )
    sides = tuple(
        Parameter(f'side_{axis}', 'N', -math.inf, math.inf, 0.0, typical=1e-2, per_section=True)
        for axis in 'xyz'
    )
    side = Effect('side_force', 'a force on one cell', 'load', sides, side_force)
    effects = [_unbounded(effect) for effect in catalogue if effect.name != 'tendon_friction']
    return Catalogue([friction, *effects, side], catalogue.files, catalogue.is_sized)


def elastic_slip(sign, before, change, presliding_length):  # type: ignore[no-untyped-def]
    """
    Direction of friction after a change of travel: a spring up to where it slips (Prandtl 1928).

    Unlike Dahl's law it is straight up to a sharp end; the spring is as long as Dahl's is wide.
    """
    return min(max(before + change / presliding_length, -1.0), 1.0)


def with_elastic_slip(catalogue: Catalogue) -> Catalogue:
    """Return the catalogue with another law for what friction remembers."""
    memory = replace(catalogue['friction_memory'], law=elastic_slip)
    effects = [memory if e.name == memory.name else e for e in catalogue]
    return Catalogue(effects, catalogue.files, catalogue.is_sized)
