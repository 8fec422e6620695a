"""A real colcon build: executables, ament index, and an installed command that runs."""

import os
import sys
from pathlib import Path

import processes
import pytest
from source_tree import copy_to

from tendon_robot_ros.cli.main import EXECUTABLES

pytest.importorskip('colcon_ros', reason='colcon is not installed')
pytestmark = pytest.mark.long
COMMAND = 'compare'


@pytest.fixture(scope='module')
def installed(tmp_path_factory):
    """Build a copy of the package in a workspace; return the folder it is installed in."""
    workspace = tmp_path_factory.mktemp('workspace')
    copy_to(workspace / 'src' / 'tendon_robot_ros')
    build = processes.run(
        [sys.executable, '-m', 'colcon', '--log-base', 'log', 'build'],
        cwd=workspace,
    )
    assert build.returncode == 0, build.stdout + build.stderr
    return workspace / 'install' / 'tendon_robot_ros'


def run_installed(installed, *command):
    """Run in a shell that has sourced the workspace, from a folder that has no source tree."""
    environment = {key: os.environ[key] for key in os.environ if key != 'PYTHONPATH'}
    return processes.run(
        ['bash', '-c', '. "$0/setup.bash" && exec "$@"', installed.parent, *command],
        cwd=installed.parent,
        env=environment,
    )


def test_ros2_run_finds_every_command(installed):
    executables = sorted(path.name for path in (installed / 'lib/tendon_robot_ros').glob('*'))
    assert executables == EXECUTABLES


def test_the_package_is_in_the_ament_index(installed):
    assert (installed / 'share/ament_index/resource_index/packages/tendon_robot_ros').is_file()
    assert (installed / 'share/tendon_robot_ros/package.xml').is_file()
    assert (installed / 'share/tendon_robot_ros/hook/ament_prefix_path.sh').is_file()


def test_config_and_launch_files_are_installed(installed):
    source = installed.parents[1] / 'src/tendon_robot_ros'
    for top in ('config', 'launch', 'data'):
        for path in (source / top).glob('**/*'):
            if path.is_file():
                assert (installed / 'share/tendon_robot_ros' / path.relative_to(source)).is_file()


def test_modules_come_from_the_installation(installed):
    run = run_installed(
        installed, sys.executable, '-c', 'import tendon_robot_ros as t; print(t.__file__)'
    )
    assert Path(run.stdout.strip()).is_relative_to(installed), run.stderr


@pytest.mark.skipif(COMMAND is None, reason='no command yet')
def test_an_installed_executable_runs_with_the_python_that_built_it(installed):
    executable = installed / 'lib/tendon_robot_ros' / COMMAND
    assert executable.read_text().splitlines()[0] == f'#!{sys.executable}'
    run = run_installed(installed, executable, '--help')
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith(f'usage: {COMMAND} ')
