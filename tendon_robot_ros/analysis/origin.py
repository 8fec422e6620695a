"""What an addition writes into a robot description, and how that is undone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any

from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from .fit import Fit
from .result import Value
from .staircase import Errors


@dataclass(frozen=True)
class Addition:
    """A description with fitted effects, and what they do to the error."""

    robot: Robot
    values: dict[str, dict[str, Value]]  # effect -> parameter -> value with its interval
    fitted: Errors  # on the postures of the fit
    check: Errors  # on a check set, else on postures left out in turn
    probability: float  # of so much remaining error if nothing else is at work
    moved: dict[str, float] = field(default_factory=dict)  # tolerance -> declared sd it moved
    more_at_work: str = ''  # what the file says when the effects are not the whole story

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            'effects': {
                name: {key: vars(value) for key, value in values.items()}
                for name, values in self.values.items()
            },
            'fitted': vars(self.fitted),
            'check': vars(self.check),
            'probability': self.probability,
            'moved': self.moved,
            'more_at_work': self.more_at_work,
        }


def changed_robot(robot: Robot, catalogue: Catalogue, fit: Fit, dataset: DataSet) -> Robot:
    """Return the description with the fitted effects."""
    fitted: dict[str, dict[str, list[float]]] = {}
    for free, value in zip(fit.frees, fit.values, strict=False):
        items = fitted.setdefault(free.effect, {})
        items.setdefault(free.parameter.name, []).append(float(f'{value:.6g}'))
    for name, items in fitted.items():
        wide = {p.name for p in catalogue[name].parameters if p.per_section}
        robot = robot.with_effect(
            name,
            {key: tuple(v) if key in wide and len(v) > 1 else v[0] for key, v in items.items()},
        )
        if name == 'gravity' and robot.gravity is None:
            robot = replace(robot, gravity=dataset.gravity)
    return robot


def with_origin(made: Addition, before: Robot) -> Robot:
    """Return the description with where its fitted values come from."""
    robot = made.robot
    error: dict[str, Any] = {'unit': 'm'}
    for one in (made.fitted, made.check):
        numbers = {key: _short(getattr(one, key)) for key in ('before', 'after', 'floor')}
        error[one.kind.replace(' ', '_')] = {'data': one.data, **numbers}
    for name, values in made.values.items():
        origin: dict[str, Any] = {
            'parameters': {key: _plain(value) for key, value in values.items()},
            'data': made.fitted.data,
            'date': date.today().isoformat(),
            'error': error,
        }
        if len(made.values) > 1:
            origin['together_with'] = [other for other in made.values if other != name]
        if name in before.effects:
            origin['replaces'] = _listed(before.effects[name])
        if made.moved:
            origin['tolerances_moved'] = {key: _short(z) for key, z in made.moved.items()}
        if made.more_at_work:
            origin['more_at_work'] = made.more_at_work
        robot = robot.with_effect(name, robot.effects[name], origin)
    return robot


def more_at_work(errors: Errors, probability: float) -> str:
    """Say that the effects are not the whole story."""
    floor = errors.floor or 0.0
    left = (
        f'{errors.after / floor:.1f} times the noise'
        if floor > 0.0
        else f'{1e3 * errors.after:.2g} mm'
    )
    return (
        f'more is at work than these effects: what is left on the fitted postures is {left} '
        f'(p = {probability:.1g})'
    )


def restore(robot: Robot, name: str) -> tuple[Robot, Mapping[str, Any] | None]:
    """
    Undo an addition: what the effect was before comes back, else the effect goes.

    Returns
    -------
    robot : Robot
    values : mapping, optional
        What came back.

    Raises
    ------
    InputError
        The description does not list that effect.

    """
    without = robot.without_effect(name)
    origin = robot.fitted.get(name)
    values = origin.get('replaces') if isinstance(origin, dict) else None
    if not isinstance(values, dict):
        return without, None
    back = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    return robot.with_effect(name, back), back


def _plain(value: Value) -> dict[str, Any]:
    plain = {key: _short(getattr(value, key)) for key in ('value', 'low', 'high')}
    return {**plain, 'unit': value.unit, **({'note': value.note} if value.note else {})}


def _listed(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: list(v) if isinstance(v, tuple) else v for key, v in values.items()}


def _short(value: float | None) -> float | None:
    return None if value is None else float(f'{value:.4g}')
