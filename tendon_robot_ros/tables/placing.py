"""Measurements in a tracker's frame to a data set in the base's, and what is to be looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..common.errors import DataSetError
from ..common.units import STANDARD_GRAVITY
from ..common.words import listed, mm
from ..comparison.outliers import Outliers, find_outliers
from ..comparison.predict import Predictor
from ..data import DataSet
from ..effects import Catalogue
from .recipe import Recipe
from .registration import TrackerFrame, find_frame, gravity_of

TRIALS_SHOWN = 6  # of those that were left out, so that the line is read
UNKNOWN_SHARE = 0.1  # [1] of the arm, by which its tip is off for the frame alone: of no use then
APART_RAD = 0.3  # [rad] 17° between gravity as the robot says it and as the tracker does


@dataclass(frozen=True)
class Placed:
    """A data set in the base frame, and how it came there."""

    dataset: DataSet
    frame: TrackerFrame
    left_out: tuple[tuple[str, str], ...]  # posture, trial that the others contradict
    gravity_look: tuple[str, ...]  # what of gravity asks for a look

    @property
    def frame_look(self) -> list[str]:
        """Say what contradicts the frame."""
        frame, length, said = self.frame, self.dataset.robot.length, []
        known = frame.tolerances(length)
        if known and max(known['position'], known['rotation'] * length) > UNKNOWN_SHARE * length:
            said.append(
                f'the frame is known to {mm(known["position"], 2)} and '
                f'{np.degrees(known["rotation"]):.2g}° only, more than a tenth of the arm at its '
                'tip: are markers, inputs and units right? (--frame base, where the table is in '
                'the base frame)'
            )
        if frame.is_mirrored:
            said.append(
                f'a left-handed frame would fit better ({mm(frame.mirrored)} instead of '
                f'{mm(frame.free)}): an axis has the wrong sign, or two inputs are swapped'
            )
        elif frame.is_contradicted:
            said.append(
                f'free to turn, the frame would fit to {mm(frame.free)} instead of '
                f'{mm(frame.residual)}: a load that the description lacks, or is what is said of '
                'it (up, gravity, frame) not right? (--frame model turns it freely)'
            )
        return said

    @property
    def look(self) -> list[str]:
        """Say what asks for a look."""
        return [*self.gravity_look, *self.frame_look]

    @property
    def dropped(self) -> list[str]:
        """Say which trials were left out."""
        if not self.left_out:
            return []
        names = [f'posture {posture} trial {trial}' for posture, trial in self.left_out]
        more = len(names) - TRIALS_SHOWN
        told = listed(names if more < 2 else [*names[:TRIALS_SHOWN], f'{more} more'])
        return [f'{told}: the other trials contradict (a slipped tendon?)']


def place(raw: DataSet, recipe: Recipe, catalogue: Catalogue) -> Placed:
    """
    Find the tracker's frame, and leave out what its other trials contradict.

    Parameters
    ----------
    raw : DataSet
        In the tracker's frame.
    recipe : Recipe
        Says `up`, `frame` and `leave_out`, as far as they are known.
    catalogue : Catalogue

    Raises
    ------
    DataSetError, InputError
        The model has no equilibrium, or the method needs what is not there.

    """
    robot, choice = raw.robot, recipe.frame

    def placed(dataset: DataSet) -> tuple[DataSet, TrackerFrame]:
        frame = find_frame(dataset, Predictor(dataset, robot, catalogue), choice, recipe.up)
        positions = dataset.positions @ frame.rotation.T + frame.shift
        return replace(dataset, positions=positions.round(9)), frame

    if recipe.leave_out is not None:
        pairs = recipe.leave_out
        dataset, frame = placed(_without(raw, pairs))
    else:
        dataset, frame = placed(raw)
        outliers = find_outliers(Predictor(dataset, robot, catalogue), {})
        pairs = tuple(
            (raw.postures[p], raw.trial_names[q]) for p, q in np.argwhere(outliers.trials).tolist()
        )
        if pairs:
            dataset, frame = placed(_without(raw, pairs))
    gravity, look = _gravity(dataset, frame, recipe)
    known = frame.tolerances(robot.length)  # so that a diagnosis may move it
    if choice.rotation is not None:  # a frame that is given comes with its tolerances
        known |= {key: robot.tolerances[key] for key in known if key in robot.tolerances}
    robot = replace(dataset.robot, tolerances={**dataset.robot.tolerances, **known})
    return Placed(replace(dataset, gravity=gravity, robot=robot), frame, pairs, look)


def _without(dataset: DataSet, pairs: Sequence[tuple[str, str]]) -> DataSet:
    out = np.zeros(dataset.trial_mask.shape, dtype=bool)
    for posture, trial in pairs:
        if posture not in dataset.postures or trial not in dataset.trial_names:
            raise DataSetError(
                f'{dataset.name}: leave_out',
                f'there is no posture {posture!r}, trial {trial!r}',
                'take that line out',
            )
        out[dataset.postures.index(posture), dataset.trial_names.index(trial)] = True
    nothing = np.zeros((*out.shape, len(dataset.markers)), dtype=bool)
    return Outliers(nothing, out, np.zeros(nothing.shape)).without(dataset)


def _gravity(
    dataset: DataSet, frame: TrackerFrame, recipe: Recipe
) -> tuple[tuple[float, float, float] | None, tuple[str, ...]]:
    """Return gravity as the tracker tells it where the robot does not, and what contradicts."""
    known = dataset.robot.gravity
    if recipe.up is None:
        told = 'where down is: say --up (y for OptiTrack, z for most others)'
        return None, (f'nothing says {told}',) if known is None else ()
    seen = gravity_of(frame, recipe.up)
    if known is None or not np.linalg.norm(known):
        at = ', '.join(f'{g:.2g}' for g in seen)
        return (seen if known is None else None), (
            f'up is told ({recipe.up}), but the description '
            + (
                'has no gravity: the tracker is not levelled by it, and gravity is taken as '
                f'[{at}] m/s² from the frame as found; say where the arm points (gravity in the '
                'description, new-robot asks for it)'
                if known is None
                else 'says that gravity is zero: up is not used, and no weight is looked for'
            ),
        )
    cosine = float(np.dot(known, seen) / (STANDARD_GRAVITY * np.linalg.norm(known)))
    apart = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    if apart < APART_RAD:
        return None, ()
    return None, (
        f'gravity of the robot and up of the tracker are {np.degrees(apart):.0f}° apart; '
        "the robot's counts",
    )
