"""How far to trust a diagnosis: alarm rate and smallest sizes, on the user's own postures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np

from ..common.errors import InputError, Progress, listener
from ..common.workers import Workers
from ..data import DataSet
from ..effects import load_catalogue
from ..inference.candidates import Ranked
from ..inference.fit import Nuisance
from ..inference.noise import Noise
from ..inference.predict import FreeParameter, Point, Predictor
from ..inference.session import Question
from ..inference.statistics import QUANTILE, chi2_noncentrality
from ..robot.inputs import disturbed
from .select import gather
from .verdict import ALARM_LEVEL, is_alarming

SECONDS = 50.0  # [s] of simulations, so that a report with them takes a minute
DETECTION_POWER = 0.8  # [1] power of a test, as is usual (Cohen 1988)


@dataclass(frozen=True)
class SmallestSize:
    """Smallest detectable size of one parameter; None where none within its bounds is."""

    free: FreeParameter
    size: float | None
    alone: bool  # whether it is the only parameter of its effect
    value: float  # of the parameter that is so far from its neutral value

    @property
    def plain(self) -> dict[str, Any]:
        """Plain data for JSON; `size` in SI."""
        parameter = self.free.parameter
        return {'size': self.size, 'parameter': self.free.key, 'unit': parameter.unit}


def smallest_sizes(
    singles: Sequence[Ranked], nuisances: Sequence[Nuisance]
) -> tuple[SmallestSize, ...]:
    """
    Return the smallest sizes of missing effects, parameter by parameter, by the fits with each.

    At this size the likelihood ratio raises the alarm with the probability `DETECTION_POWER`:
    the other parameters of the effect stay, declared tolerances and imperfections give way.
    """
    sizes, declared = [], {nuisance.free: nuisance.spread for nuisance in nuisances}
    for fit in (ranked.fit for ranked in singles if not ranked.present):
        k, alpha = len(fit.frees), (2.0 if fit.one_sided else 1.0) * ALARM_LEVEL / len(singles)
        known = np.flatnonzero(np.isfinite(np.diag(fit.covariance)[:k]))
        information = np.diag(np.linalg.pinv(fit.covariance[np.ix_(known, known)]))
        spread = np.full(k, np.inf)
        spread[known] = 1.0 / np.sqrt(information)
        spread = np.hypot(spread, [declared.get(free, 0.0) for free in fit.frees])
        spread *= np.sqrt(chi2_noncentrality(DETECTION_POWER, alpha, k))
        for free, start, size in zip(
            fit.frees, np.broadcast_to(fit.described, k), spread, strict=True
        ):
            value = start + (size if start + size <= free.parameter.high else -size)
            inside = free.parameter.low <= value <= free.parameter.high
            found = float(size) if inside else None
            sizes.append(SmallestSize(free, found, k == 1, float(value)))
    return tuple(sizes)


Task = tuple[int, FreeParameter | None, float]  # seed, hidden parameter and its value


def assess(
    dataset: DataSet,
    files: Sequence[str] = (),
    workers: int = 1,
    seconds: float = SECONDS,
    runs: int = 200,
    progress: Progress | None = None,
) -> dict[str, Any] | None:
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
    dict, optional
        Plain data: rate of alarms with nothing missing and its 95 % interval, the smallest sizes
        (SI) that raise an alarm four times in five, and how often they did. None where the noise
        is neither declared nor measured by repeated trials.

    """
    show = listener(progress)
    question = Question.of(dataset, dataset.robot, load_catalogue(files))
    if question.predictor.markers({}) is None:
        return None
    try:
        fits = gather(question)
    except InputError:
        return None
    session = fits.session
    smallest = smallest_sizes(fits.singles, session.nuisances)
    slow = {e.name for e in session.catalogue if e.always_on or e.stage == 'memory'}
    hidden = [one for one in smallest if one.size is not None and one.free.effect not in slow]
    clean: list[Task] = [(seed, None, 0.0) for seed in range(runs)]
    seeds = range(10_000, 10_000 + runs // 2)
    sized: list[Task] = [
        (seed, one.free, one.value) for seed, one in zip(seeds, cycle(hidden), strict=False)
    ]
    run = partial(alarm, dataset, session.noise, tuple(files))
    start = time.monotonic()

    def note(what: str) -> None:
        show(f'{what} [s]', min(round(time.monotonic() - start), round(seconds)), round(seconds))

    with Workers(workers) as spread:
        early, late = start + 0.65 * seconds, start + seconds
        quiet = spread.run(run, clean, early)
        count, alarms = counted(quiet, 'simulated with nothing missing', note)
        loud = spread.run(run, sized, late)
        checked, detected = counted(loud, 'simulated with an effect', note)
    sizes: dict[str, dict[str, Any]] = {}
    for one in smallest:
        sizes.setdefault(one.free.effect, {})[one.free.key] = one.plain
    low, high = wilson(alarms, count)
    return {
        'alarm_rate': alarms / count if count else None,
        'alarm_rate_low': low,
        'alarm_rate_high': high,
        'runs': count,
        'detectable': sizes,
        'checked': checked,
        'detected': detected,
    }


def alarm(dataset: DataSet, noise: Noise, files: tuple[str, ...], task: Task) -> bool | None:
    """Return whether a simulated data set raises the alarm; None without equilibrium."""
    seed, free, value = task
    question = Question.of(dataset, dataset.robot, load_catalogue(files))
    random = np.random.default_rng([seed, 71])
    point: dict[FreeParameter, float] = {
        n.free: float(random.normal(n.centre, n.spread)) for n in question.nuisances
    }
    if free is not None:
        point[free] = value
    simulated = simulated_measurements(question.predictor, point, noise, random)
    if simulated is None:
        return None
    return gather(question.mended(simulated)).answer(is_alarming)


def simulated_measurements(
    predictor: Predictor, point: Point, noise: Noise, random: np.random.Generator
) -> DataSet | None:
    """Return the data set with measurements simulated by the model at a point."""
    dataset = predictor.dataset
    by_trial = dataset.inputs_by_trial
    P, Q, m = by_trial.shape
    setting = noise.setting * random.normal(size=(P, 1, m))
    trial = noise.trial * random.normal(size=(P, Q, m))
    used = disturbed(dataset.robot, by_trial, dataset.input, setting, trial)
    trials = [predictor.markers(point, used[:, q]) for q in range(Q)]
    if any(trial is None for trial in trials):
        return None
    positions = np.stack([trial for trial in trials if trial is not None], axis=1)
    positions = positions + random.normal(0.0, noise.position, positions.shape)
    if noise.shift:
        positions = positions + random.normal(0.0, noise.shift, (P, Q, 1, 3))
    return replace(dataset, positions=np.where(dataset.mask[..., None], positions, np.nan))


def counted(
    simulated: Iterable[tuple[int, object]], what: str, note: Callable[[str], None]
) -> tuple[int, int]:
    """Return how many simulations had an equilibrium, and how many of them raised the alarm."""
    runs = hits = 0
    note(f'0 {what}')
    for _, alarm in simulated:
        runs += isinstance(alarm, bool)
        note(f'{runs} {what}')
        hits += alarm is True
    return runs, hits


def wilson(hits: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate (Wilson 1927)."""
    if runs == 0:
        return 0.0, 1.0
    z2, rate = QUANTILE**2, hits / runs
    centre = (rate + z2 / (2 * runs)) / (1.0 + z2 / runs)
    half = np.sqrt(z2 * (rate * (1.0 - rate) / runs + z2 / (4 * runs**2))) / (1.0 + z2 / runs)
    return max(float(centre - half), 0.0), min(float(centre + half), 1.0)
