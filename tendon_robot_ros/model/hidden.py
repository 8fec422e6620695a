"""What a plant hides: effects of the catalogue, and causes outside it, with checked parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..effects import Catalogue, Effect, Parameter
from ..exceptions import EffectError
from ..robot import EffectValues, Robot
from .causes import CAUSES, Damage

Values = Mapping[str, float | Sequence[float]]
Hidden = Mapping[str, Values | None]  # None or empty: the typical size


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
    for name, given in hidden.items():
        values = given or {}
        if name in CAUSES:
            _refuse_unknown(name, values, tuple(CAUSES[name].parameters))
            CAUSES[name].act(damage, {key: _one(name, key, v) for key, v in values.items()})
        elif name in catalogue:
            effects[name] = chosen(catalogue[name], values, len(robot.sections))
        else:
            raise EffectError(
                f'unknown hidden effect {name!r}; in the catalogue: '
                f'{", ".join(catalogue.names)}; outside it: {", ".join(CAUSES)}'
            )
    return effects


def chosen(effect: Effect, values: Values, sections: int) -> EffectValues:
    """
    Return checked parameters of an effect; without any, the sizes that typically matter.

    A typical force, curvature or rotation lies along x, a change per section grows to the tip.

    Raises
    ------
    EffectError
        A parameter is unknown or out of its bounds.

    """
    _refuse_unknown(effect.name, values, tuple(p.name for p in effect.parameters))
    made: EffectValues = {}
    for parameter in effect.parameters:
        if parameter.name in values:
            made[parameter.name] = _checked(
                effect.name, parameter, values[parameter.name], sections
            )
        else:
            made[parameter.name] = parameter.neutral if values else _typical(parameter, sections)
    return made


def _typical(parameter: Parameter, sections: int) -> float | tuple[float, ...]:
    if parameter.name.endswith(('_y', '_z')):
        return parameter.neutral
    if parameter.per_section and sections > 1:
        return tuple(parameter.typical * (i + 1) / sections for i in range(sections))
    return parameter.typical


def _checked(
    effect: str, parameter: Parameter, value: float | Sequence[float], sections: int
) -> float | tuple[float, ...]:
    many = isinstance(value, Sequence) and not isinstance(value, str)
    given = list(value) if isinstance(value, Sequence) and many else [value]
    numbers = tuple(_one(effect, parameter.name, number) for number in given)
    if many and not (parameter.per_section and len(numbers) == sections):
        wanted = f'{sections} numbers, one per section' if parameter.per_section else 'one number'
        raise EffectError(f'{effect}: {parameter.name}: expected {wanted}, got {len(numbers)}')
    for number in numbers:
        if not parameter.low <= number <= parameter.high:
            raise EffectError(
                f'{effect}: {parameter.name}: expected a number from {parameter.low:g} to '
                f'{parameter.high:g} [{parameter.unit}], got {number:g}'
            )
    return numbers if many else numbers[0]


def _refuse_unknown(name: str, values: Values, known: tuple[str, ...]) -> None:
    for key in values:
        if key not in known:
            raise EffectError(f'{name}: expected one of {", ".join(known)}, got {key!r}')


def _one(name: str, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, float | int):
        raise EffectError(f'{name}: {key}: expected one number, got {value!r}')
    return float(value)
