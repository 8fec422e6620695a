"""Data sets simulated from the model itself: same cells, same friction, only noise on top."""

from dataclasses import replace

import numpy as np
from arms import coarse
from source_tree import ROOT

from tendon_robot_ros.data import DataSet, default_markers
from tendon_robot_ros.diagnosis.trust import simulated_measurements
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.noise import Noise
from tendon_robot_ros.inference.predict import FreeParameter, Predictor
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.workspace.postures import default_postures

SHAPING = ('eyelet_wrap', 'straight_tendon', 'tendon_travel')
NOISE = Noise(position=2e-4, trial=0.004, setting=0.002, freedom=np.inf, source='declared')
CATALOGUE = load_catalogue()


def robot(name='kato_10_1_single', lacks=(), cells=None, **changes):
    """
    Return a shipped robot with friction and the shaping effects, except those it lacks.

    With `cells` every section has so many, as long and as soft together: what a fit of an arm as
    built costs grows with them.
    """
    found = load_robot(ROOT / 'config' / 'robots' / f'{name}.yaml')
    if cells is not None:
        found = coarse(found, cells)
    effects = dict(found.effects) | {effect: {'fraction': 1.0} for effect in SHAPING}
    effects = {name: values for name, values in effects.items() if name not in lacks}
    return replace(found, effects=effects, **{'gravity': (0.0, 0.0, 0.0)} | changes)


def postures(described, inputs, trials=5, noise=NOISE, **fields):
    """Return a data set without measurements."""
    markers = default_markers(described)
    empty = np.zeros((len(inputs), trials, len(markers), 3))
    return DataSet(
        name='simulated',
        robot=described,
        markers=markers,
        postures=tuple(str(p) for p in range(len(inputs))),
        inputs=np.asarray(inputs, dtype=float),
        positions=empty,
        position_noise=noise.position,
        setting_noise=noise.setting,
        trial_noise=noise.trial,
        gravity=described.gravity,
        **fields,
    )


def measure(dataset, hidden=None, noise=NOISE, seed=0, catalogue=CATALOGUE):
    """Return the data set as measured on a robot that hides {effect: {parameter: value}}."""
    predictor = Predictor(dataset, dataset.robot, catalogue)
    point = {}
    for effect, values in (hidden or {}).items():
        for parameter in catalogue[effect].parameters:
            value = values.get(parameter.name, parameter.neutral)
            if np.ndim(value):
                for i, section in enumerate(dataset.robot.sections):
                    point[FreeParameter(effect, parameter, i, section.name)] = float(value[i])
            else:
                point[FreeParameter(effect, parameter)] = float(value)
    made = simulated_measurements(predictor, point, noise, np.random.default_rng(seed))
    assert made is not None, 'the simulated robot has no equilibrium'
    return made


def measured(described, hidden=None, count=8, seed=0, path='from_straight', **options):
    """Return measurements of a robot in default postures."""
    kind = options.pop('input', 'tension')
    which = options.pop('which', 0)
    noise = options.pop('noise', NOISE)
    catalogue = options.pop('catalogue', CATALOGUE)
    inputs = default_postures(described, count, which, kind, path)
    dataset = postures(described, inputs, noise=noise, input=kind, path=path, **options)
    return measure(dataset, hidden, noise, seed, catalogue)
