"""Every key of a robot description, of a configuration and of a plan is explained."""

import ast
import re

import pytest
from source_tree import ROOT, parse

from tendon_robot_ros.drivers.dynamixel import config as dynamixel
from tendon_robot_ros.drivers.serial_board import config as serial_board
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.compile import KernelArrays
from tendon_robot_ros.robot import parse_robot
from tendon_robot_ros.robot.description import TOLERANCES
from tendon_robot_ros.studies import plan

PAGE = (ROOT / 'docs' / 'robot_file.md').read_text(encoding='utf-8')
EXAMPLE = PAGE.split('```yaml\n')[1].split('```')[0]


def read_keys():
    """Return the keys that the reader of descriptions knows."""
    for node in ast.walk(parse('tendon_robot_ros/robot/description.py')):
        if isinstance(node, ast.Call) and getattr(node.func, 'attr', '') == 'only':
            yield from (a.value for a in node.args if isinstance(a, ast.Constant))


def test_the_example_is_accepted_and_all_its_effects_act():
    robot = parse_robot(EXAMPLE, 'example')
    assert robot.inputs == ('near_left', 'near_right', 'far_left', 'far_right')
    KernelArrays(robot, load_catalogue())


def test_every_key_is_explained():
    text = re.sub(r'```.*?```', '', PAGE, flags=re.S)
    explained = set(re.findall(r'\w+', ' '.join(re.findall(r'`([^`]+)`', text))))
    keys = {*read_keys(), *TOLERANCES}
    assert len(keys) > 15
    assert sorted(keys - explained) == []


@pytest.mark.parametrize(
    ('keys', 'files'),
    [
        (
            {*dynamixel.KEYS, *dynamixel.MOTOR_KEYS},
            ('config/dynamixel_tension.yaml', 'config/dynamixel_pull.yaml'),
        ),
        ({*serial_board.KEYS, *serial_board.TENDON_KEYS}, ('config/serial_board.yaml',)),
        ({*plan.KEYS}, ('examples/campaign.yaml',)),
    ],
    ids=['dynamixel', 'serial', 'campaign'],
)
def test_every_key_of_a_configuration_is_in_its_example(keys, files):
    text = '\n'.join((ROOT / file).read_text(encoding='utf-8') for file in files)
    told = set(re.findall(r'[\w-]+', text))
    assert sorted(keys - told) == []
