"""What the pictures of a diagnosis show: the model before and after, and what it lacks where."""

from __future__ import annotations

from dataclasses import dataclass

from ..analysis.compare import compare
from ..analysis.comparison import Comparison
from ..analysis.missing_moment import MissingMoment, missing_moment
from ..analysis.result import Diagnosis
from ..data import DataSet
from ..effects import Catalogue, load_catalogue
from ..exceptions import NoEquilibriumError
from ..robot import EffectValues, Robot

BEFORE = 'as described'


@dataclass(frozen=True, eq=False)
class Pictures:
    """Measurements against the description before and, where something is to add, after."""

    comparison: Comparison
    before: MissingMoment | None
    after: MissingMoment | None


def pictures_of(
    found: Diagnosis,
    dataset: DataSet,
    catalogue: Catalogue | None = None,
    changed: Robot | None = None,
) -> Pictures | None:
    """
    Compute the pictures of a diagnosis.

    Parameters
    ----------
    found : Diagnosis
    dataset : DataSet
        With the description that was judged.
    catalogue : Catalogue, optional
    changed : Robot, optional
        The description with what was added; default: with the values that were found.

    Returns
    -------
    Pictures, or None where the description has no equilibrium in a posture.

    """
    catalogue = catalogue or load_catalogue()
    robot = dataset.robot
    models = [(BEFORE, robot)]
    if found.effects:
        after = changed or with_effects(found, robot)
        models.append((f'with {" and ".join(effect.name for effect in found.effects)}', after))
    try:
        comparison = compare(dataset, models, catalogue)
    except NoEquilibriumError:
        return None
    lacks = [missing_moment(dataset, one, comparison.measured, catalogue) for _, one in models]
    return Pictures(comparison, lacks[0], lacks[1] if len(lacks) > 1 else None)


def with_effects(found: Diagnosis, robot: Robot) -> Robot:
    """Return a description with the effects at the values that were found."""
    for effect in found.effects:
        values: EffectValues = dict(robot.effects.get(effect.name, {}))
        sections = [section.name for section in robot.sections]
        for key, value in effect.parameters.items():
            name, _, section = key.partition('[')
            if not section:
                values[name] = value.value
                continue
            old = values.get(name, 0.0)
            each = list(old) if isinstance(old, tuple) else [old] * len(sections)
            each[sections.index(section.removesuffix(']'))] = value.value
            values[name] = tuple(each)
        robot = robot.with_effect(effect.name, values)
    return robot
