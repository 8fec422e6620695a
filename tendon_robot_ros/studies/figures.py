"""Power, confusion, intervals, false alarms and costs, counted from the rows of a table."""

from __future__ import annotations

import collections
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from ..diagnosis.trust import DETECTED_SHARE, wilson
from ..diagnosis.verdict import Verdict
from ..effects import load_catalogue
from ..simulation.hidden import CAUSES
from .cases import NOTHING
from .judge import NAMING, CaseRow
from .running import ERROR

NOMINAL = (0.5, 0.8, 0.9, 0.95, 0.99)  # [1] shares of the intervals whose coverage is counted
BINS = 6  # of sizes that were drawn, on the scale of logarithms, so that each holds many cases
LISTED_SIZES_MAX = 12  # different sizes above which they were drawn: nobody lists so many
GONE_SHARE = 0.9  # [1] of the error on other postures that an effect must take off to count


@dataclass(frozen=True)
class Rate:
    """So many of so many, with the 95 % interval of Wilson."""

    hits: int
    runs: int

    @classmethod
    def of(cls, flags: Iterable[bool]) -> Rate:
        """Count."""
        listed = [bool(flag) for flag in flags]
        return cls(sum(listed), len(listed))

    @property
    def share(self) -> float | None:
        """Return the rate; None of nothing."""
        return self.hits / self.runs if self.runs else None

    @property
    def interval(self) -> tuple[float, float]:
        """Return its 95 % interval."""
        return wilson(self.hits, self.runs)

    def __str__(self) -> str:
        if not self.runs:
            return '–'
        low, high = self.interval
        share = 100.0 * self.hits / self.runs
        return f'{share:.0f} % ({100 * low:.0f} to {100 * high:.0f}; {self.hits} of {self.runs})'


@dataclass(frozen=True)
class Power:
    """How often an effect was seen and named, over its size."""

    robot: str
    hidden: str
    way: str  # design, noise and imperfections
    sizes: tuple[float, ...]  # times the typical one
    alarms: tuple[Rate, ...]  # anything said at all
    right: tuple[Rate, ...]  # it, or the class that it is in

    @property
    def smallest(self) -> float | None:
        """Return the size that is named in four of five cases, between those tried."""
        shares = [rate.share or 0.0 for rate in self.right]
        for i, share in enumerate(shares):
            if min(shares[i:]) >= DETECTED_SHARE:
                if i == 0:
                    return self.sizes[0]
                part = (DETECTED_SHARE - shares[i - 1]) / max(share - shares[i - 1], 1e-12)
                ends = np.log([self.sizes[i - 1], self.sizes[i]])
                return float(np.exp(ends[0] + part * (ends[1] - ends[0])))
        return None


def ways(rows: Sequence[CaseRow]) -> Callable[[CaseRow], str]:
    """Return what says how a case was measured and built, as far as that differs in a table."""
    parts: dict[str, Callable[[CaseRow], str]] = {
        'design': lambda row: row.design,
        'noise': lambda row: f'noise {row.noise}',
        'level': lambda row: f'imperfections x {row.level:g}',
    }
    told = [say for name, say in parts.items() if len({getattr(r, name) for r in rows}) > 1]
    return lambda row: '; '.join(say(row) for say in told)


def powers(rows: Sequence[CaseRow]) -> list[Power]:
    """Count how often every effect was seen, size by size."""
    way_of = ways(rows)
    hidden = [row for row in rows if row.hidden != NOTHING]
    found = []
    for key, members in grouped(hidden, lambda r: (r.robot, r.hidden, way_of(r))).items():
        binned = grouped(_binned(members), lambda row: row.size)
        sizes = sorted(binned)
        alarms = tuple(Rate.of(row.alarm for row in binned[size]) for size in sizes)
        right = tuple(Rate.of(row.right for row in binned[size]) for size in sizes)
        found.append(Power(*key, tuple(sizes), alarms, right))
    return found


