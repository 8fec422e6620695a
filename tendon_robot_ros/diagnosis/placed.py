"""
Effects that act at a place nobody knows: starts by what forces along the arm would gain, and fits.

To first order a force f (3,) [N] at one place in one posture changes chi² by f' D f - 2 g' f. The
measured shapes say where the places are, so that the direction of a string and the distance of a
wall that the arm touches follow from few unknowns, which are searched.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..inference.candidates import Candidate, Ranked
from ..inference.fit import Fit
from ..inference.fitter import BEST_FEW, FAILURES, GAINS_TO_COME, Fitter
from ..inference.imperfections import forces_along
from ..inference.predict import FreeParameter, Point, Predictor, free_parameters
from ..inference.search import DIFFERENCE_STEP
from ..inference.session import NEAR_SCORE, Session
from ..inference.statistics import QUANTILE
from ..model.derivatives import DIFFERENCE_STEP as FORCE_STEP

Start = Mapping[str, float]  # parameter -> SI
PUSH, STRING, WALL = 'point_load', 'tether', 'contact'  # effects whose place is unknown
DIRECTIONS = 200  # [1] of a wall or a string, because neighbours of so many are 15° apart
# [1] of a wall, 5° apart, because half of its gain may be gone 10° off; the best one near each of
# `DIRECTIONS` is a start
WALLS = 2000
# [1] arm lengths from the place to where a string is fixed, because its direction turns twice as
# fast at each as at the next
DISTANCES = (0.25, 0.5, 1.0, 2.0, 4.0)
STARTS = 4 * BEST_FEW  # [1] predicted before the best few are fitted, because slopes are not all


@dataclass(frozen=True)
class Screen:
    """What forces at n places of P postures would gain, imperfections of plausible size beside."""

    arc_lengths: Floats  # (n,) [m]
    gain: Floats  # (n, P, 3) [1/N] half the fall of chi² by a force
    weight: Floats  # (n, P, 3, P, 3) [1/N²] the rise of chi² by products of two of them
    free: Floats  # (n, P, 3) [m] the places as predicted without it
    measured: Floats  # (n, P, 3) [m] and as measured
    length: float  # [m] of the arm

    @classmethod
    def of(cls, fitter: Fitter, base: Fit) -> Screen | None:
        """Return what forces would gain on top of a fit; None where there are no slopes."""
        predictor, dataset = fitter.predictor, fitter.predictor.dataset
        fitter.linearise_around({})
        fitter.sizes = fitter.random.start
        arc_lengths = np.cumsum(predictor.model.arrays.cells[:, 0])
        markers = predictor.markers(base.point)
        if markers is None or predictor.model.remembers or PUSH in predictor.robot.effects:
            return None
        step = FORCE_STEP * predictor.model.catalogue[PUSH].parameters[1].typical
        slopes = forces_along(predictor, base.point, PUSH, step, arc_lengths)
        free = np.zeros((len(arc_lengths), len(predictor.inputs), 3))
        for part, shapes in predictor.settle(
            base.point, predictor.given(predictor.inputs), near=predictor.settled
        ):
            if shapes is None:
                return None
            free[:, part.rows] = shapes.of(predictor.last_visits(part)).positions.swapaxes(0, 1)
        order = np.argsort(dataset.arc_lengths)
        arcs = np.append(0.0, dataset.arc_lengths[order])
        missed = in_base_frame(predictor, dataset.mean - markers)
        off = np.insert(missed[:, order], 0, 0.0, axis=1)  # (P, 1 + J, 3) [m]
        seen = zip(off, np.isfinite(off).all(axis=2), strict=True)
        moved = np.array(
            [[np.interp(arc_lengths, arcs[own], row) for row in one[own].T] for one, own in seen]
        )
        left, white = fitter.lift(fitter.residual(markers)), fitter.whitener.white(slopes)
        shown = np.flatnonzero(dataset.trials > 0)
        alone = (fitter.whitener.owners == shown[:, None])[:, None]  # in one posture each
        columns = (fitter.lift((alone * one).reshape(-1, len(left)).T) for one in white)
        gains, weights = zip(*((own.T @ left, own.T @ own) for own in columns), strict=True)
        forces = len(shown), 3
        return cls(
            arc_lengths,
            np.reshape(gains, (-1, *forces)),
            np.reshape(weights, (-1, *forces, *forces)),
            free[:, shown],
            (free + moved.transpose(2, 0, 1))[:, shown],
            predictor.robot.length,
        )

    def loads(self) -> Iterator[Start]:
        """Yield loads, those that gain most first."""
        gain, weight = self.gain.sum(axis=1), self.weight.sum(axis=(1, 3))
        forces = np.array([np.linalg.lstsq(w, g)[0] for w, g in zip(weight, gain, strict=True)])
        for i in np.argsort(-(forces * gain).sum(axis=1)).tolist():
            yield {'arc_length': self.arc_lengths[i], **_vector('force', forces[i])}

    def strings(self) -> Iterator[Start]:
        """Yield strings, a place at a time, those that gain most first."""
        rows = []
        for i, arc_length in enumerate(self.arc_lengths.tolist()):
            at = self.measured[i]
            far = np.concatenate([self.length * d * directions() for d in DISTANCES])
            points = at.mean(axis=0) + far
            way = points[:, None] - at
            way = way / np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-9)
            flat = way.reshape(len(way), -1)
            gain = flat @ self.gain[i].ravel()
            weight = ((flat @ self.weight[i].reshape(2 * flat.shape[1:])) * flat).sum(axis=1)
            pull = np.maximum(gain, 0.0) / np.maximum(weight, 1e-300)
            m = int(np.argmax(gain * pull))
            place = {'arc_length': arc_length, **_vector('point', points[m])}
            rows.append((float(gain[m] * pull[m]), {**place, 'tension': float(pull[m])}))
        for _, start in sorted(rows, key=lambda row: -row[0]):
            yield start

    def springs(self, load: Ranked) -> Iterator[Start]:
        """Yield springs half as long at rest that pull as a load does in the mean."""
        place, *force = load.fit.values[:4].tolist()
        size, at = float(np.linalg.norm(force)), self.measured.mean(axis=1).T
        mean = np.array([np.interp(place, self.arc_lengths, own) for own in at])
        for distance in self.length * np.array(DISTANCES) if size > 0.0 else ():
            point = mean + distance * np.array(force) / size
            pull = {'slack_length': 0.5 * distance, 'stiffness': 2.0 * size / distance}
            yield {'arc_length': place, **_vector('point', point), **pull}

    def walls(self) -> Iterator[Start]:
        """
        Yield walls that the measured arm just touches, those that gain most first.

        They push where the arm is nearest to them, in the postures in which it would be behind.
        The best near every direction stands for its neighbours.
        """
        best, every = dict[int, tuple[float, Start]](), np.arange(self.gain.shape[1])
        normals = directions(WALLS)
        for near, normal in zip(np.argmax(normals @ directions().T, axis=1), normals, strict=True):
            distance = float((-self.measured @ normal).max())
            nearest = np.argmin(self.measured @ normal, axis=0)
            behind = -(self.free[nearest, every] @ normal) > distance
            gain = np.maximum(self.gain[nearest, every] @ normal, 0.0) * behind
            weight = self.weight[nearest, every, :, every] @ normal @ normal
            gained = float((gain**2 / np.maximum(weight, 1e-300)).sum())
            if near not in best or gained > best[near][0]:
                azimuth, elevation = np.arctan2(normal[1], normal[0]), np.arcsin(normal[2])
                flat = {'azimuth': float(azimuth), 'elevation': float(elevation)}
                best[near] = gained, {'distance': distance, **flat}
        for _, start in sorted(best.values(), key=lambda row: -row[0]):
            yield start


def in_base_frame(predictor: Predictor, vectors: Floats) -> Floats:
    """Return vectors (..., 3) in the robot's base frame that a turned tracker sees otherwise."""
    seen = predictor.model.measured(np.vstack([np.eye(3), np.zeros(3)]))
    return vectors @ np.linalg.inv(seen[:3] - seen[3])


