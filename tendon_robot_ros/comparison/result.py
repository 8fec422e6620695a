"""
What a comparison holds: shapes, errors, pictures for notebooks; to JSON and back.

JSON has lengths in m, angles in rad, and null where nothing was measured.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import InputError
from ..common.files import read_text
from ..common.results import TextResult, make_frame, picture_axes, plain
from ..common.words import mm
from ..inference import statistics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# [1] times the noise floor, from which an error is called more than noise, because the squared
# error of a marker over two postures exceeds four times its mean with a probability of 0.05 %
GROWN_FROM_FLOORS = 2.0


@dataclass(frozen=True, eq=False)
class Measured:
    """The measurements of a comparison: P postures, Q trials, J markers, m inputs."""

    data: str  # name of the data set
    input: str  # 'tension' or 'displacement'
    input_names: tuple[str, ...]  # (m,)
    inputs: Floats  # (P, m) [N] or [m], NaN = slack
    postures: tuple[str, ...]  # (P,)
    trials: npt.NDArray[np.int64]  # (P,)
    markers: tuple[str, ...]  # (J,)
    arc_lengths: Floats  # (J,) [m]
    per_cell: bool  # one marker at the end of every cell, and no other
    mean: Floats  # (P, J, 3) [m]
    tips: Floats  # (P, Q, 3) [m] the last marker, trial by trial
    angles: Floats | None  # (Q, P, J) [rad] angular displacement, of markers on the centreline
    position_noise: float | None  # [m] 1 sd per coordinate and trial
    floor: Floats | None  # (P, J) [m²] expected squared distance for a perfect model
    left_out: tuple[Mapping[str, Any], ...] = ()  # as `Outliers.rows` names them
    path: str = 'from_straight'  # how postures were reached, as in a data set

    @cached_property
    def noise_floor(self) -> float | None:
        """Expected rms [m] for a perfect model over postures and markers."""
        return None if self.floor is None else statistics.root_mean(self.floor)

    @cached_property
    def motion(self) -> float:
        """How far markers move from posture to posture [m]: rms distance from their middle."""
        middle = statistics.mean_over(self.mean, 0)
        return statistics.root_mean(((self.mean - middle) ** 2).sum(axis=-1))

    @cached_property
    def floor_per_marker(self) -> Floats | None:
        """Expected rms (J,) [m] for a perfect model over postures."""
        return None if self.floor is None else np.sqrt(statistics.mean_over(self.floor, 0))


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """A model's predictions and their distances from the measurements."""

    name: str
    effects: tuple[str, ...]
    markers: Floats  # (P, J, 3) [m]
    angles: Floats | None  # (P, J) [rad]
    distance: Floats  # (P, J) [m] from the trial mean
    tip_errors: Floats  # (P, Q) [m] of the last marker, trial by trial: the residual distance
    centreline: Floats | None = None  # (P, n, 3) [m], where the markers do not lie on it
    model_error: float = 0.0  # [m] rms over the markers that its description knows to be off

    @property
    def line(self) -> Floats:
        """What to draw of the arm (P, n, 3) [m]: its centreline, else its markers."""
        return self.markers if self.centreline is None else self.centreline

    @cached_property
    def rms(self) -> float:
        """Over postures and markers [m]."""
        return statistics.root_mean(self.distance**2)

    @cached_property
    def max(self) -> float:
        """Largest distance [m]."""
        return float(np.nanmax(self.distance))

    @cached_property
    def per_marker_rms(self) -> Floats:
        """Over postures (J,) [m]."""
        return np.sqrt(statistics.mean_over(self.distance**2, 0))

    @cached_property
    def per_posture_rms(self) -> Floats:
        """Over markers (P,) [m]."""
        return np.sqrt(statistics.mean_over(self.distance**2, 1))

    def tip_error(self, error: str = 'ci') -> statistics.Estimate:
        """
        Mean tip error over the postures.

        The tip error of a trial is the distance between the predicted and the measured tip, that
        of a posture the mean over its trials (Kato et al. 2015, section IV.C).
        """
        return statistics.estimate(statistics.mean_over(self.tip_errors, 1), error)

    def tip_error_of(self, posture: int, error: str = 'ci') -> statistics.Estimate:
        """Mean tip error over the trials of a posture."""
        return statistics.estimate(self.tip_errors[posture], error)


