"""What a fit found, written into a description: effects, tolerances that moved, imperfections."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..comparison.predict import CELLS, FreeParameter
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from ..robot.description import EffectValues
from .as_built import GAIN, HOLE, POSITION, ROTATION, ZERO
from .fit import Fit

Floats = npt.NDArray[np.float64]
WRITABLE_KINDS = (CELLS, GAIN, HOLE, ZERO, POSITION, ROTATION)  # kinds that a description can hold


def with_values(
    robot: Robot, catalogue: Catalogue, values: Iterable[tuple[FreeParameter, float]]
) -> Robot:
    """Return a description with values of parameters; others of their effects stay as they are."""
    found: dict[str, dict[str, list[tuple[int | None, float]]]] = {}
    for free, value in values:
        items = found.setdefault(free.effect, {})
        items.setdefault(free.parameter.name, []).append((free.column, _short(value)))
    counts = {'section': len(robot.sections), 'tendon': len(robot.tendons)}
    for name, items in found.items():
        parameters = {p.name: p for p in catalogue[name].parameters}
        known = {key: p.neutral for key, p in parameters.items()} | robot.effects.get(name, {})
        changed = {
            key: _entry(own, known[key], counts.get(parameters[key].per, 1))
            for key, own in items.items()
        }
        robot = robot.with_effect(name, known | changed, robot.fitted.get(name))
    return robot


def _entry(
    own: Sequence[tuple[int | None, float]], before: float | tuple[float, ...], count: int
) -> float | tuple[float, ...]:
    """Return the value of a parameter, or of those of so many sections or tendons, changed."""
    if own[0][0] is None or count == 1:
        return own[0][1]
    each = list(before) if isinstance(before, tuple) else [before] * count
    for column, value in own:
        each[column or 0] = value
    return tuple(each)


def changed_robot(robot: Robot, catalogue: Catalogue, fit: Fit, dataset: DataSet) -> Robot:
    """Return the description with the fitted effects."""
    values = list(zip(fit.frees, fit.values.tolist(), strict=False))
    robot = with_values(robot, catalogue, values)
    if robot.gravity is None and any(catalogue[f.effect].needs == 'gravity' for f in fit.frees):
        robot = replace(robot, gravity=dataset.gravity)
    return robot


def with_tolerances(robot: Robot, catalogue: Catalogue, fit: Fit) -> Robot:
    """Return a description whose declared quantities have the values to which a fit moved them."""
    moved = list(zip(fit.all_frees, fit.values.tolist(), strict=False))[len(fit.frees) :]
    own = [value for free, value in moved if free.effect == CELLS]
    robot = with_cells(robot, np.array(own)) if own else robot
    return with_values(robot, catalogue, (one for one in moved if one[0].effect != CELLS))


def with_cells(robot: Robot, changes: Floats) -> Robot:
    """Return a description whose cells are stiffer by relative changes (n,)."""
    ends = np.cumsum([section.cells for section in robot.sections])
    sections = tuple(
        replace(
            section,
            bending_stiffness=tuple(
                _short(k * (1.0 + change))
                for k, change in zip(
                    section.bending_stiffness, changes[end - section.cells : end], strict=True
                )
            ),
        )
        for section, end in zip(robot.sections, ends, strict=True)
    )
    return replace(robot, sections=sections)


def written_members(fit: Fit, units: Floats) -> dict[str, Floats]:
    """Return the imperfections that a description can hold, from mixtures in units of their sd."""
    if fit.built is None:
        return {}
    named = fit.built.random.named(units, fit.built.sizes)
    return {kind: values for kind, values in named.items() if kind in WRITABLE_KINDS}


def with_members(robot: Robot, fit: Fit, input: str) -> Robot:
    """
    Return a description with the cells, tendons and the registration as a fit found them.

    The gain of a tension is written as an offset of its tendons: their product is what bends.
    Those of wire pulls are `spool_gain` and `pull_zero` of each tendon. Kinks have no place in a
    description.
    """
    values = fit.members
    if values is None:
        return robot
    robot = with_cells(robot, values.get(CELLS, np.zeros(robot.cells)))
    scale = np.ones(len(robot.tendons))
    if input == 'tension':
        for change, members in zip(values.get(GAIN, ()), robot.input_tendons, strict=False):
            scale[list(members)] *= 1.0 + change
    scale *= 1.0 + values.get(HOLE, np.zeros(len(scale)))
    tendons = tuple(
        replace(t, base=_scaled(t.base, factor), end=_scaled(t.end, factor))
        for t, factor in zip(robot.tendons, scale.tolist(), strict=True)
    )
    robot = replace(robot, tendons=tendons)
    return _registered(robot if input == 'tension' else wound(robot, values), values)


def wound(robot: Robot, members: dict[str, Floats]) -> Robot:
    """Write gains and zeros of wire pulls: wound = commanded (1 + change) + offset."""
    gain, zero = np.zeros(len(robot.tendons)), np.zeros(len(robot.tendons))
    for kind, values in ((GAIN, gain), (ZERO, zero)):
        for value, tendons in zip(members.get(kind, ()), robot.input_tendons, strict=False):
            values[list(tendons)] = value
    change = np.array(robot.effects.get('spool_gain', {}).get('relative_change', 0.0))
    offset = np.array(robot.effects.get('pull_zero', {}).get('offset', 0.0))
    for name, key, values in (
        ('pull_zero', 'offset', offset + zero * (1.0 + change)),
        ('spool_gain', 'relative_change', (1.0 + gain) * (1.0 + change) - 1.0),
    ):
        if (zero if name == 'pull_zero' else gain).any():
            written = tuple(_short(value) for value in values.tolist())
            robot = robot.with_effect(name, {key: written}, robot.fitted.get(name))
    return robot


def _registered(robot: Robot, members: dict[str, Floats]) -> Robot:
    """Add the registration to what the description says of it."""
    before, values = robot.effects.get('base_misalignment', {}), EffectValues()
    for kind, key in ((POSITION, 'shift'), (ROTATION, 'rotation')):
        for axis, change in zip('xyz', members.get(kind, np.zeros(3)).tolist(), strict=True):
            old = before.get(f'{key}_{axis}', 0.0)
            values[f'{key}_{axis}'] = _short((old if isinstance(old, float) else old[0]) + change)
    if not any(members.get(kind, np.zeros(3)).any() for kind in (POSITION, ROTATION)):
        return robot
    return robot.with_effect('base_misalignment', values, robot.fitted.get('base_misalignment'))


def _scaled(offset: tuple[float, float], factor: float) -> tuple[float, float]:
    return (_short(offset[0] * factor), _short(offset[1] * factor))


def _short(value: float) -> float:
    return float(f'{value:.6g}')
