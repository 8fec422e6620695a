"""A case, diagnosed, held against the truth: a row of the table."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..comparison.noise import rms
from ..comparison.predict import Predictor, frees_of
from ..diagnosis.add import add_effects
from ..diagnosis.decide import Verdict
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis, Value
from ..model.model import Model
from ..simulation.hidden import CAUSES, Built
from ..simulation.measurements import SimulatedNoise
from .cases import NOTHING, Case, Design, PlannedRobot, Simulated, is_visible, simulated, truth_of
from .versions import UserEffect, catalogue_of, compiled_once

DIAGNOSIS, INTERVALS = 'diagnosis', 'intervals'
QUESTIONS = (DIAGNOSIS, INTERVALS)
NAMING = tuple(verdict for verdict in Verdict if verdict.may_add)
ERROR = 'error'


@dataclass(frozen=True)
class CaseRow:
    """What came of a case."""

    key: str
    robot: str
    hidden: str
    size: float
    number: int
    design: str
    noise: str
    level: float
    verdict: str
    effects: tuple[str, ...] = ()
    group: tuple[str, ...] = ()  # that cannot be told apart
    right: bool = False
    wrong_name: bool = False
    alarm: bool = False
    visible: bool = True  # the truth stands out of the noise
    gone: float | None = None  # share of (before - floor) gone on postures not used
    scatter_inside: float | None = None  # share of the kinds whose true size is in its interval
    before: float | None = None  # [m] error
    after: float | None = None
    floor: float | None = None
    seconds: float = 0.0  # of processor time, for the diagnosis alone
    problem: str = ''
    parameter: tuple[str, ...] = ()  # of the hidden effect where it was named
    truth: tuple[float, ...] = ()
    value: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    scatter_told: int = 0  # such kinds whose size was printed

    @property
    def scatter_held(self) -> list[bool]:
        """Whether the size of each kind of imperfections that was printed is in its interval."""
        if self.scatter_inside is None:
            return []
        told = max(self.scatter_told, 1)  # older tables have only the share
        held = int(self.scatter_inside * told + 1e-9)
        return [True] * held + [False] * (told - held)

    @property
    def held(self) -> list[bool]:
        """Whether each true value lies in its 95 % interval; none where none was fitted."""
        each = zip(self.low, self.truth, self.high, strict=True)
        return [low <= true <= high for low, true, high in each]


@dataclass(frozen=True)
class Setup:
    """What every case needs; goes to the workers with every chunk."""

    arms: tuple[PlannedRobot, ...]
    designs: tuple[Design, ...]
    noises: tuple[tuple[str, SimulatedNoise], ...]
    seed: int = 0
    question: str = DIAGNOSIS
    effects: tuple[UserEffect, ...] = field(default=(), repr=False)

    def arm(self, name: str) -> PlannedRobot:
        """Return a robot by its name."""
        return next(arm for arm in self.arms if arm.name == name)


@dataclass(frozen=True)
class Chunk:
    """Cases that a worker judges one after the other."""

    setup: Setup
    cases: tuple[Case, ...]


def compile_for(setup: Setup) -> None:
    """Have the kernel compiled before workers would do it side by side."""
    for arm in setup.arms:
        Model(arm.robot, catalogue_of(setup.effects)).arrays.link()


def judge_chunk(chunk: Chunk) -> list[CaseRow]:
    """Judge cases, in a worker."""
    setup = chunk.setup
    with compiled_once(setup.question, setup.effects):
        return [judge(setup, case) for case in chunk.cases]


def judge(setup: Setup, case: Case) -> CaseRow:
    """Simulate, diagnose, and hold the verdict against the truth."""
    catalogue, start = catalogue_of(setup.effects), time.process_time()
    asks = {DIAGNOSIS: _diagnosed, INTERVALS: _fitted}[setup.question]
    try:
        made = simulated(
            case,
            setup.arm(case.robot),
            setup.designs[case.design],
            setup.noises[case.noise][1],
            catalogue,
            setup.seed,
            own_model=setup.question == INTERVALS,
        )
        start = time.process_time()
        found = asks(case, made)
    except Exception as error:  # whatever a case meets, the others go on and it is counted
        found = {'verdict': ERROR, 'problem': f'{type(error).__name__}: {error}'}
    return _row(setup, case, {'seconds': time.process_time() - start, **found})


def lost(setup: Setup, case: Case, workers: int) -> CaseRow:
    """Return the row of a case at which every worker died."""
    told = {'verdict': ERROR, 'problem': f'{workers} workers died over it'}
    return _row(setup, case, told)


def _row(setup: Setup, case: Case, found: Mapping[str, Any]) -> CaseRow:
    return CaseRow(
        key=case.key,
        robot=case.robot,
        hidden=case.hidden,
        size=case.size,
        number=case.number,
        design=setup.designs[case.design].name,
        noise=setup.noises[case.noise][0],
        level=case.level,
        **found,
    )


def _diagnosed(case: Case, made: Simulated) -> dict[str, Any]:
    start = time.process_time()
    found = diagnose(made.fit, catalogue=made.catalogue, workers=1)
    seconds = time.process_time() - start
    names = tuple(effect.name for effect in found.effects)
    listed = {*names, *found.cannot_tell_apart}
    named = found.verdict in NAMING
    if case.hidden == NOTHING:
        right = found.verdict is Verdict.ADEQUATE
    elif case.hidden in CAUSES:
        right = found.verdict is Verdict.OUTSIDE_CATALOGUE
    else:
        right = named and case.hidden in listed
    own = next((effect for effect in found.effects if effect.name == case.hidden), None)
    told = case.level and right and case.hidden not in CAUSES
    return {
        'verdict': str(found.verdict),
        'effects': names,
        'group': found.cannot_tell_apart,
        'right': right,
        'wrong_name': named and case.hidden not in listed,
        'alarm': found.verdict is not Verdict.ADEQUATE,
        'visible': is_visible(case, made),
        'gone': error_gone(found, made) if named else None,
        **(_scatter(found, made.built) if told else {}),
        'before': _number(found.error_before),
        'after': _number(found.error_after),
        'floor': _number(found.noise_floor),
        'seconds': seconds,
        **(_values(case, made, own.parameters) if named and own else {}),
    }


def _fitted(case: Case, made: Simulated) -> dict[str, Any]:
    """Fit the hidden effect alone: whether its intervals hold."""
    added = add_effects(made.fit, [case.hidden], None, made.catalogue, made.fit)
    values = added.values[case.hidden]
    errors = added.fitted
    return {
        'verdict': 'fitted',
        'effects': (case.hidden,),
        'right': True,
        'alarm': True,
        'before': errors.before,
        'after': errors.after,
        'floor': errors.floor,
        **_values(case, made, values),
    }


def _values(case: Case, made: Simulated, values: Mapping[str, Value]) -> dict[str, Any]:
    """Return the fitted parameters with their intervals beside the truth."""
    told = [(v.value, v.low, v.high) for v in values.values()]
    value, low, high = zip(*told, strict=True) if told else ((), (), ())
    truth = tuple(truth_of(case, made, values).values())
    return {
        'parameter': tuple(values),
        'truth': truth,
        'value': value,
        'low': low,
        'high': high,
    }


def error_gone(found: Diagnosis, made: Simulated) -> float | None:
    """Share of (before - floor) that the named effects remove on postures not used."""
    keys = {
        (free.effect, free.key): free
        for free in frees_of([e.name for e in found.effects], made.catalogue, made.robot)
    }
    point = {
        keys[effect.name, key]: value.value
        for effect in found.effects
        for key, value in effect.parameters.items()
    }
    errors = []
    for one in ({}, point):
        markers = Predictor(made.check, made.robot, made.catalogue).markers(one)
        if markers is None:
            return None
        errors.append(rms(made.check.mean - markers))
    before, after, floor = *errors, found.noise_floor
    return (before - after) / (before - floor) if before > 1.2 * floor else None


def _scatter(found: Diagnosis, built: Built) -> dict[str, Any]:
    held = scatter_held(found.details.get('as_built'), built)
    inside = float(np.mean(held)) if held else None
    return {'scatter_inside': inside, 'scatter_told': len(held)}


def scatter_held(report: Mapping[str, Any] | None, built: Built) -> list[bool]:
    """Tell of each kind of imperfections whose size is printed whether its interval holds it."""
    sizes = built_sizes(built)
    return [
        kind['low'] <= sizes[kind['kind']] <= (kind['high'] or np.inf)
        for kind in (report or {'kinds': ()})['kinds']
        if kind['kind'] in sizes and kind['told']
    ]


def built_sizes(built: Built) -> dict[str, float]:
    """Return how much the cells scatter (rms): their stiffness [1], their kinks [rad]."""
    members = {
        'cell_stiffness': built.stiffness,
        'cell_kink': built.kink[:, built.kink.any(axis=0)],
    }
    return {name: float(np.sqrt(np.mean(np.square(one)))) for name, one in members.items()}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
