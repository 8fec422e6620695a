"""
The noise of a data set: estimated from its trials, carried through the model, and its floor.

By the same covariance, how large the error is that no model of a family explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..common.arrays import RESOLUTION, Bools, Floats, Ints
from ..common.estimation import STEP_LENGTHS
from ..data import DataSet
from ..robot.inputs import noise_scales
from .predict import Point, Predictor, SettledShapes, mean_inputs
from .statistics import RARE, chi2_isf, minimum, rms

# [1] relative variance, or singular value, below which a cause is left out, because it changes no
# weight by more than a thousandth
NEGLIGIBLE = 1e-3


@dataclass(frozen=True)
class Noise:
    """
    Noise of the marker means of a data set.

    Attributes
    ----------
    position : float [m]
        1 sd per coordinate and trial.
    trial, setting : float [1]
        Relative 1 sd of an input (`noise_scales`), per trial, and shared by a posture's trials.
    freedom : float
        Degrees of freedom that the trials gave the estimate; infinite when it was declared.
    source : str
        'trials' or 'declared'.
    shift : float [m]
        1 sd per coordinate of a shift that all markers of a trial share (the tracker, or the base,
        has moved a little).

    """

    position: float
    trial: float
    setting: float
    freedom: float
    source: str
    shift: float = 0.0


def input_slopes(predictor: Predictor, point: Point, near: SettledShapes | None = None) -> Floats:
    """
    Return the displacement of markers by relative changes of the inputs, (P, m, J, 3) [m].

    Central differences of about one noise sd with a full solution each: friction is kinked. Where
    a posture has no solution, shorter ones; without any, the input counts as without influence.
    Zero where inputs have no noise: none is declared, and no posture has two trials that show it.
    `near` are equilibria to start from.
    """
    inputs, dataset = predictor.inputs, predictor.dataset
    slopes = np.zeros((*inputs.shape, len(dataset.markers), 3))
    declared = dataset.setting_noise > 0.0 or dataset.trial_noise > 0.0
    if not declared and dataset.trials.max(initial=0) == 1:
        return slopes
    relative = np.hypot(dataset.setting_noise, dataset.trial_noise) or 0.005
    sizes = noise_scales(dataset.robot, inputs, dataset.input)
    steps = relative * sizes
    for j in range(inputs.shape[1]):
        for share in STEP_LENGTHS:
            own = share * steps[:, j]
            step = np.where(np.arange(inputs.shape[1]) == j, own[:, None], 0.0)
            up, down = (predictor.markers(point, inputs + side, near) for side in (step, -step))
            if up is not None and down is not None:
                width = np.where(own > 0.0, 2.0 * own, np.inf)
                slopes[:, j] = (up - down) * (sizes[:, j] / width)[:, None, None]
                break
    return slopes


def input_effect(dataset: DataSet, slopes: Floats) -> Floats:
    """
    Return by how much the measured inputs of each trial displace its markers, (P, Q, J, 3) [m].

    From where they would be under the mean inputs of the posture, by slopes of `input_slopes`;
    zero where all trials have the same inputs.
    """
    inputs = mean_inputs(dataset)[:, None]
    sizes = noise_scales(dataset.robot, inputs, dataset.input)
    relative = np.nan_to_num(dataset.inputs_by_trial - inputs) / np.where(sizes, sizes, np.inf)
    return np.asarray(np.einsum('pqm,pmjc->pqjc', relative, slopes))


class Whitener:
    """
    Covariance of the marker means, a block per posture, and a square root of its inverse.

    (position noise + trial noise + shift) / trials + setting noise, which all trials share. Errors
    of a model may come on top, no smaller for more trials: `accuracy` [m] growing along the arm,
    and `rough` [m, 1 sd per coordinate] of every marker; both of all postures, or (P,) of each.
    """

    def __init__(
        self,
        dataset: DataSet,
        noise: Noise,
        slopes: Floats,
        accuracy: float | Floats = 0.0,
        rough: float | Floats = 0.0,
    ) -> None:
        """Take the covariance; `slopes` are those of `input_slopes`."""
        self._visible = np.repeat(dataset.counts > 0, 3, axis=1)  # (P, 3 J)
        self._noise, self._errors = (dataset, noise, slopes), (dataset, accuracy, rough)
        counts = np.repeat(np.maximum(dataset.counts, 1), 3, axis=1)
        by_inputs = np.square(slopes).sum(axis=1).reshape(counts.shape)
        total = (noise.position**2 + noise.shift**2) / counts
        total += (noise.setting**2 + noise.trial**2 / counts) * by_inputs
        seen = np.where(self._visible, total, np.nan)
        self.variance = seen.reshape(dataset.mean.shape)  # (P, J, 3) [m²] by noise; NaN: not seen

    @cached_property
    def _factors(self) -> tuple[Floats, Floats, Floats]:
        """Roots W (P, 3 J, 3 J) of the inverses, logarithms (P,) of determinants, and W^-1."""
        blocks = covariances(*self._noise) + _model_errors(*self._errors)
        root, logs = _factored(blocks, self._visible)
        return np.linalg.inv(root), logs, root

    @property
    def size(self) -> int:
        """Number N of whitened values."""
        return int(self._visible.sum())

    def without(self, postures: Sequence[int] | Ints) -> Whitener:
        """Return the same whitener with some postures weighted zero."""
        other = Whitener(*self._noise, *self._errors[1:])
        other._visible = self._visible.copy()
        other._visible[list(postures)] = False
        return other

    def white(self, difference: Floats) -> Floats:
        """Whiten differences (..., P, J, 3) [m] into (..., N)."""
        leading, (P, n) = difference.shape[:-3], self._visible.shape
        flat = difference.reshape(-1, P, n).swapaxes(0, 1)  # (P, q, 3 J)
        seen = flat if self._visible.all() else np.where(self._visible[:, None], flat, 0.0)
        rows = (seen @ self._factors[0].swapaxes(1, 2)).swapaxes(0, 1)
        return rows[:, self._visible].reshape(*leading, self.size)

    def squares(self, white: Floats) -> Floats:
        """Return the mean squared distance (P,) [m²] of whitened values (N,); nan without any."""
        metres = np.zeros(self._visible.shape)
        metres[self._visible] = white
        metres = (self._factors[2] @ metres[..., None])[..., 0]
        seen = self._visible.sum(axis=1)
        squares = 3.0 * (metres**2).sum(axis=1) / np.maximum(seen, 1)
        return np.where(seen > 0, squares, np.nan)

    @property
    def owners(self) -> Ints:
        """Posture (N,) that each whitened value belongs to."""
        return np.repeat(np.arange(len(self._visible)), self._visible.sum(axis=1))

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance."""
        return float(self._factors[1].sum())

    def floor(self) -> float:
        """Return the expected rms [m] of the distance for a perfect model, setting noise too."""
        return float(np.sqrt(3.0 * np.nansum(self.variance) / max(self.size, 1)))


