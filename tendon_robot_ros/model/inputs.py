"""What a caller commands: tensions and wire pulls, by name or in order, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeGuard

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..robot import Robot

Floats = npt.NDArray[np.float64]
TensionsLike = Mapping[str, float] | Sequence[float] | Floats


def are_tensions(tensions: object, robot: Robot) -> TypeGuard[Floats]:
    """Tell whether these are numbers (m,) that may be tensions, in order; False: look closer."""
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
    values = finite('tensions', _ordered('tensions', robot, tensions, 0.0), len(robot.inputs))
    if (values < 0.0).any():
        raise InputError(f'tensions: expected none below 0 N, got {values}')
    return values


def tension_rows(robot: Robot, tensions: npt.ArrayLike) -> Floats:
    """
    Return input tensions of several postures (b, m) [N].

    Raises
    ------
    InputError
        Another shape, or values that are negative or not finite.

    """
    rows = np.ascontiguousarray(tensions, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != len(robot.inputs):
        raise InputError(
            f'tensions: expected (postures, {len(robot.inputs)}) numbers for '
            f'{", ".join(robot.inputs)}, got shape {rows.shape}'
        )
    if not (rows.min(initial=0.0) >= 0.0 and rows.max(initial=0.0) < math.inf):
        raise InputError('tensions: expected finite numbers not below 0 N')
    return rows


def wire_pulls(robot: Robot, pulls: TensionsLike) -> Floats:
    """
    Return wire pulls (m,) [m], NaN for slack; names left out are slack, drums wind their wires.

    Raises
    ------
    InputError
        Unknown names, or values that are no lengths.

    """
    by_wire = robot.wound(pulls) if isinstance(pulls, Mapping) else pulls
    ordered = _ordered('pulls', robot, by_wire, np.nan)
    try:
        values = np.array(ordered, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (len(robot.inputs),) or np.isinf(values).any():
        raise InputError(
            f'pulls: expected {len(robot.inputs)} lengths [m] (blank: slack), got {pulls!r}'
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
        raise InputError(f'{name}: expected {size} numbers, got {values!r}') from None
    if array.shape != (size,) or not all(map(math.isfinite, array.tolist())):
        raise InputError(f'{name}: expected {size} finite numbers, got {np.asarray(values)}')
    return array


def _ordered(what: str, robot: Robot, values: TensionsLike, absent: float) -> object:
    if not isinstance(values, Mapping):
        return values
    unknown = [name for name in values if name not in robot.inputs]
    if unknown:
        raise InputError(
            f'{what}: unknown {", ".join(map(repr, unknown))}; '
            f'{robot.name} has {", ".join(robot.inputs)}'
        )
    return [values.get(name, absent) for name in robot.inputs]
