"""Register the tracker's frame to the base frame, and transform measurements to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..common.arrays import DIGITS, Bools, Floats
from ..common.errors import DataSetError, InputError
from ..common.estimation import ITERATIONS_MAX
from ..common.rotations import angle_between, rigid_fit, rotation_about, rotation_between
from ..common.words import STANDARD_GRAVITY, listing, mm, postures
from ..data import DataSet
from ..data.arrays import Vector
from ..effects import Catalogue
from ..inference.outliers import find_outliers
from ..inference.predict import Predictor, slope
from ..inference.statistics import rms
from ..robot.estimates import BY_EYE_RAD, MODEL_ERROR_MAX, NOISE_FACTOR, TRACKER_NOISE_M
from .columns import UPS
from .recipe import FrameChoice, Recipe

# [1] lengths of the arm that the tip of a straight posture may be off the axis, because no arm
# hangs quite straight
STRAIGHT_TOLERANCE = 0.02
# [1] of the weighted error that is left where markers sit beside the backbone, because noise alone
# makes a fit of two more parameters better, too
OFFSET_GAIN = 0.93


def up_axis(up: str) -> Floats:
    """Return the unit vector (3,) of an axis such as `y` or `-z`."""
    axis: Floats = np.eye(3)['xyz'.index(up[-1])]
    return -axis if up.startswith('-') else axis


class TrackerFrame:
    """
    The pose of the tracker's frame: position in the base frame = rotation @ measured + shift.

    It is estimated from postures in that frame.

    Parameters
    ----------
    predictor : Predictor
        Of the robot as described; its data set has positions in the tracker's frame.
    choice : FrameChoice
        The method, or the result.
    up : str or None
        Axis of the tracker that points up.

    Attributes
    ----------
    rotation : (3, 3)
    shift : (3,) [m]
    method : str
        'model': all postures onto the model's; 'level': the same with both verticals together;
        'straight': the straight posture, turned about it by the others; 'base': as it is; 'given'.
    residual : float [m]
        Rms distance to the model's postures; it includes the errors of the model.
    at_base : float [m]
        The same for the two markers next to the base.
    straight : float [m] or None
        The same for the straight postures.
    free : float [m]
        Residual of a free rotation and shift.
    mirrored : float [m]
        Residual of a left-handed frame.

    Raises
    ------
    InputError
        The model has no equilibrium for a posture, or data for the method are missing.

    """

    def __init__(self, predictor: Predictor, choice: FrameChoice, up: str | None) -> None:
        dataset, markers = predictor.dataset, predictor.markers({})
        if markers is None:
            raise InputError(_unsettled(predictor))
        measured = dataset.mean
        visible = np.isfinite(measured).all(axis=2)
        gravity = np.array(predictor.robot.gravity or (0.0, 0.0, 0.0))
        has_verticals = up is not None and np.linalg.norm(gravity) > 0.0
        self.method = choice.method or ('level' if has_verticals else 'model')
        if choice.rotation is not None and choice.shift is not None:
            self.method = choice.method or 'given'
            rotation = Rotation.from_rotvec(choice.rotation).as_matrix()
            shift = np.array(choice.shift)
        elif self.method == 'base':
            rotation, shift = np.eye(3), np.zeros(3)
        elif self.method == 'straight':
            rotation, shift = _straight(markers, dataset)
        else:
            above, first = None, np.eye(3)
            if self.method == 'level':
                if up is None or not has_verticals:
                    needed = "the tracker's --up and the robot's gravity (where the arm points)"
                    raise InputError(f'--frame level needs {needed}')
                above = -gravity / np.linalg.norm(gravity)  # up in the base frame, (3,)
                first = rotation_between(up_axis(up), above)  # the tracker's up onto that
            rotation, shift = _weighted(measured @ first.T, markers, dataset.arc_lengths, above)
            rotation = rotation @ first
        # as a file gives it back
        self.rotation = Rotation.from_rotvec(rotation_vector(rotation)).as_matrix()
        self.shift = shift.round(DIGITS)
        off = measured @ self.rotation.T + self.shift - markers
        straight = _straight_postures(markers, dataset)
        seen, model = measured[visible], markers[visible]
        self.residual, self.at_base = rms(off), rms(off[:, :2])
        self.straight = rms(off[straight]) if visible[straight].any() else None
        self.free = _free_residual(seen, model)
        self.mirrored = _free_residual(seen * [1.0, 1.0, -1.0], model)

    @property
    def is_contradicted(self) -> bool:
        """Whether the frame under its constraints has a much larger residual than a free one."""
        return self.residual > NOISE_FACTOR * self.free + 2.0 * TRACKER_NOISE_M

    def tolerances(self, length: float) -> dict[str, float]:
        """
        Return the standard deviations of the frame: position [m] and rotation [rad].

        The model by which it was estimated lacks what a diagnosis looks for, so that the frame may
        be off by as much as the model: near the base in position, at the tip in rotation.
        """
        if self.method == 'base':
            return {}
        rotation = max(2.0 * self.residual, TRACKER_NOISE_M) / length
        rotation = BY_EYE_RAD if self.method == 'level' else min(rotation, 1.0)
        return {
            'position': float(f'{max(self.at_base, 2.0 * TRACKER_NOISE_M):.2g}'),
            'rotation': float(f'{rotation:.2g}'),
        }


def up_that_fits(predictor: Predictor, recipe: Recipe) -> tuple[str | None, list[str]]:
    """
    Return the axis that points up, where only the file format suggests one, and assumptions.

    Another axis is used if the verticals contradict the postures with the usual one and agree
    with the other one, because a tracker may be set up differently.
    """
    choice, usual, gravity = recipe.frame, recipe.up, predictor.robot.gravity
    if usual is None or gravity is None or not any(gravity) or choice.method or choice.rotation:
        return usual, []
    frame = TrackerFrame(predictor, choice, usual)
    if not frame.is_contradicted:
        return usual, []
    others = {up: TrackerFrame(predictor, choice, up) for up in UPS if up != usual}
    best = min(others, key=lambda up: others[up].residual)
    if others[best].is_contradicted:
        return usual, []
    return best, [
        f'{best} points up: with {usual}, as files of this kind usually have it, the frame would '
        f'fit to {mm(frame.residual)} instead of {mm(others[best].residual)} (otherwise say --up)'
    ]


def _weighted(
    measured: Floats, markers: Floats, arc_lengths: Floats, axis: Floats | None
) -> tuple[Floats, Floats]:
    """
    Lay postures (P, J, 3) [m] onto the model's, turned about an axis (3,) if there is one.

    The squared error of a model grows with the cube of the arc length where curvatures are off at
    random, so that markers next to the base have the largest weights. How fast it grows is
    estimated from the residuals.
    """
    mask = np.isfinite(measured).all(axis=2)
    a, b = measured[mask], markers[mask]
    weights = np.ones(mask.shape)
    for _ in range(ITERATIONS_MAX):
        rotation, shift = rigid_fit(a, b, weights[mask], axis)
        squares = np.where(mask, ((measured @ rotation.T + shift - markers) ** 2).sum(axis=2), 0.0)
        weights = np.broadcast_to(_weights(squares, mask, arc_lengths), mask.shape)
    return rotation, shift


def _weights(squares: Floats, visible: Bools, arc_lengths: Floats) -> Floats:
    """Return a weight (J,) [1/m²] for each marker, from squared distances (P, J) [m²]."""
    cube = visible * arc_lengths**3
    growth = float((squares * cube).sum() / (cube**2).sum())
    return np.asarray(1.0 / (TRACKER_NOISE_M**2 + growth * arc_lengths**3))


def offset_warnings(dataset: DataSet, predicted: Floats, catalogue: Catalogue) -> list[str]:
    """
    Return a line if all markers seem to sit beside the backbone although no offset is given.

    The offset is fitted together with a shift and a small rotation of the frame. A load that the
    model lacks hides it: there is no line then.

    Parameters
    ----------
    dataset : DataSet
        In the base frame.
    predicted : (P, J, 3) [m]
        The same markers by the model.
    catalogue : Catalogue

    """
    if np.any(dataset.offsets):
        return []
    columns = []  # derivatives by the offset towards x and y, then by the frame
    for step in ((TRACKER_NOISE_M, 0.0, 0.0), (0.0, TRACKER_NOISE_M, 0.0)):
        markers = tuple(replace(marker, offset=step) for marker in dataset.markers)
        aside = Predictor(replace(dataset, markers=markers), dataset.robot, catalogue)
        columns.append(slope(predicted, aside.markers({}), TRACKER_NOISE_M))
    columns += [np.broadcast_to(axis, predicted.shape) for axis in np.eye(3)]
    columns += [np.cross(axis, predicted) for axis in np.eye(3)]
    off = dataset.mean - predicted
    visible = np.isfinite(off).all(axis=2)
    squares = np.where(visible, (off**2).sum(axis=2), 0.0)
    weight = np.sqrt(_weights(squares, visible, dataset.arc_lengths))
    scale = np.broadcast_to(weight[None, :, None], off.shape)[visible].ravel()
    system = np.array([column[visible].ravel() * scale for column in columns]).T
    values = off[visible].ravel() * scale
    estimate, without = (np.linalg.lstsq(a, values)[0] for a in (system, system[:, 2:]))
    residual, residual_before = values - system @ estimate, values - system[:, 2:] @ without
    x, y = estimate[:2].tolist()
    # beyond the length it is another shift: of an arm that does not bend nothing tells them apart
    beside = NOISE_FACTOR * TRACKER_NOISE_M <= np.hypot(x, y) < dataset.robot.length
    if not beside or residual @ residual > OFFSET_GAIN**2 * (residual_before @ residual_before):
        return []
    x, y = 1e3 * round(x, 4), 1e3 * round(y, 4)
    return [
        f'markers seem to sit beside the backbone, {x:.1f} mm towards x and {y:.1f} mm towards y: '
        f'if they do, say --offset {x:.1f},{y:.1f}'
    ]


def _free_residual(measured: Floats, markers: Floats) -> float:
    rotation, shift = rigid_fit(measured, markers)
    return rms(measured @ rotation.T + shift - markers)


def _straight_postures(markers: Floats, dataset: DataSet) -> Bools:
    """Return which postures are straight according to the model, (P,)."""
    straight = dataset.offsets + np.outer(dataset.arc_lengths, up_axis('z'))
    off = np.linalg.norm(markers - straight, axis=2).max(axis=1)
    return np.asarray(off < STRAIGHT_TOLERANCE * dataset.robot.length)


def _straight(markers: Floats, dataset: DataSet) -> tuple[Floats, Floats]:
    """Align the straight posture with +z, and fit the rotation about it to the other postures."""
    measured = dataset.mean
    visible = np.isfinite(measured).all(axis=2)
    use = visible & _straight_postures(markers, dataset)[:, None]
    if use.sum() < 2:
        needed = 'a posture in which the arm is straight with two markers seen'
        raise InputError(f'--frame straight needs {needed}')
    points = measured[use]
    arc = np.broadcast_to(dataset.arc_lengths, visible.shape)[use]
    middle = points.mean(axis=0)
    along = up_axis('z')
    first = rotation_between((arc - arc.mean()) @ (points - middle), along)
    a, b = (measured[visible] - middle) @ first.T, markers[visible] - arc.mean() * along
    rotation = rotation_about(along, a, b) @ first
    return rotation, arc.mean() * along - rotation @ middle


def rotation_vector(rotation: Floats) -> Vector:
    """Return the rotation vector [rad] of a matrix."""
    x, y, z = Rotation.from_matrix(rotation).as_rotvec().round(DIGITS + 3).tolist()
    return x, y, z


def _unsettled(predictor: Predictor) -> str:
    """Say in which postures the model finds no equilibrium, why, and what may be wrong."""
    names = predictor.unsettled()
    remedy = 'check their unit, and the stiffness in the robot description'
    if not names:  # only on the way
        return f'the model finds no equilibrium for these inputs: {remedy}'
    of = postures(len(predictor.dataset.postures))
    said = f'in {len(names)} of {of} the model finds no equilibrium, first in {names[0]}'
    if refusal := predictor.refused(names[0]):
        remedy = (
            f'{refusal}; where wires give way the description says so (wire_spring), a slack wire '
            'has an empty cell; else check unit and spool'
        )
    return f'{said}: {remedy}'


class Placed:
    """
    A data set in the base frame: registered, without trials that the other trials contradict.

    Parameters
    ----------
    raw : DataSet
        In the tracker's frame.
    recipe : Recipe
        With `up`, `frame` and `leave_out`, as far as they are known.
    catalogue : Catalogue

    Attributes
    ----------
    dataset : DataSet
    frame : TrackerFrame
    left_out : tuple of (posture, trial)
        Contradicted by the other trials.
    dropped : list of str
        The same, a line.
    gravity_warnings : tuple of str
        Contradictions about gravity.

    Raises
    ------
    DataSetError, InputError
        The model has no equilibrium, or the method needs what is not there.

    """

    def __init__(self, raw: DataSet, recipe: Recipe, catalogue: Catalogue) -> None:
        robot, choice, pairs = raw.robot, recipe.frame, recipe.leave_out

        def placed(dataset: DataSet) -> tuple[DataSet, TrackerFrame]:
            frame = TrackerFrame(Predictor(dataset, robot, catalogue), choice, recipe.up)
            positions = dataset.positions @ frame.rotation.T + frame.shift
            return replace(dataset, positions=positions.round(9)), frame

        dataset, self.frame = placed(raw if pairs is None else _without(raw, pairs))
        why = 'left out, as leave_out says'
        if pairs is None:
            why = 'the other trials contradict (a slipped tendon?)'
            outliers = find_outliers(Predictor(dataset, robot, catalogue), {})
            which = np.argwhere(outliers.trials).tolist()
            pairs = tuple((raw.postures[p], raw.trial_names[q]) for p, q in which)
            if pairs:
                dataset, self.frame = placed(_without(raw, pairs))
        self.left_out = pairs
        names = [f'posture {posture} trial {trial}' for posture, trial in pairs]
        self.dropped = [f'{listing(names)}: {why}'] if names else []
        gravity, self.gravity_warnings = _gravity(dataset, self.frame, recipe)
        known = self.frame.tolerances(robot.length)  # so that a diagnosis may move it
        if choice.rotation is not None:  # a frame that is given comes with its tolerances
            known |= {key: robot.tolerances[key] for key in known if key in robot.tolerances}
        robot = replace(dataset.robot, tolerances={**dataset.robot.tolerances, **known})
        self.dataset = replace(dataset, gravity=gravity, robot=robot)

    @property
    def frame_warnings(self) -> list[str]:
        """Contradictions of the frame, a line each."""
        frame, length, lines = self.frame, self.dataset.robot.length, []
        known = frame.tolerances(length)
        off = max(known['position'], known['rotation'] * length) if known else 0.0
        if off > 2.0 * MODEL_ERROR_MAX * length:
            lines.append(
                f'the frame is known to {mm(known["position"], 2)} and '
                f'{np.degrees(known["rotation"]):.2g}° only, more than a tenth of the arm at its '
                'tip: are markers, inputs and units right? (--frame base, where the table is in '
                'the base frame)'
            )
        if NOISE_FACTOR * frame.mirrored < frame.free > 2.0 * TRACKER_NOISE_M:
            lines.append(
                f'a left-handed frame would fit better ({mm(frame.mirrored)} instead of '
                f'{mm(frame.free)}): an axis has the wrong sign, or two inputs are swapped'
            )
        elif frame.is_contradicted:
            lines.append(
                f'free to turn, the frame would fit to {mm(frame.free)} instead of '
                f'{mm(frame.residual)}: a load that the description lacks, or is what is said of '
                'it (up, gravity, frame) not right? (--frame model turns it freely)'
            )
        return lines

    @property
    def warnings(self) -> list[str]:
        """Everything that should be checked, a line each."""
        return [*self.gravity_warnings, *self.frame_warnings]


def _without(dataset: DataSet, pairs: Sequence[tuple[str, str]]) -> DataSet:
    positions = dataset.positions.copy()
    for posture, trial in pairs:
        if posture not in dataset.postures or trial not in dataset.trial_names:
            problem = f'there is no posture {posture!r}, trial {trial!r}'
            raise DataSetError(f'{dataset.name}: leave_out', problem, 'take that line out')
        positions[dataset.postures.index(posture), dataset.trial_names.index(trial)] = np.nan
    if np.isnan(positions).all():
        raise DataSetError(f'{dataset.name}: leave_out', 'leaves no trial', 'take a line out')
    return replace(dataset, positions=positions)


def _gravity(
    dataset: DataSet, frame: TrackerFrame, recipe: Recipe
) -> tuple[Vector | None, tuple[str, ...]]:
    """Return gravity from the tracker if the robot has none, and contradictions between both."""
    known, up = dataset.robot.gravity, recipe.up
    if up is None:
        missing = 'nothing says where down is: say --up (y for OptiTrack, z for most others)'
        return None, (missing,) if known is None else ()
    x, y, z = (-STANDARD_GRAVITY * (frame.rotation @ up_axis(up))).round(6).tolist()
    told = f'up is told ({up}), but the description '
    if known is None:
        at = ', '.join(f'{g:.2g}' for g in (x, y, z))
        return (x, y, z), (
            f'{told}has no gravity: the tracker is not levelled by it, and gravity is taken as '
            f'[{at}] m/s² from the frame as found; say where the arm points (gravity in the '
            'description, `robot new` asks for it)',
        )
    size = np.linalg.norm(known)
    if not size:
        zero = 'says that gravity is zero: up is not used, and no weight is looked for'
        return None, (told + zero,)
    apart = float(angle_between(np.divide(known, size), np.divide((x, y, z), STANDARD_GRAVITY)))
    if apart < NOISE_FACTOR * BY_EYE_RAD:
        return None, ()
    return None, (
        f'gravity of the robot and up of the tracker are {np.degrees(apart):.0f}° apart; '
        "the robot's counts",
    )
