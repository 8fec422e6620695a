"""The posture that separates effects which the present postures do not distinguish."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from scipy.linalg import block_diag

from ..common.arrays import Floats
from ..data import DataSet
from ..inference.candidates import Ranked
from ..inference.fit import Fit
from ..inference.imperfections import BuiltPredictor, member_moves
from ..inference.noise import Whitener, input_slopes
from ..inference.predict import Predictor, slope
from ..inference.session import NEAR_SCORE, Session, predictors_of
from ..workspace.postures import default_postures
from .result import NextMeasurement

GRID_POSTURES_MAX = 400  # [1] of the grid, because each is solved for every effect and parameter
SLOW_POSTURES_MAX = 40  # [1] of pulls, or where friction remembers, because these take longer
UNKNOWN = 1e6  # [SI²] variance of what a fit does not determine, because no parameter is as large


@dataclass(frozen=True)
class Known:
    """The arm as a fit found it, at P postures, and what refitting may change."""

    markers: Floats  # (P, J, 3) [m]
    slopes: Floats  # (q, P, J, 3) [m] by its values, and mixtures of imperfections in their sd
    covariance: Floats  # (q, q) of these


def propose(session: Session, group: Sequence[Ranked]) -> NextMeasurement | None:
    """
    Propose the posture at which the predictions of a class differ most against the noise.

    A difference counts after refitting: without the part that fitted parameters can imitate.
    """
    compared = (_compare(session, group[:6], *one) for one in _conditions(session, group))
    best = max(filter(None, compared), key=lambda worth: worth[0], default=None)
    return best[1] if best else None


def _conditions(
    session: Session, group: Sequence[Ranked]
) -> Iterator[tuple[Floats, Floats | None, Floats | None]]:
    """Yield the grid of inputs, gravity where it is another, and a posture to come from."""
    if session.dataset.input == 'displacement':
        yield default_postures(session.robot, SLOW_POSTURES_MAX, 1, 'displacement'), None, None
        return
    grid = input_grid(session.dataset, session.robot.tension_limits)
    if not len(grid):  # those used are at the limits already
        return
    names = {name for r in group for name in r.candidate.names}
    stages = {session.catalogue[name].stage for name in {*names, *session.robot.effects}}
    if 'memory' in stages:
        grid = np.random.default_rng(0).permutation(grid)[:SLOW_POSTURES_MAX]
    yield grid, None, None
    gravity = np.array(session.predictor.robot.gravity or (0.0, 0.0, 0.0))
    if names & session.catalogue.needing('gravity') and np.linalg.norm(gravity) > 0.0:
        yield grid, 0.0 - gravity, None
    history = names & session.catalogue.needing('history')
    if session.dataset.path != 'from_straight' and history:
        yield grid, None, grid[np.argmax(grid.sum(axis=1))]


def input_grid(dataset: DataSet, limits: tuple[float, float]) -> Floats:
    """Feasible inputs (b, m) [N]: up to a quarter above those used, within the limits."""
    used = np.nan_to_num(dataset.inputs)
    m = used.shape[1]
    top = np.minimum(
        np.where(used.max(axis=0) > 0.0, 1.25 * used.max(axis=0), used.max()), limits[1]
    )
    low = max(limits[0], 0.0)
    levels = {1: 12, 2: 8, 3: 6, 4: 4}.get(m, 3)
    fractions = np.linspace(0.0, 1.0, levels)
    if levels**m <= 2 * GRID_POSTURES_MAX:
        unit = np.array(list(product(fractions, repeat=m)))
    else:
        unit = np.random.default_rng(0).choice(fractions, (GRID_POSTURES_MAX, m))
    grid, sums = low + unit * (top - low), used.sum(axis=1)
    grid = grid[grid.sum(axis=1) > min(1.5 * sums.min(), sums.max())]  # sums may be all alike
    return grid[grid.sum(axis=1) <= 2.0 * max(sums.max(), used.max())]


def as_if_measured(
    like: DataSet, inputs: Floats, after: Floats | None = None, trials: int = 1
) -> tuple[DataSet, slice]:
    """
    Return postures (b, m) as a data set without readings, and which of its postures they are.

    Loaded from straight, or each from the same posture `after` (m,).
    """
    shown = slice(None)
    if after is not None:
        pairs = np.stack([np.broadcast_to(after, inputs.shape), inputs], axis=1)
        inputs, shown = pairs.reshape(-1, inputs.shape[1]), slice(1, None, 2)
    dataset = replace(
        like,
        postures=tuple(map(str, range(len(inputs)))),
        inputs=inputs,
        positions=np.zeros((len(inputs), trials, len(like.markers), 3)),
        orientations=None,
        path='from_straight' if after is None else 'sequence',
        visits=None,
        parts=(),
        part=None,
        trial_inputs=None,
        trial_names=(),
    )
    return dataset, shown


def _compare(
    session: Session,
    group: Sequence[Ranked],
    inputs: Floats,
    gravity: Floats | None,
    after: Floats | None,
) -> tuple[float, NextMeasurement] | None:
    """Return the separation of the best posture of a grid, and that posture."""
    grid, shown = as_if_measured(session.dataset, inputs, after)
    if gravity is not None:
        grid = replace(grid, gravity=tuple(gravity.tolist()))
    predictor, arm = predictors_of(grid, session.robot, session.catalogue)
    whitener = Whitener(grid, session.noise, input_slopes(predictor, group[0].fit.point))
    known = list[Known]()
    for ranked in group:
        told = _predicted(arm, ranked.fit)
        if told is None:
            return None
        known.append(told)
    worth = separation(whitener, known)[shown]
    row = int(np.arange(len(grid.postures))[shown][np.argmax(worth)])
    tips = np.array([one.markers[row, -1] for one in known])
    apart = np.linalg.norm(tips[:, None] - tips[None, :], axis=2)
    names, digits = session.robot.inputs, 3 if grid.input == 'tension' else 5
    noise = float(np.sqrt(whitener.variance[row, -1].sum()))
    return float(worth.max()), NextMeasurement(
        dict(zip(names, grid.inputs[row].round(digits).tolist(), strict=True)),
        None if after is None else dict(zip(names, after.round(3).tolist(), strict=True)),
        None if gravity is None else gravity.tolist(),
        float(apart.max()),
        noise,
        {r.candidate.label: tip.tolist() for r, tip in zip(group, tips, strict=True)},
    )


def _predicted(arm: Predictor, fit: Fit) -> Known | None:
    """Return what is known of the arm as a fit found it; None without equilibrium."""
    arm.around = fit.members
    markers = arm.markers(fit.point)
    if markers is None:
        return None
    columns = []  # (P, J, 3) by each fitted parameter
    moves, kinds = np.zeros((0, *markers.shape)), fit.built.kinds[:-1]
    if kinds and isinstance(arm, BuiltPredictor):  # the last kind is new in every posture
        mixtures = block_diag(*fit.built.random.mixtures[:-1])
        sizes = fit.built.sizes[fit.built.random.owners][: mixtures.shape[1]]
        moves = np.tensordot((mixtures * sizes).T, member_moves(arm, fit.point, kinds), 1)
    for free, value in fit.point.items():
        h = 1e-3 * free.parameter.typical
        moved = arm.markers({**fit.point, free: value + h})
        columns.append(slope(markers, moved, h))
    slopes = np.concatenate([np.reshape(columns, (-1, *markers.shape)), moves])
    own = slice(0, len(slopes))
    return Known(markers, slopes, np.nan_to_num(fit.covariance[own, own], posinf=UNKNOWN))


def separation(whitener: Whitener, group: Sequence[Known]) -> Floats:
    """Return sums (P,) over pairs of the capped squared distance that refitting leaves."""
    postures, white, known = len(group[0].markers), [], []
    for one in group:
        moves = whitener.white(one.slopes).reshape(len(one.slopes), postures, -1).swapaxes(0, 1)
        white.append(whitener.white(one.markers).reshape(postures, -1, 1))  # (P, n, 1)
        known.append(moves.swapaxes(1, 2) @ (one.covariance @ moves))  # (P, n, n)
    total, noise = np.zeros(postures), np.eye(white[0].shape[1])
    for a, b in combinations(range(len(group)), 2):
        d = white[a] - white[b]
        left = (d * np.linalg.solve(noise + known[a] + known[b], d)).sum(axis=(1, 2))
        total += np.minimum(left, 0.5 * NEAR_SCORE)
    return total
