"""Measurements of a plant, as a tracker and load cells would give them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..data import DataSet, Marker, default_markers
from ..data.joining import divide
from ..data.visits import Split, split_by_order
from .plant import Plant

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SimulatedNoise:
    """One standard deviation each."""

    position: float = 2e-4  # [m] per coordinate and trial
    setting: float = 0.002  # [1] of a tendon's input, shared by the trials of a posture
    trial: float = 0.004  # [1] of a tendon's input, per trial

    def __post_init__(self) -> None:
        """
        Refuse what is no standard deviation.

        Raises
        ------
        InputError
            A value is negative, or so large that it must be in another unit.

        """
        for key, high in (('position', 0.1), ('setting', 0.5), ('trial', 0.5)):
            value = getattr(self, key)
            if not 0.0 <= value <= high:
                raise InputError(f'noise: {key}: expected a number from 0 to {high}, got {value}')


def simulate(
    plant: Plant,
    inputs: npt.ArrayLike,
    *,
    noise: SimulatedNoise | None = None,
    trials: int = 5,
    seed: int = 0,
    markers: Sequence[Marker] | None = None,
    postures: Sequence[str] = (),
    input: str = 'tension',
    path: str = 'from_straight',
    declare: bool = True,
) -> DataSet:
    """
    Return a data set of a plant whose robot description is the owner's.

    Parameters
    ----------
    plant : Plant
        The real robot.
    inputs : (P, m) [N] or [m]
        What is set; nan = slack, with `input` 'displacement'.
    noise : SimulatedNoise, optional
        Of tracker and tendons.
    trials : int
        Trials of every posture.
    seed : int
        Of the noise.
    markers : sequence of Marker, optional
        Default: one per cell.
    postures : sequence of str, optional
        Names; default '0' to 'P-1'.
    input, path : str
        As in a data set.
    declare : bool
        Whether the data set tells the size of the noise.

    Raises
    ------
    InputError, NoEquilibriumError
        The plant cannot take these inputs.

    """
    noise, robot = noise or SimulatedNoise(), plant.robot
    rows, random = _rows(plant, inputs, trials), np.random.default_rng(seed)
    made = tuple(markers or default_markers(robot))
    names, pulls = tuple(postures or map(str, range(len(rows)))), input == 'displacement'
    visits = _order(random, names, trials) if path == 'visits' else None
    if visits is not None:
        used = rows[visits.command[visits.posture]] * _visit_factors(random, noise, visits, rows)
        positions = _placed(visits, _seen(plant, used[None], made, True, pulls))
    else:
        used = rows * _factors(random, noise, trials, rows.shape)  # (Q, P, m)
        positions = _seen(plant, used, made, path == 'sequence', pulls).swapaxes(0, 1)
    positions = positions + random.normal(0.0, noise.position, positions.shape)
    dataset = DataSet(
        name=f'simulated {robot.name}',
        robot=robot,
        markers=made,
        postures=names,
        inputs=rows,
        positions=positions,
        input=input,
        path='sequence' if visits else path,
        gravity=robot.gravity,
        position_noise=noise.position or None if declare else None,
        setting_noise=noise.setting if declare else 0.0,
        trial_noise=noise.trial if declare else 0.0,
    )
    return dataset if visits is None else divide(dataset, visits, _own(visits))


def _order(random: np.random.Generator, names: Sequence[str], trials: int) -> Split:
    """Visit every posture as many times as there are trials, in a random order."""
    order = random.permutation(np.repeat(np.arange(len(names)), trials))
    trial = np.array([int((order[:v] == command).sum()) for v, command in enumerate(order)])
    return split_by_order(names, order, trial, np.ones(len(order), dtype=bool))


def _own(split: Split) -> npt.NDArray[np.bool_]:
    """Tell which trials (P, Q) each posture has."""
    own = np.zeros((len(split.postures), int(split.visits.trials.max()) + 1), dtype=bool)
    own[split.posture, split.visits.trials] = True
    return own


def _placed(split: Split, seen: Floats) -> Floats:
    """Return markers (1, V, J, 3) of the visits by command and trial, (C, Q, J, 3)."""
    command, trial = split.command[split.posture], split.visits.trials
    places = np.empty((int(command.max()) + 1, int(trial.max()) + 1, *seen.shape[2:]))
    places[command, trial] = seen[0]
    return places


def _visit_factors(
    random: np.random.Generator, noise: SimulatedNoise, split: Split, rows: Floats
) -> Floats:
    """Factors (V, m) on what was set; never below zero."""
    setting = noise.setting * random.normal(size=(len(split.postures), rows.shape[1]))
    trial = noise.trial * random.normal(size=(len(split.posture), rows.shape[1]))
    return np.maximum((1.0 + setting[split.posture]) * (1.0 + trial), 0.0)


def _rows(plant: Plant, inputs: npt.ArrayLike, trials: int) -> Floats:
    names = plant.robot.inputs
    rows = np.asarray(inputs, dtype=float)
    if trials < 1:
        raise InputError(f'trials: expected at least 1, got {trials}')
    if rows.ndim != 2 or rows.shape[1] != len(names) or not len(rows):
        raise InputError(
            f'postures: expected (postures, {len(names)}) numbers for {", ".join(names)}, '
            f'got shape {rows.shape}'
        )
    return rows


def _seen(
    plant: Plant, inputs: Floats, markers: Sequence[Marker], sequence: bool, displacement: bool
) -> Floats:
    """Return markers (Q, P, J, 3) [m] under inputs (Q, P, m), without the tracker's noise."""
    points = np.array([marker.arc_length for marker in markers])
    offsets = np.array([marker.offset for marker in markers])
    if sequence:
        return np.array(
            [plant.markers(one, points, offsets, True, displacement) for one in inputs]
        )
    flat = inputs.reshape(-1, inputs.shape[2])
    seen = plant.markers(flat, points, offsets, displacement=displacement)
    return seen.reshape(*inputs.shape[:2], len(markers), 3)


def _factors(
    random: np.random.Generator, noise: SimulatedNoise, trials: int, shape: tuple[int, ...]
) -> Floats:
    """Factors (Q, P, m) on what was set; never below zero."""
    setting = noise.setting * random.normal(size=shape)
    trial = noise.trial * random.normal(size=(trials, *shape))
    return np.maximum((1.0 + setting) * (1.0 + trial), 0.0)