def directions(count: int = DIRECTIONS) -> Floats:
    """Return unit vectors (count, 3), evenly spread (a spiral by the golden angle)."""
    up = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    flat = np.sqrt(1.0 - up**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up])


def _vector(stem: str, values: Floats) -> dict[str, float]:
    return {f'{stem}_{axis}': value for axis, value in zip('xyz', values.tolist(), strict=True)}


def fit_placed(session: Session, base: Fit, line: float) -> list[Ranked]:
    """
    Fit every effect whose place is unknown from its best starts; without equilibrium none.

    Those whose score is not expected to fall below a `line` stop early.
    """
    screen, fitted = Screen.of(session.fitter, base), dict[str, Ranked]()
    if screen is None:
        return []
    places = {PUSH: screen.loads(), STRING: screen.strings(), WALL: screen.walls()}
    for name, starts in places.items():
        if name not in session.catalogue or name in session.robot.effects:
            continue
        if name != PUSH and session.fitter.response > 0.0:
            continue  # what changes with the posture may be the model's error
        if name == WALL:
            hard = session.catalogue[name].parameters[0].typical
            starts = ({'stiffness': hard, **wall} for wall in starts)
        best = _fitted(session, name, starts, base, line, along=name != WALL)
        load = fitted.get(PUSH)
        if name == STRING and load is not None and load.score < base.deviance:
            both = best, _fitted(session, name, screen.springs(load), base, line, few=1)
            best = min(filter(None, both), key=lambda one: one.score, default=None)
        if best is not None:
            fitted[name] = best
    return list(fitted.values())


