"""Convert tables to a data set in the robot's frame, with every choice and exclusion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError, Progress, listener, refusal
from ..common.words import listed, listing, mm
from ..data import DataSet, Marker
from ..data.still_segments import Segment, frame_noise, rows_of, segments_dataset
from ..data.visits import split_by_order
from ..effects import CatalogueLike, load_catalogue
from ..inference.crossval import predict
from ..inference.noise import input_effect, input_slopes
from ..inference.predict import Predictor
from ..robot import RobotLike, load_robot
from ..robot.estimates import TRACKER_NOISE_M
from .columns import RawTable, flag_columns, marker_label, table_of
from .imported import ImportedTable
from .markers import AS_GIVEN, MarkerOrder, order_markers, place_warnings
from .measuring import FROM_STRAIGHT, SEQUENCE, VISITS, StillMeasurements
from .reading import read_tables, widened
from .recipe import FrameChoice, MarkerColumns, Recipe, Selection, Stillness, as_recipe
from .registration import Placed, offset_warnings, rotation_vector, up_that_fits
from .traces import follow_renumbered, make_traces


def import_table(
    source: Any = (),
    robot: RobotLike | None = None,
    recipe: Recipe | Mapping[str, Any] | str | Path | None = None,
    catalogue: CatalogueLike | None = None,
    progress: Progress | None = None,
) -> ImportedTable:
    """
    Make a data set of a laboratory's tables.

    Parameters
    ----------
    source : path, DataFrame, or sequence of these
        .csv, .parquet or .c3d: recordings one after the other, or one of inputs and one of
        markers for each. By default those that the recipe names.
    robot : Robot, name, path, text or dict, optional
        By default the one that the recipe names.
    recipe : Recipe, mapping, or path of an import.yaml, optional
        What is not to be guessed; the mapping has the keys of the file (docs/import_table.md).
    catalogue : Catalogue or paths, optional
        Of effects, where the description has one of your own.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    DataSetError, InputError
        With file and row where there are some, what is wrong, and what to do.
    MissingExtraError
        pandas (or what a format needs) is not installed.

    """
    show = listener(progress)
    recipe = as_recipe(recipe)
    named = recipe.robot if robot is None else robot
    if named is None:
        remedy = 'describe the arm with `robot new`, then say --robot arm.yaml'
        raise DataSetError('robot', 'none is named', remedy)
    robot = load_robot(named)
    show('reading the tables', 0, 4)
    tables = _tables(source, recipe)
    is_up_given = recipe.up is not None
    ups = {table.up for table in tables} - {None}  # of the files, where their format has one
    if not is_up_given and len(ups) == 1:
        recipe = replace(recipe, up=ups.pop())
    chosen = Selection(tables, robot, recipe)
    columns = {use.column for use in (chosen.recipe.inputs or {}).values()}
    columns |= {c for marker in chosen.recipe.markers or () for c in marker.columns}
    # parts of a file without any column in use are excluded
    used = [t for t in tables if not t.part or columns & t.columns.keys()]
    show('looking where the arm stood still', 1, 4)
    follow_renumbered(used, chosen)
    measured = StillMeasurements(make_traces(used, chosen), chosen)
    places = [marker.arc_length for marker in chosen.recipe.markers or ()]
    if None in places or not places:
        positions = np.array([one.positions for one in measured.segments])
        order = order_markers(positions, robot, chosen.recipe.places or (), tables[0].name)
    else:  # the recipe gives their arc lengths
        arc_lengths = tuple(place for place in places if place is not None)
        order = MarkerOrder(tuple(range(len(places))), arc_lengths, AS_GIVEN)
    raw, markers = _in_tracker_frame(measured, chosen, order)
    show('laying the frame of the tracker', 2, 4)
    catalogue = load_catalogue(catalogue)
    up_assumed: list[str] = []
    if not is_up_given:
        up, up_assumed = up_that_fits(Predictor(raw, robot, catalogue), chosen.recipe)
        chosen.recipe = replace(chosen.recipe, up=up)
    placed = Placed(raw, chosen.recipe, catalogue)
    final, frame = placed.dataset, placed.frame
    show('comparing with the model', 3, 4)
    predictor, predicted = predict(final, final.robot, catalogue)
    if final.path == FROM_STRAIGHT and not final.trials.all():
        # no other posture was reached from one whose trials are all left out
        kept = np.flatnonzero(final.trials)
        final, predicted = final.select(final.postures[p] for p in kept), predicted[kept]
    sizes = [f'{t.name} ({len(t):,} rows of {len(t.columns)} columns)' for t in tables]
    return ImportedTable(
        dataset=final,
        recipe=_written_out(chosen, markers, measured, placed),
        taken=chosen,
        measured=measured,
        order=order,
        frame=frame,
        source=', '.join(sizes),
        predicted=predicted,
        dropped=(*_columns_dropped(chosen), *measured.dropped, *placed.dropped),
        assumed=(
            *chosen.assumed,
            *measured.assumed,
            *up_assumed,
            *_markers_assumed(order, chosen),
        ),
        look=(
            *chosen.warnings,
            *_history_warnings(placed, measured, order, predictor),
            *placed.warnings,
            *place_warnings(final),
            *(() if placed.frame_warnings else offset_warnings(final, predicted, catalogue)),
        ),
    )


def _written_out(
    chosen: Selection,
    markers: tuple[MarkerColumns, ...],
    measured: StillMeasurements,
    placed: Placed,
) -> Recipe:
    """Return the recipe with every choice, so that it reproduces this import without guesses."""
    recipe, frame, rule = chosen.recipe, placed.frame, measured.rule
    x, y, z = frame.shift.tolist()
    return replace(
        recipe,
        sources=tuple(t.name for t in chosen.tables),
        markers=markers,
        points=None,
        places=None,
        offset=None,
        still=Stillness(rule.speed, rule.duration, rule.change) if recipe.time else Stillness(),
        same=measured.same,
        rest=measured.rest,
        delay=measured.delays or None,
        drift=measured.drifts if any(measured.drifts) else None,
        frame=FrameChoice(frame.method, rotation_vector(frame.rotation), (x, y, z)),
        leave_out=placed.left_out,
    )


def _tables(source: Any, recipe: Recipe) -> list[RawTable]:
    given = source if isinstance(source, list | tuple) else [source]
    if not all(isinstance(one, str | Path) or hasattr(one, 'columns') for one in given):
        raise refusal('tables', 'the path of a table, a DataFrame, or a list of these', source)
    sources = list(given) or list(recipe.sources)
    if not sources:
        raise DataSetError('tables', 'none is named', 'name a .csv, .parquet or .c3d file')
    tables: list[RawTable] = []
    for one in sources:
        read = read_tables(one) if isinstance(one, str | Path) else [table_of('DataFrame', one)]
        tables += map(widened, read)
    return tables


def _in_tracker_frame(
    measured: StillMeasurements, chosen: Selection, order: MarkerOrder
) -> tuple[DataSet, tuple[MarkerColumns, ...]]:
    """Assemble the segments to a data set; positions stay in the tracker's frame."""
    known = chosen.recipe.markers or ()
    markers = []
    for i, (j, arc_length) in enumerate(zip(order.members, order.arc_lengths, strict=True)):
        label, offset = known[j].name or str(i + 1), chosen.recipe.offset or known[j].offset
        markers.append(replace(known[j], name=label, arc_length=arc_length, offset=offset))
    placed = tuple(
        Marker(m.name or '', m.arc_length or 0.0, m.offset or (0.0, 0.0, 0.0)) for m in markers
    )
    members = list(order.members)
    segments = [
        replace(one, positions=one.positions[members], orientations=one.orientations[members])
        for one in measured.segments
    ]
    path = SEQUENCE if chosen.recipe.path == VISITS else chosen.recipe.path
    name, kind, robot = chosen.tables[0].name, chosen.kind, chosen.robot
    dataset = segments_dataset(name, segments, robot, placed, input=kind, path=path)
    if chosen.recipe.path == VISITS:
        dataset = as_visits(dataset, segments, measured.begins)
    return dataset, tuple(markers)


