"""
Record the figures that users rely on, and set two records side by side.

A record is a JSON file: every figure of every part with its repeats. `--beside` prints what moved:
numbers whose repeats of both records do not overlap and that are more than 1 % apart, and words
that are others. Times of the model and of ticks are shares of what one shape of a planar arm takes
just before and after, so that records of two machines compare; other times are seconds.

example: python benchmarks/figures.py --json results/figures/now.json
    python benchmarks/figures.py --parts ticks diagnosed --json results/figures/part.json
    python benchmarks/figures.py --beside benchmarks/figures_before.json results/figures/now.json
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from machine import machine

from tendon_robot_ros import Model, load_robot

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent


@dataclass(frozen=True)
class Part:
    """Benchmarks that belong together."""

    commands: tuple[str, ...]  # scripts of this folder with their arguments
    repeats: int = 1  # of all commands; what is drawn or timed needs three for a spread
    shares: bool = False  # times are told as shares of a planar shape


PLANAR, SPATIAL, SIX = '--robot kato_10_1', '--robot spatial_3', '--robot spatial_6'
ORDERS = 'bench_control.py --only orders --orders 3 --kinds today memory closed'
PARTS = {
    'model': Part(('bench_model.py --targets 1000',), 3, shares=True),
    'ticks': Part(('bench_control.py --only ticks',), 3, shares=True),
    'load': Part(
        tuple(f'bench_control.py --only load --places 4 {robot}' for robot in (PLANAR, SPATIAL))
    ),
    'path': Part(tuple(f'bench_control.py --only path {robot}' for robot in (PLANAR, SPATIAL))),
    'orders': Part(tuple(f'{ORDERS} {robot}' for robot in (PLANAR, SPATIAL))),
    'stop': Part(
        tuple(
            f'bench_stop.py --trials 3 {robot} --mode {mode}'
            for robot in (PLANAR, SIX)
            for mode in ('tension', 'pull')
        )
    ),
    'silence': Part(tuple(f'bench_silence.py --targets 40 {robot}' for robot in (PLANAR, SIX)), 2),
    'idle': Part(('bench_idle.py --seconds 20',), 3),
    'diagnosed': Part(('diagnosed.py',), 2),
    'investigate': Part(('bench_investigate.py --cases 2 --no-random',)),
    'tentacle': Part(('tentacle.py',)),
}
# of the machine, not of the package
ASIDE = re.compile(r'(host|processor|cores|python|asked|stolen_ms|load_\w+|pages_\w+)$')
LEAST = 0.01  # [1] a change that nobody would act on
# what of the parts with `shares` is a time: [ms] where its name says so, else [s]
TIME = re.compile(r'_ms$|(median|p95|p99|least|first shape)$')


def planar_shape() -> float:
    """Return the processor time [s] of one shape of a planar arm, on this machine now."""
    model = Model(load_robot(ROOT / 'config/robots/kato_10_1.yaml'))
    tensions = model.limits[:, 0] + 0.1 * (model.limits[:, 1] - model.limits[:, 0])
    took = []
    for _ in range(2000):
        start = time.thread_time()
        model.shape(tensions)
        took.append(time.thread_time() - start)
    return float(np.median(took))


def leaves(value: Any, name: str = '') -> Iterator[tuple[str, float | str]]:
    """Yield every number and word of nested JSON under its path."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in items:
        path = f'{name}/{key}' if name else str(key)
        if item is None or ASIDE.match(str(key)):
            continue
        if isinstance(item, dict | list):
            yield from leaves(item, path)
        else:
            yield path, item if isinstance(item, str) else float(item)


