"""All places that the tip reaches, over all tendons at once, and where it can look from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import InputError
from ..common.given import Progress
from ..common.workers import Workers
from ..model.model import Model
from ..robot import Robot
from ..robot.routes import tendon_offsets
from .cubes import Reached, beyond
from .grid import POSTURES_MAX
from .streamed import Sampling, Stream

POSTURES_PER_CUBE = 10  # wanted: fewer, and cubes stay empty by chance
CUBES_MAX = 100.0  # along the arm
KEPT = ('unfinished-0.npz', 'unfinished-1.npz')  # with friction, without: not yet ended


@dataclass(frozen=True, eq=False)
class Volume:
    """Where the tip of a robot can be, all its tendons pulling as they like."""

    robot: Robot
    limits: tuple[float, float]  # [N]
    postures: int  # that were computed
    unsolved: int  # of them without equilibrium
    folded: int  # of them in which the arm would run into itself
    reached: Reached
    late: float  # share of the cubes that only the last tenth of the postures found
    largest: float  # [rad] angle between the tip's direction and the base's
    sphere: float  # share of all directions that the tip looks into
    views: dict[float, Reached]  # [rad] -> the tips that look at this angle
    frictionless: Reached | None  # the same without friction; None where the model has none

    @property
    def taken(self) -> float | None:
        """Share of the places without friction that are not near one with it."""
        other = self.frictionless
        return None if other is None else float(beyond(other.cells, self.reached.cells).mean())

    @property
    def given(self) -> float | None:
        """Share of the places with friction that are not near one without it."""
        other = self.frictionless
        return None if other is None else float(beyond(self.reached.cells, other.cells).mean())

    def to_json(self) -> dict[str, Any]:
        """Return plain data, in m, N and rad."""
        names = ('postures', 'unsolved', 'folded', 'late', 'largest', 'sphere', 'taken', 'given')
        return {
            **{name: getattr(self, name) for name in names},
            'limits': list(self.limits),
            'reached': self.reached.to_json(),
            'frictionless': self.frictionless.to_json() if self.frictionless else None,
            'views': [{'view': view, **part.to_json()} for view, part in self.views.items()],
        }


def find_volume(
    model: Model,
    postures: int = 100_000,
    views: Sequence[float] = (),
    tolerance: float = np.radians(2.5),
    limits: tuple[float, float] | None = None,
    edge: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    workers: Workers | None = None,
    kept: Path | None = None,
) -> Volume:
    """
    Sample postures over all tendons and collect the tips in cubes.

    Half of the postures have random tensions; the others start from those whose tips lie at the
    edge and walk on, so that the edge is found. Memory does not grow with their number. Postures
    in which the arm would run into itself do not count.

    Parameters
    ----------
    model : Model
    postures : int
        To compute; as many again without friction, if the model has any.
    views : sequence of float
        Angles [rad] between the tip's direction and the base's: their tips are collected, too.
    tolerance : float
        By which a view angle may be missed [rad].
    limits : (float, float), optional
        Lowest and highest tension [N]; by default the robot's.
    edge : float, optional
        Of the cubes [m]; by default so that ten postures come to each.
    seed : int
    progress : callable, optional
        Called with what is done, how many, of how many.
    workers : Workers, optional
        Processes, here or on a cluster; the result does not depend on them.
    kept : Path, optional
        Folder in which what is known is written every few seconds, and from which it goes on.

    Raises
    ------
    InputError
        The numbers make no sense, or no posture is left.

    """
    robot = model.robot
    low, high = limits or (float(model.limits[:, 0].min()), float(model.limits[:, 1].max()))
    edge = edge or _edge(robot, postures)
    _check(robot, postures, views, tolerance, (low, high), edge)
    plain = _without_friction(model)
    total = postures * (2 if plain else 1)

    def sampling_of(of: Model) -> Sampling:
        files = model.catalogue.files
        return Sampling(of.robot, files, edge, (low, high), tuple(views), tolerance, seed)

    own = workers or Workers()
    streams = [
        Stream(sampling_of(each), postures, None if kept is None else kept / KEPT[i])
        for i, each in enumerate([model, plain] if plain else [model])
    ]
    for i, stream in enumerate(streams):
        stream.run(own, progress, i * postures, total)
    return _volume(streams)


def _volume(streams: Sequence[Stream]) -> Volume:
    """Return what was found, with friction and, where there is any, without."""
    found, sampling = streams[0].tally, streams[0].sampling
    reached, postures = found.all.reached(), streams[0].postures
    if not len(reached):
        raise InputError(
            f'{sampling.robot.name}: no posture of {postures:,} is one that the arm can have'
        )
    views = zip(sampling.views, found.views, strict=True)
    return Volume(
        robot=sampling.robot,
        limits=sampling.limits,
        postures=postures,
        unsolved=int(found.counts[1]),
        folded=int(found.counts[2]),
        reached=reached,
        late=(len(reached) - streams[0].late) / len(reached),
        largest=float(found.largest[0]),
        sphere=float(found.sphere.mean()),
        views={view: cubes.reached() for view, cubes in views},
        frictionless=streams[1].tally.all.reached() if len(streams) > 1 else None,
    )


def _check(
    robot: Robot,
    postures: int,
    views: Sequence[float],
    tolerance: float,
    limits: tuple[float, float],
    edge: float,
) -> None:
    if not 0 < postures <= POSTURES_MAX:
        raise InputError(f'workspace: expected 1 to {POSTURES_MAX:,} postures, got {postures:,}')
    if not 0.0 <= limits[0] < limits[1]:
        raise InputError(
            'workspace: expected a pretension from 0 to below the limit, '
            f'got {limits[0]:g} N and {limits[1]:g} N'
        )
    if (len(views) and min(views) < 0.0) or not tolerance > 0.0:
        raise InputError('workspace: expected view angles of 0° or more and a tolerance above 0')
    if not robot.length / CUBES_MAX <= edge <= robot.length:
        raise InputError(
            f'workspace: expected cubes of {1e3 * robot.length / CUBES_MAX:.2g} mm to the length '
            f'of the arm, got {1e3 * edge:.3g} mm'
        )


def bends_as_one(robot: Robot) -> bool:
    """Whether all tendons end in one section: the place of the tip nearly fixes where it looks."""
    return len({tendon.section for tendon in robot.tendons}) == 1


def _edge(robot: Robot, postures: int) -> float:
    """Return the edge of the cubes [m] that so many postures fill."""
    cubes = max(postures, 1) / POSTURES_PER_CUBE
    # tips fill about three squares, or four cubes, of the length of the arm; those of one section
    # in space are a shell of about four squares
    if not tendon_offsets(robot)[..., 1].any():
        count = (cubes / 3.0) ** 0.5
    else:
        count = (cubes / 4.0) ** (0.5 if bends_as_one(robot) else 1.0 / 3.0)
    return robot.length / float(np.clip(count, 8.0, CUBES_MAX))


def _without_friction(model: Model) -> Model | None:
    """Return the model without friction, None if it has none."""
    catalogue = model.catalogue
    friction = {name for name in model.robot.effects if catalogue[name].takes_force}
    if not friction:
        return None
    kept = {
        name: values
        for name, values in model.robot.effects.items()
        if name not in friction and catalogue[name].acts_on not in friction
    }
    return Model(replace(model.robot, effects=kept), catalogue)


# -----------------------------------------------------------------------------
# As a file: a row per cube.


def save_volume(volume: Volume, folder: Path, names: tuple[str, str]) -> None:
    """Write a table of the cubes (CSV) and all arrays (npz), in m, N and rad."""
    reached = volume.reached
    head = [*volume.robot.inputs, 'x', 'y', 'z', 'direction_x', 'direction_y', 'direction_z']
    table = np.column_stack([reached.tensions, reached.tips, reached.directions, reached.looks])
    np.savetxt(
        folder / names[0], table, fmt='%.6g', delimiter=',', header=','.join([*head, 'looks']),
        comments='',
    )  # fmt: skip
    arrays: dict[str, Any] = {'inputs': np.array(volume.robot.inputs), 'edge': reached.edge}
    parts = {'': reached, 'frictionless_': volume.frictionless}
    parts |= {f'view_{i}_': part for i, part in enumerate(volume.views.values())}
    for start, part in parts.items():
        if part is not None:
            for name in ('cells', 'tensions', 'tips', 'directions', 'looks'):
                arrays[start + name] = getattr(part, name)
    np.savez_compressed(folder / names[1], **arrays, views=np.array(list(volume.views)))
