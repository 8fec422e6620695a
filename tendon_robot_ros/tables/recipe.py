"""import.yaml: how tables became a data set, every choice written out; gaps are guessed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ..common.errors import DataSetError, refusal
from ..common.files import read_text
from ..common.words import UNITS, find_unit
from ..common.yaml_reading import parse_yaml
from ..data.arrays import Vector
from ..data.dataset import PATHS
from ..data.folder import DatasetFields
from .columns import ColumnUse
from .markers import CHOICES

KEYS = (
    *('sources', 'robot', 'time', 'inputs', 'zero', 'spool', 'positions', 'points', 'markers'),
    *('offset', 'places', 'up', 'delay', 'drift', 'still', 'same', 'rest', 'path', 'frame'),
    'leave_out',
)
STILL = ('speed', 'duration', 'change')
UPS = ('x', 'y', 'z', '-x', '-y', '-z')
METHODS = ('model', 'level', 'straight', 'base')
HEAD = """\
# How the tables named under sources became the data set beside this file. SI units but for the
# units of columns. Change a line, or take one out to have it guessed again, and run
#   python -m tendon_robot_ros import-table --recipe THIS_FILE --output NEW_FOLDER
"""


@dataclass(frozen=True)
class MarkerColumns:
    """Columns of a marker, and where on the arm it is."""

    columns: tuple[str, ...]  # of x, y and z; of three or more points on a rim all of theirs
    name: str | None = None  # of the marker in the data set
    arc_length: float | None = None  # [m]; None: found by its place along the straight arm
    offset: Vector = (0.0, 0.0, 0.0)  # [m] in the frame there
    later: tuple[tuple[str, ...], ...] = ()  # columns in which it goes on, numbered anew

    @property
    def points(self) -> list[tuple[str, ...]]:
        """Columns of x, y and z of each point."""
        return points_of(self.columns)

    @classmethod
    def read(cls, item: RecipeFields) -> MarkerColumns:
        """Read an entry of the markers of an import.yaml."""
        item.only('columns', 'name', 'arc_length', 'offset', 'later')
        later = item.content.get('later') or []
        if not isinstance(later, list):
            raise item.error('later', 'a list of the columns of x, y and z', later)
        return cls(
            item.points('columns', item.content.get('columns')),
            item.text('name'),
            item.some('arc_length', 0.0, 100.0, 'm'),
            item.xyz('offset') or (0.0, 0.0, 0.0),
            tuple(item.points('later', columns) for columns in later),
        )

    def plain(self) -> dict[str, Any]:
        """Return the keys of its entry in an import.yaml."""
        keys: dict[str, Any] = {'name': self.name, 'columns': list(self.columns)}
        keys['arc_length'] = self.arc_length
        keys |= {'offset': list(self.offset)} if any(self.offset) else {}
        return keys | ({'later': [list(one) for one in self.later]} if self.later else {})


def points_of(columns: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the columns of x, y and z of each point."""
    return [columns[i : i + 3] for i in range(0, len(columns), 3)]


@dataclass(frozen=True)
class WireSpool:
    """The spool by which angles or currents of a motor become wire pulls or tensions."""

    radius: float | None = None  # [m]
    counts_per_turn: float | None = None
    torque_constant: float | None = None  # [N·m/A], at the spool

    @classmethod
    def read(cls, spool: RecipeFields) -> WireSpool:
        """Read the key `spool` of an import.yaml."""
        spool.only('radius', 'counts_per_turn', 'torque_constant')
        return cls(
            spool.some('radius', 1e-5, 1.0, 'm'),
            spool.some('counts_per_turn', 1e-3, 1e9, '1'),
            spool.some('torque_constant', 1e-9, 1e6, 'N·m/A'),
        )


@dataclass(frozen=True)
class FrameChoice:
    """Where the tracker's frame lies: how it is found, or the result."""

    method: str | None = None  # one of METHODS
    rotation: Vector | None = None  # [rad] rotation vector, tracker to base
    shift: Vector | None = None  # [m] of the tracker's origin, in the base frame

    @classmethod
    def read(cls, frame: RecipeFields) -> FrameChoice:
        """Read the key `frame` of an import.yaml: a result has both rotation and shift."""
        frame.only('method', 'rotation', 'shift')
        method = frame.choice('method', METHODS) if frame.has('method') else None
        if not frame.has('rotation') and not frame.has('shift'):
            return cls(method)
        a, b, c = frame.vector('rotation', 3)
        x, y, z = frame.vector('shift', 3)
        return cls(method, (a, b, c), (x, y, z))


