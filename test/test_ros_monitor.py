"""The monitor among other nodes: any order, restarts, drop-outs, two namespaces."""

import json
import re
import signal
import time
from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from arms import coarse
from diagnostic_msgs.msg import DiagnosticStatus
from forked import Forked
from geometry_msgs.msg import WrenchStamped
from ros_station import LATCHED, Station, last, start, values
from std_msgs.msg import Float64, Float64MultiArray, String
from visualization_msgs.msg import Marker, MarkerArray

from tendon_robot_ros.data import default_markers
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.monitoring import History
from tendon_robot_ros.monitoring.monitor import FrameMean
from tendon_robot_ros.monitoring.watch import ArmWatch, WatchSettings
from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.monitor.watching import Watching
from tendon_robot_ros.workspace.postures import default_postures

pytestmark = [pytest.mark.ros, pytest.mark.long]
LOADED = 120.0  # [s] a busy machine may need to load the model
TRACKER = 'tracker: {rate: 30.0, noise: 1.0e-4, missing: 0.1, lost: 0.1}'
ROBOT = load_robot('kato_10_1')
SOFT = ROBOT.with_effect('backbone_stiffness', {'relative_change': 0.1})
# what an arm as built costs to learn grows with its cells
COARSE = coarse('kato_10_1', 5)
INTERVAL = {'value': 0.0, 'low': -0.2, 'high': 0.2, 'unit': '1'}
STRETCHED = replace(  # one channel pulls 3 % more than it says
    COARSE,
    tendons=tuple(
        replace(t, base=(1.03 * t.base[0], 0.0), end=(1.03 * t.end[0], 0.0))
        if t.name == 'dist_left'
        else t
        for t in COARSE.tendons
    ),
)
EXACT_TRACKER = 'plant: {twin: true}\ntracker: {rate: 60.0, noise: 1.0e-4}\n'
POINTS = [(0.1, 0.1), (-0.08, 0.14), (0.05, 0.18), (-0.12, 0.08), (0.12, 0.06)]
FITTED = COARSE.with_effect(
    'backbone_stiffness',
    {'relative_change': 0.0},
    {'parameters': {'relative_change': INTERVAL}},
)


def test_what_was_being_learned_is_no_part_of_what_is_learned_anew():
    watch = ArmWatch(Model(COARSE), default_markers(COARSE), WatchSettings(3, 20000.0, 1e-4))
    for tensions in default_postures(COARSE, 3, 0, 'tension', 'from_straight'):
        watch.update(tensions, watch.model.shape(tensions).positions)
    learning, watching = watch._learning, SimpleNamespace(watch=watch)
    assert learning is not None
    Watching.set_model(watching, watch.model)
    learning.join()
    assert watch.state is not None
    assert watching.watch.state is None and '0 of 3' in watching.watch.text


def test_a_single_reading_that_a_load_cell_misses_does_not_hide_the_force_of_the_others():
    states, told = History(), []
    watching = SimpleNamespace(
        _drift=False,
        _monitor=SimpleNamespace(states=states),
        _due=0.0,
        _frames=FrameMean(1e-4, 0.01, 3.0),
        _is_due=lambda: True,
        _publish=lambda tensions, *_: told.append(tensions),
        watch=SimpleNamespace(observer=SimpleNamespace(slopes=None)),
    )
    for number in range(30):
        now, tension = number / 10.0, np.nan if number == 10 else 1.0
        states.put(now, np.array([tension, 1.0, np.nan, np.nan]))
        Watching.frame(watching, now, np.zeros((2, 3)), None)
    assert np.isfinite(told).all()
    assert len(told) == 29


