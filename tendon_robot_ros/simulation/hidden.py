"""
What a robot does that its description does not say.

Hidden effects of the catalogue, causes outside it, laws that only a plant has, and the ordinary
imperfections of how a robot is built.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from inspect import signature

import numpy as np

from ..common.arrays import Floats
from ..common.errors import EffectError, number, refusal, suggestion
from ..effects import Catalogue, Effect, Parameter
from ..robot import Robot
from ..robot.description import EffectValues, planar_axis

# [1] 1 sd of the stiffness from cell to cell of a plant; its owner would know so much of it
STIFFNESS_SCATTER = 0.02
SCATTER_MAX = 0.2  # [1] 1 sd of any imperfection, else cells softer by five of them had none left


class Damage:
    """Hidden damage of a robot of n cells, at first none."""

    def __init__(self, robot: Robot, seed: int) -> None:
        """Draw from the seed how gain and rotation vary from posture to posture."""
        size = 4, len(robot.inputs) + 1
        self.robot, self.waves = robot, np.random.default_rng([seed, 77]).normal(size=size)
        self.stiffness = np.ones(robot.cells)  # [1] factor on the bending stiffness
        self.gain = 0.0  # [1] largest deviation of the tensions' gain
        self.rotation = 0.0  # [rad] largest rotation of the tracker

    def deviations(self, inputs: Floats) -> Floats:
        """
        Return four numbers (b, 4) in [-1, 1] that vary with the inputs (b, m) as no law does.

        Inputs in units that bend the arm by half a radian; NaN (slack) counts as 0.
        """
        phase = np.nan_to_num(inputs) @ self.waves[:, 1:].T + 7.0 * self.waves[:, 0]
        return np.sin(phase)


def soft_cell(damage: Damage, cell: float | None = None, factor: float = 0.6) -> None:
    """One cell, counted as in its name, is softer: its stiffness times `factor`."""
    below = damage.robot.plate_cells
    n = damage.robot.cells - below
    number = (2 * n + 2) // 3 if cell is None else cell
    if number not in range(1, n + 1):
        raise EffectError(f'cell: expected a whole number from 1 (base) to {n}, got {number}')
    damage.stiffness[below + int(number) - 1] *= factor


def stiffness_gradient(damage: Damage, relative_change: float = 0.4) -> None:
    """Change the stiffness linearly from the base to `relative_change` more at the tip."""
    along = np.linspace(-0.5, 0.5, damage.robot.cells)
    damage.stiffness *= 1.0 + relative_change * along


def posture_gain(damage: Damage, size: float = 0.1) -> None:
    """Let every posture have its own gain of the tensions, at most `size` off."""
    damage.gain = size


def posture_rotation(damage: Damage, size: float = 0.03) -> None:
    """Let the tracker's frame turn from posture to posture, at most `size` [rad] about an axis."""
    damage.rotation = size


# causes outside the catalogue, by name; their parameters follow the damage that they do
_DAMAGING = (soft_cell, stiffness_gradient, posture_gain, posture_rotation)
CAUSES: dict[str, Callable[..., None]] = {cause.__name__: cause for cause in _DAMAGING}


HiddenValues = Mapping[str, float | Sequence[float]]
Hidden = Mapping[str, HiddenValues | None]  # None or empty: the typical size


def hide(
    robot: Robot, hidden: Hidden, catalogue: Catalogue, damage: Damage
) -> dict[str, EffectValues]:
    """
    Return the effects of the real robot: the owner's and the hidden ones; do the hidden damage.

    Raises
    ------
    EffectError
        An effect or parameter is unknown or out of its bounds.

    """
    effects: dict[str, EffectValues] = {name: dict(own) for name, own in robot.effects.items()}
    if not isinstance(hidden, Mapping):
        raise refusal('hidden', "a dict such as {'tip_load': {'force_x': 0.01}}", hidden)
    for name, parameters in hidden.items():
        values = {} if parameters is None else parameters
        if not isinstance(values, Mapping):
            raise refusal(f'hidden: {name}', 'its parameters as a dict', values)
        if name in CAUSES:
            _, *known = signature(CAUSES[name]).parameters
            _refuse_unknown(name, values, known)
            CAUSES[name](damage, **{key: _one(name, key, v) for key, v in values.items()})
            if not (np.all(damage.stiffness > 0.0) and abs(damage.gain) < 1.0):
                expected = 'expected a size that leaves stiffness and tensions'
                raise EffectError(f'{name}: {expected}, got {dict(values)}')
        elif name in catalogue:
            effects[name] = chosen(catalogue[name], values, robot)
        else:
            near = suggestion(name, (*catalogue.names, *CAUSES))
            raise EffectError(
                f'unknown hidden effect {name!r}; {near}in the catalogue: '
                f'{", ".join(catalogue.names)}; outside it: {", ".join(CAUSES)}'
            )
    return effects


