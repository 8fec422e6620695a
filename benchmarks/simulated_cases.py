"""Simulated robots with a hidden effect or cause, and what is true of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tendon_robot_ros.comparison.noise import Whitener, estimate_noise, input_slopes
from tendon_robot_ros.comparison.predict import Predictor
from tendon_robot_ros.diagnosis.decide import Verdict
from tendon_robot_ros.diagnosis.marginal import RandomEffects
from tendon_robot_ros.diagnosis.slopes import imperfections
from tendon_robot_ros.diagnosis.split import SplitPredictor
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.robot import Robot, load_robot
from tendon_robot_ros.robot.size import natural_sizes
from tendon_robot_ros.simulation.imperfect import Workmanship
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'
CATALOGUE = load_catalogue()
SHAPING = ('eyelet_wrap', 'straight_tendon', 'tendon_travel')
CAUSES = ('soft_cell', 'tether', 'posture_gain', 'posture_rotation', 'stiffness_gradient')
TWINS = (
    'backbone_stiffness',
    'section_stiffness',
    'tendon_stiffness',
    'transmission_loss',
    'moment_arm',
)  # scale the bends alike
NAMING = tuple(verdict for verdict in Verdict if verdict.may_add)


@dataclass(frozen=True)
class Case:
    """One simulated data set to judge."""

    robot: str
    hidden: str
    size: float
    seed: int
    scatter: float
    declared: bool  # whether the description's tolerances name the scatter
    level: float = 0.0  # how badly the arm is built, undeclared; 1: as in a laboratory
    exact: bool = False  # whether the description says that the arm is exact


def described(case: Case) -> Robot:
    """Return the owner's description of a case, with the tolerances that it declares."""
    robot = robot_of(case.robot, case.hidden)
    known = {'cell_stiffness': case.scatter} if case.declared else {}
    return replace(robot, tolerances={**robot.tolerances, **known}, exact=case.exact)


def robot_of(name: str, hidden: str) -> Robot:
    """Return the owner's description: every shaping effect but the hidden one."""
    if name == 'hinged':
        robot = load_robot(ROBOTS / 'kato_10_1.yaml')
        sections = tuple(replace(section, bends_as='hinge') for section in robot.sections)
        robot = replace(robot, sections=sections, tension_limits=(0.0, 5.0))
        shaping = SHAPING
    else:
        robot = load_robot(ROBOTS / 'spatial_3.yaml')
        section = replace(robot.sections[0], bends_as='arc')
        robot = replace(robot, sections=(section,), tension_limits=(0.0, 8.0))
        shaping = ('eyelet_wrap', 'tendon_travel')
    effects = {key: value for key, value in robot.effects.items() if key == 'tendon_friction'}
    effects |= {key: {'fraction': 1.0} for key in shaping}
    effects.pop(hidden, None)
    gravity = (9.81, 0.0, 0.0) if hidden == 'gravity' else (0.0, 0.0, 0.0)
    return replace(robot, effects=effects, gravity=gravity)


def needs_pulls(hidden: str) -> bool:
    """Tell whether an effect shows under wire pulls only."""
    return hidden in CATALOGUE and CATALOGUE[hidden].needs == 'pulls'


def hidden_values(hidden: str, size: float, seed: int, robot: Robot) -> dict[str, float]:
    """Return the true parameters: typical ones times size; forces and bends point anywhere."""
    if hidden in ('soft_cell',):
        return {'cell': float(4 + seed % 8), 'factor': 1.0 - 0.45 * size}
    if hidden in CAUSES or hidden == 'none':
        return {}
    effect = CATALOGUE[hidden].sized(natural_sizes(robot))
    if hidden in SHAPING:
        return {'fraction': 1.0}
    if hidden == 'tendon_friction':
        return {'friction_coefficient': 0.3}
    random = np.random.default_rng([seed, 5])
    two_sided = [p for p in effect.parameters if p.low <= -p.typical]
    signs = {p.name: random.choice([-1.0, 1.0]) for p in two_sided}
    values = {p.name: p.typical * size * signs.get(p.name, 1.0) for p in effect.parameters}
    if hidden == 'section_stiffness':
        values = {'relative_change': [0.15 * size, -0.1 * size]}
    if hidden in ('tip_load', 'pre_curvature', 'base_misalignment'):
        values = {key: value * random.uniform(0.4, 1.0) for key, value in values.items()}
    if hidden == 'friction_memory':
        values = {'presliding_length': 1e-4 * random.uniform(0.5, 2.0)}
    return values


