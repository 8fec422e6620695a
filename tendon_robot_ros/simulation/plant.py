"""
A plant: the robot as it really is, for simulated measurements and the mock driver.

It shares the physics with the model that its owner writes down, and little else: finer cells, the
capstan's exponential, scatter of the cells' stiffness, and effects or damage that the owner's file
does not mention. Eyelets stay where the owner's are, at the ends of the owner's cells: a tendon
touches nothing between them, so finer cells may not add friction. For the same reason cells are
not divided where a joint or the straight tendon between two eyelets is a thing of its own: hinges,
`straight_tendon`, `friction_memory` (whose travel is counted per cell), and the user's own
effects, whose scaling is unknown. There a plant differs by capstan and scatter only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import number, whole
from ..common.rotations import bent, turned_in_plane
from ..effects import Catalogue, CatalogueLike, Effect, load_catalogue
from ..model.compile import described_effect
from ..model.model import Model
from ..model.pulls import pull_shapes
from ..model.shape import Shape, ShapeBatch
from ..robot import Robot, RobotLike, Section, load_robot
from ..robot.description import XY, EffectValues, helix_angles
from ..robot.estimates import natural_sizes
from .hidden import (
    SCATTER_MAX,
    STIFFNESS_SCATTER,
    Built,
    Damage,
    Hidden,
    Workmanship,
    hide,
    plant_catalogue,
)


def parts_per_cell(
    robot: Robot, effects: dict[str, EffectValues], catalogue: Catalogue, refine: int
) -> int:
    """Return `refine` where cells may be divided, else 1."""
    scales = all(catalogue[name].divisible for name in effects)
    return refine if scales and all(s.bends_as == 'arc' for s in robot.sections) else 1


def real_robot(
    robot: Robot,
    effects: dict[str, EffectValues],
    catalogue: Catalogue,
    parts: int,
    damage: Damage,
    exponential: bool,
    built: Built,
) -> Robot:
    """
    Describe the plant.

    Parameters
    ----------
    robot : Robot
        The owner's, n cells.
    effects : dict
        The owner's and the hidden ones, as for the owner's cells.
    catalogue : Catalogue
        Says how their parameters scale where a cell is divided.
    parts : int
        Finer cells per cell.
    damage : Damage
        Hidden: factors on the stiffness of the owner's cells.
    exponential : bool
        Friction follows the capstan's exponential.
    built : Built
        Imperfections.

    """
    n = robot.cells
    wraps = np.zeros((n, parts))
    wraps[:, -1] = parts  # the eyelet turns the tendon as the whole cell does
    friction: EffectValues = {'wraps': tuple(wraps.ravel()), 'exponential': float(exponential)}
    scaled = {
        name: scaled_values(catalogue[name], values, robot, parts)
        for name, values in effects.items()
    }
    scaled['tendon_friction'] = {**scaled.get('tendon_friction', {}), **friction}
    if built.kink.any():  # it lies in the first part of its cell
        kinks, before = np.zeros((n, parts, 2)), scaled.get('pre_curvature', {})
        kinks[:, 0] = built.kink
        scaled['pre_curvature'] = {
            key: tuple((kinks[..., i].ravel() + np.array(before.get(key, 0.0))).tolist())
            for i, key in enumerate(('angle_x', 'angle_y'))
        }
    sections = cell_sections(robot, parts, damage.stiffness * (1.0 + built.stiffness))
    ends = {s.name: f'{s.name} {s.cells * parts}' for s in robot.sections}
    helix, along = helix_angles(robot), (np.arange(parts) + 0.5) / parts - 0.5
    tendons = []
    for k, tendon in enumerate(robot.tendons):
        scale = 1.0 + float(built.hole[k])
        offsets: list[XY] = []  # in every finer cell that of the cell, wound on within it
        for at, angle in zip(tendon.offsets, helix[:, k].tolist(), strict=False):
            wound = turned_in_plane(scale * np.array(at), angle * along)
            offsets += [(x, y) for x, y in wound.tolist()]
        tendons.append(
            replace(
                tendon,
                section=ends[tendon.section],
                base=(tendon.base[0] * scale, tendon.base[1] * scale),
                end=(tendon.end[0] * scale, tendon.end[1] * scale),
                offsets=tuple(offsets),
            )
        )
    return replace(robot, sections=sections, tendons=tuple(tendons), effects=scaled, fitted={})


def cell_sections(robot: Robot, parts: int, stiffness: Floats) -> tuple[Section, ...]:
    """Return a section of its own for every finer cell, with factors (n,) on the stiffness."""
    sections, factors = [], iter(stiffness)
    for section in robot.sections:
        for i in range(section.cells):
            one = replace(
                section,
                cells=1,
                cell_length=section.cell_length / parts,
                bending_stiffness=(section.bending_stiffness[i] * parts * float(next(factors)),),
                mass_profile=(section.mass_profile[i],),
                mass_offset=section.mass_offset[i : i + 1],
            )
            numbers = range(i * parts + 1, (i + 1) * parts + 1)
            sections += [replace(one, name=f'{section.name} {number}') for number in numbers]
    return tuple(sections)


def scaled_values(effect: Effect, values: EffectValues, robot: Robot, parts: int) -> EffectValues:
    """Scale what counts per cell; repeat what counts per section for every cell of it."""
    cells = [s.cells * parts for s in robot.sections]
    parameters = {parameter.name: parameter for parameter in effect.parameters}
    scaled: EffectValues = {}
    for key, value in values.items():
        factor = float(parts) ** parameters[key].parts_power
        if not isinstance(value, tuple):
            scaled[key] = value * factor
        else:
            each = np.repeat(value, cells) if parameters[key].per_section else np.array(value)
            scaled[key] = tuple((factor * each).tolist())
    return scaled


class PlantShape(Shape):
    """The real arm; its markers are in the tracker's frame."""

    def __init__(self, shape: Shape, plant: Plant, command: Floats, by_pull: bool = False) -> None:
        """Take a shape of the plant's model, and the tensions [N] or pulls [m] (m,) for it."""
        super().__init__(shape.form, shape.block)
        self.plant, self.command, self.by_pull = plant, command, by_pull

    def markers(self, arc_length: Floats, offset: Floats) -> Floats:
        """Place markers (j, 3) [m] in the tracker's frame."""
        return self.tracked(self.batch.markers(arc_length, offset)[0])

    def tracked(self, points: Floats) -> Floats:
        """Move points (j, 3) [m] of the arm into the tracker's frame."""
        seen = self.plant.tracked(points[None], self.command[None], self.by_pull)
        return np.asarray(seen[0])


