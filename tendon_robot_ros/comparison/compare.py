"""Compare models with measurements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, Progress, choice, listener
from ..data import DataSet, DataSetLike, default_markers, load_dataset
from ..effects import Catalogue, CatalogueLike, load_catalogue
from ..inference.noise import Whitener, estimate_noise, input_slopes
from ..inference.outliers import find_outliers
from ..inference.predict import Predictor
from ..inference.statistics import ERRORS
from ..model.shape import ShapeBatch
from ..robot import Robot, RobotLike, load_robot
from .result import Comparison, Measured, ModelErrors

Models = RobotLike | Sequence[RobotLike | tuple[str, RobotLike]] | Mapping[str, RobotLike]


def equilibria(predictor: Predictor) -> ShapeBatch:
    """
    Return the shapes of the postures of a description, reached as the data set's were.

    Raises
    ------
    NoEquilibriumError, InputError
        With the posture and what acts in it.

    """
    model, dataset, parts, postures = predictor.model, predictor.dataset, [], []
    for part, shapes in predictor.settle({}, predictor.inputs):
        if shapes is None:
            search: Callable[[Floats], object] = predictor.pulled
            if dataset.input == 'tension':
                search = model.sequence if predictor.carries else model.shapes
            search(predictor.inputs[part.rows])  # its error names the posture
            where = f'a posture of {dataset.name}'
            raise NoEquilibriumError(where, model.implicit_effects, np.inf)
        postures.append(part.rows)
        parts.append(shapes.of(predictor.last_visits(part)))
    return ShapeBatch.joined(parts).of(np.argsort(np.concatenate(postures)))


def compare(
    dataset: DataSetLike,
    models: Models = (),
    catalogue: CatalogueLike | None = None,
    error: str = 'ci',
    leave_out: bool = True,
    progress: Progress | None = None,
) -> Comparison:
    """
    Compare models with the measurements of a data set.

    Readings and trials that the other trials of their posture contradict are left out, as in a
    diagnosis; `measured.left_out` names them.

    Parameters
    ----------
    dataset : DataSet, path, or a list of these
        As `load_dataset` takes them.
    models : robot, sequence of robots or of (name, robot), or mapping of names to robots, optional
        Robots as `load_robot` takes them: names, paths, dicts, models. Default: the data set's
        robot description. Without a name it has the robot's.
    catalogue : Catalogue or paths, optional
        With your own effects.
    error : str
        'ci' for 95 % t-intervals of means, 'sem' for standard errors.
    leave_out : bool
        False: what other trials contradict counts as well.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    InputError
        A robot has other inputs than the data set's, names stand twice, or it is no robot.
    NoEquilibriumError
        A model has no equilibrium in a posture.

    """
    choice('error', error, ERRORS)
    show = listener(progress)
    dataset, catalogue = load_dataset(dataset), load_catalogue(catalogue)
    named = _named(models) or [(dataset.robot.name, dataset.robot)]
    names = [name for name, _ in named]
    if len(set(names)) < len(names):
        raise InputError(f'models: expected different names, got {", ".join(names)}')
    for name, robot in named:
        if robot.inputs != dataset.robot.inputs:
            raise InputError(
                f'model {name}: expected the inputs {", ".join(dataset.robot.inputs)} of '
                f'{dataset.name}, got {", ".join(robot.inputs)}'
            )
    show('trials', 0, len(named))
    excluded: tuple[Mapping[str, Any], ...] = ()
    if leave_out:
        outliers = find_outliers(Predictor(dataset, dataset.robot, catalogue), {})
        excluded, dataset = tuple(outliers.rows(dataset)), outliers.without(dataset)
    predictors = [Predictor(dataset, robot, catalogue) for _, robot in named]
    errors, axes = list[ModelErrors](), None
    for (name, robot), predictor in zip(named, predictors, strict=True):
        show('models', len(errors), len(named))
        markers = _predict(predictor)
        centred = on_the_centreline(dataset)
        if axes is None and centred:  # angles of all models are about the axes of the first
            axes = bending_axes(markers)
        errors.append(
            ModelErrors(
                name,
                tuple(robot.effects),
                markers,
                None if axes is None else _angles(markers, axes),
                np.linalg.norm(markers - dataset.mean, axis=2),
                np.linalg.norm(dataset.positions[:, :, -1] - markers[:, None, -1], axis=2),
                None if centred else _centreline(dataset, robot, catalogue),
                (robot.model_error or 0.0)
                * float(np.sqrt(dataset.arc_lengths.mean() / robot.length)),
            )
        )
    show('noise', len(named), len(named))
    best = int(np.argmin([model.rms for model in errors]))
    angles = None if axes is None else _angles(dataset.positions.swapaxes(0, 1), axes)
    measured = replace(_measured(dataset, predictors[best], angles), left_out=excluded)
    return Comparison(measured, tuple(errors), error)


def _named(models: Models) -> list[tuple[str, Robot]]:
    """Return models with their names; of robots of one name the later ones are numbered."""
    if isinstance(models, Mapping) and not {'name', 'sections'} <= set(models):
        models = list(models.items())
    named, times = list[tuple[str, Robot]](), Counter[str]()
    listed: Sequence[Any] = models if isinstance(models, list | tuple) else [models]
    for given in listed:
        match given:
            case (str(name), robot):
                named.append((name, load_robot(robot)))
            case _:
                robot = load_robot(given)
                times[robot.name] += 1
                count = times[robot.name]
                named.append((robot.name if count == 1 else f'{robot.name} ({count})', robot))
    return named


def _predict(predictor: Predictor) -> Floats:
    markers = predictor.markers({})
    if markers is None:
        equilibria(predictor)  # its error names the posture
        raise NoEquilibriumError(predictor.dataset.name, predictor.model.implicit_effects, np.nan)
    return markers


def _angles(positions: Floats, axes: Floats) -> Floats:
    """Angular displacements (..., P, J) [rad] about the axes (P, 3) of the postures."""
    return np.asarray((cell_rotations(positions) * axes[:, None, :]).sum(axis=-1))


def _centreline(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> Floats:
    """Return the ends of the cells (P, n, 3) [m] as the tracker would see them."""
    cells = default_markers(robot)
    blank = np.where(dataset.trial_mask, 0.0, np.nan)[..., None, None]  # not all were measured
    places = np.broadcast_to(blank, (*blank.shape[:2], len(cells), 3))
    unseen = replace(dataset, markers=cells, positions=places, orientations=None)
    return _predict(Predictor(unseen, robot, catalogue))


def _measured(dataset: DataSet, predictor: Predictor, angles: Floats | None) -> Measured:
    slopes = input_slopes(predictor, {})
    noise = estimate_noise(dataset, slopes)
    floor = None  # (P, J) [m²] expected squared distance of a perfect model
    if noise is not None:
        floor = Whitener(dataset, noise, slopes).variance.sum(axis=2)
    same = ('input', 'input_names', 'postures', 'trials', 'arc_lengths', 'mean', 'path')
    return Measured(
        **{key: getattr(dataset, key) for key in same},
        data=dataset.name,
        inputs=predictor.inputs,
        markers=tuple(marker.name for marker in dataset.markers),
        per_cell=dataset.markers == default_markers(dataset.robot),
        tips=dataset.positions[:, :, -1],
        angles=angles,
        position_noise=None if noise is None else noise.position,
        floor=floor,
    )


def on_the_centreline(dataset: DataSet) -> bool:
    """Return whether the markers lie on the centreline, so that their chords show its bends."""
    inside = (dataset.offsets == 0.0).all() and len(dataset.markers) > 1
    return bool(inside and (np.diff(dataset.arc_lengths, prepend=0.0) > 0.0).all())


def cell_rotations(positions: Floats) -> Floats:
    """
    Rotation from one chord of the arm to the next, as rotation vectors.

    The chord of a cell leads from the marker before it (the base for the first) to its own; the
    first turns from +z: the angular displacement of a cell based on the cell before it (Kato et
    al. 2015, section IV).

    Parameters
    ----------
    positions : (..., J, 3) [m]

    Returns
    -------
    (..., J, 3) [rad]

    """
    base = np.zeros((*positions.shape[:-2], 1, 3))
    after = np.diff(np.concatenate([base, positions], axis=-2), axis=-2)
    first = np.broadcast_to([0.0, 0.0, 1.0], base.shape)
    before = np.concatenate([first, after[..., :-1, :]], axis=-2)
    cross = np.cross(before, after)
    size = np.linalg.norm(cross, axis=-1, keepdims=True)
    angle = np.arctan2(size, (before * after).sum(axis=-1, keepdims=True))
    return np.asarray(cross / np.where(size > 0.0, size, 1.0) * angle)


def bending_axes(markers: Floats) -> Floats:
    """
    Axis (P, 3) about which each predicted posture (P, J, 3) turns most.

    +y in a planar arm, so that bends towards +x are positive; in a spatial one the whole posture
    turns by a positive angle.
    """
    axes = np.tile([0.0, 1.0, 0.0], (len(markers), 1))
    for p, turned in enumerate(cell_rotations(markers)):
        values, vectors = np.linalg.eigh(turned.T @ turned)
        axis = vectors[:, -1]
        if values[-1] > 0.0 and abs(axis[1]) < 0.999:
            axes[p] = axis * (1.0 if turned.sum(axis=0) @ axis >= 0.0 else -1.0)
    return axes
