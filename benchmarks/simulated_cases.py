"""Simulated robots with a hidden effect or cause, and what is true of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tendon_robot_ros.analysis.noise import Whitener, estimate_noise, input_slopes
from tendon_robot_ros.analysis.postures import default_postures
from tendon_robot_ros.analysis.predict import Predictor
from tendon_robot_ros.analysis.simulate import SimulatedNoise, simulate
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.plant import make_plant
from tendon_robot_ros.robot import Robot, load_robot

ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'
SHAPING = ('eyelet_wrap', 'straight_tendon', 'tendon_travel')
CAUSES = ('soft_cell', 'tether', 'posture_gain', 'posture_rotation', 'stiffness_gradient')
TWINS = (
    'backbone_stiffness',
    'section_stiffness',
    'tendon_stiffness',
    'transmission_loss',
    'moment_arm',
)  # scale the bends alike
NAMING = ('missing_effect', 'ambiguous', 'wrong_parameter', 'several')


@dataclass(frozen=True)
class Case:
    """One simulated data set to judge."""

    robot: str
    hidden: str
    size: float
    seed: int
    scatter: float
    declared: bool  # whether the description's tolerances name the scatter


def described(case: Case) -> Robot:
    """Return the owner's description of a case, with the tolerances that it declares."""
    robot = robot_of(case.robot, case.hidden)
    known = {'cell_stiffness': case.scatter} if case.declared else {}
    return replace(robot, tolerances={**robot.tolerances, **known})


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


def hidden_values(hidden: str, size: float, seed: int) -> dict[str, float]:
    """Return the true parameters: typical ones times size; forces and bends point anywhere."""
    if hidden in ('soft_cell',):
        return {'cell': float(4 + seed % 8), 'factor': 1.0 - 0.45 * size}
    if hidden in CAUSES or hidden == 'none':
        return {}
    effect = load_catalogue()[hidden]
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
    kind = 'displacement' if case.hidden == 'tendon_elongation' else 'tension'
    plant = make_plant(robot, hidden, scatter=case.scatter, seed=case.seed)
    count = 20 if path == 'sequence' else 12
    return [
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


def is_visible(case: Case, dataset, robot: Robot, values) -> bool:
    """Tell whether the hidden effect moves the markers clearly more than the noise does."""
    if case.hidden in (*CAUSES, 'none'):
        return case.hidden != 'none'
    catalogue = load_catalogue()
    before = Predictor(dataset, robot, catalogue)
    slopes = input_slopes(before, {})
    noise = estimate_noise(dataset, slopes)
    after = Predictor(
        dataset, robot.with_effect(case.hidden, true_values(robot, case, values)), catalogue
    )
    white = Whitener(dataset, noise, slopes).white(after.markers({}) - before.markers({}))
    return float(white @ white) > 30.0


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
    cases, scatter = [], (options.scatter, options.declare)
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
