"""
Diagnose all recordings and data sets below a folder, and say what changed when, robot by robot.

Robots are told apart by the name in their descriptions. When something was measured is told by a
date in its name (2026-03-14, 20260314), else by the recording itself, else by its files.
OUTPUT holds the table (Parquet) and fleet.html; what stands in the table is not diagnosed again
by the same code and libraries, so that the same command adds what has come since.

example: python -m tendon_robot_ros study fleet data/hinge_friction --output history
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..cli.options import add_cluster, declare, emit, progress
from ..common.colours import BEFORE, FLOOR, PREDICTED
from ..common.errors import InputError, TendonRobotError
from ..common.words import columns, counted, digits, grouped, listed, mm, scale_of
from ..common.workers import Workers
from ..common.yaml_reading import parse_yaml
from ..data import DataSet, load_dataset
from ..data.folder import described_robot
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import CandidateRow, Diagnosis, EffectFinding
from ..inference.intervals import Value
from ..model.versions import Preparation, UserEffect, catalogue_of, versions
from ..report.page import Figure, Page, axes, error_bars, mm_list, plain, titled, trace
from ..robot import dump_robot
from .judge import diagnosis_fields, fitted_values
from .running import ERROR, TABLE, GrowingTable, Row, Study, judge_all

HELP = 'diagnose all recordings of many robots, and say what changed when'
PAGE = 'fleet.html'
DATED = re.compile(r'(?<!\d)(20\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)(?!\d)')
# [1] error of the description over that of the recording before, from which it is said; smaller
# ratios come by chance, with a dozen postures
WORSE_FACTOR = 1.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('folder', metavar='DIR', help='with data sets and recordings below it')
    add('--output', metavar='DIR', required=True, help='folder of the table and the page')
    add_cluster(parser)
    declare(parser, '--json', '--effect-file')


def run(args: argparse.Namespace) -> None:
    """Diagnose what is new, print, write."""
    folder, output = Path(args.folder), Path(args.output)
    places, inside = datasets_below(folder), output.resolve()
    study = Fleet(question='fleet', effects=UserEffect.read(args.effect_file))
    below = [place for place in places if inside not in place.resolve().parents]
    cases = [FleetCase.of(place, folder, {**versions(study.effects)}) for place in below]
    prepare = Preparation.of_this_process(study.effects)
    with Workers(args.workers, args.cluster, prepare) as workers, progress(True) as show:
        table = GrowingTable(output / TABLE, FleetRow)
        rows = judge_all(study, cases, table, workers, show, 'recordings')
    rows.sort(key=lambda row: (row.robot, row.when, row.place))
    page = fleet_page(rows, f'Fleet: {folder.resolve().name}').write(output / PAGE)
    content = {'recordings': [asdict(row) for row in rows], 'changes': changes(rows)}
    left_out = [f'left out: {line}' for line in problems(rows)]
    text = [columns(fleet_rows(rows)), *change_lines(rows), *left_out]
    emit(args, content, '\n'.join([*text, f'written: {output}/table, {page}']))


@dataclass(frozen=True, kw_only=True)
class FleetRow(Row):
    """The diagnosis of a recording or data set; `parameter`: of every effect fitted alone."""

    place: str  # below the folder of all
    when: str  # ISO 8601
    dated_by: str  # 'name', 'recording' or 'file'
    description: str = ''  # digest of what its owner wrote down
    postures: int = 0
    trials: int = 0
    markers: int = 0
    remainder: str = ''
    unit: tuple[str, ...] = ()  # of the parameters

    def fitted(self, name: str) -> tuple[float, float, float] | None:
        """Return the value of a parameter with its 95 % interval, where it was fitted."""
        if name not in self.parameter:
            return None
        i = self.parameter.index(name)
        return self.value[i], self.low[i], self.high[i]


@dataclass(frozen=True)
class FleetCase:
    """A recording or data set to diagnose."""

    path: Path  # absolute
    place: str  # below the folder of all
    key: str  # its place, and a digest of versions and of size and time of its files

    @classmethod
    def of(cls, path: Path, folder: Path, judge: object = ()) -> FleetCase:
        """Return the case of a path below a folder; `judge`: by which versions it is judged."""
        files = sorted(path.rglob('*')) if path.is_dir() else [path]
        with suppress(TendonRobotError):  # a recording, or what cannot be read
            robot = Path(described_robot(path).source)  # it may lie elsewhere
            files += [robot] if robot not in files else []
        stamps = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files]
        digest = hashlib.sha256(repr((judge, stamps)).encode()).hexdigest()[:12]
        place = str(path.relative_to(folder))
        return cls(path.resolve(), place, f'{place}:{digest}')


class Fleet(Study[FleetCase, FleetRow]):
    """What is needed to diagnose recordings: a study."""

    def result(self, case: FleetCase) -> dict[str, Any]:
        """Read and diagnose a recording or data set."""
        try:
            dataset = load_dataset(case.path)
            return fields_of(dataset, diagnose(dataset, catalogue=catalogue_of(self.effects)))
        except TendonRobotError as error:  # a sentence for its user
            return {'verdict': ERROR, 'problem': ' '.join(str(error).split())}

    def row(self, case: FleetCase, result: Mapping[str, Any]) -> FleetRow:
        """Return the row of a recording."""
        when, dated_by = when_of(case.path, 1 + len(Path(case.place).parts))
        told = {'robot': 'not read', 'when': when, 'dated_by': dated_by, **result}
        return FleetRow(key=case.key, place=case.place, **told)


def fields_of(dataset: DataSet, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what a row holds of a data set and its diagnosis."""
    fitted: dict[str, Value] = {}
    candidates: list[CandidateRow | EffectFinding] = [*diagnosis.candidates, *diagnosis.effects]
    for candidate in candidates:  # what was named beside others counts last
        if ' + ' not in candidate.name:
            for key, value in candidate.parameters.items():
                fitted[f'{candidate.name} {key}'] = value
    sizes = zip(('postures', 'trials', 'markers'), dataset.positions.shape, strict=False)
    return {
        **dict(sizes),
        **diagnosis_fields(diagnosis),
        **fitted_values(fitted),
        'unit': tuple(value.unit for value in fitted.values()),
        'robot': dataset.robot.name,
        'description': hashlib.sha256(dump_robot(dataset.robot).encode()).hexdigest()[:8],
        'remainder': diagnosis.remainder,
    }


