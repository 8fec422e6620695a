"""Cases on workers, one after the other or side by side, into a table that grows."""

from __future__ import annotations

import os
import time
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from ..common.errors import DataSetError, Progress, listener
from ..common.files import new_file
from ..common.processes import UPKEEP_S
from ..common.results import arrow
from ..common.workers import LostWork, Workers
from ..model.versions import UserEffect, compiled_once

# [1] files of a table before they become one, because reading the keys opens every file
PARTS_MAX = 64
TABLE = 'table'  # in the folder of a study
ERROR = 'error'  # in place of a verdict


@dataclass(frozen=True, kw_only=True)
class Row:
    """The result of a case: of a simulated robot, or of a recording."""

    key: str  # of the case, in all studies that share a table
    robot: str
    verdict: str
    effects: tuple[str, ...] = ()
    group: tuple[str, ...] = ()  # that cannot be told apart
    before: float | None = None  # [m] error of the description
    after: float | None = None  # [m] with the effects
    floor: float | None = None  # [m]
    problem: str = ''
    parameter: tuple[str, ...] = ()  # that was fitted: its value and 95 % interval
    value: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()


class Keyed(Protocol):
    """One thing to judge; goes to a worker."""

    @property
    def key(self) -> str:
        """Its name in the table."""
        ...


@dataclass(frozen=True, kw_only=True)
class Study[C: Keyed, R: Row]:
    """How every case is judged, with all that is needed for it; goes to the workers."""

    question: str  # name of the kind of work, which one process of a machine compiles for others
    effects: tuple[UserEffect, ...] = field(default=(), repr=False)  # the user's own

    def result(self, case: C) -> dict[str, Any]:
        """Return what the row of a case holds beside what the case is."""
        raise NotImplementedError

    def row(self, case: C, result: Mapping[str, Any]) -> R:
        """Return the row of a case."""
        raise NotImplementedError

    def judge(self, case: C) -> R:
        """Return the row of a case; an error becomes one as well."""
        try:
            return self.row(case, self.result(case))
        except Exception as error:  # whatever a case meets, the others go on and it is counted
            return self.refused(case, f'{type(error).__name__}: {error}')

    def refused(self, case: C, problem: str) -> R:
        """Return the row of a case that could not be judged."""
        return self.row(case, {'verdict': ERROR, 'problem': problem})


def judge_chunk[C: Keyed, R: Row](study: Study[C, R], cases: Sequence[C]) -> list[R]:
    """Judge cases one after the other, in a worker."""
    with compiled_once(study.question, study.effects):
        return [study.judge(case) for case in cases]


def judge_all[C: Keyed, R: Row](
    study: Study[C, R],
    cases: Sequence[C],
    table: GrowingTable[R],
    workers: Workers,
    progress: Progress | None = None,
    what: str = 'cases',
) -> list[R]:
    """
    Judge the cases that are not in a table yet.

    Parameters
    ----------
    study : Study
    cases : sequence
    table : GrowingTable
        What is there already counts; what is finished stays there, whatever happens.
    workers : Workers
    progress : callable, optional
        Called with (what, done, total) of the missing cases.
    what : str
        How cases are called there.

    Returns
    -------
    list of Row
        Of all cases that are in the table then, in their order.

    """
    show, known = listener(progress), table.keys()
    missing = [case for case in cases if case.key not in known]
    if known_count := len(cases) - len(missing):
        what = f'{what} ({known_count:,} were there)'
    buffer: list[R] = []
    done, written = 0, time.monotonic()
    try:
        for chunk, result in workers.in_chunks(partial(judge_chunk, study), missing):
            if isinstance(result, LostWork):
                problem = f'{result.workers} workers died over it'
                result = [study.refused(case, problem) for case in chunk]
            buffer += result
            done += len(chunk)
            if time.monotonic() > written + UPKEEP_S:
                table.append(buffer)
                buffer, written = [], time.monotonic()
            show(what, done, len(missing))
    finally:
        table.append(buffer)
    table.merge()
    return table.rows_of(cases)


class GrowingTable[R: Row]:
    """
    Rows in a folder of Parquet files, each whole or not there.

    A file is written for every few seconds of results; when they get many, they become one. A row
    that stands twice, because the computer was switched off in between, counts once.
    """

    def __init__(self, folder: Path, kind: type[R]) -> None:
        self.folder, self.kind, self.arrow = folder, kind, arrow()
        self.schema = self.arrow.schema(list(self.columns()))

    def columns(self) -> Iterator[Any]:
        """Yield the fields of the schema."""
        a = self.arrow
        plain = {str: a.string(), float: a.float64(), int: a.int64(), bool: a.bool_()}
        for name, hint in typing.get_type_hints(self.kind).items():
            kind = plain[next(iter(typing.get_args(hint)), hint)]  # of `float | None`: float
            is_list = typing.get_origin(hint) is tuple
            yield a.field(name, a.list_(kind) if is_list else kind)

    def files(self) -> list[Path]:
        """List the files, oldest first."""
        return sorted(self.folder.glob('rows-*.parquet'))

    def keys(self) -> set[str]:
        """Return the keys of all rows, without reading the rest; as `rows`."""
        keys = self.arrow.schema([self.schema.field('key')])
        return {key for path in self.files() for key in self._read(path, keys)['key'].to_pylist()}

    def rows(self) -> list[R]:
        """
        Read all rows.

        Raises
        ------
        DataSetError
            A file is none that this program has written.

        """
        rows: dict[str, R] = {}
        for path in self.files():
            for row in self._read(path).to_pylist():
                lists = {name: tuple(one) for name, one in row.items() if isinstance(one, list)}
                rows[row['key']] = self.kind(**(row | lists))
        return list(rows.values())

    def rows_of(self, cases: Sequence[Keyed]) -> list[R]:
        """Return the existing rows of some cases, in the order of the cases."""
        rows = {row.key: row for row in self.rows()}
        return [rows[case.key] for case in cases if case.key in rows]

    def append(self, rows: Sequence[R]) -> None:
        """Write rows, and wait until they are on the disk."""
        if not rows:
            return
        content = [asdict(row) for row in rows]
        self._write(self.arrow.Table.from_pylist(content, schema=self.schema))
        if len(self.files()) >= PARTS_MAX:
            self.merge()

    def merge(self) -> None:
        """Make one file of all."""
        old = self.files()
        if len(old) < 2:
            return
        self._write(self.arrow.concat_tables(map(self._read, old)))
        for path in old:
            path.unlink()
        self.arrow.default_memory_pool().release_unused()  # else every merging would keep more

    def _read(self, path: Path, schema: Any = None) -> Any:
        """Read the columns of a schema, whatever their order; all by default."""
        schema = schema or self.schema
        try:
            with self.arrow.parquet.ParquetFile(path) as file:
                columns = file.read(columns=schema.names, use_threads=False)
                return columns.select(schema.names).cast(schema)
        except (ValueError, OSError, LookupError) as error:
            reason = str(error).splitlines()[0]
            raise DataSetError(str(path), f'cannot be read ({reason})', 'delete it') from None

    def _write(self, content: Any) -> None:
        """Write a file that sorts behind all others."""
        self.folder.mkdir(parents=True, exist_ok=True)
        numbers = [path.stem.removeprefix('rows-') for path in self.files()]
        number = 1 + max((int(text) for text in numbers if text.isdigit()), default=0)
        with new_file(self.folder / f'rows-{number:06d}.parquet') as draft:
            self.arrow.parquet.write_table(content, draft)
            with draft.open('rb') as written:
                os.fsync(written.fileno())