@dataclass(frozen=True, eq=False)
class Comparison(TextResult):
    """Measurements against models, side by side."""

    measured: Measured
    models: tuple[ModelErrors, ...]
    error: str = 'ci'  # 95 % t-interval, or 'sem'

    def __repr__(self) -> str:
        """Summarise the errors of every model, and the noise floor."""
        rows = [
            f'{m.name}: rms {mm(m.rms)}, tip error {mm(m.tip_error().mean)}' for m in self.models
        ]
        if self.noise_floor is not None:
            rows.append(f'a perfect model: {mm(self.noise_floor)}')
        if left_out := len(self.measured.left_out):
            rows.append(f'left out, because other trials contradict: {left_out}')
        return f'<Comparison with {self.measured.data}: {"; ".join(rows)}>'

    def frame(self) -> Any:
        """
        Return the errors as a table (pandas): a row per model, posture and marker, SI units.

        Columns `model`, `posture`, `marker`, `arc_length`, `measured_x` to `measured_z` (the mean
        of the trials), `predicted_x` to `predicted_z`, `error`; lengths in metres.
        """
        measured, models = self.measured, self.models
        k, p, j = np.indices((len(models), *measured.mean.shape[:2])).reshape(3, -1)
        columns: dict[str, Any] = {
            'model': np.array([one.name for one in models], dtype=object)[k],
            'posture': np.array(measured.postures, dtype=object)[p],
            'marker': np.array(measured.markers, dtype=object)[j],
            'arc_length': measured.arc_lengths[j],
        }
        places = measured.mean[p, j], np.array([one.markers for one in models])[k, p, j]
        for what, positions in zip(('measured', 'predicted'), places, strict=True):
            columns |= {f'{what}_{axis}': positions[:, i] for i, axis in enumerate('xyz')}
        columns['error'] = np.array([one.distance for one in models])[k, p, j]
        ordered = {'posture': measured.postures, 'marker': measured.markers}
        return make_frame(columns, dict.fromkeys(list(columns)[3:], 'm'), ordered)

    def plot(self, axes: Axes | None = None) -> Axes:
        """
        Draw the error of every model along the arm [mm] above the noise floor, with matplotlib.

        Parameters
        ----------
        axes : matplotlib Axes, optional

        Returns
        -------
        Axes

        """
        measured, axes = self.measured, axes or picture_axes()
        along = 1e3 * measured.arc_lengths
        for model in self.models:
            axes.plot(along, 1e3 * model.per_marker_rms, '.-', label=model.name)
        if measured.floor_per_marker is not None:
            floor = 1e3 * measured.floor_per_marker
            axes.fill_between(along, 0.0, floor, color='0.8', label='noise of the measurements')
        axes.set(
            xlabel='along the arm [mm]',
            ylabel='rms error [mm]',
            title=f'{measured.data}: {len(measured.postures)} postures',
            ylim=(0.0, None),
        )
        axes.legend()
        return axes

    def plot_shapes(self, posture: str | None = None) -> Figure:
        """
        Draw a posture, measured and predicted, across the plane in which it bends and along it.

        Parameters
        ----------
        posture : str, optional
            Its name; default: the one that the best model predicts worst.

        Raises
        ------
        InputError
            There is no such posture.

        """
        from ..model.shape import plot_sides

        names = self.measured.postures
        if posture is not None and posture not in names:
            raise InputError(f'no posture {posture!r}; there are: {", ".join(names)}')
        p = self.worst_posture(self.best) if posture is None else names.index(posture)
        predicted = {model.name: (model.line[p], model.markers[p]) for model in self.models}
        figure = plot_sides(self.measured.mean[p], predicted)
        figure.suptitle(f'{self.measured.data}, {names[p]}')
        return figure

    @property
    def noise_floor(self) -> float | None:
        """Expected rms [m] for a perfect model."""
        return self.measured.noise_floor

    @property
    def best(self) -> ModelErrors:
        """The model with the smallest rms."""
        return min(self.models, key=lambda model: model.rms)

    @cached_property
    def paired_t(self) -> tuple[statistics.PairedT, ...]:
        """Paired t-tests of the tip errors: over the postures, and over the trials of each."""
        tests = []
        for a, b in combinations(self.models, 2):
            names = (a.name, b.name)
            means = statistics.mean_over(a.tip_errors, 1), statistics.mean_over(b.tip_errors, 1)
            tests.append(statistics.paired_t(names, *means, None))
            for p, posture in enumerate(self.measured.postures):
                tests.append(statistics.paired_t(names, a.tip_errors[p], b.tip_errors[p], posture))
        return tuple(test for test in tests if test is not None)

    def worst_posture(self, model: ModelErrors) -> int:
        """Index of the posture with the largest rms."""
        return int(np.nanargmax(model.per_posture_rms))

    def grows_from(self, model: ModelErrors) -> int | None:
        """
        Index of the marker from which on, up to the tip, the error exceeds the noise.

        None if there is no such marker, or the noise is unknown.
        """
        floor = self.measured.floor_per_marker
        if floor is None:
            return None
        known = np.flatnonzero(np.isfinite(floor))
        low = known[~(model.per_marker_rms[known] > GROWN_FROM_FLOORS * floor[known])]
        later = known[known > (low[-1] if len(low) else -1)]
        return int(later[0]) if len(later) else None

    def angle_bands(self) -> tuple[Floats, Floats]:
        """Measured angular displacement (P, J) [rad]: mean, and half the width of its interval."""
        angles = self.measured.angles
        assert angles is not None  # the markers lie on the centreline
        return statistics.mean_over(angles, 0), statistics.half_width(angles, self.error)


