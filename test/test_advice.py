"""Whoever follows the advice of a message gets on: the same message does not come again."""

import re
import shutil

import pytest
from source_tree import ROOT

from tendon_robot_ros.cli.main import main

ROBOT = ROOT / 'config' / 'robots' / 'spatial_3.yaml'
RUN = ROOT / 'data' / 'hinge_friction' / 'fit'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Stand in a folder with a robot, a data set, and files and folders that are neither."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROBOT, 'arm.yaml')
    shutil.copytree(RUN, 'run')
    (tmp_path / 'empty.yaml').touch()
    (tmp_path / 'nothing').mkdir()
    return tmp_path


# what is typed; what the message says; what it advises, typed instead (None: it advises nothing)
SITUATIONS = [
    ('shape arm.yaml --tensions tree=1', "unknown 'tree'; did you mean three?",
     'shape arm.yaml --tensions three=1'),
    ('shape arm.yaml --tensions one=-1', 'one: expected a finite tension not below 0 N, got -1',
     'shape arm.yaml --tensions one=1'),
    ('shape arm.yaml --tensions one=20', 'above the limit of 8 N .*; say --beyond-limits',
     'shape arm.yaml --tensions one=20 --beyond-limits'),
    ('shape arm.yaml --pulls one=0.002,two=0.001', 'if m is meant, say --unit m',
     'shape arm.yaml --pulls one=0.002,two=0.001 --unit m'),
    ('shape arm.yaml --pulls one=500', '500 mm on an arm of 120 mm$', None),
    ('shape arm.yaml --pulls one=5m', '5000 mm on an arm of 120 mm$', None),
    ('shape run --tensions left=1', 'run: is a folder; name its run/robot.yaml',
     'shape run/robot.yaml --tensions left=1'),
    ('shape spatial3 --tensions one=1', 'did you mean spatial_3?',
     'shape spatial_3 --tensions one=1'),
    ('shape empty.yaml --tensions one=1', r'a robot description .* got .an empty file.', None),
    ('reach arm.yaml --position 0.01,0,0.1', 'if m is meant, say --unit m',
     'reach arm.yaml --position 0.01,0,0.1 --unit m'),
    ('reach arm.yaml --position 10,0,100 --unit m', 'if mm is meant, say --unit mm',
     'reach arm.yaml --position 10,0,100 --unit mm'),
    ('reach arm.yaml --position 1e9,0,0', 'from the base of an arm of 120 mm$', None),
    ('reach arm.yaml --position 10m,0,0', 'from the base of an arm of 120 mm$', None),
    ('compare arm.yaml', 'is a file, and no data set; name the folder that holds dataset.yaml',
     'compare run'),
    ('compare absent', 'absent: is not there; name the folder of a data set', 'compare run'),
    ('compare run/shapes.csv', 'is a table, and no data set', None),
    ('compare run --model arm.yaml', 'run: was measured with the inputs left, right of planar1, '
     'but arm.yaml has one, two, three; name a description of the robot that was measured',
     'compare run --model run/robot.yaml'),
    ('import-table run/shapes.csv --robot arm.yaml --output new',
     'run/shapes.csv: belongs to the data set run, which needs no import; compare it: ',
     'compare run'),
    ('import-table run --robot arm.yaml --output new', 'compare it: ', 'compare run'),
    ('import-bag run --output new', 'run: is a data set, and no recording; compare it: ',
     'compare run'),
    ('import-bag nothing --output new', 'nothing: is a folder without metadata.yaml', None),
    ('simulate arm.yaml --output new --count 0', '--count: expected a whole number from 1 on',
     'simulate arm.yaml --output new --count 1'),
]  # fmt: skip


@pytest.mark.parametrize(('typed', 'said', 'advised'), SITUATIONS, ids=[s[0] for s in SITUATIONS])
def test_who_follows_the_advice_gets_on(folder, capsys, typed, said, advised):
    assert main(typed.split()) == 1
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(said.replace('?', r'\?'), message), message
    if advised is None:
        assert not re.search(r'say --|did you mean', message)
    else:
        assert main(advised.split()) == 0, capsys.readouterr().err


def test_a_tension_may_have_its_unit(folder, capsys):
    assert main(['shape', 'arm.yaml', '--tensions', 'one=1500mN']) == 0
    with_unit = capsys.readouterr().out
    assert main(['shape', 'arm.yaml', '--tensions', 'one=1.5']) == 0
    assert with_unit == capsys.readouterr().out
    assert main(['shape', 'arm.yaml', '--tensions', 'one=3mm']) == 1
    assert 'one' in capsys.readouterr().err
