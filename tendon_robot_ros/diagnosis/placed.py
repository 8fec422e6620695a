"""
Effects that act at a place nobody knows: starts by what forces along the arm would gain, and fits.

To first order a force f (3,) [N] at one place in one posture changes chi² by f' D f - 2 g' f. The
measured shapes say where the places are, so that the direction of a string and the distance of a
wall that the arm touches follow from few unknowns, which are searched.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..inference.candidates import Candidate, Ranked
from ..inference.fit import Fit
from ..inference.fitter import BEST_FEW, FAILURES, Fitter
from ..inference.imperfections import pushes
from ..inference.intervals import QUANTILE
from ..inference.predict import FreeParameter, Point, Predictor, free_parameters
from ..inference.search import DIFFERENCE_STEP
from ..inference.session import NEAR_SCORE, Session

Start = Mapping[str, float]  # parameter -> SI
DIRECTIONS = 200  # [1] of a wall or a string, because neighbours of so many are 15° apart
# [1] arm lengths from the place to where a string is fixed, because its direction turns twice as
# fast at each as at the next
DISTANCES = (0.25, 0.5, 1.0, 2.0, 4.0)
STARTS = 4 * BEST_FEW  # [1] predicted before the best few are fitted, because slopes are not all


@dataclass(frozen=True)
class Screen:
    """What forces at n places of P postures would gain, imperfections of plausible size beside."""

    arc_lengths: Floats  # (n,) [m]
    gain: Floats  # (n, P, 3) [1/N] half the fall of chi² by a force
    weight: Floats  # (n, P, 3, 3) [1/N²] the rise of chi² by its square
    free: Floats  # (n, P, 3) [m] the places as predicted without it
    measured: Floats  # (n, P, 3) [m] and as measured
    length: float  # [m] of the arm
    hard: float  # [N/m] stiffness of a wall that gives way a hundred times less than the tip

    @classmethod
    def of(cls, fitter: Fitter, base: Fit) -> Screen | None:
        """Return what forces would gain on top of a fit; None where there are no slopes."""
        predictor, dataset = fitter.predictor, fitter.predictor.dataset
        fitter.linearise_around({})
        fitter.sizes = fitter.random.start
        arc_lengths = np.cumsum(predictor.model.arrays.cells[:, 0])
        slopes, markers = None, predictor.markers(base.point)
        if markers is not None:
            slopes = pushes(predictor, base.point, arc_lengths)
        if slopes is None or markers is None:
            return None
        n, _, P = slopes.shape[:3]
        alone = fitter.lift(fitter.lift(fitter.residual(markers)))  # counts what nothing explains
        white = fitter.whitener.white(slopes)
        gain, weight = np.zeros((n, P, 3)), np.zeros((n, P, 3, 3))
        for p in range(P):
            own = white[:, :, fitter.whitener.owners == p]
            gain[:, p] = own @ alone[: len(fitter.whitener.owners)][fitter.whitener.owners == p]
            weight[:, p] = own @ own.swapaxes(1, 2)
        free = np.zeros((n, P, 3))
        for part, shapes in predictor.settle(
            base.point, predictor.given(predictor.inputs), near=predictor.settled
        ):
            if shapes is None:
                return None
            free[:, part.rows] = shapes.of(predictor.last_visits(part)).positions.swapaxes(0, 1)
        order = np.argsort(dataset.arc_lengths)
        off = np.nan_to_num(dataset.mean - markers)[:, order]
        arcs = np.append(0.0, dataset.arc_lengths[order])
        moved = [
            [np.interp(arc_lengths, arcs, np.append(0.0, row)) for row in one.T] for one in off
        ]
        return cls(
            arc_lengths,
            gain,
            weight,
            free,
            free + np.array(moved).transpose(2, 0, 1),
            predictor.robot.length,
            predictor.model.catalogue['contact'].parameters[0].typical,
        )

    def loads(self) -> Iterator[Start]:
        """Yield loads, those that gain most first."""
        gain, weight = self.gain.sum(axis=1), self.weight.sum(axis=1)
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
            gain = np.einsum('mpi,pi->m', way, self.gain[i])
            weight = np.einsum('mpi,pij,mpj->m', way, self.weight[i], way)
            pull = np.maximum(gain, 0.0) / np.maximum(weight, 1e-300)
            m = int(np.argmax(gain * pull))
            place = {'arc_length': arc_length, **_vector('point', points[m])}
            rows.append((float(gain[m] * pull[m]), {**place, 'tension': float(pull[m])}))
        for _, start in sorted(rows, key=lambda row: -row[0]):
            yield start

    def strings_like(self, load: Ranked) -> Iterator[Start]:
        """Yield strings that pull as a load does where the arm is in the mean."""
        place, *force = load.fit.values[:4].tolist()
        size = float(np.linalg.norm(force))
        at = [np.interp(place, self.arc_lengths, own) for own in self.measured.mean(axis=1).T]
        for distance in DISTANCES if size > 0.0 else ():
            point = np.array(at) + distance * self.length * np.array(force) / size
            yield {'arc_length': place, **_vector('point', point), 'tension': size}

    def walls(self) -> Iterator[Start]:
        """
        Yield walls that the measured arm just touches, those that gain most first.

        They push where the arm is nearest to them, in the postures in which it would be behind.
        """
        rows, every = [], np.arange(self.gain.shape[1])
        for normal in directions():
            distance = float((-self.measured @ normal).max())
            nearest = np.argmin(self.measured @ normal, axis=0)
            behind = -(self.free[nearest, every] @ normal) > distance
            gain = np.maximum(self.gain[nearest, every] @ normal, 0.0) * behind
            weight = np.einsum('pij,i,j->p', self.weight[nearest, every], normal, normal)
            flat = {
                'stiffness': self.hard,
                'distance': distance,
                'azimuth': float(np.arctan2(normal[1], normal[0])),
                'elevation': float(np.arcsin(normal[2])),
            }
            rows.append((float((gain**2 / np.maximum(weight, 1e-300)).sum()), flat))
        for _, start in sorted(rows, key=lambda row: -row[0]):
            yield start


def directions() -> Floats:
    """Return `DIRECTIONS` unit vectors (m, 3), evenly spread (a spiral by the golden angle)."""
    up = 1.0 - (2.0 * np.arange(DIRECTIONS) + 1.0) / DIRECTIONS
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(DIRECTIONS)
    flat = np.sqrt(1.0 - up**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up])


def _vector(stem: str, values: Floats) -> dict[str, float]:
    return {f'{stem}_{axis}': value for axis, value in zip('xyz', values.tolist(), strict=True)}


def fit_placed(session: Session, base: Fit) -> list[Ranked]:
    """
    Fit every effect whose place is unknown from its best starts; without equilibrium none.

    A string also starts from the load that explains most: it is one from far away.
    """
    screen, found = Screen.of(session.fitters[0], base), list[Ranked]()
    if screen is None:
        return found
    load = _fitted(session, 'point_load', screen.loads(), base.deviance)
    strings, walls = [*screen.strings()], screen.walls()
    if load is not None:
        found.append(load)
        strings = [*screen.strings_like(load), *strings]
    if session.fitters[0].response > 0.0:
        return found  # a force that seems to change with the posture may be the model's error
    for name, starts in (('tether', strings), ('contact', walls)):
        ranked = _fitted(session, name, starts, base.deviance)
        if ranked is not None:
            found.append(ranked)
    return found


def _fitted(session: Session, name: str, starts: Iterable[Start], line: float) -> Ranked | None:
    """Return the best fit of an effect from the first starts, those with the least error first."""
    fitter, best = session.fitters[0], None
    rows = list[tuple[float, int, dict[FreeParameter, float]]]()
    every = free_parameters(session.catalogue[name], session.robot)
    for start in islice(starts, STARTS):
        frees = {
            free: float(np.clip(start[free.key], free.parameter.low, free.parameter.high))
            for free in every
            if free.key in start
        }
        with suppress(*FAILURES):
            search = fitter.search(tuple(frees), frees)
            rows.append((float(search.r @ search.r), len(rows), frees))
    for _, _, frees in sorted(rows)[:BEST_FEW]:
        candidate = Candidate((name,), tuple(frees), present=False)
        hopeless = line + NEAR_SCORE if best is None else best.fit.deviance
        with suppress(*FAILURES):
            fit = fitter.fit(candidate.frees, frees, hopeless=hopeless)
            if best is None or fit.deviance < best.fit.deviance:
                best = session.rank(candidate, fit)
    return best


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
    lengths, nothing = arrays.cells[:, 0], (0.0, 0.0, 0.0)
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
                    effect.law(nothing, nothing, at.tolist(), frame.tolist(), *along, *values)[0]
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
    point = {free: value for free, value in fit.point.items() if free.effect == name}
    rows, own = acting(predictor, point, name), [free.effect == name for free in fit.frees]
    for free, value in point.items():
        step = DIFFERENCE_STEP * free.parameter.typical
        moved = acting(predictor, {**point, free: value + step}, name)
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
