"""The topic stop: anybody's true stops the arm, and nobody's false speaks for another."""

from itertools import product

import pytest

pytest.importorskip('rclpy')

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_station import LOW, Station, holding, last, start
from std_msgs.msg import Bool

from tendon_robot_ros.ros.shared.messages import COMMAND, LATCHED

pytestmark = pytest.mark.ros
SPACE = '/stopping'
KINDS = list(
    product(
        (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT),
        (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL),
    )
)


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    with holding(SPACE, tmp_path_factory.mktemp('logs')) as station:
        yield station


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


def test_a_false_of_one_does_not_end_the_true_of_another(running, panels):
    pressed, other = panels(LATCHED), panels(COMMAND)
    pressed.publish(Bool(data=True))
    stopped(running)
    other.publish(Bool(data=False))
    running.spin(1.0)  # time enough to ask the one that is pressed again
    for node in ('driver', 'controller'):
        assert not running.trigger(f'{node}/reset').success
    pressed.publish(Bool(data=False))
    running.until(lambda: running.trigger('driver/reset').success, 'a reset')


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