def covariances(dataset: DataSet, noise: Noise, slopes: Floats) -> Floats:
    """
    Return the covariances (P, 3 J, 3 J) [m²] of the marker means by noise, trial by trial or not.

    The mean of a marker that one trial lost has the inputs of the others: part of the noise of the
    trials is then its own.
    """
    P, J = dataset.counts.shape
    mask, counts = dataset.mask.astype(float), np.maximum(dataset.counts, 1)
    weights = mask / counts[:, None]
    trials = weights.swapaxes(1, 2) @ weights  # (P, J, J) of what is new in every trial
    flat = slopes.reshape(P, -1, 3 * J)
    by_inputs = flat.swapaxes(1, 2) @ flat
    every, same = np.ones((1, 3, 3)), np.eye(3)[None]  # of two coordinates
    blocks = np.kron(noise.setting**2 + noise.trial**2 * trials, every) * by_inputs
    blocks += np.kron(noise.shift**2 * trials, same)
    diagonal = np.arange(3 * J)
    blocks[:, diagonal, diagonal] += noise.position**2 / np.repeat(counts, 3, axis=1)
    return np.asarray(blocks)


def _model_errors(dataset: DataSet, accuracy: float | Floats, rough: float | Floats) -> Floats:
    """
    Return the covariances (P, 3 J, 3 J) [m²] of the errors of a model; see `Whitener`.

    What grows along the arm is a random walk, its variance proportional to the arc length.
    """
    height = dataset.arc_lengths / dataset.robot.length
    walk = np.kron(1.0 / 3.0 * np.minimum.outer(height, height), np.eye(3))
    smooth, own = (
        np.square(np.broadcast_to(size, len(dataset.postures)))[:, None, None]
        for size in (accuracy, rough)
    )
    return np.asarray(smooth * walk + own * np.eye(len(walk)))


def _factored(blocks: Floats, visible: Bools) -> tuple[Floats, Floats]:
    """Return triangular roots (P, n, n) of what is visible, and logarithms of determinants."""
    both = visible[:, :, None] & visible[:, None]
    root = np.linalg.cholesky(np.where(both, blocks, np.eye(visible.shape[1]) * ~both))
    return root, 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)


