"""Where the tip can be while it looks in a direction (Kato et al. 2015, section IV.B)."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, Progress, listener
from ..model.forward import TOLERANCE
from ..model.model import Model
from ..model.shape import ShapeBatch
from ..robot import Robot
from ..robot.description import tendon_offsets

Floats = npt.NDArray[np.float64]
ALIGNED_COSINE = 0.5  # cosine of 60°, from which on two inputs pull to the same side
POSTURES_AT_ONCE = 20_000  # postures that are solved at once: some ten MB for an arm of many cells
POSTURES_MAX = 100_000_000  # postures of a grid: more would take days
WORKSPACE_FILES = ('postures.csv', 'workspace.npz')


@dataclass(frozen=True)
class Pair:
    """Two inputs that are pulled while all others hold the pretension."""

    inputs: tuple[str, str]  # the one that ends nearer to the base first
    indices: tuple[int, int]
    kind: str  # 'opposite sides', 'same side' or 'across'

    @property
    def name(self) -> str:
        """Both inputs and how they lie."""
        return f'{self.inputs[0]} + {self.inputs[1]} ({self.kind})'


def pairs_of(robot: Robot) -> tuple[Pair, ...]:
    """
    List the pairs of inputs that end in different sections (in the same one if there is one).

    Opposite sides: their offsets point away from each other; same side: the same way.
    """
    last = [max(robot.tendon_cells[k] for k in tendons) for tendons in robot.input_tendons]
    toward = []
    for tendons in robot.input_tendons:
        offset = tendon_offsets(robot)[0, list(tendons)].sum(axis=0)
        toward.append(offset / max(float(np.linalg.norm(offset)), 1e-300))
    ends = len(set(last))
    pairs = []
    for i, j in combinations(range(len(robot.inputs)), 2):
        if ends > 1 and last[i] == last[j]:
            continue
        a, b = (i, j) if last[i] <= last[j] else (j, i)
        cosine = float(toward[i] @ toward[j])
        kind = 'across'
        if abs(cosine) > ALIGNED_COSINE:
            kind = 'same side' if cosine > 0.0 else 'opposite sides'
        pairs.append(Pair((robot.inputs[a], robot.inputs[b]), (a, b), kind))
    return tuple(pairs)


@dataclass(frozen=True, eq=False)
class Family:
    """The postures of one pair that look at one view angle, towards one side."""

    pair: Pair
    view: float  # [rad]
    side: int  # +1 or -1: the sign of the tip angle about +y; +1 in a spatial robot
    tensions: Floats  # (b, m) [N]
    bend: Floats  # (b, n, 2) [rad]
    positions: Floats  # (b, n, 3) [m]
    angle: Floats  # (b,) [rad] tip angle

    def __len__(self) -> int:
        """Count the postures."""
        return len(self.tensions)

    @property
    def tips(self) -> Floats:
        """Tip positions (b, 3) [m]."""
        tip: Floats = self.positions[:, -1]
        return tip

    @property
    def span(self) -> Floats:
        """Range of the tip positions (3,) [m] along x, y, z."""
        return np.asarray(np.ptp(self.tips, axis=0))

    @property
    def salient(self) -> tuple[int, int, int]:
        """Indices of the postures with the highest, the median and the lowest tip."""
        order = np.argsort(self.tips[:, 2], kind='stable')
        return int(order[-1]), int(order[len(order) // 2]), int(order[0])


@dataclass(frozen=True, eq=False)
class Workspace:
    """A grid of tensions over all pairs of inputs: what was kept, of how many postures."""

    robot: Robot
    step: float  # [N]
    pretension: float  # [N]
    limit: float  # [N] the largest tension
    tolerance: float  # [rad] a view angle may be missed by
    views: tuple[float, ...]  # [rad]
    pairs: tuple[Pair, ...]
    families: tuple[Family, ...]  # those with postures, the largest of a view first
    postures: int  # all that were computed
    unsolved: int  # of them without equilibrium
    largest: float  # [rad] tip angle of all

    def of(self, view: float) -> tuple[Family, ...]:
        """Families of a view angle [rad], the largest first."""
        return tuple(f for f in self.families if f.view == view)

    def to_json(self) -> dict[str, Any]:
        """Return plain data: the families with their salient postures, in m, N and rad."""
        first = ('step', 'pretension', 'limit', 'tolerance', 'postures', 'unsolved', 'largest')
        content = {name: getattr(self, name) for name in first}
        content['tolerance'] = float(self.tolerance)
        families = [
            {
                'view': family.view,
                'pair': list(family.pair.inputs),
                'kind': family.pair.kind,
                'side': family.side,
                'postures': len(family),
                'span': family.span.tolist(),
                'tensions': family.tensions[list(family.salient)].tolist(),
                'tips': family.tips[list(family.salient)].tolist(),
            }
            for family in self.families
        ]
        return {**content, 'families': families}


def find_workspace(
    model: Model,
    views: Sequence[float],
    step: float = 0.1,
    pretension: float | None = None,
    tolerance: float = np.radians(2.5),
    pairs: Sequence[Pair] | None = None,
    limit: float | None = None,
    progress: Progress | None = None,
) -> Workspace:
    """
    Compute all combinations of tensions of all pairs; keep the postures at the view angles.

    Parameters
    ----------
    model : Model
    views : sequence of float
        Tip angles to look for [rad].
    step : float
        Of the tensions [N].
    pretension : float, optional
        Lowest tension, and that of all other inputs [N]; default: the robot's lower limit.
    tolerance : float
        A tip angle may be off by this [rad].
    pairs : sequence of Pair, optional
        Default: `pairs_of`.
    limit : float, optional
        Highest tension [N]; default: the robot's upper limit.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    InputError
        Step, pretension or views make no sense, or the postures are too many.

    """
    show = listener(progress)
    chosen = tuple(pairs_of(model.robot) if pairs is None else pairs)
    low = model.robot.tension_limits[0] if pretension is None else pretension
    high = model.robot.tension_limits[1] if limit is None else limit
    if not (step > 0.0 and 0.0 <= low < high):
        raise InputError(
            'workspace: expected a step above 0 and a pretension from 0 to below the limit, '
            f'got step {step:g} N, pretension {low:g} N, limit {high:g} N'
        )
    if not chosen:
        raise InputError('workspace: the robot has one input only; there is no pair to sweep')
    if not len(views) or min(views) < 0.0 or not tolerance > 0.0:
        raise InputError('workspace: expected view angles of 0° or more and a tolerance above 0')
    levels = np.round(low + step * np.arange(int((high - low) / step + 1e-6) + 1), 9)
    total = len(levels) ** 2 * len(chosen)
    if total > POSTURES_MAX:
        raise InputError(
            f'workspace: {total:,} postures are more than {POSTURES_MAX:,}; make the step larger'
        )
    kept = _Kept(tuple(float(view) for view in views), tolerance)
    done = 0
    for which, tensions in _chunks(model, chosen, levels, low):
        kept.add(which, *model.solve(tensions))
        done += len(tensions)
        show('postures', done, total)
    return Workspace(
        robot=model.robot,
        step=step,
        pretension=low,
        limit=high,
        tolerance=tolerance,
        views=kept.views,
        pairs=chosen,
        families=kept.families(chosen),
        postures=total,
        unsolved=kept.unsolved,
        largest=kept.largest,
    )


class _Kept:
    """The postures of a grid that look at a view angle."""

    def __init__(self, views: tuple[float, ...], tolerance: float) -> None:
        self.views, self.tolerance = views, tolerance
        self.unsolved, self.largest = 0, 0.0
        self._parts: dict[tuple[int, int, int], list[tuple[Floats, ...]]] = {}

    def add(self, which: int, batch: ShapeBatch, changes: Floats) -> None:
        """Keep what looks at a view angle."""
        good = changes < TOLERANCE
        angle = tip_angles(batch.bend, batch.tip_direction)
        self.unsolved += int((~good).sum())
        self.largest = max(self.largest, float(np.abs(angle[good]).max(initial=0.0)))
        for v, view in enumerate(self.views):
            for side in (1, -1):
                rows = good & (np.abs(side * angle - view) <= self.tolerance)
                if rows.any():
                    arrays = (batch.inputs, batch.bend, batch.positions, angle)
                    part = tuple(array[rows] for array in arrays)
                    self._parts.setdefault((v, which, side), []).append(part)

    def families(self, pairs: Sequence[Pair]) -> tuple[Family, ...]:
        """Return them by view and pair, the largest family of a view first."""
        made = [
            Family(
                pairs[which], self.views[v], side, *map(np.concatenate, zip(*rows, strict=True))
            )
            for (v, which, side), rows in self._parts.items()
        ]
        order = {view: v for v, view in enumerate(self.views)}
        return tuple(sorted(made, key=lambda family: (order[family.view], -len(family))))


def tip_angles(bend: Floats, direction: Floats) -> Floats:
    """
    Angle (b,) [rad] between the tip's direction and the base's.

    In the x-z plane the sum of the bends (b, n, 2), with its sign and beyond 180°; otherwise that
    between +z and the direction (b, 3), from 0 to 180°.
    """
    flat = np.abs(bend[..., 1]).max(axis=1, initial=0.0) < 1e-9
    total: Floats = bend[..., 0].sum(axis=1)
    return np.asarray(np.where(flat, total, np.arccos(np.clip(direction[:, 2], -1.0, 1.0))))


def _chunks(
    model: Model, pairs: Sequence[Pair], levels: Floats, low: float
) -> Iterator[tuple[int, Floats]]:
    """Yield the index of the pair and tensions (b, m) [N]."""
    count = len(levels) ** 2
    for which, pair in enumerate(pairs):
        for start in range(0, count, POSTURES_AT_ONCE):
            near, far = np.divmod(
                np.arange(start, min(start + POSTURES_AT_ONCE, count)), len(levels)
            )
            tensions = np.full((len(near), len(model.inputs)), low)
            tensions[:, pair.indices[0]] = levels[near]
            tensions[:, pair.indices[1]] = levels[far]
            yield which, tensions


def save_workspace(workspace: Workspace, folder: Path) -> None:
    """
    Write `postures.csv` and `workspace.npz` into a folder.

    The arrays of the npz have one row per kept posture: `tensions` [N], `bend` [rad],
    `positions` [m], `angle` [rad], `view` [rad], `side`, `pair` (index into `pairs`).
    """
    inputs = workspace.robot.inputs
    with (folder / WORKSPACE_FILES[0]).open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(['view', 'pair', *inputs, 'angle', 'x', 'y', 'z'])
        for family in workspace.families:
            for tensions, angle, tip in zip(
                family.tensions.tolist(), family.angle, family.tips, strict=True
            ):
                numbers = [f'{value:.6g}' for value in (*tensions, angle, *tip)]
                writer.writerow([f'{family.view:.6g}', ' + '.join(family.pair.inputs), *numbers])
    np.savez_compressed(folder / WORKSPACE_FILES[1], **_arrays(workspace))  # type: ignore[arg-type]


def _arrays(workspace: Workspace) -> dict[str, object]:
    families = workspace.families
    n, m = workspace.robot.cells, len(workspace.robot.inputs)

    def joined(name: str, empty: tuple[int, ...]) -> object:
        parts = [getattr(family, name) for family in families]
        return np.concatenate(parts) if parts else np.zeros(empty)

    def repeated(values: list[float]) -> object:
        return np.repeat(values, [len(family) for family in families])

    pairs = [pair.inputs for pair in workspace.pairs]
    return {
        'inputs': np.array(workspace.robot.inputs),
        'pairs': np.array([' + '.join(names) for names in pairs]),
        'tensions': joined('tensions', (0, m)),
        'bend': joined('bend', (0, n, 2)),
        'positions': joined('positions', (0, n, 3)),
        'angle': joined('angle', (0,)),
        'view': repeated([family.view for family in families]),
        'side': repeated([family.side for family in families]),
        'pair': repeated([pairs.index(family.pair.inputs) for family in families]),
    }
