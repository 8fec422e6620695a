"""Section IV of Kato et al. 2015, reproduced: the published numbers beside ours."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from .friction import PUBLISHED_FRICTION, SlipFriction, rehearsals
from .paper_motion import MotionExperiment, Robots, motion
from .paper_pulls import HEIGHT_NAMES, DisplacementExperiment, displacement_experiment
from .paper_tensions import (
    PUBLISHED_ERRORS_M,
    SmallExperiment,
    TensionExperiment,
    small_experiment,
    tension_experiment,
)

Range = tuple[float, float, float]
MET_WITHIN = 0.15  # [1] relative difference that counts as met: what else is assumed moves as much


SCALES = {'1': 1.0, '%': 100.0, 'mm': 1e3, '°': 180.0 / np.pi}  # of the printed units


@dataclass(frozen=True)
class Number:
    """A published number beside ours, and the range over what the paper leaves open."""

    section: str
    what: str
    unit: str
    published: float
    ours: float
    low: float
    high: float
    why: str

    @classmethod
    def of(
        cls, section: str, what: str, unit: str, published: float, ours: Range, why: str
    ) -> Number:
        """Put a published number [unit] beside ours: (ours, low, high) in SI."""
        own, low, high = (SCALES[unit] * one for one in ours)
        return cls(section, what, unit, published, own, low, high, why)

    @property
    def difference(self) -> float:
        """Ours against the published number, relative [1]."""
        return self.ours / self.published - 1.0

    @property
    def met(self) -> str:
        """How the published number is met: 'within 15 %', 'in range' or 'not met'."""
        if abs(self.difference) <= MET_WITHIN:
            return 'within 15 %'
        return 'in range' if self.low <= self.published <= self.high else 'not met'


@dataclass(frozen=True, eq=False)
class Paper:
    """Section IV, reproduced."""

    robots: Robots
    friction: dict[str, SlipFriction]
    motion: MotionExperiment
    displacement: DisplacementExperiment
    tension: TensionExperiment
    small: SmallExperiment

    @property
    def rows(self) -> list[Number]:
        """Every published number, in the order of the paper."""
        found = [*_friction(self.friction), *_motion(self.motion)]
        found += [*_displacement(self.displacement), *_tension(self.tension), *_small(self.small)]
        return found

    def to_json(self) -> dict[str, Any]:
        """Return the table as plain data."""
        return {
            'rows': [
                {**asdict(row), 'difference': row.difference, 'met': row.met} for row in self.rows
            ]
        }


def reproduce(robots: Robots, progress: Callable[[str, int, int], None] | None = None) -> Paper:
    """Run all experiments; `progress` is called with (what, done, total)."""
    steps: dict[str, Callable[[], Any]] = {
        'friction': rehearsals,
        'motion': lambda: motion(robots.target),
        'displacement': lambda: displacement_experiment(robots.prototype),
        'tension': lambda: tension_experiment(robots.single),
        'small': lambda: small_experiment(robots.small),
    }
    found = {}
    for done, (name, run) in enumerate(steps.items()):
        if progress:
            progress(name, done, len(steps))
        found[name] = run()
    return Paper(robots=robots, **found)


def _friction(frictions: dict[str, SlipFriction]) -> Iterator[Number]:
    why = 'rehearsed with drawn slip angles (SD 0.03 assumed); ± is the 95 % interval of the mean'
    for scale, one in frictions.items():
        what, ours = f'friction coefficient, {scale}, n = {one.n}', (one.mean, one.low, one.high)
        yield Number.of('IV.A', what, '1', PUBLISHED_FRICTION[scale][0], ours, why)


def _motion(experiment: MotionExperiment) -> Iterator[Number]:
    first = next(one for one in experiment.arrangements if one.across > 0.0)
    why = f'opposite-side pair, {first.name}; the range is over ±1° to ±5° for "180°"'
    ours = (first.across, first.low, first.high)
    yield Number.of('IV.B', 'tip positions at the 180° view, across', 'mm', 50.0, ours, why)
    bends = [one.bending[0] for one in (experiment.stiffening, experiment.every_tendon)]
    what = 'cost of ignoring the tendons’ stiffness (A7), proximal bends'
    why = 'six tendons make a tenth of a cell’s stiffness; six or all twelve counted'
    yield Number.of('IV.B', what, '%', 10.0, (bends[0], min(bends), max(bends)), why)


def _displacement(experiment: DisplacementExperiment) -> Iterator[Number]:
    of_error = '2° scatter per cell; mean of 200 simulated prototypes, 5 to 95 % of them'
    of_sd = (
        'SD over 15 trials (assumed to be what ± means) with cells that change by 1° from '
        'trial to trial; the range is over 0 to 2°, 5 to 95 % of prototypes'
    )
    for model, published, sd in (('FKM', 5.9, 2.9), ('PCCA', 23.7, 3.6)):
        spread, what = experiment.errors[HEIGHT_NAMES[0], model], 'tip error at given pulls'
        errors, sds = (spread.mean, spread.low, spread.high), (spread.sd, *spread.sd_range)
        yield Number.of('IV.C', f'{what}, {model}', 'mm', published, errors, of_error)
        yield Number.of('IV.C', f'its ±, {model}', 'mm', sd, sds, of_sd)
    why = 'put in; taut wires hold the sum over each section, which takes some of it away'
    ours = (experiment.scatter,) * 3
    yield Number.of('IV.C', 'scatter of the mean angle per cell', '°', 2.0, ours, why)


def _tension(experiment: TensionExperiment) -> Iterator[Number]:
    why = (
        f'one hinge lever of {1e3 * experiment.lever:.2f} mm for all four; trials scatter by '
        '1 mm; the range is over levers within 12.5 %'
    )
    for key, published in PUBLISHED_ERRORS_M.items():
        ours = (experiment.largest[key], experiment.low[key], experiment.high[key])
        what = f'largest error, {key[0]}, {key[1]}'
        yield Number.of('IV.D', what, 'mm', 1e3 * published, ours, why)


def _small(experiment: SmallExperiment) -> Iterator[Number]:
    one, low, high = experiment.as_assumed, experiment.low, experiment.high
    share = 0.5e-3 / one.hinge  # of the lever that makes the published error
    why = (
        'one reading. Without hinge friction the FKM is met exactly (0 mm); with the lever of '
        'the 10:1 prototype, scaled with the arm, it is off as ours. The reading asks for '
        f'about {100.0 * share:.0f} % of that lever; nothing else fixes it'
    )
    ours = (one.hinge, 0.0, high.hinge)
    yield Number.of('IV.E', 'tip at 90°, FKM', 'mm', 0.5, ours, why)
    why = (
        'distance of the models at equal tension; the range is over arm 1.0 to 1.6 mm, 15 to '
        '60 cells, friction 0.28 to 0.34, and equal pull instead of tension'
    )
    ours = (one.tension, low.pull, high.tension)
    yield Number.of('IV.E', 'tip at 90°, PCCA', 'mm', 7.6, ours, why)
