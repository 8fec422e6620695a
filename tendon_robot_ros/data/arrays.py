"""Markers, the arrays of a tidy table of pandas, and values in impossible units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import RESOLUTION, Bools, Floats, Ints
from ..common.errors import DataSetError, refusal, short
from ..common.words import UNITS, listed
from ..robot import Robot

# [1] times the largest tension, or the length of the arm, beyond which a value is refused, because
# it is in another unit or frame
PLAUSIBLE_FACTOR = 3.0
SAMPLES_MIN = 10  # [1] of which a spread or a rate is estimated, because fewer tell none
# [s] two times that are nearer are one for a tracker, because its frames have 30 to 100 Hz
FRAME_S = 0.02
# [1] probability by chance of what is refused: that a marker repeats its last place exactly in so
# many steps, that a still arm seems to have two senders
CHANCE_PROBABILITY = 1e-9
VALUES_MAX = 20_000_000  # [1] readings in an array, so that it fits into memory
# [1] quaternion x, y, z, w of trackers that measure no orientation, because messages need one
NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
MARKERS_EXPECTED = 'the arc length [m] of each, or a Marker'
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Marker:
    """A tracked point of the arm."""

    name: str
    arc_length: float  # [m] from the base along the straight backbone
    offset: Vector = (0.0, 0.0, 0.0)  # [m] in the frame at that arc length


def default_markers(robot: Robot) -> tuple[Marker, ...]:
    """Return one marker per cell, named '1' to 'n', at the cell's distal end."""
    ends = np.cumsum(robot.cell_lengths).round(12).tolist()  # 0.108, not 0.10800000000000003
    return tuple(Marker(str(i + 1), end) for i, end in enumerate(ends))


def even_markers(robot: Robot, count: int) -> tuple[Marker, ...]:
    """Return `count` markers, named '1' to 'n', evenly spaced up to the tip."""
    places = robot.length * (np.arange(count) + 1.0) / count
    return tuple(Marker(str(i + 1), float(place)) for i, place in enumerate(places))


def place_markers(
    robot: Robot, given: Sequence[Marker | float] | Floats | None, labels: Sequence[str], name: str
) -> tuple[Marker, ...]:
    """
    Return the labelled markers: as given or by their arc lengths [m], else one per cell.

    Raises
    ------
    DataSetError
        There are places for more or fewer markers.

    """
    if given is None and len(labels) == robot.cells:
        return default_markers(robot)
    if given is not None and not isinstance(given, Sequence | np.ndarray):
        raise refusal(f'{name}: markers', MARKERS_EXPECTED, given)
    if given is None or len(given) != len(labels):
        known = 'none' if given is None else f'{len(given)}'
        problem = f'there are {len(labels)}, {known} with a place'
        remedy = 'give the arc length [m] of each, from the base along the arm'
        raise DataSetError(f'{name}: markers', problem, remedy)
    return markers_of(given, labels, name)


def markers_of(
    given: Sequence[Marker | float] | Floats, labels: Sequence[str], name: str
) -> tuple[Marker, ...]:
    """Return markers that are given as such or by their arc lengths [m]."""
    try:
        return tuple(
            one if isinstance(one, Marker) else Marker(label, float(one))
            for label, one in zip(labels, given, strict=True)
        )
    except (TypeError, ValueError):
        raise refusal(f'{name}: markers', MARKERS_EXPECTED, given) from None


POSITION = ('x', 'y', 'z')
QUATERNION = ('qx', 'qy', 'qz', 'qw')
HINT = 'a table over time goes through import_table'


