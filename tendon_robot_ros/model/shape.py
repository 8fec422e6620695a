"""What the model returns: shapes, batches of shapes, their pictures, and tensions for a target."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.arrays import RESOLUTION, Floats
from ..common.colours import ERROR, MEASURED, line_style
from ..common.errors import InputError
from ..common.results import TextResult, make_frame, picture_axes
from ..common.rotations import bent, turned_in_plane

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EPSILON, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class ResultLayout:
    """
    Sizes of a robot's results: n cells, k tendons, m inputs.

    A block of b postures holds one field after the other, each (b, ...), in the order of
    `fields`, which is the kernel's (`postures`); that of a single posture also a friction memory.
    """

    n: int
    k: int
    m: int
    memory: int  # floats that the friction memory takes
    cell_length: Floats  # (n,) [m] at rest
    hinge: npt.NDArray[np.bool_]  # (n,)

    @cached_property
    def fields(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of the fields of one posture."""
        n, k, m = self.n, self.k, self.m
        return {
            'inputs': (m,),
            'state': (3 * n,),
            'tendon_tensions': (n, k),
            'frames': (n, 3, 3),
            'positions': (n, 3),
            'tendon_pulls': (k,),
            'pulls': (m,),
            'change': (),
        }

    @cached_property
    def size(self) -> int:
        """Floats of one posture without the memory."""
        return sum(map(math.prod, self.fields.values()))

    @cached_property
    def one(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Slice and shape of each field of a single posture."""
        ends = list(accumulate(map(math.prod, self.fields.values()), initial=0))
        places = zip(pairwise(ends), self.fields.items(), strict=True)
        return {name: (slice(*ends), shape) for ends, (name, shape) in places}

    def filled(self, inputs: Floats, states: Floats) -> tuple[Floats, ShapeBatch, Floats]:
        """
        Return a block that begins with inputs (b, m) [N] and states (b, 3n) [rad].

        Behind it what the kernel makes of it: the shapes, and the last changes (b,) [rad].
        """
        count = len(inputs)
        block = np.empty(count * self.size)
        fields: dict[str, Any] = {
            name: block[count * where.start : count * where.stop].reshape(count, *shape)
            for name, (where, shape) in self.one.items()
        }
        fields['inputs'][:], fields['state'][:] = inputs, states
        changes: Floats = fields.pop('change')
        batch = ShapeBatch(**fields, cell_length=self.cell_length, hinge=self.hinge)
        return block, batch, changes


# [1] of the arm's extent, from the x-z plane: an arm farther off is drawn in space, because a
# picture of 500 pixels would hide more than five of them
FLATNESS = 0.01


@lru_cache(maxsize=64)
def marker_cells(
    cell_lengths: bytes, arc_lengths: bytes
) -> tuple[npt.NDArray[np.intp], Floats, bool]:
    """Cells (j,) that arc lengths lie in, the fraction of each before them, and if all are 1."""
    lengths, along = np.frombuffer(cell_lengths), np.frombuffer(arc_lengths)
    ends = np.cumsum(lengths)
    outside = along[~((along >= 0.0) & (along <= ends[-1] + RESOLUTION))]
    if outside.size:
        raise InputError(
            f'markers: expected arc lengths from 0 to {ends[-1]:g} m (the tip), '
            f'got {outside[0]:g} m'
        )
    cells = np.minimum(np.searchsorted(ends + RESOLUTION, along), len(ends) - 1)
    fraction = np.clip((along - (ends - lengths)[cells]) / lengths[cells], 0.0, 1.0)
    from_end = np.abs(fraction - 1.0) * lengths[cells]
    return cells, fraction, bool((from_end < RESOLUTION).all())


def frames_inside(
    shapes: ShapeBatch, cells: npt.NDArray[np.intp], fraction: Floats, turned: bool
) -> tuple[Floats, Floats]:
    """Frames (b, j, 3, 3), if `turned` as they turn with the cell, and points (b, j, 3) inside."""
    points = np.zeros((len(shapes), shapes.positions.shape[1] + 1, 3))
    frames = np.empty((*points.shape, 3))
    points[:, 1:], frames[:, 0], frames[:, 1:] = shapes.positions, np.eye(3), shapes.frames
    chord = np.diff(points, axis=1)[:, cells]
    points, frames, bend = points[:, cells], frames[:, cells], shapes.bend[:, cells]
    angle = np.sqrt(np.square(bend).sum(axis=2))
    toward = np.where(
        angle[..., None] > TINY, bend / np.maximum(angle, TINY)[..., None], [1.0, 0.0]
    )
    hinge = shapes.hinge[cells]
    rotation = angle * np.where(hinge, fraction > 0.5, fraction)
    twist = shapes.twist[:, cells]
    toward = turned_in_plane(toward, 0.5 * twist)  # half of it lies before the bend
    chord = (frames.swapaxes(2, 3) @ chord[..., None])[..., 0]
    sine, cosine = np.sin(0.5 * angle)[..., None], np.cos(0.5 * angle)[..., None]
    middle = np.concatenate([toward * sine, cosine], axis=2)  # the tangent there
    step = (chord * middle).sum(axis=2)
    # the cell's own length now (it may be compressed): chord / chord of a unit cell
    unit = np.where(hinge, np.cos(0.5 * angle), np.sinc(0.5 * angle / np.pi))
    length = step / np.maximum(unit, EPSILON)
    arc, beyond = np.sinc(0.5 * rotation / np.pi), length * np.maximum(fraction - 0.5, 0.0)
    before = length * np.minimum(fraction, 0.5)
    across = np.where(
        hinge, beyond * np.sin(angle), length * fraction * arc * np.sin(0.5 * rotation)
    )
    along = np.where(
        hinge, before + beyond * np.cos(angle), length * fraction * arc * np.cos(0.5 * rotation)
    )
    local = np.concatenate([toward * across[..., None], along[..., None]], axis=2)
    # a loaded cell bows (kernel/loads.py): curvature that is linear along it
    local += (fraction**2 * (3.0 - 2.0 * fraction))[..., None] * (chord - step[..., None] * middle)
    points += (frames @ local[..., None])[..., 0]
    if turned:
        frames = frames @ bent(toward, rotation)
        frames[..., :2] = turned_in_plane(frames[..., :2], -(fraction * twist)[..., None])
    return frames, points


FIELDS = 'inputs', 'state', 'tendon_tensions', 'frames', 'positions', 'tendon_pulls', 'pulls'


class Bent:
    """Bends, twists and tip of one shape, or of a batch of shapes (b, ...)."""

    state: Floats
    positions: Floats
    frames: Floats

    @property
    def bend(self) -> Floats:
        """Bends (..., n, 2) [rad]."""
        state, n = self.state, self.state.shape[-1] // 3
        return state[..., : 2 * n].reshape(*state.shape[:-1], n, 2)

    @property
    def twist(self) -> Floats:
        """Twists (..., n) [rad] about the cells' own axis; zero without `torsion`."""
        twists: Floats = self.state[..., 2 * (self.state.shape[-1] // 3) :]
        return twists

    @property
    def tip_position(self) -> Floats:
        """Tip position (..., 3) [m]."""
        tip: Floats = self.positions[..., -1, :]
        return tip

    @property
    def tip_direction(self) -> Floats:
        """Approach direction (..., 3): +z of the last frame."""
        along: Floats = self.frames[..., -1, :, 2]
        return along

    @property
    def tip(self) -> Floats:
        """Tip position [m] and, behind it, approach direction (..., 6)."""
        return np.concatenate([self.tip_position, self.tip_direction], axis=-1)


@dataclass(frozen=True)
class WireSlopes:
    """Derivatives of b postures by the tensions; searches of springs begin with them."""

    pulls: Floats  # (b, m, m) [m/N], NaN where they are not known
    states: Floats  # (b, m, u) [rad/N]

    def of(self, rows: npt.NDArray[np.int64] | slice) -> WireSlopes:
        """Return those of some postures."""
        return WireSlopes(self.pulls[rows], self.states[rows])

    def put(self, rows: npt.NDArray[np.int64], others: WireSlopes) -> None:
        """Set those of some postures, if their states have as many entries."""
        if self.states.shape[2] == others.states.shape[2]:
            self.pulls[rows], self.states[rows] = others.pulls, others.states


@dataclass(frozen=True)
class ShapeBatch(Bent):
    """Shapes of b postures of a robot with n cells, k tendons and m inputs."""

    inputs: Floats  # (b, m) [N]
    state: Floats  # (b, 3n) [rad]: bends (n, 2), then twists (n,)
    tendon_tensions: Floats  # (b, n, k) [N], 0 beyond a tendon's end
    frames: Floats  # (b, n, 3, 3) at the distal ends of the cells
    positions: Floats  # (b, n, 3) [m] distal ends of the cells
    tendon_pulls: Floats  # (b, k) [m]
    pulls: Floats  # (b, m) [m], mean over the tendons of an input
    cell_length: Floats  # (n,) [m] at rest
    hinge: npt.NDArray[np.bool_]  # (n,)
    slopes: WireSlopes | None = None  # by the tensions, where they were found for wire pulls

    def __len__(self) -> int:
        """Count the postures."""
        return len(self.inputs)

    def __repr__(self) -> str:
        """Name the numbers of postures and cells."""
        return f'<ShapeBatch: {len(self)} postures of {len(self.cell_length)} cells>'

    def of(self, rows: npt.NDArray[Any] | slice) -> ShapeBatch:
        """Return some of the postures."""
        slopes = None if self.slopes is None else self.slopes.of(rows)
        return replace(self, **{name: getattr(self, name)[rows] for name in FIELDS}, slopes=slopes)

    @staticmethod
    def joined(batches: Sequence[ShapeBatch]) -> ShapeBatch:
        """Return the postures of several batches of one robot."""
        fields = {name: np.concatenate([getattr(one, name) for one in batches]) for name in FIELDS}
        return replace(batches[0], **fields, slopes=None)

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
        along, offset = np.asarray(arc_length, float), np.asarray(offset, float)
        cells, fraction, at_end = marker_cells(self.cell_length.tobytes(), along.tobytes())
        if at_end and not offset.any():
            return self.positions[:, cells]
        frames, points = self.frames[:, cells], self.positions[:, cells]
        if not at_end:
            frames, points = frames_inside(self, cells, fraction, bool(offset.any()))
        return np.asarray(points + np.einsum('bjrc,jc->bjr', frames, offset))


class Shape(Bent, TextResult):
    """One posture: the fields of `ShapeBatch` without the first axis."""

    inputs: Floats  # (m,) [N]
    tendon_tensions: Floats  # (n, k) [N]
    tendon_pulls: Floats  # (k,) [m]
    pulls: Floats  # (m,) [m]

    def __init__(self, form: ResultLayout, block: Floats) -> None:
        """Take a block that the kernel filled; its fields become arrays when they are read."""
        self.form, self.block = form, block

    def __repr__(self) -> str:
        """Name tensions and tip."""
        return f'<Shape: tensions [{_numbers(self.inputs)}] N, {_tip_text(self)}>'

    def plot(self, axes: Axes | None = None, **style: Any) -> Axes:
        """
        Draw the arm [mm] with matplotlib: in the x-z plane, or in space where it leaves it.

        Parameters
        ----------
        axes : matplotlib Axes, optional
            To draw another arm into the same picture; in space it must be three-dimensional.
        **style
            Of the line, as for `Axes.plot`.

        Returns
        -------
        Axes

        """
        return plot_arms(self.positions[None], axes, **style)

    def frame(self) -> Any:
        """
        Return the arm as a table (pandas): a row per cell, SI units.

        Columns `cell`, `arc_length`, `x`, `y`, `z` of its far end [m], `bend_x`, `bend_y` [rad].
        """
        places, bends = self.positions.T, self.bend.T
        columns = {
            'cell': np.arange(1, len(self.positions) + 1),
            'arc_length': np.cumsum(self.form.cell_length),
            **dict(zip('xyz', places, strict=True)),
            **{f'bend_{axis}': bend for axis, bend in zip('xy', bends, strict=True)},
        }
        units = dict.fromkeys(('arc_length', 'x', 'y', 'z'), 'm')
        return make_frame(columns, units | dict.fromkeys(('bend_x', 'bend_y'), 'rad'))

    def __getattr__(self, name: str) -> Floats:
        """Return a field of the block, which becomes an array when it is first read."""
        if name not in FIELDS:
            raise AttributeError(f'{type(self).__name__} has no {name}')
        where, shape = self.form.one[name]
        value: Floats = self.block[where].reshape(shape)
        setattr(self, name, value)
        return value

    @cached_property
    def memory(self) -> Floats:
        """Friction memory after this posture, for the next call."""
        return self.block[self.form.size :]

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
class Reach(TextResult):
    """Tensions for a target, and how near they bring the tip."""

    shape: Shape
    position_error: float  # [m], 0 where no position was requested
    direction_error: float  # [rad], 0 where no direction was requested
    status: str  # 'reached', 'nearest' or 'at_limit'
    at_limit: tuple[str, ...]  # inputs at their upper limit
    region: str = ''  # that keeps the arm away from the target, '' where none does

    def __repr__(self) -> str:
        """Name the status, the errors and the tensions."""
        limits = f', at its limit: {", ".join(self.at_limit)}' if self.at_limit else ''
        limits += f', kept out of {self.region}' if self.region else ''
        return (
            f'<Reach: {self.status}, {1e3 * self.position_error:.3g} mm and '
            f'{math.degrees(self.direction_error):.3g}° from the target{limits}; '
            f'tensions [{_numbers(self.tensions)}] N, {_tip_text(self.shape)}>'
        )

    @property
    def tensions(self) -> Floats:
        """Input tensions (m,) [N]."""
        return self.shape.inputs

    @property
    def pulls(self) -> Floats:
        """Wire pulls (m,) [m] of that equilibrium."""
        return self.shape.pulls


def _numbers(values: Floats) -> str:
    return ', '.join(f'{value:.3g}' for value in values)


def named_values(names: Sequence[str], values: Floats, unit: str) -> str:
    """Return values with their names, without those that are not finite."""
    named = zip(names, values, strict=True)
    return ', '.join(f'{name} {value:g} {unit}' for name, value in named if np.isfinite(value))


def _tip_text(shape: Shape) -> str:
    place, along = _numbers(1e3 * shape.tip_position), _numbers(shape.tip_direction)
    return f'tip at ({place}) mm towards ({along})'


def plot_arms(positions: Floats, axes: Axes | None = None, **style: Any) -> Axes:
    """
    Draw arms (b, n, 3) [m] from the base to the tip.

    Parameters
    ----------
    positions : (b, n, 3) [m]
        Distal ends of the cells.
    axes : matplotlib Axes, optional
        Default: new ones, flat where no arm leaves the x-z plane; else seen across the plane in
        which the arms bend.
    **style
        Of the lines, as for `Axes.plot`.

    """
    arms = 1e3 * np.concatenate([np.zeros((len(positions), 1, 3)), positions], axis=1)
    axes = new_axes(arms) if axes is None else axes
    in_space = hasattr(axes, 'get_zlim')
    for arm in arms:
        axes.plot(*(arm.T if in_space else arm.T[[0, 2]]), **{'marker': '.', **style})
    if in_space:
        axes.set(xlabel='x [mm]', ylabel='y [mm]', zlabel='z [mm]')
    else:
        axes.set(xlabel='x [mm]', ylabel='z [mm]')
    axes.set_aspect('equal')
    return axes


def new_axes(arms: Floats) -> Any:
    """Return axes for arms (b, n, 3) [mm]: flat, or seen across the plane in which they bend."""
    in_space = np.abs(arms[..., 1]).max() > FLATNESS * np.ptp(arms, axis=(0, 1)).max()
    if not in_space:
        return picture_axes()
    axes = picture_axes(projection='3d')
    axes.view_init(azim=np.degrees(bending_azimuth(arms)) - 90.0)
    return axes


def bending_azimuth(points: Floats) -> float:
    """
    Return the direction [rad, from x towards y] in which arms bend that leave the base along z.

    That of the plane through the base's axis to which the points (..., 3) [m] are nearest; points
    that were not seen (nan) do not count, and straight arms bend towards x.
    """
    flat = points.reshape(-1, 3)[:, :2]
    flat = flat[np.isfinite(flat).all(axis=1)]
    x, y = np.linalg.eigh(flat.T @ flat)[1][:, 1] if flat.any() else (1.0, 0.0)
    side = 1.0 if np.sum(flat @ (x, y)) >= 0.0 else -1.0
    return float(np.arctan2(side * y, side * x))


def views_of(points: Floats, azimuth: float) -> Floats:
    """
    Turn points (..., 3) [m] to how they are seen across and along a plane of bending.

    Returns
    -------
    (..., 3) [m]
        In the plane, across it, along the base's axis.

    """
    u = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return np.stack([points @ u, points @ np.cross([0.0, 0.0, 1.0], u), points[..., 2]], axis=-1)


def plot_sides(measured: Floats, models: Mapping[str, tuple[Floats, Floats]]) -> Figure:
    """
    Draw one posture across the plane in which the arm bends, and along it, to show all errors.

    Parameters
    ----------
    measured : (j, 3) [m]
        Markers, nan where not seen.
    models : mapping
        Name -> predicted line (n, 3) and markers (j, 3) [m].

    """
    from matplotlib import pyplot as plt

    azimuth = bending_azimuth(measured)
    figure = plt.figure(layout='constrained')
    sides = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for side, axes in enumerate(sides):

        def draw(points: Floats, axes: Axes = axes, side: int = side, **style: Any) -> None:
            view = 1e3 * views_of(points, azimuth)
            axes.plot(view[:, side], view[:, 2], **style)

        for i, (name, (line, markers)) in enumerate(models.items()):
            for pair in np.stack([measured, markers], axis=1):
                draw(pair, color=ERROR, linewidth=1.0)
            draw(np.vstack([np.zeros((1, 3)), line]), color=line_style(i).colour, label=name)
        draw(measured, color=MEASURED, marker='o', linestyle='', label='measured')
        axes.set_aspect('equal', adjustable='datalim')
    towards = f'plane of bending, {np.degrees(azimuth):.0f}° from x [mm]'
    sides[0].set(xlabel=towards, ylabel='z [mm]')
    sides[1].set(xlabel='across it [mm]')
    sides[0].legend()
    return figure
