"""Starting, ending and killing nodes in any order: the arm ends safe, and the rest recovers."""

import contextlib
import os
import signal
from itertools import pairwise

import pytest
import yaml
from forked import Forked
from launch_stand_in import launch

pytest.importorskip('rclpy')

from lifecycle_msgs.msg import Transition
from ros_station import LOW, PATIENT, Station, alone, last, stamp, start, values
from source_tree import ROOT

from tendon_robot_ros.drivers.safety import CYCLE_MAX_S
from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.shared.runtime import NodeProcess

pytestmark = pytest.mark.ros
FAR = (0.1, 0.1)  # [m] a posture with tension
STOP_TIME = 1.0  # [s]
RATE_LIMIT = 4.0  # [N/s]: the way back takes half a second


@pytest.fixture
def space(request, tmp_path):
    with alone('/' + request.node.name.split('[')[0][:40], tmp_path) as station:
        yield station


def moved(space, **driver):
    """Start driver and controller and bend the arm."""
    processes = space.run('driver', **driver), space.run('controller')
    space.until_code(space.controller, 'holding', timeout=120.0)
    space.until_code(space.driver, 'following')
    space.go_to_point(*FAR)
    assert max(last(space.states).effort) > 0.5
    return processes


def changes(space, rate):
    """Yield by how much the highest tension changes, and may at a rate, whatever is not heard."""
    efforts = [(stamp(message), max(message.effort)) for _, message in space.states]
    for (began, before), (now, after) in pairwise(efforts):
        yield after - before, rate * (now - began + CYCLE_MAX_S) + 0.02


def test_a_transition_that_is_not_there_is_refused_and_nothing_else_happens(space):
    driver, _ = moved(space)
    for wanted in (Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_CONFIGURE, 99):
        assert not space.change('driver', wanted)
    space.states.clear()
    space.until(lambda: len(space.states) > 20, 'states')
    assert driver.process.poll() is None
    assert values(last(space.driver))['code'] == 'following'
    assert max(last(space.states).effort) > 0.5


@pytest.mark.parametrize(
    'numbers',
    [[signal.SIGINT], [signal.SIGTERM, signal.SIGINT], [signal.SIGHUP]],
    ids=['one', 'and_its_echo', 'closed_terminal'],
)
def test_a_signal_ends_the_driver_after_a_ramp_to_pretension(space, numbers):
    driver, _ = moved(space, stop_time=STOP_TIME, release_rate=0.5)  # which is slower
    rate = (max(last(space.states).effort) - LOW) / STOP_TIME
    space.states.clear()
    for number in numbers:  # systemd tells all processes, launch tells them again
        driver.process.send_signal(number)
        space.spin(0.2)
    space.until(lambda: driver.process.poll() is not None, 'the end of the driver')
    assert driver.process.returncode == 0
    rest = pytest.approx(LOW, abs=0.02)
    space.until(lambda: max(last(space.states).effort) == rest, 'the end of the ramp')
    assert all(-change < limit for change, limit in changes(space, rate))
    space.until_code(space.controller, 'no_driver')


