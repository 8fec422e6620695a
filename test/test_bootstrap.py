"""tools/bootstrap.sh finds a Python 3.12, says what is missing, and installs only when it must."""

import contextlib
import os
import pty
import re
import shutil
import sys
from pathlib import Path

import processes
import pytest
from source_tree import ROOT

SCRIPT = ROOT / 'tools' / 'bootstrap.sh'
TOOLS = ('sh', 'cat', 'chmod', 'cksum', 'date', 'dirname', 'flock', 'head', 'mkdir', 'rm', 'sleep',
         'uname')  # fmt: skip
SHIM = '#!/bin/sh\necho "pyenv: python3.12: command not found" >&2\nexit 127\n'
OLD = '#!/bin/sh\nexit 1\n'  # answers the question for its version with no
# A Python that answers the script's questions and writes down what it is asked to install.
PRETENDER = """#!/bin/sh
case "$*" in
    '-I -S'*) echo "$0" ;;
    '-m venv'*) for folder; do :; done; mkdir -p "$folder/bin"; echo venv >>"$LOG"
                cat "$0" >"$folder/bin/python"; chmod +x "$folder/bin/python" ;;
    '-m pip'*) echo pip >>"$LOG"; [ -z "$SLOW" ] || { echo "$SLOW"; sleep 0.5; }
               [ -z "$BREAK" ] ;;
    *'import rclpy'*) [ -n "$PRETEND_ROS" ] ;;
    *site*) dirname "$0" ;;
esac
"""


def program(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)
    return path


@pytest.fixture
def machine(tmp_path):
    """Return the environment of a machine without any Python."""
    (tmp_path / 'bin').mkdir()
    for name in TOOLS:
        (tmp_path / 'bin' / name).symlink_to(shutil.which(name))
    return {'PATH': str(tmp_path / 'bin'), 'HOME': str(tmp_path), 'VENV': str(tmp_path / 'venv')}


def bootstrap(machine, *command, stderr=processes.PIPE):
    return processes.run([SCRIPT, *command], env=machine, stderr=stderr)


@pytest.mark.parametrize('name', ['python3.12', 'python3', 'python'])
def test_a_python_on_path_is_found(machine, tmp_path, name):
    python = program(tmp_path / 'bin' / name, PRETENDER)
    assert bootstrap(machine, '--find').stdout == f'{python}\n'


def test_a_real_python_names_itself_and_not_its_environment(machine, tmp_path):
    (tmp_path / 'bin/python3').symlink_to(sys.executable)
    real = Path(sys._base_executable).resolve()
    assert bootstrap(machine, '--find').stdout == f'{real}\n'


def test_a_shim_that_does_not_run_is_passed_over_for_pyenvs_own(machine, tmp_path):
    program(tmp_path / 'bin/python3.12', SHIM)
    program(tmp_path / 'bin/python3', OLD)
    python = program(tmp_path / '.pyenv/versions/3.12.1/bin/python', PRETENDER)
    assert bootstrap(machine, '--find').stdout == f'{python}\n'


def test_pyenv_may_live_elsewhere(machine, tmp_path):
    python = program(tmp_path / 'elsewhere/versions/3.12.9/bin/python', PRETENDER)
    found = bootstrap(machine | {'PYENV_ROOT': str(tmp_path / 'elsewhere')}, '--find')
    assert found.stdout == f'{python}\n'


def test_a_python_of_uv_is_found(machine, tmp_path):
    python = program(tmp_path / 'uv' / 'python', PRETENDER)
    program(tmp_path / 'bin/uv', f'#!/bin/sh\necho {python}\n')
    assert bootstrap(machine, '--find').stdout == f'{python}\n'


def test_the_python_that_the_user_names_is_taken_or_refused(machine, tmp_path):
    python = program(tmp_path / 'mine' / 'python', PRETENDER)
    program(tmp_path / 'bin/python3.12', PRETENDER)
    assert bootstrap(machine | {'PYTHON': str(python)}, '--find').stdout == f'{python}\n'
    refused = bootstrap(machine | {'PYTHON': 'python2'}, '--find')
    assert (refused.returncode, refused.stdout) == (1, '')
    assert refused.stderr == 'PYTHON=python2 is not a Python 3.12 that runs\n'


def test_without_a_python_it_says_what_to_install(machine, tmp_path):
    run = bootstrap(machine, 'true')
    assert run.returncode != 0
    assert run.stderr.startswith('no Python 3.12 found on PATH, under pyenv or under uv; install')
    for remedy in ('apt install python3.12-venv', 'uv python install', 'pyenv install'):
        assert remedy in run.stderr
    assert not (tmp_path / 'venv').exists()


