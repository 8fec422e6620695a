"""
Regions that no part of the arm may enter: planes, spheres and boxes, in the base frame.

    keep_out:
      - {name: table, plane: {point: [0, 0, -0.05], normal: [0, 0, 1]}}
      - {name: lamp, sphere: {centre: [0.08, 0, 0.12], radius: 0.02}, margin: 0.005}
      - {name: frame, box: {centre: [0, 0.1, 0.1], size: [0.2, 0.02, 0.2], rotation: [0, 0, 0.3]}}

Metres and radians. Behind a plane, seen along its normal, is forbidden. `rotation` is a rotation
vector of the box about its centre. `margin` is kept besides: the thickness of the arm, for one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

from ..common.arrays import Floats
from ..common.errors import InputError
from ..common.files import named_file, read_text
from ..common.rotations import from_rotation_vector
from ..common.words import FAR_M
from ..common.yaml_reading import Reader, in_range, parse_yaml

TEXT_MAX = 20_000  # [1] characters, because it is read while the arm is commanded
Vector = tuple[float, float, float]


def _place(one: Reader, key: str, limit: float = FAR_M) -> Vector:
    x, y, z = one.vector(key, 3)
    if max(abs(x), abs(y), abs(z)) > limit:
        raise one.error(key, f'three numbers of at most {limit:.4g} in SI units', [x, y, z])
    return x, y, z


def _direction(one: Reader, key: str) -> Vector:
    if not np.linalg.norm(direction := _place(one, key)) > 1e-9:
        raise one.error(key, 'a direction of some length', list(direction))
    return direction


def _size(one: Reader, key: str) -> Vector:
    if min(size := _place(one, key)) <= 0.0:
        raise one.error(key, 'three lengths above 0 [m]', list(size))
    return size


def _turn(one: Reader, key: str) -> Vector:
    return _place(one, key, 2.0 * np.pi)


@dataclass(frozen=True)
class Plane:
    """All that lies behind a plane, against its normal."""

    point: Annotated[Vector, _place]  # [m]
    normal: Annotated[Vector, _direction]  # of any length

    def distance(self, points: Floats) -> Floats:
        """Return how far points (..., 3) [m] are before the plane, (...) [m]."""
        normal = np.array(self.normal)
        return np.asarray((points - self.point) @ (normal / np.linalg.norm(normal)))


@dataclass(frozen=True)
class Sphere:
    """A ball."""

    centre: Annotated[Vector, _place]  # [m]
    radius: Annotated[float, in_range(1e-6, FAR_M, 'm')]

    def distance(self, points: Floats) -> Floats:
        """Return how far points (..., 3) [m] are outside, (...) [m]; negative: inside."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=-1) - self.radius)


@dataclass(frozen=True)
class Box:
    """A box, turned about its centre by a rotation vector."""

    centre: Annotated[Vector, _place]  # [m]
    size: Annotated[Vector, _size]  # [m] edge to edge
    rotation: Annotated[Vector, _turn] = (0.0, 0.0, 0.0)  # [rad]

    def distance(self, points: Floats) -> Floats:
        """Return how far points (..., 3) [m] are outside, (...) [m]; negative: inside."""
        edges = from_rotation_vector(self.rotation)  # columns
        over = np.abs((points - self.centre) @ edges) - 0.5 * np.array(self.size)
        outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(over.max(axis=-1), 0.0))


Solid = Plane | Sphere | Box
KINDS: dict[str, type[Solid]] = {'plane': Plane, 'sphere': Sphere, 'box': Box}


class Region(NamedTuple):
    """A named solid and the distance that is kept from it."""

    name: str
    solid: Solid
    margin: float = 0.0  # [m]


class Clearance(NamedTuple):
    """The minimum distance of points from all regions."""

    distance: float  # [m], its margin taken off; negative: inside; inf without regions
    region: str  # the nearest, '' without regions
    point: int  # index of the point that is nearest to it

    @property
    def inside(self) -> str:
        """The region that a point is in, '' where none is in any."""
        return self.region if self.distance < 0.0 else ''


