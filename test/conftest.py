"""
What every test gets: a ROS domain of its own, no graphical display, a limit of time.

And what it leaves: no process, no file in the temporary folder.
"""

import fcntl
import gc
import importlib.util
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import hypothesis
import processes
import pytest


def own_domain():
    """Take a ROS domain that no other test process on this machine has, until this one ends."""
    for domain in range(1, 102):
        try:
            lock = (Path(SHARED) / f'tendon_robot_ros_domain_{domain}').open('w')
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # taken, perhaps by another user
            continue
        return domain, lock
    raise RuntimeError('all 101 ROS domains are taken by other test processes')


# What tests import and start is compiled once, whatever this machine's settings are: each of
# several hundred processes would else compile all sources for itself, which takes two seconds.
sys.dont_write_bytecode = False
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it, and what is started inherits that
SHARED = os.environ.setdefault('PYTEST_DEBUG_TEMPROOT', tempfile.gettempdir())
DOMAIN, LOCK = own_domain()
tempfile.tempdir = os.environ['TMPDIR'] = tempfile.mkdtemp(prefix='tests_', dir=SHARED)
os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['MPLBACKEND'] = 'Agg'
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')  # as the package itself says, but earlier
# how long an example takes is no property of what is tested, but of what else this machine does
QUIET = [hypothesis.HealthCheck.too_slow]
hypothesis.settings.register_profile('busy', deadline=None, suppress_health_check=QUIET)
hypothesis.settings.load_profile('busy')
LIMIT, LONG = 600.0, 3600.0  # [s] for any test with what it sets up; for one marked slow or blind
gc.set_threshold(100_000)  # what tests and their collection make by millions holds no cycles
RERUNS = 2  # processes that talk to each other are late on a busy machine
# The files that take longest, longest first, of nodes and of others in turn: those that start
# nodes wait, the others compute. So no processor is idle, and what is left at the end is short.
LONGEST = (
    'ros_record', 'watch', 'docs', 'ros_follow', 'investigate', 'diagnose', 'ros_monitor',
    'setup_mistakes', 'ros_life', 'ros_bad_input', 'control_friction', 'placed', 'ros_dynamixel',
    'table_import', 'live', 'cells', 'local_tests', 'campaign_cluster', 'as_built', 'ros_chain',
    'dynamixel_start', 'ros_stop', 'dynamixel_commands', 'ros_travel', 'ros_investigate',
    'dynamixel_faults', 'demo', 'add', 'live_page', 'diagnosis_page', 'senders', 'driver_contract',
    'diagnose_command', 'travel', 'ros_serial', 'dynamixel_settings', 'model_error', 'reference',
    'campaign', 'watch_filter', 'as_found', 'model_equilibrium', 'model_bending_hysteresis',
    'wheel', 'control_null_space', 'model_inverse', 'readme', 'unreadable', 'advice', 'report',
    'command_line', 'model_reference', 'data_bag_identity', 'fit', 'improve', 'compare', 'trust',
    'thinning', 'data_fuzz', 'house', 'workspace',
)  # fmt: skip


def pytest_collection_modifyitems(config, items):
    """Give every test a limit, and those that start nodes another chance."""
    nodes = {item.module for item in items if item.get_closest_marker('ros')}
    longest = {f'test_{name}': place for place, name in enumerate(LONGEST)}

    def place(item):
        return longest.get(item.module.__name__, len(longest)), item.module not in nodes

    items.sort(key=place)
    limited, again = map(config.pluginmanager.hasplugin, ('timeout', 'rerunfailures'))
    for item in items:
        if limited and not item.get_closest_marker('timeout'):
            long = item.get_closest_marker('slow') or item.get_closest_marker('blind')
            item.add_marker(pytest.mark.timeout(LONG if long else LIMIT))
        if again and item.get_closest_marker('ros'):
            item.add_marker(pytest.mark.flaky(reruns=RERUNS))


def pytest_collection_finish():
    """Let no garbage collection scan what stays: modules and tests are a million objects."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope='module', autouse=True)
def nothing_is_left():
    """Refuse a module of tests that leaves a process or a temporary file; close ROS after it."""
    processes.adopt()
    children, files = processes.children(), set(temporary())
    yield
    if 'rclpy' in sys.modules:
        sys.modules['rclpy'].try_shutdown()
    left = [*processes.left(children), *sorted(set(temporary()) - files)]
    assert not left, f'left behind: {left}'


@pytest.fixture(autouse=True)
def processes_end_with_the_test():
    """End what a test started."""
    before = len(processes.started)
    yield
    for process in processes.started[before:]:
        process.end()


def temporary():
    """List the temporary folder of this process of tests."""
    return os.listdir(tempfile.gettempdir())


def pytest_runtest_setup(item):
    """Skip a test whose mark names what this machine does not have."""
    if item.get_closest_marker('ros') and importlib.util.find_spec('rclpy') is None:
        pytest.skip('rclpy is not installed')
    if item.get_closest_marker('browser') and shutil.which('chromium') is None:
        pytest.skip('chromium is not installed')


def pytest_unconfigure():
    """Take the temporary folder away."""
    shutil.rmtree(tempfile.gettempdir(), ignore_errors=True)


def pytest_configure(config):
    """Compile the models once, before workers would do it side by side."""
    if not hasattr(config, 'workerinput') and config.getoption('numprocesses', None):
        from compiling import compile_all

        compile_all()