def datasets_below(folder: Path) -> list[Path]:
    """
    List the data sets and recordings below a folder.

    Raises
    ------
    InputError
        There are none.

    """
    if not folder.is_dir():
        raise InputError(f'{folder}: is no folder; name one with recordings or data sets below it')
    places = {path.parent for path in folder.rglob('dataset.yaml')}
    bags = {path.parent for path in folder.rglob('metadata.yaml')}
    loose = {path for ending in ('*.mcap', '*.db3') for path in folder.rglob(ending)}
    places |= bags | {path for path in loose if path.parent not in bags}
    if not places:
        raise InputError(
            f'{folder}: no data set (dataset.yaml) and no recording (.mcap, .db3) below it'
        )
    return sorted(places)


def when_of(path: Path, count: int = 1) -> tuple[str, str]:
    """
    Return the time of a measurement, and its source: the name, the recording, or the file.

    `count` parts of its path are its name, so that a folder far above dates nothing.
    """
    for part in reversed(path.parts[-count:]):
        for year, month, day in DATED.findall(part):
            try:
                return date(int(year), int(month), int(day)).isoformat(), 'name'
            except ValueError:  # a number that is no date
                continue
    try:
        content = parse_yaml((path / 'metadata.yaml').read_text(encoding='utf-8'))
        start = content['rosbag2_bagfile_information']['starting_time']['nanoseconds_since_epoch']
        seconds, dated_by = 1e-9 * float(start), 'recording'
    except (OSError, ValueError, KeyError, TypeError):
        files = [path] if path.is_file() else [p for p in path.iterdir() if p.is_file()]
        seconds, dated_by = max(file.stat().st_mtime for file in files), 'file'
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec='minutes'), dated_by


def histories(rows: Iterable[FleetRow]) -> dict[str, list[FleetRow]]:
    """Collect what could be read by robot, in the order of time."""
    read = (row for row in rows if row.verdict != ERROR)
    return grouped(sorted(read, key=lambda row: (row.when, row.place)), lambda row: row.robot)


def tracked(rows: Sequence[FleetRow]) -> list[str]:
    """Name the parameters of all effects that were ever named of a robot."""
    named = {effect for row in rows for effect in row.effects}
    names = [name for row in rows for name in row.parameter if name.split()[0] in named]
    return list(dict.fromkeys(names))


def changes(rows: Sequence[FleetRow]) -> list[dict[str, str]]:
    """Return what differs from the recording before of the same robot, in the order of time."""
    return [
        {'robot': robot, 'since': old.when, 'when': new.when, 'text': text}
        for robot, own in histories(rows).items()
        for old, new in itertools.pairwise(own)
        for text in differences_of(old, new)
    ]


