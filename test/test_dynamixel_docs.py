"""The numbers and examples of the pages on Dynamixel motors are those of the code."""

import pytest
from source_tree import ROOT

pytest.importorskip('dynamixel_sdk')

from tendon_robot_ros.common.yaml_reading import parse_yaml
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel.bus import UDEV_FILE, UDEV_RULE
from tendon_robot_ros.drivers.dynamixel.config import (
    Resolution,
    from_data_sheet,
    smallest_spool,
)
from tendon_robot_ros.drivers.dynamixel.control_table import MODELS, REGISTERS
from tendon_robot_ros.drivers.dynamixel.servos import SETTINGS
from tendon_robot_ros.robot import load_robot

PAGE = ''.join(
    (ROOT / 'docs' / name).read_text(encoding='utf-8')
    for name in ('dynamixel.md', 'dynamixel_settings.md')
)


@pytest.mark.parametrize('model', MODELS.values(), ids=lambda model: model.name)
def test_the_table_of_motors_is_computed(model):
    found = Resolution(from_data_sheet(model, 0.010), model, 5.0)
    row = (
        f'| {model.name} | {model.torque_per_ampere:.3g} | {1e3 * model.current_unit:g} | '
        f'{found.newtons_per_count:.3g} | ±{found.band:.2g} N | '
        f'{1e3 * smallest_spool(model, 5.0):.0f} mm |'
    )
    assert row in PAGE


@pytest.mark.parametrize('model', MODELS.values(), ids=lambda model: model.name)
@pytest.mark.parametrize('limit', [1.0, 5.0, 20.0])
def test_the_smallest_spool_is_fine_and_a_smaller_one_is_not(model, limit):
    radius = smallest_spool(model, limit)
    assert not Resolution(from_data_sheet(model, radius), model, limit).coarse
    assert Resolution(from_data_sheet(model, 0.9 * radius - 1e-3), model, limit).coarse


def test_the_udev_rule_is_the_one_that_the_driver_prints():
    assert UDEV_RULE in PAGE
    assert UDEV_FILE in PAGE


@pytest.mark.parametrize('mode', ['tension', 'pull'])
def test_the_example_configuration_is_accepted(mode):
    path = ROOT / 'config' / f'dynamixel_{mode}.yaml'
    robot = load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')
    content = parse_yaml(path.read_text(encoding='utf-8'))
    driver = make_driver('dynamixel', robot, content, mode=mode, source=str(path))
    assert driver.limits.shape == (4, 2)


def test_the_page_lists_every_register_that_the_driver_owns():
    rows = [line for line in PAGE.splitlines() if line.endswith(('set |', 'refused |', '` |'))]
    for setting in SETTINGS:
        (row,) = [row for row in rows if f'({REGISTERS[setting.name].address})' in row]
        assert ('refused' in row.split('|')[-2]) == setting.refused
        if setting.value is not None:
            assert str(setting.value) in row
