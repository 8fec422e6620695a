"""What a fit found of an arm as it is built, written into its description."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..comparison.predict import CELLS
from ..robot import Robot
from ..robot.description import EffectValues
from .as_built import GAIN, HOLE, POSITION, ROTATION, ZERO
from .fit import Fit

Floats = npt.NDArray[np.float64]
WRITABLE_KINDS = (CELLS, GAIN, HOLE, ZERO, POSITION, ROTATION)  # kinds that a description can hold


def written_share(fit: Fit) -> Floats:
    """Return 1 for every imperfection (b,) that a description can hold, else 0."""
    assert fit.built is not None
    return np.concatenate(
        [np.full(len(k), float(k.name in WRITABLE_KINDS)) for k in fit.built.kinds]
    )


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
    off = values.get(CELLS, np.zeros(robot.cells))
    ends = np.cumsum([section.cells for section in robot.sections])
    sections = tuple(
        replace(
            section,
            bending_stiffness=tuple(
                _short(k * (1.0 + change))
                for k, change in zip(
                    section.bending_stiffness, off[end - section.cells : end], strict=True
                )
            ),
        )
        for section, end in zip(robot.sections, ends, strict=True)
    )
    scale = np.ones(len(robot.tendons))
    if input == 'tension':
        for change, members in zip(values.get(GAIN, ()), robot.input_tendons, strict=False):
            scale[list(members)] *= 1.0 + change
    scale *= 1.0 + values.get(HOLE, np.zeros(len(scale)))
    tendons = tuple(
        replace(t, base=_scaled(t.base, factor), end=_scaled(t.end, factor))
        for t, factor in zip(robot.tendons, scale.tolist(), strict=True)
    )
    robot = replace(robot, sections=sections, tendons=tendons)
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
