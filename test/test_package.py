"""package.xml, setup.py and the command table say the same."""

import ast
import re
import sys
from pathlib import Path

import processes
import pytest
from catkin_pkg.cli.tag_changelog import get_forthcoming_label
from catkin_pkg.package import parse_package
from source_tree import ROOT, files, parse

from tendon_robot_ros.cli.main import EXECUTABLES
from tendon_robot_ros.common.yaml_reading import parse_yaml

PACKAGE = parse_package(str(ROOT), warnings=(WARNINGS := []))


def setup_py(*options):
    result = processes.run(
        [sys.executable, 'setup.py', '-q', *options],
        cwd=ROOT,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def test_package_xml_is_valid_format_3_for_ament_python():
    PACKAGE.validate()
    assert WARNINGS == []
    assert PACKAGE.package_format == 3
    assert PACKAGE.get_build_type() == 'ament_python'


def test_setup_takes_name_version_and_licence_from_package_xml():
    told = setup_py('--name', '--version', '--license').split('\n')
    assert told == [PACKAGE.name, PACKAGE.version, PACKAGE.licenses[0]]


def test_the_citation_names_this_version():
    citation = parse_yaml((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert (citation['title'], citation['version']) == (PACKAGE.name, PACKAGE.version)
    assert citation['license'] == PACKAGE.licenses[0]


def test_every_command_becomes_an_executable(tmp_path):
    setup_py('egg_info', '--egg-base', str(tmp_path))
    entry_points = ''.join(path.read_text() for path in tmp_path.glob('*/entry_points.txt'))
    scripts = re.findall(r'^(\S+) = tendon_robot_ros.cli.main:run_named$', entry_points, re.M)
    assert sorted(scripts) == EXECUTABLES


def test_the_release_tools_find_what_is_new():
    text = (ROOT / 'CHANGELOG.rst').read_text()
    assert f'Changelog for package {PACKAGE.name}' in text
    assert get_forthcoming_label(text) == 'Forthcoming' or f'\n{PACKAGE.version} (' in text


# Keys of package.xml that rosdep resolves on Ubuntu 24.04 with ROS 2 Jazzy: packages released in
# jazzy/distribution.yaml, and keys of rosdep/python.yaml, of github.com/ros/rosdistro as of August
# 2026. A new key is looked up there first (`rosdep resolve KEY`), then added here.
RELEASED = {
    'action_msgs',
    'builtin_interfaces',
    'control_msgs',
    'diagnostic_msgs',
    'geometry_msgs',
    'joy',
    'launch',
    'launch_ros',
    'lifecycle_msgs',
    'nav2_msgs',
    'rcl_interfaces',
    'rclpy',
    'ros2launch',
    'rviz2',
    'sensor_msgs',
    'spacenav',
    'std_msgs',
    'std_srvs',
    'teleop_twist_joy',
    'test_msgs',
    'tf2_ros_py',
    'trajectory_msgs',
    'visualization_msgs',
}
SYSTEM = {
    'python3-hypothesis',
    'python3-matplotlib',
    'python3-numpy',
    'python3-pytest',
    'python3-scipy',
    'python3-serial',
    'python3-tqdm',
    'python3-yaml',
}
# module -> its key, where that has another name
KEYS = {
    'tf2_ros': 'tf2_ros_py',
    'serial': 'python3-serial',
    'yaml': 'python3-yaml',
    **{name: f'python3-{name}' for name in ('matplotlib', 'numpy', 'scipy', 'tqdm')},
}


def of_pip():
    """Name the modules that setup.py gets from pip: all it needs, and the extras."""
    text = (ROOT / 'setup.py').read_text()
    return {name.replace('-', '_') for name in re.findall(r"'([a-z0-9-]+)>=", text)}


def modules(*patterns):
    """Yield the modules of others that files import, and the nodes of others that they start."""
    for path in (path for pattern in patterns for path in files(pattern)):
        for node in ast.walk(parse(path)):
            if isinstance(node, ast.Import):
                yield from (alias.name.split('.')[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and not node.level:
                yield node.module.split('.')[0]
            elif isinstance(node, ast.keyword) and node.arg == 'package':
                yield node.value.value


def test_all_that_nodes_and_launch_files_use_is_declared():
    declared = {dependency.name for dependency in PACKAGE.exec_depends}
    used = set(modules('tendon_robot_ros/ros/*.py', 'launch/*.py')) - set(sys.stdlib_module_names)
    ours = {PACKAGE.name, 'viser'}
    undeclared = {module for module in used - ours if KEYS.get(module, module) not in declared}
    assert undeclared <= of_pip(), undeclared


def test_all_that_the_package_imports_comes_from_rosdep_or_pip():
    declared = {dependency.name for dependency in PACKAGE.exec_depends}
    used = set(modules('tendon_robot_ros/*.py')) - set(sys.stdlib_module_names) - {PACKAGE.name}
    undeclared = {module for module in used if KEYS.get(module, module) not in declared}
    other = {'llvmlite', 'pyarrow', 'rosbags', 'distributed', 'dask'}  # come with these
    assert undeclared <= of_pip() | other, undeclared


def test_every_key_of_package_xml_resolves():
    keys = {dependency.name for dependency in PACKAGE.exec_depends + PACKAGE.test_depends}
    assert keys <= RELEASED | SYSTEM, keys - RELEASED - SYSTEM


def test_what_rosdep_lacks_has_its_pip_line_in_the_docs():
    text = (ROOT / 'setup.py').read_text()
    needed = re.search(r'install_requires=\[(.*?)\]', text, re.S)[1]
    names = re.findall(r"'([a-z0-9-]+)>=", needed)
    keys = {dependency.name for dependency in PACKAGE.exec_depends}
    left = [n for n in names if KEYS.get(n, {'pyyaml': 'python3-yaml'}.get(n, n)) not in keys]
    docs = (ROOT / 'docs' / 'getting_started.md').read_text(encoding='utf-8')
    line = next(line for line in docs.splitlines() if 'pip install' in line and 'numba' in line)
    assert left
    assert [name for name in left if name not in line] == []


@pytest.mark.parametrize('name', ['LICENSE', 'README.md', 'CONTRIBUTING.md', 'CHANGELOG.rst'])
def test_the_files_a_visitor_looks_for_are_there(name):
    assert Path(ROOT, name).stat().st_size > 200
