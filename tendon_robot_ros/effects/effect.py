"""What a physical effect is: a name, its parameters, and one scalar law for one stage."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..exceptions import EffectError

# Stage -> (what the law takes before its parameters, what it returns). The kernel calls the laws
# of a stage one after the other, each on what the one before returned.
STAGES: dict[str, tuple[str, str]] = {
    'actuation': ('tension', 'tension that enters the first cell [N]'),
    'offset': ('scale', 'factor on every tendon offset [1]'),
    'stiffness': ('stiffness, tendons', 'bending stiffness of the cell [N·m/rad]'),
    'growth': ('factor, bend_squared', 'secant stiffness over initial stiffness [1]'),
    'rest': ('rest_x, rest_y', '(x, y) bend of the unloaded cell [rad]'),
    'arm': (
        'travel, along, across, bend, sin_half, cos_half, radial, length, hinge',
        '(travel [m], along [m], across [1]): path lost in a cell, its derivative by the '
        'bend, and what multiplies the offset across the bend plane',
    ),
    'load': (
        'force_x, force_y, force_z, mass_length, gravity_x, gravity_y, gravity_z',
        '(x, y, z) force at mid-cell, base frame [N]; mass_length = mass_profile L [m]',
    ),
    'tip_load': ('force_x, force_y, force_z', '(x, y, z) force at the tip, base frame [N]'),
    'moment': ('moment, total_tension, radius', 'size of the bending moment [N·m]'),
    'hold': ('moment, total_tension', 'size of the moment left after friction in the joint [N·m]'),
    'wrap': ('turning, mean', 'sine of half the angle that the tendon turns at the eyelet [1]'),
    'slide': ('here, beyond', 'which travel decides the friction: of this cell or all beyond'),
    'memory': ('sign, before, change', 'direction of friction, -1 to 1; change of travel [m]'),
    'eyelet': ('passed, turning', 'tension behind the eyelet over tension before it [1]'),
    'length': ('scale, total_tension', 'length of the cell over its length at rest [1]'),
    'stretch': ('stretch, tension, length', 'elongation of the tendon in a cell [m]'),
    'measurement': ('x, y, z', '(x, y, z) as the tracker sees it [m]'),
}
# Stages whose laws use the shape itself: one sweep is then not the answer.
IMPLICIT_STAGES = ('arm', 'load', 'tip_load', 'wrap', 'slide', 'memory')


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; `typical` is a size that matters, used to scale and start fits."""

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    typical: float
    per_section: bool = False


@dataclass(frozen=True)
class Effect:
    """
    A physical effect.

    Attributes
    ----------
    name : str
        As in a robot description.
    title : str
        The physics in a few words.
    stage : str
        A key of `STAGES`.
    parameters : tuple of Parameter
    law : callable
        Scalars in (the stage's, then the parameters), scalars out; uses `math` only.
    acts_on : str, optional
        The effect that this one shapes, and without which it does nothing.
    always_on : bool
        Whether it acts even at its neutral value once it is listed.

    """

    name: str
    title: str
    stage: str
    parameters: tuple[Parameter, ...]
    law: Callable[..., Any]
    acts_on: str | None = None
    always_on: bool = False
    digest: str = field(default='', compare=False)

    def __post_init__(self) -> None:
        """
        Refuse what the kernel could not call.

        Raises
        ------
        EffectError
            Unknown stage, wrong number of arguments, or bounds that exclude the neutral value.

        """
        if self.stage not in STAGES:
            raise EffectError(
                f'effect {self.name}: expected a stage of {", ".join(STAGES)}, got {self.stage!r}'
            )
        takes = len(inspect.signature(self.law).parameters)
        wanted = STAGES[self.stage][0].count(',') + 1 + len(self.parameters)
        if takes != wanted:
            raise EffectError(
                f'effect {self.name}: its law takes {takes} arguments, expected {wanted}: '
                f'{STAGES[self.stage][0]}, then {", ".join(p.name for p in self.parameters)}'
            )
        for parameter in self.parameters:
            if not parameter.low <= parameter.neutral <= parameter.high:
                raise EffectError(
                    f'effect {self.name}: {parameter.name}: expected low <= neutral '
                    f'<= high, got {parameter}'
                )
        source = inspect.getsourcefile(self.law)
        with open(source or '', 'rb') as file:
            object.__setattr__(self, 'digest', hashlib.sha256(file.read()).hexdigest()[:16])
