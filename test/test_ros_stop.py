"""The topic stop: anybody's true stops the arm, and nobody's false speaks for another."""

import re
from itertools import product

import processes
import pytest

pytest.importorskip('rclpy')

from forked import Forked
from geometry_msgs.msg import PointStamped
from rclpy.duration import Infinite
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_station import LOW, Station, held, last, point, start, values
from std_msgs.msg import Bool, String

from tendon_robot_ros.common.processes import child_environment
from tendon_robot_ros.ros.shared.inbox import subscribe_any_qos
from tendon_robot_ros.ros.shared.interface import COMMAND, COMMAND_ALL, LATCHED, LISTEN

pytestmark = pytest.mark.ros
SPACE = '/stopping'
KINDS = list(
    product(
        (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT),
        (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
    )
)


running = held(SPACE)


class Panels:
    """Publishers of `stop`, gone after the test."""

    def __init__(self, station):
        self.station, self.made = station, []

    def __call__(self, qos):
        made = self.station.node.create_publisher(Bool, 'stop', qos)
        self.made.append(made)
        listeners = 2 * (1 + (qos.reliability == ReliabilityPolicy.RELIABLE))
        listeners += 2 * (qos == LATCHED)
        heard = made.get_subscription_count
        self.station.until(lambda: heard() >= listeners, 'both nodes to listen')
        return made

    def gone(self):
        for made in self.made:
            self.station.node.destroy_publisher(made)
        self.made = []


@pytest.fixture
def panels(running):
    made = Panels(running)
    yield made
    made.gone()
    made(COMMAND).publish(Bool(data=False))
    for node in ('driver', 'controller'):
        running.until(lambda node=node: running.trigger(f'{node}/reset').success, 'a reset')
    made.gone()
    running.until_code(running.controller, 'holding')


def bent(station):
    station.go_to_point(0.06, 0.17)
    assert max(last(station.states).effort) > 0.5


def stopped(station):
    station.until_code(station.controller, 'stopped')
    station.until_code(station.driver, 'stopped')


@pytest.mark.parametrize(('reliability', 'durability'), KINDS)
def test_a_publisher_of_any_kind_stops_both(running, panels, reliability, durability):
    qos = QoSProfile(depth=10, reliability=reliability, durability=durability)
    panel = panels(qos)
    bent(running)
    panel.publish(Bool(data=True))
    stopped(running)
    running.until(lambda: max(last(running.states).effort) < LOW + 0.01, 'pretension')


def test_every_topic_that_a_person_may_write_to_hears_publishers_of_any_kind(running):
    """A best-effort, volatile subscription without deadlines hears all of them."""
    written = {
        f'{running.namespace}/{name}': {f'{running.namespace}/{node}' for node in nodes}
        for name, nodes in {
            'stop': ('controller', 'driver'),
            'tendon_command': ('driver',),
            'tendon_states': ('controller',),
            'controller/target_pose': ('controller',),
            'controller/target_point': ('controller',),
            'controller/delta_twist': ('controller',),
            'controller/tendon_trajectory': ('controller',),
        }.items()
    }

    def deaf():
        return {
            topic: nodes
            - {
                f'{one.node_namespace}/{one.node_name}'
                for one in running.node.get_subscriptions_info_by_topic(topic)
                if one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
                and one.qos_profile.durability == DurabilityPolicy.VOLATILE
                and one.qos_profile.deadline == Infinite
                and one.qos_profile.liveliness_lease_duration == Infinite
            }
            for topic, nodes in written.items()
        }

    running.until(lambda: not any(deaf().values()), 'ears for all publishers')
    subscribed = {
        topic
        for node in ('controller', 'driver')
        for topic, _ in running.node.get_subscriber_names_and_types_by_node(node, SPACE)
        if topic.startswith(SPACE)
    }
    passed_on = {f'{SPACE}/_stop_heard', f'{SPACE}/driver/status'}  # from node to node
    assert subscribed - passed_on == set(written)


def test_a_tracker_is_heard_while_the_loop_is_closed(running):
    def ears():
        found = running.node.get_subscriptions_info_by_topic(f'{SPACE}/measured_tip')
        return [one.qos_profile.reliability for one in found if one.node_name == 'controller']

    assert not ears()
    assert running.set('controller', 'tip_gain', 0.01).successful
    running.until(lambda: ears() == [ReliabilityPolicy.BEST_EFFORT], 'an ear for trackers')
    assert running.set('controller', 'tip_gain', 0.0).successful
    running.until(lambda: not ears(), 'a tracker that nobody hears')


@pytest.mark.parametrize(('qos', 'ways'), [(COMMAND, 2), (LISTEN, 1)])
def test_what_comes_by_two_ways_is_heard_once(running, qos, ways):
    heard, node = [], running.node
    ears = subscribe_any_qos(node, PointStamped, 'anything', heard.append)
    person = node.create_publisher(PointStamped, 'anything', qos)

    def begun():
        person.publish(point(0.0, 0.0))
        return heard

    running.until(begun, 'each other')
    running.until(lambda: person.get_subscription_count() == ways, 'all ways')
    running.spin(0.1)
    heard.clear()
    for number, x in enumerate((1.0, 1.0, 2.0, 1.0)):
        person.publish(point(x, 0.0))
        running.until(lambda number=number: len(heard) > number, 'it')
    running.spin(0.1)
    assert [message.point.x for message in heard] == [1.0, 1.0, 2.0, 1.0]
    for ear in ears:
        node.destroy_subscription(ear)
    node.destroy_publisher(person)


@pytest.mark.parametrize('said_once', [LATCHED, COMMAND, LISTEN])
def test_a_false_of_one_does_not_end_the_true_of_another(running, panels, said_once):
    pressed, other = panels(said_once), panels(COMMAND)
    other.publish(Bool(data=False))  # as many words as the other: numbers tell nothing
    pressed.publish(Bool(data=True))
    stopped(running)
    other.publish(Bool(data=False))
    other.publish(Bool(data=False))
    running.spin(0.3)
    for node in ('driver', 'controller'):
        answer = running.trigger(f'{node}/reset')
        assert not answer.success
        assert 'topic stop says true' in answer.message
    pressed.publish(Bool(data=False))
    running.until(lambda: running.trigger('driver/reset').success, 'a reset')


def test_after_a_false_the_cause_is_gone_when_who_said_true_is(running, panels):
    other, pressed = panels(COMMAND), panels(COMMAND)
    pressed.publish(Bool(data=True))
    stopped(running)
    other.publish(Bool(data=False))
    running.spin(0.3)
    assert not running.trigger('driver/reset').success
    running.node.destroy_publisher(panels.made.pop())
    running.until(lambda: running.trigger('driver/reset').success, 'a reset')


def test_what_one_node_alone_has_heard_it_passes_on(running, panels):
    teller = running.node.create_publisher(String, '_stop_heard', COMMAND_ALL)
    own = running.hear(String, '_stop_heard')
    running.until(lambda: teller.get_subscription_count() >= 3, 'both nodes to listen')
    for text in ('', 'true', 'xyz 1 1 true', '01 1 1 true and more'):
        teller.publish(String(data=text))
    running.spin(0.2)
    assert values(last(running.driver))['stopped'] == 'false'
    teller.publish(String(data=f'{"0a" * 16} 1 1 true'))  # of one who has left
    stopped(running)
    own.clear()
    panels(COMMAND).publish(Bool(data=False))
    running.until(lambda: running.trigger('driver/reset').success, 'a reset')
    assert any(re.fullmatch(r'[0-9a-f]{32} 1 \d+ false', told.data) for _, told in own)
    running.node.destroy_publisher(teller)


def test_a_publisher_that_left_holds_nobody(running, panels):
    pressed = panels(COMMAND)
    pressed.publish(Bool(data=True))
    stopped(running)
    panels.gone()
    panels(COMMAND).publish(Bool(data=False))
    running.until(lambda: running.trigger('driver/reset').success, 'a reset')


def test_who_starts_late_hears_the_true_among_latched_words(running, panels, tmp_path):
    pressed, other = panels(LATCHED), panels(LATCHED)
    pressed.publish(Bool(data=True))
    other.publish(Bool(data=False))
    namespace = Station(SPACE)  # its list of the driver's statuses begins empty
    try:
        with start('driver', SPACE, tmp_path, extra=('-r', '__node:=late')):
            answers = []

            def refused():
                answers.append(namespace.trigger('late/reset'))
                return 'topic stop says true' in answers[-1].message

            namespace.until(refused, 'a driver that starts stopped')
    finally:
        namespace.close()
    pressed.publish(Bool(data=False))


def test_the_stop_command_stops_all_while_others_listen_and_a_reset_each_goes_on(running):
    """No `false` is needed after it: the services have latched the stop."""
    foreign = running.hear(Bool, 'stop', COMMAND_ALL)
    bent(running)
    process = Forked(
        ['stop', '--namespace', SPACE],
        stdin=processes.DEVNULL,
        stdout=processes.PIPE,
        stderr=processes.STDOUT,
        env=child_environment(),
    )
    running.until(lambda: process.poll() is not None, 'its end')
    said = process.communicate()[0]
    assert process.returncode == 0, said
    assert f'stopped: {SPACE}/controller, {SPACE}/driver' in said
    stopped(running)
    assert running.trigger('driver/reset').success
    assert running.trigger('controller/reset').success  # at once: it has asked the driver
    running.until_code(running.controller, 'holding')
    words = [message.data for _, message in foreign]
    assert words == sorted(words, reverse=True), 'true, as often as somebody comes, and then false'
    running.go_to_point(0.05, 0.18)


def test_both_resets_one_right_after_the_other_are_taken_every_time(running):
    for _ in range(20):
        assert running.trigger('driver/stop').success
        assert running.trigger('driver/reset').success
        answer = running.trigger('controller/reset')
        assert answer.success, answer.message
    running.go_to_point(0.05, 0.18)
