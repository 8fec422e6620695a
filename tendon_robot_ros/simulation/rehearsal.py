"""A hidden cause in a robot: which, how large, postures that show it, and the story."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, choice, whole
from ..common.words import STANDARD_GRAVITY, described_quantity, mm
from ..diagnosis.verdict import Verdict
from ..effects import Catalogue
from ..inference.statistics import rms
from ..model.model import Model
from ..robot import Robot, load_robot
from ..robot.description import EffectValues
from ..robot.estimates import natural_sizes
from ..workspace.postures import default_postures
from .hidden import CAUSES, STIFFNESS_SCATTER, chosen

NOTHING_HIDDEN = 'none'
REFINEMENTS = ('eyelet_wrap', 'tendon_travel')  # what the mock's wires do, and its owner knows
# [1] tip error of a hidden effect, in lengths of the arm: between what a person sees on the page
# and what keeps the arm near its targets, so that one can watch it go
TIP_ERRORS = (0.02, 0.05)
# [1] in lengths of the arm: an effect that cannot make more is not drawn, else nobody would see it
TIP_ERROR_VISIBLE = 0.003
ERROR_REDUCTION_MIN = 0.8  # [1] of the tip error, else the story did not come true


@dataclass(frozen=True)
class Hidden:
    """What the mock robot hides."""

    name: str  # of an effect, of a cause outside the catalogue, or 'none'
    values: EffectValues

    @property
    def outside(self) -> bool:
        """Whether no effect of the catalogue describes it."""
        return self.name in CAUSES

    @property
    def plant(self) -> dict[str, EffectValues]:
        """As `make_plant` takes it."""
        return {} if self.name == NOTHING_HIDDEN else {self.name: self.values}


def refined(robot: Robot) -> Robot:
    """
    Return the paper's model refined for the mock's hardware.

    Its wires, the way its weight acts, and what the maker of its tubes says of their scatter.
    """
    for name in REFINEMENTS:
        robot = robot.with_effect(name, {'fraction': 1.0})
    tolerances = {**robot.tolerances, 'cell_stiffness': STIFFNESS_SCATTER}
    return replace(robot, gravity=(0.0, 0.0, STANDARD_GRAVITY), tolerances=tolerances)


def add_story(parser: argparse.ArgumentParser) -> None:
    """Declare what is hidden in which robot, and how the story is told."""
    add, flag = parser.add_argument, dict[str, Any](action='store_true')
    what = 'hide this: an effect, a cause outside the catalogue, or none (default: drawn)'
    add('--hidden', default='', metavar='NAME', help=what)
    what = 'draws what is hidden, how large it is, and the noise (default: from the clock)'
    add('--seed', type=int, metavar='N', help=what)
    add('--reveal', **flag, help='say at the end what was hidden')
    add('--headless', **flag, help='no page: the story as text; exits with 0 only if it came true')
    add('--postures', type=int, default=14, metavar='N', help='of the tour (default: 14)')
    what = 'the arm chooses its postures by itself, until it knows (docs/investigate.md)'
    add('--investigate', **flag, help=what)
    add('--port', type=int, default=8080, metavar='N', help='of the page (default: 8080)')
    what = 'in config/robots (default: kato_10_1)'
    add('--robot', default='kato_10_1', metavar='NAME', help=what)


def cast(args: argparse.Namespace, catalogue: Catalogue) -> tuple[Robot, Hidden, int]:
    """Return the robot of a story as its owner describes it, what it hides, and the seed."""
    whole('live: --postures', args.postures, 4)
    seed = int(time.time()) % 100000 if args.seed is None else args.seed
    robot = refined(load_robot(args.robot))
    return robot, draw(robot, catalogue, args.hidden, seed), seed


def choices(robot: Robot, catalogue: Catalogue) -> tuple[str, ...]:
    """Name what can be hidden."""
    # the others change wire pulls only, where tensions are commanded, or by decimetres
    suitable = [effect.name for effect in catalogue if effect.needs in ('', 'gravity')]
    known = [name for name in suitable if name not in robot.effects]
    return (*known, *CAUSES, NOTHING_HIDDEN)


def draw(robot: Robot, catalogue: Catalogue, name: str, seed: int) -> Hidden:
    """
    Choose what to hide, and how large it is: millimetres at the tip.

    Parameters
    ----------
    robot : Robot
        As its owner describes it.
    catalogue : Catalogue
    name : str
        One of `choices`; '' draws an effect that shows on this arm.
    seed : int

    Raises
    ------
    InputError
        The name is not known.

    """
    known, random = choices(robot, catalogue), np.random.default_rng(seed)
    if name:
        choice('hidden', name, known)
    unsized = (NOTHING_HIDDEN, *CAUSES, *(e.name for e in catalogue if e.placed))
    if name in unsized:
        return Hidden(name, {})
    remaining = [n for n in known if n not in unsized]
    sized = catalogue.sized(natural_sizes(robot))
    while True:
        effect = name or str(random.choice(remaining))
        typical = chosen(sized[effect], {}, robot)
        target = random.uniform(*TIP_ERRORS) * robot.length
        low, high = 0.02, 20.0  # times the typical size; bisected in its logarithm
        for _ in range(14):
            middle = float(np.sqrt(low * high))
            size = _tip_change(robot, sized, effect, _scaled(sized, effect, typical, middle))
            low, high = (middle, high) if size < target else (low, middle)
        hidden = Hidden(effect, _scaled(sized, effect, typical, low))
        remaining = [n for n in remaining if n != effect]
        shown = _tip_change(robot, sized, effect, hidden.values) / robot.length
        if name or not remaining or shown > TIP_ERROR_VISIBLE:
            return hidden


def tour(model: Model, count: int, seed: int) -> list[tuple[Floats, Floats | None]]:
    """Return tips (3,) [m] that exercise the robot, and for every other one its direction (3,)."""
    stops = list[tuple[Floats, Floats | None]]()
    for index, tensions in enumerate(default_postures(model.robot, count, seed)):
        shape = model.shape(np.clip(tensions, *model.robot.tension_limits))
        stops.append((shape.tip_position, shape.tip_direction if index % 2 else None))
    return stops


def _tip_change(robot: Robot, catalogue: Catalogue, name: str, values: EffectValues) -> float:
    """Return how far an effect moves the tip, rms over postures [m]; inf without equilibrium."""
    tensions = np.clip(default_postures(robot, 8, 0), *robot.tension_limits)
    try:
        without = Model(robot, catalogue).shapes(tensions)
        with_it = Model(robot.with_effect(name, values), catalogue)
        shapes = with_it.shapes(tensions)
    except (NoEquilibriumError, InputError):
        return float('inf')
    return rms(with_it.measured(shapes.positions[:, -1:])[:, 0] - without.tip_position)


def _scaled(catalogue: Catalogue, name: str, values: EffectValues, factor: float) -> EffectValues:
    """Multiply the distance from neutral, within the bounds."""
    scaled: EffectValues = {}
    for parameter in catalogue[name].parameters:
        original, neutral = values[parameter.name], parameter.neutral
        shifted = neutral + factor * (np.array(original) - neutral)
        kept = np.clip(shifted, parameter.low, parameter.high).tolist()
        scaled[parameter.name] = tuple(kept) if isinstance(original, tuple) else kept
    return scaled


@dataclass
class Story:
    """Course of a rehearsal: errors in metres, the verdict as published."""

    hidden: Hidden
    verdict: dict[str, Any] = field(default_factory=dict)
    before: float = float('nan')
    after: float = float('nan')
    added: bool = False

    @property
    def named(self) -> bool:
        """Whether the hidden effect is named, or in the stated class."""
        names = [effect['name'] for effect in self.verdict.get('effects', [])]
        return self.hidden.name in (*names, *self.verdict.get('cannot_tell_apart', []))

    @property
    def error_reduction(self) -> float:
        """Fraction of the tip error that the new description removes [1]."""
        return 1.0 - self.after / self.before if self.before > 0.0 else float('nan')

    @property
    def problem(self) -> str:
        """Why the story did not come true, '' when it did."""
        verdict = self.verdict.get('verdict', 'no verdict')
        if self.hidden.name == NOTHING_HIDDEN:
            return '' if verdict == Verdict.ADEQUATE else f'nothing was hidden, but: {verdict}'
        if self.hidden.outside:
            called = verdict == Verdict.OUTSIDE_CATALOGUE
            return '' if called else f'{self.hidden.name} is outside the catalogue, but: {verdict}'
        if verdict == Verdict.OUTSIDE_CATALOGUE or not self.named:
            return f'{self.hidden.name} was hidden, but the verdict is {verdict}'
        if not self.added:
            return 'the controller did not take the new description'
        if not self.error_reduction >= ERROR_REDUCTION_MIN:
            return f'only {100.0 * self.error_reduction:.0f} % of the tip error is gone'
        return ''

    def end(self) -> str:
        """Return the last line."""
        if self.problem:
            return f'the story did not come true: {self.problem}'
        if self.added:
            return (
                f'tip error on postures never used: {mm(self.before)} -> {mm(self.after)} '
                f'({100.0 * self.error_reduction:.0f} % gone)'
            )
        if self.hidden.name == NOTHING_HIDDEN:
            return 'nothing was hidden and nothing was found'
        return 'a cause that no effect describes: called so'


def reveal(hidden: Hidden, catalogue: Catalogue) -> str:
    """Return one line that names the hidden cause, with values and units."""
    effect = catalogue[hidden.name].parameters if hidden.values else ()
    units = {parameter.name: parameter.unit for parameter in effect}
    values = [
        described_quantity(key, units[key], np.atleast_1d(value).tolist())
        for key, value in hidden.values.items()
        if np.any(value)
    ]
    return f'hidden: {hidden.name} {", ".join(values)}'.rstrip()
