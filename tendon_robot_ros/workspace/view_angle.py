"""
Postures at a view angle, the angle between the tip's direction and the base's.

`Workspace` goes through a grid of tensions and keeps the postures near the angle; `view` and
`look_around` find those that have it exactly (Kato et al. 2015, section IV.B).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..common.arrays import ROWS_AT_ONCE, Floats
from ..common.errors import InputError, Progress, listener
from ..common.rotations import about, angle_between
from ..model.compile import BEND_TOLERANCE
from ..model.model import Model
from ..model.shape import Shape, ShapeBatch
from ..paths.path import DIRECTION_TOLERANCE_RAD, POSITION_TOLERANCE_M
from ..robot import Robot
from ..robot.description import planar_axis, tendon_offsets

# [1] postures of a grid or a cloud; more would take hours, and is a mistyped step as a rule
POSTURES_MAX = 100_000_000
# [rad] bend of a cell beyond which stacked guides would touch; assumed, the paper tells none. A
# section that bends by less away from the view would make no visible S
CELL_BEND_MAX_RAD = np.radians(20.0)
# [1] postures between straight and the tension limit that a look around chooses from: a millimetre
# of the tip or so apart, else the highest and the lowest would be missed
POSTURES_PER_SIDE = 250
WORKSPACE_FILES = ('postures.csv', 'workspace.npz')
HEIGHTS = 'highest', 'middle', 'lowest'


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
        if abs(cosine) > 0.5:  # within 60°: of six tendons around the axis, a neighbour
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
        return np.asarray(self.positions[:, -1])

    @property
    def is_flat(self) -> bool:
        """Whether all bends lie in the x-z plane."""
        return bool(np.abs(self.bend[..., 1]).max(initial=0.0) < 1e-9)

    @property
    def span(self) -> Floats:
        """Range of the tip positions (3,) [m] along x, y, z."""
        return np.asarray(np.ptp(self.tips, axis=0))

    @property
    def salient(self) -> tuple[int, int, int]:
        """Indices of the postures with the highest, the median and the lowest tip."""
        return by_height(self.tips)


def by_height(tips: Floats) -> tuple[int, int, int]:
    """Return the indices of the highest, the median and the lowest of tips (b, 3) [m]."""
    order = np.argsort(tips[:, 2], kind='stable')
    return int(order[-1]), int(order[len(order) // 2]), int(order[0])


class Workspace:
    """
    The postures at view angles, of all combinations of tensions of all pairs of inputs.

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

    Attributes
    ----------
    robot, step, pretension, limit, tolerance, views, pairs
        As given, or by default; `limit` is the largest tension [N].
    families : list of Family
        Those with postures, the largest of a view first.
    postures, unsolved : int
        All that were computed, and those of them without equilibrium.
    largest : float [rad]
        Tip angle of all.

    Raises
    ------
    InputError
        Step, pretension or views make no sense, or the postures are too many.

    """

    def __init__(
        self,
        model: Model,
        views: Sequence[float],
        step: float = 0.1,
        pretension: float | None = None,
        tolerance: float = np.radians(2.5),
        pairs: Sequence[Pair] | None = None,
        limit: float | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.robot, self.step, self.tolerance = model.robot, step, float(tolerance)
        self.views = [float(view) for view in views]
        self.pairs = tuple(pairs_of(model.robot) if pairs is None else pairs)
        low, high = model.robot.tension_limits
        self.pretension = low = low if pretension is None else pretension
        self.limit = high = high if limit is None else limit
        if not (step > 0.0 and 0.0 <= low < high):
            raise InputError(
                'workspace: expected a step above 0 and a pretension from 0 to below the limit, '
                f'got step {step:g} N, pretension {low:g} N, limit {high:g} N'
            )
        if not self.pairs:
            raise InputError('workspace: the robot has one input only; there is no pair to sweep')
        if not len(views) or min(views) < 0.0 or not tolerance > 0.0:
            problem = 'expected view angles of 0° or more and a tolerance above 0'
            raise InputError(f'workspace: {problem}')
        levels = np.round(low + step * np.arange(int((high - low) / step + 1e-6) + 1), 9)
        count = len(levels) ** 2
        self.postures = total = count * len(self.pairs)  # all that are computed
        if total > POSTURES_MAX:
            raise InputError(
                f'workspace: {total:,} postures are more than {POSTURES_MAX:,}; make the step '
                'larger'
            )
        self.unsolved, self.largest = 0, 0.0  # postures without equilibrium; [rad] tip angle
        parts: dict[tuple[Pair, int, int], list[tuple[Floats, ...]]] = {}
        for which, pair in enumerate(self.pairs):
            for start in range(0, count, ROWS_AT_ONCE):
                own = np.arange(start, min(start + ROWS_AT_ONCE, count))
                tensions = np.full((len(own), len(model.inputs)), low)
                tensions[:, pair.indices] = levels[np.stack(np.divmod(own, len(levels)), axis=1)]
                batch, changes = model.solve(tensions)
                # between the tip's direction and the base's: in the x-z plane with its sign and
                # beyond 180°, else from 0 to 180°
                flat = np.abs(batch.bend[..., 1]).max(axis=1, initial=0.0) < 1e-9
                turned = angle_between(batch.tip_direction, np.array([0.0, 0.0, 1.0]))
                good = changes < BEND_TOLERANCE
                angle = np.where(flat, batch.bend[..., 0].sum(axis=1), turned)
                self.unsolved += int((~good).sum())
                self.largest = max(self.largest, float(np.abs(angle[good]).max(initial=0.0)))
                arrays = (batch.inputs, batch.bend, batch.positions, angle)
                for (v, view), side in product(enumerate(self.views), (1, -1)):
                    rows = good & (np.abs(np.abs(angle) - view) <= tolerance)
                    rows &= (angle >= 0.0) == (side > 0)  # near 0°, too, it is on one side only
                    if rows.any():
                        part = tuple(array[rows] for array in arrays)
                        parts.setdefault((pair, v, side), []).append(part)
                listener(progress)('postures', which * count + start + len(own), total)
        families = [
            Family(pair, self.views[v], side, *map(np.concatenate, zip(*rows, strict=True)))
            for (pair, v, side), rows in parts.items()
        ]
        # those with postures, the largest of a view first
        self.families = sorted(families, key=lambda f: (self.views.index(f.view), -len(f)))

    def of(self, view: float) -> tuple[Family, ...]:
        """Families of a view angle [rad], the largest first."""
        return tuple(f for f in self.families if f.view == view)

    def to_json(self) -> dict[str, Any]:
        """Return plain data: the families with their salient postures, in m, N and rad."""
        first = ('step', 'pretension', 'limit', 'tolerance', 'postures', 'unsolved', 'largest')
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
        return {**{name: getattr(self, name) for name in first}, 'families': families}

    def save(self, folder: Path) -> None:
        """
        Write `postures.csv` and `workspace.npz` into a folder.

        The arrays of the npz have one row per kept posture: `tensions` [N], `bend` [rad],
        `positions` [m], `angle` [rad], `view` [rad], `side`, `pair` (index into `pairs`).
        """
        inputs, families = self.robot.inputs, self.families
        with (folder / WORKSPACE_FILES[0]).open('w', newline='', encoding='utf-8') as file:
            writer = csv.writer(file)
            writer.writerow(['view', 'pair', *inputs, 'angle', 'x', 'y', 'z'])
            for family in families:
                first = f'{family.view:.6g}', ' + '.join(family.pair.inputs)
                table = np.column_stack([family.tensions, family.angle, family.tips])
                writer.writerows([*first, *(f'{value:.6g}' for value in row)] for row in table)
        n, m = self.robot.cells, len(inputs)
        empty = {'tensions': (0, m), 'bend': (0, n, 2), 'positions': (0, n, 3), 'angle': (0,)}
        pairs = [' + '.join(pair.inputs) for pair in self.pairs]
        arrays: dict[str, Any] = {'inputs': np.array(inputs), 'pairs': np.array(pairs)}
        for name, shape in empty.items():
            parts = (getattr(family, name) for family in families)
            arrays[name] = np.concatenate([np.zeros(shape), *parts])
        counts = [len(family) for family in families]
        arrays['view'] = np.repeat([family.view for family in families], counts)
        arrays['side'] = np.repeat([family.side for family in families], counts)
        arrays['pair'] = np.repeat([self.pairs.index(f.pair) for f in families], counts)
        np.savez_compressed(folder / WORKSPACE_FILES[1], **arrays)


class Posture(NamedTuple):
    """A posture to go to, by its tip."""

    name: str
    position: Floats  # (3,) [m]
    direction: Floats  # (3,)


def salient(model: Model) -> list[Posture]:
    """
    Return the highest, the middle and the lowest tip at the 180° view, and an S at 45°.

    As in Kato et al. 2015, IV.B: one tendon of either section pulls and the others hold
    pretension, the lower limit; the tip's height is its z.
    """
    back = view(model, np.pi)
    rows = list(by_height(back.tip_position))
    tips = zip(HEIGHTS, back.tip_position[rows], back.tip_direction[rows], strict=True)
    postures = [Posture(f'{height}, 180° view', *tip) for height, *tip in tips]
    s_shaped = view(model, np.pi / 4)
    first = model.robot.sections[0].cells
    opposite = np.flatnonzero(s_shaped.bend[:, :first, 0].sum(axis=1) < -CELL_BEND_MAX_RAD)
    if len(opposite) == 0:
        raise InputError(f'{model.robot.name}: no S-shape at the 45° view within its limits')
    middle = opposite[by_height(s_shaped.tip_position[opposite])[1]]
    tip = s_shaped.tip_position[middle], s_shaped.tip_direction[middle]
    return [*postures, Posture('S-shape, 45° view', *tip)]


def view(model: Model, angle: float, step: float = 0.1) -> ShapeBatch:
    """
    Return the postures whose tip has turned by an angle [rad] in the x-z plane.

    The tension of the first section goes through both directions in steps [N]; for each, that
    of the second section is bisected until the view is exact.
    """
    low, high = model.limits[:, 0], model.limits[:, 1]
    prox_left, prox_right, dist_right = _planar_inputs(model)
    steps = np.arange(-high[prox_left], high[prox_right] + 0.5 * step, step)

    def inputs(dist: float) -> Floats:
        tensions = np.tile(low, (len(steps), 1))
        tensions[:, prox_left] = np.clip(-steps, low[prox_left], high[prox_left])
        tensions[:, prox_right] = np.clip(steps, low[prox_right], high[prox_right])
        tensions[:, dist_right] = dist
        return tensions

    def gap_at(tensions: Floats) -> Floats:
        return np.asarray(model.shapes(tensions).bend[:, :, 0].sum(axis=1) - angle)

    tensions = bisect(gap_at, inputs(low[dist_right]), inputs(high[dist_right]))
    bend = model.shapes(tensions).bend
    good = np.abs(bend[:, :, 0].sum(axis=1) - angle) < 1e-9
    good &= np.abs(bend).max(axis=(1, 2)) < CELL_BEND_MAX_RAD
    if not good.any():
        raise InputError(
            f'{model.robot.name}: no posture at the {np.degrees(angle):.0f}° view '
            'within its limits'
        )
    return model.shapes(tensions[good])


def bisect(gap_at: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    """
    Return tensions between two where a gap changes sign.

    Parameters
    ----------
    gap_at : callable
        Of tensions (b, m) [N], returns gaps (b,) of any unit.
    low, high : (b, m) [N]
        Tensions at which the gap is below 0, and at which it is not; where that is not so, one of
        them is approached.

    """
    for _ in range(np.finfo(float).nmant):  # then the bounds differ by rounding only
        middle = 0.5 * (low + high)
        below = (gap_at(middle) < 0.0)[:, None]
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high


def _planar_inputs(model: Model) -> tuple[int, int, int]:
    """Return the inputs of a planar two-section robot: prox left, prox right, dist right."""
    robot = model.robot
    sides = {}
    for index, members in enumerate(robot.input_tendons):
        tendon = robot.tendons[members[0]]
        sides[tendon.section, tendon.base[0] > 0.0] = index
    if len(robot.sections) != 2 or len(sides) != 4:
        raise InputError(f'{robot.name}: expected two sections with a tendon left and right each')
    first, second = (section.name for section in robot.sections)
    return sides[first, False], sides[first, True], sides[second, True]


def look_around(model: Model, angle: float, steps: int) -> list[Shape]:
    """
    Return shapes, one after the other, that all look at an angle [rad] from the base axis.

    A robot of two sections in a plane keeps its direction and moves its tip through all postures
    of section IV.B of the paper, from the highest to the lowest. A spatial robot turns once around
    the axis of the base.

    Parameters
    ----------
    model : Model
    angle : float
        Between the approach direction and the axis of the base, 0 to pi [rad].
    steps : int
        How many postures, at least 2.

    Raises
    ------
    InputError
        The robot has no such postures within its limits.

    """
    if planar_axis(model.robot) == 0:
        return _in_plane(model, angle, steps)
    return _around(model, angle, steps)


def _in_plane(model: Model, angle: float, steps: int) -> list[Shape]:
    held = view(model, angle, float(model.limits.max()) / POSTURES_PER_SIDE)
    changes = np.abs(np.diff(held.inputs, axis=0)).max(axis=1)
    distinct = np.concatenate([[True], changes > 1e-6])
    inputs, places = held.inputs[distinct], held.tip_position[distinct]
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    if len(inputs) < 2:
        raise InputError(
            f'{model.robot.name}: only one posture at the {np.degrees(angle):.0f}° view'
        )
    chosen = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], steps) - 1e-12))
    return [model.shape(inputs[row]) for row in chosen]


def _around(model: Model, angle: float, steps: int) -> list[Shape]:
    straight = model.shape(model.limits[:, 0])  # from there, a gentle bend and no curl
    looks = np.array([np.sin(angle), 0.0, np.cos(angle)])
    first = model.reach(direction=looks, guess=straight)
    shapes = [first.shape]
    for phi in np.linspace(0.0, 2.0 * np.pi, steps):
        place, along = about(2, phi) @ first.shape.tip_position, about(2, phi) @ looks
        solution = model.reach(place, along, guess=shapes[-1])
        apart, turned = solution.position_error, solution.direction_error
        if apart > POSITION_TOLERANCE_M or turned > DIRECTION_TOLERANCE_RAD:
            raise InputError(
                f'{model.robot.name}: the {np.degrees(angle):.0f}° view is out of reach when '
                f'turned by {np.degrees(phi):.0f}°: nearest {1e3 * apart:.1f} mm, '
                f'{np.degrees(turned):.1f}°; ask for a smaller angle'
            )
        shapes.append(solution.shape)
    return shapes[1:]