FORMAT = 'tendon_robot_ros/comparison@1'
SAME = ('data', 'input', 'path', 'per_cell', 'position_noise')  # called alike in the file


def to_json(comparison: Comparison) -> dict[str, Any]:
    """Return plain data: what to read first, then everything that a report draws."""
    measured = comparison.measured
    markers = zip(measured.markers, measured.arc_lengths.tolist(), strict=True)
    inputs = [dict(zip(measured.input_names, row, strict=True)) for row in plain(measured.inputs)]
    return {
        'format': FORMAT,
        **plain({key: getattr(measured, key) for key in SAME}),
        'noise_floor': plain(measured.noise_floor),
        'noise_floor_per_marker': plain(measured.floor_per_marker),
        'error': comparison.error,
        'models': [_model_to_json(comparison, model) for model in comparison.models],
        'paired_t': plain(comparison.paired_t),
        'markers': [{'name': name, 'arc_length': s} for name, s in markers],
        'left_out': [dict(row) for row in measured.left_out],
        'measured': _rows(
            posture=measured.postures,
            input=inputs,
            trials=measured.trials.tolist(),
            shape=measured.mean,
            tips=measured.tips,
            angles=None if measured.angles is None else measured.angles.swapaxes(0, 1),
            floor=None if measured.floor is None else np.sqrt(measured.floor),
        ),
    }


def _model_to_json(comparison: Comparison, model: ModelErrors) -> dict[str, Any]:
    measured, error = comparison.measured, comparison.error
    first = comparison.grows_from(model)
    postures = range(len(measured.postures))
    told = ('name', 'effects', 'model_error', 'rms', 'max', 'per_marker_rms')
    return {
        **plain({key: getattr(model, key) for key in told}),
        'tip_error': _estimate(model.tip_error(error)),
        'grows_from': None if first is None else measured.markers[first],
        'worst_posture': measured.postures[comparison.worst_posture(model)],
        'per_posture': _rows(
            posture=measured.postures,
            rms=model.per_posture_rms,
            max=np.nan_to_num(model.distance, nan=-np.inf).max(axis=1),
            tip_error=[_estimate(model.tip_error_of(p, error)) for p in postures],
            tip_errors=model.tip_errors,
            error=model.distance,
            angles=model.angles,
            shape=model.markers,
            centreline=model.centreline,
        ),
    }


def load_comparison(path: str | Path) -> Comparison:
    """
    Read a comparison that `compare --json` wrote.

    Raises
    ------
    InputError
        It is no such file.

    """

    def refuse(reason: object) -> InputError:
        return InputError(f'{path}: expected the JSON of a comparison ({FORMAT}), got {reason}')

    text = read_text(path, refuse)
    try:
        return from_json(json.loads(text))
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise refuse(f'something else ({error})') from None


def from_json(content: dict[str, Any]) -> Comparison:
    """Return the comparison that `to_json` wrote down."""
    if content['format'] != FORMAT:
        raise ValueError(f'format {content["format"]!r}')
    rows = content['measured']
    held = _columns(rows, 'trials', 'shape', 'tips', 'angles', 'floor')
    measured = Measured(
        **{key: content[key] for key in SAME if key in content},  # older files have no path
        input_names=tuple(rows[0]['input']),
        inputs=np.array([list(row['input'].values()) for row in rows], dtype=float),
        postures=tuple(row['posture'] for row in rows),
        trials=held['trials'].astype(int),
        markers=tuple(marker['name'] for marker in content['markers']),
        arc_lengths=_columns(content['markers'], 'arc_length')['arc_length'],
        mean=held['shape'],
        tips=held['tips'],
        angles=None if held['angles'] is None else held['angles'].swapaxes(0, 1),
        floor=None if held['floor'] is None else held['floor'] ** 2,
        left_out=tuple(content.get('left_out', ())),  # files of older versions have none
    )
    models = []
    for model in content['models']:
        each = model['per_posture']
        held = _columns(each, 'shape', 'angles', 'error', 'tip_errors', 'centreline')
        values = (*held.values(), model.get('model_error', 0.0))  # older files lack the last one
        models.append(ModelErrors(model['name'], tuple(model['effects']), *values))
    return Comparison(measured, tuple(models), content['error'])


def _estimate(value: statistics.Estimate) -> Any:
    return plain({key: getattr(value, key) for key in ('mean', 'low', 'high', 'n')})


def _rows(**columns: Any) -> list[dict[str, Any]]:
    """Return a row per posture of columns (P, ...); of one that is None, null in each."""
    return [
        {key: None if column is None else plain(column[p]) for key, column in columns.items()}
        for p in range(len(columns['posture']))
    ]


def _columns(rows: list[dict[str, Any]], *keys: str) -> dict[str, Any]:
    """Return columns (P, ...) of rows; None where the first row has null."""
    known = {key: None if rows[0][key] is None else [row[key] for row in rows] for key in keys}
    return {key: None if one is None else np.array(one, dtype=float) for key, one in known.items()}
