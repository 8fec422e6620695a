"""What each effect of the catalogue does to the shapes of a planar arm: the pages of effects."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.pulls import pull_shapes
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.workspace.postures import default_postures

ROOT = Path(__file__).resolve().parents[1]
UP = (0.0, 0.0, -9.81)  # [m/s²] the arm stands: the weight points to its base
ROBOT = replace(load_robot(ROOT / 'config/robots/kato_10_1.yaml'), gravity=UP)
CATALOGUE = load_catalogue().sized(natural_sizes(ROBOT))

# Sizes that one sees, SI units, where the typical one is too small or too large.
OWN_SIZES = {
    'tendon_friction': {'friction_coefficient': 0.33},
    'eyelet_wrap': {'fraction': 1.0},
    'tendon_travel': {'fraction': 1.0},
    'friction_memory': {'presliding_length': 2e-4, 'exponent': 1.0},
    'straight_tendon': {'fraction': 1.0},
    'eyelet_clearance': {'clearance': 3e-4},
    'hinge_friction': {'lever': 4e-4},
    'bending_hysteresis': {'lag': 0.02, 'presliding': 1.0},
    'backbone_stiffness': {'relative_change': 0.15},
    'section_stiffness': {'relative_change': (0.3, -0.2)},
    'tendon_stiffness': {'per_tendon': 2e-3},
    'nonlinear_stiffness': {'cubic': 40.0},
    'pre_curvature': {'angle_x': 0.01, 'angle_y': 0.0},
    'torsion': {'compliance': 2.0},
    'gravity': {'linear_density': 0.006},
    'tip_load': {'force_x': 0.003, 'force_y': 0.0, 'force_z': 0.0},
    'point_load': {'arc_length': 0.1, 'force_x': 0.006},
    'tether': {'arc_length': 0.15, 'point_x': 0.1, 'point_z': 0.15, 'tension': 3e-3},
    'contact': {'stiffness': 2.0, 'distance': 0.02, 'azimuth': np.pi},
    'axial_compression': {'compliance': 0.03},
    'transmission_loss': {'fraction': 0.15},
    'tension_offset': {'offset': 0.1},
    'moment_arm': {'relative_change': 0.15},
    'tendon_elongation': {'compliance': 0.02},
    'wire_spring': {'compliance': 4e-3},
    'backlash': {'width': 2e-3},
    'pull_zero': {'offset': 1e-3},
    'spool_gain': {'relative_change': 0.1},
    'base_misalignment': {
        'shift_x': 5e-3, 'shift_y': 0.0, 'shift_z': 0.0,
        'rotation_x': 0.0, 'rotation_y': 0.08, 'rotation_z': 0.0,
    },
}  # fmt: skip


def size_of(effect):
    """Return the values at which an effect is drawn: its first parameter, if not its own."""
    first, own = effect.parameters[0].name, OWN_SIZES.get(effect.name, {})
    usual = {p.name: p.typical if p.name == first else p.neutral for p in effect.parameters}
    return usual | own


SIZES = {effect.name: size_of(effect) for effect in CATALOGUE}
# An arm along which nothing twists does not show torsion: a force across the plane of its
# tendons, and no friction, whose sign across the bend would turn with the last digit.
ACROSS = ROBOT.without_effect('tendon_friction').with_effect(
    'tip_load', {'force_x': 0.0, 'force_y': 0.02, 'force_z': 0.0}
)

# prox_left, prox_right, dist_left, dist_right [N]
POSTURES = {
    'at rest': (0.1, 0.1, 0.1, 0.1),
    'one tendon': (0.1, 0.1, 0.1, 0.55),
    'the other side': (0.1, 0.1, 0.55, 0.1),
    'squeezed': (0.1, 0.1, 0.9, 1.6),
    'S-shape': (1.4, 0.1, 0.1, 0.55),
    'let go': (0.1, 0.1, 0.1, 0.35),
}
LOADED = (0.1, 0.1, 0.1, 0.8)  # [N] from where 'let go' comes


@dataclass(frozen=True)
class Drawn:
    """Positions (n + 1, 3) [m] of a posture without and with an effect."""

    posture: str
    without: np.ndarray
    with_it: np.ndarray

    @property
    def tip(self):
        """How far the tip moves [m]."""
        return float(np.linalg.norm(self.with_it[-1] - self.without[-1]))


def robots(name):
    """
    Return the arm without and with an effect; tendon friction is in both but for itself.

    Stiff wires that are wound more than commanded find no equilibrium: theirs end in springs.
    """
    base = ROBOT.without_effect(name) if name in ROBOT.effects else ROBOT
    if name in ('backlash', 'pull_zero', 'spool_gain'):
        base = base.with_effect('wire_spring', SIZES['wire_spring'])
    if CATALOGUE[name].stage == 'torsion':
        base = ACROSS
    return base, base.with_effect(name, SIZES[name])


def by_pulls(name):
    """Tell whether an effect shows under wire pulls only."""
    return 'pulls' in CATALOGUE[name].needs


def positions(model, posture, tensions, pulls=None):
    """Return positions (n, 3) [m] as a tracker sees them."""
    if pulls is not None:
        shape = model.pull_shape(pulls)
    elif posture == 'let go':
        return model.measured(model.sequence([LOADED, tensions]).positions[1])
    else:
        shape = model.shape(tensions)
    return model.measured(shape.positions)


def drawn(name):
    """
    Return the postures with and without an effect, the most affected one first.

    An effect that shows under wire pulls is drawn at those that the wires have without it;
    postures whose wires cannot have these lengths together are left out.
    """
    without, with_it = (Model(robot, CATALOGUE) for robot in robots(name))
    found = []
    for posture, tensions in POSTURES.items():
        pulls = None
        if by_pulls(name):
            given = without.shape(tensions).pulls
            pulls = [p if t > 0.1 else None for p, t in zip(given, tensions, strict=True)]
        try:
            points = [
                np.vstack(
                    [model.measured(np.zeros((1, 3))), positions(model, posture, tensions, pulls)]
                )
                for model in (without, with_it)
            ]
        except InputError:
            continue
        found.append(Drawn(posture, *points))
    return sorted(found, key=lambda one: -round(one.tip, 6))


SMALL = 0.1  # of the drawn or the typical size: effects are compared where they begin
ALONE = tuple(
    tuple(level if j == k else 0.1 for j in range(4))
    for k in range(4)
    for level in (0.2, 0.4, 0.6)
)  # [N]
SETS = {'one tendon at a time': ALONE, 'twelve mixed postures': default_postures(ROBOT, 12)}


def look_alikes(name, tensions, least=0.75):
    """
    Return {effect: share} of the effects that alone can do much of what one effect does.

    The share is 1 - |what is left| / |what the effect moves|, over all cells of all postures.
    """
    base = robots(name)[0]
    rows = np.array(tensions)
    if by_pulls(name):
        taut = rows > 0.1
        rows = np.where(taut, Model(base, CATALOGUE).shapes(rows).pulls, np.nan)
    at_rest = moved(name, base, rows)

    def change(effect, values):
        return (moved(name, base.with_effect(effect, values), rows) - at_rest).ravel()

    aim = change(name, small(name, SIZES[name], base))
    found = {}
    for other in CATALOGUE:
        if other.name == name or (by_pulls(other.name) and not by_pulls(name)):
            continue
        try:
            columns = [change(other.name, values) for values in single_steps(other, base)]
        except InputError:  # taut stiff wires cannot be wound any further
            continue
        one_sided = len(columns) == 1 and other.parameters[0].low == other.parameters[0].neutral
        one_sided = one_sided and other.name not in base.effects
        found[other.name] = imitated(aim, np.array(columns).T, one_sided)
    best = sorted(found.items(), key=lambda item: -round(item[1], 2))  # twins in catalogue order
    return {other: share for other, share in best if share >= least}


def moved(name, robot, rows):
    """Return all positions (p, n, 3) [m]; postures follow each other where the arm remembers."""
    model, one_after_the_other = Model(robot, CATALOGUE), 'history' in CATALOGUE[name].needs
    if by_pulls(name):
        past = model.arrays.fresh_memory() if one_after_the_other else None
        return model.measured(pull_shapes(model, rows, memory=past).positions)
    batch = model.sequence(rows) if one_after_the_other else model.shapes(rows)
    return model.measured(batch.positions)


def small(name, values, base):
    """Scale parameters towards what the base has, or their neutral values."""
    return {key: scaled(CATALOGUE[name], key, value, base) for key, value in values.items()}


def scaled(effect, key, value, base):
    """Return a small step of one parameter from where the base has it."""
    defaults = {parameter.name for parameter in effect.parameters if parameter.has_default}
    if effect.stage == 'memory' or key in defaults:
        return value
    at = np.array(base.effects.get(effect.name, {}).get(key, 0.0))
    step = at + SMALL * np.array(value)
    return tuple(step.tolist()) if step.ndim else float(step)


def single_steps(effect, base):
    """Yield small values of an effect, one parameter (of one section) off at a time."""
    parameters = [parameter for parameter in effect.parameters if not parameter.has_default]
    for parameter in parameters:
        for part in np.eye(len(base.sections)) if parameter.per_section else [np.array(1.0)]:
            yield {
                other.name: scaled(
                    effect,
                    other.name,
                    part * other.typical if other is parameter else 0.0 * part,
                    base,
                )
                for other in parameters
            }


def imitated(aim, columns, one_sided):
    """Return the share of a change (3pn,) that columns (3pn, q) reproduce, as rms."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 1e-9] / size[size > 1e-9]
    if not columns.size:
        return 0.0
    weights = np.linalg.lstsq(columns, aim, rcond=None)[0]
    if one_sided:
        weights = np.maximum(weights, 0.0)
    return float(1.0 - np.linalg.norm(aim - columns @ weights) / np.linalg.norm(aim))
