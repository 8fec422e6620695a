"""The shapes of a model in the postures of a data set, or the reason why there is none."""

from __future__ import annotations

from ..data import DataSet
from ..model.model import Model
from ..model.pulls import pull_shapes
from ..model.shape import ShapeBatch
from .predict import mean_inputs


def equilibria(dataset: DataSet, model: Model) -> ShapeBatch:
    """
    Return the shapes of the postures, reached as the data set's were.

    Raises
    ------
    NoEquilibriumError, InputError
        With the posture and what acts in it.

    """
    inputs = mean_inputs(dataset)
    carry = model.remembers and dataset.path == 'sequence'
    if dataset.input == 'displacement':
        memory = model.arrays.fresh_memory() if carry else None
        return pull_shapes(model, inputs, memory=memory)
    return model.sequence(inputs) if carry else model.shapes(inputs)
