"""How far to trust a diagnosis: alarm rate and smallest sizes, on the user's own postures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from ..common.errors import Progress, listener
from ..common.workers import Workers
from ..data import DataSet
from ..effects import load_catalogue
from ..inference.candidates import Candidate
from ..inference.fit import Fit
from ..inference.fitter import FAILURES
from ..inference.intervals import QUANTILE
from ..inference.noise import Noise
from ..inference.predict import FreeParameter, Point, Predictor
from ..inference.session import Session
from ..inference.statistics import chi2_isf
from ..robot import Robot
from .select import gather
from .verdict import ALARM_LEVEL, is_alarming

SECONDS = 50.0  # [s] of simulations, so that a report with them takes a minute
DETECTION_POWER = 0.8  # [1] power of a test, as is usual (Cohen 1988)


@dataclass(frozen=True)
class SmallestSize:
    """Smallest detectable size of one parameter; None where none within its bounds is."""

    free: FreeParameter
    size: float | None


def smallest_sizes(
    session: Session, base: Fit, candidates: Sequence[Candidate]
) -> tuple[SmallestSize, ...]:
    """
    Return the smallest sizes of missing effects, parameter by parameter.

    At this size the whitened change of the markers, less the part that the declared tolerances
    explain, is long enough for the likelihood ratio to raise the alarm with the probability
    `DETECTION_POWER`.
    """
    sizes = []
    for candidate in candidates:
        effect = session.catalogue[candidate.names[0]]
        if candidate.present or effect.always_on or effect.stage == 'memory':
            continue
        for free in candidate.frees:
            one_sided = len(candidate.frees) == 1 and free.parameter.neutral in (
                free.parameter.low,
                free.parameter.high,
            )
            alpha = ALARM_LEVEL / max(len(candidates), 1) * (2.0 if one_sided else 1.0)
            length = np.sqrt(noncentrality(len(candidate.frees), alpha))
            sizes.append(SmallestSize(free, _size(session, base, free, float(length))))
    return tuple(sizes)


def _size(session: Session, base: Fit, free: FreeParameter, length: float) -> float | None:
    """Return the size whose whitened change of the markers has a length, by rescaling the size."""
    parameter, size = free.parameter, 0.1 * free.parameter.typical
    start = base.point.get(free, session.predictor.value(free))
    side = 1.0 if start + size <= parameter.high else -1.0
    for _ in range(8):
        markers = session.predictor.markers({**base.point, free: start + side * size})
        if markers is None:
            return None
        try:  # the tolerances explain a part of the change
            change = float(np.sqrt(session.mimic(markers, (), base.point, base).chi2))
        except FAILURES:
            return None
        if change <= 0.0:
            return None
        ratio = length / change
        size *= float(np.clip(ratio, 0.1, 10.0))
        if abs(ratio - 1.0) < 0.02:
            break
    return size if parameter.low <= start + side * size <= parameter.high else None


@cache
def noncentrality(freedom: int, alpha: float) -> float:
    """Return the noncentrality at which a chi² test of this level has the `DETECTION_POWER`."""
    threshold = chi2_isf(alpha, freedom)
    noise = np.random.default_rng(0).normal(size=(20_000, freedom))
    rest = (noise[:, 1:] ** 2).sum(axis=1)
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        power = float(((noise[:, 0] + middle) ** 2 + rest > threshold).mean())
        low, high = (middle, high) if power < DETECTION_POWER else (low, middle)
    return high**2


Task = tuple[int, FreeParameter | None, float]  # seed, hidden parameter and its size


@dataclass(frozen=True)
class Trust:
    """Result of a parametric bootstrap of the whole diagnosis."""

    runs: int  # simulated data sets with nothing missing
    alarms: int
    low: float  # 95 % interval of the alarm rate
    high: float
    detectable: tuple[SmallestSize, ...]  # smallest sizes that raise an alarm four times in five
    checked: int  # simulated data sets with one such effect
    detected: int

    def to_json(self) -> dict[str, Any]:
        """Return plain data; sizes in SI, null where no size within the bounds would show."""
        sizes: dict[str, dict[str, Any]] = {}
        for one in self.detectable:
            sizes.setdefault(one.free.effect, {})[one.free.key] = {
                'size': one.size,
                'unit': one.free.parameter.unit,
            }
        rate = self.alarms / self.runs if self.runs else None
        return {
            'alarm_rate': rate,
            'alarm_rate_low': self.low,
            'alarm_rate_high': self.high,
            'runs': self.runs,
            'detectable': sizes,
            'checked': self.checked,
            'detected': self.detected,
        }


def assess(
    dataset: DataSet,
    files: Sequence[str] = (),
    workers: int = 1,
    seconds: float = SECONDS,
    runs: int = 200,
    progress: Progress | None = None,
) -> Trust | None:
    """
    Simulate measurements of the description, with the noise of the data, and diagnose them.

    Parameters
    ----------
    dataset : DataSet
        Its robot is the truth of the simulations, its postures are measured again.
    files : sequence of str
        The user's own effects.
    workers : int
        Processes.
    seconds : float
        When to stop.
    runs : int
        Largest number of clean simulations; half as many with an effect hidden.
    progress : callable, optional
        Called with (what, done, total), in seconds: they, not the simulations, end it.

    Returns
    -------
    Trust
        None where the noise is neither declared nor measured by repeated trials.

    """
    robot, show = dataset.robot, listener(progress)
    session = Session(dataset, robot, load_catalogue(files), workers=1)
    if session.predictor.markers({}) is None or not session.weigh({}):
        return None
    fits = gather(session)
    smallest = smallest_sizes(session, fits.base, [r.candidate for r in fits.singles])
    hidden = [one for one in smallest if one.size is not None]
    clean: list[Task] = [(seed, None, 0.0) for seed in range(runs)]
    sized: list[Task] = [
        (10_000 + i, hidden[i % len(hidden)].free, hidden[i % len(hidden)].size or 0.0)
        for i in range(runs // 2 if hidden else 0)
    ]
    job = Job(dataset, robot, session.noise, tuple(files))
    start, quiet, loud = time.monotonic(), Tally(), Tally()

    def note(what: str) -> None:
        show(f'{what} [s]', min(round(time.monotonic() - start), round(seconds)), round(seconds))

    with Workers(workers) as spread:
        early, late = start + 0.65 * seconds, start + seconds
        quiet.collect(spread.run(job.alarm, clean, early), 'simulated with nothing missing', note)
        loud.collect(spread.run(job.alarm, sized, late), 'simulated with an effect', note)
    low, high = wilson(quiet.hits, quiet.runs)
    return Trust(quiet.runs, quiet.hits, low, high, smallest, loud.runs, loud.hits)


@dataclass(frozen=True)
class Job:
    """What every simulation needs; goes to the worker processes."""

    dataset: DataSet
    robot: Robot
    noise: Noise
    files: tuple[str, ...]

    def alarm(self, task: Task) -> bool | None:
        """Return whether a simulated data set raises the alarm; None without equilibrium."""
        seed, free, size = task
        catalogue = load_catalogue(self.files)
        session = Session(self.dataset, self.robot, catalogue, workers=1)
        random = np.random.default_rng([seed, 71])
        point: dict[FreeParameter, float] = {
            n.free: float(random.normal(n.centre, n.spread)) for n in session.nuisances
        }
        if free is not None:
            point[free] = size
        simulated = simulated_measurements(session.predictor, point, self.noise, random)
        if simulated is None:
            return None
        session = Session(simulated, self.robot, catalogue, workers=1)
        return gather(session).answer(is_alarming) if session.weigh({}) else None


def simulated_measurements(
    predictor: Predictor, point: Point, noise: Noise, random: np.random.Generator
) -> DataSet | None:
    """Return the data set with measurements simulated by the model at a point."""
    dataset = predictor.dataset
    by_trial = dataset.inputs_by_trial
    P, Q, m = by_trial.shape
    setting = 1.0 + noise.setting * random.normal(size=(P, 1, m))
    factors = np.maximum(setting * (1.0 + noise.trial * random.normal(size=(P, Q, m))), 0.0)
    trials = [predictor.markers(point, by_trial[:, q] * factors[:, q]) for q in range(Q)]
    if any(trial is None for trial in trials):
        return None
    positions = np.stack([trial for trial in trials if trial is not None], axis=1)
    positions = positions + random.normal(0.0, noise.position, positions.shape)
    if noise.shift:
        positions = positions + random.normal(0.0, noise.shift, (P, Q, 1, 3))
    return replace(dataset, positions=np.where(dataset.mask[..., None], positions, np.nan))


@dataclass
class Tally:
    """Simulated data sets, and how many raised the alarm."""

    runs: int = 0
    hits: int = 0

    def collect(
        self, alarms: Iterable[tuple[int, object]], what: str, note: Callable[[str], None]
    ) -> None:
        """Count the simulations; those without equilibrium do not count."""
        note(f'0 {what}')
        for _, alarm in alarms:
            self.runs += isinstance(alarm, bool)
            note(f'{self.runs} {what}')
            self.hits += alarm is True


def wilson(hits: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate (Wilson 1927)."""
    if runs == 0:
        return 0.0, 1.0
    z2, rate = QUANTILE**2, hits / runs
    centre = (rate + z2 / (2 * runs)) / (1.0 + z2 / runs)
    half = np.sqrt(z2 * (rate * (1.0 - rate) / runs + z2 / (4 * runs**2))) / (1.0 + z2 / runs)
    return max(float(centre - half), 0.0), min(float(centre + half), 1.0)
