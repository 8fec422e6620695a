"""
import.yaml: how tables became a data set, every choice written out.

A recipe is read from a file, a mapping or options; the columns and units that it leaves open are
chosen from the tables.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ..common.errors import DataSetError, InputError, refusal, short
from ..common.words import TYPED_LENGTHS, UNITS, Unit, digits, find_unit, listing
from ..common.yaml_reading import dump_yaml, in_range, one_of, part
from ..data.arrays import Vector
from ..data.dataset import PATHS
from ..data.folder import DatasetFields, read_text
from ..data.tracker_faults import without_unseen
from ..robot import Robot
from .columns import FRAMES, KINDS, UPS, RawTable, guess_inputs, guess_time, names_of, triples_of
from .markers import CHOICES, Points, choose_points

METHODS = ('model', 'level', 'straight', 'base')
INPUT_KINDS = tuple(KINDS)
HEAD = """\
# How the tables named under sources became the data set beside this file. SI units but for the
# units of columns. Change a line, or take one out to have it guessed again, and run
#   python -m tendon_robot_ros import table --recipe THIS_FILE --output NEW_FOLDER
"""
OPTIONS = 'options'  # source of a recipe that options make
OPTION_OF = {'places': 'markers', 'radius': 'spool'}  # key -> option, where another word


class RecipeFields(DatasetFields):
    """Checked reading of import.yaml, or of options by its keys."""

    def error(self, key: str, expected: str, got: object) -> DataSetError:
        """Build the error for a key, or for the option that stands for it."""
        if self.source != OPTIONS:
            return super().error(key, expected, got)
        option = OPTION_OF.get(key, key).replace('_', '-')
        return DataSetError(f'--{option}', f'got {short(got)}', f'expected {expected}')

    def text(self, name: str) -> str:
        """Return a text such as the name of a column."""
        value = self.content[name]
        if isinstance(value, bool | list | dict):
            raise self.error(name, 'a text (put it in quotes: YAML reads it otherwise)', value)
        return str(value)

    def texts(self, name: str) -> tuple[str, ...]:
        """Return the names of files."""
        if not isinstance(self.content[name], list):
            raise self.error(name, 'a list of files', self.content[name])
        return tuple(map(str, self.content[name]))

    def list_of_numbers(self, name: str) -> tuple[float, ...]:
        """Return one number or a list of them as a tuple."""
        values = self.numbers(name)
        return values if isinstance(values, tuple) else (values,)

    def unit(self, name: str, *kinds: str) -> str:
        """Return a unit of these kinds."""
        text = self.text(name)
        unit = find_unit(text)
        if unit is None or unit.kind not in kinds:
            known = ', '.join(unit for kind in kinds for unit in UNITS[kind])
            raise self.error(name, f'one of {known}', text)
        return text

    def markers(self, name: str) -> tuple[MarkerColumns, ...]:
        """Return the columns of each marker."""
        return tuple(item.read(MarkerColumns) for item in self.items(name))

    def points(self, name: str, columns: Any = None) -> tuple[str, ...]:
        """Return the columns of x, y and z of one point, or of three and more on a rim."""
        columns = self.content.get(name) if columns is None else columns
        if not isinstance(columns, list) or len(columns) not in (3, *range(9, 100, 3)):
            expected = 'the columns of x, y and z, of one point or of three and more around a disk'
            raise self.error(name, expected, columns)
        return tuple(map(str, columns))

    def later(self, name: str) -> tuple[tuple[str, ...], ...]:
        """Return columns in which a marker goes on."""
        if not isinstance(self.content[name], list):
            raise self.error(name, 'a list of the columns of x, y and z', self.content[name])
        return tuple(self.points(name, columns) for columns in self.content[name])

    def times(self, name: str) -> dict[str, str]:
        """Return the unit of each column of times."""
        times = self.child(name)
        return {str(c): times.unit(c, 'time') if times.has(c) else 's' for c in times.content}

    def uses(self, name: str) -> dict[str, ColumnUse]:
        """Return the column of each input."""
        wires = self.child(name)
        return {wire: wires.child(wire).read(ColumnUse) for wire in map(str, wires.content)}

    def trials(self, name: str) -> tuple[tuple[str, str], ...]:
        """Return postures and trials."""
        rows = self.content[name]
        if not isinstance(rows, list) or any(not isinstance(r, list) or len(r) != 2 for r in rows):
            raise self.error(name, 'a list of [posture, trial]', rows)
        return tuple((str(posture), str(trial)) for posture, trial in rows)

    def frame(self, name: str) -> FrameChoice:
        """Return the pose of a frame: a result has both rotation and shift."""
        frame = self.child(name)
        for one in ('rotation', 'shift'):
            if frame.has('rotation') or frame.has('shift'):
                frame.vector(one, 3)
        return frame.read(FrameChoice)


# fields of the dataclasses below: their type, and how the key of the same name is read; they
# stand here because a function within an annotation does not see the names of this module
Text = Annotated[str | None, RecipeFields.text]
Numbers = Annotated[tuple[float, ...] | None, RecipeFields.list_of_numbers]
Xyz = Annotated[Vector | None, lambda one, name: one.vector(name, 3)]
InputUnit = Annotated[str, lambda one, name: one.unit(name, *INPUT_KINDS)]


@dataclass(frozen=True)
class ColumnUse:
    """A selected column and its unit; '' if the unit is unknown."""

    column: Annotated[str, RecipeFields.text] = ''
    unit: InputUnit = ''


@dataclass(frozen=True)
class MarkerColumns:
    """Columns of a marker, and where on the arm it is."""

    # of x, y and z; of three or more points on a rim all of theirs
    columns: Annotated[tuple[str, ...], RecipeFields.points]
    name: Text = None  # of the marker in the data set
    # [m]; None: found by its place along the straight arm
    arc_length: Annotated[float | None, in_range(0.0, 100.0, 'm')] = None
    offset: Xyz = None  # [m] in the frame there
    # columns in which it goes on, numbered anew
    later: Annotated[tuple[tuple[str, ...], ...] | None, RecipeFields.later] = None

    @property
    def parts(self) -> list[list[tuple[str, ...]]]:
        """Columns of x, y and z of each point, first and where it goes on."""
        return [
            [columns[i : i + 3] for i in range(0, len(columns), 3)]
            for columns in (self.columns, *(self.later or ()))
        ]


@dataclass(frozen=True)
class WireSpool:
    """The spool by which angles or currents of a motor become wire pulls or tensions."""

    radius: Annotated[float | None, in_range(1e-5, 1.0, 'm')] = None  # [m]
    counts_per_turn: Annotated[float | None, in_range(1e-3, 1e9, '1')] = None
    # [N·m/A], at the spool
    torque_constant: Annotated[float | None, in_range(1e-9, 1e6, 'N·m/A')] = None


@dataclass(frozen=True)
class Stillness:
    """When the arm counts as still; None is guessed."""

    speed: Annotated[float | None, in_range(1e-6, 10.0, 'm/s')] = None  # [m/s] slower is still
    duration: Annotated[float | None, in_range(1e-3, 1e4, 's')] = None  # [s] at least so long
    # [N] or [m] of an input meanwhile
    change: Annotated[float | None, in_range(1e-9, 1e4, 'N or m')] = None


@dataclass(frozen=True)
class FrameChoice:
    """Where the tracker's frame lies: how it is found, or the result."""

    method: Annotated[str | None, one_of(*METHODS)] = None
    rotation: Xyz = None  # [rad] rotation vector, tracker to base
    shift: Xyz = None  # [m] of the tracker's origin, in the base frame


