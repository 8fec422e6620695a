"""A mistake of the set-up: what is said of it, and the data set without it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.rotations import rigid_fit, upright_fit
from ..comparison.noise import rms
from ..comparison.predict import Point, Predictor
from ..data import DataSet
from .decide import ERROR_SHARE_LEFT_LIMIT, FRAME_HARDLY_KNOWN_RAD, FRAME_LEVEL_RAD

Floats = npt.NDArray[np.float64]
UNIT_FACTORS = {
    1000.0: 'milli', 0.001: 'kilo', 9.81: 'kilograms of force', 1.0 / 9.81: 'newtons twice',
    4.448: 'pounds', 1.0 / 4.448: 'newtons as pounds', 10.0: 'a decimal point',
    0.1: 'a decimal point', 2.0: 'a double count', 0.5: 'half a count',
    25.4: 'inches', 1.0 / 25.4: 'millimetres as inches',
}  # fmt: skip
UNIT_WITHIN = 1.1  # [1] of a unit's factor: a ratio of distances that near to it means it


@dataclass(frozen=True)
class Mistake:
    """A mistake that would explain the error."""

    name: str
    sentence: str  # 'with ... the error falls'
    mend: str
    after: float  # [m] rms
    mended: DataSet | None = field(default=None, repr=False)  # without it, where that can be made
    doubtful: bool = False  # whether an effect may do much the same
    fitted: int = 0  # values that were fitted to the measurements to mend it
    free_input: int | None = None  # the input whose values these are
    beside: Callable[[Point], Mistake | None] | None = field(default=None, repr=False)  # effects
    rest: str = ''  # what becomes of the error that it leaves
    certain: bool = False  # whether measurements alone show it, whatever the model lacks

    @property
    def most(self) -> float:
        """Return what it may leave [m] at most: of what would be left if the arm stood still."""
        if self.mended is None:
            return math.inf
        places = self.mended.mean
        return ERROR_SHARE_LEFT_LIMIT * rms(places - np.nanmean(places, axis=0))

    def text(self, before: float) -> str:
        """Say it with the error before and after."""
        if not math.isfinite(before):
            return (
                f'the model finds no equilibrium; {self.sentence} it does, and is off by '
                f'{1e3 * self.after:.3g} mm{self.rest}: {self.mend}'
            )
        goes = 'falls' if self.after < before else 'goes'  # up, with an effect that acts as well
        return (
            f'{self.sentence} the error {goes} from {1e3 * before:.3g} to '
            f'{1e3 * self.after:.3g} mm{self.rest}: {self.mend}'
        )


def off(predictor: Predictor, measured: Floats, markers: Floats) -> float:
    """
    Return the rms [m] between measured and predicted postures (P, J, 3).

    Up to the tracker's frame where that was found with the model itself: a mistake turned it, too.
    """
    frame = _frame(predictor, measured, markers, predictor.parts[0].gravity)
    return rms(_moved(measured, frame) - markers)


Frame = tuple[Floats, Floats] | None  # rotation (3, 3) and shift (3,) [m]


def _frame(predictor: Predictor, measured: Floats, markers: Floats, down: Floats) -> Frame:
    """Return how the tracker's frame would lie, gravity `down`; None where it is known."""
    known, seen = predictor.robot.tolerances.get('rotation', 0.0), np.isfinite(measured)
    if known < FRAME_HARDLY_KNOWN_RAD or not np.isfinite(markers).all():
        return None
    points, onto = measured[seen.all(axis=2)], markers[seen.all(axis=2)]
    size = float(np.linalg.norm(down))
    if known < FRAME_LEVEL_RAD and size > 0.0:
        return upright_fit(points, onto, down / size)
    return rigid_fit(points, onto)


def _moved(positions: Floats, frame: Frame) -> Floats:
    return positions if frame is None else positions @ frame[0].T + frame[1]


def in_frame(predictor: Predictor, dataset: DataSet, predicted: Floats) -> DataSet:
    """Return a data set in the frame of the tracker that suits what is predicted best."""
    down = np.array(dataset.gravity_for(dataset.robot) or (0.0, 0.0, 0.0))
    frame = _frame(predictor, dataset.mean, predicted, down)
    if frame is None:
        return dataset
    return replace(dataset, positions=_moved(dataset.positions, frame))


def tried(
    predictor: Predictor,
    predicted: Floats | None,
    name: str,
    sentence: str,
    mend: str,
    doubtful: bool = False,
    dataset: DataSet | None = None,
    **changes: Any,
) -> Iterator[Mistake]:
    """Yield a mistake and the data set without it, in the frame that suits what is predicted."""
    if predicted is None or not np.isfinite(predicted).all():
        return
    made = replace(dataset or predictor.dataset, **{'robot': predictor.robot, **changes})
    made = in_frame(predictor, made, predicted)
    yield Mistake(name, sentence, mend, rms(made.mean - predicted), made, doubtful)


def times(factor: float) -> str:
    """Say by what something is multiplied, or divided."""
    return f'multiplied by {factor:.4g}' if factor >= 1.0 else f'divided by {1.0 / factor:.4g}'


def as_unit(factor: float) -> float:
    """Return the factor of a unit that is near, or the factor as it is."""
    near = min(UNIT_FACTORS, key=lambda one: abs(math.log(factor / one)))
    return near if abs(math.log(factor / near)) < math.log(UNIT_WITHIN) else factor