def read_frame(
    frame: Any, inputs: Sequence[str], name: str
) -> tuple[dict[str, Any], tuple[str, ...], Floats | None]:
    """
    Convert a tidy table to the arrays of a data set.

    Parameters
    ----------
    frame : DataFrame
        Columns `posture`, `trial` (0 where there is none), `marker`, x, y, z [m], one per input,
        and perhaps `arc_length` [m] and qx, qy, qz, qw; other columns are ignored.
    inputs : sequence of str
        Names of the inputs.
    name : str
        For messages.

    Returns
    -------
    arrays : dict
        The postures, trials, inputs, positions and orientations of a `DataSet`.
    markers : tuple of str
        Their names.
    arc_lengths : (J,) [m]
        None where there is no such column.

    Raises
    ------
    DataSetError
        A column is missing, a cell is no number, or a measurement stands twice.

    """
    for column in ('posture', 'marker', *POSITION, *inputs):
        if column not in frame.columns:
            needed = f'posture, marker, x, y, z and {", ".join(inputs)}'
            remedy = f'a row per posture and marker needs {needed}; {HINT}'
            raise DataSetError(name, f'no column {column!r}', remedy)
    if not len(frame):
        raise DataSetError(name, 'has no row', HINT)
    postures, posture = _codes(frame['posture'])
    markers, marker = _codes(frame['marker'])
    only = ('0',), np.zeros(len(frame), dtype=np.int64)  # trial
    trials, trial = _codes(frame['trial']) if 'trial' in frame.columns else only
    sizes = len(postures), len(trials), len(markers)
    rows = np.ravel_multi_index((posture, trial, marker), sizes)
    values, counts = np.unique(rows, return_counts=True)
    if (counts > 1).any():
        p, q, j = np.unravel_index(int(values[counts.argmax()]), sizes)
        names = f'posture {postures[p]!r}, trial {trials[q]!r}, marker {markers[j]!r}'
        raise DataSetError(name, f'{names} stands twice', f'number the trials; {HINT}')
    arrays: dict[str, Any] = {'postures': postures, 'trial_names': trials}
    for key, columns in (('positions', POSITION), ('orientations', QUATERNION)):
        if all(column in frame.columns for column in columns):
            arrays[key] = np.full((*sizes, len(columns)), np.nan)
            arrays[key][posture, trial, marker] = _numbers(frame, columns, name)
    arc_lengths = None
    if 'arc_length' in frame.columns:
        arc_lengths, places = np.empty(len(markers)), _numbers(frame, ('arc_length',), name)[:, 0]
        arc_lengths[marker] = places
        other = ~np.isclose(arc_lengths[marker], places, rtol=0.0, atol=RESOLUTION)
        if other.any():
            row = int(other.argmax())
            problem = f'marker {markers[marker[row]]!r} is at {places[row]:g} m'
            remedy = f'in another row it is at {arc_lengths[marker[row]]:g} m: write one place'
            raise DataSetError(f'{name}, row {row}', problem, remedy)
    pulled = _numbers(frame, inputs, name)
    each = np.full((*sizes[:2], len(inputs)), np.inf)  # of every trial, inf where there is none
    each[posture, trial] = pulled
    kept = each[posture, trial]
    other = ~np.isclose(kept, pulled, rtol=0.0, atol=RESOLUTION, equal_nan=True)
    if other.any():
        row, column = np.argwhere(other)[0].tolist()
        one, another = f'{pulled[row, column]:g}', f'{kept[row, column]:g}'
        problem = f'{inputs[column]} is {one}, in another row of this trial {another}'
        remedy = 'a trial has one value for each input'
        raise DataSetError(f'{name}, row {row}', problem, remedy)
    mean, arrays['trial_inputs'] = mean_inputs(each, ~np.isinf(each[..., 0]), postures, name)
    return arrays | {'inputs': mean}, markers, arc_lengths


def mean_inputs(
    each: Floats, measured: Bools, postures: Sequence[str], name: str
) -> tuple[Floats, Floats | None]:
    """
    Return the inputs of postures, (P, m), and of their trials where these differ, (P, Q, m).

    Parameters
    ----------
    each : (P, Q, m) [N] or [m]
        Of every trial.
    measured : (P, Q)
        Whether there is such a trial.
    postures, name
        For messages.

    Raises
    ------
    DataSetError
        An input is nan, which is slack, in some trials of a posture only.

    """
    known = measured[..., None]
    slack = np.isnan(each) & known
    mixed = (slack.any(axis=1) & ~(slack | ~known).all(axis=1)).any(axis=1)
    if mixed.any():
        problem = 'an input is nan (slack) in some of its trials and a number in others'
        remedy = 'give postures of different inputs different names'
        raise DataSetError(f'{name}: posture {postures[int(mixed.argmax())]!r}', problem, remedy)
    mean = np.where(known, each, 0.0).sum(axis=1) / known.sum(axis=1)
    spread = np.where(known, np.abs(each - mean[:, None]), 0.0)
    differ = np.nan_to_num(spread).max() >= RESOLUTION
    return mean, np.where(known, each, np.nan) if differ else None


def _codes(column: Any) -> tuple[tuple[str, ...], Ints]:
    """
    Return the names in a column, and the index of each row's name.

    In the order of an ordered categorical, else in that in which they appear.
    """
    texts = [str(value) for value in column.tolist()]
    first = list(column.cat.categories) if hasattr(column, 'cat') and column.cat.ordered else []
    present = set(texts)
    order = [text for text in map(str, first) if text in present]
    names = {text: i for i, text in enumerate(dict.fromkeys([*order, *texts]))}
    return tuple(names), np.array([names[text] for text in texts], dtype=np.int64)


def _numbers(frame: Any, columns: Sequence[str], name: str) -> Floats:
    """Return columns (R, c) of numbers."""
    values = np.empty((len(frame), len(columns)))
    for i, column in enumerate(columns):
        for row, value in enumerate(frame[column].tolist()):
            try:
                values[row, i] = np.nan if value is None else float(value)
            except (TypeError, ValueError):
                where, problem = f'{name}, row {row}', f'{column} is {short(value)}'
                raise DataSetError(where, problem, 'expected a number or nan') from None
    return values


def too_tense(name: str, tension: float, limit: float) -> tuple[str, str]:
    """Return problem and remedy for a tension far beyond the limit [N]: perhaps another unit."""
    newtons = {unit: tension * UNITS['force'][unit] for unit in ('g', 'mN')}
    read = [f'{value:.3g} N if in {unit}' for unit, value in newtons.items() if value <= limit]
    unit = f' ({listed(read, "or")})' if read else ''
    remedy = f'raise tension_limits of the robot description to what was applied, or give N{unit}'
    return f'{name} is {tension:g} N, but tension_limits end at {limit:g} N', remedy
