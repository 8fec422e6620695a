"""
Commands about a robot description: ask for it, print it.

robot new, robot describe.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TextIO

import yaml

from ..common.errors import InputError
from ..common.files import write_text
from ..common.words import COMPILING, STANDARD_GRAVITY, columns, counted, mm, typed
from ..report.comparison import kind
from ..report.in_words import route, rows
from ..robot import Robot, dump_robot, estimates, load_robot, parse_robot
from .options import add_file, declare, emit, refuse_existing

FIRST_WORDS = 'An empty answer takes the value in brackets; < goes back to the question before.'
BACK = ('<', 'back')  # answers that go to the question before
# [m], [N·m/rad] a cell that is stiff and has no length, so that the first eyelet lies behind it
# (docs/robot_file.md)
PLATE = {'name': 'plate', 'cells': 1, 'cell_length': 1e-5, 'bending_stiffness': 1000.0}
VIEW_FROM_TIP = """\
Look at the tip of the level arm from the front, so that it points at you:
              180 up
                |
     270 left --o-- 90 right     {first} is the first tendon.
                |                {others}
              0 down, where a weight pulls"""
ANY_ROTATION = '(Where the first tendon lies does not matter then: an import turns the tracker.)'
FILE_HEAD = '# Written by `robot new`. In m and N; +z points along the straight arm.\n'


class NewRobot:
    """
    Ask what is known of a robot, write its description and draw it.

    The stiffness may be known as a number (of one cell), from a rod or a tube (diameters and
    modulus), a sag (the tip of the level arm under a weight), a bend (of a section under one
    tendon), or not at all; then the highest tension bends a section by 180°. An empty answer takes
    the value in brackets, `<` goes back to the question before; the answers may come from a file
    or a pipe, one per line. The file is short and meant to be edited: per-cell values, uneven
    tendons and effects go in there.

    example: python -m tendon_robot_ros robot new --output arm.yaml
    """

    HELP = 'ask about a robot, write its description and draw it'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        add_file(parser, '--output', 'the description (default: NAME.yaml)')
        declare(parser, '--overwrite', '--json')

    def run(self, args: argparse.Namespace) -> int:
        """Ask, write, draw."""
        refuse_existing('--output', args.output, args.overwrite)
        questions = Questions(sys.stdin, sys.stderr)
        questions.show(FIRST_WORDS)

        def ask_all() -> tuple[Path, Robot]:
            name = questions.text('Name of the robot', 'my_robot')
            path = Path(args.output or f'{name.replace(" ", "_").replace("/", "_")}.yaml')
            refuse_existing('--output', str(path), args.overwrite)
            return path, parse_robot(yaml.safe_dump(ask(questions, name)), str(path))

        path, robot = questions.until_answered(ask_all)
        write_text(path, FILE_HEAD + dump_robot(robot))
        picture = path.with_suffix('.png')
        from ..model.model import Model
        from ..report.pictures import draw_robot

        print(f'drawing; {COMPILING}, if not done', file=sys.stderr)
        draw_robot(Model(robot), picture)
        lines = [
            description(robot),
            f'\nwritten: {path}   picture: {picture}',
            f'next: {typed("model", "shape", path, "--tensions", f"{robot.inputs[0]}=1")}',
        ]
        content = {'robot': yaml.safe_load(dump_robot(robot)), 'written': str(path)}
        emit(args, content | {'picture': str(picture)}, '\n'.join(lines))
        return 0


def ask(questions: Questions, name: str) -> dict[str, Any]:
    """Return the content of the description."""
    count = questions.whole('How many sections', 2, 1, 20)
    cells = questions.whole('Cells (guide to guide) per section', 15, 1, 1000)
    length = 1e-3 * questions.number('Length of a cell [mm]', 7.0, 1e-3, 1e4)
    stiffness_of, percent = ask_stiffness(questions, count, cells, length)
    bends = questions.choice('Cells bend as', ('arc', 'hinge'))
    many = questions.whole('Tendons per section (2: planar)', 2, 1, 12)
    radius = 1e-3 * questions.number('Tendons are off the centre by [mm]', 5.5, 1e-3, 1e3)
    low = questions.number('Lowest tension [N]', 0.1, 0.0, 1e4)
    high = questions.number('Highest tension [N]', max(5.0, 10.0 * low), low, 1e5, above=True)
    friction = questions.number('Friction of tendon on eyelet, coefficient', 0.3, 0.0, 1.0)
    names = {1: ['arm'], 2: ['proximal', 'distal']}.get(count)
    names = names or [f'section_{i + 1}' for i in range(count)]
    stiffness = float(f'{stiffness_of(radius, high):.4g}')
    section = {'cells': cells, 'cell_length': length, 'bending_stiffness': stiffness}
    content: dict[str, Any] = {
        'name': name,
        'sections': [{'name': s, **section, 'bends_as': bends} for s in names],
        'tendons': [t for i, s in enumerate(names) for t in tendons_of(s, i, many, radius, count)],
        'tension_limits': [low, high],
        'effects': {'tendon_friction': {'friction_coefficient': friction}} if friction else {},
    }
    content |= ask_weight(questions, count * cells * length, content['effects'])
    content |= ask_tolerances(questions, percent, friction)
    ask_guides(questions, content['effects'])
    content |= ask_down(questions, content.get('gravity', (0.0, 0.0, 0.0)), content['tendons'])
    if 'eyelet_wrap' in content['effects']:  # friction may begin below the first cell
        question = 'The base plate has holes in which tendons rub'
        if questions.choice(question, ('no', 'yes')) == 'yes':
            content['sections'].insert(0, dict(PLATE))
    if many > 2 and not any(content.get('gravity', ())[:2]):  # else gravity tells it
        ask_rotation(questions, content['tendons'])
    known = [tendon['name'] for tendon in content['tendons']]
    called = questions.names('Names of the tendons', known)
    for tendon, name in zip(content['tendons'], called, strict=True):
        tendon['name'] = name
    return content


def ask_weight(questions: Questions, length: float, effects: dict[str, Any]) -> dict[str, Any]:
    """Ask where the arm points and what it weighs; its weight becomes an effect."""
    along = questions.choice(
        'The straight arm points (for gravity)', ('unknown', 'up', 'down', 'horizontal')
    )
    if along == 'unknown':
        return {}
    # two digits behind the point, so that the file is easily read; a level arm hangs along x
    acceleration = round(-STANDARD_GRAVITY if along == 'up' else STANDARD_GRAVITY, 2)
    grams = questions.number('Weight of the arm, without its base [g] (0: leave out)', 0, 0, 1e6)
    if grams:
        effects['gravity'] = {'linear_density': float(f'{1e-3 * grams / length:.4g}')}
    if along == 'horizontal':
        return {'gravity': [acceleration, 0.0, 0.0]}
    questions.show(ANY_ROTATION)
    return {'gravity': [0.0, 0.0, acceleration]}


def ask_tolerances(questions: Questions, percent: float, friction: float) -> dict[str, Any]:
    """Ask how sure values are; a diagnosis moves them so far before it calls something missing."""
    percent = questions.number('How sure is the stiffness [± %]', percent, 0, 90)
    tolerances = {'bending_stiffness': percent / 100.0} if percent else {}
    if friction and (percent := questions.number('How sure is the friction [± %]', 20, 0, 90)):
        tolerances['friction_coefficient'] = percent / 100.0
    return {'tolerances': tolerances} if tolerances else {}


def ask_guides(questions: Questions, effects: dict[str, Any]) -> None:
    """Ask how tendons run; what follows where they run free from hole to hole is no guess."""
    question = 'Between two guides the tendons run (free: straight, channel: led)'
    if questions.choice(question, ('free', 'channel')) == 'free':
        effects['straight_tendon'] = {'fraction': 1.0}
        if 'tendon_friction' in effects:
            effects |= {'eyelet_wrap': {'fraction': 1.0}, 'tendon_travel': {'fraction': 1.0}}


def ask_down(
    questions: Questions, gravity: Sequence[float], tendons: Sequence[dict[str, Any]]
) -> dict[str, list[float]]:
    """Ask where the first tendon of a level arm lies, as seen from its tip."""
    if not gravity[0]:
        return {}
    first = tendons[0]
    ring = [tendon['name'] for tendon in tendons if tendon['section'] == first['section']]
    others = 'It is the only one.' if len(ring) == 1 else f'{ring[1]} lies opposite.'
    if len(ring) > 2:
        apart = f'{360.0 / len(ring):.4g}°'
        others = f'{ring[1]} and so on follow counter-clockwise, {apart} apart.'
    questions.show(VIEW_FROM_TIP.format(first=first['name'], others=others))
    question = f'There {first["name"]} lies at [°, or down, right, up, left]'
    sides = {'down': 0.0, 'right': 90.0, 'up': 180.0, 'left': 270.0}
    angle = math.radians(questions.number(question, 0.0, -360.0, 360.0, sides))
    down = (gravity[0] * math.cos(angle), -gravity[0] * math.sin(angle))
    return {'gravity': [round(down[0], 4) + 0.0, round(down[1], 4) + 0.0, 0.0]}


def ask_rotation(questions: Questions, tendons: list[dict[str, Any]]) -> None:
    """Ask where the first tendon lies in a base frame of the user's own; all turn with it."""
    first = tendons[0]['name']
    question = f'In your base frame {first} lies at [° from x towards y]'
    angle = math.radians(questions.number(question, 0.0, -360.0, 360.0))
    c, s = math.cos(angle), math.sin(angle)
    for tendon in tendons if angle else ():
        x, y = tendon['offset']
        tendon['offset'] = [round(c * x - s * y, 9) + 0.0, round(s * x + c * y, 9) + 0.0]


