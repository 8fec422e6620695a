"""What a model with freed parameters predicts for the postures and markers of a data set."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..data import DataSet
from ..effects import Catalogue, Effect, Parameter
from ..exceptions import NoEquilibriumError, TendonRobotError
from ..model.model import TOLERANCE, Model
from ..robot import Robot

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Free:
    """One parameter of an effect (of one section, where it has its own) that a fit may move."""

    effect: str
    parameter: Parameter
    section: int | None = None
    label: str = ''  # the section's name

    @property
    def key(self) -> str:
        """Name within its effect, as reports print it."""
        return f'{self.parameter.name}[{self.label}]' if self.label else self.parameter.name


def free_parameters(effect: Effect, robot: Robot) -> tuple[Free, ...]:
    """All parameters of an effect; one per section where sections have their own."""
    frees: list[Free] = []
    for parameter in effect.parameters:
        if parameter.per_section:
            frees += [
                Free(effect.name, parameter, i, section.name)
                for i, section in enumerate(robot.sections)
            ]
        else:
            frees.append(Free(effect.name, parameter))
    return tuple(frees)


Point = Mapping[Free, float]


class Predictor:
    """A model whose parameters move; one per thread."""

    def __init__(self, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> None:
        """Build the model under the gravity of the data set."""
        self.dataset = dataset
        self.robot = replace(robot, gravity=dataset.gravity_for(robot))
        self.model = Model(self.robot, catalogue)
        arrays = self.model.arrays
        self._values, self._on, self._cells = (
            arrays.values.copy(),
            arrays.on.copy(),
            arrays.cells.copy(),
        )
        self.inputs = mean_inputs(dataset)
        self._bend: Floats | None = None
        self.bend: Floats | None = None  # of the last prediction
        self._tensions: Floats | None = None

    def value(self, free: Free) -> float:
        """Value that the description gives a parameter (neutral where it is not listed)."""
        return float(
            self._values[
                self.model.arrays.layout.rows[free.effect, free.parameter.name], free.section or 0
            ]
        )

    def markers(
        self,
        point: Point,
        inputs: Floats | None = None,
        stiffness: Floats | None = None,
        near: Floats | None = None,
    ) -> Floats | None:
        """
        Predict marker positions (P, J, 3) [m]; None where a posture has no equilibrium.

        Parameters
        ----------
        point : mapping
            Values of freed parameters; all others as described.
        inputs : (P, m) [N] or [m], optional
            Instead of the data set's.
        stiffness : (n,) [1], optional
            Factor on the bending stiffness of every cell.
        near : (P, n, 2) [rad], optional
            Bends to start from (`bend` of a neighbouring point); default: those as described.

        """
        arrays = self.model.arrays
        arrays.values[:], arrays.on[:], arrays.cells[:] = self._values, self._on, self._cells
        if stiffness is not None:
            arrays.cells[:, 1] *= stiffness
        for free, value in point.items():
            arrays.set(free.effect, free.parameter.name, free.section, value)
        given = self.inputs if inputs is None else inputs
        shapes = (
            self._pulled(given)
            if self.dataset.input == 'displacement'
            else self._pull(given, near)
        )
        if shapes is None:
            return None
        self.bend = shapes.bend
        placed = shapes.markers(self.dataset.arc_lengths, self.dataset.offsets)
        return self.model.measured(placed)

    def _pull(self, inputs: Floats, near: Floats | None):  # type: ignore[no-untyped-def]
        """Shapes under tensions; None without equilibrium."""
        if self.model.remembers:
            return self._remembering(inputs)
        guess = self._bend if near is None else near
        batch, changes = self.model.solve(inputs, guess)
        if guess is not None and not (changes < TOLERANCE).all():
            batch, changes = self.model.solve(inputs)
        if not (changes < TOLERANCE).all():
            return None
        if self._bend is None:  # the first shapes; later ones would make results depend on order
            self._bend = batch.bend
        return batch

    def _remembering(self, inputs: Floats):  # type: ignore[no-untyped-def]
        carry = self.dataset.path == 'sequence'
        batch, changes = self.model.solve(inputs, carry=carry)
        return batch if (changes < TOLERANCE).all() else None

    def _pulled(self, pulls: Floats):  # type: ignore[no-untyped-def]
        """Shapes under wire pulls, from the last tensions; None where there are none."""
        from ..model.pulls import pull_shapes

        try:
            batch = pull_shapes(self.model, pulls, self._tensions, self._bend)
        except (NoEquilibriumError, TendonRobotError):
            return None
        self._tensions, self._bend = batch.inputs, batch.bend
        return batch


def mean_inputs(dataset: DataSet) -> Floats:
    """Return the inputs (P, m) of the postures, the mean of the trials' where measured."""
    if dataset.trial_inputs is None:
        return np.array(dataset.inputs)
    seen = dataset.trial_mask[..., None]
    total = np.where(seen, dataset.trial_inputs, 0.0).sum(axis=1)
    counts = seen.sum(axis=1)
    return np.where(counts > 0, total / np.maximum(counts, 1), dataset.inputs)


def frees_of(names: Iterable[str], catalogue: Catalogue, robot: Robot) -> Iterator[Free]:
    """Yield the free parameters of several effects."""
    for name in names:
        yield from free_parameters(catalogue[name], robot)