def _columns_dropped(chosen: Selection) -> list[str]:
    markers = [point for marker in chosen.recipe.markers or () for point in marker.parts[0]]
    flags = {name.column for t in chosen.tables for name, _, _ in flag_columns(t, markers)}
    names = [column for column in chosen.unused if column not in flags]
    lines = [f'no markers: {points}' for points in chosen.aside]
    if count := len(chosen.nameless):
        lines.append(f'no markers: {count} points without a name (unlabeled)')
    return [*lines, f'{len(names)} columns: {listing(names)}'] if names else lines


def _markers_assumed(order: MarkerOrder, chosen: Selection) -> list[str]:
    lines = [] if order.reason == AS_GIVEN else [order.reason]
    labels = [marker_label(marker.columns) for marker in chosen.recipe.markers or ()]
    for members, why in (
        (order.off_arm, 'below the base, not on the arm'),
        (order.twice, 'at the place of another marker, left out'),
        (order.unseen, 'not seen while the arm stood still, left out'),
    ):
        lines += [f'{listed(labels[j] for j in members)}: {why}'] if members else []
    return lines


def _history_warnings(
    placed: Placed, measured: StillMeasurements, order: MarkerOrder, predictor: Predictor
) -> list[str]:
    """Return contradictions of the assumed history, that is the posture before each posture."""
    dataset, lines = placed.dataset, [*measured.warnings]
    # no history has two trials: only the noise between frames is known
    alone = dataset.position_noise is not None and dataset.trials.max(initial=0) <= 1
    if alone and dataset.path != FROM_STRAIGHT:
        lines.append(
            'no posture was repeated the same way: the noise, '
            f"{mm(dataset.position_noise, 2)}, is that of the tracker's frames alone, and trials "
            'differ by more; say position_noise in dataset.yaml, or measure rounds'
        )
    is_timed = measured.pieces[0].motion is not None
    if dataset.path != FROM_STRAIGHT or measured.rest or not is_timed:
        return lines
    segments = measured.segments
    places = np.array([one.positions[list(order.members)] for one in segments])
    if not path_dependence(segments, measured.begins, places):
        return lines
    # in the tracker's frame
    shift = input_effect(dataset, input_slopes(predictor, {})) @ placed.frame.rotation
    places = places - shift[rows_of(segments, dataset.postures, dataset.trial_names)]
    return [*lines, *path_dependence(segments, measured.begins, places)]


