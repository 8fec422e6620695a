"""How nodes are run: the executor, the priority, and what must not wait for callbacks."""

import os
import signal
import sys
import threading
import time
from types import SimpleNamespace

import processes
import pytest

pytest.importorskip('rclpy')

import rclpy
import ros_station  # noqa: F401  (prepares the environment for rclpy)
from forked import Forked
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from tendon_robot_ros.common.processes import FIRST_NICENESS
from tendon_robot_ros.ros.controller import parameters as model_loading
from tendon_robot_ros.ros.controller.node import ControllerNode
from tendon_robot_ros.ros.driver.node import DriverNode
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED
from tendon_robot_ros.ros.shared.runtime import (
    SIGNAL_ECHO_S,
    Runnable,
    make_executor,
    ros,
    run,
)
from tendon_robot_ros.ros.shared.timing import NEWS_PERIOD_S

pytestmark = pytest.mark.ros
NAMES = ['prox_left', 'prox_right', 'dist_left', 'dist_right']


@pytest.fixture
def context():
    yield lambda *arguments: rclpy.init(
        args=['node', *arguments], signal_handler_options=SignalHandlerOptions.NO
    )
    rclpy.try_shutdown()


@pytest.fixture
def driver(context):
    """Give a driver that nobody spins: as if a callback took for ever."""
    parameters = ['robot:=kato_10_1', 'config:=mock_twin', 'rate_limit:=1000.0']
    context('--ros-args', '-r', '__ns:=/busy', *(w for p in parameters for w in ('-p', p)))
    node = DriverNode()
    yield node
    node.end()
    node.destroy_node()


def test_commands_and_stops_reach_the_motors_while_no_callback_is_served(driver):
    sender = Node('sender', namespace='/busy')
    commands = sender.create_publisher(JointState, 'tendon_command', COMMAND)
    stops = sender.create_publisher(Bool, 'stop', LATCHED)
    try:
        driver.trigger_configure()
        driver.trigger_activate()
        message = JointState(name=NAMES, effort=[2.0, 1.0, 1.0, 1.0])

        def followed():
            commands.publish(message)
            return driver.loop.driver.read().tensions[0] > 1.5

        processes.until(followed, 'the command at the motors')
        stops.publish(Bool(data=True))
        processes.until(lambda: driver.loop.supervisor.latch, 'the stop')
    finally:
        sender.destroy_node()


def test_a_signal_is_heard_while_the_main_thread_is_in_the_middleware():
    heard, found = threading.Event(), []
    with ros([]) as ending:
        executor = make_executor()
        ending.then(heard.set)

        def person():
            os.kill(os.getpid(), signal.SIGINT)
            found.append(heard.wait(20.0))
            executor.create_task(lambda: None)

        threading.Thread(target=person).start()
        executor.spin_once(timeout_sec=60.0)
        executor.shutdown()
    assert found == [True]
    assert ending.signal == signal.SIGINT


def compute():
    """Work without serving a message while a signal comes."""
    os.kill(os.getpid(), signal.SIGINT)
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        time.sleep(0.01)
    return 'went on to its end'


def in_a_computation(ending, done):
    try:
        done.append(compute())
    finally:
        with ending.interrupting(False):
            os.kill(os.getpid(), signal.SIGINT)  # an echo
            done.append('let go')
        done.append('saved')


def in_a_callback_before_it(ending, done):
    with ending.interrupting(False):
        os.kill(os.getpid(), signal.SIGINT)
        done.append('served')
    done.append(compute())


@pytest.mark.parametrize(
    ('work', 'does'),
    [(in_a_computation, ['let go', 'saved']), (in_a_callback_before_it, ['served'])],
)
def test_a_signal_ends_a_computation_and_not_what_then_lets_the_arm_go(work, does):
    """As an investigation, whose diagnosis may take a minute."""
    done = []
    with ros([]) as ending, ending.interrupting(), pytest.raises(KeyboardInterrupt):
        work(ending, done)
    assert done == does


def test_the_service_stop_answers_while_no_callback_is_served(driver):
    person = Node('person', namespace='/busy')
    client, executor = person.create_client(Trigger, 'driver/stop'), SingleThreadedExecutor()
    executor.add_node(person)
    try:
        assert client.wait_for_service(10.0)
        answer = call(executor, client)
        assert (answer.success, 'no motors are open' in answer.message) == (True, True)
        driver.trigger_configure()
        driver.trigger_activate()
        assert driver.loop.supervisor.latch.reasons == ['stop was called']
        assert call(executor, client).success
        driver.end()
        assert driver.latch.reasons == ['stop was called'], 'of closed motors nothing else'
    finally:
        person.destroy_node()


