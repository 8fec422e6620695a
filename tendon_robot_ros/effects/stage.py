"""
The stages of the model at which effects act: what a law takes there, and what it gives back.

The kernel's generator (`model/compile.py`), the documentation and the tests read this table; the
kernel calls the laws of a stage one after the other, each on what the one before returned.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """What a law takes or gives: a number, or a tuple of so many."""

    name: str
    count: int
    unit: str
    meaning: str

    @property
    def example(self) -> Any:
        """Some value, for a law that is tried: within what a sine, a share or a scale may be."""
        return (0.5,) * self.count if self.count > 1 else 0.5


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


# In the order in which a cell meets them: a stage, and the quantities of its laws, each with unit
# and meaning. `>`: a law gives it back, and first takes it as it is without the law; `-`: a law
# only takes it; `*` behind a stage: the laws use the shape itself; in a quantity: x, y and z;
# `(3)`: a tuple of three numbers.
TABLE = """
actuation
  > tension [N] tension that enters the first cell
offset_scale
  > scale [1] factor on every tendon offset
stiffness
  > stiffness [N·m/rad] bending stiffness of the cell
  - tendons [1] number of tendons in the cell
stiffening
  > factor [1] secant stiffness over initial stiffness
  - bend_squared [rad²] square of the bend beyond the rest bend
rest
  > rest_x [rad] bend of the unloaded cell towards x
  > rest_y [rad] bend of the unloaded cell towards y
tendon_path *
  > travel [m] path that the tendon has lost in the cell
  > along [m] derivative of the travel by the bend, in the bend plane
  > across [1] what multiplies the offset across the bend plane
  - bend [rad] size of the bend
  - sin_half [1] sine of half the bend
  - cos_half [1] cosine of half the bend
  - radial [m] offset in the bend plane
  - length [m] length of the cell
  - hinge [1] 1 where the cell is a hinge, 0 where it is an arc
load *
  > force_* [N] force along *, base frame
  - mass_length [m] mass_profile times the length of the cell
  - gravity_* [m/s²] gravity along *, base frame
tip_load *
  > force_* [N] force along *, base frame
  > moment_* [N·m] moment about *, base frame
push *
  > force(3) [N] force on the end of a cell (x, y, z), base frame
  > moment(3) [N·m] moment there (x, y, z), base frame
  > friction(3) [N] part of the force along a surface (x, y, z); before: that of the posture before
  - place(3) [m] where the cell ends (x, y, z), base frame
  - frame(9) [1] its axes as columns (xx, xy, ... zz), base frame
  - along [m] arc length from the base to there, at rest
  - before [m] length of the cell that ends there
  - behind [m] length of the next cell; infinite at the tip
  - moved(3) [m] how far the end has moved since the posture before (x, y, z)
moment
  > moment [N·m] size of the bending moment
  - total_tension [N] sum of the tensions in the cell
  - radius [m] largest distance of a tendon from the centroid
joint_friction
  > moment [N·m] size of the moment left after friction in the joint
  - total_tension [N] sum of the tensions in the cell
hysteresis
  > moment_x [N·m] moment that the cell holds against its bend, along x
  > moment_y [N·m] the same along y
  - change_x [rad] change of the bend towards x since the posture before
  - change_y [rad] change of the bend towards y
  - stiffness [N·m/rad] bending stiffness of the cell
torsion *
  > twist [rad] turn of the cell about its own axis
  - moment [N·m] moment about that axis
  - stiffness [N·m/rad] bending stiffness of the cell
wrap *
  > turning [1] sine of half the angle that the eyelet turns the tendon
  - mean [1] the same for the mean bend of both neighbouring cells
friction_travel *
  > here [m] travel that decides the friction
  - beyond [m] travel in all cells beyond the eyelet
memory *
  > sign [1] direction of friction, -1 to 1
  - before [1] the direction in the posture before
  - change [m] change of the travel since then
eyelet
  > passed [1] tension behind the eyelet over tension before it
  - turning [1] sine of half the angle that the eyelet turns the tendon
length
  > scale [1] length of the cell over its length at rest
  - total_tension [N] sum of the tensions in the cell
stretch
  > stretch [m] elongation of the tendon in a cell
  - tension [N] tension in the cell
  - length [m] its length
transmission
  > pull [m] commanded pull, less what the transmission loses of it
  - before [m] the same in the posture before
winding
  > pull [m] pull of the wire as it is commanded
  - tension [N] tension that enters the first cell
measurement
  > * [m] * as the tracker sees it
"""


def _stages() -> Iterator[Stage]:
    """Yield the stages of the table."""
    for head, *lines in (block.split('\n  ') for block in re.split(r'\n(?! )', TABLE.strip())):
        each = (
            line.replace('*', axis) for line in lines for axis in ('xyz' if '*' in line else '*')
        )
        pattern = re.compile(r'([>-]) (\w+)(?:\((\d)\))? \[(.+?)\] (.+)')
        rows = [row for line in each if (row := pattern.fullmatch(line))]
        given, taken = (
            tuple(Quantity(r[2], int(r[3] or 1), r[4], r[5]) for r in rows if r[1] == mark)
            for mark in '>-'
        )
        yield Stage(head.removesuffix(' *'), given, taken, head.endswith('*'))


STAGES = {stage.name: stage for stage in _stages()}
