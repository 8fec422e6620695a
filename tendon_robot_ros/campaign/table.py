"""The table of rows, in Parquet files that grow."""

from __future__ import annotations

import itertools
import os
import typing
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from types import UnionType
from typing import Any

from ..common.dataframes import arrow
from ..common.errors import DataSetError
from ..common.files import new_file

PARTS_MAX = 64  # files, before they become one


class GrowingTable[T]:
    """
    Rows of a dataclass in a folder of Parquet files, each whole or not there.

    A file is written for every few seconds of results; when they get many, they become one. A row
    that stands twice, because the computer was switched off in between, counts once.
    """

    def __init__(self, folder: Path, kind: type[T]) -> None:
        self.folder, self.kind, self.arrow = folder, kind, arrow()
        self.schema = self.arrow.schema(list(self._columns()))
        folder.mkdir(parents=True, exist_ok=True)

    def _columns(self) -> Iterator[Any]:
        types = typing.get_type_hints(self.kind)
        a = self.arrow
        plain = {str: a.string(), float: a.float64(), int: a.int64(), bool: a.bool_()}
        for field in fields(self.kind):  # type: ignore[arg-type]
            hint = types[field.name]
            members = [m for m in typing.get_args(hint) if m not in (type(None), Ellipsis)]
            if isinstance(hint, UnionType):
                yield a.field(field.name, plain[members[0]])
            elif members:
                yield a.field(field.name, a.list_(plain[members[0]]))
            else:
                yield a.field(field.name, plain[hint])

    def files(self) -> list[Path]:
        """List the files, oldest first."""
        return sorted(self.folder.glob('rows-*.parquet'))

    def keys(self) -> set[str]:
        """Return the keys of all rows, without reading the rest; as `rows`."""
        keys = self.arrow.schema([self.schema.field('key')])
        return {key for path in self.files() for key in self._read(path, keys)['key'].to_pylist()}

    def rows(self) -> list[T]:
        """
        Read all rows.

        Raises
        ------
        DataSetError
            A file is none that this program has written.

        """
        found: dict[str, T] = {}
        for path in self.files():
            for plain in self._read(path).to_pylist():
                made = {k: tuple(v) if isinstance(v, list) else v for k, v in plain.items()}
                found[plain['key']] = self.kind(**made)
        return list(found.values())

    def append(self, rows: Sequence[T]) -> None:
        """Write rows, and wait until they are on the disk."""
        if not rows:
            return
        content = [asdict(row) for row in rows]  # type: ignore[call-overload]
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
        """Read the columns of a schema; all by default."""
        schema = schema or self.schema
        try:
            with self.arrow.parquet.ParquetFile(path) as file:
                return file.read(columns=schema.names, use_threads=False).cast(schema)
        except (ValueError, OSError, LookupError) as error:
            reason = str(error).splitlines()[0]
            raise DataSetError(str(path), f'cannot be read ({reason})', 'delete it') from None

    def _write(self, content: Any) -> None:
        taken = {path.name for path in self.files()}
        names = (f'rows-{number:06d}.parquet' for number in itertools.count(self._next()))
        path = self.folder / next(name for name in names if name not in taken)
        with new_file(path) as draft:
            self.arrow.parquet.write_table(content, draft)
            with draft.open('rb') as written:
                os.fsync(written.fileno())

    def _next(self) -> int:
        names = [path.stem.removeprefix('rows-') for path in self.files()]
        return 1 + max((int(name) for name in names if name.isdigit()), default=0)
