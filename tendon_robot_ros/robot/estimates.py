"""Plain sizes of a described robot: bend per newton, sag, weight; implausible values."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Floats
from ..common.words import STANDARD_GRAVITY, UNITS
from .description import Robot, tendon_offsets

# [rad] 20°, that the highest tension bends a section by, else its stiffness, or an offset, is in
# another unit: by a thousand, or ten
BEND_MIN_RAD = 0.35
# [1] of the largest input, to which load cells and the motors that follow them are known, because
# usual ones are no better
INPUT_TOLERANCE = 0.01
# [1] of the length: wire pulls that differ by less are the same, because so much changes the
# tension by `INPUT_TOLERANCE`
PULL_TOLERANCE = 0.002
# [N] a difference of tensions below is none, because it is below the noise of any load cell
SAME_TENSION_N = 1e-3
# ratio of two lengths beyond which one seems to be in mm and the other in m, because half of
# the thousand between the units, as decades count, is nearer to that than to 1
MILLIMETRES = math.sqrt(UNITS['length']['m'] / UNITS['length']['mm'])
# [1] of the length, beyond which no sag is said, because that of a straight beam is too large then
SAG_FRACTION_MAX = 0.3
# [1] of the length: sag of the level arm up to which an upright one stands, because a column
# buckles under a weight q L³ = 7.837 EI, and sags by q L⁴ / 8 EI (Greenhill 1881)
STANDS_UP_TO = 7.837 / 8.0
# [1] of the length, that the tip of an untried model may be off; beyond it a load or an effect is
# missing, because the bias of a calibrated model is smaller (docs/control.md)
MODEL_ERROR_MAX = 0.05
# [m] noise of a usual tracker, of all axes together, where no arm at rest has shown it: smaller
# differences are no motion, because no tracker resolves less
TRACKER_NOISE_M = 3e-4
# [1] times a noise or a known error of a model, because less may be by chance
NOISE_FACTOR = 3.0
# [1] of the terms of a sum; a smaller sum is 0, because it is the rounding of numbers that cancel
ROUNDING = 1e-12
# [rad] 2°, to which a person sets up, or sees, a direction, because nobody is better by eye
BY_EYE_RAD = math.radians(2.0)


def same_input(robot: Robot, kind: str) -> float:
    """Return the change [N] or [m] of an input, tension or displacement, that is none."""
    fraction, largest = INPUT_TOLERANCE, robot.tension_limits[1]
    if kind == 'displacement':
        fraction, largest = PULL_TOLERANCE, robot.length
    return fraction * largest


def stiffnesses(robot: Robot) -> Floats:
    """Return the bending stiffness of every cell, (n,) [N·m/rad]."""
    return np.concatenate([section.bending_stiffness for section in robot.sections])


def end_sections(robot: Robot) -> NDArray[np.int64]:
    """Return the index (m,) of the section in which each input ends."""
    names = [section.name for section in robot.sections]
    return np.array(
        [
            max(names.index(robot.tendons[k].section) for k in members)
            for members in robot.input_tendons
        ]
    )


def bend_rates(robot: Robot) -> Floats:
    """
    Return the bend per newton of each input, of the section in which it ends, (m, 2) [rad/N].

    The sum over its cells of offset / stiffness: no friction, small bends (PCCA). A group whose
    tendons balance bends by exactly 0.
    """
    per_newton = tendon_offsets(robot) / stiffnesses(robot)[:, None, None]  # (n, k, 2)
    sections = np.repeat(np.arange(len(robot.sections)), [s.cells for s in robot.sections])
    own = [
        per_newton[sections == last][:, list(members)]
        for last, members in zip(end_sections(robot), robot.input_tendons, strict=True)
    ]
    rates, sizes = (
        np.array([one.sum(axis=(0, 1)) for one in of]) for of in (own, map(np.abs, own))
    )
    return np.where(np.abs(rates) > ROUNDING * sizes, rates, 0.0)


def mass(robot: Robot) -> float:
    """Return the mass of the arm [kg], 0 where the description has no `gravity`."""
    density = robot.effects.get('gravity', {}).get('linear_density', 0.0)
    if isinstance(density, tuple):
        return 0.0
    profile = sum(s.cell_length * sum(s.mass_profile) for s in robot.sections)
    return float(density) * profile


def sag(robot: Robot, force: float = 0.0, weight: float = 0.0) -> float:
    """
    Return the sag of the tip of the level arm [m], for small bends.

    Every cell bends by its moment over its stiffness, at its middle.

    Parameters
    ----------
    robot : Robot
        Gives lengths and stiffness.
    force : float
        [N] at the tip.
    weight : float
        [N] of the arm, spread evenly.

    """
    lengths = robot.cell_lengths
    beyond = robot.length - (np.cumsum(lengths) - 0.5 * lengths)  # [m] from mid-cell to the tip
    moments = force * beyond + 0.5 * weight / robot.length * beyond**2
    return float(np.sum(moments / stiffnesses(robot) * beyond))


def handling(robot: Robot) -> list[str]:
    """Return lines: bend per newton of each input, weight of the arm, implausible values."""
    rates = np.linalg.norm(bend_rates(robot), axis=1)
    groups: dict[str, list[str]] = {}
    for name, rate, last in zip(robot.inputs, rates, end_sections(robot), strict=True):
        section = robot.sections[last].name if len(robot.own_sections) > 1 else 'the arm'
        text = f'bends {section} by {_degrees(rate)}'
        groups.setdefault(text, []).append(name)
    lines = [f'1 N on {" or ".join(names)} {text}' for text, names in groups.items()]
    lines[0] += ' (without friction)'
    if (kilograms := mass(robot)) > 0.0:
        drop = sag(robot, weight=STANDARD_GRAVITY * kilograms)
        sags = f'sags by {_number(1e3 * drop, 2)} mm at the tip'
        if drop > SAG_FRACTION_MAX * robot.length:
            sags = 'hangs down under its own weight'
        upright = '; upright, it bends over' if drop > STANDS_UP_TO * robot.length else ''
        lines.append(f'weighs {_number(1e3 * kilograms)} g; level, it {sags}{upright}')
    wrong = _other_units(robot) or _other_stiffness(robot, rates)
    return [*lines, f'NOT PLAUSIBLE: {wrong}' if wrong else _plausible(robot, rates)]


def _plausible(robot: Robot, rates: Floats) -> str:
    """Return a line about the range of the tensions."""
    top, moving = robot.tension_limits[1], rates[rates > 0.0]
    needed = sorted({_number(0.5 * math.pi / rate, 2) for rate in moving}, key=float)
    span = needed[0] if len(needed) == 1 else f'{needed[0]} to {needed[-1]}'
    if 0.5 * math.pi / moving.max() > top:
        bend = _degrees(top * float(moving.max()))
        return f'plausible: {top:g} N, the most that may pull, bend by {bend} (90° take {span} N)'
    return f'plausible: 90° take {span} N, at most {top:g} N may pull'


def _other_stiffness(robot: Robot, rates: Floats) -> str:
    """Say which input bends its section by too little or too much to be plausible, '' if none."""
    low, top = robot.tension_limits
    right_angle = 0.5 * math.pi
    for name, rate in zip(robot.inputs, rates.tolist(), strict=True):
        if 0.0 < rate * top < BEND_MIN_RAD:
            return (
                f'{name} at its limit of {top:g} N bends by {_degrees(rate * top)} only; is '
                'bending_stiffness too high (N·m/rad of one cell), or an offset too small (m)?'
            )
        if rate * max(low, INPUT_TOLERANCE * top) > right_angle:
            return (
                f'{name} bends by 90° at {right_angle / rate:.2g} N, with tensions from '
                f'{low:g} to {top:g} N; is bending_stiffness too low (N·m/rad of one cell), or '
                'tension_limits too high (N)?'
            )
    return '' if rates.any() else 'no input bends its section; are the signs of the offsets right?'


def _other_units(robot: Robot) -> str:
    """
    Say where a length or an offset seems to be in millimetres, '' if nowhere.

    Cells of arms are about as long as their tendons are off the centre, within a factor of some
    tens: where the one is more than `MILLIMETRES` times the other, millimetres suit better.
    """
    offsets = np.linalg.norm(tendon_offsets(robot), axis=2).max(axis=1)  # (n,) [m]
    first = 0
    for section in robot.sections:
        offset, first = float(offsets[first]), first + section.cells
        ratio = section.cell_length / offset if offset > 0.0 else 1.0
        if section.is_plate or 1.0 / MILLIMETRES < ratio < MILLIMETRES:
            continue
        wrong = 'cell_length' if ratio > 1.0 else 'the offset'
        return (
            f'a cell of {section.name} is {1e3 * section.cell_length:.4g} mm long, the tendons '
            f'are {1e3 * offset:.4g} mm off the centre; is {wrong} in mm? Write m'
        )
    return ''


def _degrees(angle: float) -> str:
    return f'{_number(math.degrees(angle))}°'


def _number(value: float, count: int = 3) -> str:
    """Show significant digits of a number, those of thousands without an exponent."""
    return f'{float(f"{value:.{count}g}"):g}'


def rod_stiffness(modulus: float, outer: float, inner: float, length: float) -> float:
    """
    Return the bending stiffness of a cell [N·m/rad]: E π (D⁴ - d⁴) / 64 over its length.

    Parameters
    ----------
    modulus : float
        Young's modulus E [Pa].
    outer, inner : float
        Diameters D and d [m]; d = 0 for a rod.
    length : float
        Of the cell [m].

    """
    return modulus * math.pi * (outer**4 - inner**4) / 64.0 / length


def stiffness_from_sag(force: float, drop: float, cells: int, length: float) -> float:
    """
    Return the stiffness [N·m/rad] of each of n equal cells whose tip sags under a force.

    Parameters
    ----------
    force : float
        [N] at the tip of the level arm.
    drop : float
        [m] that the tip sags by.
    cells, length : int, float
        Number of cells, and the length of one [m].

    """
    beyond = length * (cells - 0.5 - np.arange(cells))
    return float(force * np.sum(beyond**2) / drop)


def stiffness_from_bend(tension: float, bend: float, cells: int, offset: float) -> float:
    """Return the stiffness [N·m/rad] of cells that a tension [N] bends by an angle [rad]."""
    return tension * offset * cells / bend


def natural_sizes(robot: Robot) -> dict[str, float]:
    """
    Return natural sizes of a robot, in SI units; a robot scaled in length or force scales them.

    They are the scales of its physics, not its limits: radius [m] of the outermost tendon, length
    [m], bend [rad] of a cell of an arm that bends by one radian, stiffness [N·m/rad] of a cell,
    tension [N] of one tendon that bends the arm by one radian (at most the limit), force [N]
    across the tip that does about the same, its moment [N·m] about the base and stiffness [N/m] of
    such a tip, curvature [1/m] of a radian over the length, density [kg/m] whose weight is such a
    force, and the inverse of the tension per unit of length, compliance [1/N], and per radius,
    give [m/N].
    """
    stiffness = [k for section in robot.sections for k in section.bending_stiffness]
    softness = sum(1.0 / k for k in stiffness)
    own = robot.cells - robot.plate_cells or robot.cells  # all of an arm as short as a plate
    distances = [[math.hypot(*at) for at in t.offsets or (t.base, t.end)] for t in robot.tendons]
    radius = max(map(max, distances)) or 0.03 * robot.length  # tendons along the centroid
    per_newton = max(
        sum(far) / len(far) * sum(1.0 / k for k in stiffness[:cells])
        for far, cells in zip(distances, robot.tendon_cells, strict=True)
    )
    tension = min(1.0 / (per_newton or radius * softness), robot.tension_limits[1])
    force = 1.0 / (softness * robot.length)
    return {
        'radius': radius,
        'length': robot.length,
        'bend': 1.0 / own,
        'stiffness': own / softness,
        'tension': tension,
        'force': force,
        'moment': force * robot.length,
        'tip_stiffness': force / robot.length,
        'curvature': 1.0 / robot.length,
        'density': force / (STANDARD_GRAVITY * robot.length),
        'compliance': 1.0 / tension,
        'give': radius / tension,
    }