def call(executor, client):
    future = client.call_async(Trigger.Request())
    executor.spin_until_future_complete(future, 10.0)
    return future.result()


@pytest.mark.parametrize(
    ('before', 'ends'), [(signal.SIG_DFL, True), (signal.SIG_IGN, False)], ids=['', 'nohup']
)
def test_a_closed_terminal_ends_who_was_not_started_with_nohup(before, ends):
    old = signal.signal(signal.SIGHUP, before)
    heard = threading.Event()
    try:
        with ros([]) as ending:
            ending.then(heard.set)
            os.kill(os.getpid(), signal.SIGHUP)
            assert heard.wait(20.0 if ends else 0.2) == ends
            ending.request(signal.SIGTERM)
            time.sleep(SIGNAL_ECHO_S + 0.1)
            ending.request(signal.SIGHUP)  # nobody insists with that
        assert signal.getsignal(signal.SIGHUP) == before
    finally:
        signal.signal(signal.SIGHUP, old)


class SlowLoader:
    """Stands where a model is loaded, and takes as long as the test wants."""

    doing, done = 'loading', False

    def __init__(self, *arguments):
        pass

    def cancel(self):
        pass


@pytest.fixture
def controller(context, monkeypatch):
    """Give a controller that nobody spins, and whose model takes for ever to load."""
    monkeypatch.setattr(model_loading, 'Loader', SlowLoader)
    context('--ros-args', '-r', '__ns:=/busy', '-p', 'model:=kato_10_1')
    node = ControllerNode()
    yield node
    node.core = None
    node.end()
    node.destroy_node()


def test_the_controller_says_at_once_what_it_does_before_it_is_ready(controller):
    said = []
    controller.status._latched = SimpleNamespace(publish=said.append)
    for doing in ('loading', 'compiling', 'building'):
        SlowLoader.doing = doing
        controller.running()
        time.sleep(NEWS_PERIOD_S)
    assert [(status.values[0].value, status.message) for status in said] == [
        ('loading', 'reading the model'),
        ('compiling', 'compiling the model, once; half a minute'),
        ('building', 'building the library of shapes'),
    ]


def test_the_controllers_stop_is_heard_while_no_callback_is_served(controller):
    person = Node('person', namespace='/busy')
    client, executor = person.create_client(Trigger, 'controller/stop'), SingleThreadedExecutor()
    commands = []
    person.create_subscription(JointState, 'tendon_command', commands.append, COMMAND)
    executor.add_node(person)
    try:
        assert client.wait_for_service(10.0)
        answer = call(executor, client)  # no model yet: it counts when that comes
        assert answer.success
        assert 'no model and commands nothing, so the driver is told nothing' in answer.message
        assert controller.latch.reasons == ['stop was called']
        controller.core = SimpleNamespace()
        processes.until(controller._publisher.get_subscription_count, 'a listener')
        answer = call(executor, client)
        assert answer.success
        assert 'the driver releases the arm' in answer.message
        processes.until(lambda: executor.spin_once(timeout_sec=0.1) or commands, 'a command')
        assert not commands[0].name  # the driver lets go
    finally:
        person.destroy_node()


@pytest.mark.parametrize(
    ('kind', 'action', 'robot'),
    [(ControllerNode, '_cycle', 'model'), (DriverNode, '_publish_status', 'robot')],
)
def test_nodes_go_on_while_the_clock_of_ros_stands_still(
    context, monkeypatch, kind, action, robot
):
    """As when the computer's clock is set back, or a simulation publishes no /clock."""
    cycles = []
    monkeypatch.setattr(model_loading, 'Loader', SlowLoader)
    monkeypatch.setattr(kind, action, lambda node: cycles.append(1))
    context('--ros-args', '-p', 'use_sim_time:=true', '-p', f'{robot}:=kato_10_1')
    node, executor = kind(), make_executor()
    executor.add_node(node)
    try:
        processes.until(
            lambda: executor.spin_once(timeout_sec=0.05) or len(cycles) > 3, 'its cycles'
        )
    finally:
        executor.remove_node(node)
        executor.shutdown(timeout_sec=1.0)
        node.end()
        node.destroy_node()


def test_without_the_executor_of_events_the_old_one_serves(context, monkeypatch):
    context()
    monkeypatch.setitem(sys.modules, 'rclpy.experimental.events_executor', None)
    executor = make_executor()
    assert type(executor) is SingleThreadedExecutor
    executor.shutdown()


class Failing(Runnable):
    """A node whose timer fails."""

    def __init__(self):
        super().__init__('failing')
        self.ended = False
        self.create_timer(0.01, self.fail)

    def fail(self):
        raise ValueError('nobody foresaw this')

    def end(self):
        self.ended = True


