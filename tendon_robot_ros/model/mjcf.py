"""
A robot as MJCF, for MuJoCo: a body per cell, hinge joints that are springs, and its tendons.

What an effect of the description does to stiffness, rest bends, offsets, weight and tensions is in
the numbers of the file, since its own law is asked; what MuJoCo cannot say stands in its head.

A cell that bends as a hinge is two hinge joints in its middle. The order of their axes changes
from cell to cell, because two hinges in one order twist a little, always to the same side; a ball
joint would also twist under loads. An arc is one such pair, too, since its chord is only 0.6 %
longer where it bends by 15 degrees; where a section has few cells, each is divided into several
pairs. Where `straight_tendon` acts, a tendon is a spatial one through a site at either end of
every cell. Otherwise the path that it loses is its offset times the bend, which no sites say and a
fixed tendon, linear in the joints, says exactly.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from ..common.arrays import RESOLUTION
from ..common.rotations import turned_in_plane
from ..common.words import PROGRAM
from ..effects.effect import Effect
from .model import Model
from .shape import Shape

HINGES_MIN = 12  # [1] of a section of arcs, so that each bends by 15° where all bend by 180°
STEP_S = 1e-3  # [s] of the simulation, because arms in MuJoCo usually have it
# [1] least periods of the fastest spring in 2 pi steps, because explicit springs diverge at a half
STEPS_PER_PERIOD = 4.0
DENSITY = 0.1  # [kg/m] where a description has no weight, because MuJoCo needs a mass to move
INERTIA_MIN = 1e-9  # [kg·m²] of a body, because MuJoCo refuses none
# stages whose effects are in the numbers of the file
SAID = ('actuation', 'offset_scale', 'stiffness', 'rest', 'load', 'tip_load', 'torsion')
# stages that are no property of the arm under tensions
BESIDE_THE_ARM = ('stretch', 'transmission', 'winding', 'measurement')
Xml = ElementTree.Element


@dataclass(frozen=True)
class Hinge:
    """A pair of hinge joints: a cell, or a part of an arc."""

    cell: int
    part: int  # of its cell
    parts: int
    before: float  # [m] from the hinge before, or the base
    after: float  # [m] to the end of its part
    stiffness: float  # [N·m/rad]
    rest: tuple[float, float]  # [rad]
    twisting: float  # [N·m/rad] stiffness against twist; 0: none
    mass: float  # [kg]
    beside: tuple[float, float]  # [m] of the mass from the axis


class Laws:
    """The laws of the effects that act, for single cells and tendons."""

    def __init__(self, model: Model) -> None:
        """Keep the effects that act, in the order of the catalogue."""
        self.arrays, self.robot = model.arrays, model.robot
        index = self.arrays.layout.index
        self.acting = [e for e in self.arrays.catalogue if self.arrays.on[index[e.name]]]

    def __call__(
        self,
        stage: str,
        state: Sequence[float],
        *context: float,
        section: int = 0,
        tendon: int = 0,
    ) -> tuple[float, ...]:
        """Return the quantities of a stage after all its laws."""
        for effect in (e for e in self.acting if e.stage == stage):
            places = {'section': section, 'tendon': tendon, '': 0}
            values = [
                self.arrays.get(effect.name, p.name, places[p.per]) for p in effect.parameters
            ]
            given = effect.law(*state, *context, *values)
            state = given if isinstance(given, tuple) else (given,)
        return tuple(float(value) for value in state)

    def gain(self, tendon: int) -> tuple[float, float, bool]:
        """Return gain and offset [N] of a tension before the base, and whether that is all."""
        low, high = self.robot.tension_limits
        ends = [max(low, 0.01 * high), 0.5 * (low + high), high]
        first, middle, last = (self('actuation', (t,), tendon=tendon)[0] for t in ends)
        gain = (last - first) / (ends[2] - ends[0])
        offset = last - gain * ends[2]
        return gain, offset, abs(offset + gain * ends[1] - middle) < RESOLUTION

    @property
    def straight(self) -> bool:
        """Whether tendons run straight from eyelet to eyelet."""
        return self.path_blend > 0.5

    @property
    def path_blend(self) -> float:
        """The share of the chord between eyelets in a path; the rest is offset times bend."""
        bend, length, radial = 0.1, 1.0, 0.1  # of any cell: the path lost by the chord is known
        chord = length * (1.0 - math.cos(0.5 * bend)) + 2.0 * radial * math.sin(0.5 * bend)
        state, half = (radial * bend, radial, 1.0), (math.sin(0.5 * bend), math.cos(0.5 * bend))
        lost = self('tendon_path', state, bend, *half, radial, length, 1.0)[0]
        return (lost - radial * bend) / (chord - radial * bend)


def hinges(model: Model, laws: Laws) -> Iterator[Hinge]:
    """Yield the pairs of hinges from the base to the tip."""
    robot, before = model.robot, 0.0
    heavy = any(e.stage == 'load' for e in laws.acting)
    # a mass is the same wherever down is
    gravity = robot.gravity if robot.gravity and any(robot.gravity) else (0.0, 0.0, -1.0)
    sections = np.repeat(np.arange(len(robot.sections)), [s.cells for s in robot.sections])
    for i, (row, section) in enumerate(zip(model.arrays.cells, sections.tolist(), strict=True)):
        length, stiffness, mass_length, is_hinge, tendons, *beside = row.tolist()
        (stiffness,) = laws('stiffness', (stiffness,), tendons, section=section)
        rest = laws('rest', (0.0, 0.0), section=section)
        (twist,) = laws('torsion', (0.0,), 1.0, stiffness, section=section)
        mass = DENSITY * length
        if heavy:
            force = laws('load', (0.0, 0.0, 0.0), mass_length, *gravity, section=section)
            mass = math.hypot(*force) / math.hypot(*gravity)
        parts = 1 if is_hinge else math.ceil(HINGES_MIN / robot.sections[section].cells)
        half = 0.5 * length / parts
        for part in range(parts):
            yield Hinge(
                cell=i,
                part=part,
                parts=parts,
                before=before + half,
                after=half,
                stiffness=stiffness * parts,
                rest=(rest[0] / parts, rest[1] / parts),
                twisting=parts / twist if twist else 0.0,
                mass=mass / parts,
                beside=(beside[0], beside[1]),
            )
            before = half


def mjcf(model: Model) -> str:
    """
    Return the robot as MJCF: lengths in m, tensions in N.

    Actuators are named after the tendons, and their controls are tensions. Sites `cell 1` and so
    on lie at the ends of the cells. The keyframe `rest` is the arm without tension.
    """
    laws, robot = Laws(model), model.robot
    root = ElementTree.Element('mujoco', model=robot.name)
    _add(root, 'compiler', angle='radian', inertiafromgeom='false')
    down = robot.gravity if any(e.stage == 'load' for e in laws.acting) else None
    still = (0.0, 0.0, 0.0)
    _add(root, 'option', timestep=STEP_S, integrator='implicitfast', gravity=down or still)
    body = _add(_add(root, 'worldbody'), 'body', name='base')
    _site(body, 'base', (0.0, 0.0, 0.0))
    kind = 'spatial' if laws.straight else 'fixed'
    routes = [ElementTree.Element(kind, name=tendon.name) for tendon in robot.tendons]
    bends, rested = model.shape(np.zeros(len(robot.inputs))), []
    chain = list(hinges(model, laws))
    # over stiffness [s], with which the arm as a whole just does not swing
    heights = np.cumsum([hinge.before for hinge in chain])
    inertia = float(np.sum(np.array([hinge.mass for hinge in chain]) * heights**2))
    damping = 2.0 * math.sqrt(inertia * sum(1.0 / hinge.stiffness for hinge in chain))
    for number, hinge in enumerate(chain):
        body, angles = _add_hinge(body, number, hinge, damping, laws, routes, bends)
        rested += angles
    _site(body, 'tip', (0.0, 0.0, chain[-1].after))
    _add(root, 'tendon').extend(routes)
    actuators = _add(root, 'actuator')
    for k, tendon in enumerate(robot.tendons):
        gain, offset, _ = laws.gain(k)
        _add(
            actuators, 'general', name=tendon.name, tendon=tendon.name, gear=-1, gainprm=gain,
            biastype='affine', biasprm=offset, ctrlrange=(0.0, robot.tension_limits[1]),
        )  # fmt: skip
    wrench = laws('tip_load', (0.0,) * 6)
    if any(wrench):
        _add(
            actuators, 'general', name='tip_load', site='tip', refsite='base', biastype='affine',
            gear=wrench, gainprm=0, biasprm=1,
        )  # fmt: skip
    keyframe = _add(root, 'keyframe')
    _add(keyframe, 'key', name='rest', qpos=rested)
    ElementTree.indent(root)
    return f'{_head(model, laws)}\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_hinge(
    parent: Xml,
    number: int,
    hinge: Hinge,
    damping: float,
    laws: Laws,
    routes: list[Xml],
    bends: Shape,
) -> tuple[Xml, list[float]]:
    """Add the body beyond a hinge with its joints and sites; return it and its angles at rest."""
    robot, (bend_x, bend_y) = laws.robot, bends.bend[hinge.cell].tolist()
    body = _add(parent, 'body', name=f'body_{number + 1}', pos=(0.0, 0.0, hinge.before))
    inertia = max(hinge.mass * (2.0 * hinge.after) ** 2 / 12.0, INERTIA_MIN)
    beside = (*hinge.beside, 0.0)
    _add(body, 'inertial', pos=beside, mass=hinge.mass, diaginertia=[inertia] * 3)
    axes = [
        ('x', '0 1 0', hinge.stiffness, hinge.rest[0], bend_x),
        ('y', '-1 0 0', hinge.stiffness, hinge.rest[1], bend_y),
    ][:: 1 if number % 2 == 0 else -1]
    if hinge.twisting:
        axes.append(('z', '0 0 1', hinge.twisting, 0.0, float(bends.twist[hinge.cell])))
    for name, axis, stiffness, rest, _ in axes:
        _add(
            body, 'joint', name=f'joint_{number + 1}_{name}', axis=axis, springref=rest,
            stiffness=stiffness, damping=damping * stiffness,
            armature=stiffness * (STEPS_PER_PERIOD * STEP_S) ** 2 / 4.0,
        )  # fmt: skip
    radius = 0.6 * float(np.linalg.norm(laws.arrays.offset, axis=2).max())
    _add(
        body, 'geom', type='capsule', size=f'{radius:.6g}', contype='0', conaffinity='0',
        fromto=(0.0, 0.0, 0.0, 0.0, 0.0, hinge.after),
    )  # fmt: skip
    (scale,) = laws('offset_scale', (1.0,))
    for k, tendon in enumerate(robot.tendons):
        if hinge.cell >= robot.tendon_cells[k]:
            continue
        offset = scale * laws.arrays.offset[hinge.cell, k]
        if not laws.straight:
            for name, arm in zip('xy', offset.tolist(), strict=True):
                joint = f'joint_{number + 1}_{name}'
                _add(routes[k], 'joint', joint=joint, coef=-arm)
            continue
        winds = 0.5 * float(laws.arrays.helix[hinge.cell, k])
        ends = (parent, hinge.before - hinge.after, -winds), (body, hinge.after, winds)
        for (where, up, turn), wanted in zip(
            ends, (hinge.part == 0, hinge.part == hinge.parts - 1), strict=True
        ):
            if wanted:
                at = turned_in_plane(offset, np.array(turn))
                site = f'{tendon.name} {number + 1}{"+" if where is body else "-"}'
                _site(where, site, (*at, up))
                _add(routes[k], 'site', site=site)
    if hinge.part == hinge.parts - 1:
        _site(body, robot.cell_names[hinge.cell], (0.0, 0.0, hinge.after))
    return body, [angle / hinge.parts for *_, angle in axes]


def _head(model: Model, laws: Laws) -> str:
    """Return the comment at the file's head: how it was made, and what it does not say."""
    robot = model.robot
    lines = [f'{robot.name}, written by {PROGRAM} export mjcf; lengths in m, tensions in N.']
    lines += ['Masses are made up: the description has no weight.'] * (
        not any(e.stage == 'load' for e in laws.acting)
    )
    lines.append('Damping and armature of the joints are made up: they let the arm come to rest.')
    for name, members in zip(robot.inputs, robot.input_tendons, strict=True):
        if len(members) > 1:
            names = ', '.join(robot.tendons[k].name for k in members)
            lines.append(f'Input {name} pulls several tendons with its tension each: {names}.')
    missing = [f'  {effect.name}: {effect.title}' for effect in unsaid(laws)]
    if missing:
        lines += ['Not in this file, because MuJoCo cannot say it:', *missing]
    beside = [f'  {e.name}: {e.title}' for e in laws.acting if e.stage in BESIDE_THE_ARM]
    if beside:
        lines += ['Not in this file, because it is about wires or tracker:', *beside]
    return '<!--\n' + re.sub('-(?=-)', '- ', '\n'.join(lines)) + '\n-->'


def unsaid(laws: Laws) -> list[Effect]:
    """Return the effects that shape the arm and that the file leaves out, in whole or in part."""
    count = len(laws.robot.tendons)
    said = set(SAID)
    if not all(laws.gain(k)[2] for k in range(count)):
        said.discard('actuation')
    if laws.path_blend > 1.0 - 1e-6:
        said.add('tendon_path')
    return [e for e in laws.acting if e.stage not in said | {*BESIDE_THE_ARM}]


def _add(parent: Xml, tag: str, **attributes: str | float | Sequence[float]) -> Xml:
    """Add an element whose attributes are words, or numbers that MJCF reads."""
    element = ElementTree.SubElement(parent, tag)
    for key, value in attributes.items():
        numbers = [] if isinstance(value, str) else np.atleast_1d(value).tolist()
        element.set(key, ' '.join(f'{number:.9g}' for number in numbers) or str(value))
    return element


def _site(body: Xml, name: str, place: Sequence[float]) -> None:
    _add(body, 'site', name=name, pos=place, size=0.0005)