def differences_of(old: FleetRow, new: FleetRow) -> list[str]:
    """Describe the differences between two recordings of a robot."""
    texts = []
    if old.description != new.description:
        texts.append('another description')
    if (old.verdict, old.effects) != (new.verdict, new.effects):
        texts.append(f'{words_of(old)} before, now {words_of(new)}')
    if old.before and new.before:
        ratio = new.before / old.before
        if not 1.0 / WORSE_FACTOR < ratio < WORSE_FACTOR:
            errors = f'{mm(old.before)} to {mm(new.before)}'
            texts.append(f'the error of the description went from {errors}')
    for name in new.parameter:
        first, then = old.fitted(name), new.fitted(name)
        if first is None or then is None or name.split()[0] not in new.effects:
            continue
        if then[1] > first[2] or then[2] < first[1]:  # it has left its interval
            scale, shown = _scale(new, name, [first, then])
            ends = [
                f'{digits(scale * v)} ({digits(scale * low)} to {digits(scale * high)})'
                for v, low, high in (first, then)
            ]
            texts.append(f'{name}: {ends[0]} before, now {ends[1]} {shown}'.rstrip())
    return texts


def _scale(row: FleetRow, name: str, values: npt.ArrayLike) -> tuple[float, str]:
    """Return the factor and the unit that suit values of a parameter; some may be infinite."""
    unit = row.unit[row.parameter.index(name)]
    sizes = np.abs(np.asarray(values, dtype=float))
    largest = float(sizes[np.isfinite(sizes)].max(initial=0.0))
    return scale_of(unit, largest, name.split()[-1])


def words_of(row: FleetRow) -> str:
    """Describe the verdict of a recording in a few words."""
    names = f': {listed(row.effects)}' if row.effects else ''
    return row.verdict.replace('_', ' ') + names


def fleet_rows(rows: Sequence[FleetRow]) -> list[list[str]]:
    """Return a row per recording that could be read; a time of its files is said to be that."""
    table = [['robot', 'when', 'measurements', 'verdict', 'error', 'with it', 'noise floor']]
    for row in rows:
        if row.verdict != ERROR:
            when = _readable(row.when) + (' (its files)' if row.dated_by == 'file' else '')
            errors = map(mm, (row.before, row.after, row.floor))
            table.append([row.robot, when, row.place, words_of(row), *errors])
    return table


def _readable(when: str) -> str:
    """Show a time (ISO 8601, UTC) without its marks."""
    return when.removesuffix('+00:00').replace('T', ' ')


def change_lines(rows: Sequence[FleetRow]) -> list[str]:
    """Describe the changes, a line each, or say that there are none."""
    lines = [
        f'{c["robot"]}, {_readable(c["when"])} (since {_readable(c["since"])}): {c["text"]}'
        for c in changes(rows)
    ]
    return lines or ['Nothing changed from one recording to the next.']


def problems(rows: Sequence[FleetRow]) -> list[str]:
    """Describe the recordings that could not be read or judged."""
    return [f'{row.place}: {row.problem}' for row in rows if row.verdict == ERROR]


def fleet_page(rows: Sequence[FleetRow], title: str) -> Page:
    """Return the page: what changed, and a history per robot."""
    own = histories(rows)
    recordings = counted(sum(map(len, own.values())), 'recording')
    page = Page(title, f'{recordings} of {counted(len(own), "robot")}')
    page.box(change_lines(rows), 'verdict', 'What changed when')
    if problems(rows):
        page.box(problems(rows), 'warn', 'Left out')
    for robot, history in own.items():
        page.heading(robot)
        page.figures([error_figure(history), *map_parameters(history)], 'two')
        page.table([row[1:] for row in fleet_rows(history)], left=[0, 1, 2])
    return page


def error_figure(history: Sequence[FleetRow]) -> Figure:
    """Draw the errors of a robot's description over time."""
    when = [row.when for row in history]
    kinds = {
        'as described': (BEFORE, [row.before for row in history]),
        'with what was named': (PREDICTED, [row.after for row in history]),
        'noise floor': (FLOOR, [row.floor for row in history]),
    }
    text = [escape(words_of(row)) for row in history]
    data = []
    for name, (colour, errors) in kinds.items():
        y, line = mm_list(np.array(errors, dtype=float)), {'color': colour}
        data.append(trace(when, y, name, 'lines+markers', text=text, line=line))
    layout = axes({'type': 'date'}, titled('error, rms [mm]', rangemode='tozero'))
    return Figure(data, layout, 'Errors over time')


def map_parameters(history: Sequence[FleetRow]) -> list[Figure]:
    """Draw the parameters of all effects ever named of a robot, over time."""
    figures = []
    for name in tracked(history):
        rows = [row for row in history if name in row.parameter]
        known = np.array([row.fitted(name) for row in rows])  # (r, 3) value, low, high
        factor, unit = _scale(rows[0], name, known)
        value, low, high = factor * known.T
        up, down = (plain(np.maximum(side, 0.0)) for side in (high - value, value - low))
        bars = error_bars(up, down)
        when, line = [row.when for row in rows], {'color': PREDICTED}
        data = [trace(when, value.tolist(), '', 'lines+markers', line=line, error_y=bars)]
        layout = axes({'type': 'date'}, f'[{unit or 1}]')
        caption = '95 % intervals, fitted alone or with what was named beside it'
        figures.append(Figure(data, layout, name, caption))
    return figures