@dataclass(frozen=True)
class Recipe:
    """Every choice of an import; None is guessed from the tables."""

    sources: Annotated[tuple[str, ...], RecipeFields.texts] = ()
    robot: Text = None
    # column -> unit; each table has one of them; {}: times do not count, a row is a measurement
    time: Annotated[Mapping[str, str] | None, RecipeFields.times] = None
    inputs: Annotated[Mapping[str, ColumnUse] | None, RecipeFields.uses] = None  # by input
    # inputs count from their value when the arm first stands still
    zero: Annotated[bool | None, RecipeFields.flag] = None
    spool: Annotated[WireSpool, part(WireSpool)] = WireSpool()
    # of the markers
    positions: Annotated[str | None, lambda one, name: one.unit(name, 'length')] = None
    points: Annotated[str | None, one_of(*CHOICES)] = None  # where columns are guessed
    markers: Annotated[tuple[MarkerColumns, ...] | None, RecipeFields.markers] = None
    offset: Xyz = None  # [m] of all markers, where columns are guessed
    places: Numbers = None  # [m] arc lengths from base to tip, where columns are guessed
    up: Annotated[str | None, one_of(*UPS)] = None  # axis of the tracker
    delay: Numbers = None  # [s] that the tracker's file begins later, of each recording
    drift: Numbers = None  # [s/s] that its clock loses, of each recording
    still: Annotated[Stillness, part(Stillness)] = Stillness()
    # [N] or [m] inputs that differ by less are those of one posture
    same: Annotated[float | None, in_range(1e-12, 1e4, 'N or m')] = None
    # [N] or [m] below, the arm rests between; 0: it never does
    rest: Annotated[float | None, in_range(0.0, 1e4, 'N or m')] = None
    path: Annotated[str, one_of(*PATHS)] = 'from_straight'
    frame: Annotated[FrameChoice, RecipeFields.frame] = FrameChoice()
    # posture, trial
    leave_out: Annotated[tuple[tuple[str, str], ...] | None, RecipeFields.trials] = None
    input_unit: str | None = None  # of guessed columns; precedes units in their names
    time_unit: str | None = None

    def with_keys(self, keys: Mapping[str, Any]) -> Recipe:
        """
        Return the recipe with these keys of the file instead of its own.

        Of `spool`, `still` and `inputs` what they do not say stays; with `points` markers are
        guessed anew, with `places` where they are.
        """
        new = _checked(RecipeFields(OPTIONS, '', dict(keys)))
        values = {name: getattr(new, name) for name in keys}
        for name in {'spool', 'still'} & keys.keys():
            told = (one for one, value in keys[name].items() if value is not None)
            own = {one: getattr(values[name], one) for one in told}
            values[name] = replace(getattr(self, name), **own)
        if 'inputs' in keys:
            values['inputs'] = {**(self.inputs or {}), **values['inputs']}
        if 'places' in keys:
            values['markers'] = tuple(replace(m, arc_length=None) for m in self.markers or ())
        if 'points' in keys or not values.get('markers', True):
            values['markers'] = None
        return replace(self, **values)


