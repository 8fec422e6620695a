"""
Ask a dozen questions, write a robot description and draw it.

An empty answer takes the value in brackets. The answers may also come from a file or a pipe,
one per line; what is missing at its end takes the value in brackets. The file is short and
meant to be edited: per-cell values, tapered or uneven tendons and effects go in there.

example: python -m tendon_robot_ros new-robot --output arm.yaml
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO, TypeVar

import yaml

from ..common.errors import InputError, RobotDescriptionError
from ..common.files import new_file
from ..robot import Robot, dump_robot, parse_robot
from .describe import description

NAME = 'new-robot'
HELP = 'ask about a robot, write its description and draw it'

GRAVITY_ALONG_Z = {'up': -9.81, 'down': 9.81, 'horizontal': 9.81}
FILE_HEAD = '# Written by new-robot. In m and N; +z points along the straight arm.\n'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('--output', metavar='FILE', help='the description (default: NAME.yaml)')
    parser.add_argument('--overwrite', action='store_true', help='replace a file that is there')


def run(args: argparse.Namespace) -> int:
    """Ask, write, draw."""
    questions = Questions(sys.stdin, sys.stderr)
    name = questions.text('Name of the robot', 'my_robot')
    path = Path(args.output or f'{name.replace(" ", "_").replace("/", "_")}.yaml')
    if path.exists() and not args.overwrite:
        raise InputError(f'{path}: is there already; use --overwrite or another --output')
    robot = parse_robot(yaml.safe_dump(ask(questions, name)), str(path))
    with new_file(path) as draft:
        draft.write_text(FILE_HEAD + dump_robot(robot), encoding='utf-8')
    print(description(robot))
    picture = path.with_suffix('.png')
    _draw(robot, picture)
    print(f'\nwritten: {path}   picture: {picture}')
    first = robot.inputs[0]
    print(f'next: python -m tendon_robot_ros shape {path} --tensions {first}=1')
    return 0


def _draw(robot: Robot, picture: Path) -> None:
    from ..model.model import Model
    from ..report.robot_picture import draw_robot

    print('drawing (the first model ever is compiled before)', file=sys.stderr)
    model = Model(robot)
    with new_file(picture) as draft:
        draw_robot(model, draft)


def ask(questions: Questions, name: str) -> dict[str, Any]:
    """Return the content of the description."""
    count = questions.whole('How many sections', 2, 1, 20)
    cells = questions.whole('Cells (guide to guide) per section', 15, 1, 1000)
    length = questions.number('Length of a cell [mm]', 7.0, 1e-3, 1e4) * 1e-3
    stiffness = questions.number('Bending stiffness of a cell [N·m/rad]', 0.027, 1e-9, 1e6)
    bends = questions.choice('Cells bend as', ('arc', 'hinge'))
    many = questions.whole('Tendons per section (2: planar)', 2, 1, 12)
    radius = (
        questions.number('Distance of the tendons from the centre [mm]', 5.5, 1e-3, 1e3) * 1e-3
    )
    low = questions.number('Lowest tension [N]', 0.1, 0.0, 1e4)
    high = questions.number('Highest tension [N]', max(5.0, 10.0 * low), low, 1e5)
    friction = questions.number(
        'Friction coefficient of tendon on eyelet (0: none)', 0.3, 0.0, 1.0
    )
    gravity = questions.choice(
        'The straight arm points (for gravity)', ('unknown', 'up', 'down', 'horizontal')
    )
    if high <= low:
        raise RobotDescriptionError('answers', 'Highest tension', f'more than {low:g} N', high)
    names = _section_names(count)
    section = {'cells': cells, 'cell_length': length, 'bending_stiffness': stiffness}
    content: dict[str, Any] = {
        'name': name,
        'sections': [{'name': s, **section, 'bends_as': bends} for s in names],
        'tendons': [t for i, s in enumerate(names) for t in _tendons(s, i, many, radius)],
        'tension_limits': [low, high],
        'effects': {'tendon_friction': {'friction_coefficient': friction}} if friction else {},
    }
    if gravity != 'unknown':
        along = GRAVITY_ALONG_Z[gravity]
        content['gravity'] = [along, 0.0, 0.0] if gravity == 'horizontal' else [0.0, 0.0, along]
    return content


def _section_names(count: int) -> list[str]:
    if count == 1:
        return ['section']
    if count == 2:
        return ['proximal', 'distal']
    return [f'section_{i + 1}' for i in range(count)]


def _tendons(section: str, index: int, many: int, radius: float) -> list[dict[str, Any]]:
    """Spread the tendons of a section evenly; each section's stand between those of the last."""
    if many <= 2:
        sides = {'right': radius, 'left': -radius}
        return [
            {'name': f'{section}_{side}', 'offset': [x, 0.0], 'section': section}
            for side, x in list(sides.items())[:many]
        ]
    turn = math.pi / many * (index % 2)
    angles = [turn + 2.0 * math.pi * j / many for j in range(many)]
    return [
        {
            'name': f'{section}_{j + 1}',
            'offset': [round(radius * math.cos(a), 9), round(radius * math.sin(a), 9)],
            'section': section,
        }
        for j, a in enumerate(angles)
    ]


# -----------------------------------------------------------------------------
# Questions on a terminal or a pipe; a person is asked again, a pipe gets an error.

T = TypeVar('T')


class Questions:
    """Asks one question per line; an empty answer takes the default."""

    def __init__(self, answers: TextIO, prompts: TextIO) -> None:
        """Answers come from one stream, prompts go to another."""
        self._answers, self._prompts = answers, prompts
        self._person = answers.isatty()

    def text(self, question: str, default: str) -> str:
        """Ask for a name."""
        return self._ask(question, default, default, str)

    def whole(self, question: str, default: int, low: int, high: int) -> int:
        """Ask for a whole number within bounds."""

        def read(answer: str) -> int:
            value = int(answer)
            if not low <= value <= high:
                raise ValueError
            return value

        return self._ask(question, str(default), f'a whole number from {low} to {high}', read)

    def number(self, question: str, default: float, low: float, high: float) -> float:
        """Ask for a number within bounds."""

        def read(answer: str) -> float:
            value = float(answer)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError
            return value

        return self._ask(question, f'{default:g}', f'a number from {low:g} to {high:g}', read)

    def choice(self, question: str, known: tuple[str, ...]) -> str:
        """Ask for one of some words; the first is the default."""

        def read(answer: str) -> str:
            if answer not in known:
                raise ValueError
            return answer

        return self._ask(f'{question}: {", ".join(known)}', known[0], ' or '.join(known), read)

    def _ask(self, question: str, default: str, expected: str, read: Callable[[str], T]) -> T:
        while True:
            print(f'{question} [{default}]: ', end='', file=self._prompts, flush=True)
            answer = self._answers.readline().strip()
            if not self._person:
                print(answer, file=self._prompts)
            try:
                return read(answer or default)
            except ValueError:
                message = f'{question}: expected {expected}, got {answer!r}'
                if not self._person:
                    raise InputError(message) from None
                print(message, file=self._prompts)
