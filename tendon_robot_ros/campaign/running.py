"""A plan on workers, going on where it was."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..common.errors import InputError
from ..common.files import new_file
from ..common.given import Progress, listener
from ..common.workers import LostWork, Workers
from .cases import Case
from .judge import CaseRow, Chunk, judge_chunk, lost
from .plan import CampaignPlan
from .table import GrowingTable
from .versions import differences, refuse_difference, versions

CHUNK_S = 2.0  # [s] of work in a chunk: handing one out costs some milliseconds
CHUNK_MAX = 256  # cases in one
WRITTEN_EVERY_S = 5.0  # [s] the most that is computed again after a loss of power
CONTENT, ROWS = 'campaign.json', 'table'


@dataclass
class ChunkSize:
    """How many cases make a chunk, from how long the last ones took."""

    left: int
    slots: int
    seconds: float = 0.0  # for a case; 0: not yet known

    def size(self) -> int:
        """Return how many to hand out next; few at the end, so that no worker waits for long."""
        fair = max(self.left // (4 * self.slots), 1)
        wanted = int(CHUNK_S / self.seconds) if self.seconds else 1
        return max(min(wanted, fair, CHUNK_MAX), 1)

    def saw(self, rows: Sequence[CaseRow], seconds: float) -> None:
        """Learn from a chunk."""
        own = seconds / len(rows)
        self.seconds = own if not self.seconds else 0.8 * self.seconds + 0.2 * own


@dataclass(frozen=True)
class Timed:
    """The rows of a chunk and the time [s] that it took in the worker, of the processor too."""

    rows: list[CaseRow]
    seconds: float
    processor: float


def timed_chunk(chunk: Chunk) -> Timed:
    """Judge a chunk, in a worker."""
    start, began = time.monotonic(), time.thread_time()
    rows = judge_chunk(chunk)
    return Timed(rows, time.monotonic() - start, time.thread_time() - began)


def run_plan(
    plan: CampaignPlan,
    folder: Path,
    workers: Workers,
    progress: Progress | None = None,
    accept_change: bool = False,
) -> list[CaseRow]:
    """
    Judge the cases of a plan that are not in the table yet.

    Parameters
    ----------
    plan : CampaignPlan
    folder : Path
        Of the table; what is there already counts.
    workers : Workers
    progress : callable, optional
        Called with (what, done, total) of the cases that were left.
    accept_change : bool
        Go on where other versions began; `earlier_rows` then says so.

    Returns
    -------
    list of CaseRow
        Of all cases of the plan, in its order.

    Raises
    ------
    InputError
        The folder belongs to something else, or to other versions.
    ClusterLostError
        The scheduler is gone; what was finished is in the table.

    """
    show = listener(progress)
    claim(folder, plan, accept_change)
    table = GrowingTable(folder / ROWS, CaseRow)
    known = table.keys()
    todo = [case for case in plan.cases if case.key not in known]
    before = len(plan.cases) - len(todo)
    what = f'cases ({before:,} were there)' if before else 'cases'
    buffer: list[CaseRow] = []
    done, written = 0, time.monotonic()
    try:
        for rows in _judged(plan, todo, workers):
            buffer += rows
            done += len(rows)
            if time.monotonic() > written + WRITTEN_EVERY_S:
                table.append(buffer)
                buffer, written = [], time.monotonic()
            show(what, done, len(todo))
    finally:
        table.append(buffer)
    table.merge()
    return rows_of(plan, folder)


def _judged(plan: CampaignPlan, todo: Sequence[Case], workers: Workers) -> Iterator[list[CaseRow]]:
    """Yield the rows of chunks as they come."""
    pace = ChunkSize(len(todo), workers.slots)
    handed: dict[int, Chunk] = {}

    def chunks() -> Iterator[Chunk]:
        begin, numbers = 0, itertools.count()
        while begin < len(todo):
            end = begin + pace.size()
            chunk = Chunk(plan.setup, tuple(todo[begin:end]))
            handed[next(numbers)] = chunk
            pace.left -= len(chunk.cases)
            yield chunk
            begin = end

    for index, result in workers.run(timed_chunk, chunks()):
        chunk = handed.pop(index)
        if isinstance(result, LostWork):
            yield [lost(plan.setup, case, result.workers) for case in chunk.cases]
            continue
        pace.saw(result.rows, result.seconds)
        yield result.rows


def claim(folder: Path, plan: CampaignPlan, accept_change: bool = False) -> None:
    """Make the folder that of a plan, or refuse it."""
    path = folder / CONTENT
    ours = {'versions': versions(plan.setup.effects), 'contents': plan.contents}
    earlier: list[dict[str, Any]] = []
    if path.is_file():
        theirs = read_content(folder)
        _refuse_other_contents(folder, theirs['contents'], ours['contents'])
        earlier = theirs['earlier']
        if not accept_change:
            refuse_difference(
                f'{folder}: was run with other versions',
                theirs['versions'],
                ours['versions'],
                'use another --output, or --accept-change, which keeps the rows that are there',
            )
        elif differences(theirs['versions'], ours['versions']):
            rows = len(GrowingTable(folder / ROWS, CaseRow).keys())
            earlier = [*earlier, {'rows': rows, 'versions': theirs['versions']}]
        ours['contents'] = {**theirs['contents'], **ours['contents']}
    elif folder.exists() and any(folder.iterdir()):
        raise InputError(f'{folder}: is not empty and no campaign; use another --output')
    folder.mkdir(parents=True, exist_ok=True)
    with new_file(path) as draft:
        text = json.dumps({**ours, 'earlier': earlier}, indent=1)
        draft.write_text(text + '\n', encoding='utf-8')


def _refuse_other_contents(folder: Path, theirs: dict[str, str], ours: dict[str, str]) -> None:
    """Refuse what is called as before and is something else."""
    changed = [name for name, digest in ours.items() if theirs.get(name, digest) != digest]
    if changed:
        raise InputError(
            f'{folder}: was run with another {", ".join(changed)}; use another --output'
        )


def read_content(folder: Path) -> dict[str, Any]:
    """Return what a folder was run with: versions, contents, and earlier versions."""
    try:
        content = json.loads((folder / CONTENT).read_text())
        plain = {key: dict(content[key]) for key in ('versions', 'contents')}
        return {**plain, 'earlier': list(content.get('earlier', ()))}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'{folder / CONTENT}: cannot be read ({error}); use another --output'
        ) from None


def earlier_rows(folder: Path) -> list[str]:
    """Say which rows of a table come from other versions than the last, a line per change."""
    content = read_content(folder)
    return [
        f'the first {one["rows"]:,} rows were judged by other versions: '
        + '; '.join(differences(one['versions'], content['versions']))
        for one in content['earlier']
    ]


def rows_of(plan: CampaignPlan, folder: Path) -> list[CaseRow]:
    """Return the rows that are there of a plan, in its order."""
    rows = {row.key: row for row in GrowingTable(folder / ROWS, CaseRow).rows()}
    return [rows[case.key] for case in plan.cases if case.key in rows]
