"""How settled postures follow small moves: parameters, and tensions that hold wire pulls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..model.arrays import KernelArrays
from ..model.derivatives import TENSION_STEP
from ..model.forward import ForwardModel

Floats = npt.NDArray[np.float64]
TAUT_FROM_N = 1e-6  # [N] tension of a wire that holds its length


@dataclass(frozen=True)
class Tangent:
    """How q parameters move P settled postures with J markers."""

    markers: Floats  # (q, P, J, 3) [m per unit]
    states: Floats  # (q, P, 3n) [rad per unit]
    tensions: Floats  # (q, P, m) [N per unit]


class Freed:
    """A parameter that moves a little to both sides, as far as its bounds let it."""

    def __init__(
        self,
        arrays: KernelArrays,
        ends: tuple[float, float],
        count: int,
        set_to: Callable[[float], None],
    ) -> None:
        """Note what `set_to` makes of the model's arrays at both ends, for `count` postures."""
        self.down, self.up = (np.full(count, end) for end in ends)
        self._moved: tuple[npt.NDArray[Any], ...] = (
            arrays.values, arrays.on, arrays.cells, arrays.gravity, arrays.offset, arrays.helix,
        )  # fmt: skip
        self._kept: dict[float, list[npt.NDArray[Any]]] = {}
        for side in (*ends, 0.0):
            set_to(side)
            self._kept[side] = [array.copy() for array in self._moved]

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N]: they stay."""
        return inputs

    @contextmanager
    def made(self, model: ForwardModel, side: Floats) -> Iterator[None]:
        """Let the parameter be on one side while the block runs."""
        self._put(float(side[0]))
        try:
            yield
        finally:
            self._put(0.0)

    def _put(self, side: float) -> None:
        for array, kept in zip(self._moved, self._kept[side], strict=True):
            array[:] = kept


class Shifted:
    """The same of a parameter of an effect, that the model's arrays hold as it is now."""

    def __init__(
        self,
        arrays: KernelArrays,
        ends: tuple[float, float],
        count: int,
        effect: str,
        parameter: str,
        columns: slice,
    ) -> None:
        """Note where its values lie, and how far it moves in `count` postures."""
        self.down, self.up = (np.full(count, end) for end in ends)
        self._arrays, self._effect = arrays, effect
        self._values = arrays.values[arrays.layout.rows[effect, parameter], columns]
        self._here = self._values.copy()

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N]: they stay."""
        return inputs

    @contextmanager
    def made(self, model: ForwardModel, side: Floats) -> Iterator[None]:
        """Let the parameter be on one side, its effect on, while the block runs."""
        on = self._arrays.on.copy()
        self._arrays.act(self._effect)
        self._values[:] = self._here + side[0]
        try:
            yield
        finally:
            self._values[:], self._arrays.on[:] = self._here, on


class Pulled:
    """An input tension that moves a little to both sides, never below zero."""

    def __init__(self, j: int, tensions: Floats) -> None:
        """Take the index of the input and its tensions (b,) [N]."""
        self.j, step = j, np.full(len(tensions), TENSION_STEP)
        self.up, self.down = step, -np.minimum(step, tensions)

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N] of one side."""
        moved = inputs.copy()
        moved[:, self.j] += side
        return moved

    def made(self, model: ForwardModel, side: Floats) -> AbstractContextManager[None]:
        """Leave the model as it is."""
        return nullcontext()


def held(tensions: Floats, seen: Floats, states: Floats, q: int) -> tuple[Floats, Floats, Floats]:
    """
    Let tensions (b, m) [N] answer q parameters so that the pulls of taut wires stay.

    `seen` (q + m, b, m + 3 J) begins with the pulls, `states` is (q + m, b, 3n); the last m by the
    tensions. Returns both for the parameters alone, and the answers (q, b, m) [N per unit].
    """
    m = tensions.shape[1]
    answers = np.zeros((q, len(tensions), m))
    for b, own in enumerate(tensions):
        taut = np.flatnonzero(own > TAUT_FROM_N)
        by_tension = seen[q:, b, :m][np.ix_(taut, taut)]
        answers[:, b, taut] = -seen[:q, b, taut] @ np.linalg.pinv(by_tension, rcond=1e-9)
    return (
        seen[:q] + np.einsum('qbm,mbx->qbx', answers, seen[q:]),
        states[:q] + np.einsum('qbm,mbx->qbx', answers, states[q:]),
        answers,
    )
