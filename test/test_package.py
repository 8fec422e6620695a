"""package.xml, setup.py and the command table say the same."""

import re
import sys
from pathlib import Path

import processes
import pytest
from catkin_pkg.cli.tag_changelog import get_forthcoming_label
from catkin_pkg.package import parse_package
from source_tree import ROOT

from tendon_robot_ros.cli.main import COMMANDS

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


def test_every_command_becomes_an_executable(tmp_path):
    setup_py('egg_info', '--egg-base', str(tmp_path))
    entry_points = ''.join(path.read_text() for path in tmp_path.glob('*/entry_points.txt'))
    scripts = re.findall(r'^(\S+) = tendon_robot_ros.cli.main:run_named$', entry_points, re.M)
    assert sorted(scripts) == sorted(COMMANDS)


def test_the_release_tools_find_what_is_new():
    text = (ROOT / 'CHANGELOG.rst').read_text()
    assert f'Changelog for package {PACKAGE.name}' in text
    assert get_forthcoming_label(text) == 'Forthcoming' or f'\n{PACKAGE.version} (' in text


def test_messages_that_nodes_import_are_declared():
    declared = {dependency.name for dependency in PACKAGE.exec_depends}
    imported = set()
    for path in (ROOT / 'tendon_robot_ros/ros').glob('**/*.py'):
        imported |= set(
            re.findall(r'^\s*(?:from|import) (\w+_msgs|std_srvs)\b', path.read_text(), re.M)
        )
    assert imported <= declared


@pytest.mark.parametrize('name', ['LICENSE', 'README.md', 'CONTRIBUTING.md', 'CHANGELOG.rst'])
def test_the_files_a_visitor_looks_for_are_there(name):
    assert Path(ROOT, name).stat().st_size > 200