@dataclass(frozen=True)
class KeepOut:
    """Regions that no part of the arm may enter; without any, everything is allowed."""

    regions: tuple[Region, ...] = ()

    def __bool__(self) -> bool:
        """Whether there are regions."""
        return bool(self.regions)

    def distances(self, points: npt.ArrayLike) -> Floats:
        """Return how far points (..., 3) [m] are from every region, (r, ...) [m]."""
        at = np.asarray(points, dtype=float)
        distances = [region.solid.distance(at) - region.margin for region in self.regions]
        return np.array(distances).reshape(len(self.regions), *at.shape[:-1])

    def clearance(self, points: npt.ArrayLike) -> Clearance:
        """Return how far points (n, 3) [m] are from the nearest region."""
        distances = self.distances(np.asarray(points, dtype=float).reshape(-1, 3))
        if not distances.size:
            return Clearance(np.inf, '', -1)
        row, point = np.unravel_index(int(np.argmin(distances)), distances.shape)
        return Clearance(float(distances[row, point]), self.regions[row].name, int(point))


def load_keep_out(named: str | Path) -> KeepOut:
    """
    Read regions from the path of a YAML file, or from its text.

    Raises
    ------
    InputError, RobotDescriptionError
        The file cannot be read; a region is not valid: which, what was expected and what came.

    """
    text = text_of(str(named))
    return parse_keep_out(text, 'keep_out' if text == named else str(named))


def text_of(named: str) -> str:
    """Return the YAML text of regions that are named by a path, or given as text."""
    if (path := named_file(named)) is None:
        return named
    text = read_text(path, lambda reason: InputError(f'{named}: cannot be read: {reason}'))
    if not text.strip():  # a file that is named shall hold regions
        raise InputError(f'{named}: expected regions under keep_out, got an empty file')
    return text


def parse_keep_out(text: str, source: str = 'keep_out') -> KeepOut:
    """
    Read regions from YAML text: a mapping with the key `keep_out`, or its list alone; '': none.

    Raises
    ------
    InputError, RobotDescriptionError

    """
    if len(text) > TEXT_MAX:
        raise InputError(f'{source}: expected at most {TEXT_MAX} characters, got {len(text)}')
    content = parse_yaml(text, lambda reason: InputError(f'{source}: {reason}'))
    if content is None or isinstance(content, list):
        content = {'keep_out': content or []}
    reader = Reader(source, '', content)
    reader.only('keep_out')
    if reader.content.get('keep_out') == []:
        return KeepOut()
    regions = tuple(_region(item) for item in reader.items('keep_out'))
    reader.unique('keep_out', [region.name for region in regions])
    return KeepOut(regions)


def joined(*texts: str) -> str:
    """
    Return the regions of several YAML texts as one; a region that two of them have counts once.

    Raises
    ------
    InputError, RobotDescriptionError
        Two regions that differ have the same name.

    """
    items: list[object] = []
    for text in texts:
        parse_keep_out(text)  # raises where it is not valid
        content = parse_yaml(text) or []
        content = content if isinstance(content, list) else content['keep_out']
        items += [item for item in content if item not in items]
    merged = yaml.safe_dump({'keep_out': items}, default_flow_style=None)
    parse_keep_out(merged)
    return merged


def _region(item: Reader) -> Region:
    item.only('name', 'margin', *KINDS)
    name = item.name('name')
    kinds = [kind for kind in KINDS if item.has(kind)]
    if len(kinds) != 1:
        got = ', '.join(kinds) or list(item.content)
        raise item.error('', f'one of {", ".join(KINDS)}', got)
    margin = item.number('margin', 0.0, FAR_M, 'm', 0.0)
    return Region(name, item.child(kinds[0]).read(KINDS[kinds[0]]), margin)
