"""The measured trunk: two data sets, one of them with a known load."""

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.comparison.compare import compare
from tendon_robot_ros.comparison.predict import Predictor
from tendon_robot_ros.data import join, load_dataset
from tendon_robot_ros.effects import load_catalogue

TRUNK = ROOT / 'data' / 'trunk'


@pytest.fixture(scope='module')
def both():
    """Read both data sets as one."""
    return join([load_dataset(TRUNK / name) for name in ('base', 'payload_100')])


def test_the_trunk_loads_and_compares(both):
    assert both.positions.shape == (18, 29, 3, 3)
    assert len(np.unique(both.groups)) == 9
    found = compare(both)
    assert found.models[0].rms == pytest.approx(12.7e-3, abs=1e-4)


def test_the_known_weight_pulls_its_own_postures_down(both):
    predictor = Predictor(both, both.robot, load_catalogue())
    shown = predictor.markers({})
    down = shown[9:, -1, 2] - shown[:9, -1, 2]
    assert (down[np.arange(9) != 4] > 3e-4).all() and abs(down[4]) < 1e-4  # c4 hangs straight


def test_every_folder_keeps_its_licence():
    for name in ('base', 'payload_100'):
        assert 'MIT License' in (TRUNK / name / 'LICENSE.txt').read_text(encoding='utf-8')