def measured(case: Case, robot: Robot, values):
    """Simulate the postures to diagnose and those to check on."""
    hidden = {} if case.hidden == 'none' else {case.hidden: values}
    path = 'sequence' if case.hidden == 'friction_memory' else 'from_straight'
    kind = 'displacement' if needs_pulls(case.hidden) else 'tension'
    work = Workmanship().times(case.level) if case.level else None
    plant = make_plant(robot, hidden, scatter=case.scatter, seed=case.seed, work=work)
    count = 20 if path == 'sequence' else 12
    sets = [
        simulate(
            plant,
            default_postures(robot, count, which, kind, path),
            input=kind,
            path=path,
            noise=SimulatedNoise(),
            seed=2 * case.seed + which,
        )
        for which in (0, 1)
    ]
    return [disturbed(one, case.seed) if case.level else one for one in sets], plant.built


def disturbed(dataset, seed: int):
    """Lose 3 % of the readings of the markers, and put 0.5 % of them off by 5 mm (1 sd)."""
    random = np.random.default_rng([seed, 19])
    positions = dataset.positions.copy()
    wild = random.random(positions.shape[:3]) < 0.005
    positions[wild] += random.normal(0.0, 5e-3, (int(wild.sum()), 3))
    positions[random.random(positions.shape[:3]) < 0.03] = np.nan
    return replace(dataset, positions=positions)


def is_visible(case: Case, dataset, robot: Robot, values) -> bool:
    """
    Tell whether the hidden effect stands out of the noise.

    On an arm as built: by what imperfections of that level cannot explain (information left).
    """
    if case.hidden in (*CAUSES, 'none'):
        return case.hidden != 'none'
    catalogue = load_catalogue()
    before = Predictor(dataset, robot, catalogue)
    slopes = input_slopes(before, {})
    noise = estimate_noise(dataset, slopes)
    after = Predictor(
        dataset, robot.with_effect(case.hidden, true_values(robot, case, values)), catalogue
    )
    whitener = Whitener(dataset, noise, slopes)
    white = whitener.white(after.markers({}) - before.markers({}))
    if case.exact:
        return float(white @ white) > 30.0
    found = imperfections(SplitPredictor(before), {})
    random = RandomEffects(whitener.white(found.moves).T, found.owners, found.kinds)
    sizes = case.level * np.where(np.isfinite(random.plausible), random.plausible, 0.0)
    left = random.lift(random.root(sizes), white)
    return float(left @ left) > 30.0


def true_values(robot: Robot, case: Case, values):
    """Spread values per section as the plant does."""
    effect = load_catalogue()[case.hidden]
    return {
        p.name: tuple(np.broadcast_to(values[p.name], len(robot.sections)).tolist())
        if p.per_section
        else values[p.name]
        for p in effect.parameters
    }


def cases_of(options) -> list[Case]:
    """List what to judge: sizes are drawn between a fifteenth and full."""
    cases, scatter = [], (options.scatter, options.declare, options.as_built, options.exact)
    effects = options.effects or list(load_catalogue().names) + list(CAUSES)
    for robot in ('hinged', 'arcs'):
        for effect in effects:
            if robot == 'arcs' and effect in ('straight_tendon', 'section_stiffness'):
                continue  # one section: the same as backbone_stiffness
            for seed in range(options.seeds):
                size = 15.0 ** -np.random.default_rng([seed, 9]).random()
                size = max(size, 0.5) if effect in CAUSES else size
                cases.append(Case(robot, effect, float(size), seed + 1, *scatter))
        cases += [
            Case(robot, 'none', 0.0, 1000 + seed, *scatter) for seed in range(options.clean // 2)
        ]
    return cases
