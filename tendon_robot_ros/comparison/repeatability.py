"""What the trials of a posture tell of the noise: their deviations from its mean, by REML."""

from __future__ import annotations

import math

import numpy as np

from ..data import DataSet
from .noise import Floats, Noise, input_share
from .statistics import minimum

TRIAL_DOF_MIN = 30  # degrees of freedom within postures from which the trials tell the noise
SHIFT_MARKERS_MIN = 3  # that a trial shifts all markers alike is not seen on fewer
SHIFT_ROUNDS = 3  # through the two sizes, one after the other
SHIFT_GAIN = 10.8  # of -2 log likelihood, from which a shift is believed: 0.1 % false


def estimate_noise(dataset: DataSet, slopes: Floats) -> Noise | None:
    """
    Estimate the noise from deviations within postures only (REML), else take what is declared.

    Model error is the same in all trials of a posture, so it cannot leak in. Of visits it can:
    what was before the command before differs, and what is declared counts first. None: neither
    trials nor a declared `position_noise`.
    """
    declared = None
    if dataset.position_noise is not None:
        trial, setting = dataset.trial_noise, dataset.setting_noise
        declared = Noise(dataset.position_noise, trial, setting, np.inf, 'declared')
    if declared is not None and dataset.visits is not None:
        return declared
    total, parts, wholes = 0.0, [], []
    explained = input_share(dataset, slopes)
    for p in range(len(dataset.postures)):
        seen = dataset.trial_mask[p]
        complete = dataset.mask[p][seen].all(axis=0)
        trials, markers = int(seen.sum()), int(complete.sum())
        if trials < 2 or not markers:
            continue
        moves = dataset.positions[p][seen][:, complete].reshape(trials, -1)
        g = slopes[p][:, complete].reshape(len(slopes[p]), -1).T  # (3 J, m)
        moves = moves - explained[p][seen][:, complete].reshape(trials, -1)
        moves = moves - moves.mean(axis=0)
        u, s, _ = np.linalg.svd(g, full_matrices=False)
        along = ((moves @ u) ** 2).sum(axis=0)
        rest = max(float((moves**2).sum() - along.sum()), 0.0)
        parts.append((trials - 1, s, along, moves.shape[1] - len(s), rest))
        if markers >= SHIFT_MARKERS_MIN:
            wholes.append((moves, g))
        total += (trials - 1) * moves.shape[1]
    if total < TRIAL_DOF_MIN:
        return declared
    position, trial = _restricted_likelihood(parts)
    position, trial, shift = _with_shift(wholes, position, trial)
    return Noise(position, trial, dataset.setting_noise, total, 'trials', shift)


def _restricted_likelihood(
    parts: list[tuple[int, Floats, Floats, int, float]],
) -> tuple[float, float]:
    """
    Maximise the likelihood of the deviations over the two standard deviations.

    Only their ratio needs a search: given it, the position noise has a closed form.
    """
    count = sum(nu * (len(s) + rest) for nu, s, _, rest, _ in parts)
    nus = np.concatenate([np.full(len(s), nu) for nu, s, *_ in parts])
    sizes = np.concatenate([s for _, s, *_ in parts]) ** 2
    along = np.concatenate([a for _, _, a, *_ in parts])
    rest = float(sum(r for *_, r in parts))
    largest = max(float(sizes.max(initial=0.0)), 1e-30)

    def position2(ratio: float) -> float:
        return max((float(np.sum(along / (1.0 + ratio * sizes))) + rest) / count, 1e-24)

    def cost(log: float) -> float:
        ratio = math.exp(log) / largest
        spread = float(np.sum(nus * np.log1p(ratio * sizes)))
        return spread + count * math.log(position2(ratio))

    grid = np.arange(-14.0, 21.0, 1.0)
    best = float(grid[int(np.argmin([cost(float(log)) for log in grid]))])
    log, lowest = minimum(cost, best - 1.0, best + 1.0, 1e-3)
    if best == grid[0] or lowest > count * math.log(position2(0.0)):
        return math.sqrt(position2(0.0)), 0.0
    ratio = math.exp(log) / largest
    position = math.sqrt(position2(ratio))
    return position, min(math.sqrt(ratio) * position, 0.3)


def _with_shift(
    wholes: list[tuple[Floats, Floats]], position: float, trial: float
) -> tuple[float, float, float]:
    """
    Return position noise, trial noise and the shift shared by the markers of a trial.

    Deviations (trials, 3 J) of every posture from its mean, and what its inputs do (3 J, m). The
    shift is 0, and the others are as they come, unless the likelihood gains by `SHIFT_GAIN`.
    """
    if not wholes:
        return position, trial, 0.0
    level = _Level(wholes)
    before = level(trial**2 / position**2, 0.0)[0]
    inputs, shift = (trial / position) ** 2, 0.0  # variances over that of a coordinate
    for _ in range(SHIFT_ROUNDS):
        shift = level.likeliest((inputs, None), -7.0, 9.0)
        if inputs:
            low = math.log(inputs)
            inputs = level.likeliest((None, shift), low - 12.0, low + 2.0)
    if level(0.0, shift)[0] <= level(inputs, shift)[0]:
        inputs = 0.0
    after, variance = level(inputs, shift)
    if before - after < SHIFT_GAIN:
        return position, trial, 0.0
    return math.sqrt(variance), math.sqrt(inputs * variance), math.sqrt(shift * variance)


class _Level:
    """
    The likelihood of two variances over that of a coordinate, given which the latter is known.

    Of every posture only the products of what inputs and shifts do, (P, m + 3, m + 3), and of that
    with the deviations are needed (Woodbury).
    """

    def __init__(self, wholes: list[tuple[Floats, Floats]]) -> None:
        moves, both = zip(*wholes, strict=True)
        axes = [np.hstack([g, np.tile(np.eye(3), (len(g) // 3, 1))]) for g in both]
        self._gram = np.stack([a.T @ a for a in axes])
        along = [a.T @ move.T for a, move in zip(axes, moves, strict=True)]
        self._seen = np.stack([c @ c.T for c in along])
        self._freedom = np.array([len(move) - 1.0 for move in moves])
        self._count = float(sum((len(move) - 1) * move.shape[1] for move in moves))
        self._total = float(sum((move**2).sum() for move in moves))

    def __call__(self, inputs: float, shift: float) -> tuple[float, float]:
        """Return -2 log likelihood of the two variances, and that of a coordinate [m²]."""
        size = np.sqrt(np.append(np.full(self._gram.shape[1] - 3, inputs), [shift] * 3))
        scale = np.outer(size, size)
        root = np.linalg.cholesky(np.eye(len(size)) + scale * self._gram)
        logs = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        inverse = np.linalg.inv(root)
        explained = float(((inverse @ (scale * self._seen)) * inverse).sum())
        variance = max((self._total - explained) / self._count, 1e-24)
        return float(self._freedom @ logs) + self._count * math.log(variance), variance

    def likeliest(
        self, known: tuple[float | None, float | None], low: float, high: float
    ) -> float:
        """Return the likeliest of the two variances that is not known, between two logarithms."""

        def cost(log: float) -> float:
            inputs, shift = (math.exp(log) if one is None else one for one in known)
            return self(inputs, shift)[0]

        return math.exp(minimum(cost, low, high, 0.02)[0])