def relative_error(known: float, tips: Floats) -> float:
    """Return a known error of a model [m] relative to what the tip (P, 3) [m] moves [1]."""
    return known / max(rms(tips - np.nanmean(tips, axis=0)), known) if known else 0.0


# [1] logarithms of the size of an error over the rms of all residuals between which it is sought:
# 0.2 % to 20 times, because a smaller one moves no weight and no part is larger than the whole
LOG_SIZES = (-6.0, 3.0)
# [1] of the logarithm of a standard deviation, because `TRIAL_DOF_MIN` estimate it to 13 % only
LOG_PRECISION = 0.1
VARIANCE_PRECISION = 0.01  # [1] of a logarithm, because trials give a variance to 26 % at best
DESCENT_ROUNDS = 2  # [1] through two sizes in turn, because a change of one hardly moves the other


def likely(
    dataset: DataSet, noise: Noise, slopes: Floats, off: Floats, held: Sequence[int] | Ints = ()
) -> tuple[float, float]:
    """
    Return the sizes [m] under which measured minus model `off` (P, J, 3) [m] is most likely.

    Of an error of every posture that grows along the arm, and of one of every marker (1 sd per
    coordinate), beside the noise: `accuracy` and `rough` of a `Whitener`.

    Parameters
    ----------
    slopes : (P, m, J, 3)
        Of `input_slopes`.
    held : sequence
        Postures that do not count.

    """
    visible = np.repeat(dataset.counts > 0, 3, axis=1)  # (P, 3 J)
    visible[list(held)] = False
    size = rms(np.where(visible.reshape(off.shape), off, np.nan)) / np.sqrt(3.0)
    flat = np.where(visible, off.reshape(visible.shape), 0.0)
    noises = covariances(dataset, noise, slopes)

    def cost(smooth: float, rough: float) -> float:
        """Return -2 log likelihood with errors of these sizes [m]."""
        root, logs = _factored(noises + _model_errors(dataset, smooth, rough), visible)
        white = np.linalg.solve(root, flat[..., None])
        return float((white**2).sum() + logs.sum())

    best = [0.0, 0.0]
    for _ in range(DESCENT_ROUNDS):
        for i in range(len(best)):

            def along(x: float, i: int = i) -> float:
                return cost(*(size * np.exp([*best[:i], x, *best[i + 1 :]])))

            best[i], _ = minimum(along, *LOG_SIZES, LOG_PRECISION)
    smooth, rough = np.exp(best).tolist()
    return size * smooth, size * rough


# [1] degrees of freedom within postures, from which the noise is estimated by trials, because its
# standard deviation is then known to 1 / sqrt(2 n) = 13 %
TRIAL_DOF_MIN = 30
# [1] of -2 log likelihood, that one more variance gains by chance with a probability of 0.1 %
VARIANCE_GAIN_MIN = chi2_isf(RARE, 1.0)


def estimate_noise(dataset: DataSet, slopes: Floats) -> Noise | None:
    """
    Estimate the noise from deviations within postures (REML), else return the declared noise.

    Model error is the same in all trials of a posture, so it does not bias the estimate. Among
    visits it may, because the commands before the last one differ; then what is declared is used
    first. None where there are neither trials nor a declared `position_noise`.
    """
    declared = None
    if dataset.position_noise is not None:
        trial, setting = dataset.trial_noise, dataset.setting_noise
        position = max(dataset.position_noise, RESOLUTION)
        declared = Noise(position, trial, setting, np.inf, 'declared')
    if declared is not None and dataset.visits is not None:
        return declared
    deviations, driven = list[Floats](), list[Floats]()
    explained = input_effect(dataset, slopes)
    for p in range(len(dataset.postures)):
        trials, markers = _complete(dataset.mask[p])
        if len(trials) < 2 or not len(markers):
            continue
        block = np.ix_(trials, markers)
        moves = (dataset.positions[p][block] - explained[p][block]).reshape(len(trials), -1)
        deviations.append(moves - moves.mean(axis=0))
        driven.append(slopes[p][:, markers].reshape(len(slopes[p]), -1).T)
    total = float(sum((len(moves) - 1) * moves.shape[1] for moves in deviations))
    if total < TRIAL_DOF_MIN:
        return declared
    # with two markers or fewer the inputs cannot be distinguished from a shift
    many = any(moves.shape[1] > 6 for moves in deviations)
    position, trial, shift = _likeliest(_TrialLikelihood(deviations, driven), many)
    return Noise(position, trial, dataset.setting_noise, total, 'trials', shift)


