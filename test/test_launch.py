"""Launch and parameter files name only what the nodes know; they run where launch exists."""

import importlib.util
import re

import pytest
import yaml
from source_tree import ROOT, parse

pytest.importorskip('rclpy')

from tendon_robot_ros.cli.main import COMMANDS
from tendon_robot_ros.nodes import controller_setup, driver_setup, robot_model
from tendon_robot_ros.nodes.controller_setup import SPECS as CONTROLLER

LAUNCH = sorted((ROOT / 'launch').glob('*.launch.py'))
SPECS = {'controller': controller_setup.SPECS, 'driver': driver_setup.SPECS}


@pytest.mark.parametrize('path', LAUNCH, ids=lambda path: path.name)
def test_a_launch_file_compiles_and_describes_a_launch(path):
    compile(path.read_text(), str(path), 'exec')
    assert any(
        getattr(node, 'name', '') == 'generate_launch_description' for node in parse(path).body
    )


def test_the_launch_file_sets_only_parameters_that_exist():
    text = (ROOT / 'launch' / 'robot.launch.py').read_text()
    names = re.search(r'for key in \(([^)]*)\)', text).group(1)
    assert set(re.findall(r"'(\w+)'", names)) <= {spec.name for spec in driver_setup.SPECS}
    names = re.search(r'controller = \{([^}]*)\}', text).group(1)
    assert set(re.findall(r"'(\w+)':", names)) <= {spec.name for spec in CONTROLLER}


@pytest.mark.parametrize('name', SPECS)
def test_a_parameter_file_holds_the_defaults(name):
    content = yaml.safe_load((ROOT / 'config' / f'{name}.yaml').read_text())
    specs = {spec.name: spec for spec in SPECS[name]}
    for key, value in content['/**']['ros__parameters'].items():
        assert specs[key].checked(value) == specs[key].default


@pytest.mark.parametrize('name', SPECS)
def test_every_parameter_says_what_it_is(name):
    for spec in SPECS[name]:
        assert spec.text
        assert spec.checked(spec.default) is not None
        assert type(spec.default) is not float or spec.unit


@pytest.mark.skipif(importlib.util.find_spec('launch_ros') is None, reason='no launch here')
@pytest.mark.parametrize('path', LAUNCH, ids=lambda path: path.name)
def test_a_launch_file_makes_a_description(path):
    spec = importlib.util.spec_from_file_location('launched', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert len(module.generate_launch_description().entities) > 2


@pytest.mark.parametrize('path', LAUNCH, ids=lambda path: path.name)
def test_a_launch_file_names_only_commands_and_files_of_this_package(path):
    text = path.read_text()
    own = re.findall(r"package='tendon_robot_ros',\s*executable='([\w-]+)'", text)
    assert set(own) <= set(COMMANDS)
    for name in re.findall(r"'([\w.]+\.(?:yaml|rviz))'", text):
        if not name.startswith('.'):
            assert (ROOT / 'config' / name).is_file()
    specs = {spec.name for spec in robot_model.SPECS}
    if 'robot-model' in own:
        given = re.findall(r"parameters=\[\{'(\w+)'", text)
        assert given
        assert set(given) <= specs
    if 'teleop_' in text:
        devices = re.search(r"'device': \('\w+', '(\w+) or (\w+)'\)", text).groups()
        for device in devices:
            assert (ROOT / 'config' / f'teleop_{device}.yaml').is_file()
