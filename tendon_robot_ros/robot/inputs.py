"""Tensions and wire pulls: those of a caller, by name or in order, checked; and their noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, named_columns, refusal, short, suggestion
from .description import Robot
from .estimates import natural_sizes

TensionsLike = Mapping[str, float] | Sequence[float] | Floats


def are_tensions(tensions: object, robot: Robot) -> TypeGuard[Floats]:
    """Tell quickly whether values are tensions (m,) in order; False: they may be still."""
    if not (isinstance(tensions, np.ndarray) and tensions.shape == (len(robot.inputs),)):
        return False
    values = tensions.tolist()
    return bool(min(values) >= 0.0 and sum(values) < math.inf)  # NaN is neither


def tensions_of(robot: Robot, tensions: TensionsLike) -> Floats:
    """
    Return input tensions (m,) [N]; names left out are slack (0).

    Raises
    ------
    InputError
        Unknown names, or values that are negative or not finite.

    """
    if are_tensions(tensions, robot):
        return tensions.astype(float)
    values = finite('tensions', _in_order('tensions', robot, tensions, 0.0), len(robot.inputs))
    if (values < 0.0).any():
        raise _no_tension('tensions', robot, values[None])
    return values


def input_rows(robot: Robot, inputs: Any, kind: str = 'tension', what: str = '') -> Floats:
    """
    Return the inputs of several postures (b, m), tensions [N] or wire pulls [m] (nan: slack).

    Parameters
    ----------
    robot : Robot
    inputs : (b, m), DataFrame, structured array or mapping of columns
        Columns with names are taken by name, in any order.
    kind : str
        'tension' or 'displacement'.
    what : str
        For messages; default: 'tensions' or 'pulls'.

    Raises
    ------
    InputError
        A name is unknown or missing, another shape, a tension is negative or no number.

    """
    what = what or ('tensions' if kind == 'tension' else 'pulls')
    try:
        rows = np.ascontiguousarray(_in_order(what, robot, inputs, None), dtype=float)
    except (TypeError, ValueError):
        raise refusal(what, f'numbers for {", ".join(robot.inputs)}', inputs) from None
    if rows.ndim != 2 or rows.shape[1] != len(robot.inputs):
        raise InputError(
            f'{what}: expected (postures, {len(robot.inputs)}) numbers for '
            f'{", ".join(robot.inputs)}, got shape {rows.shape}'
        )
    if kind == 'tension':
        if not (rows.min(initial=0.0) >= 0.0 and rows.max(initial=0.0) < math.inf):
            raise _no_tension(what, robot, rows)
    elif np.isinf(rows).any():
        raise InputError(f'{what}: expected lengths [m] (nan: slack), got an infinite one')
    return rows


def _no_tension(what: str, robot: Robot, rows: Floats) -> InputError:
    """Return a message with the value of rows (b, m) that is no tension."""
    row, column = np.argwhere(~((rows >= 0.0) & (rows < math.inf)))[0].tolist()
    value, name = rows[row, column], robot.inputs[column]
    slack = '; say 0 where a tendon is slack' if math.isnan(value) else ''
    where = f'posture {row}, {name}' if len(rows) > 1 else name
    return InputError(
        f'{what}: {where}: expected a finite tension not below 0 N, got {value:g}{slack}'
    )


def wire_pulls(robot: Robot, pulls: TensionsLike) -> Floats:
    """
    Return wire pulls (m,) [m], NaN for slack; names left out are slack, drums wind their wires.

    Raises
    ------
    InputError
        Unknown names, a drum beside its wire, or values that are no lengths.

    """
    if (named := named_columns(pulls)) is not None:
        for drum, wires in robot.drums.items():
            if drum in named and (own := [wire for wire in wires if wire in named]):
                raise InputError(f'pulls: drum {drum!r} and its wire {own[0]!r}: name one of them')
        pulls = robot.wound({key: np.nan if x is None else x for key, x in named.items()})
    ordered = _in_order('pulls', robot, pulls, np.nan)
    try:
        values = np.array(ordered, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (len(robot.inputs),) or np.isinf(values).any():
        raise InputError(
            f'pulls: expected {len(robot.inputs)} lengths [m] (blank: slack), got {short(pulls)}'
        )
    return values


def finite(name: str, values: object, size: int) -> Floats:
    """
    Return a vector of finite numbers.

    Raises
    ------
    InputError
        It has another size, or entries that are no finite numbers.

    """
    try:
        array = np.array(values, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise refusal(name, f'{size} numbers', values) from None
    if array.shape != (size,) or not all(map(math.isfinite, array.tolist())):
        raise InputError(f'{name}: expected {size} finite numbers, got {short(array.tolist())}')
    return array


def _in_order(what: str, robot: Robot, values: Any, absent: float | None) -> Any:
    """Return values in the order of the inputs; `absent` replaces missing ones, None: refused."""
    if (named := named_columns(values)) is None:
        return values
    unknown = [name for name in named if name not in robot.inputs]
    missing = [name for name in robot.inputs if absent is None and name not in named]
    if unknown or missing:
        lacks = f'unknown {", ".join(map(repr, unknown))}' if unknown else ''
        lacks = lacks or f'{", ".join(map(repr, missing))} missing'
        hint = suggestion(unknown[0], robot.inputs) if unknown else ''
        raise InputError(f'{what}: {lacks}; {hint}{robot.name} has {", ".join(robot.inputs)}')
    if absent is None:
        return np.column_stack([np.asarray(named[name], dtype=float) for name in robot.inputs])
    return [named.get(name, absent) for name in robot.inputs]


def noise_scales(robot: Robot, inputs: Floats, kind: str) -> Floats:
    """
    Return what the relative noise of inputs (..., m) is relative to, in their unit.

    Of tensions their own size, because a load cell errs by a gain. Of wire pulls the radius of the
    outermost tendon, because the play of a wire does not grow with what is wound: 0.01 is then
    about 0.01 rad of bend. 0 where a wire is slack.
    """
    if kind == 'tension':
        return np.abs(inputs)
    return np.where(np.isnan(inputs), 0.0, natural_sizes(robot)['radius'])


def disturbed(robot: Robot, inputs: Floats, kind: str, setting: Floats, trial: Floats) -> Floats:
    """Return inputs (..., m) with two relative errors; a tension is never below zero."""
    factors = np.maximum((1.0 + setting) * (1.0 + trial), 0.0)
    return inputs + noise_scales(robot, inputs, kind) * (factors - 1.0)