def _complete(mask: Bools) -> tuple[Ints, Ints]:
    """
    Return trials and markers of a posture, of which every reading (Q, J) is there.

    Trials that lost a marker are left out, or markers that a trial lost: whatever keeps more
    readings, so that a marker with one lost reading still counts, however noisy it is.
    """
    some = mask[mask.any(axis=1)][:, mask.any(axis=0)]
    trials, markers = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    whole_trials, whole_markers = some.all(axis=1), some.all(axis=0)
    if (whole_trials.sum() - 1) * len(markers) >= (len(trials) - 1) * whole_markers.sum():
        return trials[whole_trials], markers
    return trials, markers[whole_markers]


def _likeliest(likelihood: _TrialLikelihood, may_shift: bool) -> tuple[float, float, float]:
    """
    Return the likeliest standard deviations of position [m], of inputs [1] and of a shift [m].

    The shift is 0 unless it `may_shift` and the likelihood gains by `VARIANCE_GAIN_MIN`. All but
    the first are sought as variances over that of a coordinate.
    """
    grid = np.arange(-14.0, 21.0) - math.log(likelihood.strongest)  # there may be several valleys
    best = int(np.argmin([likelihood(math.exp(log), 0.0)[0] for log in grid.tolist()]))
    near = (None, 0.0), grid[best] - 1.0, grid[best] + 1.0
    inputs = likelihood.likeliest(*near) if best > 0 else 0.0
    alone, variance = likelihood(inputs, 0.0)
    position, trial, shift = math.sqrt(variance), min(math.sqrt(inputs * variance), 0.3), 0.0
    for _ in range(DESCENT_ROUNDS if may_shift else 0):
        shift = likelihood.likeliest((inputs, None), -7.0, 9.0)
        if inputs:
            low = math.log(inputs)
            inputs = likelihood.likeliest((None, shift), low - 12.0, low + 2.0)
    if likelihood(0.0, shift)[0] <= likelihood(inputs, shift)[0]:
        inputs = 0.0
    together, variance = likelihood(inputs, shift)
    if not may_shift or alone - together < VARIANCE_GAIN_MIN:
        return position, trial, 0.0
    return math.sqrt(variance), math.sqrt(inputs * variance), math.sqrt(shift * variance)


class _TrialLikelihood:
    """
    The restricted likelihood (REML) of deviations of trials from the mean of their posture.

    By the variances of inputs and of a shift that all markers of a trial share, each over that of
    a coordinate, for which there is a closed form then. Of every posture only the products of what
    inputs and shifts do, (P, m + 3, m + 3), and of that with the deviations are needed (Woodbury).
    """

    def __init__(self, deviations: Sequence[Floats], driven: Sequence[Floats]) -> None:
        """Take deviations (trials, 3 J) [m] of postures, and what their inputs do (3 J, m)."""
        axes = [np.hstack([g, np.tile(np.eye(3), (len(g) // 3, 1))]) for g in driven]
        self._gram = np.stack([a.T @ a for a in axes])
        along = [a.T @ moves.T for a, moves in zip(axes, deviations, strict=True)]
        self._products = np.stack([c @ c.T for c in along])
        self._freedom = np.array([len(moves) - 1.0 for moves in deviations])
        self._count = float(sum((len(moves) - 1) * moves.shape[1] for moves in deviations))
        self._total = float(sum((moves**2).sum() for moves in deviations))
        m = self._gram.shape[1] - 3
        strongest = np.linalg.eigvalsh(self._gram[:, :m, :m]).max(initial=0.0)
        self.strongest = max(float(strongest), 1e-30)  # [m²] that an input does at most

    def __call__(self, inputs: float, shift: float) -> tuple[float, float]:
        """Return -2 log likelihood of the two variances, and that of a coordinate [m²]."""
        size = np.sqrt(np.append(np.full(self._gram.shape[1] - 3, inputs), [shift] * 3))
        scale = np.outer(size, size)
        root = np.linalg.cholesky(np.eye(len(size)) + scale * self._gram)
        logs = 2.0 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        inverse = np.linalg.inv(root)
        explained = float(((inverse @ (scale * self._products)) * inverse).sum())
        variance = max((self._total - explained) / self._count, RESOLUTION**2)
        return float(self._freedom @ logs) + self._count * math.log(variance), variance

    def likeliest(
        self, known: tuple[float | None, float | None], low: float, high: float
    ) -> float:
        """Return the likeliest value of the unknown variance, between two logarithms."""

        def cost(log: float) -> float:
            inputs, shift = (math.exp(log) if one is None else one for one in known)
            return self(inputs, shift)[0]

        return math.exp(minimum(cost, low, high, VARIANCE_PRECISION)[0])
