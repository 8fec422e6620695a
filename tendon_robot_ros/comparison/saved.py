"""A comparison to JSON and back; lengths in m, angles in rad, null where nothing was measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import InputError
from ..common.files import read_text
from .result import Comparison, Floats, Measured, ModelErrors
from .statistics import Estimate, PairedT

FORMAT = 'tendon_robot_ros/comparison@1'


def to_json(comparison: Comparison) -> dict[str, Any]:
    """Return plain data: what to read first, then everything that a report draws."""
    measured, error = comparison.measured, comparison.error
    return {
        'format': FORMAT,
        'data': measured.data,
        'noise_floor': _number(measured.noise_floor),
        'noise_floor_per_marker': _numbers(measured.floor_per_marker),
        'position_noise': _number(measured.position_noise),
        'error': error,
        'models': [_model(comparison, model) for model in comparison.models],
        'paired_t': [_test(test) for test in comparison.paired_t],
        'markers': [
            {'name': name, 'arc_length': float(s)}
            for name, s in zip(measured.markers, measured.arc_lengths, strict=True)
        ],
        'per_cell': measured.per_cell,
        'input': measured.input,
        'left_out': [dict(row) for row in measured.left_out],
        'measured': [_posture(measured, p) for p in range(len(measured.postures))],
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
    angles = None if rows[0]['angles'] is None else _array(r['angles'] for r in rows)
    floor = None if rows[0]['floor'] is None else _array(r['floor'] for r in rows) ** 2
    measured = Measured(
        data=content['data'],
        input=content['input'],
        input_names=tuple(rows[0]['input']),
        inputs=_array(list(row['input'].values()) for row in rows),
        postures=tuple(row['posture'] for row in rows),
        trials=np.array([row['trials'] for row in rows]),
        markers=tuple(marker['name'] for marker in content['markers']),
        arc_lengths=_array(marker['arc_length'] for marker in content['markers']),
        per_cell=content['per_cell'],
        mean=_array(row['shape'] for row in rows),
        tips=_array(row['tips'] for row in rows),
        angles=None if angles is None else angles.swapaxes(0, 1),
        position_noise=content['position_noise'],
        floor=floor,
        left_out=tuple(content.get('left_out', ())),  # files of older versions have none
    )
    models = tuple(_read_model(model) for model in content['models'])
    return Comparison(measured, models, content['error'])


def _model(comparison: Comparison, model: ModelErrors) -> dict[str, Any]:
    error, from_marker = comparison.error, comparison.grows_from(model)
    names = comparison.measured.markers
    return {
        'name': model.name,
        'effects': list(model.effects),
        'rms': model.rms,
        'max': model.max,
        'tip_error': _estimate(model.tip_error(error)),
        'per_marker_rms': _numbers(model.per_marker_rms),
        'grows_from': None if from_marker is None else names[from_marker],
        'worst_posture': comparison.measured.postures[comparison.worst_posture(model)],
        'per_posture': [_errors(comparison, model, p) for p in range(len(model.distance))],
    }


def _errors(comparison: Comparison, model: ModelErrors, p: int) -> dict[str, Any]:
    distance = model.distance[p]
    seen = np.isfinite(distance).any()
    return {
        'posture': comparison.measured.postures[p],
        'rms': _number(model.per_posture_rms[p]),
        'max': _number(np.nanmax(distance)) if seen else None,
        'tip_error': _estimate(model.tip_error_of(p, comparison.error)),
        'tip_errors': _numbers(model.tip_errors[p]),
        'error': _numbers(distance),
        'angles': None if model.angles is None else _numbers(model.angles[p]),
        'shape': _numbers(model.markers[p]),
        'centreline': None if model.centreline is None else _numbers(model.centreline[p]),
    }


def _read_model(content: dict[str, Any]) -> ModelErrors:
    rows = content['per_posture']
    angles = None if rows[0]['angles'] is None else _array(row['angles'] for row in rows)
    line = None if rows[0]['centreline'] is None else _array(row['centreline'] for row in rows)
    return ModelErrors(
        name=content['name'],
        effects=tuple(content['effects']),
        markers=_array(row['shape'] for row in rows),
        angles=angles,
        distance=_array(row['error'] for row in rows),
        tip_errors=_array(row['tip_errors'] for row in rows),
        centreline=line,
    )


def _posture(measured: Measured, p: int) -> dict[str, Any]:
    return {
        'posture': measured.postures[p],
        'input': dict(zip(measured.input_names, _numbers(measured.inputs[p]) or (), strict=True)),
        'trials': int(measured.trials[p]),
        'shape': _numbers(measured.mean[p]),
        'tips': _numbers(measured.tips[p]),
        'angles': None if measured.angles is None else _numbers(measured.angles[:, p]),
        'floor': None if measured.floor is None else _numbers(np.sqrt(measured.floor[p])),
    }


def _estimate(value: Estimate) -> dict[str, Any]:
    return {
        'mean': _number(value.mean),
        'low': _number(value.low),
        'high': _number(value.high),
        'n': value.n,
    }


def _test(test: PairedT) -> dict[str, Any]:
    return {
        'models': list(test.models),
        'posture': test.posture,
        'difference': test.difference,
        'low': test.low,
        'high': test.high,
        't': _number(test.t),
        'p': test.p,
        'n': test.n,
    }


def _number(value: float | np.floating[Any] | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def _numbers(values: Floats | None) -> list[Any] | None:
    """Nested lists with null for what is missing."""
    if values is None:
        return None
    array = np.asarray(values, dtype=float)
    return list(np.where(np.isfinite(array), array, np.array(None, dtype=object)).tolist())


def _array(rows: Any) -> Floats:
    return np.array(list(rows), dtype=float)
