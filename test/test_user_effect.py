"""An effect that only the user knows is simulated, named by diagnose, and added."""

import numpy as np
import pytest
import simulated
from simulated import measured
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.data import save_dataset
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.robot import load_robot

pytestmark = pytest.mark.slow
PULLEY = (ROOT / 'examples' / 'soft_pulley.py').read_text(encoding='utf-8')


def test_an_effect_of_the_users_own_is_named_and_added(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'soft_pulley.py').write_text(PULLEY)
    catalogue = load_catalogue(['soft_pulley.py'])
    hidden = {'soft_pulley': {'loss': 0.06}}
    dataset = measured(simulated.robot(), hidden, count=12, catalogue=catalogue)
    save_dataset(dataset, tmp_path / 'data')
    assert main(['diagnose', 'data', '--effect-file', 'soft_pulley.py', '--add', 'new.yaml']) == 0
    assert 'Missing: a pulley that gives way, loss 0.0' in capsys.readouterr().out
    assert np.isclose(load_robot('new.yaml').effects['soft_pulley']['loss'], 0.06, rtol=0.1)
    assert main(['diagnose', 'data', '--robot', 'new.yaml']) == 1
    assert "effects: unknown effect 'soft_pulley'" in capsys.readouterr().err
    assert main(['effect', 'add', 'soft_pulley', '--data', 'data', '--output', 'b.yaml']) == 1
