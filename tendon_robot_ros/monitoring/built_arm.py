"""
One arm as it was built, learned posture by posture while nothing touches it.

Its imperfections b (cells, kinks, gains, the tracker's frame; prior: plausible sizes) are
estimated by an extended Kalman filter: y = f(T, b) + remainder + noise, around those that are
known, for the references once more around those that were found. What no imperfection explains,
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
from ..diagnosis.as_built import remainders
from ..diagnosis.slopes import imperfections
from ..diagnosis.split import SplitPredictor
from ..effects import Catalogue
from ..model.shape import ShapeBatch
from ..robot import Robot
from ..robot.estimates import natural_sizes

Floats = npt.NDArray[np.float64]
ROUNDS = 2  # of learning from references, the second around what the first found
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
        self.kinds = self.split.kinds() if self.level > 0.0 else ()
        usual = [np.full(len(kind), self.level * kind.plausible) for kind in self.kinds]
        self.plausible = np.concatenate(usual) if usual else np.zeros(0)  # (q,) 1 sd, each a unit
        self._members: dict[str, Floats] | None = None
        self.forget()

    @property
    def members(self) -> dict[str, Floats]:
        """The imperfections as they are known, by kind [its unit]."""
        if self._members is None:
            self._members = self._named(self.mean)
        return self._members

    def expected(self, tensions: Floats, point: Point | None = None) -> Expected | None:
        """Return what is expected under tensions (m,) [N]; None without equilibrium."""
        inputs = np.maximum(tensions, 0.0)[None]
        shapes = self.shapes(inputs, point or {})
        columns = None if shapes is None else self._columns(inputs, point or {})
        if shapes is None or columns is None:
            return None
        return Expected(self.split.see(shapes).ravel(), columns)

    def shapes(self, inputs: Floats, point: Point) -> ShapeBatch | None:
        """Shapes under tensions (1, m) [N] with the imperfections as they are known."""
        self.split.around = self.members
        ((_, shapes),) = self.split.settle(point, self.split.given(inputs))
        return shapes

    def forget(self) -> None:
        """Know nothing of the imperfections but their prior."""
        self.mean, self.covariance = np.zeros(len(self.plausible)), np.eye(len(self.plausible))
        self._members = None

    def rest(self, rows: npt.NDArray[np.bool_]) -> Floats:
        """Covariance of seen coordinates under a remainder of 1 m sd at the tip [1]."""
        return np.asarray(self._rest[np.ix_(rows, rows)])

    def scatter(self, rows: npt.NDArray[np.bool_], frames: int = 1) -> Floats:
        """Covariance [m²] of seen coordinates, the mean of frames, new in every posture."""
        noise = self.noise**2 / frames * np.eye(int(rows.sum()))
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
        self.forget()
        for _ in range(ROUNDS):
            base, best, found = self._linear(tensions, positions), -np.inf, 0.0
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
        self.mean, self._members = self.mean + gain.T @ white, None
        self.covariance = self.covariance - gain.T @ gain
        return float(-0.5 * white @ white - np.log(np.diag(root)).sum())

    def _linear(self, tensions: Floats, positions: Floats) -> list[tuple[Floats, ...]]:
        """Return prediction, columns and measurement of postures: linear, at no imperfections."""
        seen = [(self.expected(t), p.ravel()) for t, p in zip(tensions, positions, strict=True)]
        return [
            (e.markers - e.columns @ self.mean, e.columns, y) for e, y in seen if e is not None
        ]

    def _learn_all(self, base: Sequence[tuple[Floats, ...]]) -> float:
        total = 0.0
        self.forget()
        for markers, columns, measured in base:
            total += self.learn(Expected(markers + columns @ self.mean, columns), measured)
        return total

    def _columns(self, inputs: Floats, point: Point) -> Floats | None:
        """Return what each imperfection of a plausible size does (3 J, q) [m]."""
        size = 3 * len(self.whole.dataset.markers)
        if not self.kinds:
            return np.zeros((size, 0))
        self.split.inputs = inputs
        found = imperfections(self.split, point, self.members)
        if found is None:
            return None
        moves = found.moves[: len(self.plausible)].reshape(-1, size)
        return np.asarray((self.plausible[:, None] * moves).T)

    def _named(self, mean: Floats) -> dict[str, Floats]:
        ends = np.cumsum([len(kind) for kind in self.kinds])[:-1]
        own = np.split(mean * self.plausible, ends) if self.kinds else []
        return {kind.name: values for kind, values in zip(self.kinds, own, strict=True)}