def load_recipe(path: str | Path) -> Recipe:
    """
    Read an import.yaml; its sources are relative to its folder.

    Raises
    ------
    DataSetError
        With file, key, what was expected and what came.

    """
    path, remedy = Path(path), 'name an import.yaml'
    text = read_text(path, remedy)
    if not text.strip():
        raise DataSetError(str(path), 'cannot be read (it is empty)', remedy)
    recipe = _checked(RecipeFields.parse(text, str(path)))
    sources = [os.path.normpath(path.parent / name) for name in recipe.sources]
    robot = None if recipe.robot is None else os.path.normpath(path.parent / recipe.robot)
    return replace(recipe, sources=tuple(sources), robot=robot)


def as_recipe(given: Recipe | Mapping[str, Any] | str | Path | None) -> Recipe:
    """Return a recipe that is given as such, as its keys, or as a file; None is an empty one."""
    if given is None or isinstance(given, Recipe):
        return given or Recipe()
    if isinstance(given, str | Path):
        return load_recipe(given)
    if not isinstance(given, Mapping):
        raise refusal('recipe', 'a dict, or the path of an import.yaml', given)
    return _checked(RecipeFields('recipe', '', dict(given)))


def _checked(top: RecipeFields) -> Recipe:
    recipe = top.read(Recipe)
    if recipe.drift and recipe.delay is None:
        expected = 'delay beside it: clocks are known by both, or found'
        raise top.error('drift', expected, recipe.drift)
    if max(map(abs, recipe.drift or (0.0,))) > 0.1:
        expected = 'seconds that the clock loses per second, within 0.1'
        raise top.error('drift', expected, recipe.drift)
    return recipe


