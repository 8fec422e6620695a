"""Select columns and their units where a recipe leaves them open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..common.errors import DataSetError, InputError
from ..common.words import TYPED_LENGTHS, UNITS, digits, find_unit, listing
from ..data.tracker_faults import FAR_M, without_unseen
from ..robot import Robot
from .columns import (
    FRAMES,
    RawTable,
    guess_inputs,
    guess_time,
    names_of,
    need_column,
    triples_of,
)
from .markers import FRAMES_MAX, Points, choose_points
from .recipe import MarkerColumns, Recipe

# [s] a median step above is in another unit, because nobody records an arm so slowly
STEP_MAX_S = 2.0
LENGTH_UNITS = ('m', 'mm')  # a factor of 1000, so that the size of the arm decides
FAR = FAR_M / UNITS['length']['mm']  # in the smallest unit that is tried
# [1] lengths of the arm that its markers may be apart, because a bent arm shows less, and one with
# a long tool more
EXTENT = (0.25, 1.3)


@dataclass(frozen=True)
class Selection:
    """The selected columns, their use, and how they were recognised, in table order."""

    recipe: Recipe
    reasons: Mapping[str, str]  # column -> how it was recognised
    unused: tuple[str, ...]
    assumed: tuple[str, ...]
    kind: str  # 'tension' or 'displacement'
    warnings: tuple[str, ...] = ()  # contradictions between a table and the recipe
    aside: tuple[str, ...] = ()  # excluded triples, by quantity
    nameless: tuple[tuple[str, str, str], ...] = ()  # columns of markers that have no name

    @property
    def unused_points(self) -> tuple[str, ...]:
        """The excluded points by quantity, and the number of points without a name."""
        count = len(self.nameless)
        return self.aside + ((f'{count} points without a name (unlabeled)',) if count else ())


def choose_columns(tables: Sequence[RawTable], robot: Robot, recipe: Recipe) -> Selection:
    """
    Fill in the columns and units that a recipe leaves open.

    Raises
    ------
    DataSetError, InputError
        Columns for the inputs or the markers are missing, or a unit.

    """
    assumed = [f'{t.name}: {note}' for t in tables for note in t.notes]
    reasons: dict[str, str] = {}
    recipe = _choose_times(tables, recipe, reasons, assumed)
    recipe = _choose_inputs(tables, robot, recipe, reasons)
    recipe, points = _choose_markers(tables, recipe, reasons, assumed)
    recipe = _choose_position_unit(tables, robot, recipe, assumed)
    used = set(reasons)
    unused = [c for t in tables for c in t.names if c not in used]
    units = {find_unit(use.unit) for use in (recipe.inputs or {}).values()}
    kinds = {unit.kind for unit in units if unit is not None}
    kind = 'tension' if kinds <= {'force', 'current'} else 'displacement'
    if kind == 'displacement' and not kinds <= {'length', 'angle', 'counts'}:
        raise InputError(
            'inputs: all are tensions or all are wire pulls; give columns of one kind'
        )
    if recipe.zero is None:
        turned = bool(kinds & {'angle', 'counts'})
        recipe = replace(recipe, zero=turned)
        if turned:
            assumed.append('motors count from where they are when the arm first stands still')
    warnings = tuple(_units_contradicted(tables, recipe))
    triples = {c for table in tables for triple in triples_of(table) for c in triple.columns}
    unused = [column for column in dict.fromkeys(unused) if column not in triples]
    chosen = Selection(recipe, reasons, tuple(unused), tuple(assumed), kind, warnings)
    if points is None:
        return chosen
    chosen = replace(chosen, aside=points.aside, nameless=points.nameless)
    if points.unused_fraction > 0.5:  # most of them
        question = (
            f'{100 * points.unused_fraction:.0f} % of all x, y, z are left out, '
            f'{listing(chosen.unused_points)}: are the markers those that are taken?'
        )
        chosen = replace(chosen, warnings=(*warnings, question))
    return chosen


def _units_contradicted(tables: Sequence[RawTable], recipe: Recipe) -> list[str]:
    """
    Return a line for each unit in a table that contradicts the unit in use.

    This is a warning and no error, because the header of a logger may be wrong, and then the unit
    given by the user must hold.
    """
    inputs = (recipe.inputs or {}).values()
    used_as = {use.column: ('inputs', use.unit) for use in inputs}
    columns = [column for marker in recipe.markers or () for column in marker.columns]
    used_as |= dict.fromkeys(columns, ('positions', recipe.positions or ''))
    used_as |= {column: ('time', unit) for column, unit in (recipe.time or {}).items()}
    contradictions: dict[tuple[str, str, str], list[str]] = {}
    for name in (name for table in tables for name in names_of(table)):
        what, text = used_as.get(name.column, ('', ''))
        unit = find_unit(text)
        if name.unit is None or unit is None or unit.kind == name.unit.kind == 'counts':
            continue
        if (name.unit.kind, name.unit.factor) != (unit.kind, unit.factor):
            contradictions.setdefault((what, name.unit.text, unit.text), []).append(name.column)
    lines = []
    for (what, written, text), own in contradictions.items():
        one, other = find_unit(text), find_unit(written)
        size = ', another kind of quantity'
        if one is not None and other is not None and one.kind == other.kind:
            ratio = one.factor / other.factor
            times = digits(max(ratio, 1.0 / ratio), 3)
            size = f', {times} times as {"much" if ratio > 1.0 else "little"}'
        lines.append(
            f'the table says {written} of {listing(own)}, and {text} was taken{size}: if the '
            f'table is right, leave out --unit {what}={text} (or take the unit out of import.yaml)'
        )
    return lines


def _choose_times(
    tables: Sequence[RawTable], recipe: Recipe, reasons: dict[str, str], assumed: list[str]
) -> Recipe:
    times = dict(recipe.time or {})
    for column in times:
        need_column(tables, column, 'time')
    for table in tables:
        mine = [column for column in times if table.holds(column)]
        if mine:
            reasons[mine[0]] = 'as given'
            continue
        if (use := guess_time(names_of(table))) is None:
            continue
        reasons[use.column] = 'its name'
        unit = recipe.time_unit or use.unit
        if not unit and table.units.get(use.column) == FRAMES:
            raise DataSetError(
                table.name,
                'counts frames, and nothing says how many a second',
                'say --unit time=60Hz, or how many it has',
            )
        if not unit:
            unit, note = _time_unit(table, use.column)
            assumed += [f'{table.name}: {note}'] if note else []
        times[use.column] = unit
    if times and not all(time_column(table, times) for table in tables):
        lacking = next(table for table in tables if not time_column(table, times))
        raise DataSetError(lacking.name, 'has no column of times', 'say --column time=COLUMN')
    if not times and recipe.time_unit is not None:  # a unit was given, so a column must exist
        raise DataSetError(tables[0].name, 'has no column of times', 'say --column time=COLUMN')
    if not times:
        assumed.append(
            'no column of times: every row is a measurement of the arm at rest '
            '(a recording? name its column: --column time=COLUMN)'
        )
    return replace(recipe, time=times or None)


def _time_unit(table: RawTable, column: str) -> tuple[str, str]:
    if column in table.texts:
        return 's', ''
    step = float(np.nanmedian(np.abs(np.diff(table.columns[column])))) if len(table) > 1 else 0.0
    for unit, factor in (('s', 1.0), ('ms', 1e-3), ('us', 1e-6), ('ns', 1e-9)):
        if step * factor <= STEP_MAX_S:
            rate = (
                '' if step == 0.0 else f', then there are {1 / (step * factor):.3g} rows a second'
            )
            return unit, f'{column} is in {unit}{rate}'
    return 's', ''


def time_column(table: RawTable, times: Mapping[str, str] | None) -> str | None:
    """Return the column of times that a table has."""
    known = (c for c in times or {} if table.holds(c))
    return next(known, None)


def _choose_inputs(
    tables: Sequence[RawTable], robot: Robot, recipe: Recipe, reasons: dict[str, str]
) -> Recipe:
    inputs = dict(recipe.inputs or {})
    for name, use in inputs.items():
        if name not in robot.inputs:
            raise InputError(f'inputs: expected {", ".join(robot.inputs)}, got {name!r}')
        need_column(tables, use.column, f'input {name}')
        reasons[use.column] = 'as given'
    missing = [name for name in robot.inputs if name not in inputs]
    if missing:
        guesses = ((t, guess_inputs(names_of(t), missing)) for t in tables)
        _, guess = next(((t, g) for t, g in guesses if g is not None), (None, None))
        if guess is None:
            raise DataSetError(
                tables[0].name,
                f'no columns for the inputs {listing(missing)} are recognised among '
                f'{listing(n.column for t in tables for n in names_of(t) if not n.axis)}',
                'name each by --column INPUT=COLUMN',
            )
        inputs |= guess.columns
        reasons |= {use.column: guess.reason for use in guess.columns.values()}
    units = ((n.column, n.unit) for t in tables for n in names_of(t) if n.unit is not None)
    written: dict[str, str] = {}
    for column, unit in units:
        written.setdefault(column, unit.text)
    for name, use in inputs.items():  # the unit of an option, of the recipe, or of the file
        text = recipe.input_unit or use.unit or written.get(use.column, '')
        inputs[name] = replace(use, unit=text)
    lacking = [use.column for use in inputs.values() if not use.unit]
    if lacking:
        raise DataSetError(
            tables[0].name,
            f'nothing says the unit of {listing(lacking)}',
            'write it into the header, as in "T1 [N]", or say --unit inputs=N (mN, g, kgf, lbf, '
            'mm, deg, ticks, mA ...)',
        )
    return replace(recipe, inputs={name: inputs[name] for name in robot.inputs})


def _choose_markers(
    tables: Sequence[RawTable], recipe: Recipe, reasons: dict[str, str], assumed: list[str]
) -> tuple[Recipe, Points | None]:
    """Return the recipe, and the selected points if it names no markers."""
    if recipe.markers is not None:
        for marker in recipe.markers:
            for column in marker.columns:
                need_column(tables, column, 'markers')
                reasons[column] = 'as given'
        return recipe, None
    points = choose_points(tables, recipe.points)
    for columns in points.columns:
        reasons |= dict.fromkeys(columns, 'its name')
    assumed += [points.note] if points.note else []
    markers = tuple(MarkerColumns(columns) for columns in points.columns)
    return replace(recipe, markers=markers), points


def _choose_position_unit(
    tables: Sequence[RawTable], robot: Robot, recipe: Recipe, assumed: list[str]
) -> Recipe:
    if recipe.positions is not None:
        return recipe
    columns = [column for marker in recipe.markers or () for column in marker.columns]
    written = set()
    for table in tables:
        for name in names_of(table):
            if name.column in columns:
                written.add(None if name.unit is None else name.unit.text)
    if len(written) == 1 and (unit := written.pop()) is not None:
        return replace(recipe, positions=unit)
    if len(written - {None}) > 1:
        raise DataSetError(
            tables[0].name,
            f'markers are in several units: {listing(sorted(str(u) for u in written))}',
            'export all in one; where only the header is wrong, say --unit positions=mm',
        )
    apart = _extent(tables, recipe)
    low, high = (fraction * robot.length for fraction in EXTENT)
    fitting = [u for u in LENGTH_UNITS if low <= apart * UNITS['length'][u] <= high]
    if not fitting:
        others = [u for u in TYPED_LENGTHS if low <= apart * UNITS['length'][u] <= high]
        raise DataSetError(
            tables[0].name,
            f'nothing says the unit of the markers, and neither m nor mm fits: they are '
            f'{apart:.4g} apart, the arm is {1e3 * robot.length:.4g} mm long',
            ' or '.join(f'say --unit positions={unit}' for unit in others)
            or 'correct cell_length and cells of the robot, or say --unit positions=UNIT',
        )
    assumed.append(
        f'markers are in {fitting[0]}: they are up to {apart:.4g} apart on an arm of '
        f'{1e3 * robot.length:.4g} mm'
    )
    return replace(recipe, positions=fitting[0])


def _extent(tables: Sequence[RawTable], recipe: Recipe) -> float:
    """Return the largest distance of two markers, or the path of a single one, in their unit."""
    largest = 0.0
    for table in tables:
        places = [
            np.column_stack([table.numbers(c) for c in m.columns[:3]])
            for m in recipe.markers or ()
            if table.holds(*m.columns)
        ]
        if places:
            stacked = np.stack(places, axis=1)[:: max(len(table) // FRAMES_MAX, 1)]
            places = list(without_unseen(stacked, None, FAR)[0].swapaxes(0, 1))
        for i, one in enumerate(places):
            for other in places[i + 1 :]:
                apart = np.linalg.norm(one - other, axis=1)
                if np.isfinite(apart).any():
                    largest = max(largest, float(np.nanpercentile(apart, 95)))
        if len(places) == 1:
            low, high = np.nanpercentile(places[0], [2, 98], axis=0)
            largest = float((high - low).max())
    return largest