class Watched(Station):
    """A namespace with what the monitor says."""

    def __init__(self, namespace, folder):
        super().__init__(namespace)
        self.folder, self.started = folder, []
        self.monitor = self.hear(DiagnosticStatus, 'monitor/status', LATCHED)
        self.rolling = self.hear(Float64, 'monitor/rolling_error')
        self.verdicts = self.hear(String, 'monitor/verdict', LATCHED)

    def run(self, name, **more):
        parameters = {
            'driver': {
                'robot': dump_robot(SOFT),
                'config': f'plant: {{twin: true}}\n{TRACKER}\n',
            },
            'controller': {},
            'monitor': {
                'folder': str(self.folder / 'recordings'),
                'path': 'from_straight',
                'force_rate': 5.0,
            },
        }[name] | more
        self.started.append(start(name, self.namespace, self.folder, **parameters))
        return self.started[-1]

    def watched(self):
        return values(last(self.monitor)).get('watch', '')

    def learned(self):
        said = re.search(r'(\d+) of', self.watched())
        return int(said[1]) if said else 0

    def knows(self):
        return self.watched() == 'as it was'

    def comparing(self):
        self.until_code(self.monitor, 'comparing', timeout=LOADED)

    def end(self):
        for process in self.started:
            if process.process.poll() is None:
                process.process.send_signal(signal.SIGINT)
        for process in self.started:
            process.end()
        self.close()


@pytest.fixture
def space(request, tmp_path):
    space = Watched('/' + request.node.name[:40], tmp_path)
    yield space
    space.end()


def test_in_any_order_with_drop_outs_and_restarts_the_monitor_compares(space):
    space.run('monitor')
    space.until_code(space.monitor, 'waiting', timeout=LOADED)
    controller = space.run('controller')
    driver = space.run('driver')
    space.comparing()
    refused = space.trigger('monitor/diagnose')
    assert not refused.success
    assert 'record two or more' in refused.message
    refused = space.trigger('monitor/add')
    assert not refused.success
    assert 'call record, then diagnose' in refused.message
    forces = space.hear(WrenchStamped, 'monitor/tip_force')
    covariances = space.hear(Float64MultiArray, 'monitor/tip_force_covariance')
    space.until(lambda: forces and covariances, 'the force at the tip')
    assert last(forces).header.frame_id == 'kato_10_1_base'
    spread = np.reshape(last(covariances).data, (3, 3))
    assert (np.linalg.eigvalsh(spread) > 0.0).all()
    force = last(forces).wrench.force
    assert np.linalg.norm([force.x, force.y, force.z]) < 0.1, 'nothing touches it'
    assert '0 of 30 postures' in space.trigger('monitor/learn').message
    driver.process.kill()
    space.until_code(space.monitor, 'no_tracker', 'not_compared')
    space.run('driver')
    space.comparing()
    controller.process.kill()
    space.spin(1.0)
    space.rolling.clear()
    space.until(lambda: space.rolling, 'errors without a controller')


def test_a_stiffer_arm_is_followed_within_the_interval_and_undo_gives_the_old_model_back(space):
    """The arm is 10 % stiffer than its description, whose interval is 20 % to both sides."""
    said = space.hear(String, 'monitor/adaptation', LATCHED)
    stiff = COARSE.with_effect('backbone_stiffness', {'relative_change': 0.1})
    space.run('driver', robot=dump_robot(stiff), config=EXACT_TRACKER)
    space.run('controller', model=dump_robot(FITTED))
    space.run('monitor', adapt=True, still_time=0.3, force_rate=0.0)
    space.comparing()
    refused = space.trigger('monitor/undo')
    assert not refused.success
    assert 'nothing was changed' in refused.message

    def told():
        return json.loads(last(said).data) if said else {'changes': 0, 'postures': 0}

    for x, z in POINTS * 2:
        before = told()['postures']
        space.go_to_point(x, z)
        space.rolling.clear()
        space.until(lambda before=before: told()['postures'] > before, 'a posture')
        space.until(lambda: space.rolling, 'the error there')
        if told()['changes']:
            break
    assert told()['changes'] == 1, told()
    (change,) = told()['last']['parameters']
    assert change['before'] == 0.0
    assert 0.05 < change['after'] <= 0.1, 'a quarter of the interval at most'
    _, before = space.rolling[0]  # the model may be another by now
    space.until(lambda: space.text('controller', 'model') != dump_robot(FITTED), 'another model')
    stiffer = load_robot(space.text('controller', 'model')).effects['backbone_stiffness']
    assert stiffer['relative_change'] == pytest.approx(change['after'], rel=1e-4)
    space.until(lambda: last(space.rolling).data < 0.4 * before.data, 'a smaller error at the tip')
    undone = space.trigger('monitor/undo')
    assert undone.success
    assert undone.message == 'backbone_stiffness.relative_change is 0 again; adapt is false now'
    space.until(lambda: space.text('controller', 'model') == dump_robot(FITTED), 'the old model')
    space.until(lambda: values(last(space.monitor))['adapt'] == 'false', 'that nothing follows')
    (back,) = told()['last']['parameters']
    assert (change['before'], change['after']) == (back['after'], back['before'])