@pytest.fixture
def pretend(machine, tmp_path):
    """Return a function that runs the script with a pretender, and tells what was installed."""
    program(tmp_path / 'bin/python3.12', PRETENDER)
    log = tmp_path / 'log'

    def run(*command, stderr=processes.PIPE, **environment):
        log.write_text('')
        known = machine | {'LOG': str(log)} | environment
        result = bootstrap(known, *command, stderr=stderr)
        return result, log.read_text().split()

    return run


def test_a_second_run_installs_nothing(pretend):
    assert pretend()[1] == ['venv', 'pip']
    result, installed = pretend('sh', '-c', 'exit 3')
    assert installed == []
    assert (result.returncode, result.stdout, result.stderr) == (3, '', '')


@pytest.mark.parametrize(
    ('line', 'told'),
    [
        ('Collecting numba>=0.59 (from tendon_robot_ros)', 'looking for numba'),
        (
            '  Downloading https://x.org/a/numba-0.60.whl (3 MB)',
            'downloading numba-0.60.whl (3 MB)',
        ),
        (
            '  Using cached numba-0.60.whl (3 MB)',
            'taking numba-0.60.whl (3 MB), which is here alre',
        ),
        ('Installing collected packages: a, b, c', 'installing, 0 of 3 packages'),
        ('Installing build dependencies: started', 'looking for what is needed'),
    ],
)
def test_what_pip_is_at_is_said_on_a_terminal(pretend, line, told):
    ours, terminal = pty.openpty()
    pretend(SLOW=line, stderr=terminal)
    os.close(terminal)
    shown = ''
    with open(ours, 'rb', buffering=0) as screen, contextlib.suppress(OSError):  # its end
        while block := screen.read(1000):
            shown += block.decode()
    assert told in shown
    assert 'set up in ' in shown


def test_other_requirements_are_installed_into_the_same_environment(pretend):
    pretend()
    assert pretend(PIP_CONSTRAINT='oldest.txt')[1] == ['pip']


def test_a_half_made_environment_is_made_anew(pretend, tmp_path):
    result, _ = pretend(BREAK='yes')
    assert result.returncode != 0
    assert 'pip could not install' in result.stderr
    (tmp_path / 'venv/left_over').touch()
    assert pretend()[1] == ['venv', 'pip']
    assert not (tmp_path / 'venv/left_over').exists()


def test_an_environment_whose_python_is_gone_is_made_anew(pretend, tmp_path):
    pretend()
    (tmp_path / 'venv/bin/python').unlink()
    assert pretend()[1] == ['venv', 'pip']


def test_what_another_environments_wheels_left_behind_is_dropped(pretend):
    report = 'echo "${LD_LIBRARY_PATH:-}/${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}/$AMENT_PREFIX_PATH"'
    left = {'_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1', 'LD_LIBRARY_PATH': '/else/lib'}
    result, _ = pretend('sh', '-c', report, AMENT_PREFIX_PATH='/else', **left)
    assert result.stdout.startswith('//')
    assert result.stdout.endswith('/venv\n')


def test_a_sourced_jazzy_is_used_in_an_environment_of_its_own(pretend):
    pretend()
    sourced = {'ROS_DISTRO': 'jazzy', 'PRETEND_ROS': 'yes', 'AMENT_PREFIX_PATH': '/opt/ros/jazzy'}
    result, installed = pretend('sh', '-c', 'echo $AMENT_PREFIX_PATH', **sourced)
    assert '(sourced ROS 2)' in result.stderr
    assert installed == ['venv', 'pip']
    assert result.stdout == '/opt/ros/jazzy\n'


def test_a_sourced_jazzy_needs_a_python_that_imports_rclpy(pretend):
    result, installed = pretend('true', ROS_DISTRO='jazzy')
    assert result.returncode != 0
    assert result.stderr.startswith('no Python 3.12 that imports rclpy found on PATH')
    assert installed == []


def test_another_distribution_is_left_aside(pretend):
    result, _ = pretend(
        'sh',
        '-c',
        'echo $PYTHONPATH$ROS_DISTRO',
        ROS_DISTRO='humble',
        PYTHONPATH='/opt/ros/humble',
    )
    assert 'ROS 2 humble is sourced; it is left aside' in result.stderr
    assert result.stdout == '\n'


def test_the_oldest_versions_are_allowed():
    """An environment of them cannot be made otherwise."""
    asked = re.findall(r"'([\w-]+)>=([\d.]+)'", (ROOT / 'setup.py').read_text(encoding='utf-8'))
    lines = (ROOT / 'tools/oldest.txt').read_text(encoding='utf-8').splitlines()
    oldest = dict(line.lower().split('==') for line in lines if '==' in line)
    held = [(name, version) for name, version in asked if name in oldest]
    assert len(held) > 10
    for name, version in held:
        assert _numbers(oldest[name]) >= _numbers(version), name


def _numbers(version):
    return [int(part) for part in version.split('.')]
