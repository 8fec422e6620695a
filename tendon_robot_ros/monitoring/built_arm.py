"""
One arm as it was built, learned posture by posture while nothing touches it.

Its imperfections b (cells, kinks, gains, the tracker's frame; prior: plausible sizes) are
estimated by a Kalman filter: y = f(T) + B(T) b + remainder + noise. What no imperfection explains,
another one in every posture and smooth along the arm, has a size that the predictions of the
reference postures tell best. Tip force and drift alarm stand on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..comparison.predict import Point, Predictor
from ..data import DataSet, Marker
from ..diagnosis.as_built import REMAINDER, Kind, remainders
from ..diagnosis.slopes import imperfections
from ..diagnosis.split import SplitPredictor
from ..effects import Catalogue
from ..robot import Robot
from ..robot.estimates import natural_sizes

Floats = npt.NDArray[np.float64]
REMAINDER_SHARES = (0.0, 0.0005, 0.001, 0.002, 0.004, 0.008, 0.016)  # of the length, at the tip


@dataclass(frozen=True)
class Expected:
    """What is expected of a posture: markers, and how imperfections of 1 sd move them."""

    markers: Floats  # (3 J,) [m] of the model and of the imperfections as they are known
    columns: Floats  # (3 J, q) [m] per sd


class BuiltArm:
    """The arm that is watched."""

    def __init__(
        self,
        robot: Robot,
        catalogue: Catalogue,
        markers: Sequence[Marker],
        noise: float,
        level: float = 1.0,
    ) -> None:
        """
        Know nothing yet.

        Parameters
        ----------
        robot : Robot
            The description, with the effects that were found.
        catalogue : Catalogue
        markers : (J,) sequence of Marker
        noise : float
            1 sd of a coordinate of a marker [m].
        level : float
            How well the arm is built, times an ordinary laboratory's work [1]; 0: as described.

        """
        self.catalogue = catalogue.sized(natural_sizes(robot))
        self.robot, self.noise = robot, noise
        self.level = 0.0 if robot.exact else level
        m, J = len(robot.inputs), len(markers)
        blank = np.full((1, 1, J, 3), np.nan)
        dataset = DataSet('now', robot, tuple(markers), ('now',), np.zeros((1, m)), blank,
                          gravity=robot.gravity)  # fmt: skip
        self.whole = Predictor(dataset, robot, self.catalogue)
        self.split = SplitPredictor(self.whole)
        one = DataSet('one', robot, tuple(markers), ('one',), np.zeros((1, m)),
                      np.zeros((1, 1, J, 3)), gravity=robot.gravity)  # fmt: skip
        rest = remainders(Predictor(one, robot, self.catalogue)).reshape(-1, 3 * J)
        self._rest = rest.T @ rest  # (3 J, 3 J) of a remainder of 1 m sd at the tip
        self.remainder = 0.0  # [m] 1 sd at the tip
        self.kinds: tuple[Kind, ...] = ()
        self.mean: Floats = np.zeros(0)
        self.covariance: Floats = np.zeros((0, 0))

    def expected(self, tensions: Floats, point: Point | None = None) -> Expected | None:
        """Return what is expected under tensions (m,) [N]; None without equilibrium."""
        inputs = np.maximum(tensions, 0.0)[None]
        here = self.whole.markers(point or {}, inputs)
        if here is None:
            return None
        columns = self._columns(inputs, point or {}, here.size)
        if columns is None:
            return None
        if len(self.mean) != columns.shape[1]:
            self.forget(columns.shape[1])
        return Expected(here.ravel() + columns @ self.mean, columns)

    def forget(self, count: int) -> None:
        """Know nothing of so many imperfections but their prior."""
        self.mean, self.covariance = np.zeros(count), np.eye(count)

    def rest(self, rows: npt.NDArray[np.bool_]) -> Floats:
        """Covariance of seen coordinates under a remainder of 1 m sd at the tip [1]."""
        return np.asarray(self._rest[np.ix_(rows, rows)])

    def scatter(self, rows: npt.NDArray[np.bool_]) -> Floats:
        """Covariance [m²] of seen coordinates that is new in every posture."""
        noise = self.noise**2 * np.eye(int(rows.sum()))
        return np.asarray(self.remainder**2 * self.rest(rows) + noise)

    def fit(self, tensions: Floats, positions: Floats) -> float:
        """
        Learn from reference postures, once more for every size of the remainder; keep the best.

        Parameters
        ----------
        tensions : (P, m) [N]
        positions : (P, J, 3) [m]

        Returns
        -------
        float
            1 sd of the remainder at the tip [m].

        """
        seen = [(self.expected(t), p.ravel()) for t, p in zip(tensions, positions, strict=True)]
        base = [
            (e.markers - e.columns @ self.mean, e.columns, y) for e, y in seen if e is not None
        ]
        best, found = -np.inf, 0.0
        for share in REMAINDER_SHARES:
            self.remainder = share * self.robot.length
            likelihood = self._learn_all(base)
            if likelihood > best:
                best, found = likelihood, self.remainder
        self.remainder = found
        self._learn_all(base)
        return found

    def learn(self, expected: Expected, measured: Floats) -> float:
        """Take a posture (3 J,) [m] into what is known; return its predictive log likelihood."""
        rows = np.isfinite(measured)
        columns = expected.columns[rows]
        off = measured[rows] - expected.markers[rows]
        spread = columns @ self.covariance @ columns.T + self.scatter(rows)
        root = np.linalg.cholesky(spread)
        white = np.linalg.solve(root, off)
        gain = np.linalg.solve(root, columns @ self.covariance)  # (rows, q), whitened
        self.mean = self.mean + gain.T @ white
        self.covariance = self.covariance - gain.T @ gain
        return float(-0.5 * white @ white - np.log(np.diag(root)).sum())

    def _learn_all(self, base: Sequence[tuple[Floats, Floats, Floats]]) -> float:
        total = 0.0
        self.forget(len(self.mean))
        for markers, columns, measured in base:
            total += self.learn(Expected(markers + columns @ self.mean, columns), measured)
        return total

    def _columns(self, inputs: Floats, point: Point, size: int) -> Floats | None:
        """Return what each imperfection of a plausible size does (3 J, q) [m]."""
        if self.level == 0.0:
            return np.zeros((size, 0))
        self.split.inputs = inputs
        found = imperfections(self.split, point)
        if found is None:
            return None
        self.kinds = tuple(kind for kind in found.kinds if kind.name != REMAINDER)
        plausible = np.repeat([k.plausible for k in self.kinds], [len(k) for k in self.kinds])
        moves = found.moves[: len(plausible)].reshape(len(plausible), -1)
        return np.asarray(self.level * (plausible[:, None] * moves).T)
