"""
Measurements of a plant, as a tracker and load cells would give them.

As a data set, and as a laboratory logs it: a wide table over time, in the tracker's own frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import Progress, choice, listener, names, number, refusal, whole
from ..common.files import new_file
from ..common.rotations import about, towards
from ..data import DataSet, Marker, default_markers
from ..data.arrays import markers_of
from ..data.dataset import INPUTS, LIMITS, PATHS
from ..data.visits import split_by_order
from ..robot import RobotLike
from ..robot.inputs import disturbed, input_rows
from .plant import Plant, make_plant


@dataclass(frozen=True)
class SimulatedNoise:
    """One standard deviation each."""

    position: float = 2e-4  # [m] per coordinate and trial
    setting: float = 0.002  # [1] of an input (`noise_scales`), shared by the trials of a posture
    trial: float = 0.004  # [1] of an input, per trial

    def __post_init__(self) -> None:
        """
        Refuse what is no standard deviation.

        Raises
        ------
        InputError
            A value is negative, or so large that it must be in another unit.

        """
        for key, value in vars(self).items():
            number(f'noise: {key}', value, 0.0, *LIMITS[f'{key}_noise'])


def simulate(
    plant: Plant | RobotLike,
    inputs: Any,
    *,
    noise: SimulatedNoise | None = None,
    trials: int = 5,
    seed: int = 0,
    markers: Sequence[Marker | float] | None = None,
    postures: Sequence[str] = (),
    input: str = 'tension',
    path: str = 'from_straight',
    declare: bool = True,
    progress: Progress | None = None,
) -> DataSet:
    """
    Return a data set of a plant whose robot description is the owner's.

    Parameters
    ----------
    plant : Plant
        The real robot, of `make_plant`; a robot stands for a plant that hides nothing.
    inputs : (P, m) [N] or [m], DataFrame, or dict of columns
        What is set, by name or in the order of `robot.inputs`; nan = slack, with `input`
        'displacement'.
    noise : SimulatedNoise, optional
        Of tracker and tendons.
    trials : int
        Trials of every posture.
    seed : int
        Of the noise.
    markers : sequence of Marker or arc lengths [m], optional
        Default: one per cell.
    postures : sequence of str, optional
        Names; default '0' to 'P-1'.
    input, path : str
        As in a data set.
    declare : bool
        Whether the data set declares the size of the noise.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    InputError, NoEquilibriumError
        The plant cannot take these inputs.

    """
    if not isinstance(plant, Plant):
        plant = make_plant(plant)
    show, noise = listener(progress), SimulatedNoise() if noise is None else noise
    robot, trials = plant.robot, whole('trials', trials, 1)
    if not isinstance(noise, SimulatedNoise):
        raise refusal('noise', 'a SimulatedNoise', noise)
    kind, _ = choice('input', input, INPUTS), choice('path', path, PATHS)
    rows = input_rows(robot, inputs, kind, 'postures')
    if not len(rows):
        raise refusal('postures', 'at least one row of inputs', inputs)
    random = np.random.default_rng(whole('seed', seed))
    chosen = default_markers(robot)
    if markers is not None:
        named = names('simulate: markers', (), len(markers) if hasattr(markers, '__len__') else 0)
        chosen = markers_of(markers, named, 'simulate')
    labels, pulls = names('postures', postures, len(rows)), kind == 'displacement'
    points = np.array([marker.arc_length for marker in chosen])
    offsets = np.array([marker.offset for marker in chosen])

    def observed(inputs: Floats, sequence: bool) -> Floats:
        """Return markers (Q, P, J, 3) [m] under inputs (Q, P, m), without noise of the tracker."""
        seen = []
        for index, batch in enumerate(inputs):
            show('trials', index, len(inputs))
            seen.append(plant.markers(batch, points, offsets, sequence, pulls))
        return np.array(seen)

    split = None
    if path == 'visits':  # every posture as many times as there are trials, in a random order
        command = random.permutation(np.repeat(np.arange(len(labels)), trials))
        trial = np.array([int((command[:v] == one).sum()) for v, one in enumerate(command)])
        split = split_by_order(labels, command, trial, np.ones(len(command), dtype=bool))
        setting = random.normal(size=(len(split.postures), rows.shape[1]))[split.posture]
        each = noise.trial * random.normal(size=rows[command].shape)
        used = disturbed(robot, rows[command], kind, noise.setting * setting, each)
        positions = np.empty((len(rows), trials, len(chosen), 3))
        positions[command, trial] = observed(used[None], True)[0]
    else:
        setting, trial = random.normal(size=rows.shape), random.normal(size=(trials, *rows.shape))
        used = disturbed(robot, rows, kind, noise.setting * setting, noise.trial * trial)
        positions = observed(used, path == 'sequence').swapaxes(0, 1)
    positions = positions + random.normal(0.0, noise.position, positions.shape)
    dataset = DataSet(
        name=f'simulated {robot.name}',
        robot=robot,
        markers=chosen,
        postures=labels,
        inputs=rows,
        positions=positions,
        input=input,
        path='sequence' if split else path,
        gravity=robot.gravity,
        position_noise=noise.position or None if declare else None,
        setting_noise=noise.setting if declare else 0.0,
        trial_noise=noise.trial if declare else 0.0,
    )
    return dataset if split is None else dataset.by_origin(split, split.visits.trials)


@dataclass(frozen=True)
class Laboratory:
    """How a recording is made."""

    rate: float = 50.0  # [1/s]
    trials: int = 3  # of every posture
    hold: float = 2.0  # [s] that a posture stands, and the rest between two
    move: float = 0.5  # [s]
    turned: float = float(np.radians(30.0))  # [rad] of the tracker about the vertical
    shift: tuple[float, float, float] = (0.12, 0.15, -0.06)  # [m] of the base, 200 mm off
    lost: float = 0.02  # [1] fraction of the frames without a marker, in bursts
    frame_noise: float = 1e-4  # [m] per coordinate and frame
    cell_noise: float = 0.004  # [N] of the load cells, per frame
    slips: int = 1  # trials in which a tendon slips
    slipped: float = 0.7  # [1] fraction of the largest tension that then arrives


def tracker_frame(gravity: Sequence[float] | None, lab: Laboratory) -> tuple[Floats, Floats]:
    """Return rotation (3, 3) and shift (3,) [m] from the base to a levelled tracker, y up."""
    down = np.array([0.0, 0.0, -1.0] if gravity is None else gravity, dtype=float)
    size = float(np.linalg.norm(down))
    above = np.array([0.0, 0.0, 1.0]) if size == 0.0 else -down / size
    up = np.array([0.0, 1.0, 0.0])
    return about(1, lab.turned) @ towards(up) @ towards(above).T, np.array(lab.shift)


def raw_table(
    plant: Plant,
    inputs: npt.ArrayLike,
    *,
    lab: Laboratory | None = None,
    noise: SimulatedNoise | None = None,
    seed: int = 0,
    which: int = 0,
    markers: Sequence[Marker] | None = None,
    progress: Progress | None = None,
) -> tuple[list[str], Floats]:
    """
    Return names and values (R, 1 + m + 3 J) of a table: s, N and mm.

    The arm rests between all postures; the numbers of markers are shuffled, and the frame is that
    of a tracker with y up.

    Parameters
    ----------
    plant : Plant
        The real robot.
    inputs : (P, m) [N]
        Tensions of the postures.
    lab : Laboratory, optional
        How it is recorded.
    noise : SimulatedNoise, optional
        Of tracker and tendons, from trial to trial.
    seed : int
        Of the noise, and of the numbers of the markers.
    which : int
        Another recording of the same arm by the same tracker.
    markers : sequence of Marker, optional
        Default: one per cell.
    progress : callable, optional
        Called with (what, done, total).

    """
    lab, random = lab or Laboratory(), np.random.default_rng([seed, 7, which])
    rows = np.asarray(inputs, dtype=float)
    rest = np.full((1, rows.shape[1]), plant.robot.tension_limits[0])
    dataset = simulate(
        plant,
        np.vstack([rest, rows]),
        noise=noise,
        trials=lab.trials,
        seed=2 * seed + which,
        markers=markers,
        progress=progress,
    )
    places = np.array(dataset.positions)  # (1 + P, Q, J, 3) [m], rest first
    for _ in range(lab.slips):
        p, q = int(random.integers(len(rows))), int(random.integers(lab.trials))
        slipped = rows[p].copy()
        slipped[slipped.argmax()] *= lab.slipped
        places[p + 1, q] = plant.markers(slipped[None], dataset.arc_lengths, dataset.offsets)[0]
    stops = [(0, 0)]  # (posture, trial), with a rest after each
    for q, p in product(range(lab.trials), range(1, len(rows) + 1)):
        stops += [(p, q), (0, q)]
    values = over_time([np.append(dataset.inputs[p], places[p, q].ravel()) for p, q in stops], lab)
    m, J = rows.shape[1], len(dataset.markers)
    rotation, shift = tracker_frame(plant.robot.gravity, lab)
    tracked = values[:, m:].reshape(-1, J, 3) @ rotation.T + shift
    tracked += random.normal(0.0, lab.frame_noise, tracked.shape)
    burst = max(round(0.5 * lab.rate), 1)  # [frames] in half a second, in which a marker is lost
    bursts = round(lab.lost * len(values) / burst)
    for j in range(J):
        for start in random.integers(0, len(values), bursts):
            tracked[start : start + burst, j] = np.nan
    shuffled = np.random.default_rng([seed, 8]).permutation(J)
    columns = [
        np.arange(len(values)) / lab.rate,
        values[:, :m] + random.normal(0.0, lab.cell_noise, (len(values), m)),
        1e3 * tracked[:, shuffled].reshape(len(values), -1),
    ]
    headings = ['time_s', *(f'T{i + 1} [N]' for i in range(m))]
    headings += [f'marker_{i + 1:02d}_{axis} [mm]' for i in range(J) for axis in 'xyz']
    return headings, np.column_stack(columns)


def over_time(stops: Sequence[Floats], lab: Laboratory) -> Floats:
    """Hold at every stop and go smoothly to the next."""
    still, moving = round(lab.hold * lab.rate), round(lab.move * lab.rate)
    fraction = 0.5 - 0.5 * np.cos(np.pi * (np.arange(moving) + 1.0) / (moving + 1.0))
    parts = []
    for start, end in zip(stops, [*stops[1:], stops[-1]], strict=True):
        parts += [np.tile(start, (still, 1)), start + fraction[:, None] * (end - start)]
    return np.concatenate(parts[:-1])


def write_table(path: str | Path, names: Sequence[str], values: Floats) -> None:
    """Write a table as CSV, 0.001 of each unit; a missing value is empty."""
    with new_file(Path(path)) as draft, draft.open('w', encoding='utf-8') as file:
        file.write(','.join(names) + '\n')
        for row in np.round(values, 3).tolist():
            file.write(','.join('' if v != v else f'{v:.10g}' for v in row) + '\n')