def test_a_terminal_that_takes_no_words_stops_no_thread(space):
    """As after Ctrl-S in it, or when its connection hangs: the log would wait, and all with it."""
    taken, full = os.pipe()
    own = os.open(f'/proc/self/fd/{full}', os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(own, b'.')
    known = {'robot': 'kato_10_1', 'config': 'mock_twin', **PATIENT['driver']}
    with (
        os.fdopen(full, 'w') as output,
        NodeProcess('driver', known, space.namespace, output) as node,
    ):
        space.until_code(space.driver, 'released', timeout=120.0)
        assert space.trigger('driver/stop').success
        space.until_code(space.driver, 'stopped')
        assert space.trigger('driver/reset').success
        assert node.end(timeout=30.0) == 0
    os.close(taken)
    os.close(own)


def test_a_killed_controller_lets_the_arm_go_and_a_new_one_takes_over(space):
    _, controller = moved(space)
    controller.process.kill()
    space.until_code(space.driver, 'releasing', 'released')
    assert 'the sender of the commands has died' in last(space.driver).message
    space.until(lambda: max(last(space.states).effort) < LOW + 0.01, 'pretension')
    space.run('controller')
    space.until_code(space.driver, 'following')
    space.go_to_point(*FAR)


def test_a_killed_driver_halts_the_controller_and_the_next_one_moves_nothing(space):
    driver, _ = moved(space)
    driver.process.kill()
    space.until_code(space.controller, 'no_driver')
    space.commands.clear()
    space.until(lambda: len(space.commands) > 10, 'commands')
    held = [message.effort.tolist() for _, message in space.commands]
    assert all(effort == held[0] for effort in held)
    space.until(lambda: 'no commands' in last(space.controller).message, 'silence')
    space.states.clear()
    space.run('driver')
    space.until_code(space.controller, 'holding')
    space.until(lambda: len(space.states) > 50, 'states')
    assert max(max(message.effort) for _, message in space.states) < LOW + 0.01
    space.go_to_point(*FAR)
    assert max(last(space.states).effort) > 0.5


def test_with_resume_the_next_driver_is_led_to_the_old_target(space):
    driver = space.run('driver')
    space.run('controller', resume=True)
    space.until_code(space.controller, 'holding', timeout=120.0)
    space.go_to_point(*FAR)
    driver.process.kill()
    space.until_code(space.controller, 'no_driver')
    space.states.clear()
    space.run('driver', rate_limit=RATE_LIMIT)
    space.until(lambda: space.states and max(last(space.states).effort) > 0.5, 'the posture')
    assert all(change < limit for change, limit in changes(space, RATE_LIMIT))
    space.until_code(space.controller, 'reached', 'nearest', 'at_limit')


def test_the_controller_may_come_first_and_waits(space):
    space.run('controller')
    space.until_code(space.controller, 'waiting', timeout=120.0)
    assert not space.commands
    space.run('driver')
    space.until_code(space.controller, 'holding')


def test_release_to_limp_switches_torque_off(space):
    _, controller = moved(space, release_to='limp')
    assert controller.end() == 0
    space.until_code(space.driver, 'releasing', 'limp')
    assert 'no command' not in last(space.driver).message  # it was told
    space.until_code(space.driver, 'limp')
    assert values(last(space.driver))['torque_off'].count(',') == 3
    space.until(lambda: max(last(space.states).effort) < 0.01, 'slack tendons')


def test_without_autostart_the_transitions_are_those_of_ros(space):
    heard = {'driver': space.driver, 'controller': space.controller}
    active = {'driver': ('following', 'releasing', 'released'), 'controller': ('holding',)}
    for node, said in heard.items():
        space.run(node, autostart=False)
        space.until_code(said, 'unconfigured')
        assert space.change(node, Transition.TRANSITION_CONFIGURE)
        space.until_code(said, 'off')
        assert space.change(node, Transition.TRANSITION_ACTIVATE)
        space.until_code(said, *active[node])
    assert space.change('controller', Transition.TRANSITION_DEACTIVATE)
    space.until_code(space.controller, 'off')
    assert space.change('driver', Transition.TRANSITION_DEACTIVATE)
    space.until_code(space.driver, 'stopped')
    assert 'the node is not active' in last(space.driver).message
    assert space.change('driver', Transition.TRANSITION_CLEANUP)
    assert space.change('driver', Transition.TRANSITION_CONFIGURE)


@pytest.mark.parametrize(
    ('node', 'parameters', 'words'),
    [
        ('driver', {'robot': 'nowhere.yaml'}, 'nowhere.yaml: file: expected a readable YAML'),
        ('driver', {'config': 'lags: 1'}, 'expected one of lag, tension_noise'),
        ('controller', {'model': ''}, 'expected the name of a robot'),
        ('controller', {'model': 'name: x'}, 'sections: expected a list'),
    ],
)
def test_a_node_that_cannot_start_says_why(space, node, parameters, words):
    process = space.run(node, **parameters)
    heard = getattr(space, node)
    space.until_code(heard, 'not_ready')
    assert words in last(heard).message
    assert process.process.poll() is None


def test_a_node_that_could_not_start_tries_again(space, tmp_path):
    late = tmp_path / 'late.yaml'
    nodes = [space.run('driver', robot=str(late)), space.run('controller', model=str(late))]
    for heard in (space.driver, space.controller):
        space.until_code(heard, 'not_ready')
    late.write_text(dump_robot(load_robot('kato_10_1')))
    space.until_code(space.controller, 'holding')
    assert [node.process.poll() for node in nodes] == [None, None]


def test_a_parameter_that_cannot_be_ends_the_process_with_one_line(tmp_path):
    process = start('driver', '/bad_parameter', tmp_path, command_mode='telepathy')
    assert process.process.wait(60.0) == 1
    (log,) = tmp_path.glob('driver_*.log')
    expected = "error: command_mode: expected one of tension, pull, got 'telepathy'\n"
    assert log.read_text() == expected


def test_what_the_launch_file_starts_holds_the_arm(space, tmp_path):
    mine = {'model': 'kato_10_1', 'config': 'mock_twin', 'command_mode': 'pull'}
    file = tmp_path / 'mine.yaml'
    file.write_text(yaml.dump({'/**': {'ros__parameters': mine}}))
    said = {'params_file': str(file), 'robot': 'kato_10_1', 'log_level': 'warn'}
    said['namespace'] = space.namespace
    path, shares = ROOT / 'launch' / 'robot.launch.py', {'tendon_robot_ros': ROOT}
    for one in launch(path, tmp_path, shares, **said):
        Forked([one.executable, *one.arguments])
    space.until_code(space.controller, 'holding', timeout=120.0)
    space.until_code(space.driver, 'following')
    assert values(last(space.driver))['mode'] == 'pull'


def test_two_robots_live_in_two_namespaces(tmp_path):
    spaces = '/one', '/two'
    nodes = [start(node, name, tmp_path) for name in spaces for node in ('driver', 'controller')]
    stations = [Station(name) for name in spaces]
    try:
        for station in stations:
            station.until_code(station.controller, 'holding', timeout=120.0)
        stations[0].go_to_point(*FAR)
        stations[1].spin(0.2)
        assert max(last(stations[0].states).effort) > 0.5
        assert max(last(stations[1].states).effort) == pytest.approx(LOW, abs=1e-3)
    finally:
        for process in nodes:
            process.process.send_signal(signal.SIGINT)
        for process in nodes:
            process.end()
        for station in stations:
            station.close()


def test_in_pull_mode_the_chain_reaches_a_target_too(space):
    # how hard tendons pull against each other is in the stretch of the wires alone
    elastic = load_robot('kato_10_1').with_effect('tendon_elongation', {'compliance': 1e-4})
    space.run('driver', command_mode='pull', robot=dump_robot(elastic))
    space.run('controller', command_mode='pull', model=dump_robot(elastic))
    space.until_code(space.controller, 'holding', timeout=120.0)
    space.go_to_point(0.06, 0.17)
    assert len(last(space.commands).effort) == 0
    assert space.tip() == pytest.approx([0.06, 0.0, 0.17], abs=5e-4)