def ask_stiffness(
    questions: Questions, sections: int, cells: int, length: float
) -> tuple[Callable[[float, float], float], float]:
    """
    Ask for the stiffness of a cell, or for what it follows from.

    Parameters
    ----------
    questions : Questions
    sections, cells : int
        Number of sections, and of the cells of each.
    length : float
        Of a cell [m].

    Returns
    -------
    stiffness_of : callable
        Radius of the tendons [m] and highest tension [N] -> stiffness of a cell [N·m/rad].
    percent : float
        Its usual accuracy [%].

    """
    source = questions.choice(
        'The bending stiffness is known as', ('number', 'rod', 'tube', 'sag', 'bend', 'unknown')
    )
    if source == 'number':
        value = questions.number('Bending stiffness of a cell [N·m/rad]', 0.027, 1e-9, 1e6)
        return lambda *_: value, 5.0
    if source in ('rod', 'tube'):
        outer = 1e-3 * questions.number('Outer diameter [mm]', 1.0, 1e-3, 1e3)
        inner = 0.0
        if source == 'tube':
            wall = questions.number('Wall [mm]', 0.1 * 1e3 * outer, 1e-4, 0.5e3 * outer)
            inner = outer - 2e-3 * wall
        known = 'nitinol 60, steel 200, glass fibre 40, PEEK 3.6, nylon 2'
        modulus = 1e9 * questions.number(f'Modulus E [GPa] ({known})', 60.0, 1e-6, 1e4)
        value = estimates.rod_stiffness(modulus, outer, inner, length)
        return lambda *_: value, 10.0
    if source == 'sag':
        grams = questions.number('Hold the arm level, weight at its tip [g]', 10.0, 1e-3, 1e6)
        most = estimates.SAG_FRACTION_MAX
        sag_max = 1e3 * most * sections * cells * length
        why = f'{100 * most:g} % of the arm; if it sags more, take a lighter weight'
        sags = questions.number(
            'Its tip then sags by [mm]', min(5.0, 0.5 * sag_max), 1e-3, sag_max, why=why
        )
        force = 1e-3 * STANDARD_GRAVITY * grams
        value = estimates.stiffness_from_sag(force, 1e-3 * sags, sections * cells, length)
        return lambda *_: value, 10.0
    tension, angle, percent = None, math.pi, 50.0  # not known: the highest bends by 180°
    if source == 'bend':
        tension = questions.number('One tendon alone, tension [N]', 1.0, 1e-6, 1e5)
        angle = math.radians(questions.number('Its section then bends by [°]', 45.0, 1e-3, 1e4))
        percent = 20.0
    of_bend = estimates.stiffness_from_bend
    return (lambda radius, highest: of_bend(tension or highest, angle, cells, radius)), percent