@dataclass(frozen=True)
class Recipe:
    """Every choice of an import; None is guessed from the tables."""

    sources: tuple[str, ...] = ()
    robot: str | None = None
    time: Mapping[str, str] | None = None  # column -> unit; each table has one of them
    inputs: Mapping[str, ColumnUse] | None = None  # input -> its column
    input_unit: str | None = None  # of guessed columns; precedes units in their names
    time_unit: str | None = None
    zero: bool | None = None  # inputs count from their value when the arm first stands still
    spool: WireSpool = WireSpool()
    positions: str | None = None  # unit of the markers
    points: str | None = None  # one of CHOICES, where columns are guessed
    markers: tuple[MarkerColumns, ...] | None = None
    offset: Vector | None = None  # [m] of all markers, where columns are guessed
    places: tuple[float, ...] = ()  # [m] arc lengths from base to tip, where columns are guessed
    up: str | None = None  # axis of the tracker
    delay: tuple[float, ...] | None = None  # [s] that the tracker's file begins later, of each
    drift: tuple[float, ...] | None = None  # [s/s] that its clock loses, of each
    speed: float | None = None  # [m/s] slower is still
    duration: float = 1.0  # [s] at least so long
    change: float | None = None  # [N] or [m] of an input, while the arm stands still
    same: float | None = None  # [N] or [m] inputs that differ by less are those of one posture
    rest: float | None = None  # [N] or [m] below, the arm rests between; 0: it never does
    path: str = 'from_straight'
    frame: FrameChoice = FrameChoice()
    leave_out: tuple[tuple[str, str], ...] | None = None  # posture, trial


class RecipeFields(DatasetFields):
    """Checked reading of import.yaml."""

    def text(self, key: str) -> str | None:
        """Return a text such as the name of a column, None when absent."""
        value = self.content.get(key)
        if value is None:
            return None
        if isinstance(value, bool | list | dict):
            raise self.error(key, 'a text (put it in quotes: YAML reads it otherwise)', value)
        return str(value)

    def some(self, key: str, low: float, high: float, unit: str) -> float | None:
        """Return a number within bounds, None when absent."""
        return self.number(key, low, high, unit) if self.has(key) else None

    def xyz(self, key: str) -> Vector | None:
        """Return three numbers, None when absent."""
        if not self.has(key):
            return None
        x, y, z = self.vector(key, 3)
        return x, y, z

    def list_of_numbers(self, key: str) -> tuple[float, ...]:
        """Return one number or a list of them as a tuple, empty when absent."""
        values = self.numbers(key) if self.has(key) else ()
        return values if isinstance(values, tuple) else (values,)

    def points(self, key: str, columns: Any) -> tuple[str, ...]:
        """Return the columns of x, y and z of one point, or of three and more on a rim."""
        if not isinstance(columns, list) or len(columns) not in (3, *range(9, 100, 3)):
            expected = 'the columns of x, y and z, of one point or of three and more around a disk'
            raise self.error(key, expected, columns)
        return tuple(map(str, columns))

    def unit(self, key: str, *kinds: str) -> str | None:
        """Return a unit of these kinds, None when absent."""
        text = self.text(key)
        unit = None if text is None else find_unit(text)
        if text is not None and (unit is None or unit.kind not in kinds):
            known = ', '.join(name for kind in kinds for name in UNITS[kind])
            raise self.error(key, f'one of {known}', text)
        return text


def load_recipe(path: str | Path) -> Recipe:
    """
    Read an import.yaml; its sources are relative to its folder.

    Raises
    ------
    DataSetError
        With file, key, what was expected and what came.

    """
    path = Path(path)

    def refuse(reason: str) -> DataSetError:
        return DataSetError(str(path), f'cannot be read ({reason})', 'name an import.yaml')

    text = read_text(path, refuse)
    if not text.strip():
        raise refuse('it is empty')
    try:
        content = parse_yaml(text)
    except ValueError as error:
        raise DataSetError(str(path), f'is no valid YAML ({error})', 'correct that line') from None
    return read_recipe(content, str(path), path.parent)


def as_recipe(given: Recipe | Mapping[str, Any] | str | Path | None) -> Recipe:
    """Return a recipe that is given as such, as its keys, or as a file; None is an empty one."""
    if given is None or isinstance(given, Recipe):
        return given or Recipe()
    if isinstance(given, str | Path):
        return load_recipe(given)
    if not isinstance(given, Mapping):
        raise refusal('recipe', 'a dict, or the path of an import.yaml', given)
    return read_recipe(dict(given))


