"""The story of `make live`, told in text, and the tour behind the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..exceptions import NoEquilibriumError
from ..model.model import Model
from ..monitoring.rehearsal import tour
from ..monitoring.story import Story
from ..report.words import mm
from .director import Director

Array = NDArray[np.float64]
CHECKS = 6  # postures that are not recorded
DIAGNOSIS = 600.0  # [s]


def play(director: Director, model: Model, story: Story, postures: int) -> None:
    """Record, diagnose, add, look again; fill in the story and print it as it happens."""
    director.wait_until_up()
    robot = model.robot
    print(
        f'robot {robot.name}: {robot.cells} cells, {len(robot.tendons)} tendons   model: '
        f'{", ".join(robot.effects)}'
    )
    print(director.call('monitor/record'))
    errors = []
    for stop in tour(model, postures, 0):
        if director.record(stop):
            errors.append(director.error())
    shown = f'{mm(_rms(errors))} rms, {mm(max(errors))} at worst' if errors else 'unknown'
    print(f'{director.recorded} postures recorded   tip error {shown}')
    print(director.call('monitor/diagnose'), flush=True)
    director.wait(lambda: director.verdict, DIAGNOSIS, 'the verdict')
    story.verdict = director.verdict
    print(story.verdict['sentence'])
    print(story.verdict['remainder'])
    if story.verdict['verdict'] in ('outside_catalogue', 'adequate', 'cannot_judge'):
        return
    _add_and_look(director, model, story)


def _add_and_look(director: Director, model: Model, story: Story) -> None:
    """Add what was found and go to postures that were never used."""
    director.call('monitor/add')
    director.wait(lambda: director.status['monitor'].get('added') == '1', DIAGNOSIS, 'the adding')
    names = [effect['name'] for effect in story.verdict['effects']]
    story.added = director.wait(lambda: director.uses(names), 60.0, 'the reload', strict=False)
    print(f'{director.progress}\ncontroller: {director.status["controller"].get("model")}')
    before, after = [], []
    for stop in tour(model, CHECKS, 1):
        if not director.go(stop):
            continue
        off = director.tip() - _old_tip(model, director.tensions())
        before.append(float(np.linalg.norm(off)))
        after.append(director.error())
    if after:
        story.before, story.after = _rms(before), _rms(after)


def tour_forever(director: Director, model: Model, postures: int) -> None:
    """Go through the postures again and again, while the page lets it."""
    while True:
        for stop in tour(model, postures, 0):
            director.wait(lambda: director.touring, float('inf'), 'the tour')
            director.go(stop)


def _old_tip(model: Model, tensions: Array) -> Array:
    """Return where the description before the addition has the tip [m]."""
    try:
        return model.shape(np.maximum(tensions, 0.0)).tip_position
    except NoEquilibriumError:
        return np.full(3, np.nan)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