def tendons_of(
    section: str, index: int, many: int, radius: float, sections: int
) -> list[dict[str, Any]]:
    """Spread the tendons of a section evenly; each section's stand between those of the last."""
    prefix = 'tendon' if sections == 1 else section
    names = ('right', 'left') if many <= 2 else range(1, many + 1)
    first = 0 if many <= 2 else index % 2
    tendons = []
    for j, name in zip(range(many), names, strict=False):
        angle = math.pi / many * (first + 2.0 * j)
        offset = [round(radius * math.cos(angle), 9), round(radius * math.sin(angle), 9)]
        tendons.append({'name': f'{prefix}_{name}', 'offset': offset, 'section': section})
    return tendons


class WentBack(Exception):
    """The user wants to answer the previous question again."""


class Questions:
    """Asks one question per line; an empty answer takes the default, `<` goes back."""

    def __init__(self, answers: TextIO, prompts: TextIO) -> None:
        """Answers come from one stream, prompts go to another."""
        self._answers, self._prompts = answers, prompts
        self._person = answers.isatty()
        self._given: list[str] = []  # answers, in order
        self._index = 0  # of the next question
        self._before: dict[str, str] = {}  # question -> what was answered before going back

    def until_answered[T](self, ask: Callable[[], T]) -> T:
        """Return what `ask` makes of the answers; after a `<` what stays is answered as it was."""
        while True:
            self._index = 0
            try:
                return ask()
            except WentBack:
                if self._given:
                    self._given.pop()

    def text(self, question: str, default: str) -> str:
        """Ask for a name."""

        def read(answer: str) -> str:
            if set(',=') & set(answer):
                raise ValueError
            return answer

        return self.ask(question, default, 'a name without comma or equals sign', read)

    def names(self, question: str, known: Sequence[str]) -> list[str]:
        """Ask for as many names as are known, with commas between them."""

        def read(answer: str) -> list[str]:
            names = [name.strip() for name in answer.split(',')]
            if not len({*names}) == len(names) == len(known) or '' in names or '=' in answer:
                raise ValueError
            return names

        expected = f'{len(known)} different names with commas between them, none with ='
        return self.ask(question, ','.join(known), expected, read)

    def whole(self, question: str, default: int, low: int, high: int) -> int:
        """Ask for a whole number within bounds."""
        return int(self.number(question, default, low, high, kind=int))

    def show(self, text: str) -> None:
        """Print a text before a question, unless the question is answered already."""
        if self._index == len(self._given):
            print(text, file=self._prompts)

    def number(
        self,
        question: str,
        default: float,
        low: float,
        high: float,
        words: Mapping[str, float] = MappingProxyType({}),
        above: bool = False,
        why: str = '',
        kind: type[float] = float,
    ) -> float:
        """Ask for a number within bounds (or above `low`), or for a word that stands for one."""

        def read(answer: str) -> float:
            value = words[answer] if answer in words else kind(answer)
            if not low <= value <= high or (above and value == low):
                raise ValueError
            return value

        number = 'a whole number' if kind is int else 'a number'
        bounds = f'{number} {"above" if above else "from"} {low:g} to {high:g}'
        expected = ' or '.join([f'{bounds} ({why})' if why else bounds, *words])
        return self.ask(question, f'{default:g}', expected, read)

    def choice(self, question: str, known: tuple[str, ...]) -> str:
        """Ask for one of some words; the first is the default."""
        expected = ' or '.join(known)
        asked = f'{question}: {", ".join(known)}'
        return self.ask(asked, known[0], expected, lambda answer: known[known.index(answer)])

    def ask[T](self, question: str, default: str, expected: str, read: Callable[[str], T]) -> T:
        """Ask until `read` takes the answer; a pipe is asked once."""
        self._index += 1
        if self._index <= len(self._given):
            return read(self._given[self._index - 1])
        default = self._before.get(question, default)
        while True:
            print(f'{question} [{default}]: ', end='', file=self._prompts, flush=True)
            answer = self._answers.readline().strip()
            if not self._person:
                print(answer, file=self._prompts)
            if answer in BACK:
                raise WentBack
            try:
                value = read(answer or default)
            except ValueError:
                message = f'{question}: expected {expected}, got {answer!r}'
                if not self._person:
                    raise InputError(message) from None
                print(message, file=self._prompts)
                continue
            self._given.append(answer or default)
            self._before[question] = answer or default
            return value


