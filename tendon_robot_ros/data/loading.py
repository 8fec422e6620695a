"""
Measurements however they are named: a folder, a recording, an object, or several of these.

Of a recording every still segment is a measurement.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats, Ints
from ..common.errors import DataSetError, place, refusal
from ..common.files import shared_file, write_picture
from ..common.local_stop import SILENCE_S
from ..common.words import listing
from ..robot import Robot, RobotLike, load_robot, parse_robot
from .arrays import PLAUSIBLE_FACTOR, Marker, default_markers, too_tense
from .bag_reader import Recording, Topics, is_bag, read_bag, refuse_two_senders, with_markers
from .bag_writer import DESCRIPTION, ROBOT
from .dataset import EXPECTED, LIMITS, DataSet, HasDataSet, Part, as_dataset, extent
from .folder import describe, read_fields, read_folder
from .still_segments import ArmMotion, Rule, Segment, find_segments, never_still, segments_dataset
from .tracker_faults import undo_exchanges, undo_renumbering, without_unseen_readings
from .visits import join_visits


@dataclass(frozen=True)
class Imported:
    """A data set, and the segments of the recording that it is made of."""

    dataset: DataSet
    segments: tuple[Segment, ...]
    motion: ArmMotion
    recording: Recording
    rule: Rule
    left_out: tuple[str, ...]  # one line about each measurement or reading that was not used


def import_bag(
    bag: str | Path,
    robot: RobotLike | None = None,
    rule: Rule | None = None,
    topics: Topics | None = None,
    description: str | None = None,
    rest: float | None = None,
    in_tracker_frame: bool = False,
) -> Imported:
    """
    Make a data set from a recording.

    Segments in which all inputs are the same within the rule's change are trials of one posture;
    in a sequence every segment is a posture of its own. Where the recording says which posture
    and trial a measurement is, as `export_bag` does, that holds.

    Parameters
    ----------
    bag : str or Path
        A rosbag2 folder, or a single .mcap or .db3 file.
    robot : Robot, name, path, text or dict, optional
        By default the one that the recording holds.
    rule : Rule, optional
        When the arm counts as still.
    topics : Topics, optional
        Where the recording holds what.
    description : str, optional
        Text of a dataset.yaml, for example with the markers; by default the recording's.
    rest : float, optional
        [N] or [m] segments whose inputs all stay below are no measurements but the rest between.
    in_tracker_frame : bool
        Positions may stay in a frame of which the recording does not say where the base is in it;
        else that is refused.

    Raises
    ------
    DataSetError
        It is no recording, something in it is missing, or the arm never stands still.
    MissingExtraError
        The package rosbags is not installed.

    """
    topics = topics or Topics()
    recording = read_bag(bag, topics)
    if robot is None and recording.robot is None:
        problem, remedy = 'it holds no robot description', 'name one with --robot robot.yaml'
        raise DataSetError(recording.name, problem, remedy)
    if robot is None:
        robot = parse_robot(recording.robot or '', f'{recording.name}: {ROBOT}')
    robot = load_robot(robot)
    described = _describe(recording, robot, description)
    listed, kind = described.pop('markers'), described['input']
    expected = listed or default_markers(robot)
    recording = with_markers(recording, topics, [one.name for one in expected])
    if not in_tracker_frame and not recording.in_base:
        unplaced = 'no transform in it says where the base is'
        problem = f'markers are in the frame {recording.frame!r}, and {unplaced}'
        remedy = 'take it in with `import bag`, which finds where it lies (--frame base: the base)'
        raise DataSetError(recording.name, problem, remedy)
    recording, renumbered = undo_renumbering(recording, len(expected))
    markers = _markers(recording, robot, listed)
    recording = replace(recording, inputs=_inputs(recording, robot, kind))
    names = [marker.name for marker in markers]
    recording, unseen = without_unseen_readings(recording, robot.length, names)
    refuse_two_senders(recording)
    recording, exchanged = undo_exchanges(recording)
    recording, unheard = _while_states_come(recording)
    rule = (rule or Rule()).fill(robot, kind)
    speeds = ArmMotion.of(recording, rule)
    segments, excluded = find_segments(recording, speeds, rule, described['path'] == 'sequence')
    if not any(np.isfinite(one.positions).any() for one in segments):
        times = [track.times for track in recording.tracks]
        raise never_still(recording.name, [speeds], times, rule)
    if rest is not None:
        segments = [one for one in segments if (np.nan_to_num(one.inputs) >= rest).any()]
        if not segments:
            problem = f'wherever the arm stands still all inputs are below {rest:g}: at rest'
            raise DataSetError(recording.name, problem, 'lower what counts as rest')
    places = np.array([one.positions for one in segments])
    if not recording.in_base:  # of a tracker's frame only how far they spread
        places = places - np.nanmedian(places, axis=(0, 1))
    far = float(np.nan_to_num(np.abs(places)).max())
    if far > PLAUSIBLE_FACTOR * robot.length:
        problem = f'a marker is {far:g} m away, but the robot is only {robot.length:g} m long'
        remedy = 'record metres in the base frame (are these mm?)'
        raise DataSetError(recording.name, problem, remedy)
    segments = plausible_inputs(recording.name, segments, robot, kind, rule)
    dataset = segments_dataset(recording.name, segments, robot, markers, **described)
    left_out = (*renumbered, *exchanged, *unseen, *unheard, *excluded)
    return Imported(dataset, tuple(segments), speeds, recording, rule, left_out)


def _while_states_come(recording: Recording) -> tuple[Recording, list[str]]:
    """Exclude the markers while no tendon state comes: nothing tells what the inputs are."""
    intervals = np.diff(recording.state_times)
    # drivers publish many states a second; of slower ones three of their intervals
    age_max = max(SILENCE_S, 3.0 * float(np.median(intervals))) if len(intervals) else np.inf
    tracks, count = [], 0
    for track in recording.tracks:
        last = np.searchsorted(recording.state_times, track.times + 1e-9) - 1
        old = (last >= 0) & (track.times - recording.state_times[last] > age_max)
        positions = np.where(old[:, None, None], np.nan, track.positions)
        tracks.append(replace(track, positions=positions))
        count += int(np.isfinite(track.positions[old, :, 0]).sum())
    told = f'{count:,} marker readings: no tendon state came for {age_max:.2g} s before them'
    return replace(recording, tracks=tuple(tracks)), [told] if count else []


def _describe(recording: Recording, robot: Robot, text: str | None) -> dict[str, Any]:
    source = 'description' if text is not None else f'{recording.name}: {DESCRIPTION}'
    text = recording.description if text is None else text
    fields = read_fields(text or '', source)
    described = describe(fields, robot)
    if not fields.has('input'):  # a driver that observes no tension gives NaN
        observed = np.isfinite(recording.states_of(robot.inputs, 'tension')).any()
        described['input'] = 'tension' if observed else 'displacement'
    return described


def _markers(
    recording: Recording, robot: Robot, listed: tuple[Marker, ...] | None
) -> tuple[Marker, ...]:
    """Return the marker of every pose, in the order of the recording."""
    markers = listed or default_markers(robot)
    names = recording.marker_names
    if not names:
        count = recording.tracks[0].positions.shape[1]
        if count != len(markers):
            problem = f'the shape has {count} poses, but there are {len(markers)} markers'
            remedy = 'list the markers in a dataset.yaml and name it with --description'
            raise DataSetError(recording.name, problem, remedy)
        return markers
    known = {marker.name: marker for marker in markers}
    if listed is None:
        known.setdefault('tip', Marker('tip', robot.length))
    for name in names:
        if name not in known:
            problem = f'no marker {name!r} is described; known: {listing(known)}'
            remedy = 'list it in a dataset.yaml and name that with --description'
            raise DataSetError(recording.name, problem, remedy)
    return tuple(known[name] for name in names)


def _inputs(recording: Recording, robot: Robot, kind: str) -> Floats:
    inputs = recording.states_of(robot.inputs, kind)
    listed = {name for state in recording.states for name in state.name}
    for name, column in zip(robot.inputs, inputs.T, strict=True):
        if name not in listed:
            others = listing(sorted(listed))
            problem = f'the tendon states do not name {name!r}; they name {others}'
            remedy = 'use the robot description of the robot that was recorded'
            raise DataSetError(recording.name, problem, remedy)
        if kind == 'tension' and not np.isfinite(column).any():
            problem = f'the tension of {name!r} was not observed (effort is empty or NaN)'
            remedy = 'say input: displacement in a dataset.yaml and name it with --description'
            raise DataSetError(recording.name, problem, remedy)
    return inputs


def plausible_inputs(
    bag: str, segments: list[Segment], robot: Robot, kind: str, rule: Rule
) -> list[Segment]:
    """
    Return the segments; what a load cell shows below zero at rest is zero.

    Raises
    ------
    DataSetError
        An input is beyond what the robot description has, or a tension pushes.

    """
    inputs = np.nan_to_num([one.inputs for one in segments])
    if kind == 'tension':
        limit, margin = robot.tension_limits[1], rule.change or 0.0
        if inputs.max() > PLAUSIBLE_FACTOR * limit:
            raise DataSetError(bag, *too_tense('a tendon', float(inputs.max()), limit))
        if inputs.min() < -margin:
            problem = f'a tendon is {inputs.min():g} N, but a tendon cannot push'
            remedy = f'zero its load cell at rest, to within {margin:g} N, or turn its sign around'
            raise DataSetError(bag, problem, remedy)
        return [replace(one, inputs=np.maximum(one.inputs, 0.0)) for one in segments]
    for value in (inputs.min(), inputs.max()):
        if abs(value) > robot.length:
            long = f'the robot is only {robot.length:g} m long'
            problem = f'a wire is pulled by {value:g} m, but {long}'
            raise DataSetError(bag, problem, 'give metres (are these mm?)')
    return segments


PICTURE_WIDTH_MAX_IN = 40.0  # [inch] so that viewers open it
NAME_WIDTH_IN = 0.22  # [inch] of a segment, so that names of neighbours do not overlap


def draw_segments(imported: Imported, path: str | Path) -> Path:
    """
    Draw speed and inputs over time with the segments that became measurements.

    Parameters
    ----------
    imported : Imported
        What `import_bag` returned.
    path : str or Path
        Where the picture goes; the ending says the format: .png, .svg or .pdf.

    Raises
    ------
    DataSetError
        Nothing can be written there.

    """
    from matplotlib.figure import Figure

    names_width = NAME_WIDTH_IN * len(imported.segments)
    width = min(max(8.0, names_width), PICTURE_WIDTH_MAX_IN)
    figure = Figure(figsize=(width, 5.5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    moved, limit = imported.motion, 1e3 * imported.rule.speed
    speed = np.where(np.isfinite(moved.speed), 1e3 * moved.speed, np.nan)
    above.semilogy(moved.times, np.maximum(speed, limit / 100), color='tab:blue', linewidth=0.8)
    rule = f'{limit:g} mm/s for {imported.rule.duration:g} s counts as still'
    above.axhline(limit, color='tab:red', linestyle='--', linewidth=0.8, label=rule)
    above.set_ylabel('speed [mm/s]')
    data = imported.dataset
    style: dict[str, Any] = {'rotation': 90, 'ha': 'center', 'va': 'bottom', 'fontsize': 'x-small'}
    for one in imported.segments if names_width <= PICTURE_WIDTH_MAX_IN else ():
        name = one.posture if len(data.trial_names) == 1 else f'{one.posture}, {one.trial}'
        middle = (one.begin + one.end) / 2
        above.text(middle, 1.01, name, transform=above.get_xaxis_transform(), **style)
    scale, label = (1.0, 'tension [N]') if data.input == 'tension' else (1e3, 'wire pull [mm]')
    for name, values in zip(data.input_names, imported.recording.inputs.T, strict=True):
        below.plot(imported.recording.state_times, scale * values, linewidth=0.9, label=name)
    below.set_ylabel(label)
    below.set_xlabel('time [s]')
    for axes in (above, below):
        for one in imported.segments:
            axes.axvspan(one.begin, one.end, color='tab:green', alpha=0.25, linewidth=0)
        axes.spines[['top', 'right']].set_visible(False)
    figure.legend(loc='outside lower right', ncols=6, fontsize='small')
    figure.suptitle(summary(imported), x=0.01, ha='left', fontsize='large')
    return write_picture(figure, path, 110)


def summary(imported: Imported) -> str:
    """Summarise the import in one line."""
    dataset = imported.dataset
    size = extent(dataset.trials, dataset.inputs, len(dataset.markers))
    return f'{len(imported.segments)} still segments: {size}'


DataSetLike = DataSet | HasDataSet | str | Path | Sequence['DataSet | HasDataSet | str | Path']


def load_dataset(data: DataSetLike, robot: RobotLike | None = None) -> DataSet:
    """
    Read and check measurements; nothing in their files is ever executed.

    Parameters
    ----------
    data : path, DataSet, or a list of these
        A folder with dataset.yaml, inputs.csv and shapes.csv; a recording (rosbag2 folder, .mcap
        or .db3), of which every still segment is a measurement; a data set or an import as it
        is. Several of one robot are joined. `data/...` that is not here is that of the package.
    robot : Robot, name, path, text or dict, optional
        The robot to use instead of the one that the measurements name.

    Raises
    ------
    DataSetError, InputError
        With file, row, what is wrong and what to do.
    RobotDescriptionError
        The robot description is not valid.

    """
    other = None if robot is None else load_robot(robot)
    if isinstance(data, str | os.PathLike):
        path = place('data', data)
        if path.parts[:1] == ('data',) and not path.exists():
            path = shared_file(str(path)) or path
        return import_bag(path, other).dataset if is_bag(path) else read_folder(path, other)
    if isinstance(data, list | tuple) and data:
        return join([load_dataset(one, other) for one in data])
    dataset = as_dataset(data)
    if other is None:
        return dataset
    if other.inputs != dataset.robot.inputs:
        own, given = (', '.join(one.inputs) for one in (dataset.robot, other))
        problem = f'has the inputs {own}, not {given} of {other.name}'
        raise DataSetError(dataset.name, problem, 'name the robot that was measured')
    return replace(dataset, robot=other)


ALIKE = ('markers', 'input', 'path', 'input_names')  # what data sets must have in common


def join(datasets: Sequence[DataSetLike]) -> DataSet:
    """
    Return the postures of several data sets as one data set.

    Each posture keeps the gravity and the `known` effects of its data set; of declared noises the
    largest holds. Postures are named `data set/posture`.

    Parameters
    ----------
    datasets : list of DataSet or path
        As `load_dataset` takes each.

    Raises
    ------
    DataSetError
        They differ in robot, markers, inputs, or in how the arm was loaded.

    """
    if not isinstance(datasets, list | tuple) or not datasets:
        raise refusal('data', f'a list, each {EXPECTED}', datasets)
    sets = [load_dataset(one) for one in datasets]
    first = sets[0]
    if len(sets) == 1:
        return first
    _refuse_unlike(sets)
    names = [dataset.name.rstrip('/').rpartition('/')[2] for dataset in sets]
    if len(set(names)) < len(names):  # the last parts of two folders are the same
        names = [dataset.name for dataset in sets]
    if len(set(names)) < len(names):  # of objects even these, 'arrays' for example
        names = [f'{name} no {i}' for i, name in enumerate(names, 1)]
    parts: list[Part] = []
    part: list[Ints] = []  # index of the part of every posture
    for name, dataset in zip(names, sets, strict=True):
        part.append(np.zeros(len(dataset.postures), dtype=np.int64))
        for one, rows in dataset.divided:
            part[-1][rows] = len(parts)
            parts.append(one if dataset.parts else replace(one, name=name))
    trials = max((d.trial_names for d in sets), key=len)
    visits = [dataset.visits for dataset in sets if dataset.visits is not None]
    noises: dict[str, Any] = {
        key: max((n for d in sets if (n := getattr(d, key)) is not None), default=None)
        for key in LIMITS
    }
    turned = [d.orientations for d in sets if d.orientations is not None]
    by_trial = any(dataset.trial_inputs is not None for dataset in sets)
    pairs = zip(names, sets, strict=True)
    return replace(
        first,
        name=shlex.join(dataset.name for dataset in sets),
        postures=tuple(f'{name}/{posture}' for name, d in pairs for posture in d.postures),
        inputs=np.concatenate([d.inputs for d in sets]),
        positions=stacked([d.positions for d in sets], len(trials)),
        orientations=stacked(turned, len(trials)) if len(turned) == len(sets) else None,
        trial_inputs=stacked([d.inputs_by_trial for d in sets], len(trials)) if by_trial else None,
        trial_names=trials,
        gravity=next((d.gravity for d in sets if d.gravity is not None), None),
        known={},
        parts=tuple(parts),
        part=np.concatenate(part),
        visits=join_visits(visits) if visits else None,
        **noises,
    )


def _refuse_unlike(sets: Sequence[DataSet]) -> None:
    """Raise DataSetError where data sets do not belong together."""
    first = sets[0]
    for other in sets[1:]:
        for key in ALIKE:
            if getattr(first, key) != getattr(other, key):
                remedy = f'data sets that are used together have the same {", ".join(ALIKE)}'
                raise DataSetError(other.name, f'has other {key} than {first.name}', remedy)
        ours, theirs = (replace(d.robot, source='', fitted={}) for d in (first, other))
        if ours != theirs:
            problem = f'has another robot description than {first.name}'
            raise DataSetError(other.name, problem, 'name the one that holds for all with --robot')
    for one in sets:
        if one.reference is not None:
            problem = f'the deviations of {one.reference.name} are taken off it'
            raise DataSetError(one.name, problem, 'join before an earlier recording is taken off')


def stacked(arrays: Sequence[Floats], trials: int) -> Floats:
    """Join arrays (P, Q, ...) of postures, each padded with NaN to the same number of trials."""
    shapes = [(len(array), trials - array.shape[1], *array.shape[2:]) for array in arrays]
    lacking = [np.full(shape, np.nan) for shape in shapes]
    return np.concatenate([np.hstack(pair) for pair in zip(arrays, lacking, strict=True)])