def path_dependence(
    segments: Sequence[Segment], begins: Sequence[int], places: Floats
) -> list[str]:
    """
    Return a line if trials of a posture differ with the posture before it.

    Parameters
    ----------
    segments : sequence of Segment
        Named by posture, in order.
    begins : sequence of int
        Which of them are the first of a recording.
    places : (N, J, 3) [m]
        Their markers, in any frame.

    """
    origins = ['', *(one.posture for one in segments[:-1])]
    known = [i for i in range(len(segments)) if i not in begins]
    apart: dict[bool, list[float]] = {True: [], False: []}
    for j, i in combinations(known, 2):
        if segments[i].posture == segments[j].posture:
            squares = np.sum((places[i] - places[j]) ** 2, axis=1)
            if np.isfinite(squares).any():
                apart[origins[i] == origins[j]].append(float(np.nanmax(squares)))
    if not apart[False]:
        return []
    other = float(np.sqrt(np.median(apart[False])))
    same = float(np.sqrt(np.median(apart[True]))) if apart[True] else 0.0
    if other < max(TRACKER_NOISE_M, 2.0 * same):
        return []
    beside = f', {mm(same)} where from the same one' if apart[True] else ''
    remedy = (
        'say --path visits'
        if apart[True]
        else 'but no posture was reached twice the same way, so that nothing would tell the noise '
        'of visits: measure rounds in the same order, or let it rest between'
    )
    return [
        f'trials of one posture are {mm(other)} apart where the arm came from different ones'
        f'{beside}, their inputs taken into account: the way counts; {remedy}'
    ]


def as_visits(dataset: DataSet, segments: Sequence[Segment], begins: Sequence[int]) -> DataSet:
    """
    Split the postures of a data set by the posture before, as visits in their order.

    Parameters
    ----------
    dataset : DataSet
        Of these segments: a posture per command, a trial per visit to it.
    segments, begins
        As of `path_dependence`; the arm was straight before the first segment of every recording.

    """
    commands, trials = rows_of(segments, dataset.postures, dataset.trial_names)
    fresh = np.isin(np.arange(len(segments)), begins)
    measured = dataset.trial_mask[commands, trials]
    split = split_by_order(dataset.postures, commands, trials, measured, fresh)
    divided = dataset.by_origin(split, trials)
    if dataset.position_noise is None and divided.trials.max(initial=0) < 2:
        return replace(divided, position_noise=frame_noise(segments))
    return divided
