"""
A simulated case, diagnosed, held against the truth: a row of the table.

From the rows: power, confusion, intervals, false alarms and costs.
"""

from __future__ import annotations

import collections
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..common.results import plain
from ..common.words import grouped
from ..diagnosis.add import add_effect
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis, found_values
from ..diagnosis.trust import DETECTION_POWER, wilson
from ..diagnosis.verdict import SAME_ERROR_RATIO, Verdict
from ..effects import load_catalogue
from ..inference.intervals import Value
from ..inference.predict import Predictor
from ..inference.statistics import normal_ppf, rms
from ..model.model import Model
from ..model.versions import catalogue_of
from ..simulation.hidden import CAUSES, Built, Workmanship
from ..simulation.measurements import SimulatedNoise, simulate
from ..simulation.plant import make_plant
from . import cases
from .cases import NOTHING, Case, Design, PlannedRobot, Simulated, is_visible, truth_of
from .running import ERROR, Row, Study

DIAGNOSIS, INTERVALS = 'diagnosis', 'intervals'
QUESTIONS = (DIAGNOSIS, INTERVALS)
NAMING = tuple(verdict for verdict in Verdict if verdict.may_add)
# [1] nominal probability of the intervals whose coverage is counted
NOMINAL = (0.5, 0.8, 0.9, 0.95, 0.99)
# [1] bins, on a logarithmic scale, of sizes that were drawn, so that each holds many cases; sizes
# are drawn where there are more than twice as many, because nobody lists so many
BINS = 6
# [1] of the error on other postures that an effect must take off to count (docs/campaigns.md)
REMOVED_FRACTION = 0.9


@dataclass(frozen=True, kw_only=True)
class CaseRow(Row):
    """The result of a simulated case; `parameter`: of the hidden effect if it was named."""

    hidden: str
    size: float
    number: int
    design: str
    noise: str
    level: float
    right: bool = False
    wrong_name: bool = False
    alarm: bool = False
    visible: bool = True  # the truth stands out of the noise
    gone: float | None = None  # fraction of (before - floor) gone on postures not used
    scatter_inside: float | None = None  # fraction of the kinds whose true size is in its interval
    scatter_told: int = 0  # number of such kinds with a printed size
    seconds: float = 0.0  # of processor time, for the diagnosis alone
    truth: tuple[float, ...] = ()

    @property
    def held(self) -> list[bool]:
        """Whether each true value lies in its 95 % interval; none where none was fitted."""
        each = zip(self.low, self.truth, self.high, strict=True)
        return [low <= true <= high for low, true, high in each]