def chosen(effect: Effect, values: HiddenValues, robot: Robot) -> EffectValues:
    """
    Return checked parameters of an effect; without any, the sizes that typically matter.

    A typical force, curvature or rotation lies along x, a change per section grows to the tip.

    Raises
    ------
    EffectError
        A parameter is unknown or out of its bounds.

    """
    _refuse_unknown(effect.name, values, [p.name for p in effect.parameters])
    result: EffectValues = {}
    sections = len(robot.sections)
    for parameter in effect.parameters:
        shapes = parameter.has_default or parameter.only_described
        if parameter.name in values:
            result[parameter.name] = checked(effect.name, parameter, values[parameter.name], robot)
        elif values or shapes or parameter.name.endswith(('_y', '_z')):
            result[parameter.name] = parameter.neutral
        elif parameter.per_section and sections > 1:
            typical = parameter.typical
            result[parameter.name] = tuple(typical * (i + 1) / sections for i in range(sections))
        else:
            result[parameter.name] = parameter.typical
    return result


def checked(
    effect: str, parameter: Parameter, value: float | Sequence[float], robot: Robot
) -> float | tuple[float, ...]:
    """Return a number, or one per section or tendon; EffectError where it is out of bounds."""
    many = isinstance(value, Sequence) and not isinstance(value, str)
    entries = value if isinstance(value, Sequence) and many else [value]
    numbers = tuple(_one(effect, parameter.name, entry) for entry in entries)
    count = {'section': len(robot.sections), 'tendon': len(robot.tendons)}.get(parameter.per)
    if many and len(numbers) != count:
        expected = f'{count} numbers, one per {parameter.per}' if count else 'one number'
        raise EffectError(f'{effect}: {parameter.name}: expected {expected}, got {len(numbers)}')
    for one in numbers:
        if expected := parameter.expected(one, described=False):
            raise EffectError(f'{effect}: {parameter.name}: expected {expected}, got {one:g}')
    return numbers if many else numbers[0]


def _refuse_unknown(name: str, values: HiddenValues, known: Collection[str]) -> None:
    for key in values:
        if key not in known:
            raise EffectError(f'{name}: expected one of {", ".join(known)}, got {key!r}')


def _one(name: str, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, float | int):
        raise EffectError(f'{name}: {key}: expected one number, got {value!r}')
    return float(value)


def capstan(passed, turning, friction_coefficient, wraps, exponential):  # type: ignore[no-untyped-def]
    """
    Tension behind an eyelet over tension before it, exp(-mu wrap) (Euler, Eytelwein).

    The wrap is `wraps` times the angle that this cell turns the tendon; `exponential` 0: the
    paper's (1 - b) / (1 + b) at that angle.
    """
    half = wraps * math.asin(min(turning, 1.0))
    if exponential != 0.0:
        return passed * math.exp(-2.0 * friction_coefficient * half)
    b = friction_coefficient * math.sin(half)
    return passed * (1.0 - b) / (1.0 + b)