def test_an_error_in_a_callback_ends_the_process_the_safe_way(context, capfd):
    made = []
    assert run(lambda: made.append(Failing()) or made[0], []) == 1
    assert made[0].ended
    assert 'nobody foresaw this' in capfd.readouterr().err


def test_a_parameter_that_is_no_name_of_a_topic_is_refused_in_one_line(context, capfd):
    given = ['--ros-args', '-r', '__ns:=/named', '-p', 'driver_status:="a b"']
    assert run(ControllerNode, given) == 1
    said = capfd.readouterr().err
    assert 'Traceback' not in said
    assert said.splitlines()[-1].startswith('error: Invalid topic name: ')
    assert said.endswith(": 'a b'\n")


ENDS = """
import sys
from tendon_robot_ros.ros.shared.runtime import Runnable, run


class Quiet(Runnable):
    def __init__(self):
        super().__init__('quiet')
        print('runs', flush=True)


code = run(Quiet, [])
print('over', flush=True)
sys.stdin.readline()
sys.exit(code)
"""


def test_an_echo_of_the_signal_does_not_kill_a_process_that_has_ended_safe():
    """Launch passes a signal on while the interpreter of a node already ends."""
    pipes = {'stdin': processes.PIPE, 'stdout': processes.PIPE}
    with Forked(['-c', ENDS], **pipes) as process:
        assert process.stdout.readline() == 'runs\n'
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == 'over\n'
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            process.send_signal(number)
        process.communicate('\n', timeout=60.0)
    assert process.returncode == 0


SHOW = (
    'import os; from tendon_robot_ros.common.processes import go_first, go_with_others; {}; '
    'print(os.getpriority(os.PRIO_PROCESS, 0))'
)


def priority_after(calls, nice=0):
    program = [sys.executable, '-c', SHOW.format(calls)]
    given = ['nice', '-n', str(nice)] if nice else []
    return int(processes.run([*given, *program]).stdout)


def test_what_moves_motors_goes_first_where_it_may():
    mine = os.getpriority(os.PRIO_PROCESS, 0)
    if mine != 0:
        pytest.skip('the tests themselves were started with another priority')
    wanted = processes.run(['nice', '-n', str(FIRST_NICENESS), 'nice'])
    assert priority_after('go_first()') == int(wanted.stdout)  # 0 where it is not allowed
    assert priority_after('go_first(); go_with_others()') == 0
    assert priority_after('go_first()', nice=5) == 5


@pytest.mark.skipif(not os.path.exists('/proc/self/autogroup'), reason='a kernel without sessions')
@pytest.mark.parametrize('leads', [True, False], ids=['its own', 'of a terminal'])
def test_its_own_session_goes_first_too_where_it_may_and_one_with_others_does_not(leads):
    """Within it alone the nice value of what solves beside the commands would weigh."""
    if os.getpriority(os.PRIO_PROCESS, 0) != 0:
        pytest.skip('the tests themselves were started with another priority')
    wanted = processes.run(['nice', '-n', str(FIRST_NICENESS), 'nice']).stdout.strip()
    program = [
        *([] if leads else ['bash', '-c', '"$@"; true', 'shell']),  # as a child of who leads
        sys.executable,
        '-c',
        'from tendon_robot_ros.common.processes import go_first; go_first(); '
        'print(open("/proc/self/autogroup").read())',
    ]
    assert f' nice {wanted if leads else 0}\n' in processes.run(program).stdout


REALTIME = """
import os, threading
from tendon_robot_ros.common.processes import go_realtime, in_realtime
late = threading.Event()
threading.Thread(target=late.wait).start()
computes = threading.Thread(target=late.wait, name='computes')
computes.start()
before = in_realtime()
go_realtime(4, but=['computes'])
own = {int(thread): os.sched_getscheduler(int(thread)) for thread in os.listdir('/proc/self/task')}
left = own.pop(computes.native_id) == os.SCHED_OTHER
child = os.popen('chrt -p $$').read()
all_others = set(own.values()) == {os.SCHED_RR | os.SCHED_RESET_ON_FORK}
first = os.sched_getparam(0).sched_priority == 4
print(before, in_realtime(), all_others, first, left, 'SCHED_OTHER' in child)
late.set()
"""


def realtime(nice=0):
    return processes.run(['nice', '-n', str(nice), sys.executable, '-c', REALTIME]).stdout


def test_the_threads_of_the_driver_are_in_real_time_where_they_may_and_nothing_else():
    if os.getpriority(os.PRIO_PROCESS, 0) != 0:
        pytest.skip('the tests themselves were started with another priority')
    allowed = processes.run(['chrt', '-r', '5', 'true']).returncode == 0
    assert realtime() == f'False {allowed} {allowed} {allowed} True True\n'
    assert realtime(nice=5) == 'False False False False True True\n'