def read_recipe(content: Any, source: str = 'recipe', folder: Path | None = None) -> Recipe:
    """Check the content of an import.yaml."""
    top = RecipeFields(source, '', content)
    top.only(*KEYS)
    still = top.child('still', optional=True)
    still.only(*STILL)
    files = top.content.get('sources') or []
    if not isinstance(files, list):
        raise top.error('sources', 'a list of files', files)
    robot = top.text('robot')
    times = top.child('time', optional=True)
    inputs = {}
    for name in top.child('inputs', optional=True).content:
        one = top.child('inputs').child(str(name))
        one.only('column', 'unit')
        unit = one.unit('unit', 'force', 'length', 'angle', 'counts', 'current')
        inputs[str(name)] = ColumnUse(one.text('column') or '', unit or '')
    drifts = top.list_of_numbers('drift') or None
    if drifts and not top.has('delay'):
        raise top.error('drift', 'delay beside it: clocks are known by both, or found', drifts)
    if drifts and max(map(abs, drifts)) > 0.1:
        raise top.error('drift', 'seconds that the clock loses per second, within 0.1', drifts)
    rows = top.content.get('leave_out')
    if rows is not None and (
        not isinstance(rows, list) or any(not isinstance(r, list) or len(r) != 2 for r in rows)
    ):
        raise top.error('leave_out', 'a list of [posture, trial]', rows)
    return Recipe(
        sources=tuple(_place(str(name), folder) for name in files),
        robot=None if robot is None else _place(robot, folder),
        time={str(c): times.unit(c, 'time') or 's' for c in times.content}
        if top.has('time')
        else None,
        inputs=inputs if top.has('inputs') else None,
        zero=top.flag('zero') if top.has('zero') else None,
        spool=WireSpool.read(top.child('spool', optional=True)),
        positions=top.unit('positions', 'length'),
        points=top.choice('points', CHOICES) if top.has('points') else None,
        markers=tuple(map(MarkerColumns.read, top.items('markers')))
        if top.has('markers')
        else None,
        offset=top.xyz('offset'),
        places=top.list_of_numbers('places'),
        up=top.choice('up', UPS) if top.has('up') else None,
        delay=top.list_of_numbers('delay') or None,
        drift=drifts,
        speed=still.some('speed', 1e-6, 10.0, 'm/s'),
        duration=still.some('duration', 1e-3, 1e4, 's') or 1.0,
        change=still.some('change', 1e-9, 1e4, 'N or m'),
        same=top.some('same', 1e-12, 1e4, 'N or m'),
        rest=top.some('rest', 0.0, 1e4, 'N or m'),
        path=top.choice('path', PATHS, default='from_straight'),
        frame=FrameChoice.read(top.child('frame', optional=True)),
        leave_out=None if rows is None else tuple((str(p), str(q)) for p, q in rows),
    )


def _place(name: str, folder: Path | None) -> str:
    return name if folder is None else os.path.normpath(folder / name)


def dump_recipe(recipe: Recipe, folder: Path) -> str:
    """Write an import.yaml that lies in a folder; `load_recipe` gives the same recipe."""
    base = os.path.abspath(folder)
    plain: dict[str, Any] = {
        'sources': [os.path.relpath(os.path.abspath(s), base) for s in recipe.sources],
        'robot': 'robot.yaml',
        'time': dict(recipe.time) if recipe.time else None,
        'inputs': {
            name: {'column': use.column, 'unit': use.unit}
            for name, use in (recipe.inputs or {}).items()
        },
        'zero': recipe.zero or None,
        'spool': {k: v for k, v in vars(recipe.spool).items() if v is not None} or None,
        'positions': recipe.positions,
        'markers': [marker.plain() for marker in recipe.markers or ()],
        'up': recipe.up,
        'delay': list(recipe.delay) if recipe.delay else None,
        'drift': list(recipe.drift) if recipe.drift else None,
        'still': {key: getattr(recipe, key) for key in STILL} if recipe.time else None,
        'same': recipe.same,
        'rest': recipe.rest,
        'path': recipe.path,
        'frame': {
            'method': recipe.frame.method,
            'rotation': list(recipe.frame.rotation or ()),
            'shift': list(recipe.frame.shift or ()),
        },
        'leave_out': [list(pair) for pair in recipe.leave_out or ()],
    }
    kept = {key: value for key, value in plain.items() if value is not None}
    return HEAD + str(
        yaml.safe_dump(kept, sort_keys=False, default_flow_style=None, allow_unicode=True)
    )
