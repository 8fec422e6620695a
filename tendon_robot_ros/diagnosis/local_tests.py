"""
Where the best model is still wrong: one test per place, with the false discovery rate held.

A place (one cell, one tendon; in all postures or in one) is a column c of what a fault there would
do to the whitened markers. With the parameters and the imperfections of a fit free to give way, c_
is what they leave of it, r what they leave of the measurements, and z = c_'r / |c_| is standard
normal where nothing is wrong: the score test (Rao 1948) under the covariance of an arm as it is
built. Among the places of one kind the false discovery rate is held by Benjamini and Hochberg's
step (1995), at an equal share for every kind, so that it is held over all of them. What the
strongest place explains is taken off before the next one is named. Where one asks for a bend or a
stiffness that no cell can have, the cause is not a place's, and no weaker one is named either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from ..common.arrays import Floats, Ints
from ..inference.fit import Fit, covariance_root
from ..inference.imperfections import (
    ACROSS,
    BEND_MAX_RAD,
    GAIN,
    HOLE,
    KINK,
    ZERO,
    BuiltPredictor,
    Imperfections,
    Kind,
    imperfections,
)
from ..inference.marginal import NEGLIGIBLE
from ..inference.noise import Whitener
from ..inference.predict import CELLS
from ..inference.session import Session
from ..inference.statistics import QUANTILE, chi2_isf, false_discovery_control, normal_cdf, t_sf
from ..robot import Robot
from .verdict import FALSE_DISCOVERY_RATE, P_SEVERAL_MIN

IN_CELLS = (CELLS, KINK, ACROSS)
IN_INPUTS = (GAIN, HOLE, ZERO)
ONCE = (KINK, ACROSS, GAIN, ZERO)  # kinds that are also looked for in single postures
FAULTS_MAX = 8  # [1] places that are named, because nobody looks at more
CHANGE_MAX = 3.0  # [1] of the stiffness of one cell, by slopes: docs/inference.md


@dataclass(frozen=True)
class Place:
    """Where a fault may be."""

    kind: str  # 'cell_stiffness', 'cell_kink', 'cell_kink_across', 'channel_gain', ...
    name: str  # of the member: 'cell 9', 'cell 9 towards x', 'left'
    unit: str
    posture: int | None = None  # None: in all of them


@dataclass(frozen=True)
class LocalFault:
    """A place at which the model is wrong by more than chance, the false discovery rate held."""

    place: Place
    size: float  # [unit of the place] by the markers
    low: float
    high: float
    z: float  # [1] in standard deviations
    rate: float  # smallest false discovery rate at which it is named
    alike: tuple[str, ...]  # places that explain as much, itself included

    def to_json(self, robot: Robot, postures: Sequence[str]) -> dict[str, Any]:
        """Return plain data for JSON; `along` [m] is where the cell lies on the straight arm."""
        p, words = self.place.posture, self.place.name.split()
        along = None
        if words[0] == 'cell' and self.place.kind in IN_CELLS:
            ends = np.cumsum([0.0, *robot.cell_lengths])
            cell = robot.cell_names.index(' '.join(words[:2]))
            along = ends[cell : cell + 2].tolist()
        return {
            **vars(self),
            'kind': self.place.kind,
            'place': self.place.name,
            'posture': None if p is None else postures[p],
            'along': along,
            'unit': self.place.unit,
            'alike': list(self.alike),
        }


def local_faults(
    kinds: Sequence[Kind], moves: Floats, whitener: Whitener, fit: Fit, freedom: float = np.inf
) -> list[LocalFault]:
    """
    Return where a fit is still wrong, the strongest first; empty where it is nowhere.

    Parameters
    ----------
    kinds : sequence of Kind
    moves : (q, P, J, 3) [m per unit]
        Derivatives of the markers by each of their members.
    whitener : Whitener
        Of the fit.
    fit : Fit
    freedom : float
        Degrees of freedom behind the noise.

    """
    places, columns = places_in(kinds, moves, whitener)
    faults = faults_among(places, columns, fit.residual, fit.jacobian, freedom)
    return list(takewhile(lambda fault: not is_absurd(fault), faults))


def is_absurd(fault: LocalFault) -> bool:
    """Return whether a place would need an impossible size: then the cause lies elsewhere."""
    limits = {CELLS: CHANGE_MAX, KINK: BEND_MAX_RAD, ACROSS: BEND_MAX_RAD}
    return abs(fault.size) > limits.get(fault.place.kind, np.inf)


def faults_of(session: Session, fit: Fit) -> list[dict[str, Any]]:
    """Return the local faults of a fit in a session that was weighed there, as plain data."""
    own: Imperfections | None = session.imperfections
    if session.robot.exact or session.dataset.reference:  # any may be off, or have changed
        own = imperfections(BuiltPredictor(session.predictor), fit.point, changed=True)
    if own is None:
        return []
    faults = local_faults(own.kinds, own.moves, session.whitener, fit, session.noise.freedom)
    return [fault.to_json(session.robot, session.dataset.postures) for fault in faults]


def faults_among(
    places: Sequence[Place],
    columns: PlaceColumns,
    residual: Floats,
    jacobian: Floats,
    freedom: float = np.inf,
) -> list[LocalFault]:
    """
    Test places against the residual of a fit.

    Parameters
    ----------
    places : (M,)
    columns : PlaceColumns
        Derivatives of the N whitened predictions by each of M places.
    residual : (N + priors,)
        Measured minus predicted, whitened, rows of priors last.
    jacobian : (N + priors, q)
        Of the residual by all fitted parameters and imperfections.
    freedom : float
        Degrees of freedom behind the noise.

    """
    tests = _Tests(places, columns, residual, jacobian)
    chosen, rates = list[int](), list[float]()
    while len(chosen) < FAULTS_MAX:
        z, _ = tests.beside(chosen)
        rate = _rates(places, z, freedom)
        lowest = np.flatnonzero(rate <= rate.min(initial=1.0))
        if not len(lowest) or rate[lowest[0]] > FALSE_DISCOVERY_RATE:
            break
        chosen.append(int(lowest[np.argmax(np.abs(z[lowest]))]))
        rates.append(float(rate[chosen[-1]]))
    for _ in range(2):  # reselect each place given the others
        for k in range(len(chosen)):
            z, _ = tests.beside(chosen[:k] + chosen[k + 1 :])
            same = tests.same_kind(chosen[k], z)  # empty if the others explain it
            chosen[k] = max(same, key=lambda i: abs(z[i]), default=chosen[k])
    faults = []
    for k, best in enumerate(chosen):
        z, length = tests.beside(chosen[:k] + chosen[k + 1 :])
        if not np.isfinite(z[best]):
            continue
        sd, half = float(z[best]), float(QUANTILE / length[best])
        size = sd / float(length[best])
        alike = tuple(
            places[i].name
            for i in tests.same_kind(best, z)
            if z[i] ** 2 > z[best] ** 2 - chi2_isf(P_SEVERAL_MIN, 1)
        )
        fault = LocalFault(places[best], size, size - half, size + half, sd, rates[k], alike)
        faults.append(fault)
    return sorted(faults, key=lambda fault: -abs(fault.z))


@dataclass(frozen=True)
class PlaceColumns:
    """
    Derivatives of N values by each of M places: one of K columns, or its rows in one posture.

    The columns of single postures are not stored, since there are K times P of them.
    """

    whole: Floats  # (N, K)
    owners: Ints  # posture (N,) of each value
    column: Ints  # (M,) which of the K
    posture: Ints  # (M,) in which posture; -1: in all

    def __getitem__(self, i: int) -> Floats:
        """Return the column (N,) of a place."""
        p, own = self.posture[i], self.whole[:, self.column[i]]
        return own if p < 0 else np.where(self.owners == p, own, 0.0)

    def products(self, vectors: Floats) -> Floats:
        """Return the products (M, d) of all columns with vectors (N, d)."""
        return self._products(self.whole, vectors)

    def squares(self) -> Floats:
        """Return the squared lengths (M,) of all columns."""
        return self._products(np.square(self.whole), np.ones((len(self.whole), 1)))[:, 0]

    def _products(self, whole: Floats, vectors: Floats) -> Floats:
        products = np.empty((len(self.column), vectors.shape[1]))
        for p in np.unique(self.posture):
            own, rows = self.posture == p, slice(None) if p < 0 else self.owners == p
            products[own] = (whole[rows].T @ vectors[rows])[self.column[own]]
        return products


class _Tests:
    """The columns of places and a residual, projected orthogonally to the columns of the fit."""

    def __init__(
        self, places: Sequence[Place], columns: PlaceColumns, residual: Floats, jacobian: Floats
    ) -> None:
        n, self.columns = len(columns.whole), columns
        self._basis = _basis(jacobian)
        self._explained = columns.products(self._basis[:n])  # (M, q): part in the space of the fit
        self.residual = residual - self._basis @ (self._basis.T @ residual)
        squares = columns.squares()
        self._squares = squares - np.square(self._explained).sum(axis=1)
        self._along = columns.products(self.residual[:n, None])[:, 0]
        self.length_min = 2.0 * NEGLIGIBLE * np.maximum(np.sqrt(squares), 1e-12)
        self.families = [(place.kind, place.posture) for place in places]

    def beside(self, chosen: Sequence[int]) -> tuple[Floats, Floats]:
        """Return z (M,), nan where undetermined, and lengths (M,) beside chosen places."""
        n, picked = len(self.columns.whole), np.zeros((len(self.residual), len(chosen)))
        for k, i in enumerate(chosen):
            picked[:n, k] = self.columns[i]
        basis = _basis(picked - self._basis @ self._explained[list(chosen)].T)
        cross = self.columns.products(basis[:n])
        length = np.sqrt(np.maximum(self._squares - np.square(cross).sum(axis=1), 0.0))
        known = length > self.length_min
        z = np.full(len(length), np.nan)
        z[known] = (self._along - cross @ (basis.T @ self.residual))[known] / length[known]
        return z, length

    def same_kind(self, i: int, z: Floats) -> list[int]:
        """Return the determined places of the same kind and posture, i among them."""
        same = [family == self.families[i] for family in self.families]
        return np.flatnonzero(same & np.isfinite(z)).tolist()


def _rates(places: Sequence[Place], z: Floats, freedom: float) -> Floats:
    """Return the false discovery rate (M,) at which each place would just be named."""
    families: dict[tuple[str, bool], list[int]] = {}
    for i in np.flatnonzero(np.isfinite(z)).tolist():
        families.setdefault((places[i].kind, places[i].posture is None), []).append(i)
    rates = np.ones(len(places))
    for members in families.values():
        sizes, p = np.abs(z[members]), np.ones(len(members))
        odd = sizes > QUANTILE  # the p-values of the others decide nothing
        if np.isfinite(freedom):
            p[odd] = [2.0 * t_sf(size, freedom) for size in sizes[odd].tolist()]
        else:
            p[odd] = 2.0 * normal_cdf(-sizes[odd])
        rates[members] = np.minimum(len(families) * false_discovery_control(p), 1.0)
    return rates


def _basis(jacobian: Floats) -> Floats:
    """Orthonormal basis (N, d) of the columns of a Jacobian."""
    return jacobian @ covariance_root(jacobian)[0]


def places_in(
    kinds: Sequence[Kind], moves: Floats, whitener: Whitener
) -> tuple[list[Place], PlaceColumns]:
    """Return the places to test, and the derivatives of the whitened markers by them."""
    named = [(kind, member) for kind in kinds for member in kind.members]
    tested = np.array([kind.name in IN_CELLS + IN_INPUTS for kind, _ in named], dtype=bool)
    postures = np.unique(whitener.owners).tolist()
    places, column, posture = [], [], []
    for i, k in enumerate(np.flatnonzero(tested).tolist()):
        kind, member = named[k]
        once = postures if kind.name in ONCE else []
        places += [Place(kind.name, member, kind.unit, p) for p in (None, *once)]
        column += [i] * (1 + len(once))
        posture += [-1, *once]
    whole = whitener.white(moves[tested]).T
    return places, PlaceColumns(
        whole, whitener.owners, np.array(column, dtype=int), np.array(posture, dtype=int)
    )