class Plant:
    """A robot to be measured; `robot` is its owner's description, `model` the real one."""

    def __init__(
        self, robot: Robot, model: Model, parts: int, damage: Damage, built: Built | None = None
    ) -> None:
        """Take the owner's robot, the real one with `parts` cells per cell, and its damage."""
        self.robot, self.model, self.parts, self.damage = robot, model, parts, damage
        self.built = built or Built.exact(robot)
        self.inputs = robot.inputs
        # tension [N] and wire pull [m] that bend the arm by half a radian, roughly
        radius = natural_sizes(robot)['radius']
        softness = sum(1.0 / k for s in robot.sections for k in s.bending_stiffness)
        self._scale = 0.5 / (softness * radius), 0.5 * radius
        self._state: PlantShape | None = None

    def respond(self, tensions: npt.ArrayLike) -> PlantShape:
        """
        Return the arm under tensions (m,) [N] that follow those of the last call.

        Raises
        ------
        InputError, NoEquilibriumError

        """
        requested = self.model.tensions(np.asarray(tensions, dtype=float))
        shape = self.model.follow(self._state, requested * self._gain(requested[None])[0])
        self._state = PlantShape(shape, self, requested)
        self._state.inputs[:] = requested  # without the hidden gain
        return self._state

    def forget(self) -> None:
        """Reset the arm: straight and free of tension."""
        self._state = None

    def respond_to_pulls(self, pulls: npt.ArrayLike) -> PlantShape:
        """Return the arm under wire pulls (m,) [m], nan = slack, that follow the last call's."""
        target = np.asarray(pulls, dtype=float)
        shape = self.model.follow_pulls(self._state, target * self._gain(target[None], True)[0])
        self._state = PlantShape(shape, self, target, by_pull=True)
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
        n, ends = self.robot.cells, slice(self.parts - 1, None, self.parts)
        # bends and twists of finer cells add up
        b = len(fine.state)
        bends = fine.bend.reshape(b, n, self.parts, 2).sum(axis=2).reshape(b, 2 * n)
        twists = fine.twist.reshape(b, n, self.parts).sum(axis=2)
        return replace(
            fine,
            state=np.concatenate([bends, twists], axis=1),
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
        rows = np.asarray(inputs, dtype=float)
        fine = self._fine(rows, sequence, displacement)
        return self.tracked(fine.markers(arc_length, offset), rows, displacement)

    def tracked(self, points: Floats, inputs: Floats, displacement: bool = False) -> Floats:
        """Move points (b, j, 3) [m] of the arm under inputs (b, m) into the tracker's frame."""
        points = self.model.measured(points)
        moved = np.cross(self.built.rotation, points)
        points = points + moved + 0.5 * np.cross(self.built.rotation, moved) + self.built.position
        if self.damage.rotation == 0.0:
            return points
        rotation = self.damage.rotation * self._deviations(inputs, displacement)[:, 1:3]
        angle = np.linalg.norm(rotation, axis=1)
        toward = rotation / np.maximum(angle, 1e-300)[:, None]
        turned: Floats = np.einsum('brc,bjc->bjr', bent(toward, angle), points)
        return turned

    def _fine(self, inputs: Floats, sequence: bool, displacement: bool) -> ShapeBatch:
        applied = inputs * self._gain(inputs, displacement)
        if displacement:
            memory = self.model.arrays.fresh_memory() if sequence else None
            return pull_shapes(self.model, applied, memory=memory)
        settled = self.model.sequence(applied) if sequence else self.model.shapes(applied)
        return replace(settled, inputs=inputs)

    def _gain(self, inputs: Floats, displacement: bool = False) -> Floats:
        own = np.broadcast_to(1.0 + self.built.gain, inputs.shape)
        if self.damage.gain == 0.0:
            return np.asarray(own)
        return own * (1.0 + self.damage.gain * self._deviations(inputs, displacement)[:, :1])

    def _deviations(self, inputs: Floats, displacement: bool) -> Floats:
        return self.damage.deviations(inputs / self._scale[int(displacement)])


def make_plant(
    robot: RobotLike,
    hidden: Hidden | None = None,
    refine: int = 3,
    scatter: float = STIFFNESS_SCATTER,
    capstan: bool = True,
    seed: int = 0,
    catalogue: CatalogueLike | None = None,
    work: Workmanship | None = None,
) -> Plant:
    """
    Make the robot that a simulation or a mock really is.

    Parameters
    ----------
    robot : Robot, name, path, text or dict
        What its owner wrote down.
    hidden : mapping, optional
        Effect, or cause outside the catalogue (`hidden.CAUSES`), to its parameters; no parameters:
        the typical size. An effect that the owner lists has these values instead of the owner's.
    refine : int
        Cells per cell of the owner, where the cells may be divided (see this module).
    scatter : float
        Relative standard deviation of the stiffness from cell to cell [1].
    capstan : bool
        Friction at eyelets follows the exponential instead of the paper's quotient.
    seed : int
        Of the scatter.
    catalogue : Catalogue or paths, optional
        With the user's own effects.
    work : Workmanship, optional
        How well it is built, instead of `scatter`; default: the stiffness scatters, and no more.

    Raises
    ------
    EffectError
        An effect or parameter is unknown or out of its bounds.
    InputError
        `refine` or `scatter` are out of range.

    """
    robot, refine, seed = load_robot(robot), whole('refine', refine, 1), whole('seed', seed)
    scatter = number('scatter', scatter, 0.0, SCATTER_MAX)
    catalogue = load_catalogue(catalogue).sized(natural_sizes(robot))
    for name, values in robot.effects.items():
        described_effect(robot, catalogue, name, values)
    damage = Damage(robot, seed)
    effects = hide(robot, {} if hidden is None else hidden, catalogue, damage)
    if work is not None:
        built = Built.draw(robot, work, seed)
    else:
        random, built = np.random.default_rng(seed), Built.exact(robot)
        damage.stiffness *= 1.0 + scatter * random.normal(size=robot.cells).clip(-4, 4)
    parts = parts_per_cell(robot, effects, catalogue, refine)
    real = real_robot(robot, effects, catalogue, parts, damage, capstan, built)
    return Plant(robot, Model(real, plant_catalogue(catalogue)), parts, damage, built)
