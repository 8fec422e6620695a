"""
The workspace of the tip over all tendons at once, and its approach directions.

Postures are sampled in rounds: the first round has random tensions; each later one starts from the
postures whose tips lie at the edge of the known workspace, and changes them a little. Every batch
has its own random generator, seeded by its round and number, and is sorted into cubes by the
process that computes it; cubes may be merged in any order. The result therefore does not depend on
the distribution of the work, and memory does not grow with the number of postures.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ..common.arrays import ROWS_AT_ONCE, Floats
from ..common.errors import InputError, Progress, listener
from ..common.files import new_file
from ..common.processes import UPKEEP_S
from ..common.rotations import angle_between
from ..common.workers import LostWork, Workers
from ..effects import load_catalogue
from ..model.compile import BEND_TOLERANCE
from ..model.model import Model
from ..model.shape import ShapeBatch
from ..robot import Robot, dump_robot, parse_robot
from ..robot.description import planar_axis, tendon_offsets
from .cubes import SPHERE_PART_COUNT, Cubes, Reached, beyond, folds, sphere_part
from .view_angle import POSTURES_MAX, WORKSPACE_FILES

# [1] postures wanted for every cube: with fewer some stay empty by chance
POSTURES_PER_CUBE = 10
# [1] cubes along the arm, at least and at most: fewer would show no form, more take gigabytes
CUBES_ALONG = (8.0, 100.0)
# [1] rounds from the edge of what is known, half of all postures together; in each the edge moves
# on by a step or so, else corners that few tensions reach would stay empty
EDGE_ROUNDS = 10
# [1] of random tensions, those that are the lowest and the highest, because the edge of the
# workspace is reached where most tendons are slack and some at their limit
EXTREMES = (0.5, 0.1)
# [1] of the range of tensions, 1 sd of a step from a posture at the edge; small, so that most of
# the new postures lie near the edge as well
STEP_SD = 0.15
# [1] parts of the sphere per part of `cubes`, along either side: 5°, so that the fraction of all
# directions is known to a percent or so
FINER = 6
KEPT = ('unfinished-0.npz', 'unfinished-1.npz')  # with friction, without: not yet ended
Packed = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Sampling:
    """What to sample; goes to the workers. `of` fills and checks it."""

    robot: Robot
    files: tuple[str, ...]  # the user's own effects
    postures: int
    views: tuple[float, ...]  # [rad]
    tolerance: float  # [rad]
    limits: tuple[float, float]  # [N]
    edge: float  # [m] of the cubes

    @classmethod
    def of(
        cls,
        model: Model,
        postures: int = 100_000,
        views: Sequence[float] = (),
        tolerance: float = np.radians(2.5),
        pretension: float | None = None,
        limit: float | None = None,
        edge: float | None = None,
    ) -> Sampling:
        """
        Say what to sample.

        Parameters
        ----------
        model : Model
        postures : int
            To compute; as many again without friction, if the model has any.
        views : sequence of float
            Angles [rad] between the tip's direction and the base's: their tips are collected, too.
        tolerance : float
            By which a view angle may be missed [rad].
        pretension, limit : float, optional
            Lowest and highest tension [N]; by default the robot's.
        edge : float, optional
            Of the cubes [m]; by default so that ten postures come to each.

        Raises
        ------
        InputError
            The numbers make no sense.

        """
        robot = model.robot
        minimum, maximum = CUBES_ALONG
        low, high = robot.tension_limits
        low, high = low if pretension is None else pretension, high if limit is None else limit
        if edge is None:
            # tips fill about three squares, or four cubes, of the length of the arm; those of one
            # section in space are a shell of about four squares
            flat, wanted = planar_axis(robot) == 0, postures / POSTURES_PER_CUBE
            sheet = flat or bends_as_one(robot)
            count = (max(wanted, 0.0) / (3.0 if flat else 4.0)) ** (1 / 2 if sheet else 1 / 3)
            edge = robot.length / float(np.clip(count, minimum, maximum))
        smallest, expected = robot.length / maximum, ''
        if not 0 < postures <= POSTURES_MAX:
            expected = f'1 to {POSTURES_MAX:,} postures, got {postures:,}'
        elif not 0.0 <= low < high:
            expected = f'a pretension from 0 to below the limit, got {low:g} N and {high:g} N'
        elif (len(views) and min(views) < 0.0) or not tolerance > 0.0:
            expected = 'view angles of 0° or more and a tolerance above 0'
        elif not smallest <= edge <= robot.length:
            cubes = f'cubes of {1e3 * smallest:.2g} mm to the length of the arm'
            expected = f'{cubes}, got {1e3 * edge:.3g} mm'
        if expected:
            raise InputError(f'workspace: expected {expected}')
        files = model.catalogue.files
        return cls(robot, files, postures, tuple(views), tolerance, (low, high), edge)

    @property
    def rounds(self) -> list[int]:
        """How many postures each round has."""
        half = self.postures // 2
        more = np.diff(np.linspace(0, half, EDGE_ROUNDS + 1).astype(int))
        return [self.postures - half, *more[more > 0].tolist()]


def bends_as_one(robot: Robot) -> bool:
    """Whether all tendons end in one section: the place of the tip nearly fixes where it looks."""
    return len({tendon.section for tendon in robot.tendons}) == 1


class SortedTips:
    """Sorted postures: cubes of tips, and counts, of bounded memory."""

    def __init__(self, sampling: Sampling) -> None:
        self.sampling = sampling
        # of all tips, and of those at each view
        self.cubes = [Cubes(sampling.robot, sampling.edge) for _ in (None, *sampling.views)]
        self.all, *self.views = self.cubes
        self.sphere = np.zeros(FINER**2 * SPHERE_PART_COUNT, dtype=bool)  # visited
        self.counts = np.zeros(3, dtype=np.int64)  # postures, without equilibrium, folded
        self.largest = np.zeros(1)  # [rad]
        # (n,) [m], the farthest tendon
        self.thickness = np.linalg.norm(tendon_offsets(sampling.robot), axis=2).max(axis=1)

    def packed(self) -> Packed:
        """Return everything as arrays."""
        arrays = {'sphere': self.sphere, 'counts': self.counts, 'largest': self.largest}
        for i, cubes in enumerate(self.cubes):
            arrays |= {f'{i}_{name}': value for name, value in cubes.packed().items()}
        return arrays

    def merge(self, other: Packed) -> None:
        """Add what another one has packed."""
        self.sphere |= other['sphere']
        self.counts += other['counts']
        self.largest = np.maximum(self.largest, other['largest'])
        for i, cubes in enumerate(self.cubes):
            names = cubes.packed()
            cubes.merge({name: other[f'{i}_{name}'] for name in names})

    def add(self, batch: ShapeBatch, changes: Floats) -> None:
        """Sort solved postures into the cubes; arms that collide with themselves are excluded."""
        tips, along = batch.tip_position, batch.tip_direction
        solved = changes < BEND_TOLERANCE
        free = ~folds(batch.positions, self.thickness, self.sampling.robot.cell_lengths)
        self.counts += np.array([len(tips), (~solved).sum(), (solved & ~free).sum()])
        good = solved & free
        inputs, tips, along = batch.inputs[good], tips[good], along[good]
        angle = angle_between(along, np.array([0.0, 0.0, 1.0]))
        self.largest = np.maximum(self.largest, angle.max(initial=0.0))
        self.sphere[sphere_part(along, FINER)] = True
        self.all.add(inputs, tips, along)
        for view, cubes in zip(self.sampling.views, self.views, strict=True):
            rows = np.abs(angle - view) <= self.sampling.tolerance
            cubes.add(inputs[rows], tips[rows], along[rows])


def sort_batches(
    sampling: Sampling, round: int, start: Floats, batches: Sequence[tuple[int, int]]
) -> Packed:
    """Solve and sort the batches (number, postures) of a round, in a worker."""
    model = _model_of(dump_robot(sampling.robot), sampling.files)
    tally = SortedTips(sampling)
    for number, count in batches:
        entropy = np.random.SeedSequence(0, spawn_key=(round, number))
        random = np.random.default_rng(entropy)
        tally.add(*model.solve(drawn(random, count, sampling, start)))
    return tally.packed()


@lru_cache(maxsize=1)
def _model_of(description: str, files: tuple[str, ...]) -> Model:
    """Return the model of a robot as YAML; a process makes it once for all chunks."""
    return Model(parse_robot(description), files)


def drawn(random: np.random.Generator, count: int, sampling: Sampling, start: Floats) -> Floats:
    """
    Return random tensions (count, m) [N], a step away from those of a start (e, m), if any.

    Without a start many tendons are at the lowest tension, and some at the highest.
    """
    low, high = sampling.limits
    if len(start):
        rows = start[random.integers(len(start), size=count)]
        size = STEP_SD * (high - low) * random.random((count, 1))
        step = size * random.normal(size=rows.shape)
        step[random.random(rows.shape) < EXTREMES[0]] = 0.0
        return np.asarray(np.clip(rows + step, low, high))
    shape = (count, len(sampling.robot.inputs))
    fraction, kind = random.random(shape), random.random(shape)
    fraction[kind < EXTREMES[0]] = 0.0
    fraction[kind > 1.0 - EXTREMES[1]] = 1.0
    return low + (high - low) * fraction


class Stream:
    """A sampling under way; it goes on from what is kept."""

    def __init__(self, sampling: Sampling, kept: Path | None) -> None:
        self.sampling, self.kept, self.tally = sampling, kept, SortedTips(sampling)
        self.finished = set[tuple[int, int]]()  # (round, batch)
        self.start = np.zeros((0, len(sampling.robot.inputs)))  # (e, m) [N] of the round
        self.late = 0  # cubes when the last tenth of the postures began
        self.saved = time.monotonic()
        if kept is not None and kept.is_file():
            self.load(kept)

    @property
    def key(self) -> str:
        """Digest of what is sampled."""
        sampling = replace(self.sampling, robot=None)  # type: ignore[arg-type]
        digests = [effect.digest for effect in load_catalogue(sampling.files)]
        text = f'{dump_robot(self.sampling.robot)} {sampling} {digests}'
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def run(self, workers: Workers, show: Progress, computed: int, total: int) -> None:
        """Sample what is missing; `computed` of `total` postures were computed before."""
        sizes = self.sampling.rounds
        for number, size in enumerate(sizes):
            if number == len(sizes) - 2:
                self.late = self.late or len(self.tally.all)
            batches = [
                (i, min(ROWS_AT_ONCE, size - i * ROWS_AT_ONCE))
                for i in range(-(-size // ROWS_AT_ONCE))
                if (number, i) not in self.finished
            ]
            begins = not any(round_done == number for round_done, _ in self.finished)
            if number and batches and begins and len(self.tally.all):
                known = Reached(self.tally.all)
                # the half of the cubes with the fewest neighbours
                edge = known.tensions[known.neighbours <= np.median(known.neighbours)]
                # thinned, because the start goes to every worker with every chunk
                self.start = edge[:: max(len(edge) // (10 * ROWS_AT_ONCE), 1)]
            work = partial(sort_batches, self.sampling, number, self.start)
            for chunk, result in workers.in_chunks(work, batches):
                if isinstance(result, LostWork):
                    raise InputError(
                        f'{self.sampling.robot.name}: {result.workers} processes died over the '
                        'same postures; is there memory for --workers of them?'
                    )
                self.tally.merge(result)
                self.finished |= {(number, i) for i, _ in chunk}
                if self.kept is not None and time.monotonic() > self.saved + UPKEEP_S:
                    self.save(self.kept)
                show('postures', computed + int(self.tally.counts[0]), total)

    def save(self, path: Path) -> None:
        """Write the state."""
        self.saved = time.monotonic()
        finished = np.array(sorted(self.finished), dtype=np.int64)
        known: dict[str, Any] = self.tally.packed()
        with new_file(path) as draft, draft.open('wb') as file:
            np.savez(file, key=self.key, done=finished, start=self.start, late=self.late, **known)

    def load(self, path: Path) -> None:
        """Load the state of an earlier run, to continue it."""
        try:
            with np.load(path) as arrays:
                content = dict(arrays)
            key = str(content['key'])
        except (OSError, ValueError, EOFError, LookupError, TypeError, BadZipFile) as error:
            raise InputError(f'{path}: cannot be read ({error}); delete it') from None
        if key != self.key:
            raise InputError(
                f'{path}: is of another robot or other options; delete it, or give these again'
            )
        self.tally.merge(content)
        self.finished = {(int(r), int(i)) for r, i in content['done']}
        self.start, self.late = content['start'], int(content['late'])


class Volume:
    """
    The workspace of the tip over all combinations of tensions, sampled and collected in cubes.

    Half of the postures have random tensions; the others start from those whose tips lie at the
    edge. Memory does not grow with their number. Postures in which the arm would run into itself
    do not count.

    Parameters
    ----------
    sampling : Sampling
    progress : callable, optional
        Called with what is done, how many, of how many.
    workers : Workers, optional
        Processes, here or on a cluster; the result does not depend on them.
    kept : Path, optional
        Folder in which what is known is written every few seconds, and from which it goes on.

    Attributes
    ----------
    robot, limits, postures
        As of the sampling.
    unsolved, folded : int
        Postures without equilibrium, and those in which the arm collides with itself.
    reached : Reached
    frictionless : Reached or None
        The same without friction; None where the model has none, or no posture is left.
    taken, given : float or None [1]
        Fraction of the places without friction that are not near one with it, and of the places
        with friction that are not near one without it.
    late : float [1]
        Fraction of the cubes that only the last tenth of the postures found.
    largest : float [rad]
        Angle between the tip's direction and the base's.
    sphere : float [1]
        Fraction of all directions that the tip looks into.
    views : dict of Reached
        By angle [rad]: the tips that look at it.

    Raises
    ------
    InputError
        No posture is left.

    """

    def __init__(
        self,
        sampling: Sampling,
        progress: Progress | None = None,
        workers: Workers | None = None,
        kept: Path | None = None,
    ) -> None:
        self.robot, self.limits, self.postures = sampling.robot, sampling.limits, sampling.postures
        samplings = [sampling]
        catalogue = load_catalogue(sampling.files)
        if friction := {name for name in self.robot.effects if catalogue[name].takes_force}:
            without = {
                name: values
                for name, values in self.robot.effects.items()
                if not {name, catalogue[name].acts_on} & friction
            }
            samplings.append(replace(sampling, robot=replace(self.robot, effects=without)))
        streams = [
            Stream(each, None if kept is None else kept / name)
            for each, name in zip(samplings, KEPT, strict=False)
        ]
        workers, show = workers or Workers(), listener(progress)
        for i, stream in enumerate(streams):
            stream.run(workers, show, i * self.postures, len(streams) * self.postures)
        tally = streams[0].tally
        self.reached = Reached(tally.all)
        if not len(self.reached):
            raise InputError(
                f'{self.robot.name}: no posture of {self.postures:,} is one that the arm can have'
            )
        _, self.unsolved, self.folded = tally.counts.tolist()
        self.late = (len(self.reached) - streams[0].late) / len(self.reached)
        self.largest = float(tally.largest[0])
        self.sphere = float(tally.sphere.mean())
        self.views = dict(zip(sampling.views, map(Reached, tally.views), strict=True))
        self.frictionless = self.taken = self.given = None
        if len(streams) > 1 and len(other := Reached(streams[1].tally.all)):
            self.frictionless = other
            self.taken = float(beyond(other.cells, self.reached.cells).mean())
            self.given = float(beyond(self.reached.cells, other.cells).mean())

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

    def save(self, folder: Path) -> None:
        """Write a table of the cubes (CSV) and all arrays (npz), in m, N and rad."""
        reached = self.reached
        head = [*self.robot.inputs, 'x', 'y', 'z', 'direction_x', 'direction_y', 'direction_z']
        parts = reached.tensions, reached.tips, reached.directions, reached.looks
        header = ','.join([*head, 'looks'])
        table, arrays_file = (folder / name for name in WORKSPACE_FILES)
        np.savetxt(table, np.column_stack(parts), '%.6g', ',', header=header, comments='')
        arrays: dict[str, Any] = {'inputs': np.array(self.robot.inputs), 'edge': reached.edge}
        every = {'': reached, 'frictionless_': self.frictionless}
        every |= {f'view_{i}_': part for i, part in enumerate(self.views.values())}
        for start, part in every.items():
            if part is not None:
                for name in ('cells', 'tensions', 'tips', 'directions', 'looks'):
                    arrays[start + name] = getattr(part, name)
        np.savez_compressed(arrays_file, **arrays, views=np.array(list(self.views)))