@dataclass(frozen=True, kw_only=True)
class Setup(Study[Case, CaseRow]):
    """What every simulated case needs: a study."""

    arms: tuple[PlannedRobot, ...]
    designs: tuple[Design, ...]
    noises: tuple[tuple[str, SimulatedNoise], ...]
    seed: int = 0

    def arm(self, name: str) -> PlannedRobot:
        """Return a robot by its name."""
        return next(arm for arm in self.arms if arm.robot.name == name)

    def compile(self) -> None:
        """Have the kernel compiled before workers would do it side by side."""
        for arm in self.arms:
            Model(arm.robot, catalogue_of(self.effects)).arrays.link()

    def result(self, case: Case) -> dict[str, Any]:
        """Simulate, diagnose, and hold the verdict against the truth."""
        return (diagnosed if self.question == DIAGNOSIS else fitted)(case, self.simulated(case))

    def simulated(self, case: Case) -> Simulated:
        """
        Build the arm of a case and measure it, and once more in other postures.

        Where intervals are in question the arm is one of the model itself, of the same cells and
        laws, so that nothing but noise moves what is fitted.

        Raises
        ------
        TendonRobotError
            The hidden effect cannot be, or the arm has no equilibrium.

        """
        catalogue, design = catalogue_of(self.effects), self.designs[case.design]
        robot = cases.described(case, self.arm(case.robot), catalogue)
        of_arm, of_fit, of_check, of_hidden = cases.seeds_of(case, self.seed)
        values = cases.hidden_values(case.hidden, case.size, robot, catalogue, of_hidden)
        hidden = {} if case.hidden == NOTHING else {case.hidden: values}
        work = Workmanship().times(case.level) if case.level else None
        own_model = self.question == INTERVALS
        how: dict[str, Any] = {'refine': 1, 'capstan': False} if own_model else {}
        how |= {'scatter': case.scatter, 'seed': of_arm, 'catalogue': catalogue, 'work': work}
        plant = make_plant(robot, hidden, **how)
        trials = design.trials if design.data is None else int(design.data.positions.shape[1])
        sets, noise = [], self.noises[case.noise][1]
        for which, own in enumerate((of_fit, of_check)):
            inputs, kind, path = cases.postures_of(case, robot, design, catalogue, which)
            data: dict[str, Any] = {'input': kind, 'path': path, 'markers': design.placed(robot)}
            one = simulate(plant, inputs, noise=noise, trials=trials, seed=own, **data)
            sets.append(cases.with_lost_readings(one, own) if case.level else one)
        return Simulated(robot, sets[0], sets[1], values, plant.built, catalogue)

    def row(self, case: Case, result: Mapping[str, Any]) -> CaseRow:
        """Return the row of a case."""
        design, noise = self.designs[case.design].name, self.noises[case.noise][0]
        same = ('key', 'robot', 'hidden', 'size', 'number', 'level')
        own = {name: getattr(case, name) for name in same}
        return CaseRow(**own, design=design, noise=noise, **result)


