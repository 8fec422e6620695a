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
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..common.files import new_file
from ..common.given import Progress, listener
from ..common.workers import LostWork, Workers
from ..effects import load_catalogue
from ..model import forward
from ..model.model import Model
from ..robot import Robot, dump_robot
from ..robot.routes import tendon_offsets
from .cubes import LOOKS, Cubes, Floats, folds, sphere_part

BATCH = 2_000  # postures that are solved at once
CHUNK_S = 2.0  # [s] of work in a chunk
CHUNK_MAX = 200  # batches in a chunk
WALKS = 10  # rounds from the edge of what is known, half of all postures together
EDGE_MAX = 20_000  # postures at the edge that a round starts from
LOW_SHARE, HIGH_SHARE = 0.5, 0.1  # of the tensions are the lowest and the highest there are
WALK_SHARE = 0.15  # of the range of tensions: a step from a posture at the edge (1 sd, at most)
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

    def clear(self) -> None:
        """Forget all."""
        for cubes in self.cubes:
            cubes.clear()
        self.sphere[:] = False
        self.counts[:] = 0
        self.largest[:] = 0.0


@lru_cache(maxsize=2)
def _worker(sampling_key: str) -> dict[str, Any]:
    """Keep model and empty cubes of a sampling in the process that works on it."""
    return {}


def sort_batches(chunk: Batches) -> tuple[Packed, float]:
    """Solve and sort the batches of a chunk, in a worker; return what is known, and the time."""
    start, sampling = time.monotonic(), chunk.sampling
    own = _worker(repr(sampling))
    if not own:
        own |= {'model': Model(sampling.robot, load_catalogue(sampling.files)),
                'tally': SortedTips(sampling)}  # fmt: skip
    model, tally = own['model'], own['tally']
    tally.clear()
    for number, count in chunk.sizes:
        entropy = np.random.SeedSequence(sampling.seed, spawn_key=(chunk.round, number))
        random = np.random.default_rng(entropy)
        known = len(chunk.start) > 0
        _sort(model, tally, (onward if known else spread)(random, count, chunk))
    packed = {name: value.copy() for name, value in tally.packed().items()}
    return packed, time.monotonic() - start


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


def _sort(model: Model, tally: SortedTips, tensions: Floats) -> None:
    """Solve postures and put those that the arm can have where they belong."""
    sampling = tally.sampling
    thickness = np.linalg.norm(tendon_offsets(model.robot), axis=2).max(axis=1)  # (n,)
    batch, changes = model.solve(tensions)
    solved = changes < forward.TOLERANCE
    free = ~folds(batch.positions, thickness, tally.all.lengths)
    refused = int((~solved).sum()), int((solved & ~free).sum())
    tally.counts += np.array([len(tensions), *refused])
    good = solved & free
    inputs, tips, along = batch.inputs[good], batch.tip_position[good], batch.tip_direction[good]
    tally.all.add(inputs, tips, along)
    angle = np.arccos(np.clip(along[:, 2], -1.0, 1.0))
    tally.largest[0] = max(tally.largest[0], float(angle.max(initial=0.0)))
    tally.sphere[sphere_part(along, FINER)] = True
    for view, cubes in zip(sampling.views, tally.views, strict=True):
        rows = np.abs(angle - view) <= sampling.tolerance
        cubes.add(inputs[rows], tips[rows], along[rows])


# -----------------------------------------------------------------------------
# All rounds, on workers; what is known is written now and then, to go on from.


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
    seconds: float = 0.0  # for a batch, as far as it is known
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
        for number, size in enumerate(sizes):
            if number == len(sizes) - 2:
                self.late = self.late or self.tally.all.used
            batches = [
                (i, min(BATCH, size - i * BATCH))
                for i in range(-(-size // BATCH))
                if (number, i) not in self.done
            ]
            if number and batches and not any(r == number for r, _ in self.done):
                self.start = self._edge()
            handed: list[Batches] = []
            chunks = self._chunks(number, batches, workers.slots, handed)
            for index, result in workers.run(sort_batches, chunks):
                if isinstance(result, LostWork):
                    raise InputError(
                        f'{self.sampling.robot.name}: {result.workers} processes died over the '
                        'same postures; is there memory for --workers of them?'
                    )
                self._take(handed[index], *result)
                show('postures', begun + int(self.tally.counts[0]), total)
        return self.tally

    def _chunks(
        self, number: int, batches: list[tuple[int, int]], slots: int, handed: list[Batches]
    ) -> Iterator[Batches]:
        """Cut a round into chunks of some seconds, smaller ones at its end."""
        begin = 0
        while begin < len(batches):
            wanted = int(CHUNK_S / self.seconds) if self.seconds else 1
            count = max(min(wanted, (len(batches) - begin) // (2 * slots), CHUNK_MAX), 1)
            part = tuple(batches[begin : begin + count])
            handed.append(Batches(self.sampling, number, part, self.start))
            begin += count
            yield handed[-1]

    def _take(self, chunk: Batches, packed: Packed, seconds: float) -> None:
        own = seconds / len(chunk.sizes)
        self.seconds = own if not self.seconds else 0.7 * self.seconds + 0.3 * own
        self.tally.merge(packed)
        self.done |= {(chunk.round, number) for number, _ in chunk.sizes}
        if self.kept is not None and time.monotonic() > self.saved + SAVED_EVERY_S:
            self._save(self.kept)

    def _edge(self) -> Floats:
        """Return tensions (e, m) [N] of cubes with few neighbours, not more than go to workers."""
        if not self.tally.all.used:
            return self.start
        edge = self.tally.all.edge_tensions()
        return edge[:: max(len(edge) // EDGE_MAX, 1)]

    def _save(self, path: Path) -> None:
        self.saved = time.monotonic()
        done = np.array(sorted(self.done), dtype=np.int64)
        with new_file(path) as draft, draft.open('wb') as file:
            np.savez(file, key=self.key, done=done, start=self.start, late=self.late,
                     **self.tally.packed())  # type: ignore[arg-type]  # fmt: skip

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
