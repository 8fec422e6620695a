"""
Which bend, and so which moment, a model lacks where, in every posture: what the pictures show.

Bends differenced from positions are imprecise, so that cells are taken together in blocks, and
the bend that each block lacks is fitted to all markers at once: d p / d theta = axis x (p - pivot)
for every marker beyond a cell. To first order; a diagnosis does not rest on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..common.arrays import Floats
from ..comparison.compare import bending_axes, equilibria
from ..comparison.result import Measured
from ..data import DataSet
from ..effects import Catalogue
from ..inference.crossval import predict
from ..inference.imperfections import BEND_MAX_RAD
from ..model.shape import ShapeBatch
from ..robot import Robot
from .placed import in_base_frame

BLOCKS_PER_SECTION = 3  # [1] because bends of single cells drown in the noise of markers
BEND_MIN = 1e-3  # [rad] of a cell, else rounding would be its direction


@dataclass(frozen=True, eq=False)
class MissingMoment:
    """Missing bend and moment in P postures and B blocks of cells; nan where undetermined."""

    blocks: tuple[str, ...]  # (B,) 'cells 1 to 5'
    bend: Floats  # (P, B) [rad] per cell that is missing; positive: the arm bends more
    moment: Floats  # (P, B) [N·m] that would bend the described cells as much
    moment_sd: Floats  # (P, B) [N·m]
    total_tension: Floats  # (P, B) [N] sum of the tendons in the block
    tension_difference: Floats  # (P, B) [N] net moment of the tendons over the arm
    model_bend: Floats  # (P, B) [rad] per cell
    lever: Floats  # (P, B) [m] from the block to the tip
    deviation: Floats  # (P, J) sideways, measured minus model, in noise sd; positive: bends more


def missing_moment(
    dataset: DataSet, robot: Robot, measured: Measured, catalogue: Catalogue
) -> MissingMoment | None:
    """
    Return the moments that a robot description lacks; None where the noise is not known.

    Parameters
    ----------
    dataset : DataSet
    robot : Robot
        The description.
    measured : Measured
        Of a comparison with that data set.
    catalogue : Catalogue

    """
    if measured.floor is None:
        return None
    predictor, markers = predict(dataset, robot, catalogue)
    shapes = equilibria(predictor)
    arm = _Arm(shapes, dataset)
    edges = blocks_of(robot, len(dataset.markers))
    below = robot.plate_cells
    sd = np.sqrt(measured.floor / 3.0)
    missed = in_base_frame(predictor, measured.mean - markers)
    fits = [arm.fit(p, missed[p], sd[p], edges) for p in range(len(sd))]
    bend, spread = np.array(fits).swapaxes(0, 1)
    spread = np.where(spread < BEND_MAX_RAD, spread, np.nan)
    bend = np.where(np.isfinite(spread), bend, np.nan)
    cells = predictor.model.arrays.cells
    stiffness = _means(cells[None, :, 1], edges)
    offsets = predictor.model.arrays.offset
    return MissingMoment(
        blocks=tuple(
            f'cell {b - below}' if b - a == 1 else f'cells {a - below + 1} to {b - below}'
            for a, b in edges
        ),
        bend=bend,
        moment=stiffness * bend,
        moment_sd=stiffness * spread,
        total_tension=_means(shapes.tendon_tensions.sum(axis=2), edges),
        tension_difference=_means(arm.net_tension(offsets), edges),
        model_bend=_means(arm.along(shapes.bend), edges),
        lever=_means(np.linalg.norm(shapes.positions[:, -1:] - arm.pivots, axis=2), edges),
        deviation=np.array([arm.sideways(p, off) for p, off in enumerate(missed)]) / sd,
    )


def blocks_of(robot: Robot, markers: int) -> list[tuple[int, int]]:
    """
    Divide every section into blocks (first cell, end) that the markers can tell apart.

    A base plate, which does not bend, is in none.
    """
    parts = max(1, min(BLOCKS_PER_SECTION, markers // max(len(robot.own_sections), 1)))
    edges, start = list[tuple[int, int]](), 0
    for section in robot.sections:
        if not section.is_plate:
            cuts = np.linspace(start, start + section.cells, min(parts, section.cells) + 1)
            edges += pairwise(cuts.round().astype(int).tolist())
        start += section.cells
    return edges


class _Arm:
    """Pivots and bending directions of predicted shapes."""

    def __init__(self, shapes: ShapeBatch, dataset: DataSet) -> None:
        self.shapes = shapes
        b, n = len(shapes), shapes.bend.shape[1]
        ends = np.concatenate([np.zeros((b, 1, 3)), shapes.positions], axis=1)
        before = np.concatenate([np.broadcast_to(np.eye(3), (b, 1, 3, 3)), shapes.frames], axis=1)
        self.frames = before[:, :n]  # (b, n, 3, 3) at the proximal ends
        half = 0.5 * shapes.cell_length[:, None]
        self.pivots = ends[:, :-1] + half * self.frames[..., 2]  # (b, n, 3) [m]
        self.middle = np.cumsum(shapes.cell_length) - 0.5 * shapes.cell_length
        self.arc_lengths = dataset.arc_lengths
        self.markers = shapes.markers(dataset.arc_lengths, dataset.offsets)
        self.axes = self._axes()
        # (b, n, 2): z x u is the axis
        self.towards = np.stack([self.axes[..., 1], -self.axes[..., 0]], axis=-1)

    def _axes(self) -> Floats:
        """Axis (b, n, 3) of every cell's bend in its own frame; of the posture where straight."""
        bend, frames = self.shapes.bend, self.frames
        size = np.linalg.norm(bend, axis=2, keepdims=True)
        own = np.stack([-bend[..., 1], bend[..., 0], np.zeros_like(bend[..., 0])], axis=-1)
        whole = bending_axes(self.shapes.positions)  # (b, 3); the posture bends by more than 0
        total = np.einsum('bnrc,bnc->br', frames, own)
        whole = whole * np.where((whole * total).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
        axis = np.einsum('bnrc,br->bnc', frames, whole)
        axis[..., 2] = 0.0
        axis /= np.maximum(np.linalg.norm(axis, axis=2, keepdims=True), 1e-12)
        own = own / np.maximum(size, 1e-300)
        against = np.sign((own * axis).sum(axis=2, keepdims=True))
        return np.asarray(np.where(size > BEND_MIN, own * np.where(against < 0, -1.0, 1.0), axis))

    def fit(
        self, p: int, residual: Floats, sd: Floats, edges: list[tuple[int, int]]
    ) -> tuple[Floats, Floats]:
        """Fit the bend (B,) [rad] per cell that a posture lacks, and its sd."""
        axes = np.einsum('nrc,nc->nr', self.frames[p], self.axes[p])
        arms = self.markers[p][None] - self.pivots[p][:, None]  # (n, J, 3)
        moves = np.cross(axes[:, None], arms) * (
            self.arc_lengths[None, :, None] > self.middle[:, None, None]
        )
        visible = np.isfinite(residual).all(axis=1)
        columns = [(moves[a:b].sum(axis=0) / sd[:, None])[visible].ravel() for a, b in edges]
        slopes = np.array(columns).T
        normal = slopes.T @ slopes + np.eye(len(edges)) * 1e-9
        covariance = np.linalg.inv(normal)
        white = (residual / sd[:, None])[visible].ravel()
        return covariance @ (slopes.T @ white), np.sqrt(np.diag(covariance))

    def along(self, vectors: Floats) -> Floats:
        """Part (b, n) of vectors (b, n, 2) in the direction in which the posture bends."""
        return np.asarray((vectors * self.towards).sum(axis=2))

    def net_tension(self, offsets: Floats) -> Floats:
        """Net moment of the tendons over their largest offset (b, n) [N]."""
        moments = np.einsum('bnk,nkc->bnc', self.shapes.tendon_tensions, offsets)
        return self.along(moments) / float(np.abs(offsets).max())

    def sideways(self, p: int, residual: Floats) -> Floats:
        """Deviation (J,) [m] of the markers towards the bend."""
        cells = np.searchsorted(self.middle, self.arc_lengths) - 1
        cells = cells.clip(0, len(self.middle) - 1)
        axes = np.einsum('jrc,jc->jr', self.frames[p][cells], self.axes[p][cells])
        tangents = self.shapes.frames[p][cells][..., 2]
        return np.asarray((residual * np.cross(axes, tangents)).sum(axis=1))


def _means(values: Floats, edges: list[tuple[int, int]]) -> Floats:
    """Means (P, B) over the cells of blocks; values (P, n)."""
    return np.stack([values[:, a:b].mean(axis=1) for a, b in edges], axis=1)
