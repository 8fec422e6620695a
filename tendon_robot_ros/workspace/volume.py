"""All places that the tip reaches, over all tendons at once, and where it can look from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import InputError, Progress
from ..common.workers import Workers
from ..model.model import Model
from ..robot import Robot
from ..robot.description import tendon_offsets
from .cubes import Reached, beyond
from .grid import POSTURES_MAX
from .streamed import Sampling, Stream

POSTURES_PER_CUBE = 10  # wanted: fewer, and cubes stay empty by chance
CUBES_MIN, CUBES_MAX = 8.0, 100.0  # along the arm: to show a form, and to stay within memory
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
    if edge is None:
        # tips fill about three squares, or four cubes, of the length of the arm; those of one
        # section in space are a shell of about four squares
        cubes, flat = postures / POSTURES_PER_CUBE, not tendon_offsets(robot)[..., 1].any()
        sheet = flat or bends_as_one(robot)
        count = (max(cubes, 0.0) / (3.0 if flat else 4.0)) ** (1 / 2 if sheet else 1 / 3)
        edge = robot.length / float(np.clip(count, CUBES_MIN, CUBES_MAX))
    if not 0 < postures <= POSTURES_MAX:
        raise InputError(f'workspace: expected 1 to {POSTURES_MAX:,} postures, got {postures:,}')
    if not 0.0 <= low < high:
        raise InputError(
            'workspace: expected a pretension from 0 to below the limit, '
            f'got {low:g} N and {high:g} N'
        )
    if (len(views) and min(views) < 0.0) or not tolerance > 0.0:
        raise InputError('workspace: expected view angles of 0° or more and a tolerance above 0')
    if not robot.length / CUBES_MAX <= edge <= robot.length:
        raise InputError(
            f'workspace: expected cubes of {1e3 * robot.length / CUBES_MAX:.2g} mm to the length '
            f'of the arm, got {1e3 * edge:.3g} mm'
        )
    robots, catalogue = [robot], model.catalogue
    friction = {name for name in robot.effects if catalogue[name].takes_force}
    if friction:
        lost = {name for name in robot.effects if catalogue[name].acts_on in friction} | friction
        left = {name: own for name, own in robot.effects.items() if name not in lost}
        robots.append(replace(robot, effects=left))
    streams = []
    for i, each in enumerate(robots):
        sampling = Sampling(
            each, catalogue.files, edge, (low, high), tuple(views), tolerance, seed
        )
        streams.append(Stream(sampling, postures, None if kept is None else kept / KEPT[i]))
    own_workers = workers or Workers()
    for i, stream in enumerate(streams):
        stream.run(own_workers, progress, i * postures, len(streams) * postures)
    found = streams[0].tally
    reached = found.all.reached()
    if not len(reached):
        raise InputError(f'{robot.name}: no posture of {postures:,} is one that the arm can have')
    return Volume(
        robot=robot,
        limits=(low, high),
        postures=postures,
        unsolved=int(found.counts[1]),
        folded=int(found.counts[2]),
        reached=reached,
        late=(len(reached) - streams[0].late) / len(reached),
        largest=float(found.largest[0]),
        sphere=float(found.sphere.mean()),
        views={
            view: cubes.reached() for view, cubes in zip(sampling.views, found.views, strict=True)
        },
        frictionless=streams[1].tally.all.reached() if len(streams) > 1 else None,
    )


def bends_as_one(robot: Robot) -> bool:
    """Whether all tendons end in one section: the place of the tip nearly fixes where it looks."""
    return len({tendon.section for tendon in robot.tendons}) == 1


def save_volume(volume: Volume, folder: Path, names: tuple[str, str]) -> None:
    """Write a table of the cubes (CSV) and all arrays (npz), in m, N and rad."""
    reached = volume.reached
    head = [*volume.robot.inputs, 'x', 'y', 'z', 'direction_x', 'direction_y', 'direction_z']
    table = np.column_stack([reached.tensions, reached.tips, reached.directions, reached.looks])
    header = ','.join([*head, 'looks'])
    np.savetxt(folder / names[0], table, '%.6g', ',', header=header, comments='')
    arrays: dict[str, Any] = {'inputs': np.array(volume.robot.inputs), 'edge': reached.edge}
    parts = {'': reached, 'frictionless_': volume.frictionless}
    parts |= {f'view_{i}_': part for i, part in enumerate(volume.views.values())}
    for start, part in parts.items():
        if part is not None:
            for name in ('cells', 'tensions', 'tips', 'directions', 'looks'):
                arrays[start + name] = getattr(part, name)
    np.savez_compressed(folder / names[1], **arrays, views=np.array(list(volume.views)))
