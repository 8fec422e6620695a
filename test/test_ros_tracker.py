"""What a tracker may send: a topic per marker, late and refused messages; the loop it closes."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseArray, PoseStamped
from ros_station import INPUTS, LATCHED, Station, holding, last, start, values
from sensor_msgs.msg import JointState

from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

pytestmark = pytest.mark.ros
LOADED = 120.0  # [s] a busy machine may need to load the model
TENSIONS = [0.3, 0.1, 0.1, 0.4]
MARKERS = '[{name: middle, arc_length: 0.1}, {name: tip, arc_length: 0.2}]'
TOPICS = '{middle: camera/one, tip: camera/two}'
TURNED = '0.1 0 0 0 0 0.70710678 0.70710678'  # by 90° about z, then 100 mm along x


class Tracked(Station):
    """A monitor alone with what a test sends."""

    def __init__(self, folder, name, **parameters):
        super().__init__(f'/{name}')
        self.monitor = self.hear(DiagnosticStatus, 'monitor/status', LATCHED)
        self.measured = self.hear(PoseArray, 'monitor/measured')
        known = {'model': 'kato_10_1', 'markers': MARKERS, 'folder': str(folder), **parameters}
        self.process = start('monitor', f'/{name}', folder, **known)

    def end(self):
        self.process.end()
        self.close()

    def feed(self, condition, what, old=0.0, frame='kato_10_1_base', **poses):
        """Send states and poses (topic with _ for /) until something is true."""

        def sent():
            now = self.node.get_clock().now()
            states = JointState(name=list(INPUTS), effort=TENSIONS, position=[0.0] * 4)
            states.header.stamp = now.to_msg()
            self.send('tendon_states', states)
            for topic, place in poses.items():
                message = PoseStamped()
                message.header.frame_id = frame
                nanoseconds = now.nanoseconds - int(1e9 * old)
                message.header.stamp.sec = nanoseconds // 10**9
                message.header.stamp.nanosec = nanoseconds % 10**9
                p = message.pose.position
                p.x, p.y, p.z = map(float, place)
                self.send(topic.replace('_', '/', 1) if 'camera' in topic else topic, message)
            self.spin(0.05)
            return condition()

        self.until(sent, what, LOADED)

    def places(self):
        return np.array([[p.position.x, p.position.y, p.position.z]
                         for p in last(self.measured).poses])  # fmt: skip

    def says(self, code):
        return bool(self.monitor) and values(last(self.monitor))['code'] == code


@pytest.fixture
def tracked(request, tmp_path):
    made = []

    def make(**parameters):
        made.append(Tracked(tmp_path, request.node.name[:40], **parameters))
        made[0].until(lambda: not made[0].says('waiting') and made[0].monitor, 'loading', LOADED)
        return made[0]

    yield make
    for one in made:
        one.end()


def test_a_topic_per_marker_in_the_frame_of_the_tracker(tracked):
    station = tracked(measured_markers=TOPICS, tracker_transform=TURNED)
    arm = Model(load_robot('kato_10_1')).shape(TENSIONS)
    wanted = arm.markers(np.array([0.1, 0.2]), np.zeros((2, 3)))
    x, y, z = (wanted - [0.1, 0.0, 0.0]).T
    seen = np.array([y, -x, z]).T  # as the turned camera sees it
    both = {'frame': 'camera', 'camera_one': seen[0], 'camera_two': seen[1]}

    def compared():
        return station.says('comparing') and np.isfinite(station.places()).all()

    def near():
        return float(values(last(station.monitor))['error (m)']) < 1e-3

    station.feed(compared, 'both markers', **both)
    assert station.places() == pytest.approx(wanted, abs=1e-6)
    station.feed(near, 'a small error', **both)
    station.measured.clear()
    station.feed(
        lambda: len(station.measured) > 3,
        'one marker, and 0, 0, 0 for one that was not seen',
        camera_one=np.zeros(3),
        camera_two=seen[1],
    )
    assert np.isnan(station.places()[0]).all()
    assert station.places()[1] == pytest.approx(wanted[1], abs=1e-6)


def test_what_comes_too_late_or_in_another_frame_is_refused_and_named(tracked):
    station = tracked()
    arm = Model(load_robot('kato_10_1')).shape(TENSIONS)
    tip = arm.tip_position
    heard = station.measured
    station.feed(lambda: heard and station.says('comparing'), 'the tip', measured_tip=tip)
    assert np.isnan(station.places()[0]).all(), 'a tip says nothing of the other markers'
    station.feed(lambda: station.says('refused'), 'a refusal', old=2.0, measured_tip=tip)
    assert 'expected at most 0.5 s' in last(station.monitor).message
    station.feed(lambda: station.says('comparing'), 'the tip again', measured_tip=tip)
    station.feed(lambda: station.says('refused'), 'a refusal', frame='camera', measured_tip=tip)
    assert 'camera' in last(station.monitor).message
    assert 'kato_10_1_base' in last(station.monitor).message


def test_a_marker_that_nobody_knows_is_named(tracked):
    station = tracked(measured_markers='{elbow: camera/one}')
    station.until_code(station.monitor, 'problem', timeout=LOADED)
    assert 'expected names of middle, tip, got' in last(station.monitor).message


def test_a_shifted_tracker_is_off_by_its_shift_once(tmp_path):
    hidden = '{base_misalignment: {shift_x: 0.005, rotation_y: 0.05}}'
    config = f'{{plant: {{refine: 1, scatter: 0.0, hidden: {hidden}}}}}'
    station = Station('/shifted')
    try:
        with start('driver', '/shifted', tmp_path, config=config):
            station.until(lambda: station.tips, 'the tip', LOADED)
    finally:
        station.close()
    straight = 0.208
    assert station.tip()[0] == pytest.approx(0.005 + straight * np.sin(0.05), abs=1e-3)
    turn = last(station.tips).pose.orientation
    along = 2.0 * (turn.x * turn.z + turn.w * turn.y)  # x of the direction that +z points to
    assert along == pytest.approx(np.sin(0.05), abs=2e-3)


def test_the_tip_of_an_arm_unlike_the_model_is_brought_to_the_target(tmp_path):
    hidden = (
        '{plant: {refine: 1, scatter: 0.0, hidden: {backbone_stiffness: {relative_change: 0.1}}}}'
    )
    nodes = {'driver': {'config': hidden}, 'controller': {'tip_gain': 2.0}}
    with holding('/loop', tmp_path, **nodes) as station:
        target = np.array([0.06, 0.0, 0.17])
        station.go_to_point(0.06, 0.17)
        station.until(lambda: np.linalg.norm(station.tip() - target) < 2e-4, 'the target')
        assert float(values(last(station.controller))['correction (m)']) > 1e-3
        station.until(
            lambda: float(values(last(station.controller))['measured_error (m)']) < 2e-4,
            'the status to say so',
        )
