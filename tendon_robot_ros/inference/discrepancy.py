"""
What has changed since an earlier recording of the same arm.

An arm deviates from every description of it, and in the same way for the same inputs. How it is
built is therefore estimated from the earlier recording, what it still deviates there is taken off
the new one, and only what has changed is left. These deviations d are taken as a Gaussian process
over the inputs u (Rasmussen and Williams 2006, chapter 2) at heights h along the arm,

    cov d(u, h) d(u', h') = s² exp(-|u - u'|² / 2 l²) min(h, h').

For equal inputs they cancel, for near ones in part, and what stays open is known. Size s and
length l are the likeliest ones of the earlier recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..common.arrays import RESOLUTION, Floats
from ..common.errors import DataSetError
from ..data import DataSet, DataSetLike, load_dataset
from ..data.dataset import EarlierRecording
from ..effects import CatalogueLike, load_catalogue
from .crossval import described_by, predict
from .noise import NEGLIGIBLE
from .predict import mean_inputs
from .session import Question
from .statistics import minimum

ALIKE = ('markers', 'input', 'input_names')  # what both recordings must have in common
LENGTHS = 12  # [1] that are tried, so that each is within a quarter of the next
SIZE_PRECISION = 0.02  # [1] of a size², because a dozen postures tell it to a tenth


def earlier_of(new: DataSet, reference: DataSetLike) -> DataSet:
    """
    Return an earlier recording of the arm of a new one, with the description of this.

    Raises
    ------
    DataSetError
        Markers or inputs differ.

    """
    old = load_dataset(reference, new.robot)
    for key in ALIKE:
        if getattr(new, key) != getattr(old, key):
            raise DataSetError(
                f'{old.name}: {key}',
                f'differ from those of {new.name}',
                'a reference has the same markers and inputs',
            )
    return old


def since(
    dataset: DataSetLike,
    reference: DataSetLike,
    catalogue: CatalogueLike | None = None,
    lacked: Sequence[str] = (),
) -> DataSet:
    """
    Return a recording without what the arm deviated from its description before.

    Its robot is the arm as it was found in the reference.

    Parameters
    ----------
    dataset, reference : DataSet, path, or a list of these
        The new recording, whose robot describes both, and the earlier one, of the same markers
        under inputs of one kind.
    catalogue : Catalogue or paths, optional
    lacked : sequence of str
        Effects that were added to the description because the reference shows them.

    Raises
    ------
    DataSetError
        Markers or inputs differ, or no posture of the reference shows all markers.
    InputError
        The noise of the reference is not known.
    NoEquilibriumError
        The description has no equilibrium in many postures of the reference.

    """
    new = load_dataset(dataset)
    described, old = new.robot, earlier_of(new, reference)
    whole = np.flatnonzero((old.counts > 0).all(axis=1))
    if not len(whole):
        raise DataSetError(old.name, 'no posture shows all markers', 'record one that does')
    question = Question.of(
        old.select(old.postures[p] for p in whole), described, load_catalogue(catalogue)
    )
    session = question.prepared()
    fit = session.base_fit()
    found = described_by(session, fit, beside=True)
    settled = session.dataset
    # a sequence has postures on its way of which not all markers, or none, were read
    seen = np.flatnonzero((settled.counts > 0).all(axis=1))
    moved = session.imperfections.moved(fit.anew)  # of several recordings
    off = (settled.mean - moved - predict(settled, found, session.catalogue)[1])[seen]
    heights = settled.arc_lengths / described.length
    tracker = session.noise.position**2 / settled.counts[seen].mean(axis=1)  # (P,) [m²]
    all_noise = session.whitener.variance[seen].mean(axis=(1, 2))
    driven = 3.0 * (all_noise - tracker) / heights.mean()  # by inputs: it grows along the arm
    deviations = DeviationProcess(
        np.nan_to_num(session.predictor.inputs[seen]), off, heights, driven, tracker
    )
    spread = {kind: root for kind, root in fit.spread.items() if kind not in fit.anew}
    taken, doubt, noise = deviations.at(np.nan_to_num(mean_inputs(new)))
    return replace(
        new.less(taken),
        robot=found,
        reference=EarlierRecording(
            old.name, deviations.error, doubt, noise, spread, tuple(lacked)
        ),
    )


class DeviationProcess:
    """
    A Gaussian process of the deviations of an arm from its description.

    Attributes
    ----------
    error : float
        Rms at the tip [m], as measured.
    size : float
        The same without noise.
    length : float
        Distance of inputs [N] or [m] over which deviations are alike.

    """

    def __init__(
        self, inputs: Floats, off: Floats, heights: Floats, driven: Floats, tracker: Floats
    ) -> None:
        """
        Find the likeliest size and length.

        Parameters
        ----------
        inputs : (P, m) [N] or [m]
        off : (P, J, 3) [m]
            Measured minus predicted.
        heights : (J,) [1]
            Of the markers, relative to the arm's length.
        driven : (P,) [m²]
            Variance of `off` at the tip by noise of inputs, over three coordinates.
        tracker : (P,) [m²]
            Variance of `off` at every marker by the tracker, per coordinate.

        """
        self.inputs, self.off, self.driven, self.tracker = inputs, off, driven, tracker
        last = np.argmax(heights)
        mean2 = float((off[:, last] ** 2).sum(axis=1).mean() / heights[last]) + RESOLUTION**2
        self.error = float(np.sqrt(mean2))
        values, shapes = np.linalg.eigh(np.minimum.outer(heights, heights))
        values, shapes = (one[..., values > NEGLIGIBLE * values.max()] for one in (values, shapes))
        parts = np.einsum('pjc,jk->kpc', off, shapes)
        # of inputs it grows along the arm as the deviations do, of the tracker it does not
        noise = values * (driven.mean() / 3.0 + NEGLIGIBLE * mean2) + tracker.mean()
        apart, lengths, best = self._apart(inputs), [1.0], np.inf
        apart = apart[apart > 0.0]
        if apart.size:  # from a length by which all inputs differ to one by which all are alike
            low, high = 0.3 * np.sqrt(apart.min()), 3.0 * np.sqrt(apart.max())
            lengths = np.geomspace(low, high, LENGTHS).tolist()
        for length in lengths:
            alike, modes = np.linalg.eigh(self._alike(inputs, length))
            scales = np.outer(values, np.maximum(alike, 0.0)) / 3.0
            power = ((modes.T @ parts) ** 2).sum(axis=2)

            def deviance(log: float, scales: Floats = scales, power: Floats = power) -> float:
                variance = mean2 * np.exp(log) * scales + noise[:, None]
                return float((3.0 * np.log(variance) + power / variance).sum())

            # the size relative to what was measured, which is the largest
            at, least = minimum(deviance, np.log(NEGLIGIBLE), 0.0, SIZE_PRECISION)
            if least < best:
                best, self.length, size2 = least, length, mean2 * float(np.exp(at))
        self.size = float(np.sqrt(size2))
        self.ratio = (driven + 3.0 * tracker / heights.mean()) / size2 + NEGLIGIBLE

    def _apart(self, inputs: Floats) -> Floats:
        """Return the squared distances (n, P) of inputs (n, m) to those of the reference."""
        return np.asarray(((inputs[:, None] - self.inputs) ** 2).sum(axis=2))

    def _alike(self, inputs: Floats, length: float) -> Floats:
        return np.exp(-0.5 * self._apart(inputs) / length**2)

    def at(self, inputs: Floats) -> tuple[Floats, Floats, Floats]:
        """
        Return the expected deviations at n inputs, and how well they are known.

        Returns
        -------
        off : (n, J, 3) [m]
        doubt : (n,) [m]
            Rms at the tip of what stays open, growing along the arm.
        noise : (n,) [m]
            1 sd per coordinate of every marker by the tracker.

        """
        alike, near = self._alike(self.inputs, self.length), self._alike(inputs, self.length)
        weights = np.linalg.solve(alike + np.diag(self.ratio), near.T).T
        left = 1.0 - (weights * (2.0 * near - weights @ alike)).sum(axis=1)
        doubt = self.size**2 * np.maximum(left, 0.0) + weights**2 @ self.driven
        noise = weights**2 @ self.tracker
        return np.tensordot(weights, self.off, 1), np.sqrt(doubt), np.sqrt(noise)
