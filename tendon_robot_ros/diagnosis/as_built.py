"""
The arm as it is built: the imperfections that nobody declares, and how they move the markers.

Every arm has them: cells whose stiffness scatters or that are kinked at rest, tensions and holes
that are a little off, a tracker whose frame is. They are the same in every posture. One cell (or
tendon) is one column: the derivative of all markers by its imperfection.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..comparison.predict import CELLS, FreeParameter, Point, Predictor
from ..effects import Catalogue
from ..robot import Robot, Section
from ..robot.description import EffectValues

Floats = npt.NDArray[np.float64]
KINK, ACROSS, GAIN, HOLE = 'cell_kink', 'cell_kink_across', 'channel_gain', 'hole_radius'
ZERO, POSITION, ROTATION = 'pull_zero', 'position', 'rotation'
REMAINDER = 'remainder'  # what no imperfection explains: another one in every posture
KINDS_WITH_FEW_MEMBERS = (GAIN, HOLE, ZERO, POSITION, ROTATION)  # kinds with few members
REMAINDER_SHAPES = 4  # shapes along the arm that a remainder may have
# Kind -> (unit, 1 sd that is plausible where nothing is declared, step of its derivative)
PLAUSIBLE_SIZES: dict[str, tuple[str, float, float]] = {
    CELLS: ('1', 0.03, 0.01),
    KINK: ('rad', math.radians(0.1), 1e-3),
    ACROSS: ('rad', math.radians(0.1), 1e-3),
    GAIN: ('1', 0.01, 5e-3),
    HOLE: ('1', 0.01, 1e-2),
    ZERO: ('m', 2e-4, 1e-4),
    POSITION: ('m', 5e-4, 1e-3),
    ROTATION: ('rad', math.radians(0.3), 1e-3),
}
PLAUSIBLE_LENGTH = 0.2  # [m] of the arm for which plausible lengths are these


@dataclass(frozen=True)
class Kind:
    """One kind of imperfection; its members share one standard deviation."""

    name: str
    unit: str
    plausible: float  # scale of the half-normal prior of that standard deviation [unit]
    members: tuple[str, ...]

    def __len__(self) -> int:
        """Return how many members it has."""
        return len(self.members)


Members = Mapping[str, Floats]  # kind -> size of each of its members


@dataclass(frozen=True)
class Imperfections:
    """The kinds that a data set may show, and what a unit of each member does to the markers."""

    kinds: tuple[Kind, ...]
    moves: Floats  # (q, P, J, 3) [m per unit], the members of all kinds one after the other
    bend: Floats  # (P, J, 3) [m] what the imperfections do beyond these slopes, where taken

    @cached_property
    def owners(self) -> npt.NDArray[np.int64]:
        """Index (q,) of the kind that each column belongs to."""
        return np.repeat(np.arange(len(self.kinds)), [len(kind) for kind in self.kinds])


def imperfections(
    predictor: Predictor, point: Point, at: Members | None = None
) -> Imperfections | None:
    """
    Return the imperfections of an arm at a point; None where the model has no equilibrium.

    Derivatives are central differences of settled shapes, taken at imperfections `at`.
    """
    split = SplitPredictor(predictor)
    kinds = split.kinds()
    start = {k.name: np.zeros(len(k)) if at is None else at[k.name] for k in kinds}
    here, plain = split.built(point, start), split.markers(point)
    if here is None or plain is None:
        return None
    moves = [split.slope(point, start, k.name, i, here) for k in kinds for i in range(len(k))]
    sizes = np.concatenate([start[kind.name] for kind in kinds])
    columns = remainders(predictor)
    rest = Kind(REMAINDER, 'm', np.inf, tuple(map(str, range(len(columns)))))
    return Imperfections(
        (*kinds, rest),
        np.concatenate([moves, columns]),
        here - plain - np.tensordot(sizes, np.array(moves), 1),
    )


def remainders(predictor: Predictor) -> Floats:
    """
    Return columns (q, P, J, 3) of a remainder of 1 m sd at the tip, posture by posture.

    The error of an arm that bends a little otherwise, at random along its length: twice
    integrated white noise, its `REMAINDER_SHAPES` largest shapes in each direction.
    """
    dataset = predictor.dataset
    share = dataset.arc_lengths / predictor.robot.length
    low, high = np.minimum.outer(share, share), np.maximum.outer(share, share)
    values, shapes = np.linalg.eigh(low**2 * (3.0 * high - low) / 2.0)
    shapes = (shapes * np.sqrt(np.maximum(values, 0.0)))[:, ::-1][:, :REMAINDER_SHAPES]
    P, J, q = len(dataset.postures), shapes.shape[0], shapes.shape[1]
    columns = np.zeros((P, q, 3, P, J, 3))
    for p in np.flatnonzero(dataset.trials > 0):
        for xyz in range(3):
            columns[p, :, xyz, p, :, xyz] = shapes.T
    return columns[dataset.trials > 0].reshape(-1, P, J, 3)


def planar_axis(robot: Robot) -> int | None:
    """Axis (0: x, 1: y) towards which an arm bends whose tendons all lie in one plane."""
    offsets = np.array([end for tendon in robot.tendons for end in (tendon.base, tendon.end)])
    flat = np.abs(offsets).max(axis=0) < 1e-6
    return 0 if flat[1] else 1 if flat[0] else None


class SplitPredictor(Predictor):
    """A predictor of the same arm with a section per cell, so that every cell may be its own."""

    def __init__(self, predictor: Predictor) -> None:
        """Split the robot of a predictor."""
        self.whole = predictor.robot
        super().__init__(
            predictor.dataset,
            split_robot(predictor.robot, predictor.model.catalogue),
            predictor.model.catalogue,
        )
        ends = np.cumsum([section.cells for section in self.whole.sections])
        self._spans = [
            slice(end - s.cells, end) for end, s in zip(ends, self.whole.sections, strict=True)
        ]
        self._offsets = self.model.arrays.offset.copy()

    def kinds(self) -> tuple[Kind, ...]:
        """Return what may be off; a registration that is declared is a parameter of the fit."""
        cells = [f'cell {i + 1}' for i in range(self.whole.cells)]
        axis = planar_axis(self.whole)
        kinks = [f'{cell} towards {xy}' for cell in cells for xy in 'xy']
        labels = {CELLS: cells, KINK: kinks}
        if axis is not None:
            labels |= {KINK: kinks[axis::2], ACROSS: kinks[1 - axis :: 2]}
        labels[GAIN] = list(self.whole.inputs)  # of a tension: a hole off its place does the same
        if self.dataset.input == 'displacement':
            labels |= {HOLE: [t.name for t in self.whole.tendons], ZERO: list(self.whole.inputs)}
        known = self.whole.tolerances
        labels |= {name: list('xyz') for name in (POSITION, ROTATION) if name not in known}
        made = []
        for name, members in labels.items():
            unit, plausible, _ = PLAUSIBLE_SIZES[name]
            usual = plausible * (self.whole.length / PLAUSIBLE_LENGTH if unit == 'm' else 1.0)
            size = float(known.get(KINK if name == ACROSS else name, usual))
            if size > 0.0:
                made.append(Kind(name, unit, size, tuple(members)))
        return tuple(made)

    def slope(self, point: Point, at: Members, kind: str, i: int, here: Floats) -> Floats:
        """Return the derivative (P, J, 3) [m] by member i of a kind; zero where it fails."""
        step = PLAUSIBLE_SIZES[kind][2]
        up, down = (self.built(point, _moved(at, kind, i, side * step)) for side in (1.0, -1.0))
        if up is not None and down is not None:
            return (up - down) / (2.0 * step)
        if up is not None:
            return (up - here) / step
        return np.zeros_like(here) if down is None else (here - down) / step

    def built(self, point: Point, off: Members) -> Floats | None:
        """Predict the markers of an arm with imperfections; None without equilibrium."""
        offset = self.model.arrays.offset
        offset[:] = self._offsets * (1.0 + off.get(HOLE, np.zeros(1))[None, :, None])
        inputs = self.inputs * (1.0 + off.get(GAIN, 0.0)) + off.get(ZERO, 0.0)
        try:
            placed = self.markers(
                {**point, **self._kinks(point, off)}, inputs, 1.0 + off.get(CELLS, np.zeros(1))
            )
        finally:
            offset[:] = self._offsets
        if placed is None:
            return None
        turn, shift = off.get(ROTATION, np.zeros(3)), off.get(POSITION, np.zeros(3))
        return placed + np.cross(turn, placed) + shift

    def _kinks(self, point: Point, off: Members) -> dict[FreeParameter, float]:
        """Return the bend at rest of every cell as parameters of its own."""
        axis, effect = planar_axis(self.whole), self.model.catalogue['pre_curvature']
        kinks = np.zeros((self.whole.cells, 2))
        if axis is None:
            kinks += off.get(KINK, np.zeros(1)).reshape(-1, 2 if KINK in off else 1)
        else:
            kinks[:, axis] = off.get(KINK, 0.0)
            kinks[:, 1 - axis] = off.get(ACROSS, 0.0)
        bends = {}
        for xy in np.flatnonzero(kinks.any(axis=0)):
            whole = FreeParameter(effect.name, effect.parameters[xy])
            value = point.get(whole, self.value(whole))
            for cell in range(len(kinks)):
                own = FreeParameter(effect.name, effect.parameters[xy], cell, 'own')
                bends[own] = value + float(kinks[cell, xy])
        return bends

    def pushed(self, point: Point, cell: int, force: Floats) -> Floats | None:
        """Predict the markers with a force (3,) [N] at the middle of a cell; None: it cannot."""
        weight = self.model.catalogue['gravity']
        size = float(np.linalg.norm(force))
        weighs = self._on[self.model.arrays.layout.index[weight.name]]
        if weighs or any(free.effect == weight.name for free in point):
            return None
        mass = self.model.arrays.cells[cell, 2]
        own = FreeParameter(weight.name, weight.parameters[0], cell, 'own')
        with self.under_gravity(np.asarray(force) / max(size, 1e-30)):
            return self.markers({**point, own: size / mass})

    def spread(self, free: FreeParameter) -> tuple[FreeParameter, ...]:
        """Return a free parameter of one section as those of its cells."""
        own = free.effect == CELLS or free.label == 'own' or free.parameter.per_tendon
        if own or free.column is None:
            return (free,)
        span = self._spans[free.column]
        return tuple(replace(free, column=i) for i in range(span.start, span.stop))

    def markers(self, point: Point, *args: object, **options: object) -> Floats | None:
        """Predict marker positions; see `Predictor.markers`."""
        split = {one: value for free, value in point.items() for one in self.spread(free)}
        return super().markers(split, *args, **options)  # type: ignore[arg-type]


def split_robot(robot: Robot, catalogue: Catalogue) -> Robot:
    """Return the same robot with every cell a section of its own."""
    sections = tuple(
        Section(
            f'{s.name} {i + 1}',
            1,
            s.cell_length,
            (s.bending_stiffness[i],),
            (s.mass_profile[i],),
            s.bends_as,
        )
        for s in robot.sections
        for i in range(s.cells)
    )
    ends = {s.name: f'{s.name} {s.cells}' for s in robot.sections}
    cells = [s.cells for s in robot.sections]
    wide = {(e.name, p.name) for e in catalogue for p in e.parameters if p.per_section}
    effects: dict[str, EffectValues] = {
        name: {
            key: tuple(np.repeat(value, cells).tolist())
            if isinstance(value, tuple) and (name, key) in wide
            else value
            for key, value in values.items()
        }
        for name, values in robot.effects.items()
    }
    tendons = tuple(replace(tendon, section=ends[tendon.section]) for tendon in robot.tendons)
    return replace(robot, sections=sections, tendons=tendons, effects=effects, fitted={})


def typical_force(robot: Robot) -> float:
    """Return a side force [N] at the tip that bends the arm by about a third of a radian."""
    softness = sum(1.0 / k for section in robot.sections for k in section.bending_stiffness)
    return 0.6 / (softness * robot.length)


def _moved(at: Members, kind: str, i: int, step: float) -> dict[str, Floats]:
    sizes = np.array(at[kind])
    sizes[i] += step
    return {**at, kind: sizes}
