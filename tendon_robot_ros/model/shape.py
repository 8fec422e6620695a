"""What the model returns: shapes, batches of shapes, and tension solutions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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


def _only(rows: Floats) -> Floats:
    row: Floats = rows[0]
    return row


@dataclass(frozen=True)
class Shape:
    """One posture; the fields of `ShapeBatch` without the first axis."""

    batch: ShapeBatch
    memory: Floats  # friction memory after it, for the next call

    @property
    def inputs(self) -> Floats:
        """Input tensions (m,) [N]."""
        return _only(self.batch.inputs)

    @property
    def bend(self) -> Floats:
        """Bends (n, 2) [rad]."""
        return _only(self.batch.bend)

    @property
    def positions(self) -> Floats:
        """Distal ends of the cells (n, 3) [m]."""
        return _only(self.batch.positions)

    @property
    def frames(self) -> Floats:
        """Frames at the distal ends of the cells (n, 3, 3)."""
        return _only(self.batch.frames)

    @property
    def tendon_tensions(self) -> Floats:
        """Tension of every tendon in every cell (n, k) [N]."""
        return _only(self.batch.tendon_tensions)

    @property
    def pulls(self) -> Floats:
        """Wire pulls of the inputs (m,) [m]."""
        return _only(self.batch.pulls)

    @property
    def tendon_pulls(self) -> Floats:
        """Wire pulls of the tendons (k,) [m]."""
        return _only(self.batch.tendon_pulls)

    @property
    def tip_position(self) -> Floats:
        """Tip position (3,) [m]."""
        return _only(self.batch.tip_position)

    @property
    def tip_direction(self) -> Floats:
        """Approach direction (3,)."""
        return _only(self.batch.tip_direction)

    def markers(self, arc_length: Floats, offset: Floats) -> Floats:
        """Place markers (j, 3) [m]; see `ShapeBatch.markers`."""
        return _only(self.batch.markers(arc_length, offset))


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