def plant_catalogue(catalogue: Catalogue) -> Catalogue:
    """Return the catalogue with the capstan for tendon friction, every parameter one per cell."""
    friction = catalogue['tendon_friction']
    wraps = Parameter('wraps', '1', 0.0, math.inf, 1.0, typical=1.0, per_section=True)
    exponential = Parameter('exponential', '1', 0.0, 1.0, 0.0, typical=1.0)
    parameters = (*friction.parameters, wraps, exponential)
    friction = replace(friction, law=capstan, parameters=parameters)
    effects = []
    for effect in catalogue:  # finer cells have other values, each its own, beyond all bounds
        if effect.name != 'tendon_friction':
            wide = tuple(
                replace(p, low=-math.inf, high=math.inf, per_section=effect.values_of == 'section')
                for p in effect.parameters
            )
            effects.append(replace(effect, parameters=wide))
    return Catalogue([friction, *effects], catalogue.files, catalogue.is_sized)


@dataclass(frozen=True)
class Workmanship:
    """One standard deviation of each imperfection, as in an ordinary laboratory."""

    stiffness: float = 0.03  # [1] from cell to cell
    kink: float = float(np.radians(0.1))  # [rad] of each cell at rest
    gain: float = 0.01  # [1] of the reading of each input
    hole: float = 0.01  # [1] of the radius at which each tendon runs
    position: float = 3e-4  # [m] of the tracker's frame, per axis
    rotation: float = float(np.radians(0.2))  # [rad] of the tracker's frame, per axis

    def __post_init__(self) -> None:
        """
        Refuse what is no standard deviation.

        Raises
        ------
        InputError

        """
        for one in fields(self):
            number(f'workmanship: {one.name}', getattr(self, one.name), 0.0, SCATTER_MAX, 'SI')

    def times(self, factor: float) -> Workmanship:
        """Return better (below 1) or worse work."""
        return Workmanship(*(factor * getattr(self, field.name) for field in fields(self)))


@dataclass(frozen=True)
class Built:
    """The imperfections of one robot."""

    stiffness: Floats  # (n,) [1] relative
    kink: Floats  # (n, 2) [rad]
    gain: Floats  # (m,) [1]
    hole: Floats  # (k,) [1]
    position: Floats  # (3,) [m]
    rotation: Floats  # (3,) [rad]

    @classmethod
    def draw(cls, robot: Robot, work: Workmanship, seed: int) -> Built:
        """Build a robot; a planar one has kinks in its plane only."""
        random = np.random.default_rng([seed, 41])
        n, m, k = robot.cells, len(robot.inputs), len(robot.tendons)
        axis = planar_axis(robot)
        plane = np.ones(2) if axis is None else np.eye(2)[axis]
        return cls(
            work.stiffness * random.normal(size=n).clip(-4, 4),
            work.kink * random.normal(size=(n, 2)) * plane,
            work.gain * random.normal(size=m),
            work.hole * random.normal(size=k),
            work.position * random.normal(size=3),
            work.rotation * random.normal(size=3),
        )

    @classmethod
    def exact(cls, robot: Robot) -> Built:
        """Return a robot without any."""
        return cls.draw(robot, Workmanship(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0)

    @property
    def sizes(self) -> dict[str, float]:
        """How much the cells scatter (rms): their stiffness [1], their kinks [rad]."""
        planes = max(int(self.kink.any(axis=0).sum()), 1)  # in which it has kinks
        return {
            'cell_stiffness': float(np.sqrt(np.mean(self.stiffness**2))),
            'cell_kink': float(np.sqrt(np.mean((self.kink**2).sum(axis=1)) / planes)),
        }

    def text(self, robot: Robot) -> list[str]:
        """Return a description of the imperfections of a robot."""
        worst = int(np.argmax(np.abs(self.stiffness)))
        gains, holes = (
            ', '.join(f'{100.0 * x:+.1f} %' for x in part) for part in (self.gain, self.hole)
        )
        shift, turn = (
            ', '.join(f'{x:+.2f}' for x in part)
            for part in (1e3 * self.position, np.degrees(self.rotation))
        )
        return [
            f'cells scatter by {100.0 * np.std(self.stiffness):.1f} % in stiffness '
            f'(most {robot.cell_names[worst]}: {100.0 * self.stiffness[worst]:+.0f} %), '
            f'kinks of {np.degrees(self.sizes["cell_kink"]):.2f}°',
            f'inputs off by {gains}; holes by {holes}',
            f'tracker off by {shift} mm and {turn}°',
        ]
