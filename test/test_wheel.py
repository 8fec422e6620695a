"""The wheel alone, in an environment with what it declares and without ROS, has all it needs."""

import os
import shutil
import sys
import sysconfig
import tarfile
import venv
from importlib import metadata
from pathlib import Path

import processes
import pytest
from packaging.requirements import Requirement
from source_tree import copy_to
from test_package import PACKAGE

pytestmark = pytest.mark.long
SITE = Path(sysconfig.get_path('purelib', vars={'base': ''}).lstrip('/'))
DATA = 'data/hinge_friction/fit'  # of the package: nothing lies in the folder it is run in


def built(kind, source, folder):
    """Build as `python -m build` does, with the setuptools that are here; return the file."""
    call = f'from setuptools import build_meta; print(build_meta.build_{kind}("{folder}"))'
    result = processes.run([sys.executable, '-c', call], cwd=source)
    assert result.returncode == 0, result.stderr
    return folder / result.stdout.split()[-1]


def add_needs(distribution, found):
    """Collect the distributions that one needs without extras, all the way down."""
    for need in map(Requirement, distribution.requires or ()):
        if need.name not in found and (need.marker is None or need.marker.evaluate({'extra': ''})):
            found[need.name] = metadata.distribution(need.name)
            add_needs(found[need.name], found)
    return found


@pytest.fixture(scope='module')
def python(tmp_path_factory):
    """Install sdist -> wheel into an environment of its own; return its Python."""
    folder = tmp_path_factory.mktemp('wheel')
    with tarfile.open(built('sdist', copy_to(folder / 'source'), folder)) as packed:
        packed.extractall(folder, filter='data')
    source = folder / f'{PACKAGE.name}-{PACKAGE.version}'
    wheel = built('wheel', source, folder)
    shutil.rmtree(source)
    venv.create(folder / 'venv', with_pip=False)
    path = folder / 'venv/bin/python'
    # also where a source tree with a build of it is on PYTHONPATH
    options = '--no-index', '--no-deps', '--ignore-installed'
    install = ['-m', 'pip', '--python', path, 'install', *options, wheel]
    result = processes.run([sys.executable, *install])
    assert result.returncode == 0, result.stderr
    site = folder / 'venv' / SITE
    (ours,) = metadata.distributions(name=PACKAGE.name, path=[str(site)])
    for name, needed in add_needs(ours, {}).items():
        if not needed.files:
            pytest.skip(f'{name} comes from the system, which does not list its files')
        for top in {Path(file).parts[0] for file in needed.files} - {'..', '__pycache__'}:
            if not (site / top).exists():
                (site / top).symlink_to(needed.locate_file(top))
    return path


def run(python, folder, *arguments):
    """Run where there is no source tree; what it compiles is shared with other tests."""
    environment = {key: os.environ[key] for key in os.environ if not key.startswith('PYTHON')}
    result = processes.run([python, *arguments], cwd=folder, env=environment)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def test_the_package_is_that_of_the_wheel_and_there_is_no_ros(python, tmp_path):
    asked = 'import sys, importlib.util as u, tendon_robot_ros as t; '
    asked += 'print(t.__version__, t.__file__.startswith(sys.prefix), u.find_spec("rclpy"))'
    assert run(python, tmp_path, '-c', asked).split() == [PACKAGE.version, 'True', 'None']


@pytest.mark.parametrize(
    ('command', 'says'),
    [
        (f'compare {DATA} --report page.html', 'noise floor'),
        ('robot describe spatial_6', 'effects:'),
        ('simulate kato_2_1 --output simulated', 'written: simulated'),
        ('live --headless --hidden tip_load --seed 1 --postures 4', '% gone)'),
    ],
)
def test_commands_run_and_find_what_the_wheel_brings(python, tmp_path, command, says):
    assert says in run(python, tmp_path, '-m', 'tendon_robot_ros', *command.split())
