"""
A plant: the robot as it really is, for simulated measurements and the mock driver.

It shares the physics with the model that its owner writes down, and little else: finer cells, the
capstan's exponential, scatter of the cells' stiffness, and effects or damage that the owner's
file does not mention. Eyelets stay where the owner's are, at the ends of the owner's cells: a
tendon touches nothing between them, so finer cells may not add friction. For the same reason
cells are not divided where a joint or the straight tendon between two eyelets is a thing of its
own: hinges, `straight_tendon`, `friction_memory` (whose travel is counted per cell), and the
user's own effects, of which nobody knows how they scale. There a plant differs by capstan and
scatter only.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..effects import Catalogue, load_catalogue
from ..exceptions import InputError
from ..robot import Robot
from .causes import Damage
from .hidden import Hidden, hide
from .markers import rotation
from .model import Model
from .plant_laws import plant_catalogue
from .plant_robot import parts_per_cell, real_robot
from .pulls import pull_shapes
from .shape import Shape, ShapeBatch

Floats = npt.NDArray[np.float64]


class PlantShape(Shape):
    """The arm as it is; its markers are where the tracker sees them."""

    def __init__(self, shape: Shape, plant: Plant, asked: Floats | None = None) -> None:
        """Take a shape of the plant's model; `asked` [N]: inputs without the hidden gain."""
        super().__init__(shape.form, shape.block)
        self.plant = plant
        if asked is not None:
            self.inputs[:] = asked

    def markers(self, arc_length: Floats, offset: Floats) -> Floats:
        """Place markers (j, 3) [m] in the tracker's frame."""
        placed = self.batch.markers(arc_length, offset)
        seen: Floats = self.plant.tracked(placed, self.inputs[None])[0]
        return seen


class Plant:
    """A robot to be measured; `robot` is what its owner wrote, `model` what it really is."""

    def __init__(self, robot: Robot, model: Model, parts: int, damage: Damage) -> None:
        """Take the owner's robot, the real one with `parts` cells per cell, and its damage."""
        self.robot, self.model, self.parts, self.damage = robot, model, parts, damage
        self.inputs = robot.inputs
        self._state: PlantShape | None = None

    def respond(self, tensions: npt.ArrayLike) -> PlantShape:
        """
        Return the arm under tensions (m,) [N] that follow those of the last call.

        Raises
        ------
        InputError, NoEquilibriumError

        """
        asked, last = self.model.tensions(np.asarray(tensions, dtype=float)), self._state
        given = asked * self._gain(asked[None])[0]
        bend, memory = (None, None) if last is None else (last.bend, last.memory)
        shape = self.model.shape(given, bend, memory)
        self._state = PlantShape(shape, self, asked)
        return self._state

    def respond_to_pulls(self, pulls: npt.ArrayLike) -> PlantShape:
        """Return the arm under wire pulls (m,) [m], nan = slack; friction does not remember."""
        asked = np.asarray(pulls, dtype=float)
        shape = self.model.pull_shape(asked * self._gain(asked[None], True)[0], self._state)
        self._state = PlantShape(shape, self)
        return self._state

    def shapes(
        self, inputs: npt.ArrayLike, sequence: bool = False, displacement: bool = False
    ) -> ShapeBatch:
        """
        Return the shapes under inputs (b, m) [N] or [m] at the ends of the owner's cells.

        Parameters
        ----------
        inputs : (b, m)
            Tensions [N], or wire pulls [m] with nan = slack.
        sequence : bool
            Load one posture after the other; else each from straight.
        displacement : bool
            Inputs are wire pulls.

        Raises
        ------
        InputError, NoEquilibriumError

        """
        fine = self._fine(np.asarray(inputs, dtype=float), sequence, displacement)
        b, n, ends = len(fine), self.robot.cells, slice(self.parts - 1, None, self.parts)
        return replace(
            fine,
            bend=fine.bend.reshape(b, n, self.parts, 2).sum(axis=2),
            tendon_tensions=fine.tendon_tensions[:, ends],
            frames=fine.frames[:, ends],
            positions=fine.positions[:, ends],
            hinge=fine.hinge[ends],
            cell_length=fine.cell_length.reshape(n, self.parts).sum(axis=1),
        )

    def markers(
        self,
        inputs: npt.ArrayLike,
        arc_length: Floats,
        offset: Floats,
        sequence: bool = False,
        displacement: bool = False,
    ) -> Floats:
        """Return markers (b, j, 3) [m] as the tracker sees them; inputs as for `shapes`."""
        given = np.asarray(inputs, dtype=float)
        fine = self._fine(given, sequence, displacement)
        return self.tracked(fine.markers(arc_length, offset), given, displacement)

    def tracked(self, points: Floats, inputs: Floats, displacement: bool = False) -> Floats:
        """Move points (b, j, 3) [m] of the arm under inputs (b, m) into the tracker's frame."""
        seen = self.model.measured(points)
        if self.damage.rotation == 0.0:
            return seen
        turn = self.damage.rotation * self._deviations(inputs, displacement)[:, 1:3]
        angle = np.linalg.norm(turn, axis=1)
        toward = turn / np.maximum(angle, 1e-300)[:, None]
        turned: Floats = np.einsum('brc,bjc->bjr', rotation(toward, angle), seen)
        return turned

    def _fine(self, inputs: Floats, sequence: bool, displacement: bool) -> ShapeBatch:
        given = inputs * self._gain(inputs, displacement)
        if not displacement:
            solve = self.model.sequence if sequence else self.model.shapes
            return replace(solve(given), inputs=inputs)
        memory = self.model.arrays.fresh_memory() if sequence else None
        return pull_shapes(self.model, given, memory=memory)

    def _gain(self, inputs: Floats, displacement: bool = False) -> Floats:
        if self.damage.gain == 0.0:
            return np.ones((len(inputs), 1))
        return 1.0 + self.damage.gain * self._deviations(inputs, displacement)[:, :1]

    def _deviations(self, inputs: Floats, displacement: bool) -> Floats:
        return self.damage.deviations(inputs / self._scale[int(displacement)])

    @cached_property
    def _scale(self) -> tuple[float, float]:
        """Tension [N] and wire pull [m] that bend the arm by half a radian, roughly."""
        radius = max(float(np.hypot(*tendon.end)) for tendon in self.robot.tendons)
        softness = sum(1.0 / k for s in self.robot.sections for k in s.bending_stiffness)
        return 0.5 / (softness * radius), 0.5 * radius


