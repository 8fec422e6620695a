"""What the model returns: shapes, batches of shapes, and tension solutions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .form import Form

FIELDS = (
    'inputs',
    'bend',
    'tendon_tensions',
    'frames',
    'positions',
    'tendon_pulls',
    'pulls',
)
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ShapeBatch:
    """Shapes of b postures of a robot with n cells, k tendons and m inputs."""

    inputs: Floats  # (b, m) [N]
    bend: Floats  # (b, n, 2) [rad]
    tendon_tensions: Floats  # (b, n, k) [N], 0 beyond a tendon's end
    frames: Floats  # (b, n, 3, 3) at the distal ends of the cells
    positions: Floats  # (b, n, 3) [m] distal ends of the cells
    tendon_pulls: Floats  # (b, k) [m]
    pulls: Floats  # (b, m) [m], mean over the tendons of an input
    cell_length: Floats  # (n,) [m] at rest
    hinge: npt.NDArray[np.bool_]  # (n,)

    def __len__(self) -> int:
        """Count the postures."""
        return len(self.inputs)

    @property
    def tip_position(self) -> Floats:
        """Tip positions (b, 3) [m]."""
        tip: Floats = self.positions[:, -1]
        return tip

    @property
    def tip_direction(self) -> Floats:
        """Approach directions (b, 3): +z of the last frame."""
        along: Floats = self.frames[:, -1, :, 2]
        return along

    def markers(self, arc_length: Floats, offset: Floats) -> Floats:
        """
        Place markers on the shapes.

        Parameters
        ----------
        arc_length : (j,) [m]
            Along the straight backbone; a cell's end belongs to that cell (within 1e-9 m).
        offset : (j, 3) [m]
            In the frame there: arc interpolated, hinge the half before or after.

        Returns
        -------
        (b, j, 3) [m]

        Raises
        ------
        InputError
            A marker lies beyond the tip.

        """
        from .markers import place_markers

        return place_markers(self, np.asarray(arc_length, float), np.asarray(offset, float))


class Shape:
    """One posture: the fields of `ShapeBatch` without the first axis."""

    def __init__(self, form: Form, block: Floats) -> None:
        """Take a block that the kernel filled; its fields are made when they are asked for."""
        self.form, self.block = form, block

    def _field(self, name: str) -> Floats:
        where, shape = self.form.one[name]
        return self.block[where].reshape(shape)

    @cached_property
    def inputs(self) -> Floats:
        """Input tensions (m,) [N]."""
        return self._field('inputs')

    @cached_property
    def bend(self) -> Floats:
        """Bends (n, 2) [rad]."""
        return self._field('bend')

    @cached_property
    def positions(self) -> Floats:
        """Distal ends of the cells (n, 3) [m]."""
        return self._field('positions')

    @cached_property
    def frames(self) -> Floats:
        """Frames at the distal ends of the cells (n, 3, 3)."""
        return self._field('frames')

    @cached_property
    def tendon_tensions(self) -> Floats:
        """Tension of every tendon in every cell (n, k) [N]."""
        return self._field('tendon_tensions')

    @cached_property
    def pulls(self) -> Floats:
        """Wire pulls of the inputs (m,) [m]."""
        return self._field('pulls')

    @cached_property
    def tendon_pulls(self) -> Floats:
        """Wire pulls of the tendons (k,) [m]."""
        return self._field('tendon_pulls')

    @cached_property
    def memory(self) -> Floats:
        """Friction memory after this posture, for the next call."""
        return self.block[self.form.size :]

    @property
    def tip_position(self) -> Floats:
        """Tip position (3,) [m]."""
        tip: Floats = self.positions[-1]
        return tip

    @property
    def tip_direction(self) -> Floats:
        """Approach direction (3,)."""
        along: Floats = self.frames[-1, :, 2]
        return along

    @cached_property
    def batch(self) -> ShapeBatch:
        """The same as a batch of one."""
        return ShapeBatch(
            **{name: getattr(self, name)[None] for name in FIELDS},
            cell_length=self.form.cell_length,
            hinge=self.form.hinge,
        )

    def markers(self, arc_length: Floats, offset: Floats) -> Floats:
        """Place markers (j, 3) [m]; see `ShapeBatch.markers`."""
        placed: Floats = self.batch.markers(arc_length, offset)[0]
        return placed


@dataclass(frozen=True)
class Reach:
    """Tensions for a target, and how near they bring the tip."""

    shape: Shape
    position_error: float  # [m], 0 where no position was asked
    direction_error: float  # [rad], 0 where no direction was asked
    status: str  # 'reached', 'nearest' or 'at_limit'
    at_limit: tuple[str, ...]  # inputs at their upper limit

    @property
    def tensions(self) -> Floats:
        """Input tensions (m,) [N]."""
        return self.shape.inputs

    @property
    def pulls(self) -> Floats:
        """Wire pulls (m,) [m] of that equilibrium."""
        return self.shape.pulls