def test_a_contact_is_told_with_its_place_and_stops_the_arm_or_lets_it_yield(space):
    """Something pushes at six tenths of the arm from the second start of the driver on."""
    place = 0.6 * COARSE.length
    pushed = COARSE.with_effect('point_load', {'arc_length': place, 'force_x': 0.015})
    space.run('driver', robot=dump_robot(COARSE), config=EXACT_TRACKER)
    space.run('controller', model=dump_robot(COARSE))
    reacting = {'contact_action': 'stop', 'contact_threshold': 0.005}
    space.run('monitor', still_time=0.3, tracker_noise=1e-4, **reacting)
    space.comparing()
    contacts = space.hear(String, 'monitor/contact')
    arrows = space.hear(MarkerArray, 'monitor/markers')

    def touched():
        return bool(contacts) and json.loads(last(contacts).data)['acts']

    space.go_to_point(0.06, 0.17)
    contacts.clear()  # on the way, states and frames are not of the same time
    arrows.clear()
    space.until(lambda: contacts and arrows, 'an estimate')
    assert not touched()
    assert last(arrows).markers[0].action == Marker.DELETE
    space.started[0].process.kill()
    space.run('driver', robot=dump_robot(pushed), config=EXACT_TRACKER)
    space.until(touched, 'the contact', LOADED)
    space.until_code(space.controller, 'stopped')
    space.until_code(space.driver, 'stopped')

    def placed():
        # a single estimate may be wrong, and its arrow comes after it
        told, arrow = json.loads(last(contacts).data), last(arrows).markers[0]
        if not told['acts'] or arrow.action != Marker.ADD or told['reaction'] != 'stop':
            return False
        begin = [arrow.points[0].x, arrow.points[0].y, arrow.points[0].z]
        off = np.linalg.norm(np.array(begin) - told['point'])
        return max(2.0 * off, abs(told['arc_length'] - place)) < 0.1 * COARSE.length

    space.until(placed, 'its place, when the arm is at rest')
    told = json.loads(last(contacts).data)
    low, high = told['interval']
    assert low <= told['arc_length'] <= high < COARSE.length
    assert told['force'][0] == pytest.approx(0.015, rel=0.3)
    assert last(arrows).markers[0].type == Marker.ARROW
    refused = space.trigger('controller/reset')
    assert not refused.success, 'the contact lasts'
    assert space.set('monitor', 'contact_action', 'none').successful
    for node in 'driver', 'controller':
        space.until(lambda node=node: space.trigger(f'{node}/reset').success, f'{node} goes on')
    space.go_to_point(0.06, 0.17)
    assert space.code() in ('reached', 'nearest', 'at_limit')
    assert space.set('monitor', 'contact_action', 'yield').successful
    space.until_code(space.controller, 'holding')
    assert values(last(space.driver))['code'] == 'following', 'it lets go of nothing'


