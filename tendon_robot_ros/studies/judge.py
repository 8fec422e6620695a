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
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis, Value
from ..diagnosis.verdict import Verdict
from ..model.model import Model
from ..model.versions import UserEffect, catalogue_of
from ..simulation.hidden import CAUSES, Built
from ..simulation.measurements import SimulatedNoise
from .cases import NOTHING, Case, Design, PlannedRobot, Simulated, is_visible, simulated, truth_of
from .running import ERROR, Row

DIAGNOSIS, INTERVALS = 'diagnosis', 'intervals'
QUESTIONS = (DIAGNOSIS, INTERVALS)
NAMING = tuple(verdict for verdict in Verdict if verdict.may_add)
# [1] error over the noise floor below which nothing is left of which a share could be gone
ERROR_STANDS_OUT = 1.2


@dataclass(frozen=True, kw_only=True)
class CaseRow(Row):
    """What came of a simulated case; `parameter`: of the hidden effect where it was named."""

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
    gone: float | None = None  # share of (before - floor) gone on postures not used
    scatter_inside: float | None = None  # share of the kinds whose true size is in its interval
    scatter_told: int = 0  # such kinds whose size was printed
    seconds: float = 0.0  # of processor time, for the diagnosis alone
    truth: tuple[float, ...] = ()

    @property
    def scatter_held(self) -> list[bool]:
        """Whether the size of each kind of imperfections that was printed is in its interval."""
        if self.scatter_inside is None:
            return []
        held = round(self.scatter_inside * self.scatter_told)
        return [True] * held + [False] * (self.scatter_told - held)

    @property
    def held(self) -> list[bool]:
        """Whether each true value lies in its 95 % interval; none where none was fitted."""
        each = zip(self.low, self.truth, self.high, strict=True)
        return [low <= true <= high for low, true, high in each]


@dataclass(frozen=True)
class Setup:
    """What every simulated case needs: a study."""

    arms: tuple[PlannedRobot, ...]
    designs: tuple[Design, ...]
    noises: tuple[tuple[str, SimulatedNoise], ...]
    seed: int = 0
    question: str = DIAGNOSIS
    effects: tuple[UserEffect, ...] = field(default=(), repr=False)

    def arm(self, name: str) -> PlannedRobot:
        """Return a robot by its name."""
        return next(arm for arm in self.arms if arm.name == name)

    def compile(self) -> None:
        """Have the kernel compiled before workers would do it side by side."""
        for arm in self.arms:
            Model(arm.robot, catalogue_of(self.effects)).arrays.link()

    def judge(self, case: Case) -> CaseRow:
        """Simulate, diagnose, and hold the verdict against the truth."""
        start = time.process_time()
        try:
            made = simulated(
                case,
                self.arm(case.robot),
                self.designs[case.design],
                self.noises[case.noise][1],
                catalogue_of(self.effects),
                self.seed,
                own_model=self.question == INTERVALS,
            )
            start = time.process_time()
            found = {DIAGNOSIS: _diagnosed, INTERVALS: _fitted}[self.question](case, made)
        except Exception as error:  # whatever a case meets, the others go on and it is counted
            found = {'verdict': ERROR, 'problem': f'{type(error).__name__}: {error}'}
        return self._row(case, {'seconds': time.process_time() - start, **found})

    def lost(self, case: Case, workers: int) -> CaseRow:
        """Return the row of a case at which every worker died."""
        told = {'verdict': ERROR, 'problem': f'{workers} workers died over it'}
        return self._row(case, told)

    def _row(self, case: Case, found: Mapping[str, Any]) -> CaseRow:
        return CaseRow(
            key=case.key,
            robot=case.robot,
            hidden=case.hidden,
            size=case.size,
            number=case.number,
            design=self.designs[case.design].name,
            noise=self.noises[case.noise][0],
            level=case.level,
            **found,
        )


def told_by(found: Diagnosis) -> dict[str, Any]:
    """Return what a row holds of a diagnosis."""
    errors = {
        'before': found.error_before,
        'after': found.error_after,
        'floor': found.noise_floor,
    }
    return {
        'verdict': str(found.verdict),
        'effects': tuple(effect.name for effect in found.effects),
        'group': found.cannot_tell_apart,
        **{name: float(error) if np.isfinite(error) else None for name, error in errors.items()},
    }


def fitted_values(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return what a row holds of fitted parameters."""
    return {
        'parameter': tuple(values),
        'value': tuple(float(value.value) for value in values.values()),
        'low': tuple(float(value.low) for value in values.values()),
        'high': tuple(float(value.high) for value in values.values()),
    }


def _diagnosed(case: Case, made: Simulated) -> dict[str, Any]:
    start = time.process_time()
    found = diagnose(made.fit, catalogue=made.catalogue, workers=1)
    seconds = time.process_time() - start
    listed = {*(effect.name for effect in found.effects), *found.cannot_tell_apart}
    named = found.verdict in NAMING
    if case.hidden == NOTHING:
        right = found.verdict is Verdict.ADEQUATE
    elif case.hidden in CAUSES:
        right = found.verdict is Verdict.OUTSIDE_CATALOGUE
    else:
        right = named and case.hidden in listed
    row = {
        **told_by(found),
        'right': right,
        'wrong_name': named and case.hidden not in listed,
        'alarm': found.verdict is not Verdict.ADEQUATE,
        'visible': is_visible(case, made),
        'gone': error_gone(found, made) if named else None,
        'seconds': seconds,
    }
    if case.level and right and case.hidden not in CAUSES:
        held = scatter_held(found.details.get('as_built'), made.built)
        row['scatter_inside'] = float(np.mean(held)) if held else None
        row['scatter_told'] = len(held)
    own = next((effect for effect in found.effects if effect.name == case.hidden), None)
    if named and own is not None:
        row |= _beside_truth(case, made, own.parameters)
    return row


def _fitted(case: Case, made: Simulated) -> dict[str, Any]:
    """Fit the hidden effect alone: whether its intervals hold."""
    added = add_effects(made.fit, [case.hidden], None, made.catalogue, made.fit)
    errors = added.fitted
    return {
        'verdict': 'fitted',
        'effects': (case.hidden,),
        'right': True,
        'alarm': True,
        'before': errors.before,
        'after': errors.after,
        'floor': errors.floor,
        **_beside_truth(case, made, added.values[case.hidden]),
    }


def _beside_truth(case: Case, made: Simulated, values: Mapping[str, Value]) -> dict[str, Any]:
    truth = tuple(truth_of(case, made, values).values())
    return {**fitted_values(values), 'truth': truth}


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
    return (before - after) / (before - floor) if before > ERROR_STANDS_OUT * floor else None


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