def _fitted(
    session: Session,
    name: str,
    starts: Iterable[Start],
    base: Fit,
    line: float,
    along: bool = False,
    few: int = BEST_FEW,
) -> Ranked | None:
    """
    Return the best fit of an effect from the `few` starts that a linear step leaves best.

    Of places `along` the arm those that are worse than their neighbours lead to the same fit. A
    start is not followed if that step, less what gains may come, leaves it as far behind the line
    as `Session.fit_all` allows.
    """
    fitter, best = session.fitter, None
    rows = list[tuple[float, dict[FreeParameter, float]]]()
    reach = DISTANCES[-1] * session.robot.length  # a string from farther away is as good as a load
    every = [within(f, reach) for f in free_parameters(session.catalogue[name], session.robot)]
    for start in sorted(islice(starts, STARTS), key=lambda start: start.get('arc_length', 0.0)):
        frees = {free: free.clip(start[free.key]) for free in every if free.key in start}
        with suppress(*FAILURES):
            search = fitter.search(tuple(frees), frees, near=base.settled)
            rows.append((fitter.estimate(search).deviance, frees))
    estimates = np.pad([estimate for estimate, _ in rows], 1, constant_values=np.inf)
    lowest = estimates[1:-1] <= np.minimum(estimates[:-2], estimates[2:])
    likely = [row for row, own in zip(rows, lowest, strict=True) if own or not along]
    for estimate, frees in sorted(likely, key=lambda row: row[0])[:few]:
        candidate = Candidate((name,), tuple(frees), present=False)
        hopeless = (line if best is None else min(line, best.score)) - 2.0 * len(frees)
        gain = max(base.deviance - estimate, 0.0)
        with suppress(*FAILURES):
            if estimate - GAINS_TO_COME * gain <= hopeless + NEAR_SCORE:
                fit = fitter.fit(candidate.frees, frees, hopeless=hopeless)
            elif best is None:
                fit = fitter.freeze(fitter.search(candidate.frees, frees))
            else:
                break
            if best is None or fit.deviance < best.fit.deviance:
                best = session.rank(candidate, fit)
    return best