def make_plant(
    robot: Robot,
    hidden: Hidden | None = None,
    refine: int = 3,
    scatter: float = 0.02,
    capstan: bool = True,
    seed: int = 0,
    catalogue: Catalogue | None = None,
) -> Plant:
    """
    Make the robot that a simulation or a mock really is.

    Parameters
    ----------
    robot : Robot
        What its owner wrote down.
    hidden : mapping, optional
        Effect, or cause outside the catalogue (`causes.CAUSES`), to its parameters; no parameters:
        the typical size. An effect that the owner lists has these values instead of the owner's.
    refine : int
        Cells per cell of the owner, where the cells may be divided (see this module).
    scatter : float
        Relative standard deviation of the stiffness from cell to cell [1].
    capstan : bool
        Friction at eyelets follows the exponential instead of the paper's quotient.
    seed : int
        Of the scatter.
    catalogue : Catalogue, optional
        With the user's own effects.

    Raises
    ------
    EffectError
        An effect or parameter is unknown or out of its bounds.
    InputError
        `refine` or `scatter` make no sense.

    """
    if refine < 1 or not 0.0 <= scatter <= 0.2:
        raise InputError(
            f'plant: expected refine >= 1 and scatter from 0 to 0.2, got {refine} and {scatter}'
        )
    catalogue = catalogue or load_catalogue()
    damage = Damage.none(robot, seed)
    effects = hide(robot, hidden or {}, catalogue, damage)
    random = np.random.default_rng(seed)
    stiffness = damage.stiffness * (1.0 + scatter * random.normal(size=robot.cells).clip(-4, 4))
    parts = parts_per_cell(robot, effects, refine)
    real = real_robot(robot, effects, parts, stiffness, damage.side_force, capstan)
    return Plant(robot, Model(real, plant_catalogue(catalogue)), parts, damage)
