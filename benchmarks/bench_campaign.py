"""
What spreading a campaign costs: workers at work, overhead, workers that are killed, memory.

Cheap cases on purpose (an exact arm, few postures: a tenth of a second), where handing out weighs
most. `at work` is how many workers compute at a time, the speed-up on an idle machine; processor
time is that of all processes, the start of workers included (dask's were there already), and
`beside the work` is what of it was not spent on cases, over what was.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from machine import machine, tell

from tendon_robot_ros.common.workers import Workers
from tendon_robot_ros.model.versions import Preparation
from tendon_robot_ros.studies.judge import CaseRow
from tendon_robot_ros.studies.plan import CampaignPlan, plan_of, run_plan

CONFIG = Path(__file__).resolve().parents[1] / 'config'
ROBOT = CONFIG / 'robots' / 'kato_10_1_single.yaml'
SETTINGS = CONFIG / 'dask.yaml'  # as docs/campaigns.md advises
STARTED_S = 3.0  # [s] of processor time, after which a worker is at work
TICK = os.sysconf('SC_CLK_TCK')
PAGE = os.sysconf('SC_PAGE_SIZE')


class Watched(Workers):
    """Workers whose time at work is counted."""

    busy = 0.0  # [s]
    work = 0.0  # [s] of processor time

    def run(self, *arguments: Any, **options: Any) -> Iterator[tuple[int, Any]]:
        for index, result in super().run(*arguments, **options):
            self.busy += getattr(result, 'seconds', 0.0)
            self.work += getattr(result, 'processor', 0.0)
            yield index, result


def plan(cases: int) -> CampaignPlan:
    """Return a plan of so many cheap cases."""
    content = {
        'robots': [str(ROBOT)],
        'hidden': ['hinge_friction'],
        'sizes': [1.0],
        'seeds': cases // 2,
        'clean': cases // 2,
        'imperfections': [0],
        'exact': True,
        'designs': [{'postures': 5, 'trials': 3, 'markers': 5}],
    }
    return plan_of(content, 'bench')


def children_of(pid: int) -> list[int]:
    """List a process and all that it has started."""
    parents = {}
    for path in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError, IndexError):
            fields = path.joinpath('stat').read_text().rpartition(')')[2].split()
            parents[int(path.name)] = int(fields[1])
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def processor(pids: list[int]) -> float:
    """Processor time [s] of processes that run, and of their children that have ended."""
    total = 0.0
    for pid in pids:
        with contextlib.suppress(OSError):
            fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
            total += sum(map(int, fields[11:15])) / TICK
    return total


def spent(others: tuple[int, ...] = ()) -> float:
    """Processor time [s] of this process, of its ended children, and of others with theirs."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    own = sum(one.ru_utime + one.ru_stime for one in used)
    return own + sum(processor(children_of(pid)) for pid in others)


def measured(
    cases: int, count: int, cluster: str = '', others: tuple[int, ...] = ()
) -> tuple[dict[str, float], list[CaseRow]]:
    """Run the cheap campaign; what it took, and its rows."""
    before, begun = spent(others), time.monotonic()
    with (
        tempfile.TemporaryDirectory() as folder,
        Watched(count, cluster, Preparation.of_this_process()) as workers,
    ):
        ready = time.monotonic()
        rows = run_plan(plan(cases), Path(folder) / 'out', workers)
        wall = time.monotonic() - ready
    used = spent(others) - before
    figures = {
        'cases per second': cases / (time.monotonic() - begun),
        'at work': workers.busy / wall,
        'processor seconds': used,
        'beside the work': used / workers.work - 1.0,
    }
    return figures, [replace(row, seconds=0.0) for row in rows]


