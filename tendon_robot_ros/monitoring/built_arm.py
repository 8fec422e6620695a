"""
One arm as it was built, learned posture by posture while nothing touches it.

Its imperfections b (cells, kinks, gains, the tracker's frame; prior: plausible sizes) are
estimated by an extended Kalman filter: y = f(T, b) + remainder + noise, around those that are
known by then. What no imperfection explains, another one in every posture and smooth along the
arm, and the noise of the tensions as read have the sizes with which the filter, linear around
its last estimate, predicts the reference postures best. How much more than it
expects its innovations vary where imperfections show, over one posture and over several in a row,
is measured there, too (batch means). Tip force and drift alarm stand on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.estimation import kalman_update
from ..comparison.predict import Point, Predictor, SettledShapes
from ..data import DataSet, Marker
from ..diagnosis.imperfections import GAIN, KINK, PLAUSIBLE_SIZES, SplitPredictor, remainders
from ..diagnosis.slopes import imperfections
from ..effects import Catalogue
from ..model.shape import ShapeBatch
from ..robot import Robot
from ..robot.estimates import bend_rates, end_sections, natural_sizes
from .references import Reference, contradicted, log_likelihoods, widening

Bools = npt.NDArray[np.bool_]
# [1] of the length, at the tip: 1 sd of what no imperfection explains; factors of three, because
# the likelihood tells no finer
REMAINDERS = 0.0, 0.0003, 0.001, 0.003, 0.01
# [1] relative 1 sd of a tension as read, from a perfect load cell to one that would be refused
SETTINGS = 0.0, 0.0005, 0.001, 0.002, 0.005
# [1] rounds of sizes and misread references; what changes more often would go to and fro for ever
ROUNDS_MAX = 6
# [1] of the median error: a reference further from the description is misread, because no arm is
# as different from itself
FAR_FACTOR = 10.0
# [1] probability of a posture by chance, below which it is surely not that of the arm
ODD_PROBABILITY = 1e-6


@dataclass(frozen=True)
class Expected:
    """What is expected of a posture: markers, and how imperfections of 1 sd move them."""

    markers: Floats  # (3 J,) [m] of the model and of the imperfections as they are known
    columns: Floats  # (3 J, q) [m] per sd
    bent: Floats  # (3 J, 2 m) [m] what is not linear of it, within what is not known


_Linear = tuple[Expected, Floats]  # at no imperfections, and (3 J,) [m] as measured


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

        def predictor(positions: Floats) -> Predictor:
            dataset = DataSet(
                'now',
                robot,
                tuple(markers),
                ('now',),
                np.zeros((1, m)),
                positions,
                gravity=robot.gravity,
            )
            return Predictor(dataset, robot, self.catalogue)

        self.whole = predictor(np.full((1, 1, J, 3), np.nan))
        self.split = SplitPredictor(self.whole)
        rest = remainders(predictor(np.zeros((1, 1, J, 3)))).reshape(-1, 3 * J)
        self._rest = rest.T @ rest  # (3 J, 3 J) of a remainder of 1 m sd at the tip
        self.remainder = 0.0  # [m] 1 sd at the tip
        self.setting = 0.0  # 1 sd of a tension as read, in plausible gains
        self.left_out: tuple[int, ...] = ()  # of the references: misread
        self.widening = 1.0  # by which variances are larger than expected
        self.kinds = self.split.kinds() if self.level > 0.0 else ()
        usual = [np.full(len(kind), self.level * kind.plausible) for kind in self.kinds]
        self.plausible = np.concatenate(usual) if usual else np.zeros(0)  # (q,) 1 sd, each a unit
        names = np.repeat([kind.name for kind in self.kinds], [len(kind) for kind in self.kinds])
        self._gains = np.flatnonzero(names == GAIN)
        self._kinked = usual_kinks(robot, level) if self.kinds else np.zeros(m)
        self._members: dict[str, Floats] | None = None
        self.forget()

    @property
    def members(self) -> dict[str, Floats]:
        """The imperfections as they are known, by kind [its unit]."""
        if self._members is None:
            ends = np.cumsum([len(kind) for kind in self.kinds])[:-1]
            own = np.split(self.mean * self.plausible, ends) if self.kinds else []
            named = zip(self.kinds, own, strict=True)
            self._members = {kind.name: values for kind, values in named}
        return self._members

    def expected(self, tensions: Floats, point: Point | None = None) -> Expected | None:
        """Return what is expected under tensions (m,) [N]; None without equilibrium."""
        inputs = np.maximum(tensions, 0.0)[None]
        shapes = self.shapes(inputs, point or {})
        if shapes is None:
            return None
        beside = self._beside(inputs)
        columns = self.columns(inputs, point or {})
        if columns is None:
            return None
        here = self.split.see(shapes).ravel()
        return Expected(here, columns, self._bent(inputs, here, columns, beside))

    def _beside(self, inputs: Floats) -> tuple[Floats, Floats] | None:
        """
        Return steps (4 m, m) [N] of what arrives of tensions, and the markers there (4 m, 3 J).

        They do as much more and less as a usual kink does, then half of it. The model is as it
        was last set.
        """
        steps = np.diag(self._kinked)
        steps = np.vstack([steps, -steps, 0.5 * steps, -0.5 * steps])
        here = self.split.given(inputs)
        near = np.maximum(here + steps, 0.0)
        shapes = self.split.shapes(near, None) if steps.any() else None
        if shapes is None:
            return None
        return near - here, self.split.see(shapes).reshape(len(near), -1)

    def _bent(
        self, inputs: Floats, here: Floats, columns: Floats, beside: tuple[Floats, Floats] | None
    ) -> Floats:
        """
        Return by how much markers beside a posture are off a parabola there, (3 J, 2 m) [m].

        An arm that hardly bends has friction either way: which one, kinks decide that nobody
        knows. The tangent tells nothing of it. What is off the tangent at a step, without four
        times what it is at half of it, is nothing where the model is smooth.
        """
        if beside is None or not len(self._gains):
            return np.zeros((len(here), 0))
        steps, there = beside
        per_newton = columns[:, self._gains] / self.plausible[self._gains] / inputs.clip(1e-9)
        whole, half = np.split(there - here - steps @ per_newton.T, 2)
        return np.asarray((whole - 4.0 * half).T)

    def shapes(
        self, inputs: Floats, point: Point, near: SettledShapes | None = None
    ) -> ShapeBatch | None:
        """Shapes under tensions (1, m) [N] with the imperfections as they are known."""
        self.split.around = self.members
        ((_, shapes),) = self.split.settle(point, self.split.given(inputs), near=near)
        return shapes

    def forget(self) -> None:
        """Know nothing of the imperfections but their prior."""
        self.mean, self.covariance = np.zeros(len(self.plausible)), np.eye(len(self.plausible))
        self._members = None

    def as_known(self, mean: Floats, covariance: Floats) -> BuiltArm:
        """Return the same arm as it was known at another time; it shares the model."""
        made = copy(self)
        made.mean, made.covariance, made._members = mean, covariance, None
        return made

    def rest(self, rows: Bools) -> Floats:
        """Covariance of seen coordinates under a remainder of 1 m sd at the tip [1]."""
        return np.asarray(self._rest[np.ix_(rows, rows)])

    def scatter(
        self,
        rows: Bools,
        columns: Floats,
        frames: int = 1,
        bent: Floats | None = None,
    ) -> Floats:
        """
        Covariance (r, r) [m²] of seen coordinates that is new in every posture.

        Parameters
        ----------
        rows : (3 J,) of bool
            What is seen.
        columns : (3 J, q) [m]
            As of `Expected`: a tension that is read wrongly is as a gain that is off.
        frames : int
            Of which the coordinates are the mean.
        bent : (3 J, k) [m], optional
            As of `Expected`.

        """
        read = self.setting * columns[rows][:, self._gains]
        noise = self.noise**2 / frames * np.eye(int(rows.sum()))
        noise += read @ read.T
        if bent is not None:
            noise += bent[rows] @ bent[rows].T
        return np.asarray(self.remainder**2 * self.rest(rows) + noise)

    def fit(self, tensions: Floats, positions: Floats, frames: int = 1) -> float:
        """
        Learn from reference postures, the sizes of remainder and noise those that predict best.

        Those that are misread are left out (`left_out`): ten times as far from the description as
        most, or contradicted by the others.

        Parameters
        ----------
        tensions : (P, m) [N]
        positions : (P, J, 3) [m]
        frames : int
            Of which each position is the mean.

        Returns
        -------
        float
            1 sd of the remainder at the tip [m].

        """
        self.forget()
        near = counts = self._near(tensions, positions)
        for _ in range(ROUNDS_MAX):
            before = counts
            base = self._sized(tensions, positions, frames, before)
            references = [
                None if one is None else Reference(*self.seen(*one, frames)) for one in base
            ]
            counts = near & ~contradicted(references, before)
            if np.array_equal(counts, before):
                break
        self.left_out = tuple(np.flatnonzero(~counts).tolist())
        scores = self._follow(tensions[counts], positions[counts], frames)
        self.widening = widening(scores[len(scores) // 3 :])
        return self.remainder

    def _sized(
        self, tensions: Floats, positions: Floats, frames: int, counts: Bools
    ) -> list[_Linear | None]:
        """Set the sizes that predict best those that count; return all of them, linear."""
        for _ in range(2):  # around the last estimate: far from it all looks larger
            seen = [
                (self.expected(t), p.ravel()) for t, p in zip(tensions, positions, strict=True)
            ]
            base = [
                None if e is None else (replace(e, markers=e.markers - e.columns @ self.mean), y)
                for e, y in seen
            ]
            counted = [one for one, c in zip(base, counts, strict=True) if c and one is not None]
            self._vary(counted, frames)
            self.forget()
            for free, measured in counted:
                markers = free.markers + free.columns @ self.mean
                self.learn(replace(free, markers=markers), measured, frames)
        return base

    def _near(self, tensions: Floats, positions: Floats) -> Bools:
        """Tell which postures (P,) are about as far from the description as most of them."""
        off = np.full(len(tensions), np.nan)
        for i, (inputs, seen) in enumerate(zip(tensions, positions, strict=True)):
            shapes = self.shapes(np.maximum(inputs, 0.0)[None], {})
            if shapes is not None and np.isfinite(seen).any():
                apart = self.split.see(shapes).reshape(seen.shape) - seen
                off[i] = np.sqrt(np.nanmean(apart**2))
        usual = np.nanmedian(off) if np.isfinite(off).any() else np.inf
        return np.asarray(~(off > FAR_FACTOR * max(float(usual), self.noise)))

    def _vary(self, base: Sequence[_Linear], frames: int) -> None:
        """Set the sizes of remainder and of the noise of the tensions that predict best."""
        usual = self.plausible[self._gains]
        remainders = [part * self.robot.length for part in REMAINDERS]
        settings = [size / float(usual[0]) if len(usual) else 0.0 for size in SETTINGS]
        axes: dict[bytes, tuple[Floats, Floats]] = {}
        postures = []
        for free, measured in base:
            rows = np.isfinite(measured)
            off = measured[rows] - free.markers[rows]
            if (seen := rows.tobytes()) not in axes:
                sizes, vectors = np.linalg.eigh(self.rest(rows))
                axes[seen] = sizes, vectors
            postures.append((free.columns[rows], off, free.bent[rows], axes[seen]))
        noise = self.noise / np.sqrt(frames)
        likely = log_likelihoods(postures, self._gains, noise, remainders, settings)
        i, j = np.unravel_index(likely.argmax(), likely.shape)
        self.remainder, self.setting = remainders[i], settings[j]

    def learn(self, expected: Expected, measured: Floats, frames: int = 1) -> None:
        """Take a posture (3 J,) [m] into what is known."""
        off, columns, scatter = self.seen(expected, measured, frames)
        after = kalman_update(self.mean, self.covariance, columns, off, scatter)
        self.mean, self.covariance, self._members = after.mean, after.covariance, None

    def seen(
        self, expected: Expected, measured: Floats, frames: int = 1
    ) -> tuple[Floats, Floats, Floats]:
        """Return of a posture (3 J,) [m], where it was seen: residual, columns and scatter."""
        rows = np.isfinite(measured)
        scatter = self.scatter(rows, expected.columns, frames, expected.bent)
        return measured[rows] - expected.markers[rows], expected.columns[rows], scatter

    def _follow(
        self, tensions: Floats, positions: Floats, frames: int
    ) -> list[tuple[Floats, Floats]]:
        """
        Learn posture by posture, each around what is known by then; return the scores.

        As the arm is watched later: linear around the last estimate, the innovations
        hang together, because what the postures do not tell is far from there meanwhile.
        """
        scores = list[tuple[Floats, Floats]]()
        self.forget()
        for inputs, seen in zip(tensions, positions, strict=True):
            expected = self.expected(inputs)
            if expected is not None:
                scores.append(self.score(expected, seen.ravel(), frames))
                self.learn(expected, seen.ravel(), frames)
        return scores

    def score(
        self, expected: Expected, measured: Floats, frames: int = 1
    ) -> tuple[Floats, Floats]:
        """Return C' S^-1 nu (q,) of a posture (3 J,) [m], and what is expected of its square."""
        off, columns, scatter = self.seen(expected, measured, frames)
        weighted = np.linalg.solve(columns @ self.covariance @ columns.T + scatter, columns)
        return weighted.T @ off, columns.T @ weighted

    def columns(self, inputs: Floats, point: Point) -> Floats | None:
        """Return what each imperfection of a plausible size does (3 J, q) [m]."""
        size = 3 * len(self.whole.dataset.markers)
        if not self.kinds:
            return np.zeros((size, 0))
        self.split.inputs = inputs
        made = imperfections(self.split, point, self.members)
        if made is None:
            return None
        moves = made.moves[: len(self.plausible)].reshape(-1, size)
        return np.asarray((self.plausible[:, None] * moves).T)


def usual_kinks(robot: Robot, level: float) -> Floats:
    """Return how much of each input (m,) [N] bends a cell as its usual kink does."""
    cells = np.array([section.cells for section in robot.sections])[end_sections(robot)]
    kink = level * PLAUSIBLE_SIZES[KINK][1]
    return np.asarray(kink * cells / np.linalg.norm(bend_rates(robot), axis=1))