def dump_recipe(recipe: Recipe, folder: Path) -> str:
    """Write an import.yaml that lies in a folder; `load_recipe` gives the same recipe."""
    base = os.path.abspath(folder)
    sources = tuple(os.path.relpath(os.path.abspath(s), base) for s in recipe.sources)
    written = replace(recipe, sources=sources, robot='robot.yaml', zero=recipe.zero or None)
    keys = asdict(replace(written, input_unit=None, time_unit=None), dict_factory=_said)
    keys.setdefault('leave_out', ())  # none is a choice, too
    keys |= {'time': {}} if recipe.time == {} else {}
    return HEAD + dump_yaml(keys)


def _said(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the fields of a dataclass that hold something."""
    return {name: value for name, value in pairs if value not in (None, {})}


# [s] a median step above is in another unit, because nobody records an arm so slowly
STEP_MAX_S = 2.0
LENGTH_UNITS = ('m', 'mm')  # a factor of 1000, so that the size of the arm decides
SMALLEST = UNITS['length']['mm']  # [m] the smallest unit that is tried
# [1] lengths of the arm that its markers may be apart, because a bent arm shows less, and one with
# a long tool more
EXTENT = (0.25, 1.3)


class Selection:
    """
    The selected columns and units: what a recipe leaves open is filled in.

    Attributes
    ----------
    recipe : Recipe
        With all columns and units.
    reasons : dict of str
        How each column was recognised.
    unused : list of str
        Columns that are not used.
    assumed, warnings : list of str
        Assumptions; contradictions between a table and the recipe.
    kind : str
        'tension' or 'displacement'.
    aside : tuple of str
        Excluded triples, by quantity.
    nameless : list of tuple of str
        Columns of markers that have no name.

    Raises
    ------
    DataSetError, InputError
        Columns for the inputs or the markers are missing, or a unit.

    """

    def __init__(self, tables: Sequence[RawTable], robot: Robot, recipe: Recipe) -> None:
        self.tables, self.robot, self.recipe = tables, robot, recipe
        self.assumed = [f'{t.name}: {note}' for t in tables for note in t.notes]
        self.reasons: dict[str, str] = {}
        self._choose_times()
        self._choose_inputs()
        points = self._choose_markers()
        self.aside, self.nameless = points.aside, list(points.nameless)
        self._choose_position_unit()
        units = {find_unit(use.unit) for use in (self.recipe.inputs or {}).values()}
        kinds = {unit.kind for unit in units if unit is not None}
        self.kind = 'tension' if kinds <= {'force', 'current'} else 'displacement'
        if self.kind == 'displacement' and not kinds <= {'length', 'angle', 'counts'}:
            problem = 'all are tensions or all are wire pulls; give columns of one kind'
            raise InputError(f'inputs: {problem}')
        if recipe.zero is None:
            turned = bool(kinds & {'angle', 'counts'})
            self.recipe = replace(self.recipe, zero=turned)
            if turned:
                first = 'where they are when the arm first stands still'
                self.assumed.append(f'motors count from {first}')
        self.warnings = self._units_contradicted()
        taken = set(self.reasons)
        taken |= {c for t in tables for triple in triples_of(t) for c in triple.columns}
        self.unused = [*dict.fromkeys(c for t in tables for c in t.columns if c not in taken)]

    @property
    def written_units(self) -> dict[str, Unit]:
        """The unit of every column that has one, by its name or by the file."""
        names = (name for table in reversed(self.tables) for name in names_of(table))
        return {name.column: name.unit for name in names if name.unit is not None}

    def _units_contradicted(self) -> list[str]:
        """
        Return a line for each unit in a table that contradicts the unit in use.

        This is a warning and no error, because the header of a logger may be wrong, and then the
        unit given by the user must hold.
        """
        used_as = {u.column: ('inputs', u.unit) for u in (self.recipe.inputs or {}).values()}
        columns = [column for marker in self.recipe.markers or () for column in marker.columns]
        used_as |= dict.fromkeys(columns, ('positions', self.recipe.positions or ''))
        used_as |= {column: ('time', unit) for column, unit in (self.recipe.time or {}).items()}
        contradictions: dict[tuple[str, Unit, Unit], list[str]] = {}
        for column, written in self.written_units.items():
            what, text = used_as.get(column, ('', ''))
            unit = find_unit(text)
            if unit is None or unit.kind == written.kind == 'counts':
                continue
            if (written.kind, written.factor) != (unit.kind, unit.factor):
                contradictions.setdefault((what, written, unit), []).append(column)
        lines = []
        for (what, written, unit), own in contradictions.items():
            size = ', another kind of quantity'
            if unit.kind == written.kind:
                ratio = unit.factor / written.factor
                times = digits(max(ratio, 1.0 / ratio), 3)
                size = f', {times} times as {"much" if ratio > 1.0 else "little"}'
            lines.append(
                f'the table says {written.text} of {listing(own)}, and {unit.text} was taken'
                f'{size}: if the table is right, leave out --unit {what}={unit.text} (or take the '
                'unit out of import.yaml)'
            )
        return lines

    def _take_given(self, column: str, option: str) -> None:
        """Take a column that the recipe names; refuse one that no table has."""
        if not any(table.holds(column) for table in self.tables):
            first = self.tables[0]
            problem, known = f'no column {column!r} ({option})', listing(first.columns)
            raise DataSetError(first.name, problem, f'use one of {known}')
        self.reasons[column] = 'as given'

    def _choose_times(self) -> None:
        recipe, tables = self.recipe, self.tables
        if recipe.time == {}:  # as given: every row is a measurement
            return
        times = dict(recipe.time or {})
        for column in times:
            self._take_given(column, 'time')
        for table in tables:
            guess = guess_time(names_of(table))
            if guess is None or time_column(table, times) is not None:
                continue
            column = guess.column
            self.reasons[column] = 'its name'
            unit = recipe.time_unit or (guess.unit.text if guess.unit else '')
            if not unit and table.units.get(column) == FRAMES:
                problem = 'counts frames, and nothing says how many a second'
                raise DataSetError(table.name, problem, 'say --unit time=60Hz, or how many it has')
            if not unit:
                unit, note = _time_unit(table, column)
                self.assumed += [f'{table.name}: {note}'] if note else []
            times[column] = unit
        lacking = [table for table in tables if time_column(table, times) is None]
        # a unit was given, so a column must exist
        if lacking and (times or recipe.time_unit is not None):
            problem, remedy = 'has no column of times', 'say --column time=COLUMN'
            raise DataSetError(lacking[0].name, problem, remedy)
        if not times:
            self.assumed.append(
                'no column of times: every row is a measurement of the arm at rest '
                '(a recording? name its column: --column time=COLUMN)'
            )
        self.recipe = replace(recipe, time=times or None)

    def _choose_inputs(self) -> None:
        recipe, tables, robot = self.recipe, self.tables, self.robot
        inputs = dict(recipe.inputs or {})
        for name, use in inputs.items():
            if name not in robot.inputs:
                raise InputError(f'inputs: expected {", ".join(robot.inputs)}, got {name!r}')
            self._take_given(use.column, f'input {name}')
        missing = [name for name in robot.inputs if name not in inputs]
        if missing:
            guesses = (guess_inputs(names_of(t), missing) for t in tables)
            if (guess := next(filter(None, guesses), None)) is None:
                known = listing(n.column for t in tables for n in names_of(t) if not n.axis)
                none = f'no columns for the inputs {listing(missing)} are recognised'
                remedy = 'name each by --column INPUT=COLUMN'
                raise DataSetError(tables[0].name, f'{none} among {known}', remedy)
            columns, reason = [one.column for one in guess[0]], guess[1]
            inputs |= {name: ColumnUse(c, '') for name, c in zip(missing, columns, strict=True)}
            self.reasons |= dict.fromkeys(columns, reason)
        written = self.written_units
        for name, use in inputs.items():  # the unit of an option, of the recipe, or of the file
            own = written[use.column].text if use.column in written else ''
            inputs[name] = replace(use, unit=recipe.input_unit or use.unit or own)
        lacking = [use.column for use in inputs.values() if not use.unit]
        if lacking:
            units = 'mN, g, kgf, lbf, mm, deg, ticks, mA ...'
            remedy = f'write it into the header, as in "T1 [N]", or say --unit inputs=N ({units})'
            problem = f'nothing says the unit of {listing(lacking)}'
            raise DataSetError(tables[0].name, problem, remedy)
        self.recipe = replace(recipe, inputs={name: inputs[name] for name in robot.inputs})

    def _choose_markers(self) -> Points:
        """Return the selected points; none where the recipe names the markers."""
        recipe, tables = self.recipe, self.tables
        if recipe.markers is not None:
            for marker in recipe.markers:
                for column in marker.columns:
                    self._take_given(column, 'markers')
            return Points()
        points = choose_points(tables, recipe.points)
        for columns in points.columns:
            self.reasons |= dict.fromkeys(columns, 'its name')
        self.assumed += [points.note] if points.note else []
        self.recipe = replace(recipe, markers=tuple(map(MarkerColumns, points.columns)))
        return points

    def _choose_position_unit(self) -> None:
        recipe, robot, name = self.recipe, self.robot, self.tables[0].name
        if recipe.positions is not None:
            return
        units = self.written_units
        columns = (column for marker in recipe.markers or () for column in marker.columns)
        written = {units[c].text if c in units else None for c in columns}
        if len(written) == 1 and (unit := written.pop()) is not None:
            self.recipe = replace(recipe, positions=unit)
            return
        if len(written - {None}) > 1:
            problem = f'markers are in several units: {listing(sorted(str(u) for u in written))}'
            remedy = 'export all in one; where only the header is wrong, say --unit positions=mm'
            raise DataSetError(name, problem, remedy)
        apart = _extent(self.tables, recipe)
        low, high = (fraction * robot.length for fraction in EXTENT)
        fitting = [u for u in LENGTH_UNITS if low <= apart * UNITS['length'][u] <= high]
        if not fitting:
            others = [u for u in TYPED_LENGTHS if low <= apart * UNITS['length'][u] <= high]
            none = 'nothing says the unit of the markers, and neither m nor mm fits'
            sizes = f'they are {apart:.4g} apart, the arm is {1e3 * robot.length:.4g} mm long'
            fit = ' or '.join(f'say --unit positions={unit}' for unit in others)
            correct = 'correct cell_length and cells of the robot, or say --unit positions=UNIT'
            raise DataSetError(name, f'{none}: {sizes}', fit or correct)
        known_by = f'up to {apart:.4g} apart on an arm of {1e3 * robot.length:.4g} mm'
        self.assumed.append(f'markers are in {fitting[0]}: they are {known_by}')
        self.recipe = replace(recipe, positions=fitting[0])


def _time_unit(table: RawTable, column: str) -> tuple[str, str]:
    if table.is_text(column):
        return 's', ''
    steps = np.abs(np.diff(table.columns[column]))
    step, whole = (
        (float(np.nanmedian(steps)), float(np.nansum(steps))) if len(steps) else (0.0, 0.0)
    )
    for unit in ('s', 'ms', 'us', 'ns'):
        seconds = step * UNITS['time'][unit]
        is_recording = unit == 's' or whole * UNITS['time'][unit] > STEP_MAX_S
        if seconds <= STEP_MAX_S and is_recording:
            rate = f', then there are {1 / seconds:.3g} rows a second' if seconds else ''
            return unit, f'{column} is in {unit}{rate}'
    return 's', ''


def time_column(table: RawTable, times: Mapping[str, str] | None) -> str | None:
    """Return the column of times that a table has."""
    return next((c for c in times or {} if table.holds(c)), None)


def _extent(tables: Sequence[RawTable], recipe: Recipe) -> float:
    """Return the largest distance of two markers, or the path of a single one, in their unit."""
    largest = 0.0
    for table in tables:
        markers = [m.columns[:3] for m in recipe.markers or () if table.holds(*m.columns)]
        if not markers:
            continue
        places = without_unseen(SMALLEST * table.places(markers, some=True), None)[0] / SMALLEST
        if len(markers) == 1:
            low, high = np.nanpercentile(places[:, 0], [2, 98], axis=0)
            return float((high - low).max())
        apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
        known = apart[:, np.isfinite(apart).any(axis=0)]
        largest = max(largest, float(np.nanpercentile(known, 95, axis=0).max(initial=0.0)))
    return largest
