"""
Installation, for colcon and for pip.

The version comes from package.xml, the list of executables from tendon_robot_ros/cli/main.py.
"""

import os
import sys
import xml.etree.ElementTree as ElementTree
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from tendon_robot_ros.cli.main import EXECUTABLES  # noqa: E402

NAME = 'tendon_robot_ros'
PACKAGE_XML = ElementTree.parse(HERE / 'package.xml').getroot()

PAGES = 'plotly>=5.18'  # reports that open offline
EXTRAS = {
    'viewer': ['viser>=1.0'],
    'report': [PAGES],  # what a report asks for where colcon has installed the package without it
    # a laboratory's tables: CSV a million rows a second, Parquet, motion capture's .c3d
    'tables': ['ezc3d>=1.5', 'pandas>=2.2', 'pyarrow>=15'],
    'bags': ['rosbags>=0.11'],
    # chunks of campaigns on more than one machine
    'cluster': ['distributed>=2024.4'],
    'dynamixel': ['dynamixel-sdk>=3.7'],
    'serial': ['pyserial>=3.5'],
    # ROS 2 Jazzy for machines without it; where ROS is sourced, leave this one out
    'ros': [
        'ros-jazzy-rclpy[fastrtps]',
        'ros-jazzy-diagnostic-msgs',
        'ros-jazzy-geometry-msgs',
        'ros-jazzy-sensor-msgs',
        'ros-jazzy-std-msgs',
        'ros-jazzy-std-srvs',
        'ros-jazzy-trajectory-msgs',
        'ros-jazzy-visualization-msgs',
    ],
    'ros-test': ['ros-jazzy-test-msgs'],  # an action that every rclpy knows
    'test': [
        'hypothesis>=6.98',
        'mujoco>=3.2',  # the exported file, run to rest
        'pytest>=7.4,<8.4',
        'pytest-rerunfailures>=13',
        'pytest-timeout>=2.2',
        'pytest-xdist>=3.7',
    ],
    # the newest pytest and setuptools that colcon still works with
    'colcon': [
        'colcon-bash',
        'colcon-core',
        'colcon-output',
        'colcon-package-selection',
        'colcon-parallel-executor',
        'colcon-python-setup-py',
        'colcon-ros',
        'colcon-test-result',
        'pytest<8.4',
        'setuptools<80',
    ],
    'docs': [
        'furo>=2024.8',  # theme that is readable on a telephone
        'myst-parser>=4',  # the pages are Markdown, so that they can be read where the code is
        'numpydoc>=1.8',  # the docstrings are numpydoc
        'sphinx>=8',  # what rosdoc2 runs
    ],
    'dev': ['mypy>=2.4,<3', 'ruff>=0.17,<0.18', 'types-PyYAML', 'types-tqdm'],
}


def executables() -> list[str]:
    """
    List the console scripts: every command for ROS, one for pip.

    colcon puts them into lib/tendon_robot_ros, where only `ros2 run` looks. pip would put them
    on the PATH, where `add` or ImageMagick's `compare` belong to others.
    """
    if 'setuptools.build_meta' in sys.modules:  # pip
        return [f'{NAME} = {NAME}.__main__:main']
    return [f'{name} = {NAME}.cli.main:run_named' for name in EXECUTABLES]


def shared_files() -> list[tuple[str, list[str]]]:
    """List the files that go to share/tendon_robot_ros, folder by folder."""
    share = f'share/{NAME}'
    files = [
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (share, ['package.xml']),
    ]
    for top in ('config', 'launch', 'data', 'firmware'):
        for folder, _, _ in os.walk(top):
            if folder == 'firmware/build':
                continue
            found = [path for path in glob(f'{folder}/*') if os.path.isfile(path)]
            files.append((f'{share}/{folder}', sorted(found)))
    return files


setup(
    name=NAME,
    version=PACKAGE_XML.findtext('version'),
    description=' '.join(PACKAGE_XML.findtext('description', '').split()),
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license=PACKAGE_XML.findtext('license'),
    maintainer=PACKAGE_XML.findtext('maintainer'),
    maintainer_email=PACKAGE_XML.find('maintainer').get('email'),
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={'': ['py.typed', '*.css', '*.html', '*.js', '*.yaml']},
    data_files=shared_files(),
    python_requires='>=3.12',
    install_requires=[
        'daqp>=0.7',  # quadratic programs of a few tensions, 20 µs each (docs/control.md)
        'matplotlib>=3.6',
        'numba>=0.61',  # kernel/linking.py
        'numpy>=1.26',
        PAGES,
        'pyyaml>=6.0',
        'scipy>=1.11',
        'threadpoolctl>=3.1',  # a notebook has imported numpy before this package
        'tqdm>=4.66',
    ],
    extras_require=EXTRAS,
    entry_points={'console_scripts': executables()},
    zip_safe=False,
)