def diagnosis_fields(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the fields of a row that describe a diagnosis."""
    errors = diagnosis.error_before, diagnosis.error_after, diagnosis.noise_floor
    return {
        'verdict': str(diagnosis.verdict),
        'effects': tuple(effect.name for effect in diagnosis.effects),
        'group': diagnosis.cannot_tell_apart,
        **dict(zip(('before', 'after', 'floor'), plain(errors), strict=True)),
    }


def fitted_values(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return the fields of a row that describe fitted parameters."""
    return {
        'parameter': tuple(values),
        'value': tuple(float(value.value) for value in values.values()),
        'low': tuple(float(value.low) for value in values.values()),
        'high': tuple(float(value.high) for value in values.values()),
    }


def diagnosed(case: Case, sim: Simulated) -> dict[str, Any]:
    """Diagnose and compare with the truth: name, interval, error on other postures, scatter."""
    start = time.process_time()
    diagnosis = diagnose(sim.fit, catalogue=sim.catalogue)
    seconds = time.process_time() - start
    listed = {*(effect.name for effect in diagnosis.effects), *diagnosis.cannot_tell_apart}
    named = diagnosis.verdict in NAMING
    if case.hidden == NOTHING:
        right = diagnosis.verdict is Verdict.ADEQUATE
    elif case.hidden in CAUSES:
        right = diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE
    else:
        right = named and case.hidden in listed
    row = {
        **diagnosis_fields(diagnosis),
        'right': right,
        'wrong_name': named and case.hidden not in listed,
        'alarm': diagnosis.verdict is not Verdict.ADEQUATE,
        'visible': is_visible(case, sim),
        'gone': removed_fraction(diagnosis, sim) if named else None,
        'seconds': seconds,
    }
    if case.level and right and case.hidden not in CAUSES:
        held = scatter_held(diagnosis.details.get('as_built'), sim.built)
        row['scatter_inside'] = float(np.mean(held)) if held else None
        row['scatter_told'] = len(held)
    own = next((effect for effect in diagnosis.effects if effect.name == case.hidden), None)
    if named and own is not None:
        row |= _beside_truth(sim, own.parameters)
    return row


def fitted(case: Case, sim: Simulated) -> dict[str, Any]:
    """Fit the hidden effect alone, to see whether its intervals hold the true values."""
    start = time.process_time()
    added = add_effect(sim.fit, [case.hidden], None, sim.catalogue, sim.fit)
    return {
        'verdict': 'fitted',
        'effects': (case.hidden,),
        'right': True,
        'alarm': True,
        **{key: getattr(added.fitted, key) for key in ('before', 'after', 'floor')},
        'seconds': time.process_time() - start,
        **_beside_truth(sim, added.values[case.hidden]),
    }


def _beside_truth(sim: Simulated, values: Mapping[str, Value]) -> dict[str, Any]:
    return {**fitted_values(values), 'truth': tuple(truth_of(sim, values).values())}


def removed_fraction(diagnosis: Diagnosis, sim: Simulated) -> float | None:
    """Return the fraction of (before - floor) that the named effects remove elsewhere."""
    point = found_values(diagnosis.effects, sim.catalogue, sim.robot)
    errors = []
    for one in ({}, point):
        markers = Predictor(sim.check, sim.robot, sim.catalogue).markers(one)
        if markers is None:
            return None
        errors.append(rms(sim.check.mean - markers))
    before, after, floor = *errors, diagnosis.noise_floor
    return (before - after) / (before - floor) if before > SAME_ERROR_RATIO * floor else None


def scatter_held(report: Mapping[str, Any] | None, built: Built) -> list[bool]:
    """Return for each printed kind of imperfections whether its interval holds the true size."""
    sizes = built.sizes
    return [
        kind['low'] <= sizes[kind['kind']] <= (kind['high'] or np.inf)
        for kind in (report or {'kinds': ()})['kinds']
        if kind['kind'] in sizes and kind['told']
    ]


@dataclass(frozen=True)
class Rate:
    """A proportion of hits in runs, with the 95 % interval of Wilson 1927."""

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

    def to_json(self) -> dict[str, Any]:
        """Return its share, its 95 % interval and its counts."""
        low, high = self.interval
        return {'share': self.share, 'low': low, 'high': high, **vars(self)}

    def __str__(self) -> str:
        if not self.runs:
            return '–'
        low, high = self.interval
        rate = 100.0 * self.hits / self.runs
        return f'{rate:.0f} % ({100 * low:.0f} to {100 * high:.0f}; {self.hits} of {self.runs})'


class Power:
    """How often an effect was seen and named, over its size, of rows measured in one way."""

    def __init__(self, robot: str, hidden: str, way: str, rows: Sequence[CaseRow]) -> None:
        self.robot, self.hidden = robot, hidden
        self.way = way  # design, noise and imperfections
        by_size = dict(sorted(grouped(binned(rows), lambda row: row.size).items()))
        self.sizes = tuple(by_size)  # times the typical one
        # anything said at all; it, or the class that it is in
        self.alarms = tuple(Rate.of(row.alarm for row in own) for own in by_size.values())
        self.right = tuple(Rate.of(row.right for row in own) for own in by_size.values())

    @property
    def smallest(self) -> float | None:
        """Return the size that is named in four of five cases, between those tried."""
        rates = [one.share or 0.0 for one in self.right]
        for i, rate in enumerate(rates):
            if min(rates[i:]) >= DETECTION_POWER:
                if i == 0:
                    return self.sizes[0]
                part = (DETECTION_POWER - rates[i - 1]) / max(rate - rates[i - 1], 1e-12)
                ends = np.log([self.sizes[i - 1], self.sizes[i]])
                return float(np.exp(ends[0] + part * (ends[1] - ends[0])))
        return None


def methods(rows: Sequence[CaseRow]) -> Callable[[CaseRow], str]:
    """Return a function that describes how a case was measured, where that differs in the rows."""
    words = {'design': '{}', 'noise': 'noise {}', 'level': 'imperfections x {:g}'}
    varying = [name for name in words if len({getattr(row, name) for row in rows}) > 1]
    return lambda row: '; '.join(words[name].format(getattr(row, name)) for name in varying)


def powers(rows: Sequence[CaseRow]) -> list[Power]:
    """Count how often every effect was seen, size by size."""
    method_of = methods(rows)
    hidden = [row for row in rows if row.hidden != NOTHING]
    ways = grouped(hidden, lambda row: (row.robot, row.hidden, method_of(row)))
    return [Power(*key, members) for key, members in ways.items()]


def binned(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """Put sizes that were drawn into bins; sizes that were listed stay."""
    if len({row.size for row in rows}) <= 2 * BINS:
        return list(rows)
    logs = np.log([row.size for row in rows])
    edges = np.linspace(logs.min(), logs.max() + 1e-9, BINS + 1)
    which = np.searchsorted(edges, logs, side='right') - 1
    middles = np.exp(0.5 * (edges[:-1] + edges[1:]))
    return [replace(row, size=float(middles[i])) for row, i in zip(rows, which, strict=True)]


def confusion(rows: Sequence[CaseRow]) -> tuple[list[str], list[str], list[list[int]]]:
    """Return what was hidden, what was said (a verdict, or names), and how often."""
    counts: collections.Counter[tuple[str, str]] = collections.Counter()
    for row in rows:
        said = row.verdict.replace('_', ' ')
        if row.verdict in NAMING and row.effects:
            said = row.hidden if row.right else ' + '.join(row.effects)
        counts[row.hidden, said] += 1
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
            z.append(abs(true - value) / half if half > 0.0 else np.inf if true != value else 0.0)
    full = normal_ppf(0.975)
    limits = [(nominal, normal_ppf(0.5 + 0.5 * nominal) / full) for nominal in NOMINAL]
    return [(nominal, Rate.of(one <= limit for one in z)) for nominal, limit in limits]


def rates(rows: Sequence[CaseRow]) -> dict[str, Rate]:
    """Return the rates that the diagnosis is judged by."""
    effects = [row for row in rows if row.hidden not in (*CAUSES, NOTHING)]
    named = [row for row in effects if row.right]
    visible = [row for row in effects if row.visible]
    causes = [row for row in rows if row.hidden in CAUSES]
    clean = [row for row in rows if row.hidden == NOTHING]
    twins = {effect.name for effect in load_catalogue() if effect.scales_bends}
    single = [row for row in named if row.hidden not in twins]
    return {
        'right, of all effects': Rate.of(row.right for row in effects),
        'right, of those that stand out of the noise': Rate.of(row.right for row in visible),
        'wrong names, of all effects': Rate.of(row.wrong_name for row in effects),
        'a single name, effects without a twin': Rate.of(len(row.group) <= 1 for row in single),
        'true values inside their 95 % intervals': Rate.of(
            held for row in effects for held in row.held
        ),
        'named effects that take 90 % of the error off other postures': Rate.of(
            row.gone >= REMOVED_FRACTION for row in named if row.gone is not None
        ),
        'scatter inside its interval, where it is told': Rate(
            sum(round((row.scatter_inside or 0.0) * row.scatter_told) for row in rows),
            sum(row.scatter_told for row in rows),
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


def rates_by_hidden(rows: Sequence[CaseRow]) -> list[dict[str, Any]]:
    """Return the rates of everything that was hidden, robot by robot."""
    return [
        {
            'robot': robot,
            'hidden': hidden,
            'right': Rate.of(row.right for row in members),  # of all sizes
            'right_if_seen': Rate.of(row.right for row in members if row.visible),
            'wrong_names': Rate.of(row.wrong_name for row in members),
            'inside': Rate.of(held for row in members for held in row.held),
        }
        for (robot, hidden), members in grouped(rows, lambda r: (r.robot, r.hidden)).items()
    ]


def to_json(rows: Sequence[CaseRow]) -> dict[str, Any]:
    """Return all figures as plain data."""
    return {
        'cases': len(rows),
        'rates': plain(rates(rows)),
        'rates_by_robot': plain(rates_by_robot(rows)),
        'rates_by_hidden': plain(rates_by_hidden(rows)),
        'power': [{**plain(vars(one)), 'smallest': one.smallest} for one in powers(rows)],
        'coverage': [{'nominal': nominal, **plain(rate)} for nominal, rate in coverage(rows)],
        'seconds': float(np.median([row.seconds for row in rows])) if rows else None,
    }
