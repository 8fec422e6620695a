"""The robot description: YAML to frozen, validated dataclasses (SI units); tendon routes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, RobotDescriptionError
from ..common.results import TextResult
from ..common.rotations import turned_in_plane
from ..common.yaml_reading import Read, Reader, in_range, one_of, parse_yaml

TOLERANCES = (
    'bending_stiffness',
    'cell_stiffness',
    'cell_kink',
    'channel_gain',
    'hole_radius',
    'pull_zero',
    'friction_coefficient',
    'tension_gain',
    'position',
    'rotation',
)
XY = tuple[float, float]  # [m]
# [m] of a section that only holds the holes of the base plate, because no cell is so short
PLATE_LENGTH_MAX_M = 1e-5
EffectValues = dict[str, float | tuple[float, ...]]


def _cells(item: Reader, key: str = 'cells') -> int:
    return item.whole(key, 1, 10000)


def _per_cell(unit: str, default: float | None = None) -> Read:
    return lambda item, key: item.per_cell(key, _cells(item), unit, default)


def _mass_offset(item: Reader, key: str) -> tuple[XY, ...]:
    """Return where the weight of each cell is: one place for all cells, or one each."""
    value, cells = item.content[key], _cells(item)
    each = isinstance(value, list) and any(isinstance(row, list) for row in value)
    offsets = item.offsets(key, cells) if each else (item.offset(key),) * cells
    return offsets if any(map(any, offsets)) else ()


@dataclass(frozen=True)
class Section:
    """An independently actuated run of equal-length cells."""

    name: Annotated[str, Reader.name]
    cells: Annotated[int, _cells]
    cell_length: Annotated[float, in_range(1e-6, 10.0, 'm')]
    bending_stiffness: Annotated[tuple[float, ...], _per_cell('N·m/rad')]  # (cells,)
    mass_profile: Annotated[tuple[float, ...], _per_cell('1', 1.0)]  # (cells,)
    bends_as: Annotated[str, one_of('arc', 'hinge')] = 'arc'
    mass_offset: Annotated[tuple[XY, ...], _mass_offset] = ()  # (cells, 2) [m]; empty: on the axis

    @property
    def is_plate(self) -> bool:
        """Whether it only holds the holes of a base plate, which people do not count as a cell."""
        return self.cells * self.cell_length <= PLATE_LENGTH_MAX_M


@dataclass(frozen=True)
class Tendon:
    """
    A tendon: its offset from the centroid, the section it ends in, the input that pulls it.

    The offset goes from `base` to `end` while it turns about the axis by `helix` per length; or
    it is that of `offsets` in every cell.
    """

    name: Annotated[str, Reader.name]
    base: XY  # [m] at the base
    end: XY  # [m] where it ends
    section: str
    group: Annotated[str | None, Reader.name] = None
    drum: Annotated[str | None, Reader.name] = None  # of its wire, where it winds several
    winding: int = 1  # or -1: the wire is paid out while the drum is turned
    helix: float = 0.0  # [rad/m], from x to y
    offsets: tuple[XY, ...] = ()  # (cells of the tendon, 2) [m] at mid-cell


@dataclass(frozen=True)
class Robot(TextResult):
    """A validated robot description; every field in SI units."""

    name: str
    sections: tuple[Section, ...]
    tendons: tuple[Tendon, ...]
    tension_limits: tuple[float, float]  # [N], of every input
    effects: dict[str, EffectValues] = field(default_factory=dict)
    gravity: tuple[float, float, float] | None = None  # [m/s²], base frame, points down
    tolerances: dict[str, float] = field(default_factory=dict)  # 1 sd
    fitted: dict[str, Any] = field(default_factory=dict)  # effect -> source of its values
    exact: bool = False  # no scatter but that of `tolerances`
    model_error: float | None = None  # [m] rms at the tip of what no effect explains, if known
    source: str = 'robot'

    def __repr__(self) -> str:
        """Summarise the arm: name, length, sections, tendons."""
        sections = ', '.join(f'{s.name} of {s.cells} cells' for s in self.sections)
        return (
            f'<Robot {self.name}: {1e3 * self.length:.4g} mm; sections: {sections}; '
            f'{len(self.tendons)} tendons, inputs {", ".join(self.inputs)}; '
            f'effects: {", ".join(self.effects) or "none (PCCA)"}>'
        )

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names that can be commanded, in file order: a group once, else the tendon."""
        return tuple(dict.fromkeys(tendon.group or tendon.name for tendon in self.tendons))

    @cached_property
    def input_tendons(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the tendons that each input pulls."""
        return tuple(
            tuple(k for k, t in enumerate(self.tendons) if (t.group or t.name) == name)
            for name in self.inputs
        )

    @cached_property
    def drums(self) -> dict[str, dict[str, int]]:
        """Drums, the inputs whose wires they wind, and in which direction (1 or -1)."""
        drums: dict[str, dict[str, int]] = {}
        for tendon in self.tendons:
            if tendon.drum is not None:
                drums.setdefault(tendon.drum, {})[tendon.name] = tendon.winding
        return drums

    def wound(self, pulls: Mapping[str, Any]) -> dict[str, Any]:
        """Return wire pulls [m] by input, those of a drum on each of its wires."""
        wires: dict[str, Any] = {}
        for name, pull in pulls.items():
            own = self.drums.get(name, {name: 1})
            wires |= {wire: winding * pull for wire, winding in own.items()}
        return wires

    @cached_property
    def own_sections(self) -> tuple[Section, ...]:
        """The sections that bend: all but a base plate."""
        return tuple(section for section in self.sections if not section.is_plate)

    @cached_property
    def plate_cells(self) -> int:
        """Cells of a base plate: people count from the first cell beyond it."""
        return self.cells - sum(section.cells for section in self.own_sections)

    @cached_property
    def cells(self) -> int:
        """Number of cells of all sections."""
        return sum(section.cells for section in self.sections)

    @cached_property
    def cell_names(self) -> tuple[str, ...]:
        """Names of all cells, from the base; the first of the arm is 'cell 1'."""
        return tuple(f'cell {i + 1 - self.plate_cells}' for i in range(self.cells))

    @cached_property
    def length(self) -> float:
        """Length of the straight backbone [m]."""
        return sum(section.cells * section.cell_length for section in self.sections)

    @cached_property
    def cell_lengths(self) -> Floats:
        """Length of every cell, (n,) [m]."""
        return np.repeat([s.cell_length for s in self.sections], [s.cells for s in self.sections])

    @cached_property
    def tendon_cells(self) -> tuple[int, ...]:
        """Number of cells that each tendon runs through."""
        total, end = 0, {}
        for section in self.sections:
            total += section.cells
            end[section.name] = total
        return tuple(end[tendon.section] for tendon in self.tendons)

    def with_effect(self, name: str, values: EffectValues, fitted: Any = None) -> Robot:
        """Return a copy with an effect added or replaced."""
        origin = {key: value for key, value in self.fitted.items() if key != name}
        if fitted is not None:
            origin[name] = fitted
        return replace(self, effects={**self.effects, name: dict(values)}, fitted=origin)

    def without_effect(self, name: str) -> Robot:
        """
        Return a copy without an effect.

        Raises
        ------
        InputError
            The description does not list that effect.

        """
        if name not in self.effects:
            listed = ', '.join(self.effects) or 'none'
            raise InputError(f'{self.source}: effects: no {name!r} to remove; listed: {listed}')
        keep = {key: value for key, value in self.effects.items() if key != name}
        origin = {key: value for key, value in self.fitted.items() if key != name}
        return replace(self, effects=keep, fitted=origin)


# [1] characters of a description, so that a file of something else is refused at once
DESCRIPTION_MAX = 1_000_000


def parse_robot(text: str, source: str = 'robot') -> Robot:
    """Read a robot description from YAML text; `source` names it in messages."""
    if len(text) > DESCRIPTION_MAX:
        expected = f'at most {DESCRIPTION_MAX:,} characters'
        raise RobotDescriptionError(source, 'file', expected, 'more than that')
    content = parse_yaml(
        text, lambda reason: RobotDescriptionError(source, 'file', 'valid YAML', reason)
    )
    if content is None:
        expected = 'a robot description (`robot new` writes one)'
        raise RobotDescriptionError(source, 'file', expected, 'an empty file')
    return check_robot(Reader(source, '', content))


def check_robot(top: Reader) -> Robot:
    """Return the robot of a description; RobotDescriptionError where it is not valid."""
    top.only(*(key.name for key in fields(Robot) if key.name != 'source'))
    sections = tuple(item.read(Section) for item in top.items('sections'))
    top.unique('sections', [section.name for section in sections])
    tendons = tuple(_tendon(item, sections) for item in top.items('tendons'))
    top.unique('tendons', [tendon.name for tendon in tendons])
    groups = {tendon.group for tendon in tendons if tendon.group}
    names = groups | {tendon.name for tendon in tendons}
    for tendon in tendons:
        if tendon.name in groups:
            raise top.error('tendons', 'group names that are not tendon names', tendon.name)
        if tendon.drum in names:
            raise top.error('tendons', 'drums with names of their own', tendon.drum)
    effects: dict[str, EffectValues] = {}
    for name in top.child('effects').content:
        effect = top.child('effects').child(str(name))
        effects[str(name)] = {str(key): effect.numbers(str(key)) for key in effect.content}
    tolerances = top.child('tolerances')
    tolerances.only(*TOLERANCES)
    return Robot(
        name=top.name('name'),
        sections=sections,
        tendons=tendons,
        tension_limits=top.limits('tension_limits'),
        effects=effects,
        gravity=top.vector('gravity', 3) if top.has('gravity') else None,
        tolerances={key: tolerances.number(key, 0.0, 1.0) for key in tolerances.content},
        fitted=dict(top.child('fitted').content),
        exact=top.flag('exact'),
        model_error=top.length('model_error') if top.has('model_error') else None,
        source=top.source,
    )


def _tendon(item: Reader, sections: tuple[Section, ...]) -> Tendon:
    item.only('name', 'offset', 'section', 'group', 'drum', 'winding')
    if item.has('winding') and not item.has('drum'):
        raise item.error('winding', 'the drum that winds the wire, too', item.content['winding'])
    if item.has('drum') and item.has('group'):
        raise item.error('drum', 'a drum or a group, not both', item.content['drum'])
    winding = item.whole('winding', -1, 1, 1)
    if winding == 0:
        raise item.error('winding', '1, or -1 for a wire that is wound the other way', winding)
    names = tuple(section.name for section in sections)
    ending = item.choice('section', names)
    route = _route(item, sections[: names.index(ending) + 1])
    return Tendon(section=ending, winding=winding, **item.fields(Tendon), **route)


def _route(item: Reader, sections: tuple[Section, ...]) -> dict[str, Any]:
    """Return the fields of a tendon that say where it runs through the sections."""
    if not isinstance(item.content.get('offset'), dict):
        at = item.offset('offset')
        return {'base': at, 'end': at}
    route = item.child('offset')
    route.only('base', 'end', 'helix', 'cells')
    if route.has('cells'):
        if other := [key for key in ('base', 'end', 'helix') if route.has(key)]:
            raise route.error(other[0], 'nothing beside cells, which say it all', other[0])
        offsets = route.offsets('cells', sum(section.cells for section in sections))
        return {'base': offsets[0], 'end': offsets[-1], 'offsets': offsets}
    base = route.offset('base')
    end = route.offset('end') if route.has('end') or not route.has('helix') else base
    # a quarter of a turn in one cell at most, because a tendon is straight within a cell
    helix_max = 0.5 * math.pi / max(section.cell_length for section in sections)
    helix = route.number('helix', -helix_max, helix_max, 'rad/m', 0.0)
    return {'base': base, 'end': end, 'helix': helix}


def tendon_offsets(robot: Robot) -> Floats:
    """Return the offset of every tendon at mid-cell, (n, k, 2) [m], zero beyond its end."""
    lengths = np.array(robot.cell_lengths)
    offset = _offsets_at(robot, np.cumsum(lengths) - 0.5 * lengths)
    for k, (tendon, cells) in enumerate(zip(robot.tendons, robot.tendon_cells, strict=True)):
        if tendon.offsets:
            offset[:cells, k] = tendon.offsets
        offset[cells:, k] = 0.0
    return offset


def planar_axis(robot: Robot) -> int | None:
    """Axis (0: x, 1: y) towards which an arm bends whose tendons all lie in one plane."""
    flat = np.abs(tendon_offsets(robot)).max(axis=(0, 1)) < 1e-6
    return 0 if flat[1] else 1 if flat[0] else None


def helix_angles(robot: Robot) -> Floats:
    """Return the angle by which every tendon winds about the axis in every cell, (n, k) [rad]."""
    lengths = np.array(robot.cell_lengths)
    ends = np.cumsum(lengths)
    angles = _turns(*(_offsets_at(robot, at) for at in (ends - lengths, ends)))
    for k, (tendon, cells) in enumerate(zip(robot.tendons, robot.tendon_cells, strict=True)):
        if tendon.offsets:
            at = np.array(tendon.offsets)
            angle = np.append(0.0, np.cumsum(_turns(at[:-1], at[1:])))
            middles = (ends - 0.5 * lengths)[:cells]
            rate = np.gradient(angle, middles) if cells > 1 else 0.0
            angles[:cells, k] = rate * lengths[:cells]
        angles[cells:, k] = 0.0
    return np.where(np.abs(angles) < 1e-12, 0.0, angles)  # rounding errors


def _turns(start: Floats, end: Floats) -> Floats:
    """Return the angles (...) [rad] by which lines between offsets (..., 2) [m] wind."""
    (x0, y0), (x1, y1) = np.moveaxis(start, -1, 0), np.moveaxis(end, -1, 0)
    middle = 0.25 * ((x0 + x1) ** 2 + (y0 + y1) ** 2)
    return np.asarray(2.0 * np.arctan2(x0 * y1 - y0 * x1, 2.0 * middle))


def _offsets_at(robot: Robot, arc_lengths: Floats) -> Floats:
    """Offsets (j, k, 2) [m] of tendons at arc lengths (j,): lines that turn by their helices."""
    base = np.array([tendon.base for tendon in robot.tendons])
    end = np.array([tendon.end for tendon in robot.tendons])
    helix = np.array([tendon.helix for tendon in robot.tendons])
    whole = np.cumsum(robot.cell_lengths)[np.array(robot.tendon_cells) - 1]
    at = arc_lengths[:, None]
    return turned_in_plane(base + (at / whole)[..., None] * (end - base), helix * at)
