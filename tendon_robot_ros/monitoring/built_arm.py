"""
One arm as it was built, learned from postures without external load.

Its imperfections b (cells, kinks, gains, the tracker's frame; prior: plausible sizes) are
estimated by an extended Kalman filter, y = f(T, b) + G(T) a + remainder + noise, linearised at the
current estimate. The remainder, which no imperfection explains, is independent between postures
and smooth along the arm; its size and the noise of the measured tensions maximise the likelihood
of the reference postures, linear around the last estimate. Before there are references it is the
`model_error` of the description.

A description with a `model_error` may lack effects. Their error is not a new one in every posture:
it comes back with the tensions, and is alike under similar ones. G, the motion of the markers by
the parameters of all effects (prior: typical values), makes cov G a = G(T) A G(T')' between
postures. It has two columns for a parameter, for a parabola through the motion by a typical value.
What half a typical value moves beyond that parabola is independent between postures: it is large
where a moment is near a kink of friction, and only there. Without a `model_error` nothing is known
to be lacking, and a = 0.

The variance of the innovations is compared with its prediction over one posture and over several
in sequence (batch means), and widened by the ratio. Tip force and drift alarm use this model.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import block_diag

from ..common.arrays import Bools, Floats
from ..common.errors import NoEquilibriumError
from ..common.estimation import kalman_update
from ..data import DataSet, Marker
from ..effects import Catalogue, Effect
from ..inference import imperfections
from ..inference.candidates import acts
from ..inference.noise import relative_error
from ..inference.predict import FreeParameter, Point, Predictor, SettledShapes, frees_of
from ..inference.search import DIFFERENCE_STEP
from ..model.shape import ShapeBatch
from ..robot import Robot
from ..robot.estimates import bend_rates, end_sections, natural_sizes
from .references import Reference, contradicted, log_likelihood, widening

# [1] 1 sd of the remainder at the tip, of the length, and of a measured tension; factors of three,
# because the likelihood resolves no finer ones
RELATIVE_ERRORS = 0.0, 0.0003, 0.001, 0.003, 0.01
# no reference lacks them: the frame is an imperfection, and none is loaded
FRAME, LOAD = 'base_misalignment', 'tip_load'
# [1] significance of a posture that does not fit the arm: its probability by chance
ODD_PROBABILITY = 1e-6
# [N] of a slack wire: so small that it moves no marker, because at 0 a gain shows no slope
SLACK_N = 1e-6


@dataclass(frozen=True)
class Expected:
    """Prediction of a posture: markers, and their motion by states of 1 sd."""

    markers: Floats  # (3 J,) [m] at the estimated states
    columns: Floats  # (3 J, q + n) [m] per sd of the q states, and of n new ones in every posture


_Linear = tuple[Expected, Floats]  # without imperfections, and the measured (3 J,) [m]


def solved[T](prediction: T | None) -> T:
    """Return a prediction of the model; raise NoEquilibriumError where it has none."""
    if prediction is None:
        raise NoEquilibriumError('this posture', (), np.inf)
    return prediction


class BuiltArm:
    """Estimate of the imperfections of one arm."""

    def __init__(
        self,
        robot: Robot,
        catalogue: Catalogue,
        markers: Sequence[Marker],
        noise: float,
        level: float = 1.0,
    ) -> None:
        """
        Begin with the prior.

        Parameters
        ----------
        robot : Robot
            The description, with its added effects.
        catalogue : Catalogue
        markers : (J,) sequence of Marker
        noise : float
            1 sd of a coordinate of a marker [m].
        level : float
            Size of the imperfections relative to ordinary workmanship [1]; 0: as described.

        """
        self.catalogue = catalogue.sized(natural_sizes(robot))
        self.robot, self.noise = robot, noise
        self.level = 0.0 if robot.exact else level
        inputs, unseen = np.zeros((1, len(robot.inputs))), np.full((1, 1, len(markers), 3), np.nan)
        now = DataSet(
            'now', robot, tuple(markers), ('now',), inputs, unseen, gravity=robot.gravity
        )
        self.described = Predictor(now, robot, self.catalogue)
        self.predictor = imperfections.BuiltPredictor(self.described)
        seen = Predictor(replace(now, positions=np.zeros_like(unseen)), robot, self.catalogue)
        rest = imperfections.remainders(seen).reshape(-1, 3 * len(markers))
        self._rest = rest.T @ rest  # (3 J, 3 J) of a remainder of 1 m sd at the tip
        known = float((robot.model_error or 0.0) / np.sqrt(3.0))  # [m] of a coordinate
        sizes = {known, *(part * robot.length for part in RELATIVE_ERRORS)}
        self.remainders: list[float] = sorted(sizes)  # [m] possible ones
        self.remainder = known  # [m] 1 sd of a coordinate at the tip, until references show it
        self.setting = 0.0  # 1 sd of a measured tension, in plausible gains
        self.excluded: tuple[int, ...] = ()  # indices of misread references
        self.widening = 1.0  # factor on the predicted variances
        self.response = 0.0  # known error relative to what the tip moves [1]
        self.kinds = self.predictor.kinds()
        counts, scale = [len(kind) for kind in self.kinds], self.level or 1.0
        self.plausible = scale * np.repeat([k.plausible for k in self.kinds], counts)  # (q,) 1 sd
        self.built = len(self.plausible)  # states that are imperfections, the first ones
        self.frees: list[FreeParameter] = []  # the other states: of effects that may be lacking
        self._gains = np.flatnonzero(
            np.repeat([k.name == imperfections.GAIN for k in self.kinds], counts)
        )
        self._kinked = usual_kinks(robot, self.level)
        # covariance (q, q) of the states [sd²]; an exact arm is known to have no imperfections
        self.prior = float(self.level > 0.0) * np.eye(self.built)
        self.forget()

    def expect_lacking(self) -> None:
        """Estimate what the description lacks, too, if it has a `model_error`."""
        if self.frees or not self.robot.model_error:
            return
        names = [effect.name for effect in moving_effects(self.robot, self.catalogue)]
        lacking = (name for name in names if name not in (FRAME, LOAD))
        self.frees = [*frees_of(lacking, self.catalogue, self.robot)]
        typical = [free.parameter.typical for free in self.frees]
        self.plausible = np.concatenate([self.plausible, typical, typical])
        self.prior = block_diag(self.prior, np.eye(2 * len(typical)))
        self.forget()

    @property
    def members(self) -> dict[str, Floats]:
        """Estimated imperfections by kind [its unit]."""
        ends = np.cumsum([len(kind) for kind in self.kinds])[:-1]
        own = np.split((self.mean * self.plausible)[: self.built], ends)
        return {kind.name: values for kind, values in zip(self.kinds, own, strict=True)}

    def expected(self, tensions: Floats, point: Point | None = None) -> Expected:
        """Return the prediction under tensions (m,) [N]; raise NoEquilibriumError without one."""
        inputs = np.maximum(tensions, SLACK_N)[None]
        shapes = self.shapes(inputs, point or {})
        beside, columns = self._beside(inputs), self.columns(inputs, point or {})
        markers = self.predictor.see(shapes).ravel()
        bent = self._bent(inputs, markers, columns, beside)
        return Expected(markers + self.lacked(columns), np.hstack([columns, bent]))

    def lacked(self, columns: Floats) -> Floats:
        """Return the motion (..., 3 J) [m] by what the description lacks, of (..., 3 J, q + n)."""
        return self.moves(columns, self.built)

    def moves(self, columns: Floats, first: int = 0) -> Floats:
        """Return the motion (..., 3 J) [m] by the estimated states from the first one on."""
        return np.asarray(columns[..., first : len(self.mean)] @ self.mean[first:])

    def _beside(self, inputs: Floats) -> tuple[Floats, Floats] | None:
        """
        Return steps (4 m, m) [N] of the tensions at the arm, and the markers there (4 m, 3 J) [m].

        The steps bend a cell as a usual kink does, in both directions, then by half of it. The
        imperfections are those of the last evaluation.
        """
        steps = np.diag(self._kinked)
        steps = np.vstack([steps, -steps, 0.5 * steps, -0.5 * steps])
        arriving = self.predictor.given(inputs)
        varied = np.maximum(arriving + steps, 0.0)
        shapes = self.predictor.shapes(varied, None) if steps.any() else None
        if shapes is None:
            return None
        return varied - arriving, self.predictor.see(shapes).reshape(len(varied), -1)

    def _bent(
        self, inputs: Floats, markers: Floats, columns: Floats, near: tuple[Floats, Floats] | None
    ) -> Floats:
        """
        Return the deviation (3 J, 2 m) [m] of markers near a posture from a parabola.

        Near the straight posture the direction of friction depends on unknown kinks, and the
        response is not differentiable. The deviation from the tangent at a step, minus four times
        that at half the step, vanishes for a smooth model.
        """
        if near is None or not len(self._gains):
            return np.zeros((len(markers), 0))
        steps, shifted = near
        per_newton = columns[:, self._gains] / self.plausible[self._gains] / inputs
        whole, half = np.split(shifted - markers - steps @ per_newton.T, 2)
        return np.asarray((whole - 4.0 * half).T)

    def shapes(
        self, inputs: Floats, point: Point, near: SettledShapes | None = None
    ) -> ShapeBatch:
        """Return shapes under tensions (1, m) [N] with the estimated imperfections."""
        self.predictor.around = self.members
        ((_, shapes),) = self.predictor.settle(point, self.predictor.given(inputs), near=near)
        return solved(shapes)

    def forget(self) -> None:
        """Reset the imperfections to their prior."""
        self.mean, self.covariance = np.zeros(len(self.plausible)), self.prior

    def as_known(self, mean: Floats, covariance: Floats) -> BuiltArm:
        """Return the arm with the estimate of another time; it shares the model."""
        arm = copy(self)
        arm.mean, arm.covariance = mean, covariance
        return arm

    def rest(self, rows: Bools) -> Floats:
        """Return the covariance of visible coordinates by a remainder of 1 m at the tip [1]."""
        return np.asarray(self._rest[np.ix_(rows, rows)])

    def scatter(self, rows: Bools, columns: Floats, frames: int = 1) -> Floats:
        """
        Return the covariance (r, r) [m²] of visible coordinates that is independent per posture.

        Parameters
        ----------
        rows : (3 J,) of bool
            Visible coordinates.
        columns : (3 J, q + n) [m]
            As of `Expected`: an error of a measured tension acts as an error of its gain.
        frames : int
            Number of frames whose mean the coordinates are.

        """
        read, new = self.setting * columns[:, self._gains], columns[:, len(self.mean) :]
        own = np.hstack([read, new])[rows]
        noise = self.noise**2 / frames * np.eye(len(own))
        return np.asarray(self.remainder**2 * self.rest(rows) + noise + own @ own.T)

    def spread(self, rows: Bools, columns: Floats, frames: int = 1) -> Floats:
        """Return the same with the part that all postures share, by the uncertain states."""
        own = columns[rows, : len(self.mean)]
        return np.asarray(own @ self.covariance @ own.T + self.scatter(rows, columns, frames))

    def fit(self, tensions: Floats, positions: Floats, frames: int = 1) -> None:
        """
        Fit to reference postures, with the sizes of remainder and noise of maximum likelihood.

        Misread references are `excluded`: outliers in the prediction by the others.

        Parameters
        ----------
        tensions : (P, m) [N]
        positions : (P, J, 3) [m]
        frames : int
            Number of frames whose mean each position is.

        """
        self.expect_lacking()
        self.forget()
        counts, before = np.ones(len(tensions), dtype=np.bool_), set[bytes]()
        while counts.tobytes() not in before:  # until nothing changes, or sets alternate
            before.add(counts.tobytes())
            base = self._sized(tensions, positions, frames, counts)
            references = [None if one is None else self._reference(one, frames) for one in base]
            counts = ~contradicted(references, counts)
        self.excluded = tuple(np.flatnonzero(~counts).tolist())
        seen = np.isfinite(positions[counts]).all(axis=2).any(axis=0)
        arc_lengths = self.described.dataset.arc_lengths
        tip = int(np.argmax(np.where(seen, arc_lengths, -1.0)))  # or near it
        self.response = relative_error(self.robot.model_error or 0.0, positions[counts, tip])
        scores = self._follow(tensions[counts], positions[counts], frames)
        self.widening = widening(scores[len(scores) // 3 :])

    def _sized(
        self, tensions: Floats, positions: Floats, frames: int, counts: Bools
    ) -> list[_Linear | None]:
        """Fit sizes and imperfections to the references that count; return all, linearised."""
        for _ in range(2):  # at the last estimate: errors of linearisation look like noise
            base = list[_Linear | None]()
            for inputs, measured in zip(tensions, positions, strict=True):
                linear = None
                with suppress(NoEquilibriumError):
                    e = self.expected(inputs)
                    e = replace(e, markers=e.markers - self.moves(e.columns))
                    linear = e, measured.ravel()
                base.append(linear)
            counted = [one for one, c in zip(base, counts, strict=True) if c and one is not None]
            self._vary(counted, frames)
            self.forget()
            for free, measured in counted:
                markers = free.markers + self.moves(free.columns)
                self.learn(replace(free, markers=markers), measured, frames)
        return base

    def _reference(self, one: _Linear, frames: int) -> Reference:
        """Return a reference posture with its sizes as they are now."""
        seen = self.observation(*one, frames)
        return seen._replace(columns=seen.columns @ self.prior)

    def _vary(self, base: Sequence[_Linear], frames: int) -> None:
        """Set the sizes of remainder and tension noise to those of maximum likelihood."""
        usual = self.plausible[self._gains]
        settings = [size / usual[0] for size in RELATIVE_ERRORS] if len(usual) else [0.0]

        def likely(sizes: tuple[float, float]) -> float:
            self.remainder, self.setting = sizes
            return log_likelihood([self._reference(one, frames) for one in base])

        self.remainder, self.setting = max(product(self.remainders, settings), key=likely)

    def learn(self, expected: Expected, measured: Floats, frames: int = 1) -> None:
        """Update the imperfections by a measured posture (3 J,) [m]."""
        off, columns, scatter = self.observation(expected, measured, frames)
        after = kalman_update(self.mean, self.covariance, columns, off, scatter)
        self.mean, self.covariance = after.mean, after.covariance

    def observation(self, expected: Expected, measured: Floats, frames: int = 1) -> Reference:
        """Return what is seen of a posture (3 J,) [m]: its visible coordinates."""
        rows = np.isfinite(measured)
        scatter, own = self.scatter(rows, expected.columns, frames), expected.columns[rows]
        off = measured[rows] - expected.markers[rows]
        return Reference(off, own[:, : len(self.mean)], scatter)

    def _follow(
        self, tensions: Floats, positions: Floats, frames: int
    ) -> list[tuple[Floats, Floats]]:
        """
        Filter the postures in sequence, as the monitoring does later.

        Returns the score C' S^-1 nu (q,) of each innovation nu, and its covariance (q, q).

        The innovations are correlated, because directions without information are far from the
        point of linearisation.
        """
        scores = list[tuple[Floats, Floats]]()
        self.forget()
        for inputs, measured in zip(tensions, positions, strict=True):
            with suppress(NoEquilibriumError):
                expected = self.expected(inputs)
                off, columns, scatter = self.observation(expected, measured.ravel(), frames)
                spread = columns @ self.covariance @ columns.T + scatter
                weighted = np.linalg.solve(spread, columns)
                scores.append((weighted.T @ off, columns.T @ weighted))
                self.learn(expected, measured.ravel(), frames)
        return scores

    def columns(self, inputs: Floats, point: Point) -> Floats:
        """Return the motion of the markers (3 J, q + n) [m] by states of plausible size."""
        self.predictor.inputs = inputs
        return np.asarray(self.moved(self.predictor, point)[0])

    def moved(self, arm: imperfections.BuiltPredictor, point: Point) -> Floats:
        """Return the motion of the markers (P, 3 J, q + n) [m] by states of plausible size."""
        responses = solved(imperfections.imperfections(arm, point, self.members, changed=True))
        slope, half, whole = differences(arm, point, self.frees, (DIFFERENCE_STEP, 0.5, 1.0))
        built = responses.moves[: self.built].reshape(self.built, *slope.shape[1:])
        left = 0.5 * (half - slope) - 0.25 * (whole - slope)
        moves = np.concatenate([built, slope, whole - slope, left])
        sizes = np.append(self.plausible, [f.parameter.typical for f in self.frees])
        return np.asarray(np.moveaxis(moves * sizes[:, None, None], 0, 2))


def slopes(
    predictor: Predictor,
    point: Point,
    frees: Sequence[FreeParameter],
    inputs: Floats | None = None,
) -> Floats:
    """Return the Jacobian (P, 3 J, k) of the markers by parameters."""
    solved(predictor.markers(point, inputs))
    moves = solved(predictor.tangent(point, frees, solved(predictor.settled))).markers
    return np.moveaxis(moves.reshape(*moves.shape[:2], -1), 0, 2)


def differences(
    predictor: Predictor,
    point: Point,
    frees: Sequence[FreeParameter],
    parts: Sequence[float] = (DIFFERENCE_STEP,),
) -> Floats:
    """Return the motion of the markers (n, k, P, 3 J) per unit, by n parts of typical values."""
    P, J = len(predictor.inputs), len(predictor.dataset.markers)
    moves = np.zeros((len(parts), len(frees), P, 3 * J))
    base = solved(predictor.markers(point)) if frees else np.zeros(0)
    for (i, part), (k, free) in product(enumerate(parts), enumerate(frees)):
        value = point.get(free, predictor.value(free))
        step = free.parameter.step(value, part)
        moved = predictor.markers({**point, free: value + step}) if step else None
        if moved is not None:
            moves[i, k] = (moved - base).reshape(P, 3 * J) / step
    return moves


def moving_effects(robot: Robot, catalogue: Catalogue) -> list[Effect]:
    """Return the effects by which an arm moves that rests under tensions, those at places not."""
    return [effect for effect in catalogue if acts(effect, robot, ('gravity',))]


def usual_kinks(robot: Robot, level: float) -> Floats:
    """Return the change of each input (m,) [N] that bends a cell as a usual kink does, or 0."""
    cells = np.array([section.cells for section in robot.sections])[end_sections(robot)]
    kink = level * imperfections.PLAUSIBLE_SIZES[imperfections.KINK][1]
    rates = np.linalg.norm(bend_rates(robot), axis=1)
    return np.divide(kink * cells, rates, out=np.zeros(len(rates)), where=rates > 0.0)