def ways(name: str, postures: int) -> int:
    """
    Return in how many ways an effect is tried beside its parameters, which its p-value counts.

    A string pulls with a weight or as a spring. A plane cuts off some of P points in space in
    2 sum_k (P - 1 over k) ways, k from 0 to 3 (Cover 1965): every subset of four.
    """
    walls = 2 * sum(math.comb(postures - 1, k) for k in range(4))
    return {WALL: walls, STRING: 2}.get(name, 1)


def within(free: FreeParameter, reach: float) -> FreeParameter:
    """Return a free parameter whose bounds, where it is a length, are within a reach [m]."""
    own = free.parameter
    low, high = max(own.low, -reach), min(own.high, reach)
    return replace(free, parameter=replace(own, low=low, high=high)) if own.unit == 'm' else free


def acting(predictor: Predictor, point: Point, name: str) -> Floats:
    """
    Return where an effect pushes the arm in every posture, and how, by its own law.

    Returns
    -------
    (P, 7)
        Arc length [m] (nan: it does not push there), place [m] and force [N] in the base frame;
        of forces at several places their sum, at their mean by size.

    """
    effect, arrays = predictor.model.catalogue[name], predictor.model.arrays
    lengths, moved = arrays.cells[:, 0], (0.0, 0.0, 0.0)
    nothing = moved, moved, moved  # force, moment, friction
    ends, behind = np.cumsum(lengths).tolist(), np.append(lengths[1:], np.inf).tolist()
    rows = np.full((len(predictor.inputs), 7), np.nan)
    for part, shapes in predictor.settle(point, predictor.given(predictor.inputs)):
        if shapes is None:
            continue
        last = shapes.of(predictor.last_visits(part))
        own = [arrays.layout.rows[name, parameter.name] for parameter in effect.parameters]
        values = arrays.values[own, 0].tolist()
        for p, places, frames in zip(part.rows, last.positions, last.frames, strict=True):
            cells = zip(places, frames.reshape(-1, 9), ends, lengths, behind, strict=True)
            forces = np.array(
                [
                    effect.law(*nothing, at.tolist(), frame.tolist(), *along, moved, *values)[0]
                    for at, frame, *along in cells
                ]
            )
            sizes = np.linalg.norm(forces, axis=1)
            if sizes.any():
                mean = sizes / sizes.sum()
                rows[p] = [mean @ ends, *(mean @ places), *forces.sum(axis=0)]
    return rows


def pushes_by(session: Session, fit: Fit, name: str, scale: float = 1.0) -> list[dict[str, Any]]:
    """
    Return in which postures an effect of a fit pushes the arm, where [m] and how [N].

    Where the tracker sees them. `half` is half the 95 % interval of the arc length; `scale`
    multiplies the covariance.
    """
    predictor, slopes = session.predictor, []
    point = {free: fit.point[free] for free in fit.frees}  # those beside it bend the arm as well
    rows, own = acting(predictor, point, name), [free.effect == name for free in point]
    for free in (one for one in point if one.effect == name):
        step = DIFFERENCE_STEP * free.parameter.typical
        moved = acting(predictor, {**point, free: point[free] + step}, name)
        slopes.append(np.nan_to_num(moved[:, 0] - rows[:, 0]) / step)
    known = scale * fit.interval_covariance[np.ix_(own, own)]
    spread = np.einsum('qp,qr,rp->p', slopes, np.nan_to_num(known, posinf=0.0), slopes)
    half = QUANTILE * np.sqrt(np.maximum(spread, 0.0))
    at = predictor.model.measured(rows[:, 1:4])
    force = predictor.model.measured(rows[:, 1:4] + rows[:, 4:]) - at
    return [
        {
            'posture': session.dataset.postures[p],
            'arc_length': float(rows[p, 0]),
            'half': float(half[p]),
            'at': at[p].tolist(),
            'force': force[p].tolist(),
        }
        for p in np.flatnonzero(np.isfinite(rows[:, 0]))
    ]