def _binned(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """Put sizes that were drawn into bins; sizes that were listed stay."""
    if len({row.size for row in rows}) <= LISTED_SIZES_MAX:
        return list(rows)
    logs = np.log([row.size for row in rows])
    edges = np.linspace(logs.min(), logs.max() + 1e-9, BINS + 1)
    which = np.searchsorted(edges, logs, side='right') - 1
    middles = np.exp(0.5 * (edges[:-1] + edges[1:]))
    return [replace(row, size=float(middles[i])) for row, i in zip(rows, which, strict=True)]


def said(row: CaseRow) -> str:
    """Say in one word what a diagnosis said: the class's first member where it names one."""
    if row.verdict in NAMING and row.effects:
        return row.hidden if row.right else ' + '.join(row.effects)
    return row.verdict.replace('_', ' ')


def confusion(rows: Sequence[CaseRow]) -> tuple[list[str], list[str], list[list[int]]]:
    """Return what was hidden, what was said, and how often."""
    counts = collections.Counter((row.hidden, said(row)) for row in rows)
    hidden = list(dict.fromkeys(row.hidden for row in rows))
    names = {name for _, name in counts}
    words = [name for name in hidden if name in names] + sorted(names - set(hidden))
    return hidden, words, [[counts[one, word] for word in words] for one in hidden]


def coverage(rows: Sequence[CaseRow]) -> list[tuple[float, Rate]]:
    """Return how many intervals hold the truth, for several nominal shares."""
    z = []
    for row in rows:
        for true, value, low, high in zip(row.truth, row.value, row.low, row.high, strict=True):
            half = (high - value) if true > value else (value - low)
            z.append(abs(true - value) / half if half > 0.0 else float(true != value) * np.inf)
    full = NormalDist().inv_cdf(0.975)
    limits = [(share, NormalDist().inv_cdf(0.5 + 0.5 * share) / full) for share in NOMINAL]
    return [(share, Rate.of(one <= limit for one in z)) for share, limit in limits]


@dataclass(frozen=True)
class Cost:
    """What a way to measure brings, and what it costs."""

    way: str
    alarms: Rate  # of hidden effects seen
    right: Rate  # and named
    quiet: Rate  # clean sets that were called so
    seconds: float  # [s] of processor time for a diagnosis, median


def costs(rows: Sequence[CaseRow]) -> list[Cost]:
    """Compare the ways to measure: the same arms, all effects and sizes."""
    found = []
    for way, members in grouped(rows, ways(rows)).items():
        hidden = [row for row in members if row.hidden != NOTHING and row.hidden not in CAUSES]
        found.append(
            Cost(
                way,
                Rate.of(row.alarm for row in hidden),
                Rate.of(row.right for row in hidden),
                Rate.of(row.right for row in members if row.hidden == NOTHING),
                float(np.median([row.seconds for row in members])),
            )
        )
    return found


def clean_rows(rows: Sequence[CaseRow]) -> list[tuple[str, str, Rate, Rate]]:
    """Return (robot, way, alarms, named) of the sets with nothing hidden."""
    way_of = ways(rows)
    clean = [row for row in rows if row.hidden == NOTHING]
    return [
        (*key, Rate.of(r.alarm for r in members), Rate.of(r.verdict in NAMING for r in members))
        for key, members in grouped(clean, lambda row: (row.robot, way_of(row))).items()
    ]


def rates(rows: Sequence[CaseRow]) -> dict[str, Rate]:
    """Return the rates that the diagnosis is judged by."""
    effects = [row for row in rows if row.hidden not in (*CAUSES, NOTHING)]
    named = [row for row in effects if row.right]
    causes = [row for row in rows if row.hidden in CAUSES]
    clean = [row for row in rows if row.hidden == NOTHING]
    twins = {effect.name for effect in load_catalogue() if effect.scales_bends}
    single = [row for row in named if row.hidden not in twins]
    return {
        'right, of all effects': Rate.of(row.right for row in effects),
        'right, of those that stand out of the noise': Rate.of(
            row.right for row in effects if row.visible
        ),
        'wrong names, of all effects': Rate.of(row.wrong_name for row in effects),
        'a single name, effects without a twin': Rate.of(len(row.group) <= 1 for row in single),
        'true values inside their 95 % intervals': Rate.of(
            held for row in effects for held in row.held
        ),
        'named effects that take 90 % of the error off other postures': Rate.of(
            row.gone >= GONE_SHARE for row in named if row.gone is not None
        ),
        'scatter inside its interval, where it is told': Rate.of(
            held for row in rows for held in row.scatter_held
        ),
        'causes called outside, of those that raise an alarm': Rate.of(
            row.right for row in causes if row.verdict != Verdict.ADEQUATE
        ),
        'clean sets with an effect named': Rate.of(row.verdict in NAMING for row in clean),
        'clean sets with any alarm': Rate.of(not row.right for row in clean),
        'cases that ended in an error': Rate.of(row.verdict == ERROR for row in rows),
    }


def rates_by_robot(rows: Sequence[CaseRow]) -> dict[str, dict[str, Rate]]:
    """Return the rates of every robot."""
    return {robot: rates(members) for robot, members in grouped(rows, lambda r: r.robot).items()}


@dataclass(frozen=True)
class HiddenRates:
    """What was said where one thing was hidden in one robot."""

    robot: str
    hidden: str
    right: Rate  # of all sizes
    right_if_seen: Rate  # of those that stand out of the noise
    wrong_names: Rate
    inside: Rate  # true values inside their 95 % intervals


def rates_by_hidden(rows: Sequence[CaseRow]) -> list[HiddenRates]:
    """Return the rates of everything that was hidden, robot by robot."""
    return [
        HiddenRates(
            robot,
            hidden,
            Rate.of(row.right for row in members),
            Rate.of(row.right for row in members if row.visible),
            Rate.of(row.wrong_name for row in members),
            Rate.of(held for row in members for held in row.held),
        )
        for (robot, hidden), members in grouped(rows, lambda r: (r.robot, r.hidden)).items()
    ]


def grouped[K](rows: Iterable[CaseRow], by: Callable[[CaseRow], K]) -> dict[K, list[CaseRow]]:
    """Collect rows that share something."""
    groups: dict[K, list[CaseRow]] = {}
    for row in rows:
        groups.setdefault(by(row), []).append(row)
    return groups


def to_json(rows: Sequence[CaseRow]) -> dict[str, Any]:
    """Return all figures as plain data."""
    return {
        'cases': len(rows),
        'rates': _plain(rates(rows)),
        'rates_by_robot': _plain(rates_by_robot(rows)),
        'rates_by_hidden': _plain(rates_by_hidden(rows)),
        'power': [{**_plain(one), 'smallest': one.smallest} for one in powers(rows)],
        'coverage': [{'nominal': share, **_plain(rate)} for share, rate in coverage(rows)],
        'seconds': float(np.median([row.seconds for row in rows])) if rows else None,
    }


def _plain(value: Any) -> Any:
    """Return figures as JSON holds them; a rate as its share, 95 % interval and counts."""
    if isinstance(value, Rate):
        low, high = value.interval
        found = {'share': value.share, 'low': low, 'high': high}
        return {**found, 'hits': value.hits, 'runs': value.runs}
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, (list, tuple)) else value