def said(command: str) -> dict[str, Any]:
    """Run a benchmark to its end; return its JSON."""
    script, *arguments = command.split()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'figures.json'
        option = '--output' if script == 'bench_investigate.py' else '--json'
        run = [sys.executable, str(HERE / script), *arguments, option, str(file)]
        ended = subprocess.run(run, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if not file.exists():
            sys.exit(f'{command} ended with {ended.returncode}: {ended.stderr.strip()[-400:]}')
        text = file.read_text()
    if option == '--output':  # a line of JSON per case
        rows = [json.loads(line) for line in text.splitlines()]
        return {f'{row["robot"]} {row["seed"]}': row for row in rows}
    made = json.loads(text)
    return made if isinstance(made, dict) else {'rows': made}


def record(part: Part) -> dict[str, list[float | str]]:
    """Run the commands of a part; return the repeats of every figure."""
    found: dict[str, list[float | str]] = {}
    for _ in range(part.repeats):
        for command in part.commands:
            before = planar_shape() if part.shares else 1.0
            figures = dict(leaves(said(command), command))
            unit = 0.5 * (before + planar_shape()) if part.shares else 1.0
            for name, value in figures.items():
                if part.shares and isinstance(value, float) and TIME.search(name):
                    value /= 1e3 * unit if '_ms' in name else unit
                found.setdefault(name, []).append(value)
    return found


def moved(old: list[Any], new: list[Any]) -> str:
    """Say how a figure moved beyond the spread of its repeats; empty: it did not."""
    if isinstance(old[0], str) or isinstance(new[0], str):
        return '' if set(old) & set(new) else f'{old[0]} -> {new[0]}'
    (was, *_), (now, *_) = [np.median(old)], [np.median(new)]
    apart = max(old) < min(new) or max(new) < min(old)
    if not apart or abs(now - was) <= LEAST * max(abs(was), abs(now)):
        return ''
    spread = f'{min(old):.4g} to {max(old):.4g} -> {min(new):.4g} to {max(new):.4g}'
    return f'{was:.4g} -> {now:.4g}   ({spread})' if len(old) + len(new) > 2 else spread


def beside(before: Path, after: Path) -> int:
    """Print what moved from one record to another; return how many figures did."""
    old, new = (json.loads(path.read_text()) for path in (before, after))
    count = 0
    for name in old['parts']:
        was, now = old['parts'][name]['figures'], new['parts'].get(name, {}).get('figures')
        if now is None:
            print(f'{name}: not in {after}')
            continue
        changes = {key: moved(was[key], now[key]) for key in was if key in now}
        changes |= {key: 'is gone' for key in was if key not in now}
        changes |= {key: f'is new: {now[key][0]}' for key in now if key not in was}
        told = {key: change for key, change in changes.items() if change}
        print(f'{name}: {len(told)} of {len(changes)} figures moved')
        for key, change in told.items():
            print(f'  {key}: {change}')
        count += len(told)
    return count


def main() -> None:
    """Record the parts, or compare two records."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--parts', nargs='+', default=list(PARTS), choices=list(PARTS))
    parser.add_argument('--json', type=Path, default=ROOT / 'results/figures/now.json')
    parser.add_argument('--beside', type=Path, nargs=2, metavar=('OLD', 'NEW'))
    options = parser.parse_args()
    if options.beside:
        for path in options.beside:
            if not path.is_file():
                parser.error(f'--beside: {path}: no such record; --json writes one')
        beside(*options.beside)
        return
    options.json.parent.mkdir(parents=True, exist_ok=True)
    revision = subprocess.run(
        ['git', 'rev-parse', 'HEAD'], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    made: dict[str, Any] = {'revision': revision, 'machine': machine(), 'parts': {}}
    if options.json.exists():  # parts of the same revision that are there stay
        there = json.loads(options.json.read_text())
        made['parts'] = there['parts'] if there['revision'] == revision else {}
    for name in options.parts:
        start = time.monotonic()
        figures = record(PARTS[name])
        made['parts'][name] = {'seconds': round(time.monotonic() - start), 'figures': figures}
        options.json.write_text(json.dumps(made, indent=1))
        print(f'{name}: {len(figures)} figures in {made["parts"][name]["seconds"]} s', flush=True)
    print(f'written: {options.json}')


if __name__ == '__main__':
    main()
