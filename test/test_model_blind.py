"""
The model against an independent engine's measurements, with the true effect in place.

The engine is a rigid-body simulation that shares no code with this package. What remains must be
noise: of the markers, and of the tensions that were set.
"""

from dataclasses import replace

import numpy as np
import pytest
from measurements import LETTERS, blind, truth

from tendon_robot_ros.data import load_dataset
from tendon_robot_ros.model.model import Model

IN_THE_CATALOGUE = [c for c in LETTERS if truth(c)['hidden'] not in ('tether', 'soft_cell')]


def hidden(letter):
    """Return the hidden effect with its parameters; {} for none."""
    told = truth(letter)
    names = {'wrong_stiffness': 'backbone_stiffness', 'none': None}
    name = names.get(told['hidden'], told['hidden'])
    return {name: told['parameters']} if name else {}


def shapes(model, dataset, inputs):
    return model.sequence(inputs) if dataset.path == 'sequence' else model.shapes(inputs)


def rms(model, dataset):
    """Of the distance between model and trial mean, over postures and markers [m]."""
    placed = shapes(model, dataset, dataset.inputs).markers(dataset.arc_lengths, dataset.offsets)
    return np.sqrt((np.linalg.norm(placed - dataset.mean, axis=2) ** 2).mean())


def floor(model, dataset):
    """Return the expectation of `rms` for a perfect model [m]."""
    trials = dataset.trials[:, None]
    relative = np.sqrt(dataset.setting_noise**2 + dataset.trial_noise**2 / trials)
    total = 3.0 * dataset.position_noise**2 / trials
    for j in range(dataset.inputs.shape[1]):
        step = np.zeros_like(dataset.inputs)
        step[:, j] = (relative * dataset.inputs)[:, j]
        up, down = (
            shapes(model, dataset, dataset.inputs + sign * step).positions for sign in (1, -1)
        )
        total = total + (np.linalg.norm(up - down, axis=2) ** 2 / 4.0)
    return np.sqrt(total.mean())


def described(letter, part, effects):
    """Return the measurements of a case, and the model of its arm with more effects."""
    dataset = load_dataset(blind(letter) / part)
    robot = replace(dataset.robot, gravity=dataset.gravity_for(dataset.robot))
    return dataset, Model(replace(robot, effects=robot.effects | effects))


@pytest.mark.parametrize('part', ['fit', 'check'])
@pytest.mark.parametrize('letter', IN_THE_CATALOGUE)
def test_with_the_true_effect_the_model_is_off_by_the_noise(letter, part):
    dataset, model = described(letter, part, hidden(letter))
    error, noise = rms(model, dataset), floor(model, dataset)
    print(f'{letter} {part}: {1e3 * error:.3f} mm, noise {1e3 * noise:.3f} mm')
    assert 0.6 * noise < error < (1.35 if hidden(letter) else 1.3) * noise


@pytest.mark.parametrize('part', ['fit', 'check'])
@pytest.mark.parametrize('letter', [c for c in IN_THE_CATALOGUE if c != 'a'])
def test_without_it_the_model_is_off_by_more(letter, part):
    dataset, model = described(letter, part, {})
    assert rms(model, dataset) > 2.0 * floor(model, dataset)
