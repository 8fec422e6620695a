"""What every test gets: a ROS domain of its own, and no graphical display."""

import fcntl
import importlib.util
import os
import shutil
import tempfile
from pathlib import Path

import pytest


def own_domain():
    """Take a ROS domain that no other test process on this machine has, until this one ends."""
    for domain in range(1, 102):
        try:
            lock = (Path(tempfile.gettempdir()) / f'tendon_robot_ros_domain_{domain}').open('w')
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # taken, perhaps by another user
            continue
        return domain, lock
    raise RuntimeError('all 101 ROS domains are taken by other test processes')


DOMAIN, LOCK = own_domain()
os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['MPLBACKEND'] = 'Agg'


def pytest_runtest_setup(item):
    """Skip a test whose mark names what this machine does not have."""
    if item.get_closest_marker('ros') and importlib.util.find_spec('rclpy') is None:
        pytest.skip('rclpy is not installed')
    if item.get_closest_marker('browser') and shutil.which('chromium') is None:
        pytest.skip('chromium is not installed')


def pytest_configure(config):
    """Compile the model once, before two workers would do it side by side."""
    if hasattr(config, 'workerinput') or not config.getoption('numprocesses', None):
        return
    from tendon_robot_ros.effects import load_catalogue
    from tendon_robot_ros.model.compose import is_compiled

    if not is_compiled(load_catalogue()):
        from tendon_robot_ros.control.loading import load
        from tendon_robot_ros.robot import load_robot

        load(
            load_robot(Path(__file__).parents[1] / 'config/robots/kato_10_1.yaml'),
            load_catalogue(),
        )
