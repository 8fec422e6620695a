"""The noise of a data set: repeatability of the trials, input noise through the model, floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..data import DataSet
from .predict import Point, Predictor
from .statistics import minimum

Floats = npt.NDArray[np.float64]
UNSEEN_VARIANCE = 1e-3  # [1] of a marker's own variance: what inputs do less is left out
TRIAL_DOF_MIN = 30  # degrees of freedom within postures from which the trials tell the noise


@dataclass(frozen=True)
class Noise:
    """
    Noise of the marker means of a data set.

    Attributes
    ----------
    position : float [m]
        1 sd per coordinate and trial.
    trial, setting : float [1]
        Relative 1 sd of a tendon's input, per trial and shared by the trials of a posture.
    freedom : float
        Degrees of freedom that the trials gave the estimate; infinite when it was declared.
    source : str
        'trials' or 'declared'.

    """

    position: float
    trial: float
    setting: float
    freedom: float
    source: str


def input_steps(dataset: DataSet, inputs: Floats) -> Floats:
    """Step (P, m) of the inputs that carries their noise through the model: about one sd."""
    relative = np.hypot(dataset.setting_noise, dataset.trial_noise) or 0.005
    return np.asarray(relative * np.abs(np.nan_to_num(inputs)))


def input_slopes(predictor: Predictor, point: Point) -> Floats:
    """
    Return how markers answer to the inputs, relative: (P, m, J, 3) [m] per unit of T.

    Central differences of about one noise sd with a full solution each: friction is kinked. An
    input without a solution on both sides counts as without influence.
    """
    inputs, dataset = predictor.inputs, predictor.dataset
    steps = input_steps(dataset, inputs)
    slopes = np.zeros((*inputs.shape, len(dataset.markers), 3))
    for j in range(inputs.shape[1]):
        side = []
        for sign in (1.0, -1.0):
            moved = inputs.copy()
            moved[:, j] += sign * steps[:, j]
            side.append(predictor.markers(point, moved))
        if side[0] is None or side[1] is None:
            continue
        width = np.where(steps[:, j] > 0.0, 2.0 * steps[:, j], np.inf)
        scale = np.abs(np.nan_to_num(inputs[:, j])) / width
        slopes[:, j] = (side[0] - side[1]) * scale[:, None, None]
    return slopes


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
    total, parts = 0.0, []
    for p in range(len(dataset.postures)):
        seen = dataset.trial_mask[p]
        complete = dataset.mask[p][seen].all(axis=0)
        trials, markers = int(seen.sum()), int(complete.sum())
        if trials < 2 or not markers:
            continue
        moves = dataset.positions[p][seen][:, complete].reshape(trials, -1)
        g = slopes[p][:, complete].reshape(len(slopes[p]), -1).T  # (3 J, m)
        if dataset.trial_inputs is not None:
            moves = moves - _measured_share(dataset, p, seen, g)
        moves = moves - moves.mean(axis=0)
        u, s, _ = np.linalg.svd(g, full_matrices=False)
        along = ((moves @ u) ** 2).sum(axis=0)
        rest = max(float((moves**2).sum() - along.sum()), 0.0)
        parts.append((trials - 1, s, along, moves.shape[1] - len(s), rest))
        total += (trials - 1) * moves.shape[1]
    if total < TRIAL_DOF_MIN:
        return declared
    position, trial = _restricted_likelihood(parts)
    return Noise(position, trial, dataset.setting_noise, total, 'trials')


def _measured_share(dataset: DataSet, p: int, seen: npt.NDArray[np.bool_], g: Floats) -> Floats:
    """Return what the measured differences of the inputs explain (trials, 3 J) [m]."""
    assert dataset.trial_inputs is not None
    inputs = np.nan_to_num(dataset.trial_inputs[p][seen])
    mean = inputs.mean(axis=0)
    relative = (inputs - mean) / np.where(mean == 0.0, np.inf, mean)
    return np.asarray(relative @ g.T)


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


class Whitener:
    """
    Covariance of the marker means, a block per posture, and a root of its inverse.

    (position noise + trial noise) / trials + setting noise, which the trials of a posture share.
    The mean of a marker that one trial lost has the inputs of the others: part of the trial noise
    is then its own. Errors of a model may come on top, no smaller for more trials: `accuracy` [m]
    of a posture, growing along the arm, and `rough` [m, 1 sd per coordinate] of every marker.

    Noise of m inputs adds G'G of m rows to a diagonal D. With G D^-1/2 = B and B B' = V L V' the
    symmetric root of (1 + B'B)^-1 is 1 - B'V f(L) V'B, f(l) = 1 / (1 + l + sqrt(1 + l)): nothing
    of the size of the markers is factored. Where `accuracy` is asked for, blocks are dense.
    """

    def __init__(
        self,
        dataset: DataSet,
        noise: Noise,
        slopes: Floats,
        accuracy: float = 0.0,
        rough: float = 0.0,
    ) -> None:
        """Find the roots; `slopes` are those of `input_slopes`."""
        self._seen = np.repeat(dataset.counts > 0, 3, axis=1)  # (P, 3 J)
        counts = np.repeat(np.maximum(dataset.counts, 1), 3, axis=1)
        own = noise.position**2 / counts
        driven = _driven(dataset, noise, slopes, own + rough**2)
        total = own + (driven**2).sum(axis=1)
        self.variance = [one[seen] for one, seen in zip(total, self._seen, strict=True)]
        self._scale = np.where(self._seen, 1.0 / np.sqrt(own + rough**2), 0.0)  # (P, 3 J)
        scaled = driven * self._scale[:, None]
        values, vectors = np.linalg.eigh(scaled @ scaled.swapaxes(1, 2))
        values = np.maximum(values, 0.0)[..., None]  # (P, m, 1)
        shrunk = 1.0 / np.sqrt(1.0 + values + np.sqrt(1.0 + values))
        self._along = shrunk * (vectors.swapaxes(1, 2) @ scaled)  # (P, m, 3 J)
        self._logs = np.log1p(values).sum(axis=(1, 2)) - 2.0 * np.log(
            self._scale, out=np.zeros_like(self._scale), where=self._seen
        ).sum(axis=1)
        self._dense: list[Floats] | None = None
        if accuracy:
            self._take_dense(dataset, accuracy, own + rough**2, driven)

    def _take_dense(self, dataset: DataSet, accuracy: float, own: Floats, driven: Floats) -> None:
        """Factor blocks in which errors are shared along the arm."""
        self._dense = []
        for p, rows in enumerate(self.rows):
            g = driven[p][:, rows]
            block = np.diag(own[p, rows]) + g.T @ g + common_error(dataset, rows, accuracy)
            root = np.linalg.inv(np.linalg.cholesky(block)) if len(rows) else block
            self._logs[p] = -2.0 * float(np.log(np.diag(root)).sum())
            self._dense.append(root)

    @property
    def rows(self) -> list[npt.NDArray[np.intp]]:
        """What was seen of each posture: indices of (marker, coordinate)."""
        return [np.flatnonzero(seen) for seen in self._seen]

    @property
    def size(self) -> int:
        """Number N of whitened values."""
        return int(self._seen.sum())

    def root(self, p: int) -> Floats:
        """Return W (n, n) for what was seen of a posture: W'W is the covariance's inverse."""
        if self._dense is not None:
            return self._dense[p]
        rows = np.flatnonzero(self._seen[p])
        along = self._along[p][:, rows]
        return np.asarray((np.eye(len(rows)) - along.T @ along) * self._scale[p, rows])

    def without(self, postures: Sequence[int] | npt.NDArray[np.int64]) -> Whitener:
        """Return weights that do not see some postures."""
        made, held = copy(self), list(postures)
        made._seen, made._scale = self._seen.copy(), self._scale.copy()
        made._along, made._logs = self._along.copy(), self._logs.copy()
        made._seen[held], made._scale[held] = False, 0.0
        made._along[held], made._logs[held] = 0.0, 0.0
        if self._dense is not None:
            nothing = np.zeros((0, 0))
            made._dense = [nothing if p in held else one for p, one in enumerate(self._dense)]
        return made

    def white(self, difference: Floats) -> Floats:
        """Whiten differences (..., P, J, 3) [m] into (..., N)."""
        lead, (P, n) = difference.shape[:-3], self._seen.shape
        flat = difference.reshape(-1, P, n).swapaxes(0, 1)  # (P, q, 3 J)
        if self._dense is not None:
            own = zip(flat, self.rows, self._dense, strict=True)
            blocks = [one[:, rows] @ root.T for one, rows, root in own]
            return np.concatenate(blocks, axis=1).reshape(*lead, -1)
        complete = self._seen.all()
        scaled = (flat if complete else np.where(self._seen[:, None], flat, 0.0)) * self._scale[
            :, None
        ]
        white = scaled - (scaled @ self._along.swapaxes(1, 2)) @ self._along
        rows = white.swapaxes(0, 1).reshape(-1, P * n)
        return (rows if complete else rows[:, self._seen.reshape(-1)]).reshape(*lead, -1)

    @property
    def owners(self) -> npt.NDArray[np.int64]:
        """Posture (N,) that each whitened value belongs to."""
        return np.repeat(np.arange(len(self._seen)), self._seen.sum(axis=1))

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance."""
        return float(self._logs.sum())

    def floor(self) -> float:
        """Return the expected rms [m] of the distance for a perfect model, setting noise too."""
        total = sum(float(variance.sum()) for variance in self.variance)
        return float(np.sqrt(3.0 * total / max(self.size, 1)))


def _driven(dataset: DataSet, noise: Noise, slopes: Floats, own: Floats) -> Floats:
    """Return rows G (P, r m, 3 J) [m] of what the noise of m inputs does to the marker means."""
    rows = _input_noise(dataset, noise)
    flat = slopes.reshape(*slopes.shape[:2], -1)  # (P, m, 3 J)
    loudest = (flat**2 / own[:, None]).max(axis=(1, 2), initial=0.0)
    shown = (rows**2).sum(axis=2) * loudest[:, None] > UNSEEN_VARIANCE
    rows = rows[:, : max(int(shown.any(axis=0).sum()), 1)]
    made = np.repeat(rows, 3, axis=2)[:, :, None] * flat[:, None]
    return np.asarray(made.reshape(len(made), -1, made.shape[-1]))


def _input_noise(dataset: DataSet, noise: Noise) -> Floats:
    """
    Return rows R (P, r, J), the largest first: R'R is the covariance of an input's relative error.

    As it stands behind the mean of every marker, which is that of the trials that saw it.
    """
    mask, counts = dataset.mask, dataset.counts
    if (mask.any(axis=1)[:, None] & dataset.trial_mask[..., None] <= mask).all():  # none is lost
        size = noise.setting**2 + noise.trial**2 / np.maximum(dataset.trials, 1)
        return np.repeat(np.sqrt(size)[:, None, None], mask.shape[2], axis=2)
    rows = np.full((len(mask), mask.shape[1] + 1, mask.shape[2]), noise.setting)
    rows[:, 1:] = noise.trial * mask / np.maximum(counts, 1)[:, None]
    _, sizes, shapes = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(sizes[..., None] * shapes)


def common_error(dataset: DataSet, rows: npt.NDArray[np.int64], accuracy: float) -> Floats:
    """Covariance of an error of one posture that grows along the arm up to `accuracy` [m]."""
    share = np.repeat(dataset.arc_lengths / dataset.robot.length, 3)[rows]
    same = (rows[:, None] % 3) == (rows[None, :] % 3)
    return np.asarray(accuracy**2 / 3.0 * np.minimum.outer(share, share) * same)


def rms(difference: Floats) -> float:
    """Root mean square 3-D distance [m] over what was seen; difference (P, J, 3)."""
    distance2 = (difference**2).sum(axis=-1)
    return float(np.sqrt(np.nanmean(distance2)))