class Describe:
    """
    Print what ROBOT is, what one newton does to it, and whether that is plausible.

    Sections, tendons, limits, tolerances, and the physical effects of its model. With --urdf print
    a URDF instead, for RViz and TF: two revolute joints per cell, `<name>_x` towards x and
    `<name>_y` towards y, and where cells twist a third, `<name>_z`, about its axis. JSON: the
    description as it is understood, in SI units.

    example: python -m tendon_robot_ros robot describe config/robots/kato_10_1.yaml
    """

    HELP = 'print a robot description, or a URDF of it'

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the arguments."""
        declare(parser, 'robot')
        parser.add_argument('--urdf', action='store_true', help='print a URDF')
        declare(parser, '--json')

    def run(self, args: argparse.Namespace) -> None:
        """Read and print."""
        robot = load_robot(args.robot)
        if args.urdf:
            from ..robot.urdf import urdf

            emit(args, {'urdf': urdf(robot)}, urdf(robot))
        else:
            emit(args, yaml.safe_load(dump_robot(robot)), description(robot))


def description(robot: Robot) -> str:
    """Return the description for a reader (mm)."""
    low, high = robot.tension_limits
    own = robot.own_sections
    length = sum(section.cells * section.cell_length for section in own)
    plate = ', on a base plate with holes' if len(own) < len(robot.sections) else ''
    size = (
        f'{counted(len(own), "section")}, {counted(sum(s.cells for s in own), "cell")}, '
        f'{counted(len(robot.tendons), "tendon")}, {1e3 * length:g} mm{plate}'
    )
    lines = [
        f'robot {robot.name}: {size}',
        f'model: {model_name(robot)}',
        f'commanded: {", ".join(robot.inputs)}, {low:g} to {high:g} N each',
    ]
    if robot.gravity is not None:
        lines.append(f'gravity: {", ".join(f"{g:g}" for g in robot.gravity)} m/s²')
    lines += ['', section_table(robot), '', columns(rows(robot)), '']
    lines += [*estimates.handling(robot), '']
    lines.append('effects:' if robot.effects else 'effects: none')
    for name, values in robot.effects.items():
        texts = ', '.join(
            f'{key} {", ".join(map(str, v)) if isinstance(v, tuple) else v}'
            for key, v in values.items()
        )
        lines.append(f'  {name}: {texts}{" (fitted)" if name in robot.fitted else ""}')
    if robot.tolerances:
        shown = ', '.join(f'{name} {value:g}' for name, value in robot.tolerances.items())
        lines.append(f'not sure (1 sd): {shown}')
    if robot.model_error:
        lines.append(
            f'model_error: known to be off by {mm(robot.model_error, 2)} rms at the tip, which no '
            'effect explains'
        )
    return '\n'.join(lines)


def model_name(robot: Robot) -> str:
    """Name the model after the effects that it lists."""
    if not robot.effects:
        return 'PCCA (no effects)'
    if list(robot.effects) == ['tendon_friction']:
        friction = robot.effects['tendon_friction'].get('friction_coefficient')
        return f'FKM (tendon_friction, friction coefficient {friction})'
    return kind(tuple(robot.effects), len(robot.effects))


def section_table(robot: Robot) -> str:
    """Return a row for every section."""
    beside = any(section.mass_offset for section in robot.sections)
    table = [['section', 'cells', 'cell [mm]', 'stiffness [N·m/rad]', 'bends as']]
    table[0] += ['weight at x, y [mm]'] * beside
    for section in robot.sections:
        low, high = min(section.bending_stiffness), max(section.bending_stiffness)
        stiffness = f'{low:g}' if low == high else f'{low:g} to {high:g}'
        sizes = [str(section.cells), f'{1e3 * section.cell_length:g}', stiffness]
        weight = [route(section.mass_offset or ((0.0, 0.0),))] * beside
        table.append([section.name, *sizes, section.bends_as, *weight])
    return columns(table)
