"""Exact rods: how far the model is from them, and what a diagnosis of their shapes says."""

import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest
from marks import slow
from source_tree import ROOT

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.inference.statistics import rms
from tendon_robot_ros.model.model import Model

sys.path.append(str(ROOT / 'benchmarks'))
rods = importlib.import_module('bench_rods')


@pytest.mark.parametrize(
    ('cells', 'table', 'without', 'loaded'),
    [
        (20, 'rods.csv', (0.021, 0.5), (0.1, 0.6)),  # another package's
        (20, 'rods_20.csv', (0.006, 0.03), (0.008, 0.03)),  # the same, solved finely
        (40, 'rods_40.csv', (0.0015, 0.0075), (0.002, 0.0075)),
    ],
)
def test_rods_are_met_with_and_without_a_force_at_the_tip(cells, table, without, loaded):
    """Errors [mm], median and largest; with half the cell a quarter: the second order."""
    found = rods.compare(cells, rods.EI_OVER_GJ, table)
    for key, count, (median, most) in (('without', 14, without), ('with', 26, loaded)):
        apart = found[f'{key} a force at the tip [mm]']
        assert apart['postures'] == count
        assert apart['median'] < median and apart['largest'] < most


@pytest.mark.parametrize(('disks', 'seed'), [slow(40, 0), (20, 2)])
@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
@pytest.mark.long
def test_a_diagnosis_names_the_twist_of_a_rod_with_its_size(exact, disks, seed):
    found = diagnose(rods.measured('twisting', disks, seed=seed, exact=exact))
    assert found.verdict == 'missing_effect'
    assert [effect.name for effect in found.effects] == ['torsion']
    assert found.cannot_tell_apart == ()
    for value in found.effects[0].parameters.values():
        assert value.low <= rods.EI_OVER_GJ <= value.high


@pytest.mark.parametrize(
    ('exact', 'disks', 'seed'),
    [slow(True, 40, 0), (True, 20, 1), slow(False, 40, 0), slow(False, 20, 1)],
)
def test_a_diagnosis_of_a_rod_that_does_not_twist_names_nothing(exact, disks, seed):
    found = diagnose(rods.measured('stiff', disks, seed=seed, exact=exact))
    assert found.verdict == 'adequate'


@pytest.mark.parametrize(('disks', 'most'), [(20, 1.2e-6), (40, 0.35e-6)])
@pytest.mark.parametrize(('name', 'compliance'), [('twisting', rods.EI_OVER_GJ), ('stiff', 0.0)])
def test_every_disk_of_a_loaded_rod_is_met(name, compliance, disks, most):
    """Cells that were arcs under a load, too, are 23 (20 disks) and 6 µm off, rms."""
    dataset = rods.measured(name, disks, seed=0, exact=True)
    robot = dataset.robot.with_effect('torsion', {'compliance': compliance})
    places = [[row[axis] for axis in 'xyz'] for row in rods.table(f'shapes_{name}_{disks}.csv')]
    off = np.reshape(places, (-1, disks, 3)) - Model(robot).shapes(dataset.inputs).positions
    assert rms(off) < most


def test_inside_a_cell_a_loaded_rod_is_met_by_the_curve_that_it_bows_in():
    """Four cells under a force across the tip, gently bent: the cubic of a beam."""
    robot, force = rods.rod(4), 1e-3
    model = Model(replace(robot, effects={'tip_load': {'force_x': force}}))
    shape = model.shape([0.0] * 6)
    s, reach = np.linspace(0.0, 2.0 * rods.LENGTH, 41), 2.0 * rods.LENGTH
    beam = force / rods.BENDING * (0.5 * reach * s**2 - s**3 / 6.0)
    assert np.allclose(
        shape.markers(s, np.zeros((41, 3)))[:, 0], beam, rtol=0, atol=1e-4 * beam[-1]
    )
    hinges = tuple(replace(section, bends_as='hinge') for section in robot.sections)
    arms = (replace(robot, sections=hinges, effects=model.robot.effects), robot)
    for arm in arms:  # hinges do not bow, and arcs without a load do not
        shape = Model(arm).shape([0.5, 0.0, 0.0, 0.3, 0.0, 0.0])
        frames = np.concatenate([np.eye(3)[None], shape.frames[:-1]])
        steps = np.diff(np.concatenate([np.zeros((1, 3)), shape.positions]), axis=0)
        middle = frames[:, :, 2] + shape.frames[:, :, 2]
        assert np.abs(np.cross(steps, middle)).max() < 1e-15
