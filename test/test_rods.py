"""Exact rods: how far the model is from them, and what a diagnosis of their shapes says."""

import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.comparison.cell_errors import cell_errors
from tendon_robot_ros.comparison.noise import rms
from tendon_robot_ros.comparison.predict import Predictor
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue

sys.path.append(str(ROOT / 'benchmarks'))
rods = importlib.import_module('bench_rods')


@pytest.mark.parametrize(
    ('cells', 'table', 'without', 'loaded'),
    [
        (20, 'rods.csv', (0.021, 0.5), (0.1, 0.6)),  # another package's
        (20, 'rods_20.csv', (0.006, 0.03), (0.03, 0.06)),  # the same, solved finely
        (40, 'rods_40.csv', (0.0015, 0.0075), (0.0075, 0.015)),
    ],
)
def test_rods_are_met_with_and_without_a_force_at_the_tip(cells, table, without, loaded):
    """Errors [mm], median and largest; with half the cell a quarter: the second order."""
    found = rods.compare(cells, rods.EI_OVER_GJ, table)
    for key, count, (median, most) in (('without', 14, without), ('with', 26, loaded)):
        apart = found[f'{key} a force at the tip [mm]']
        assert apart['postures'] == count
        assert apart['median'] < median and apart['largest'] < most


@pytest.mark.parametrize(('disks', 'seed'), [(40, 0), (20, 2)])
@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
def test_a_diagnosis_names_the_twist_of_a_rod_with_its_size(exact, disks, seed):
    found = diagnose(rods.measured('twisting', disks, seed=seed, exact=exact), workers=1)
    assert found.verdict == 'missing_effect'
    assert [effect.name for effect in found.effects] == ['torsion']
    assert found.cannot_tell_apart == ()
    for value in found.effects[0].parameters.values():
        assert value.low <= rods.EI_OVER_GJ <= value.high


@pytest.mark.parametrize(('disks', 'seed'), [(40, 0), (20, 1)])
@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
def test_a_diagnosis_of_a_rod_that_does_not_twist_names_nothing(exact, disks, seed):
    found = diagnose(rods.measured('stiff', disks, seed=seed, exact=exact), workers=1)
    assert found.verdict == 'adequate'


@pytest.mark.parametrize('disks', [20, 40])
@pytest.mark.parametrize(('name', 'compliance'), [('twisting', rods.EI_OVER_GJ), ('stiff', 0.0)])
def test_what_cells_of_finite_length_leave_out_is_known(name, compliance, disks):
    dataset = rods.measured(name, disks, seed=0, exact=True)
    robot = dataset.robot.with_effect('torsion', {'compliance': compliance})
    places = [[row[axis] for axis in 'xyz'] for row in rods.table(f'shapes_{name}_{disks}.csv')]
    predictor = Predictor(dataset, robot, load_catalogue())
    off = np.reshape(places, (-1, disks, 3)) - predictor.markers({})
    left = off - cell_errors(predictor, {})
    assert rms(off) > 2e-5 * (20 / disks) ** 2
    assert rms(left) < 0.1 * rms(off)


def test_hinges_and_arms_without_a_load_are_their_cells():
    dataset = rods.measured('stiff', 20, seed=0, exact=True)
    for robot in (
        replace(dataset.robot, effects={'straight_tendon': {'fraction': 1.0}}),
        replace(
            dataset.robot,
            sections=tuple(replace(s, bends_as='hinge') for s in dataset.robot.sections),
        ),
    ):
        assert not cell_errors(Predictor(dataset, robot, load_catalogue()), {}).any()
