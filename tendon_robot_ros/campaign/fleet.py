"""Recordings and data sets of many robots over time, compared and diagnosed."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np

from ..common.errors import InputError, TendonRobotError
from ..common.given import Progress, listener
from ..common.words import digits, listed, mm, scale_of
from ..common.workers import LostWork, Workers
from ..common.yaml_reading import parse_yaml
from ..data import DataSet, load_dataset
from ..data.recording.importing import import_bag
from ..data.recording.reader import is_bag
from ..diagnosis.decide import Verdict
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import CandidateRow, EffectFinding, Value
from ..robot import dump_robot
from .judge import ERROR
from .table import GrowingTable
from .versions import UserEffect, catalogue_of, compiled_once

TABLE = 'table'
DATED = re.compile(r'(?<!\d)(20\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)(?!\d)')
WORSE_FACTOR = 1.5  # of the error of the description, from one recording to the next, that is said


@dataclass(frozen=True)
class FleetRow:
    """A recording or data set, and what it says."""

    key: str  # its place, and a digest of its files
    place: str  # below the folder of all
    robot: str
    description: str  # digest of what its owner wrote down
    when: str  # ISO 8601
    dated_by: str  # 'name', 'recording' or 'file'
    postures: int
    trials: int
    markers: int
    verdict: str
    effects: tuple[str, ...] = ()
    group: tuple[str, ...] = ()  # that cannot be told apart
    before: float | None = None  # [m] error of the description
    after: float | None = None  # [m] with the effects
    floor: float | None = None  # [m]
    remainder: str = ''
    problem: str = ''
    parameter: tuple[str, ...] = ()  # 'effect parameter', of every effect fitted alone
    unit: tuple[str, ...] = ()
    value: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    def fitted(self, name: str) -> tuple[float, float, float] | None:
        """Return the value of a parameter with its 95 % interval, where it was fitted."""
        if name not in self.parameter:
            return None
        i = self.parameter.index(name)
        return self.value[i], self.low[i], self.high[i]


@dataclass(frozen=True)
class ToDiagnose:
    """A recording or data set to diagnose; goes to a worker."""

    path: str
    place: str
    key: str
    effects: tuple[UserEffect, ...] = field(default=(), repr=False)


def found_below(folder: Path) -> list[Path]:
    """
    List the data sets and recordings below a folder.

    Raises
    ------
    InputError
        There are none.

    """
    if not folder.is_dir():
        raise InputError(f'{folder}: is no folder; name one with recordings or data sets below it')
    found = {path.parent for path in folder.rglob('dataset.yaml')}
    bags = {path.parent for path in folder.rglob('metadata.yaml')}
    loose = {path for ending in ('*.mcap', '*.db3') for path in folder.rglob(ending)}
    found |= bags | {path for path in loose if path.parent not in bags}
    if not found:
        raise InputError(
            f'{folder}: no data set (dataset.yaml) and no recording (.mcap, .db3) below it'
        )
    return sorted(found)


def run_fleet(
    folder: Path,
    output: Path,
    workers: Workers,
    effects: tuple[UserEffect, ...] = (),
    progress: Progress | None = None,
) -> list[FleetRow]:
    """
    Diagnose what is below a folder and not in the table yet.

    Parameters
    ----------
    folder : Path
    output : Path
        Folder of the table.
    workers : Workers
        Have to see the same files.
    effects : tuple of UserEffect
        The user's own.
    progress : callable, optional
        Called with (what, done, total).

    Returns
    -------
    list of FleetRow
        By robot and time.

    """
    show, inside = listener(progress), output.resolve()
    paths = [path for path in found_below(folder) if inside not in path.resolve().parents]
    todo = [
        ToDiagnose(
            str(path.resolve()), str(path.relative_to(folder)), key_of(path, folder), effects
        )
        for path in paths
    ]
    table = GrowingTable(output / TABLE, FleetRow)
    known = table.keys()
    left = [one for one in todo if one.key not in known]
    for done, (index, result) in enumerate(workers.run(judge_measured, left), start=1):
        row = _lost(left[index], result) if isinstance(result, LostWork) else result
        table.append([row])
        show('recordings', done, len(left))
    wanted = {one.key for one in todo}
    rows = [row for row in table.rows() if row.key in wanted]
    return sorted(rows, key=lambda row: (row.robot, row.when, row.place))


def key_of(path: Path, folder: Path) -> str:
    """Name a recording by its place and by size and time of its files."""
    files = sorted(path.rglob('*')) if path.is_dir() else [path]
    told = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    digest = hashlib.sha256(repr(told).encode()).hexdigest()[:12]
    return f'{path.relative_to(folder)}:{digest}'


def when_of(path: Path) -> tuple[str, str]:
    """Return when something was measured, and what says so: its name, the recording, the file."""
    for part in reversed(path.parts):
        for year, month, day in DATED.findall(part):
            try:
                return date(int(year), int(month), int(day)).isoformat(), 'name'
            except ValueError:  # a number that is no date
                continue
    try:
        content = parse_yaml((path / 'metadata.yaml').read_text(encoding='utf-8'))
        start = content['rosbag2_bagfile_information']['starting_time']['nanoseconds_since_epoch']
        return _iso(1e-9 * float(start)), 'recording'
    except (OSError, ValueError, KeyError, TypeError):
        pass
    files = [path] if path.is_file() else [p for p in path.iterdir() if p.is_file()]
    return _iso(max(file.stat().st_mtime for file in files)), 'file'


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec='minutes')


def judge_measured(one: ToDiagnose) -> FleetRow:
    """Read and diagnose a recording or data set, in a worker."""
    path = Path(one.path)
    when, dated_by = when_of(path)
    try:
        dataset = import_bag(path).dataset if is_bag(path) else load_dataset(path)
        with compiled_once('fleet', one.effects):
            return _diagnosed(one, dataset, when, dated_by)
    except TendonRobotError as error:
        return _refused(one, when, dated_by, ' '.join(str(error).split()))
    except Exception as error:  # the other measurements are diagnosed all the same
        told = f'{type(error).__name__}: {error}'
        return _refused(one, when, dated_by, ' '.join(told.split()))


def _diagnosed(one: ToDiagnose, dataset: DataSet, when: str, dated_by: str) -> FleetRow:
    found = diagnose(dataset, catalogue=catalogue_of(one.effects), workers=1)
    fitted: dict[str, Value] = {}
    candidates: list[CandidateRow | EffectFinding] = [*found.candidates, *found.effects]
    for candidate in candidates:  # what was named beside others counts last
        names = candidate.parameters.items()
        if ' + ' not in candidate.name:
            fitted |= {f'{candidate.name} {key}': value for key, value in names}
    P, Q, J = dataset.positions.shape[:3]
    before, after, floor = (
        float(error) if np.isfinite(error) else None
        for error in (found.error_before, found.error_after, found.noise_floor)
    )
    return FleetRow(
        key=one.key,
        place=one.place,
        robot=dataset.robot.name,
        description=hashlib.sha256(dump_robot(dataset.robot).encode()).hexdigest()[:8],
        when=when,
        dated_by=dated_by,
        postures=P,
        trials=Q,
        markers=J,
        verdict=str(found.verdict),
        effects=tuple(effect.name for effect in found.effects),
        group=found.cannot_tell_apart,
        before=before,
        after=after,
        floor=floor,
        remainder=found.remainder,
        parameter=tuple(fitted),
        unit=tuple(value.unit for value in fitted.values()),
        value=tuple(float(value.value) for value in fitted.values()),
        low=tuple(float(value.low) for value in fitted.values()),
        high=tuple(float(value.high) for value in fitted.values()),
    )


def _refused(one: ToDiagnose, when: str, dated_by: str, problem: str) -> FleetRow:
    return FleetRow(one.key, one.place, 'not read', '', when, dated_by, 0, 0, 0, ERROR,
                    problem=problem)  # fmt: skip


def _lost(one: ToDiagnose, lost: LostWork) -> FleetRow:
    when, dated_by = when_of(Path(one.path))
    return _refused(one, when, dated_by, f'{lost.workers} processes died over it')


# -----------------------------------------------------------------------------
# What changed from one to the next.


@dataclass(frozen=True)
class Change:
    """What is different in a recording from the one before of the same robot."""

    robot: str
    since: str  # the last one without it
    when: str
    text: str


def histories(rows: Iterable[FleetRow]) -> dict[str, list[FleetRow]]:
    """Collect what could be read by robot, in the order of time."""
    found: dict[str, list[FleetRow]] = {}
    for row in rows:
        if row.verdict != ERROR:
            found.setdefault(row.robot, []).append(row)
    return {robot: sorted(own, key=lambda row: (row.when, row.place))
            for robot, own in found.items()}  # fmt: skip


def tracked(rows: Sequence[FleetRow]) -> list[str]:
    """Name the parameters of all effects that were ever named of a robot."""
    named = {effect for row in rows for effect in row.effects}
    names = [name for row in rows for name in row.parameter if name.split()[0] in named]
    return list(dict.fromkeys(names))


def changes(rows: Sequence[FleetRow]) -> list[Change]:
    """Say what changed when, robot by robot."""
    found = []
    for robot, own in histories(rows).items():
        names = tracked(own)
        for old, new in itertools.pairwise(own):
            said = [*_said(old, new), *_moved(old, new, names)]
            found += [Change(robot, old.when, new.when, text) for text in said]
    return found


def _said(old: FleetRow, new: FleetRow) -> list[str]:
    told = []
    if old.description != new.description:
        told.append('another description')
    if (old.verdict, old.effects) != (new.verdict, new.effects):
        told.append(f'{words_of(old)} before, now {words_of(new)}')
    if old.before and new.before:
        ratio = new.before / old.before
        if not 1.0 / WORSE_FACTOR < ratio < WORSE_FACTOR:
            told.append(f'the error of the description went from {mm(old.before)} to '
                        f'{mm(new.before)}')  # fmt: skip
    return told


def _moved(old: FleetRow, new: FleetRow, names: Sequence[str]) -> list[str]:
    """Say which parameters of what is named now have left their intervals."""
    told = []
    for name in names:
        first, then = old.fitted(name), new.fitted(name)
        if first is None or then is None or name.split()[0] not in new.effects:
            continue
        if then[1] > first[2] or then[2] < first[1]:
            unit = new.unit[new.parameter.index(name)]
            scale, shown = scale_of(unit, max(map(abs, (*first, *then))), name.split()[-1])
            ends = [
                f'{digits(scale * v)} ({digits(scale * low)} to {digits(scale * high)})'
                for v, low, high in (first, then)
            ]
            told.append(f'{name}: {ends[0]} before, now {ends[1]} {shown}'.rstrip())
    return told


def words_of(row: FleetRow) -> str:
    """Say in a few words what was said of one."""
    if row.verdict in (Verdict.ADEQUATE, Verdict.CANNOT_JUDGE, ERROR):
        return row.verdict.replace('_', ' ')
    names = listed(row.effects, 'and') if row.effects else ''
    return f'{row.verdict.replace("_", " ")}{": " + names if names else ""}'