def learned_and_changed(space):
    """Let the monitor learn the arm; then one of its channels pulls 3 % more than it says."""
    for x, z in POINTS:
        before = space.learned()  # the posture at the start may count as one
        space.go_to_point(x, z)
        space.until(
            lambda before=before: space.learned() > before or space.knows(), 'one more posture'
        )
    space.until(space.knows, 'the arm as it is known', LOADED)
    space.started[0].process.kill()
    space.until_code(space.monitor, 'no_tracker', 'not_compared')
    space.run('driver', robot=dump_robot(STRETCHED), config=EXACT_TRACKER)
    space.comparing()
    end = time.monotonic() + LOADED
    for x, z in cycle(POINTS):  # on a busy machine not every posture is seen to stand
        space.go_to_point(x, z)
        if values(last(space.monitor))['drift'] == 'true' or time.monotonic() > end:
            break
    space.until_code(space.monitor, 'drifted')


def test_after_an_alarm_investigate_drives_to_what_tells_the_change_and_names_it(space):
    space.run('driver', robot=dump_robot(COARSE), config=EXACT_TRACKER)
    space.run('controller', model=dump_robot(COARSE))
    watching = {'reference_postures': float(len(POINTS)), 'tracker_noise': 1e-4}
    space.run('monitor', still_time=0.3, force_rate=0.0, **watching)
    space.comparing()
    refused = space.trigger('monitor/change')
    assert not refused.success
    assert re.search(rf'no alarm: learning the arm: [01] of {len(POINTS)}', refused.message)
    learned_and_changed(space)
    found, told = space.folder / 'found', space.folder / 'investigate.log'
    command = ['investigate', '--output', found, '--speed', 2, '--trials', 2]
    command += ['--ros-args', '-r', f'__ns:={space.namespace}']
    with told.open('w') as log, Forked(command, stdout=log, stderr=log) as process:
        space.until(lambda: process.poll() is not None, 'the end of investigate', LOADED)
    said = told.read_text()
    assert process.returncode == 0, said
    assert 'has changed: gain of dist_left (+' in said
    assert 'call monitor/learn' in said
    log = json.loads((found / 'investigation.json').read_text())
    assert log['outcome']['why'] == 'change_named'
    assert log['changed'][0]['values']['relative_change'] == pytest.approx(0.03, abs=0.01)
    space.trigger('monitor/learn')
    space.until(lambda: space.watched().startswith('learning the arm'), 'another reference')


@pytest.mark.slow
def test_record_diagnose_add_reach_the_controller_and_another_namespace_hears_nothing(
    space, tmp_path
):
    other = Watched('/elsewhere', tmp_path)
    try:
        for name in ('driver', 'controller', 'monitor'):
            space.run(name)
        space.comparing()
        assert space.trigger('monitor/record').success
        for x, z in POINTS:
            count = int(values(last(space.monitor))['postures'])
            space.go_to_point(x, z)
            space.until(
                lambda count=count: int(values(last(space.monitor))['postures']) > count,
                'a recorded posture',
            )
        count = values(last(space.monitor))['postures']
        assert f'stopped after {count} postures' in space.trigger('monitor/record').message
        assert f'{count} postures are kept' in space.trigger('monitor/record').message
        assert space.trigger('monitor/diagnose').success
        space.until(lambda: space.verdicts, 'the verdict', timeout=LOADED)
        verdict = json.loads(last(space.verdicts).data)
        names = [effect['name'] for effect in verdict['effects']]
        assert 'backbone_stiffness' in (*names, *verdict['cannot_tell_apart'])
        assert space.trigger('monitor/add').success
        space.until(lambda: values(last(space.monitor))['added'] == '1', 'the adding', LOADED)
        space.until(
            lambda: names[0] in values(last(space.controller)).get('model', ''), 'reload', LOADED
        )
        space.until(lambda: space.rolling and last(space.rolling).data < 1e-3, 'the fall', LOADED)
        assert not other.monitor and not other.rolling and not other.verdicts
    finally:
        other.end()
