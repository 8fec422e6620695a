"""Measured postures as frozen arrays; a missing value is NaN (SI units)."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.arrays import Bools, Floats, Ints, evenly
from ..common.errors import DataSetError, InputError, choice, names, number, refusal
from ..common.results import TextResult, make_frame
from ..common.words import counted, listing, postures
from ..robot import Robot, RobotLike, load_robot
from ..robot.inputs import finite, input_rows
from .arrays import (
    PLAUSIBLE_FACTOR,
    POSITION,
    QUATERNION,
    Marker,
    Vector,
    place_markers,
    read_frame,
    too_tense,
)
from .visits import Split, Visits, corners, remembered

Known = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value

EXPECTED = 'a DataSet, its folder, a recording, or a list of these'
FRAME = ' (DataSet.from_frame makes one of a tidy table, import_table of one over time)'
INPUTS = ('tension', 'displacement')
# [1] of the largest input, below which an arm is at rest, because pretension holds its wires taut
REST_FRACTION = 0.05
# [m] and [1] largest noise and accuracy, because what is larger is in another unit
LIMITS = {
    'position_noise': (0.1, 'm'),
    'accuracy': (0.1, 'm'),
    'setting_noise': (0.5, '1'),
    'trial_noise': (0.5, '1'),
}
# [1] blocks of time of a sequence, whose neighbours are alike, that are left out at once, because
# a longer block has whole motions
BLOCKS_MAX = 32
LOADINGS = ('from_straight', 'sequence')  # every trial of a posture has the same history
PATHS = (*LOADINGS, 'visits')
READINGS = ('positions', 'orientations')  # arrays (P, Q, J, n)


def names_in(name: str) -> list[str]:
    """Return the names of the data sets that one of this name was joined from, else the name."""
    try:
        return [name] if Path(name).exists() else shlex.split(name)
    except ValueError:  # a quotation mark in it
        return [name]


def at_rest(inputs: Floats) -> Bools:
    """Return which postures (P,) of inputs (P, m) [N] or [m] are at rest; NaN is a slack wire."""
    sizes = np.abs(np.nan_to_num(inputs)).max(axis=1)
    return np.asarray(sizes < REST_FRACTION * sizes.max())


def extent(trials: Ints, inputs: Floats, markers: int) -> str:
    """
    Say how much was measured: '12 postures (one at rest) x 3 to 5 trials x 15 markers'.

    Of postures with trials (P,) and inputs (P, m) [N] or [m]; those without a trial do not count.
    """
    measured = trials > 0
    few, many = int(trials[measured].min()), int(trials.max())
    each = counted(many, 'trial')
    parts = [postures(int(measured.sum()), int(at_rest(inputs)[measured].sum()))]
    parts += [each if few == many else f'{few} to {each}', counted(markers, 'marker')]
    return ' x '.join(parts)


@dataclass(frozen=True)
class Part:
    """Known loads while some of the postures were measured: gravity and effects."""

    name: str  # of the data set that they come from
    gravity: Vector | None  # [m/s²], base frame
    known: Known


@dataclass(frozen=True, eq=False)
class EarlierRecording:
    """
    An earlier recording of the same arm.

    What the arm deviated from its description there is taken off the positions of a data set, so
    that only what has changed since is left.
    """

    name: str  # of the recording
    error: float  # [m] rms at the tip of what the arm deviated there
    doubt: Floats  # (P,) [m] rms at the tip of what it leaves open for each posture
    noise: Floats  # (P,) [m] 1 sd per coordinate of the tracker in what is taken off
    spread: Mapping[str, Floats]  # kind -> `Fit.spread` (members, r) of imperfections found there
    lacked: tuple[str, ...] = ()  # effects that it shows, added to the description


@dataclass(frozen=True, eq=False)
class DataSet(TextResult):
    """
    Postures of a robot: commanded inputs and measured positions of its markers.

    P postures, Q trials, J markers, m inputs. In a `sequence` every trial replays all postures in
    order, so a posture without any measurement may stand between others, as among `visits`;
    `from_straight` each posture has at least one. The trials of a posture need not be the first
    ones: use `mask`.
    """

    name: str  # the folder, as the user wrote it
    robot: Robot
    markers: tuple[Marker, ...]  # (J,)
    postures: tuple[str, ...]  # (P,)
    inputs: Floats  # (P, m) [N] or [m], columns as robot.inputs; NaN = slack
    positions: Floats  # (P, Q, J, 3) [m], base frame
    orientations: Floats | None = None  # (P, Q, J, 4) [1], quaternion x y z w
    trial_inputs: Floats | None = None  # (P, Q, m) where they were measured per trial
    trial_names: tuple[str, ...] = ()  # (Q,), by default '0' to 'Q-1'
    input: str = 'tension'  # or 'displacement'
    path: str = 'from_straight'  # or 'sequence' or 'visits'
    visits: Visits | None = None  # how the arm came to its postures, where it is of `visits`
    gravity: Vector | None = None  # [m/s²], base frame; None = not given
    position_noise: float | None = None  # [m], 1 sd per coordinate
    setting_noise: float = 0.0  # [1], relative 1 sd (`noise_scales`), shared by a posture's trials
    trial_noise: float = 0.0  # [1], relative 1 sd per input and trial
    accuracy: float | None = None  # [m], the error the user can live with
    known: Known = field(default_factory=dict)  # effects that acted here and nowhere else
    parts: tuple[Part, ...] = ()  # the data sets that it was joined from; none: it is one
    part: Ints | None = None  # (P,) index of the part that a posture belongs to
    reference: EarlierRecording | None = None  # whose deviations are taken off the positions
    thinned_from: int = 0  # [1] measured postures of which these are some; 0: these are all

    def __post_init__(self) -> None:
        """Make the arrays read-only and refuse shapes that do not fit each other."""
        P, m, J = len(self.postures), len(self.robot.inputs), len(self.markers)
        Q = np.shape(self.positions)[1] if np.ndim(self.positions) == 4 else 0
        if (self.path == 'visits') != (self.visits is not None):
            problem = f'there is {"no" if self.visits is None else "an"} order of visits'
            remedy = 'a folder has it in inputs.csv, column visit or previous, with path: visits'
            raise DataSetError(f'{self.name}: path: {self.path}', problem, remedy)
        if not self.trial_names:
            object.__setattr__(self, 'trial_names', tuple(str(q) for q in range(Q)))
        shapes = {'positions': (P, Q, J, 3), 'orientations': (P, Q, J, 4)}
        for key, shape in {'inputs': (P, m), 'trial_inputs': (P, Q, m), **shapes}.items():
            if (given := getattr(self, key)) is None:
                continue
            array = np.array(given, dtype=float)
            if array.shape != shape:
                remedy = f'expected {shape} from postures, trials, markers and inputs'
                raise DataSetError(f'{self.name}: {key}', f'has shape {array.shape}', remedy)
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        if self.input == 'tension' and np.isnan(self.inputs).any():
            p, i = np.argwhere(np.isnan(self.inputs))[0].tolist()
            problem = f'the tension of {self.input_names[i]} is nan'
            remedy = 'give every tension, 0 where a tendon is slack'
            raise DataSetError(f'{self.name}: posture {self.postures[p]!r}', problem, remedy)

    def __repr__(self) -> str:
        """Summarise the size of the data set and its robot."""
        P, Q, J = self.positions.shape[:3]
        unit = 'N' if self.input == 'tension' else 'm'
        lost = 1.0 - self.mask[self.trial_mask].mean() if self.trial_mask.any() else 1.0
        noise = '' if self.position_noise is None else f', noise {1e3 * self.position_noise:g} mm'
        return (
            f'<DataSet {self.name}: {P} postures x up to {Q} trials x {J} markers of '
            f'{self.robot.name}; {self.input} [{unit}] of {", ".join(self.input_names)}; '
            f'{100.0 * lost:.2g} % of the markers not seen{noise}>'
        )

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        robot: RobotLike,
        *,
        markers: Sequence[Marker | float] | None = None,
        name: str = 'DataFrame',
        input: str = 'tension',
        path: str = 'from_straight',
        gravity: Vector | None = None,
        position_noise: float | None = None,
        setting_noise: float = 0.0,
        trial_noise: float = 0.0,
        accuracy: float | None = None,
    ) -> DataSet:
        """
        Return the data set of a tidy table: a row per posture, trial and marker, SI units.

        Parameters
        ----------
        frame : DataFrame
            Columns `posture`, `trial` (may be left out), `marker`, `x`, `y`, `z` [m] in the base
            frame, one per input of the robot [N] or [m], and perhaps `arc_length` [m] and `qx`,
            `qy`, `qz`, `qw`. A marker that was not seen is nan, or has no row. `frame` gives such
            a table back; one over time goes through `import_table`.
        robot : Robot, name, path, text or dict
            The robot that was measured.
        markers : sequence of Marker or arc lengths [m], optional
            In the order in which the table names them; default: its column `arc_length`, else
            one per cell.
        name : str
            For messages.
        input, path, gravity, position_noise, setting_noise, trial_noise, accuracy
            As of `from_arrays`.

        Raises
        ------
        DataSetError
            A column or a value is missing, in another unit, or stands twice.

        """
        robot = load_robot(robot)
        if not hasattr(frame, 'columns'):
            raise refusal(name, 'a DataFrame (of arrays: DataSet.from_arrays)', frame)
        arrays, labels, places = read_frame(frame, robot.inputs, name)
        return cls._checked(
            robot,
            places if markers is None else markers,
            labels,
            **arrays,
            name=name,
            input=input,
            path=path,
            gravity=gravity,
            position_noise=position_noise,
            setting_noise=setting_noise,
            trial_noise=trial_noise,
            accuracy=accuracy,
        )

    @classmethod
    def from_arrays(
        cls,
        robot: RobotLike,
        inputs: Any,
        positions: ArrayLike,
        *,
        markers: Sequence[Marker | float] | None = None,
        postures: Sequence[str] = (),
        name: str = 'arrays',
        input: str = 'tension',
        path: str = 'from_straight',
        gravity: Vector | None = None,
        position_noise: float | None = None,
        setting_noise: float = 0.0,
        trial_noise: float = 0.0,
        accuracy: float | None = None,
    ) -> DataSet:
        """
        Return the data set of arrays.

        Parameters
        ----------
        robot : Robot, name, path, text or dict
            The robot that was measured.
        inputs : (P, m) [N] or [m], or a DataFrame, a dict or a structured array
            Columns with names are taken by name, in any order; others are in the order of
            `robot.inputs`. Of wire pulls nan is slack.
        positions : (P, J, 3) or (P, Q, J, 3) [m]
            Of J markers in the base frame, in Q trials; nan was not seen.
        markers : sequence of Marker or arc lengths [m], optional
            Default: one per cell.
        postures : sequence of str, optional
            Names; default '0' to 'P-1'.
        name : str
            For messages.
        input : str
            'tension' [N], or 'displacement': wire pulls [m].
        path : str
            'from_straight', or 'sequence': every trial replays all postures in order.
        gravity : (3,) [m/s²], optional
            In the base frame; default: the robot's.
        position_noise : float, optional
            [m] 1 sd per coordinate of the tracker.
        setting_noise, trial_noise : float
            [1] relative 1 sd of each input, shared by a posture's trials, and per trial; of wire
            pulls relative to the distance of the outermost tendon from the backbone.
        accuracy : float, optional
            [m] the error that you can live with.

        Raises
        ------
        DataSetError
            Shapes do not fit each other, or values are in another unit.

        """
        robot = load_robot(robot)
        rows = input_rows(robot, inputs, choice('input', input, INPUTS), f'{name}: inputs')
        try:
            places = np.asarray(positions, dtype=float)
        except (TypeError, ValueError):
            raise refusal(f'{name}: positions', 'numbers [m]', positions) from None
        places = places[:, None] if places.ndim == 3 else places
        if places.ndim != 4 or places.shape[3] != 3:
            remedy = 'expected (postures, markers, 3) or (postures, trials, markers, 3)'
            raise DataSetError(f'{name}: positions', f'has shape {np.shape(positions)}', remedy)
        P, _, J = places.shape[:3]
        if not P:
            raise DataSetError(f'{name}: positions', 'hold no posture', 'give at least one')
        return cls._checked(
            robot,
            markers,
            tuple(str(j + 1) for j in range(J)),
            postures=names('postures', postures, P),
            inputs=rows,
            positions=places,
            name=name,
            input=input,
            path=path,
            gravity=gravity,
            position_noise=position_noise,
            setting_noise=setting_noise,
            trial_noise=trial_noise,
            accuracy=accuracy,
        )

    @classmethod
    def _checked(
        cls,
        robot: Robot,
        markers: Sequence[Marker | float] | Floats | None,
        labels: tuple[str, ...],
        **values: Any,
    ) -> DataSet:
        """Return the data set of these values if they are in plausible units."""
        choice('input', values['input'], INPUTS)
        choice('path', values['path'], LOADINGS)
        for key, (maximum, unit) in LIMITS.items():
            if values[key] is not None:
                number(key, values[key], 0.0, maximum, unit)
        if values['gravity'] is not None:
            values['gravity'] = tuple(finite('gravity', values['gravity'], 3).tolist())
        placed = place_markers(robot, markers, labels, values['name'])
        dataset = cls(robot=robot, markers=placed, **values)
        length, limit, arcs = robot.length, robot.tension_limits[1], dataset.arc_lengths
        remedy = 'give metres and newtons, in the base frame'
        far = float(np.nan_to_num(np.abs(dataset.positions)).max(initial=0.0))
        inputs = np.nan_to_num(dataset.inputs)
        low, high = float(inputs.min(initial=0.0)), float(inputs.max(initial=0.0))
        if not ((arcs >= 0.0) & (arcs <= length + 1e-9)).all():
            problem = f'a marker is at {np.nanmax(arcs):g} m of an arm of {length:g} m'
        elif far > PLAUSIBLE_FACTOR * length:
            problem = f'a marker is {far:g} m away, but the robot is only {length:g} m long'
        elif dataset.input == 'displacement' and max(-low, high) > length:
            problem = f'a wire is pulled by {max(-low, high):g} m on an arm of {length:g} m'
        elif dataset.input == 'tension' and high > PLAUSIBLE_FACTOR * limit:
            problem, remedy = too_tense('a tendon', high, limit)
        elif dataset.input == 'tension' and low < 0.0:
            problem = f'a tension is {low:g} N, but a tendon cannot push'
        else:
            return dataset
        raise DataSetError(dataset.name, problem, remedy)

    def frame(self) -> Any:
        """
        Return a tidy table (pandas): a row per posture, trial and marker, SI units.

        Columns `posture`, `trial`, `marker`, `arc_length`, `x`, `y`, `z`, the inputs, and the
        quaternion where there is one; postures, trials and markers are categories in their order,
        markers from the base to the tip. `from_frame` makes the same measurements of it.
        """
        measured = self.trial_mask.copy()  # (P, Q)
        measured[~measured.any(axis=1), 0] = True  # an unmeasured posture has a row per marker
        p, q, j = np.nonzero(np.repeat(measured[..., None], len(self.markers), axis=2))
        ordered = {
            'posture': self.postures,
            'trial': self.trial_names,
            'marker': tuple(marker.name for marker in self.markers),
        }
        columns: dict[str, Any] = {
            key: np.array(texts, dtype=object)[row]
            for (key, texts), row in zip(ordered.items(), (p, q, j), strict=True)
        }
        columns['arc_length'] = self.arc_lengths[j]
        columns |= dict(zip(POSITION, self.positions[p, q, j].T, strict=True))
        if self.orientations is not None:
            columns |= dict(zip(QUATERNION, self.orientations[p, q, j].T, strict=True))
        columns |= dict(zip(self.input_names, self.inputs_by_trial[p, q].T, strict=True))
        units = dict.fromkeys(('arc_length', *POSITION), 'm')
        units |= dict.fromkeys(self.input_names, 'N' if self.input == 'tension' else 'm')
        return make_frame(columns, units, ordered)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the columns of `inputs`."""
        return self.robot.inputs

    @cached_property
    def divided(self) -> tuple[tuple[Part, Ints], ...]:
        """The parts that have postures, and which each of them has."""
        if self.part is None:
            whole = Part(self.name, self.gravity, self.known)
            return ((whole, np.arange(len(self.postures))),)
        rows = [np.flatnonzero(self.part == i) for i in range(len(self.parts))]
        return tuple((part, own) for part, own in zip(self.parts, rows, strict=True) if len(own))

    def less(self, moved: Floats) -> DataSet:
        """Return the data set with all markers moved back by (P, J, 3) [m]."""
        return replace(self, positions=self.positions - moved[:, None])

    @cached_property
    def groups(self) -> Ints:
        """
        Index (P,) of the command, of a sequence of the block of time: the same where alike.

        Such postures are not independent: leave all of them out to judge a prediction.
        """
        if self.path == 'sequence':
            measured = np.cumsum(self.trials > 0) - 1
            return measured * BLOCKS_MAX // max(int(measured[-1]) + 1, BLOCKS_MAX)
        commanded = np.nan_to_num(self.inputs, nan=np.inf)
        return np.unique(commanded, axis=0, return_inverse=True)[1].reshape(-1)

    @cached_property
    def mask(self) -> Bools:
        """Whether a marker was visible in a trial, (P, Q, J)."""
        return np.isfinite(self.positions).all(axis=3)

    @cached_property
    def trial_mask(self) -> Bools:
        """Whether a trial has at least one visible marker, (P, Q)."""
        return self.mask.any(axis=2)

    @cached_property
    def trials(self) -> Ints:
        """Number of trials with at least one visible marker, (P,)."""
        return self.trial_mask.sum(axis=1)

    @cached_property
    def counts(self) -> Ints:
        """Number of trials in which the marker was visible, (P, J)."""
        return self.mask.sum(axis=1)

    @cached_property
    def mean(self) -> Floats:
        """Mean position over the trials with a visible marker, (P, J, 3) [m]; NaN without any."""
        total = np.where(self.mask[..., None], self.positions, 0.0).sum(axis=1)
        counts = self.counts[..., None]
        return np.where(counts > 0, total / np.maximum(counts, 1), np.nan)

    @cached_property
    def inputs_by_trial(self) -> Floats:
        """Inputs of every trial, (P, Q, m) [N] or [m]: the measured ones, else the posture's."""
        if self.trial_inputs is not None:
            return self.trial_inputs
        P, Q = self.positions.shape[:2]
        return np.broadcast_to(self.inputs[:, None, :], (P, Q, self.inputs.shape[1]))

    @cached_property
    def arc_lengths(self) -> Floats:
        """Arc length of every marker, (J,) [m]."""
        return np.array([marker.arc_length for marker in self.markers])

    @cached_property
    def offsets(self) -> Floats:
        """Offset of every marker in the frame at its arc length, (J, 3) [m]."""
        return np.array([marker.offset for marker in self.markers]).reshape(-1, 3)

    def gravity_for(self, robot: Robot) -> Vector | None:
        """Return the gravity [m/s²] that acted: the data set's, else the robot's, else None."""
        return self.gravity if self.gravity is not None else robot.gravity

    def select(self, postures: Iterable[str]) -> DataSet:
        """
        Return the data set with these postures only, in the order of the file.

        A sequence keeps the postures in between, and visits keep all, because the arm remembers
        them, but without their measurements.

        Raises
        ------
        InputError
            A posture is unknown, or none is named.

        """
        selected = set(postures)
        unknown = selected.difference(self.postures)
        if unknown or not selected:
            problem = f'no posture {min(unknown)!r}' if unknown else 'no posture is selected'
            raise InputError(f'{self.name}: {problem}; known: {listing(self.postures)}')
        chosen = np.array([posture in selected for posture in self.postures])
        if self.path == 'from_straight':
            return self._rows(np.flatnonzero(chosen))
        end = len(chosen) if self.visits else int(np.flatnonzero(chosen)[-1]) + 1
        part = self._rows(np.arange(end))
        hidden = ~chosen[: len(part.postures), None, None, None]
        return part.changed(lambda array: np.where(hidden, np.nan, array), *READINGS)

    def thinned(self, count: int) -> DataSet:
        """
        Return the data set with so many of its measured postures, evenly spread over their order.

        A sequence keeps also the postures at which its path turns, without their measurements, as
        far back as the arm may remember them, and visits keep all.
        """
        measured = np.flatnonzero(self.trials > 0)
        if len(measured) <= count:
            return self
        kept = measured[evenly(len(measured), count)]
        chosen = self.select(self.postures[i] for i in kept)
        if self.path == 'sequence':
            path = np.nan_to_num(chosen.inputs)
            rows = corners(path, kept)
            chosen = chosen._rows(rows[remembered(path[rows], np.searchsorted(rows, kept))])
        return replace(chosen, thinned_from=len(measured))

    def changed(self, change: Callable[[Any], Any], *names: str, **values: Any) -> DataSet:
        """Return the data set with these arrays changed, as far as it has them, and values."""
        arrays = {n: change(array) for n in names if (array := getattr(self, n)) is not None}
        return replace(self, **arrays, **values)

    def without_unseen_markers(self) -> DataSet:
        """Return the data set of the markers that were visible in any trial."""
        visible = self.mask.any(axis=(0, 1))
        markers = tuple(m for m, one in zip(self.markers, visible, strict=True) if one)
        return self.changed(lambda array: array[:, :, visible], *READINGS, markers=markers)

    def hold_out(self, share: float = 0.25, seed: int = 0) -> tuple[DataSet, DataSet]:
        """
        Split into postures to fit and postures to check, drawn at random.

        Parameters
        ----------
        share : float
            Share of the measured postures that the second data set gets, at least one.
        seed : int
            The same seed draws the same postures.

        Raises
        ------
        InputError
            There are fewer than two measured postures, or the share is not between 0 and 1.

        """
        of = self.visits.commands if self.visits else self.postures  # all visits of a command
        visits = zip(of, self.postures, self.trials, strict=True)
        measured = {name: command for command, name, n in visits if n}
        commands = list(dict.fromkeys(measured.values()))
        if len(commands) < 2 or not 0.0 < share < 1.0:
            problem = f'a share of {share:g} of {len(commands)} measured postures'
            remedy = 'both parts need at least one'
            raise InputError(f'{self.name}: cannot hold out {problem}; {remedy}')
        size = min(max(round(share * len(commands)), 1), len(commands) - 1)
        drawn = np.random.default_rng(seed).permutation(len(commands))[:size]
        check = {name for name, command in measured.items() if commands.index(command) in drawn}
        return self.select(set(measured) - check), self.select(check)

    def by_origin(self, split: Split, trials: Ints | None) -> DataSet:
        """Split the postures by the command before; rows (R,) are of a trial, or of all."""
        inputs = self.inputs[split.command]
        own = np.zeros((len(split.postures), self.positions.shape[1]), dtype=bool)
        own[split.posture, slice(None) if trials is None else trials] = True

        def part(array: Floats, other: Floats | float = np.nan) -> Floats:
            wide = own.reshape(*own.shape, *(1,) * (array.ndim - 2))
            return np.where(wide, array[split.command], other)

        each = self.trial_inputs
        return self.changed(
            part,
            *READINGS,
            postures=split.postures,
            inputs=inputs,
            trial_inputs=None if each is None else part(each, inputs[:, None]),
            path='visits',
            visits=split.visits,
        )

    def _rows(self, rows: NDArray[np.intp]) -> DataSet:
        postures = tuple(self.postures[i] for i in rows)
        arrays = ('inputs', 'part', 'trial_inputs', *READINGS)
        taken = self.reference
        if taken is not None:
            taken = replace(taken, doubt=taken.doubt[rows], noise=taken.noise[rows])
        return self.changed(lambda array: array[rows], *arrays, postures=postures, reference=taken)


class HasDataSet(Protocol):
    """An import: what holds measurements."""

    @property
    def dataset(self) -> DataSet:
        """The measurements."""


def as_dataset(data: object) -> DataSet:
    """Return a data set as it is, or that of an import; anything else is refused."""
    dataset = data if isinstance(data, DataSet) else getattr(data, 'dataset', None)
    if not isinstance(dataset, DataSet):
        frame = FRAME if hasattr(data, 'columns') else ''
        raise refusal('data', f'{EXPECTED}{frame}', data)
    return dataset
