"""
Postures in rounds and chunks, sorted into cubes where they are computed: memory does not grow.

The first round has random tensions; those after it start from the edge of what is known then and
walk on. Every batch has chance of its own, spawned by its round and number, and cubes may be
merged in any order, so that the result does not depend on who computes what and when.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, Progress, listener
from ..common.files import new_file
from ..common.workers import ChunkSize, LostWork, Workers
from ..effects import load_catalogue
from ..model import forward
from ..model.model import Model
from ..model.shape import ShapeBatch
from ..robot import Robot, dump_robot
from ..robot.description import tendon_offsets
from .cubes import LOOKS, Cubes, Floats, folds, sphere_part

BATCH = 2_000  # postures that are solved at once: some MB for an arm of many cells
CHUNK_MAX = 200  # batches in a chunk: what is computed again if its worker dies
WALKS = 10  # rounds from the edge of what is known, half of all postures together
EDGE_MAX = 20_000  # postures at the edge that a round starts from: they go to every worker
# [1] of the tensions are the lowest and the highest there are, because the edge is found there
LOW_SHARE, HIGH_SHARE = 0.5, 0.1
WALK_SHARE = 0.15  # [1] of the range of tensions: 1 sd of a step from a posture at the edge
FINER = 6  # than the looks of a cube are the parts of all directions, along either side
SAVED_EVERY_S = 10.0  # [s] the most that is computed again after an end
Packed = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Sampling:
    """What to sample; goes to the workers."""

    robot: Robot
    files: tuple[str, ...]  # the user's own effects
    edge: float  # [m] of the cubes
    limits: tuple[float, float]  # [N]
    views: tuple[float, ...]  # [rad]
    tolerance: float  # [rad]
    seed: int

    def rounds(self, postures: int) -> list[int]:
        """Return how many postures each round has."""
        walks = np.diff(np.linspace(0, postures // 2, WALKS + 1).astype(int))
        return [postures - postures // 2, *walks[walks > 0].tolist()]


@dataclass(frozen=True)
class Batches:
    """A chunk: some batches of a round."""

    sampling: Sampling
    round: int
    sizes: tuple[tuple[int, int], ...]  # (number of the batch, its postures)
    start: Floats = field(repr=False)  # (e, m) [N] at the edge of what is known; none: random


class SortedTips:
    """What became of postures: cubes, and counts that do not grow."""

    def __init__(self, sampling: Sampling) -> None:
        self.sampling = sampling
        self.all = Cubes(sampling.robot, sampling.edge)
        self.views = [Cubes(sampling.robot, sampling.edge) for _ in sampling.views]
        self.sphere = np.zeros(FINER**2 * LOOKS, dtype=bool)  # directions that were looked into
        self.counts = np.zeros(3, dtype=np.int64)  # postures, without equilibrium, folded
        self.largest = np.zeros(1)  # [rad]
        self.thickness = np.linalg.norm(tendon_offsets(sampling.robot), axis=2).max(axis=1)
        self.lengths = np.concatenate(
            [np.full(section.cells, section.cell_length) for section in sampling.robot.sections]
        )  # (n,) [m]; thickness (n,) [m]: the farthest tendon

    @property
    def cubes(self) -> list[Cubes]:
        """All cubes: of all tips, and of those at each view."""
        return [self.all, *self.views]

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
        """Put solved postures where they belong, those that the arm cannot have left out."""
        tips, along = batch.tip_position, batch.tip_direction
        solved = changes < forward.TOLERANCE
        free = ~folds(batch.positions, self.thickness, self.lengths)
        self.counts += np.array([len(tips), (~solved).sum(), (solved & ~free).sum()])
        good = solved & free
        inputs, tips, along = batch.inputs[good], tips[good], along[good]
        angle = np.arccos(np.clip(along[:, 2], -1.0, 1.0))
        self.largest = np.maximum(self.largest, angle.max(initial=0.0))
        self.sphere[sphere_part(along, FINER)] = True
        self.all.add(inputs, tips, along)
        for view, cubes in zip(self.sampling.views, self.views, strict=True):
            rows = np.abs(angle - view) <= self.sampling.tolerance
            cubes.add(inputs[rows], tips[rows], along[rows])


def sort_batches(chunk: Batches) -> tuple[Packed, float]:
    """Solve and sort the batches of a chunk, in a worker; return what is known, and the time."""
    start, sampling = time.monotonic(), chunk.sampling
    model, tally = _model_of(sampling), SortedTips(sampling)
    for number, count in chunk.sizes:
        entropy = np.random.SeedSequence(sampling.seed, spawn_key=(chunk.round, number))
        random = np.random.default_rng(entropy)
        tensions = (onward if len(chunk.start) else spread)(random, count, chunk)
        tally.add(*model.solve(tensions))
    return tally.packed(), time.monotonic() - start


_MODELS: dict[str, Model] = {}  # of the last sampling that this process has worked on


def _model_of(sampling: Sampling) -> Model:
    """Return the model; a process makes it once for all chunks."""
    key = repr((sampling.robot, sampling.files))
    if key not in _MODELS:
        _MODELS.clear()
        _MODELS[key] = Model(sampling.robot, load_catalogue(sampling.files))
    return _MODELS[key]


def spread(random: np.random.Generator, count: int, chunk: Batches) -> Floats:
    """Random tensions (count, m) [N]: many tendons hold the lowest, some pull the highest."""
    low, high = chunk.sampling.limits
    shape = (count, len(chunk.sampling.robot.inputs))
    share, kind = random.random(shape), random.random(shape)
    share[kind < LOW_SHARE] = 0.0
    share[kind > 1.0 - HIGH_SHARE] = 1.0
    return low + (high - low) * share


def onward(random: np.random.Generator, count: int, chunk: Batches) -> Floats:
    """Tensions (count, m) [N] a step away from those of postures at the edge."""
    low, high = chunk.sampling.limits
    rows = chunk.start[random.integers(len(chunk.start), size=count)]
    size = WALK_SHARE * (high - low) * random.random((count, 1))
    step = size * random.normal(size=rows.shape)
    step[random.random(rows.shape) < LOW_SHARE] = 0.0
    return np.asarray(np.clip(rows + step, low, high))


@dataclass
class Stream:
    """A sampling on its way."""

    sampling: Sampling
    postures: int
    kept: Path | None = None  # where it is written
    tally: SortedTips = field(init=False)
    done: set[tuple[int, int]] = field(default_factory=set)  # (round, batch)
    start: Floats = field(init=False)  # (e, m) [N] that the round starts from
    late: int = 0  # cubes when the last tenth of the postures began
    saved: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        """Go on from what is kept."""
        self.tally = SortedTips(self.sampling)
        self.start = np.zeros((0, len(self.sampling.robot.inputs)))
        if self.kept is not None and self.kept.is_file():
            self._load(self.kept)

    @property
    def key(self) -> str:
        """Digest of what is sampled."""
        sampling = replace(self.sampling, robot=None)  # type: ignore[arg-type]
        digests = [effect.digest for effect in load_catalogue(sampling.files)]
        text = f'{dump_robot(self.sampling.robot)} {sampling} {self.postures} {digests}'
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def run(
        self, workers: Workers, progress: Progress | None, begun: int, total: int
    ) -> SortedTips:
        """Sample what is left."""
        show, sizes = listener(progress), self.sampling.rounds(self.postures)
        pace = ChunkSize(workers.slots, CHUNK_MAX)
        for number, size in enumerate(sizes):
            if number == len(sizes) - 2:
                self.late = self.late or len(self.tally.all)
            batches = [
                (i, min(BATCH, size - i * BATCH))
                for i in range(-(-size // BATCH))
                if (number, i) not in self.done
            ]
            begins = not any(done == number for done, _ in self.done)
            if number and batches and begins and len(self.tally.all):
                edge = self.tally.all.reached().edge_tensions
                self.start = edge[:: max(len(edge) // EDGE_MAX, 1)]
            handed: list[Batches] = []
            chunks = self._chunks(number, batches, pace, handed)
            for index, result in workers.run(sort_batches, chunks):
                if isinstance(result, LostWork):
                    raise InputError(
                        f'{self.sampling.robot.name}: {result.workers} processes died over the '
                        'same postures; is there memory for --workers of them?'
                    )
                packed, seconds = result
                pace.took(seconds, len(handed[index].sizes))
                self.tally.merge(packed)
                self.done |= {(number, i) for i, _ in handed[index].sizes}
                if self.kept is not None and time.monotonic() > self.saved + SAVED_EVERY_S:
                    self._save(self.kept)
                show('postures', begun + int(self.tally.counts[0]), total)
        return self.tally

    def _chunks(
        self, number: int, batches: list[tuple[int, int]], pace: ChunkSize, handed: list[Batches]
    ) -> Iterator[Batches]:
        """Cut a round into chunks."""
        begin = 0
        while begin < len(batches):
            end = begin + pace.of(len(batches) - begin)
            handed.append(Batches(self.sampling, number, tuple(batches[begin:end]), self.start))
            begin = end
            yield handed[-1]

    def _save(self, path: Path) -> None:
        self.saved = time.monotonic()
        done = np.array(sorted(self.done), dtype=np.int64)
        known: dict[str, Any] = self.tally.packed()
        with new_file(path) as draft, draft.open('wb') as file:
            np.savez(file, key=self.key, done=done, start=self.start, late=self.late, **known)

    def _load(self, path: Path) -> None:
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
        self.done = {(int(r), int(i)) for r, i in content['done']}
        self.start, self.late = content['start'], int(content['late'])
