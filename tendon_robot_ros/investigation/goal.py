"""What is asked of an investigation, what it may spend, and where it may go."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field

from ..common.errors import InputError

START_MIN = 3  # postures from which anything is judged


@dataclass(frozen=True)
class Goal:
    """What is asked, and within what."""

    interval: float = 0.25  # [1] half a 95 % interval, of the value or of a typical size
    visible: float = 0.015  # [1] tip motion, of the length, that no effect may make unseen
    postures: int = 16  # at most, those of the check apart
    minutes: float = math.inf
    start: int = 4  # postures before the first diagnosis
    at_once: int = 1  # postures between two diagnoses
    trials: int = 3  # of every posture
    checks: int = 3  # fresh postures to verify on
    add: bool = False  # write what is found even where the verdict is a class
    tension_max: float = math.inf  # [N] besides the limits of the description
    seed: int = 0  # of the postures that may be chosen
    tracker_noise: float = 2e-4  # [m] to plan with until there are measurements
    effect_files: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """
        Refuse what cannot be done.

        Raises
        ------
        InputError

        """
        for option, value, low, high in (
            ('--interval', 100.0 * self.interval, 0.1, 1000.0),
            ('--visible', 100.0 * self.visible, 0.01, 100.0),
            ('--postures', self.postures, START_MIN, 1000),
            ('--minutes', self.minutes, 0.01, math.inf),
            ('--start', self.start, START_MIN, self.postures),
            ('--at-once', self.at_once, 1, 100),
            ('--trials', self.trials, 1, 100),
            ('--checks', self.checks, 0, 100),
            ('--tension-max', self.tension_max, 1e-6, math.inf),
        ):
            if not low <= value <= high:
                raise InputError(f'{option}: expected {low:g} to {high:g}, got {value:g}')


def add_goal(parser: argparse.ArgumentParser, trials: int) -> None:
    """Declare the goal; `trials` is the default."""
    default = Goal()
    add = parser.add_argument
    text = 'half a 95 %% interval that is narrow enough, of the value or of a typical size'
    add('--interval', type=float, default=100.0 * default.interval, metavar='PERCENT',
        help=f'{text} (default: {100.0 * default.interval:g})')  # fmt: skip
    text = 'tip motion of the length: adequate is a model when no effect may make more unseen'
    add('--visible', type=float, default=100.0 * default.visible, metavar='PERCENT',
        help=f'{text} (default: {100.0 * default.visible:g})')  # fmt: skip
    for name, value, meta, text in (
        ('postures', default.postures, 'N', 'at most so many'),
        ('start', default.start, 'N', 'so many before the first diagnosis'),
        ('at-once', default.at_once, 'N', 'so many between two diagnoses'),
        ('trials', trials, 'N', 'of every posture'),
        ('checks', default.checks, 'N', 'fresh postures to verify on'),
    ):
        add(f'--{name}', type=int, default=value, metavar=meta, help=f'{text} (default: {value})')
    add('--minutes', type=float, default=math.inf, metavar='M', help='at most so long')
    add('--tension-max', type=float, default=math.inf, metavar='N',
        help='[N] besides the limits of the description')  # fmt: skip
    add('--add', action='store_true',
        help='write what is found though a class or more is left')  # fmt: skip


def goal_of(args: argparse.Namespace, effect_files: tuple[str, ...] = ()) -> Goal:
    """
    Return the goal that was typed.

    Raises
    ------
    InputError

    """
    names = ('postures', 'minutes', 'start', 'at_once', 'trials', 'checks', 'add', 'tension_max')
    typed = {name: getattr(args, name) for name in names}
    return Goal(
        interval=args.interval / 100.0,
        visible=args.visible / 100.0,
        effect_files=effect_files,
        **typed,
    )
