"""
The stages of the model at which effects act: what a law takes there, and what it gives back.

The kernel's generator (`model/compile.py`), the documentation and the tests read this table; the
kernel calls the laws of a stage one after the other, each on what the one before returned.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A scalar that a law takes or gives."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Stage:
    """
    A place in the model where laws act.

    Attributes
    ----------
    name : str
        As in `Effect.stage`.
    outputs : tuple of Quantity
        What a law gives back; it takes the same quantities as they are without it, first.
    context : tuple of Quantity
        What it takes besides, before its own parameters.
    implicit : bool
        Whether its laws use the shape itself, so that one sweep is not the answer.

    """

    name: str
    outputs: tuple[Quantity, ...]
    context: tuple[Quantity, ...] = ()
    implicit: bool = False

    @property
    def inputs(self) -> tuple[Quantity, ...]:
        """What a law takes before its parameters, in this order."""
        return self.outputs + self.context


def _quantities(*rows: tuple[str, str, str]) -> tuple[Quantity, ...]:
    return tuple(Quantity(*row) for row in rows)


TOTAL_TENSION = ('total_tension', 'N', 'sum of the tensions in the cell')
FORCE = _quantities(*((f'force_{axis}', 'N', f'force along {axis}, base frame') for axis in 'xyz'))

# in the order in which a cell meets them
_ALL = (
    Stage(
        'actuation',
        _quantities(('tension', 'N', 'tension that enters the first cell')),
    ),
    Stage(
        'offset_scale',
        _quantities(('scale', '1', 'factor on every tendon offset')),
    ),
    Stage(
        'stiffness',
        _quantities(('stiffness', 'N·m/rad', 'bending stiffness of the cell')),
        _quantities(('tendons', '1', 'number of tendons in the cell')),
    ),
    Stage(
        'stiffening',
        _quantities(('factor', '1', 'secant stiffness over initial stiffness')),
        _quantities(('bend_squared', 'rad²', 'square of the bend beyond the rest bend')),
    ),
    Stage(
        'rest',
        _quantities(
            ('rest_x', 'rad', 'bend of the unloaded cell towards x'),
            ('rest_y', 'rad', 'bend of the unloaded cell towards y'),
        ),
    ),
    Stage(
        'tendon_path',
        _quantities(
            ('travel', 'm', 'path that the tendon has lost in the cell'),
            ('along', 'm', 'derivative of the travel by the bend, in the bend plane'),
            ('across', '1', 'what multiplies the offset across the bend plane'),
        ),
        _quantities(
            ('bend', 'rad', 'size of the bend'),
            ('sin_half', '1', 'sine of half the bend'),
            ('cos_half', '1', 'cosine of half the bend'),
            ('radial', 'm', 'offset in the bend plane'),
            ('length', 'm', 'length of the cell'),
            ('hinge', '1', '1 where the cell is a hinge, 0 where it is an arc'),
        ),
        implicit=True,
    ),
    Stage(
        'load',
        FORCE,
        _quantities(
            ('mass_length', 'm', 'mass_profile times the length of the cell'),
            *((f'gravity_{axis}', 'm/s²', f'gravity along {axis}, base frame') for axis in 'xyz'),
        ),
        implicit=True,
    ),
    Stage('tip_load', FORCE, implicit=True),
    Stage(
        'moment',
        _quantities(('moment', 'N·m', 'size of the bending moment')),
        _quantities(
            TOTAL_TENSION, ('radius', 'm', 'largest distance of a tendon from the centroid')
        ),
    ),
    Stage(
        'joint_friction',
        _quantities(('moment', 'N·m', 'size of the moment left after friction in the joint')),
        _quantities(TOTAL_TENSION),
    ),
    Stage(
        'torsion',
        _quantities(('twist', 'rad', 'turn of the cell about its own axis')),
        _quantities(
            ('moment', 'N·m', 'moment about that axis'),
            ('stiffness', 'N·m/rad', 'bending stiffness of the cell'),
        ),
        implicit=True,
    ),
    Stage(
        'wrap',
        _quantities(('turning', '1', 'sine of half the angle that the eyelet turns the tendon')),
        _quantities(('mean', '1', 'the same for the mean bend of both neighbouring cells')),
        implicit=True,
    ),
    Stage(
        'friction_travel',
        _quantities(('here', 'm', 'travel that decides the friction')),
        _quantities(('beyond', 'm', 'travel in all cells beyond the eyelet')),
        implicit=True,
    ),
    Stage(
        'memory',
        _quantities(('sign', '1', 'direction of friction, -1 to 1')),
        _quantities(
            ('before', '1', 'the direction in the posture before'),
            ('change', 'm', 'change of the travel since then'),
        ),
        implicit=True,
    ),
    Stage(
        'eyelet',
        _quantities(('passed', '1', 'tension behind the eyelet over tension before it')),
        _quantities(('turning', '1', 'sine of half the angle that the eyelet turns the tendon')),
    ),
    Stage(
        'length',
        _quantities(('scale', '1', 'length of the cell over its length at rest')),
        _quantities(TOTAL_TENSION),
    ),
    Stage(
        'stretch',
        _quantities(('stretch', 'm', 'elongation of the tendon in a cell')),
        _quantities(('tension', 'N', 'tension in the cell'), ('length', 'm', 'its length')),
    ),
    Stage(
        'winding',
        _quantities(('pull', 'm', 'pull of the wire as it is commanded')),
        _quantities(('tension', 'N', 'tension that enters the first cell')),
    ),
    Stage(
        'measurement',
        _quantities(*((axis, 'm', f'{axis} as the tracker sees it') for axis in 'xyz')),
    ),
)
STAGES = {stage.name: stage for stage in _ALL}
