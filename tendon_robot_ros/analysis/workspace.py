"""Where the tip can be while it looks in a given direction (Kato et al. 2015, section IV.B)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..exceptions import InputError
from ..model.model import TOLERANCE, Model
from ..model.shape import ShapeBatch
from ..robot import Robot
from .pairs import Pair, pairs_of

Floats = npt.NDArray[np.float64]
CHUNK = 20_000  # postures that are solved at once
MOST = 100_000_000  # postures that a sweep may hold
Progress = Callable[[str, int, int], None]


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
    """A sweep over all pairs of inputs: what was kept, and how many postures there were."""

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


def sweep(
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
    chosen = tuple(pairs_of(model.robot) if pairs is None else pairs)
    low = model.robot.tension_limits[0] if pretension is None else pretension
    high = model.robot.tension_limits[1] if limit is None else limit
    levels = _levels(step, low, high)
    total = len(levels) ** 2 * len(chosen)
    _check(chosen, views, tolerance, total)
    kept = _Kept(tuple(float(view) for view in views), tolerance)
    done = 0
    for which, tensions in _chunks(model, chosen, levels, low):
        kept.add(which, *model.solve(tensions))
        done += len(tensions)
        if progress:
            progress('postures', done, total)
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
    """The postures of a sweep that look at a view angle."""

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


def _levels(step: float, low: float, high: float) -> Floats:
    if not (step > 0.0 and 0.0 <= low < high):
        raise InputError(
            'workspace: expected a step above 0 and a pretension from 0 to below the limit, '
            f'got step {step:g} N, pretension {low:g} N, limit {high:g} N'
        )
    return np.asarray(np.round(low + step * np.arange(int((high - low) / step + 1e-6) + 1), 9))


def _check(pairs: Sequence[Pair], views: Sequence[float], tolerance: float, total: int) -> None:
    if not pairs:
        raise InputError('workspace: the robot has one input only; there is no pair to sweep')
    if not len(views) or min(views) < 0.0 or not tolerance > 0.0:
        raise InputError('workspace: expected view angles of 0° or more and a tolerance above 0')
    if total > MOST:
        raise InputError(
            f'workspace: {total:,} postures are more than {MOST:,}; make the step larger'
        )


def _chunks(
    model: Model, pairs: Sequence[Pair], levels: Floats, low: float
) -> Iterator[tuple[int, Floats]]:
    """Yield the index of the pair and tensions (b, m) [N]."""
    count = len(levels) ** 2
    for which, pair in enumerate(pairs):
        for start in range(0, count, CHUNK):
            near, far = np.divmod(np.arange(start, min(start + CHUNK, count)), len(levels))
            tensions = np.full((len(near), len(model.inputs)), low)
            tensions[:, pair.indices[0]] = levels[near]
            tensions[:, pair.indices[1]] = levels[far]
            yield which, tensions
