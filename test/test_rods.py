"""Exact rods: how far the model is from them, and what a diagnosis of their shapes says."""

import importlib
import sys

import pytest
from source_tree import ROOT

from tendon_robot_ros.diagnosis.diagnose import diagnose

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


@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
def test_a_diagnosis_names_the_twist_of_a_rod_with_its_size(exact):
    found = diagnose(rods.measured('twisting', 40, seed=0, exact=exact), workers=1)
    assert found.verdict == 'missing_effect'
    assert [effect.name for effect in found.effects] == ['torsion']
    assert found.cannot_tell_apart == ()
    for value in found.effects[0].parameters.values():
        assert value.low <= rods.EI_OVER_GJ <= value.high


@pytest.mark.parametrize('exact', [True, False], ids=['exact', 'as built'])
def test_a_diagnosis_of_a_rod_that_does_not_twist_names_no_twist(exact):
    found = diagnose(rods.measured('stiff', 40, seed=0, exact=exact), workers=1)
    assert found.verdict == 'adequate'