@contextmanager
def dask(count: int, settings: Path | None = None) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Start a scheduler and workers as processes; give the address and the process ids."""
    where = {} if settings is None else {'DASK_CONFIG': str(settings)}
    with tempfile.TemporaryDirectory() as folder:
        told, log = Path(folder) / 'scheduler.json', (Path(folder) / 'log').open('w')
        base = [sys.executable, '-m', 'dask']
        ends = ['--scheduler-file', str(told)]
        calls = (
            ['scheduler', '--host', '127.0.0.1', '--port', '0', '--no-dashboard'],
            ['worker', '--nworkers', str(count), '--nthreads', '1', '--no-dashboard'],
        )
        options: dict[str, Any] = {'cwd': folder, 'stdout': log, 'stderr': log}
        options['env'] = {**os.environ, **where}
        started = [subprocess.Popen([*base, *call, *ends], **options) for call in calls]
        try:
            while not (told.exists() and told.read_text().rstrip().endswith('}')):  # written whole
                time.sleep(0.05)
            yield json.loads(told.read_text())['address'], tuple(one.pid for one in started)
        finally:
            for one in reversed(started):
                one.terminate()
                one.wait()


@contextmanager
def killing(times: int, find: Callable[[], list[int]]) -> Iterator[list[int]]:
    """Kill a worker every second, so many times in all."""
    dead: list[int] = []
    stop = threading.Event()

    def kill() -> None:
        while len(dead) < times and not stop.wait(1.0):
            for pid in [pid for pid in find() if pid not in dead][:1]:
                dead.append(pid)
                os.kill(pid, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield dead
    finally:
        stop.set()
        thread.join()


def spawned(pid: int) -> list[int]:
    """List the workers below a process that are past their start, in which a nanny gives up."""
    found = []
    for one in children_of(pid)[1:]:
        with contextlib.suppress(OSError):
            line = Path(f'/proc/{one}/cmdline').read_bytes()
            found += [one] if b'spawn_main' in line and processor([one]) > STARTED_S else []
    return found


def spreading(cases: int) -> dict[str, Any]:
    """Measure one and two workers one after the other, twice, and schedulers with two."""
    figures: dict[str, Any] = {'load average': os.getloadavg()[0]}
    alone, rows = measured(cases, 1)
    figures['in this process'] = alone
    for count in (2, 2):
        figures[f'{count} workers'], found = measured(cases, count)
        assert found == rows
    for name, settings in (('dask, 2 workers', None), ('with config/dask.yaml', SETTINGS)):
        with dask(2, settings) as (address, pids):
            measured(cases // 4, 2, address, pids)  # the workers load the kernel
            figures[name], found = measured(cases, 2, address, pids)
            assert found == rows
    return figures


def killed(cases: int, times: int) -> dict[str, Any]:
    """Kill workers during a campaign: rows that are missing or differ from those of one alone."""
    _, rows = measured(cases, 1)
    figures = {}
    with killing(times, lambda: spawned(os.getpid())) as dead:
        found = measured(cases, 2)[1]
    figures['processes'] = {'killed': len(dead), 'rows that differ': differing(rows, found)}
    with dask(2) as (address, pids), killing(times, lambda: spawned(pids[1])) as dead:
        found = measured(cases, 2, address, pids)[1]
    figures['dask'] = {'killed': len(dead), 'rows that differ': differing(rows, found)}
    return figures


def differing(one: list[CaseRow], other: list[CaseRow]) -> int:
    """Count rows that are missing or another."""
    known = {row.key: row for row in other}
    return sum(known.get(row.key) != row for row in one)


def memory(cases: int) -> dict[str, float]:
    """Diagnose so many in this process; what it has in memory [MB] at every tenth of them."""
    found: dict[str, float] = {}

    def look(what: str, done: int, total: int) -> None:
        if done * 10 // total > len(found):
            pages = int(Path('/proc/self/statm').read_text().split()[1])
            found[f'{done:,}'] = round(pages * PAGE / 1e6, 1)
            print(f'{done:,}: {found[f"{done:,}"]} MB', file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as folder, Workers() as workers:
        run_plan(plan(cases), Path(folder) / 'out', workers, look)
    return found


def main() -> int:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=int, default=400)
    parser.add_argument('--kills', type=int, default=10)
    parser.add_argument('--memory', type=int, default=10_000, help='diagnoses')
    parser.add_argument('--only', choices=('spreading', 'killed', 'memory'))
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    plan(2).setup.compile()
    measured(4, 1)
    asked: dict[str, Callable[[], Any]] = {
        'spreading': lambda: spreading(options.cases),
        'killed': lambda: killed(options.cases, options.kills),
        'memory': lambda: memory(options.memory),
    }
    figures = {name: ask() for name, ask in asked.items() if options.only in (None, name)}
    tell({'machine': machine(), **figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
